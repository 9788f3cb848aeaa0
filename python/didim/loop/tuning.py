"""The inertia along a reference, which tuned gains and gain updating need. Tested in ``tests/test_closed_loop.py``."""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array
from ..model.dynamics import inertia_matrix
from ..robot.robot import Robot
from .reference import Reference


def mean_inertia(robot: Robot, x: Array, reference: Reference) -> Array:
    """Mean of ``diag M(q)`` along a reference, (n_dof,): the representative inertia ``J`` of gain updating (findings, 6)."""
    q, _, _ = reference.at(np.linspace(0.0, reference.duration, 1001))
    return np.asarray(np.diagonal(inertia_matrix(robot, q, x), axis1=1, axis2=2).mean(axis=0))
