"""The linear system (6), (7) of recordings: rows joint by joint, windows one after the other.

Each window of a recording is filtered separately, so samples outside it (a stop, a tool change) have no influence. Y and every
column of W pass the same decimation filter, which preserves the linear relation between them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

import didim._core as _core

from .._tools.arrays import Array, ratio
from .._tools.threads import core_threads
from .._tools.words import counted
from ..errors import CoreErrorsAs, FitError
from ..model.dynamics import rigid_torque
from ..model.memory import memory_columns
from ..robot.placement import joined
from ..robot.robot import Robot
from ..signal.decimation import Stage, decimate, decimation_stages, row_values
from ..signal.noise import noise_correlation
from ..signal.processing import SignalProcessing
from ..signal.window import Window, at_place
from .block import Block, by_joint, stacked
from .logs.parameters import LogParameters
from .selection import Selection


def linear_system(
    robot: Robot,
    parts: Sequence[Window],
    signal: SignalProcessing,
    selection: Selection,
    beta: Array | None = None,
    logs: LogParameters | None = None,
) -> LinearSystem:
    """Build (7) of several segments, with the fixed parameters moved to the left side.

    Parameters
    ----------
    robot : Robot
        Robot with the base columns of the regressor (2).
    parts : sequence of Window
        At least one.
    signal : SignalProcessing
        Decimation.
    selection : Selection
        Fixed and dropped parameters.
    beta : ndarray, shape (n_base,), optional
        Base parameters for the torque of links and rotors in the columns of load friction, which is zero without them.
    logs : LogParameters, optional
        Further parameters of some recordings, whose columns follow the base columns; `selection` then covers all of them.

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
    ``test_identify.py`` checks the order of the rows, and recovers the parameters from noise-free recordings.
    """
    columns = list(robot.base_parameters.indices)
    n_dof = robot.n_dof
    w_parts, y_parts, payload_parts = [], [], []
    for part in parts:
        with at_place(part.place):
            stages = decimation_stages(part.q.shape[0], signal)
            w = observation(robot, part, columns, stages, beta)
        y_parts.append(_torques(part, signal))
        w = w.reshape(n_dof, -1, len(columns))[:, signal.kept_rows]
        if logs is not None and not logs.simple:
            payload_parts.append(w @ logs.base_known(part.recording))
            w = np.concatenate([w, w @ logs.base_columns(part.recording)], axis=2)
        w_parts.append(w)
    rows = sum(y.shape[1] for y in y_parts)
    names = robot.base_parameters.names if logs is None else logs.names
    # The core's columns are contiguous, those of the system are not: one copy joins and transposes them.
    w_all = np.concatenate(w_parts, axis=1, out=np.empty((n_dof, rows, len(names))))
    w_all = w_all.reshape(n_dof * rows, len(names))
    y_all = np.concatenate(y_parts, axis=1).reshape(n_dof * rows)
    estimated = selection.estimated
    known = None
    if len(estimated) < len(names) or payload_parts:
        with np.errstate(over="ignore", invalid="ignore"):  # reported below
            known = w_all @ selection.values
            if payload_parts:
                known = known + np.concatenate(payload_parts, axis=1).reshape(-1)
            y_all = y_all - known
        if not np.isfinite(y_all).all():
            raise FitError(
                "the torques of the fixed parameters are too large for floating point; check their values"
            )
        w_all = w_all[:, estimated]
    return LinearSystem(
        w=np.ascontiguousarray(w_all),
        y=np.ascontiguousarray(y_all),
        blocks=stacked(
            n_dof,
            [y.shape[1] for y in y_parts],
            places=[(part.recording, part.number) for part in parts],
            rates_hz=[part.rate_hz / math.prod(signal.decimation) for part in parts],
            correlation=noise_correlation(signal),
        ),
        names=tuple(names[index] for index in estimated),
        known=known,
    )


def torque_rows(parts: Sequence[Window], signal: SignalProcessing) -> Array:
    """Return the torques of segments in the rows of (7), (r,), including those of known parameters."""
    return np.concatenate([_torques(part, signal) for part in parts], axis=1).reshape(-1)


def _torques(part: Window, signal: SignalProcessing) -> Array:
    """Return the decimated torques of a segment, (n_dof, n_kept)."""
    with at_place(part.place):
        y = row_values(part.tau, signal).T
    if y.shape[1] == 0:
        raise FitError(f"{part.place}: decimation leaves nothing of {counted(part.q.shape[0], 'sample')}")
    return y


def observation(
    robot: Robot,
    part: Window,
    columns: Sequence[int],
    stages: Sequence[Stage],
    beta: Array | None = None,
) -> Array:
    """Build the observation matrix (6) of one segment: (n_dof * n_kept, n_columns), rows joint by joint.

    Raises
    ------
    FitError
        When the core refuses the segment, or a number is too large for floating point.
    """
    load = None
    columns = list(columns)
    if robot.friction.has_load:
        x = robot.base_parameters.lift(np.zeros(len(robot.base_parameters.names)) if beta is None else beta)
        load = rigid_torque(robot, part.q, part.dq, part.ddq, x)
    with CoreErrorsAs(FitError):
        w = np.asarray(
            _core.observation(
                robot.core, part.q, part.dq, part.ddq, columns, list(stages), core_threads(), load=load
            )
        )
    for name, joint, column in memory_columns(robot, part.q, part.dq, load, part.temperature):
        index = robot.parameter_names.index(name)
        if index in columns:
            rows = len(w) // robot.n_dof
            w[joint * rows : (joint + 1) * rows, columns.index(index)] += decimate(column[:, None], stages)[
                :, 0
            ]
    if not np.isfinite(w).all():
        raise FitError(
            "positions, velocities or accelerations are too large for floating point; check their unit"
        )
    return w


@dataclass(frozen=True, kw_only=True)
class LinearSystem:
    """The system (7): rows joint by joint, a column per estimated parameter.

    Parameters
    ----------
    w : ndarray, shape (r, b)
        Observation matrix.
    y : ndarray, shape (r,)
        Measured torques, N.m or N, joint side.
    blocks : tuple of Block
        Rows of each joint in each window; they cover all rows, joint by joint.
    names : tuple of str
        Names of the columns.
    known : ndarray, shape (r,), optional
        Torques of the fixed parameters, already subtracted from ``y``.
    slopes : mapping of str to ndarray, shape (r,)
        By the name of a column of a friction law: the derivative of the column by the law's estimated velocity.
    alternatives : tuple of (str, ndarray of shape (r,))
        Name of a column of a friction law, and a column that fits as well in its place, zero for none.
    instruments : ndarray, shape (r, b), optional
        Observation matrix of the same rows and columns along another motion, with noise independent of ``w``.
    """

    w: Array
    y: Array
    blocks: tuple[Block, ...]
    names: tuple[str, ...]
    known: Array | None = None
    slopes: Mapping[str, Array] = field(default_factory=dict)
    alternatives: tuple[tuple[str, Array], ...] = ()
    instruments: Array | None = None

    @cached_property
    def joint_blocks(self) -> tuple[tuple[Block, ...], ...]:
        """Blocks of each joint."""
        return tuple(tuple(blocks) for blocks in by_joint(self.blocks))

    @cached_property
    def joints(self) -> tuple[slice, ...]:
        """Rows of each joint."""
        return tuple(slice(blocks[0].rows.start, blocks[-1].rows.stop) for blocks in self.joint_blocks)

    @property
    def counts(self) -> NDArray[np.intp]:
        """Number of rows of each joint, (n_dof,)."""
        return np.array([rows.stop - rows.start for rows in self.joints], dtype=np.intp)

    @cached_property
    def joint_columns(self) -> tuple[NDArray[np.intp], ...]:
        """Columns with nonzero entries in the rows of each joint: those of its subtree, drives and logs."""
        return tuple(np.flatnonzero(self.w[rows].any(axis=0)) for rows in self.joints)

    @cached_property
    def parts(self) -> tuple[tuple[NDArray[np.intp], NDArray[np.intp]], ...]:
        """Independent groups of rows and columns, such as those of the legs of one trunk, which are solved separately.

        An empty column belongs to the first group, whose solution reports it.
        """
        groups = independent(self.joint_columns)
        empty = np.setdiff1d(np.arange(len(self.names)), np.concatenate([own for _, own in groups]))
        rows = [np.arange(part.start, part.stop) for part in self.joints]
        return tuple(
            (
                np.concatenate([rows[joint] for joint in joints]),
                own if number else np.sort(np.concatenate([own, empty])),
            )
            for number, (joints, own) in enumerate(groups)
        )

    @cached_property
    def matrices(self) -> tuple[Array, ...]:
        """W of each of `parts`; that of a single part is all of W, and is not copied."""
        if len(self.parts) == 1:
            return (self.w,)
        return tuple(self.w[np.ix_(rows, columns)] for rows, columns in self.parts)

    def residual(self, beta: Array) -> Array:
        """Return ``Y - W beta``, (r,)."""
        residual = self.y.copy()
        for (rows, columns), w in zip(self.parts, self.matrices, strict=True):
            residual[rows] -= w @ beta[columns]
        return residual

    @property
    def measured(self) -> Array:
        """Measured torques, shape (r,), including those of fixed parameters."""
        return self.y if self.known is None else self.y + self.known

    def norms(self, rows: Array) -> Array:
        """2-norm of each joint's part of a vector of r rows, shape (n_dof,)."""
        return np.array([np.linalg.norm(rows[joint]) for joint in self.joints])

    def relative_error(self, residual: Array) -> float:
        """Norm of an error, (r,), over that of the measured torques, by the norms of the joints as a result has them."""
        error, torque = (float(np.linalg.norm(self.norms(rows))) for rows in (residual, self.measured))
        return ratio(error, torque)

    def part(self, blocks: Sequence[Block]) -> LinearSystem:
        """Return the system of some of the blocks, such as all windows but one, with renumbered rows."""
        blocks = [block for joint in by_joint(blocks) for block in joint]
        rows = np.concatenate([block.numbers for block in blocks])
        ends = np.cumsum([0, *(block.n_rows for block in blocks)]).tolist()
        return replace(
            self,
            w=np.ascontiguousarray(self.w[rows]),
            y=self.y[rows],
            known=None if self.known is None else self.known[rows],
            slopes={name: column[rows] for name, column in self.slopes.items()},
            alternatives=tuple((name, column[rows]) for name, column in self.alternatives),
            instruments=None if self.instruments is None else self.instruments[rows],
            blocks=tuple(
                replace(block, rows=slice(start, stop))
                for block, start, stop in zip(blocks, ends[:-1], ends[1:], strict=True)
            ),
        )


