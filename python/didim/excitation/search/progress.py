"""The progress line of a design, with the remaining time. Tested in ``tests/test_progress.py``."""

from __future__ import annotations

import threading
import time

from ..._tools.progress import ProgressLine
from .starts import FIRST, HOPS, LAST, THINNED_COST, TRIAL, TRIALS


def share_done(evaluations: int, iterations: int) -> float:
    """Return the elapsed share of a start's time after a number of evaluations, for a Fourier series, at most 1."""
    thinned = (TRIALS * TRIAL + FIRST + HOPS + TRIAL) * iterations
    spent = THINNED_COST * min(evaluations, thinned) + max(0.0, evaluations - thinned)
    return min(1.0, spent / (THINNED_COST * thinned + LAST * iterations))


class DesignLine:
    """Callback of a search (`Progress`) with one line for all its starts, which may run in several threads.

    Parameters
    ----------
    starts : int
        Number of starts.
    iterations : int, optional
        Iterations of each start; None for a search that reports a start only at its end.
    wanted : bool
        Whether the line is shown.
    """

    def __init__(self, starts: int, iterations: int | None, wanted: bool) -> None:
        self._starts, self._iterations = starts, iterations
        self._line, self._lock, self._begin = ProgressLine(wanted), threading.Lock(), time.monotonic()
        self._done: dict[int, float] = {}
        self._values: dict[int, float] = {}

    def __call__(self, start: int, evaluations: int, value: float) -> None:
        """Update the line."""
        with self._lock:
            self._done[start] = 1.0 if self._iterations is None else share_done(evaluations, self._iterations)
            self._values[start] = value
            share = sum(self._done.values()) / self._starts
            left = (time.monotonic() - self._begin) * (1.0 - share) / share
            self._line.show(
                f"excite: {100.0 * share:.0f} %, criterion {max(self._values.values()):.1f}, about {left:.0f} s left"
            )

    def close(self) -> None:
        """Remove the line."""
        with self._lock:
            self._line.close()
