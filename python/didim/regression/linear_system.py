"""From recordings to the linear system (6), (7): rows joint by joint, windows one after the other.

Each window of a recording is filtered by itself, so that nothing outside it (a stop, a tool change) leaks in.
Y and every column of W go through the same decimation filter, which keeps the linear relation between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import FitError
from ..robot.robot import Robot
from ..signal.decimation import Stage, decimate, decimation_stages
from ..signal.processing import SignalProcessing
from ..signal.segments import Segment, at_place
from .selection import Selection


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
        with at_place(part.place):
            stages = decimation_stages(part.q.shape[0], signal)
            w = _observation(robot, part, columns, stages)
            y = decimate(part.tau, stages)[signal.kept_rows].T
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
        with np.errstate(over="ignore", invalid="ignore"):  # at_place below
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


@dataclass(frozen=True, kw_only=True)
class LinearSystem:
    """The system (7): rows joint by joint, a column per parameter to estimate.

    Parameters
    ----------
    w : ndarray, shape (r, b)
        Observation matrix.
    y : ndarray, shape (r,)
        Measured torques, N.m or N, joint side.
    joints : tuple of slice
        Rows of each joint.
    names : tuple of str
        Names of the columns.
    known : ndarray, shape (r,), optional
        Torques of the parameters that are fixed, already taken out of ``y``.
    windows : tuple of int
        Rows of each window within a joint's; one window by default.
    """

    w: Array
    y: Array
    joints: tuple[slice, ...]
    names: tuple[str, ...]
    known: Array | None = None
    windows: tuple[int, ...] = ()

    @property
    def measured(self) -> Array:
        """Measured torques, shape (r,): those of fixed parameters included."""
        return self.y if self.known is None else self.y + self.known

    def norms(self, rows: Array) -> Array:
        """2-norm of each joint's part of a vector of r rows, shape (n_dof,)."""
        return np.array([np.linalg.norm(rows[joint]) for joint in self.joints])


def check_size(system: LinearSystem) -> None:
    """Refuse torques and columns whose sum of squares no floating-point number holds.

    Raises
    ------
    FitError
        Naming the joint or the parameter (``test_least_squares.py``).
    """
    with np.errstate(over="ignore", invalid="ignore"):
        torques, columns = system.norms(system.measured), np.linalg.norm(system.w, axis=0)
        rest = system.norms(system.y)
    cure = "check their unit, the drive gain and the values of fixed parameters"
    for joint, rows in enumerate(system.joints):
        if not np.isfinite(torques[joint] + rest[joint]):
            raise FitError(f"the torques of joint {joint + 1} are too large to be squared; {cure}")
        if torques[joint] == 0.0 and system.measured[rows].any():
            raise FitError(f"the torques of joint {joint + 1} are too small to be squared; {cure}")
    for column in np.flatnonzero(~np.isfinite(columns)):
        name = system.names[column]
        raise FitError(f"the column of {name} is too large to be squared; check the unit of the positions")
