"""Partial derivatives of the inverse dynamic model. Tested in ``tests/test_maximum_likelihood.py``."""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array
from ..model.dynamics import inertia_matrix, inverse_dynamics
from ..robot.robot import Robot

CENTRAL_DIFFERENCE = 1e-6
"""Step of the central differences (rad or m, rad/s or m/s): small beside the width over which smooth friction changes its sign."""


def torque_partials(robot: Robot, q: Array, dq: Array, ddq: Array, x: Array) -> tuple[Array, Array, Array]:
    """Differentiate the inverse dynamic model by positions, velocities and accelerations, by central differences.

    Parameters
    ----------
    robot : Robot
        Robot, friction included. The finite difference is large where a sign jumps.
    q, dq, ddq : ndarray, shape (n_samples, n_dof)
        Motion, SI units.
    x : ndarray, shape (n_parameters,)
        Standard parameters.

    Returns
    -------
    by_q, by_dq, by_ddq : ndarray, shape (n_samples, n_dof, n_dof)
        Row i, column j: torque of joint i by the variable of joint j. The last is ``M(q)``.
    """
    n_dof = q.shape[1]
    by_q, by_dq = np.empty((len(q), n_dof, n_dof)), np.empty((len(q), n_dof, n_dof))
    for joint in range(n_dof):
        step = np.zeros(n_dof)
        step[joint] = CENTRAL_DIFFERENCE
        ahead, behind = (inverse_dynamics(robot, q + move, dq, ddq, x) for move in (step, -step))
        by_q[:, :, joint] = (ahead - behind) / (2.0 * CENTRAL_DIFFERENCE)
        ahead, behind = (inverse_dynamics(robot, q, dq + move, ddq, x) for move in (step, -step))
        by_dq[:, :, joint] = (ahead - behind) / (2.0 * CENTRAL_DIFFERENCE)
    return by_q, by_dq, np.asarray(inertia_matrix(robot, q, x))
