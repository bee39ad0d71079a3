"""`tandem bench learner`: gradient updates a second, ours beside the same update in PyTorch eager.

work.py  what both are given: networks, rows and one minibatch, in one file
ours.py  the learner's own jitted update

The peer is bench/learner/torch_update.py, run by a Python that has torch (Debian's python3-torch).
"""
