"""Contestants of `benches/peers.py`, a program per file. What all of them compute is in `task.py`."""
