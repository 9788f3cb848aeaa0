"""Rows of the linear system (7): joint by joint, and within a joint window by window of the recordings.

Weights, the variance (9), the covariance of decimated noise, the jackknife over windows, and parameters of single logs only
depend on blocks, the rows of one joint in one window. Tested in ``tests/test_identify.py`` and ``tests/test_solver.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array, ratio
from .._tools.words import counted
from ..errors import FitError
from ..robot.placement import joined

Rows = NDArray[np.intp]
"""Numbers of rows of a system."""


@dataclass(frozen=True)
class Block:
    """Rows of one joint in one window.

    Attributes
    ----------
    rows : slice
        Rows of the system, in the order of time.
    joint : int
        Joint, from 0.
    recording : int
        Recording, from 0, among those of the experiment.
    window : int
        Window of the recording, from 0.
    rate_hz : float
        Rate of the rows, after decimation.
    correlation : (n_lags,) array or None
        Autocorrelation on these rows of white noise in the log, from lag 0 (1) on; None if it stays white.
    """

    rows: slice
    joint: int
    recording: int = 0
    window: int = 0
    rate_hz: float = 1.0
    correlation: Array | None = field(default=None, compare=False, repr=False)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return len(self.numbers)

    @property
    def numbers(self) -> Rows:
        """Numbers of the rows in the system."""
        return np.arange(self.rows.start, self.rows.stop, self.rows.step or 1)


def stacked(
    n_joints: int,
    lengths: Sequence[int],
    *,
    places: Sequence[tuple[int, int]] | None = None,
    rates_hz: Sequence[float] | None = None,
    correlation: Array | None = None,
) -> tuple[Block, ...]:
    """Return the blocks of rows in the order of joints and, within a joint, of windows.

    Parameters
    ----------
    n_joints : int
        Number of joints.
    lengths : sequence of int
        Rows of each window, for each joint the same.
    places : sequence of (int, int), optional
        Recording and window of each; by default windows of one recording.
    rates_hz : sequence of float, optional
        Rate of each; 1 Hz by default.
    correlation : (n_lags,) array, optional
        See `Block`.
    """
    places = [(0, window) for window in range(len(lengths))] if places is None else places
    rates = [1.0] * len(lengths) if rates_hz is None else rates_hz
    blocks, start = [], 0
    for joint in range(n_joints):
        for length, (recording, window), rate in zip(lengths, places, rates, strict=True):
            rows = slice(start, start + length)
            blocks.append(Block(rows, joint, recording, window, rate, correlation))
            start += length
    return tuple(blocks)


def by_joint(blocks: Iterable[Block]) -> list[list[Block]]:
    """Return the blocks of each joint."""
    return _grouped(blocks, lambda block: block.joint)


def by_window(blocks: Iterable[Block]) -> list[list[Block]]:
    """Return the blocks of each window of each recording, which a jackknife leaves out together."""
    return _grouped(blocks, lambda block: (block.recording, block.window))


def _grouped(blocks: Iterable[Block], key: Callable[[Block], Any]) -> list[list[Block]]:
    return [list(group) for _, group in groupby(sorted(blocks, key=key), key)]


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

    def with_velocities(self, solution: Array) -> LinearSystem:
        """Return the system with a further column for the estimated velocity of each law, of the name of its parameter.

        The velocities were estimated too. With their columns in the system, the variances of the parameters include the
        uncertainty of the velocities. A law with a parameter of zero has no column.
        """
        if not self.slopes:
            return self
        values = {name: float(solution[self.names.index(name)]) for name in self.slopes}
        columns = {name: values[name] * slope for name, slope in self.slopes.items()}
        columns = {name: column for name, column in columns.items() if column.any()}
        return replace(self, w=np.column_stack([self.w, *columns.values()]), names=(*self.names, *columns))

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
