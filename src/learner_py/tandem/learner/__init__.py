"""The learner: executed episodes in, policies out. `process.py` is the place to start reading."""