def unit_columns(a: Array) -> tuple[Array, Array]:
    """Return the columns of a matrix (r, b) with norm 1, and their norms, (b,); a column of zeros stays, with norm 1."""
    size = np.linalg.norm(a, axis=0)
    size[size == 0.0] = 1.0
    return a / size, size


def check_size(system: LinearSystem) -> None:
    """Refuse torques and columns whose sum of squares overflows.

    Raises
    ------
    FitError
        Naming the joint or the parameter (``test_least_squares.py``).
    """
    with np.errstate(over="ignore", invalid="ignore"):
        torques, columns = system.norms(system.measured), np.sqrt(np.einsum("rb,rb->b", system.w, system.w))
        rest = system.norms(system.y)
    for joint, rows in enumerate(system.joints):
        check_squares(joint, torques[joint] + rest[joint], torques[joint], measured=system.measured[rows])
    for column in np.flatnonzero(~np.isfinite(columns)):
        name = system.names[column]
        raise FitError(f"the column of {name} is too large to be squared; check the unit of the positions")


def check_squares(joint: int, largest: float, size: float, *, measured: Array) -> None:
    """Refuse torques of a joint (from 0) whose norm `largest` or `size` overflows.

    Raises
    ------
    FitError
        Naming the joint (``test_least_squares.py``, ``test_cli.py``).
    """
    cure = "check their unit, the drive gain and the values of fixed parameters"
    if not np.isfinite(largest):
        raise FitError(f"the torques of joint {joint + 1} are too large to be squared; {cure}")
    if size == 0.0 and measured.any():
        raise FitError(f"the torques of joint {joint + 1} are too small to be squared; {cure}")


def check_solvable(system: LinearSystem) -> None:
    """Refuse a system without columns, with too few rows, or with squares that overflow.

    Raises
    ------
    FitError
        The sentence gives the remedy.
    """
    rows, columns = system.w.shape
    if columns == 0:
        raise FitError("no parameter is left to estimate: all are fixed or dropped")
    if rows <= columns:
        raise FitError(
            f"{counted(rows, 'row')} cannot determine {counted(columns, 'parameter')}; "
            "use a longer record or window, or decimate less"
        )
    check_size(system)


def independent(
    joint_columns: Sequence[NDArray[np.intp]],
) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return groups of joints and of columns, (k,) each, that share none, by the columns of each joint; in the order of joints."""
    own = [set(columns.tolist()) for columns in joint_columns]
    shared = [(a, b) for a, b in combinations(range(len(own)), 2) if own[a] & own[b]]
    return [
        (np.array(joints), np.array(sorted(set().union(*(own[k] for k in joints))), dtype=np.intp))
        for joints in joined(len(own), shared)
    ]
