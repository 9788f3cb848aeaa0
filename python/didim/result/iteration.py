"""Iterations of a method, how they end, and errors on recordings that were held out.

Tested in ``tests/test_identification.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from .._tools.saved import plain, restored


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """One iteration of a method, passed to ``callback`` and stored in ``history``.

    Tested in ``tests/test_progress.py``.

    Attributes
    ----------
    iteration : int
        Counted from 1.
    relative_error : float
        Norm of the torque error over that of the torque, all joints.
    step : float
        Norm of the change of beta over that of beta (from zero in the first iteration).
    more : mapping of str to float
        Further numbers of the method.
    """

    iteration: int
    relative_error: float
    step: float
    more: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers as JSON data, further ones beside the others."""
        data: dict[str, Any] = plain(self)
        more: dict[str, Any] = data.pop("more")
        return data | more

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Iteration:
        """Restore an iteration from `to_dict`."""
        own = {key: data[key] for key in ("iteration", "relative_error", "step")}
        more = {key: value for key, value in data.items() if key not in own}
        made: Iteration = restored(cls, {**own, "more": more})
        return made


@dataclass(frozen=True, kw_only=True)
class Reporter:
    """Reports of a run in progress; by default they go nowhere.

    Attributes
    ----------
    progress : callable
        Called with every iteration; True stops the run.
    say : callable
        Called with sentences on the progress.
    measured : callable
        Called with the rows along measured motion (`didim.methods.job.MeasuredRows`), which the verdict would compute again.
    """

    progress: Callable[[Iteration], bool] = lambda iteration: False
    say: Callable[[str], None] = lambda sentence: None
    measured: Callable[[Any], None] = lambda rows: None

    @property
    def without_iterations(self) -> Reporter:
        """Sentences alone, for a run inside another: its iterations are not those of the whole."""
        return Reporter(say=self.say, measured=self.measured)


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Torque errors of an estimate on a held-out recording.

    Attributes
    ----------
    name : str
        Recording.
    relative_error : tuple of float
        Per joint, 0.07 = 7 %.
    overall_relative_error : float
        Of all joints together.
    error_rms : tuple of float
        Per joint, root mean square (N.m or N); empty in results of older versions.
    """

    name: str
    relative_error: tuple[float, ...]
    overall_relative_error: float
    error_rms: tuple[float, ...] = ()


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
