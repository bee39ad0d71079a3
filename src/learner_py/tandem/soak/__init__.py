"""A soak: a real-time training with its real programs, while a seeded monkey breaks what can break.

Data flow: `setting` (scenario) -> `programs` (the three processes) <- `monkey` (what it does when)
-> `ear` (what was heard) -> `run` (from start to orderly end) -> `verdict` (what log and ear say about it).
"""
