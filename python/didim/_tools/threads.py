"""Number of threads of the core: limited by the environment or `set_threads`, and one in worker processes.

``DIDIM_THREADS`` applies to a process and its children, and to NumPy's threads if NumPy is loaded after this package.
Results have the same bits for any number. Tested in ``tests/test_threads.py``.
"""

from __future__ import annotations

import os
import sys

from ..errors import ThreadsError
from .settings import whole

VARIABLE = "DIDIM_THREADS"
"""Environment variable that limits the number of threads."""
MOST_THREADS = 4096
"""Largest number of threads that a user may ask for: no machine has more, so a larger number is a mistake."""
NUMPY_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that NumPy's linear algebra reads when it is loaded."""

_limit: list[int] = []
"""Limit set by `set_threads`; empty if it was not called."""


def set_threads(n: int | None) -> None:
    """Limit the threads of simulations, filters and observation matrices.

    Tested in ``tests/test_threads.py``.

    Parameters
    ----------
    n : int or None
        Largest number of threads. None removes the limit: then ``DIDIM_THREADS`` applies, or one thread in a worker process, or
        all cores.

    Raises
    ------
    ThreadsError
        For anything but a whole number of at least 1.

    Notes
    -----
    The argument ``threads`` of a method or a call has precedence.
    """
    if n is not None:
        whole("the number of threads", n, ThreadsError, least=1, most=MOST_THREADS)
    _limit[:] = [] if n is None else [n]


def core_threads(asked: int | None = None) -> int | None:
    """Return the number of threads for a call of the core: the requested one, or the limit; None for all cores.

    Raises
    ------
    ThreadsError
        For a wrong ``DIDIM_THREADS``.
    """
    if asked is not None:
        return asked
    if _limit:
        return _limit[0]
    text = os.environ.get(VARIABLE)
    if text is not None:
        number = int(text) if text.strip().isascii() and text.strip().isdigit() and len(text) < 9 else text
        return whole(VARIABLE, number, ThreadsError, least=1, most=MOST_THREADS)
    # The neighbours of a process of `multiprocessing` have the other cores.
    processes = sys.modules.get("multiprocessing.process")
    return None if processes is None or processes.parent_process() is None else 1


if VARIABLE in os.environ and "numpy" not in sys.modules:
    for _name in NUMPY_VARIABLES:
        os.environ.setdefault(_name, os.environ[VARIABLE])
