"""Conditions for standard parameters to belong to a robot: positive pseudo-inertias, rotors and friction.

A condition is a `Cone`, ``F(x) = K + sum_i x_i B_i >= 0`` with small symmetric matrices. That of a link is its pseudo-inertia (12),
4 x 4 (Wensing, Kim, Slotine 2017; Traversaro 2016); those of the drives are in ``drive_cones.py``.
Tested in ``tests/test_consistent.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..robot.rigid_body import INERTIAL, pseudo_inertia
from ..robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Cone:
    """One condition ``F(x) = K + sum_i x_i B_i >= 0`` on the standard parameters.

    Attributes
    ----------
    label : str
        Subject of the condition, such as "link 3", "Ia4" or "Fv5-6".
    indices : tuple of int
        Standard parameters that it depends on, k of them.
    basis : (k, m, m) array
        ``B_i``, symmetric.
    constant : (m, m) array
        ``K``.
    weight : float
        Weight (nats) of the term ``-log det F + tr(Q F)``; 0 for a plain condition.
    slope : (m, m) array or None
        ``Q``.
    """

    label: str
    indices: tuple[int, ...]
    basis: Array
    constant: Array
    weight: float = 0.0
    slope: Array | None = None

    def at(self, x: Array) -> Array:
        """Return ``F(x)``, (m, m)."""
        return np.asarray(self.constant + np.tensordot(x[list(self.indices)], self.basis, 1))


def places_of(robot: Robot) -> dict[str, int]:
    """Return the index of each standard parameter by name."""
    return {name: index for index, name in enumerate(robot.parameter_names)}


def cone(
    robot_places: Mapping[str, int],
    label: str,
    terms: Mapping[str, Array | float],
    constant: Array | float = 0.0,
) -> Cone:
    """Return the condition given by a matrix, or a number, per parameter name."""
    matrices = {name: np.atleast_2d(np.asarray(term, dtype=np.float64)) for name, term in terms.items()}
    matrices = {name: matrix for name, matrix in matrices.items() if matrix.any()}
    order = len(next(iter(matrices.values())))
    return Cone(
        label,
        tuple(robot_places[name] for name in matrices),
        np.array(list(matrices.values())),
        np.broadcast_to(np.asarray(constant, dtype=np.float64), (order, order)).copy(),
    )


def link_cones(robot: Robot) -> list[Cone]:
    """Return the condition (12) of every link: its pseudo-inertia about its frame."""
    places = places_of(robot)
    basis = np.array([pseudo_inertia(unit) for unit in np.eye(len(INERTIAL))])
    return [
        Cone(f"link {j}", tuple(places[f"{name}{j}"] for name in INERTIAL), basis, np.zeros((4, 4)))
        for j in range(1, robot.n_joints + 1)
    ]


def pseudo_inertias(robot: Robot, x: Array) -> list[Array]:
    """Return the pseudo-inertia of every link about its frame, (4, 4) each."""
    places = places_of(robot)
    return [
        pseudo_inertia(np.array([x[places[f"{name}{j}"]] for name in INERTIAL]))
        for j in range(1, robot.n_joints + 1)
    ]
