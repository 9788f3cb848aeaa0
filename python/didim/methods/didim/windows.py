"""Windows of a log for DIDIM, and the points and steps of its iteration. Tested in ``tests/test_didim.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array, ratio
from ...evidence.loop.simulated import Piece, compare_motions
from ...loop.outcome import Outcome
from ...regression.fit import Fit
from ...signal.window import Window
from ...terms.model import Model
from ...terms.rows import LinearSystem
from ..job import Job

Motion = tuple[Array, Array, Array, Array]
"""Simulated ``q dq ddq tau`` of a window, (n_kept, n_dof) each."""


@dataclass(frozen=True)
class Simulated:
    """Simulated motion of every window with some parameters."""

    motions: list[Motion]
    scale: Array | None
    """Factors of the gains."""
    error: float
    """Norm of measured less simulated torque over that of measured torque, (12)."""
    finer: Array | None = None
    """Torques of the first window with half the steps, where they were asked for."""


@dataclass(frozen=True)
class Iterate:
    """An iterate: standard parameters, their simulated motion, and the number of the iteration (0: the start)."""

    x: Array
    simulated: Simulated
    iteration: int


@dataclass(frozen=True)
class Solved:
    """The linear system (7) along the motion of an iterate, with its solution."""

    along: Iterate
    system: LinearSystem
    fit: Fit
    target: Array
    """Standard parameters of the solution, (n_parameters,)."""
    std: Array
    """Standard deviations of the base parameters, (b,)."""
    held: tuple[int, ...] = ()
    """Columns that the motion does not identify, which keep their values."""

    def at(self, length: float) -> Array:
        """Return the standard parameters at a share of the way from the iterate to the solution."""
        x = self.along.x
        return x + length * (self.target - x) if length < 1.0 else self.target


@dataclass(frozen=True)
class Step:
    """A step from one point to the next."""

    length: float
    """Share of the way to the solution."""
    largest: float
    """Largest share that keeps M(q) positive definite."""
    largest_change: float
    """Largest change of a base parameter on the whole way, in standard deviations."""
    after: Iterate | Outcome
    """Iterate after the step, or how the simulation of the shortest step ended."""
    wanted: float = 1.0
    """Share that was asked for before anything shortened it: a secant step is shorter by design."""
    repeated: bool = False
    """Whether the step keeps the parameters and only simulates them with smaller steps in time."""


def measured_torque(logs: Model, window: Window, x: Array) -> Array:
    """Return the measured torques of a window; with unknown drive gains the currents times the gains in `x`, (p + e,)."""
    if window.drives is None:
        return window.tau
    gains = x[len(x) - logs.n_gains :]
    return np.asarray((window.tau @ np.linalg.inv(window.drives) * gains) @ window.drives)


def beside(window: Window, arrays: Sequence[Array], candidate: int) -> Motion:
    """Return the motion of a candidate beside the torques of a window."""
    q, dq, ddq, tau = (values[candidate][window.kept] for values in arrays)
    return q, dq, ddq, tau


def of_motions(
    logs: Model,
    windows: Sequence[Window],
    x: Array,
    motions: list[Motion],
    scale: Array | None,
) -> Simulated:
    """Return simulated motions of every window, with the error of their torques."""
    squares, size = 0.0, 0.0
    for window, (_, _, _, tau) in zip(windows, motions, strict=True):
        measured = measured_torque(logs, window, x)
        squares += float(np.sum((measured - tau) ** 2))
        size += float(np.sum(measured**2))
    return Simulated(motions, scale, ratio(np.sqrt(squares), np.sqrt(size)))


def motion_record(job: Job, windows: Sequence[Window], motion: Simulated) -> dict[str, list[float]]:
    """Return the comparison of simulated and measured motion of all windows, for the record of a result."""
    pieces: list[Piece] = [
        (each.measured[each.kept] if each.measured.size else None, q, each.tau, tau)
        for each, (q, _, _, tau) in zip(windows, motion.motions, strict=True)
    ]
    return compare_motions(job.signal, pieces).record()


def along_motion(windows: Sequence[Window], motion: Simulated) -> list[Window]:
    """Return every window along its simulated motion."""
    return [window.along(each[:3]) for window, each in zip(windows, motion.motions, strict=True)]
