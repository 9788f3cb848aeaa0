"""What only some recordings have: payloads, own offsets and friction, and drive gains.

    beta_l = beta + B (v_l + V_l theta)          base parameters of log l
    Y_l = W_l beta_l + rho_l

``V_l`` has a column for each unknown of log l's payload, and for each of its own offsets and friction coefficients; ``v_l`` is
the known part of its payload; ``B`` is the matrix of the base parameters. The columns are thus combinations of those of W,
along measured or simulated motion. Tested in ``tests/test_logs.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .._tools.arrays import Array
from ..robot.payload import UNITS, Payload
from ..robot.robot import Robot
from ..signal.window import Window
from .base import At
from .unknown import Unknown

Kind = Literal["payload", "offset", "friction", "gain"]
DEPENDENT_COLUMN = 1e-9
"""Norm of a unit column's component orthogonal to the others below which it depends on them: rounding."""


@dataclass(frozen=True)
class ColumnBlock:
    """Description of the unknowns that only some recordings have.

    Attributes
    ----------
    kind : {"payload", "offset", "friction", "gain"}
        Kind of the parameters.
    owner : str
        Their payload or recording; empty for gains.
    names, units : tuple of str
        Names and units of the parameters, without their owner: ``MX``, ``Off3``, ``K1``.
    complete : bool
        Whether they are all unknowns of their owner. A planar arm does not identify all ten of a payload; its pseudo-inertia is
        then unknown and unconstrained.
    """

    kind: Kind
    owner: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    complete: bool = True

    @property
    def full_names(self) -> tuple[str, ...]:
        """Names of the columns, prefixed by the owner: ``disc.MX``."""
        return tuple(f"{self.owner}.{name}" if self.owner else name for name in self.names)


@dataclass(frozen=True, eq=False)
class Share:
    """The term of standard parameters that some recordings have beside those of the robot.

    Attributes
    ----------
    block : ColumnBlock
        Its unknowns, k of them; none where all is known.
    recordings : tuple of int
        Recordings that have it; none for drive gains, whose columns follow from the solution.
    directions : (p, k) array
        Standard parameters of the robot by each unknown.
    fixed : (p,) array or None
        Standard parameters of the known part.
    """

    block: ColumnBlock
    recordings: tuple[int, ...]
    directions: Array
    fixed: Array | None = None

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Unknowns, SI units, joint side; gains in torque per ampere."""
        names = zip(self.block.full_names, self.block.units, strict=True)
        return tuple(Unknown(name=name, unit=unit) for name, unit in names)

    def columns(self, window: Window, at: At) -> Array:
        """Return the columns of the unknowns in a window, (n_dof, n_rows, k): zero in recordings of others."""
        if window.recording not in self.recordings:
            return np.zeros((*at.kernel(window).shape[:2], len(self.block.names)))
        return at.combined(window, self.directions)

    def known(self, window: Window, at: At) -> Array | float:
        """Return the torque of the known part in a window, (n_dof, n_rows): zero in recordings of others."""
        if self.fixed is None or window.recording not in self.recordings:
            return 0.0
        return at.combined(window, self.fixed)

    def standard(self, values: Array, recording: int) -> Array | float:
        """Return what unknowns, (..., k), add to the standard parameters of the robot in a recording, (..., p)."""
        if recording not in self.recordings:
            return 0.0
        added = values @ self.directions.T
        return added if self.fixed is None else added + self.fixed

    def for_parameters(self, names: Sequence[str], others: Sequence[str]) -> Share:
        """Return the share of standard parameters `names` for a robot that has `others`: zero for those that are new."""
        matrix = np.array([[float(name == other) for name in names] for other in others])
        fixed = None if self.fixed is None else matrix @ self.fixed
        return replace(self, directions=matrix @ self.directions, fixed=fixed)


def payload_share(
    robot: Robot, payload: Payload, recordings: Sequence[int], transform: Array
) -> Share | None:
    """Return the term of a payload: its known part, and its unknowns as far as the robot shows and separates them.

    None where it has neither. `transform` has the standard parameters of the robot by each of the payload's ten, (p, 10).
    """
    known, columns, names = payload.split
    fixed = transform @ known if known.any() else None
    by_body = [transform @ column for column in columns.T]
    # A planar arm does not identify or separate some of the ten.
    chosen = independent([robot.base_parameters.matrix @ column for column in by_body])
    if fixed is None and not chosen:
        return None
    own = tuple(names[index] for index in chosen)
    units = tuple(UNITS[name] for name in own)
    block = ColumnBlock("payload", payload.name, own, units, len(chosen) == len(names))
    directions = np.stack([by_body[index] for index in chosen], axis=1) if chosen else transform[:, :0]
    return Share(block, tuple(recordings), directions, fixed)


def independent(vectors: Sequence[Array]) -> list[int]:
    """Return the vectors that are independent of the preceding ones."""
    basis: list[Array] = []
    chosen = []
    for index, vector in enumerate(vectors):
        size = np.linalg.norm(vector)
        if not size > 0.0:
            continue
        rest = vector / size
        for _ in range(2):  # repeated because of rounding
            for other in basis:
                rest = rest - other * (other @ rest)
        left = np.linalg.norm(rest)
        if left > DEPENDENT_COLUMN:
            basis.append(rest / left)
            chosen.append(index)
    return chosen
