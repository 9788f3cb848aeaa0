"""Import this before NumPy: a library that takes all cores would be timed beside one that does not."""

from __future__ import annotations

import os

THREADS = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
os.environ.update(THREADS)
