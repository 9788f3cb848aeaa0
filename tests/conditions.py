"""The conditions of physics in their own units, and those that parameters do not meet: a check that needs no solver."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from didim import Robot
from didim.model.consistency import Cone, link_cones
from didim.model.drive_cones import Drives, friction_cones, rotor_cones
from didim.regression.consistent.problem import ConstrainedProblem

Array = NDArray[np.float64]

EIGENVALUE_ROUNDING = 1e-9
"""Largest negative eigenvalue of a physical condition that rounding explains, as a share of the size of its terms."""


def smallest_of(condition: Cone, x: Array) -> float:
    """Return the smallest eigenvalue of a condition, as a share of the size of its terms."""
    terms = np.abs(x[list(condition.indices)])[:, None, None] * np.abs(condition.basis)
    size = np.abs(condition.constant).max() + np.max(terms, initial=0.0)
    return float(np.linalg.eigvalsh(condition.at(x))[0] / size) if size > 0.0 else 0.0


def drive_cones(robot: Robot) -> list[Cone]:
    """The conditions on rotors and friction: (13), and (14) for any coupled joints."""
    drives = Drives(robot)
    return [*rotor_cones(drives), *friction_cones(drives)]


def conditions_of(robot: Robot) -> list[Cone]:
    """The conditions on links, rotors and friction."""
    return [*link_cones(robot), *drive_cones(robot)]


def violations(conditions: Sequence[Cone], x: Array, tolerance: float = EIGENVALUE_ROUNDING) -> list[str]:
    """List the violated conditions, with the smallest eigenvalue of each.

    Parameters
    ----------
    conditions : sequence of Cone
        Conditions such as ``[*link_cones(robot), *drive_cones(robot)]``.
    x : (p,) array
        Standard parameters.
    tolerance : float
        Negative eigenvalue that counts as rounding, as a share of the size of the terms.

    Returns
    -------
    list of str
        Empty for a robot that can exist.
    """
    found = []
    for condition in conditions:
        if not smallest_of(condition, x) >= -tolerance:
            smallest = float(np.linalg.eigvalsh(condition.at(x))[0])
            found.append(f"{condition.label} (smallest eigenvalue {smallest:.3g})")
    return found


def multipliers(problem: ConstrainedProblem, rows: Array, right: Array) -> list[Array]:
    """Return ``Z`` of each condition at the solution, (m, m): ``F Z = weight I``; an empty array of one without unknowns."""
    found = problem._solved(rows, right[None], 1).multipliers(0)
    orders = [len(condition.constant) for condition in problem.conditions]
    return [
        np.reshape(values, (order, order) if values else 0)
        for values, order in zip(found, orders, strict=True)
    ]
