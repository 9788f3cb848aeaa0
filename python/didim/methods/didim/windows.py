"""Windows of a log for DIDIM, and the points and steps of its iteration. Tested in ``tests/test_didim.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array, ratio
from ...evidence.loop.simulated import Piece, compare_motions
from ...loop.closed_loop import ClosedLoop
from ...loop.outcome import Outcome
from ...regression.fit import Fit
from ...regression.linear_system import LinearSystem
from ...regression.logs.parameters import LogParameters
from ...signal.segments import Segment
from ..job import Job

Motion = tuple[Array, Array, Array, Array]
"""Simulated ``q dq ddq tau`` of a window, (n_kept, n_dof) each."""


@dataclass(frozen=True)
class Window:
    """A window of the log: its closed loop and measured torques."""

    loop: ClosedLoop
    name: str
    place: str
    recording: int
    window: int
    tau: Array
    """Measured torques, aligned and trimmed, (n_kept, n_dof)."""
    kept: slice
    """Samples of the window that the torques stand beside."""
    parameters: LogParameters
    drives: Array | None = None
    """Reduction matrix of the motors whose currents stand in place of the torques, (n_dof, n_dof)."""

    def torque(self, x: Array) -> Array:
        """Return the measured torques; with unknown drive gains the currents times the gains in `x`."""
        if self.drives is None:
            return self.tau
        gains = x[len(x) - self.parameters.n_gains :]
        return np.asarray((self.tau @ np.linalg.inv(self.drives) * gains) @ self.drives)

    def standard(self, x: Array) -> Array:
        """Return the standard parameters (p,) of the robot with the payload of this window."""
        return self.parameters.standard(x, self.recording)

    def run(self, x: Array, scale: Array | None) -> tuple[Motion, Outcome]:
        """Simulate the window with standard parameters, (n_parameters,), and scaled gains, (n_dof,)."""
        gains = None if scale is None else scale[None]
        arrays, (outcome,) = self.loop.run(self.standard(x)[None], gain_scale=gains)
        return self.motion(arrays, 0), outcome

    def motion(self, arrays: Sequence[Array], candidate: int) -> Motion:
        """Return the motion of a candidate beside the torques."""
        q, dq, ddq, tau = (values[candidate][self.kept] for values in arrays)
        return q, dq, ddq, tau


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


def of_motions(
    windows: Sequence[Window],
    x: Array,
    motions: list[Motion],
    scale: Array | None,
) -> Simulated:
    """Return simulated motions of every window, with the error of their torques."""
    squares, size = 0.0, 0.0
    for window, (_, _, _, tau) in zip(windows, motions, strict=True):
        measured = window.torque(x)
        squares += float(np.sum((measured - tau) ** 2))
        size += float(np.sum(measured**2))
    return Simulated(motions, scale, ratio(np.sqrt(squares), np.sqrt(size)))


def motion_record(job: Job, windows: Sequence[Window], motion: Simulated) -> dict[str, list[float]]:
    """Return the comparison of simulated and measured motion of all windows, for the record of a result."""
    pieces: list[Piece] = []
    for window, (q_s, _, _, tau_s) in zip(windows, motion.motions, strict=True):
        recording = job.experiment.recordings[window.recording]
        start, stop = recording.windows[window.window]
        q = recording.measured_positions()[start:stop][window.kept] if recording.has_positions else None
        pieces.append((q, q_s, window.tau, tau_s))
    return compare_motions(job.signal, pieces).record()


def segments_of(windows: Sequence[Window], motion: Simulated) -> list[Segment]:
    """Return the simulated motion of every window with the measured torques."""
    return [
        Segment(
            name=window.name,
            place=window.place,
            recording=window.recording,
            window=window.window,
            rate_hz=window.loop.rate_hz,
            q=np.ascontiguousarray(q),
            dq=np.ascontiguousarray(dq),
            ddq=np.ascontiguousarray(ddq),
            tau=window.tau,
        )
        for window, (q, dq, ddq, _) in zip(windows, motion.motions, strict=True)
    ]
