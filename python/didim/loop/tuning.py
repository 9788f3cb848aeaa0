"""Mean inertia along a reference, for tuned gains and gain updating. Tested in ``tests/test_closed_loop.py``."""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array
from ..model.dynamics import inertia_matrix
from ..robot.robot import Robot
from .controller import Controller
from .reference import Reference

DAMPING = 1.4
"""Velocity gain divided by the root of position gain times inertia: twice a damping ratio of 0.7."""


def mean_inertia(robot: Robot, x: Array, reference: Reference) -> Array:
    """Mean of ``diag M(q)`` along a reference, (n_dof,): the representative inertia ``J`` of gain updating."""
    return mean_diagonal(robot, x, reference.at(np.linspace(0.0, reference.duration, 1001))[0])


def mean_diagonal(robot: Robot, x: Array, q: Array) -> Array:
    """Mean of ``diag M(q)`` over positions (n, n_dof), (n_dof,)."""
    return np.asarray(np.diagonal(inertia_matrix(robot, q, x), axis1=1, axis2=2).mean(axis=0))


def largest_coulomb(robot: Robot, x: Array) -> Array:
    """Largest Coulomb friction of each joint, (n_dof,) (N.m or N): it may differ by direction."""
    coulomb = np.zeros(robot.n_dof)
    for parameter, value in zip(robot.standard_parameters, x, strict=True):
        if parameter.kind == "Fc":
            coulomb[parameter.joint] = max(coulomb[parameter.joint], abs(float(value)))
    return coulomb


def made_up(
    robot: Robot, x: Array, q: Array, *, frequency_hz: float = 10.0, error: float = 1e-3
) -> Controller:
    """Return gains for a robot with an unknown controller, by rule (D).

        kp_j = max( J_j (2 pi f)^2, Fc_j / error ),    kv_j = 1.4 sqrt(kp_j J_j)

    The robot then follows the measured motion closely, without stick-slip.

    Parameters
    ----------
    robot : Robot
        The robot.
    x : (n_parameters,) array
        Standard parameters, such as a consistent estimate.
    q : (n, n_dof) array
        Positions, over which ``J``, the diagonal of M(q), is averaged.
    frequency_hz : float
        Natural frequency.
    error : float
        Position error (rad or m) at which the controller's torque equals the Coulomb friction.
    """
    inertia = mean_diagonal(robot, x, q)
    kp = np.maximum(inertia * (2.0 * np.pi * frequency_hz) ** 2, largest_coulomb(robot, x) / error)
    return Controller.pd(kp, DAMPING * np.sqrt(kp * inertia))
