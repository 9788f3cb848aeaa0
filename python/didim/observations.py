"""From recordings to the linear system (6), (7): rows joint by joint, windows one after the other.

Each window of a recording is filtered by itself, so that nothing outside it (a stop, a tool change) leaks in.
Y and every column of W go through the same decimation filter, which keeps the linear relation between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from . import _core, signals
from .delay import align
from .errors import FitError, SignalError
from .least_squares import LinearSystem
from .schema import counted

if TYPE_CHECKING:
    from .recording import Recording
    from .robot import Robot
    from .selection import Selection
    from .signals import SignalProcessing, Stage

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Segment:
    """Motion and torque of one window, filtered and trimmed, at the rate of the recording.

    Attributes
    ----------
    name : str
        Recording that it is part of.
    place : str
        Recording and window, as messages open.
    rate_hz : float
        Its rate.
    q, dq, ddq : ndarray, shape (n_samples, n_dof)
        Joint position, velocity and acceleration, SI units.
    tau : ndarray, shape (n_samples, n_dof)
        Measured torque, N.m or N, joint side; not filtered.
    """

    name: str
    place: str
    rate_hz: float
    q: Array
    dq: Array
    ddq: Array
    tau: Array


def segments(recording: Recording, signal: SignalProcessing, delay_samples: float = 0.0) -> list[Segment]:
    """Filter, differentiate and trim each window of a recording.

    Parameters
    ----------
    recording : Recording
        Must have torques.
    signal : SignalProcessing
        Filter and trimming.
    delay_samples : float
        How late the torque was recorded; it is moved back by as much.

    Returns
    -------
    list of Segment
        One per window.

    Raises
    ------
    FitError
        Without torques, or when trimming leaves nothing of a window.
    SignalError
        When the filter cannot be applied; the message names recording and window.

    Notes
    -----
    ``test_identify.py`` filters windows each by itself, and reads the messages.
    """
    if recording.tau is None:
        raise FitError(f"recording '{recording.name}' has no torques, which this method needs")
    found = []
    for start, stop in recording.windows:
        place = f"recording '{recording.name}'"
        if (start, stop) != (0, len(recording.q)):
            place += f", window of samples {start} to {stop}"
        with told(place):
            found_motion = signals.differentiate(recording.q[start:stop], recording.rate_hz, signal)
            motion, tau = align(found_motion, recording.tau[start:stop], delay_samples)
        found.append(trimmed(recording, place, signal, motion, tau))
    return found


def trimmed(
    recording: Recording, place: str, signal: SignalProcessing, motion: Sequence[Array], tau: Array
) -> Segment:
    """Return the segment of aligned motion and torque, without the samples that trimming takes off its ends.

    Parameters
    ----------
    recording : Recording
        Gives name and rate.
    place : str
        Recording and window, for messages.
    signal : SignalProcessing
        Trimming.
    motion : sequence of (n, n_dof) arrays
        ``q dq ddq``, joint side.
    tau : (n, n_dof) array
        Joint torques (N.m or N).

    Raises
    ------
    FitError
        When trimming leaves nothing.
    """
    kept = slice(signal.trim_start, tau.shape[0] - signal.trim_end)
    if kept.stop <= kept.start:
        raise FitError(
            f"{place}: trimming {signal.trim_start} and {signal.trim_end} samples leaves nothing of "
            f"{counted(tau.shape[0], 'sample')}"
        )
    q, dq, ddq, torque = (np.ascontiguousarray(values[kept]) for values in (*motion, tau))
    return Segment(
        name=recording.name, place=place, rate_hz=recording.rate_hz, q=q, dq=dq, ddq=ddq, tau=torque
    )


def linear_system(
    robot: Robot, parts: Sequence[Segment], signal: SignalProcessing, selection: Selection
) -> LinearSystem:
    """Build (7) of several segments, with the fixed parameters moved to the left side.

    Parameters
    ----------
    robot : Robot
        Gives the base columns of the regressor (2).
    parts : sequence of Segment
        At least one.
    signal : SignalProcessing
        Decimation.
    selection : Selection
        Fixed and dropped parameters.

    Returns
    -------
    LinearSystem
        Columns of the estimated parameters only.

    Raises
    ------
    SignalError
        When the decimation cannot be applied; the message names recording and window.
    FitError
        When numbers are too large for floating point.

    Notes
    -----
    ``test_identify.py`` checks the order of the rows and that noise-free recordings give the parameters back.
    """
    columns = list(robot.base_parameters.indices)
    n_dof = robot.n_dof
    w_parts, y_parts = [], []
    for part in parts:
        with told(part.place):
            stages = signals.decimation_stages(part.q.shape[0], signal)
            w = _observation(robot, part, columns, stages)
            y = signals.decimate(part.tau, stages)[signal.kept_rows].T
        if y.shape[1] == 0:
            raise FitError(f"{part.place}: decimation leaves nothing of {counted(part.q.shape[0], 'sample')}")
        y_parts.append(y)
        w_parts.append(w.reshape(n_dof, -1, len(columns))[:, signal.kept_rows])
    rows = sum(y.shape[1] for y in y_parts)
    w_all = np.concatenate(w_parts, axis=1).reshape(n_dof * rows, len(columns))
    y_all = np.concatenate(y_parts, axis=1).reshape(n_dof * rows)
    estimated = selection.estimated
    known = None
    if len(estimated) < len(columns):
        with np.errstate(over="ignore", invalid="ignore"):  # told below
            known = w_all @ selection.values
            y_all = y_all - known
        if not np.isfinite(y_all).all():
            raise FitError(
                "the torques of the fixed parameters are too large for floating point; check their values"
            )
        w_all = w_all[:, estimated]
    return LinearSystem(
        w=np.ascontiguousarray(w_all),
        y=np.ascontiguousarray(y_all),
        joints=tuple(slice(joint * rows, (joint + 1) * rows) for joint in range(n_dof)),
        names=tuple(robot.base_parameters.names[index] for index in estimated),
        known=known,
        windows=tuple(y.shape[1] for y in y_parts),
    )


def _observation(robot: Robot, part: Segment, columns: Sequence[int], stages: Sequence[Stage]) -> Array:
    """Build the observation matrix (6) of one segment: (n_dof * n_kept, n_columns), rows joint by joint.

    Raises
    ------
    FitError
        When the core refuses the segment, or a number is too large for floating point.
    """
    try:
        w = np.asarray(_core.observation(robot.core, part.q, part.dq, part.ddq, list(columns), list(stages)))
    except ValueError as reason:
        raise FitError(str(reason)) from None
    if not np.isfinite(w).all():
        raise FitError(
            "positions, velocities or accelerations are too large for floating point; check their unit"
        )
    return w


@contextmanager
def told(place: str) -> Iterator[None]:
    """Open the message of an error with the recording and window that it is about."""
    try:
        yield
    except (SignalError, FitError) as error:
        raise type(error)(f"{place}: {error}") from None
