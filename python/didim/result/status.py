"""Endings of an identification: named statuses whose value is a sentence."""

from __future__ import annotations

from enum import Enum


class Status(Enum):
    """Ending of an identification.

    ``status.value`` is a sentence with the event and the advice.

    Tested in ``tests/test_identification.py``.
    """

    SOLVED = "Solved: the least-squares estimate is unique."
    ILL_CONDITIONED = (
        "Not solved well: the observation matrix is so badly conditioned that few digits of the estimate are "
        "right; use a more exciting motion, or drop or fix parameters."
    )
    CONVERGED = "Converged: the stopping rule of the method is met."
    NO_STEP = (
        "Not converged: with every step, however short, the simulation stops early; check the controller, the integration "
        "step, and the sign and unit of the torques."
    )
    NOT_CONVERGED = (
        "Not converged: the iterations ended before the parameters converged; look at the history, at the controller and "
        "at the log."
    )
    INTERRUPTED = "Interrupted: the estimate is the best point found so far."
    STOPPED = "Stopped by the callback: the estimate is the best point found so far."

    @property
    def converged(self) -> bool:
        """Whether the method converged (exit code 0 of the command line)."""
        return self in (Status.SOLVED, Status.CONVERGED)
