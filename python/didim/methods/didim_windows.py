"""Windows of a log for DIDIM: the closed loop of each, and the torques to explain. Tested in ``tests/test_didim.py``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..errors import FitError
from ..experiment.loop import closed_loop
from ..loop.closed_loop import ClosedLoop
from ..model.safe_step import thinned
from ..signal.align import align
from ..signal.spikes import without_spikes
from .method import Job

CHECKED_POSITIONS = 500
"""Positions along a simulated motion at which M(q) is kept positive definite."""


@dataclass(frozen=True)
class Window:
    """A window of the log: its closed loop, and the torques to explain."""

    loop: ClosedLoop
    name: str
    place: str
    tau: Array
    """Measured torques, aligned and trimmed, (n_kept, n_dof)."""
    kept: slice
    """Samples of the window that the torques stand beside."""


@dataclass(frozen=True)
class Simulated:
    """The motion of every window with some parameters."""

    motions: list[tuple[Array, Array, Array, Array]]
    scale: Array | None
    """Factors of the gains."""
    error: float
    """Norm of measured less simulated torque over that of measured torque, (12)."""
    finer: Array | None = None
    """Torques of the first window with half the steps, where they were asked for."""


def windows_of(job: Job, delay: float) -> list[Window]:
    """Return the windows of the recordings that are fitted, their torques moved back by a delay in samples."""
    experiment = job.experiment
    recordings = [item for item in experiment.recordings if item.role == "fit"]
    if not recordings:
        raise FitError(f"experiment '{experiment.name}' has no recording with role 'fit'")
    found = []
    for recording in recordings:
        if recording.tau is None:
            raise FitError(f"recording '{recording.name}' has no torques, which this method needs")
        for start, stop in recording.windows:
            loop = closed_loop(experiment, recording, (start, stop))
            n = stop - start
            # The torque is moved back against the motion as for IDIM-LS; the motion is simulated later.
            measured = without_spikes(recording.tau[start:stop], job.signal)
            (index,), tau = align([np.arange(n, dtype=np.float64)[:, None]], measured, delay)
            kept = slice(job.signal.trim_start, len(tau) - job.signal.trim_end)
            if kept.stop <= kept.start:
                raise FitError(
                    f"recording '{recording.name}': trimming {job.signal.trim_start} and {job.signal.trim_end} samples "
                    "leaves nothing"
                )
            first = int(index[0, 0])
            place = f"recording '{recording.name}'"
            if (start, stop) != (0, len(recording.q)):
                place += f", window of samples {start} to {stop}"
            found.append(
                Window(
                    loop=loop,
                    name=recording.name,
                    place=place,
                    tau=np.ascontiguousarray(tau[kept]),
                    kept=slice(first + kept.start, first + kept.stop),
                )
            )
    return found


def checked_positions(q: Array) -> Array:
    """Return the positions at which M(q) is kept positive definite, (n, n_dof)."""
    return thinned(q, CHECKED_POSITIONS)
