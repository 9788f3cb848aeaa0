"""Length of a step towards a target for which the parameters still belong to a robot.

Tested in ``tests/test_identities.py``, ``tests/test_didim.py`` and ``tests/test_cloe.py``.
"""

from __future__ import annotations

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from ..robot.robot import Robot

POSITIVE = 1e-3
"""Share of M(q) that a full step must preserve: the inertia of a start such as (17) may be a hundred times too large."""
SMALLEST_INERTIA_SHARE = 0.1
"""Share of M(q) that a shortened step preserves."""


def safe_step(
    robot: Robot, q: Array, x: Array, target: Array, margin: float = SMALLEST_INERTIA_SHARE
) -> float:
    """Return the share of the step to a target for which M(q) stays positive definite.

    Parameters
    ----------
    robot : Robot
        Robot with its geometry.
    q : (n, n_dof) array
        Positions at which M(q) is evaluated (rad or m).
    x, target : (n_parameters,) arrays
        Standard parameters at the two ends of the step.
    margin : float
        A step that must be shortened keeps at least this share of M(q) at `x`, at every position.

    Returns
    -------
    float
        Share of the step; 1 if M(q) at the target has at least the share ``POSITIVE`` of that at `x`.
    """
    if _core.largest_safe_step(robot.core, q, x, target, POSITIVE) == 1.0:
        return 1.0
    return float(_core.largest_safe_step(robot.core, q, x, target, margin))


def thinned(q: Array, most: int) -> Array:
    """Return evenly spaced positions: at least `most` if there are so many, and fewer than twice as many."""
    return np.ascontiguousarray(q[:: max(1, len(q) // most)])
