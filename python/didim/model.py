"""Inverse dynamic model (1) and its regressor (2), in batches over samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from .errors import ShapeError
from .robot import Robot

Array = NDArray[np.float64]


def inverse_dynamics(robot: Robot, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, x: ArrayLike) -> Array:
    """Torques of a motion: ``tau = M(q) ddq + N(q, dq)``, rotors and friction included, equation (1).

    Checked against Pinocchio's ``rnea`` and against the regressor in ``tests/test_pinocchio.py`` and
    ``tests/test_identities.py``.

    Parameters
    ----------
    robot : Robot
        The robot.
    q, dq, ddq : (n_samples, n_dof) arrays
        Positions (rad or m), velocities and accelerations, joint side.
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``.

    Returns
    -------
    (n_samples, n_dof) array
        Torques (N.m) or forces (N), joint side.

    Raises
    ------
    ShapeError
        For a wrong shape, or a NaN, with its place.
    """
    q, dq, ddq = _motion(robot, q, dq, ddq)
    vector = standard_vector(robot, x)
    try:
        return _core.inverse_dynamics(robot.core, q, dq, ddq, vector)
    except ValueError as reason:
        raise ShapeError(str(reason)) from None


def regressor(robot: Robot, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
    """Regressor of the inverse dynamic model: ``tau = W x`` at each sample, equation (2).

    Checked against Pinocchio's ``computeJointTorqueRegressor`` in ``tests/test_pinocchio.py``.

    Parameters
    ----------
    robot : Robot
        The robot.
    q, dq, ddq : (n_samples, n_dof) arrays
        Positions (rad or m), velocities and accelerations, joint side.

    Returns
    -------
    (n_samples, n_dof, n_parameters) array
        Torque per unit of each standard parameter, joint side.

    Raises
    ------
    ShapeError
        For a wrong shape, or a NaN, with its place.
    """
    q, dq, ddq = _motion(robot, q, dq, ddq)
    try:
        return _core.regressor(robot.core, q, dq, ddq)
    except ValueError as reason:
        raise ShapeError(str(reason)) from None


def standard_vector(robot: Robot, x: ArrayLike) -> Array:
    """Check a vector of standard parameters, ``(n_parameters,)``.

    Raises
    ------
    ShapeError
        For a wrong length, or a NaN, with the parameter's name.
    """
    vector = np.asarray(x, dtype=np.float64)
    names = robot.parameter_names
    if vector.shape != (len(names),):
        hint = ""
        if vector.shape == (len(robot.base_parameters.names),):
            hint = "; these may be base parameters: lift them with robot.base_parameters.lift(beta)"
        raise ShapeError(
            f"x must have shape ({len(names)},) for robot {robot.name!r}, got {vector.shape}{hint}"
        )
    bad = np.flatnonzero(~np.isfinite(vector))
    if bad.size:
        raise ShapeError(f"x has {vector[bad[0]]} for parameter {names[bad[0]]}")
    return vector


def _motion(robot: Robot, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> tuple[Array, Array, Array]:
    return _matrix(robot, "q", q), _matrix(robot, "dq", dq), _matrix(robot, "ddq", ddq)


def _matrix(robot: Robot, name: str, value: ArrayLike) -> Array:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ShapeError(
            f"{name} must be an array of numbers with shape (n_samples, {robot.n_dof})"
        ) from None
    if array.ndim != 2 or array.shape[1] != robot.n_dof:
        hint = "; transpose it?" if array.ndim == 2 and array.shape[0] == robot.n_dof else ""
        raise ShapeError(
            f"{name} must have shape (n_samples, {robot.n_dof}) for robot {robot.name!r}, "
            f"got {array.shape}{hint}"
        )
    return array
