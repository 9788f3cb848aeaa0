"""Inverse dynamic model (1), its regressor (2) and the direct dynamic model (4), in batches over samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

import didim._core as _core

from .._tools.arrays import LARGEST_POSITION, LARGEST_SQUARED, Array, real_array, surely_within
from ..errors import CoreErrorsAs, IndefiniteError, ShapeError
from ..robot.rigid_body import INERTIAL
from ..robot.robot import Robot
from .memory import memory_columns


def inverse_dynamics(
    robot: Robot,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike,
    x: ArrayLike,
    *,
    temperature: ArrayLike | None = None,
) -> Array:
    """Compute the torques of a motion, equation (1), rotors and friction included.

    Checked against Pinocchio's ``rnea`` and against the regressor in ``tests/test_pinocchio.py`` and
    ``tests/test_identities.py``.

    Parameters
    ----------
    robot : Robot
        The robot.
    q, dq, ddq : (n_samples, n_dof) arrays
        Positions (rad or m), velocities and accelerations, joint side; consecutive samples if friction has memory (``hold``,
        ``dahl``).
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``.
    temperature : (n_samples, n_dof) or (n_samples,) array, optional
        Temperature of the joints (degC); the reference temperature of each law without it.

    Returns
    -------
    (n_samples, n_dof) array
        Torques (N.m) or forces (N), joint side.

    Raises
    ------
    ShapeError
        For a wrong shape, or a NaN; the message gives its position.
    """
    q, dq, ddq = _motion(robot, q, dq, ddq)
    vector = standard_vector(robot, x)
    warmth = None if temperature is None else _temperature(robot, temperature)
    with CoreErrorsAs(ShapeError):
        tau = _core.inverse_dynamics(robot.core, q, dq, ddq, vector)
    if robot.friction.has_memory:
        load = rigid_torque(robot, q, dq, ddq, vector) if robot.friction.has_load else None
        for name, joint, column in memory_columns(robot, q, dq, load, warmth):
            tau[:, joint] += vector[robot.parameter_names.index(name)] * column
    return tau


def regressor(
    robot: Robot,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike,
    *,
    x: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    out: Array | None = None,
) -> Array:
    """Compute the regressor of the inverse model, ``tau = W x``, equation (2).

    Checked against Pinocchio's ``computeJointTorqueRegressor`` in ``tests/test_pinocchio.py``.

    Parameters
    ----------
    robot : Robot
        The robot.
    q, dq, ddq : (n_samples, n_dof) arrays
        Positions (rad or m), velocities and accelerations, joint side.
    x : (n_parameters,) array, optional
        Standard parameters, needed for load friction: they give the torque of links and rotors.
    temperature : (n_samples, n_dof) or (n_samples,) array, optional
        Temperature of the joints (degC); the reference temperature of each law without it.
    out : (n_samples, n_dof, n_parameters) array, optional
        Contiguous memory for the result: reuse saves time for batches that fit the cache.

    Returns
    -------
    (n_samples, n_dof, n_parameters) array
        Torque per unit of each standard parameter, joint side.

    Raises
    ------
    ShapeError
        For a wrong shape, or a NaN; the message gives its position.
    """
    q, dq, ddq = _motion(robot, q, dq, ddq)
    warmth = None if temperature is None else _temperature(robot, temperature)
    load = None
    if robot.friction.has_load:
        if x is None:
            raise ShapeError(f"robot {robot.name!r} has load friction: its regressor needs the parameters x")
        load = rigid_torque(robot, q, dq, ddq, standard_vector(robot, x))
    with CoreErrorsAs(ShapeError):
        w = _core.regressor(robot.core, q, dq, ddq, out, load)
    for name, joint, column in memory_columns(robot, q, dq, load, warmth):
        w[:, joint, robot.parameter_names.index(name)] += column
    return w


def rigid_torque(robot: Robot, q: Array, dq: Array, ddq: Array, x: Array) -> Array:
    """Return the torque of links and rotors without friction and offset, (n_samples, n_dof), joint side.

    Load friction is a share of it (Hamon, Gautier, Garrec 2010). ``test_friction_terms.py`` compares with a robot without friction.
    """
    rigid = np.array(x, dtype=np.float64)
    rigid[list(friction_places(robot))] = 0.0
    with CoreErrorsAs(ShapeError):
        return _core.inverse_dynamics(robot.core, q, dq, ddq, rigid)


def gravity(robot: Robot, q: ArrayLike, x: ArrayLike) -> Array:
    """Compute the torques against gravity and springs (gravity compensation).

    Friction and offsets are left out.

    They are those of `inverse_dynamics` at rest with links and rotors alone, and of ``NAME_gravity`` of `didim.export.to_c`; both
    are compared in ``tests/test_identities.py`` and ``tests/test_export_c.py``.

    Parameters
    ----------
    robot : Robot
        The robot; its file gives the direction of gravity.
    q : (n_samples, n_dof) array
        Positions (rad or m), joint side.
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``, such as ``fit.parameters``.

    Returns
    -------
    (n_samples, n_dof) array
        Torques (N.m) or forces (N), joint side.

    Raises
    ------
    ShapeError
        For a wrong shape, or a NaN; the message gives its position.
    """
    positions = _matrix(robot, "q", q)
    rest, vector = np.zeros_like(positions), standard_vector(robot, x)
    torque = rigid_torque(robot, positions, rest, rest, vector)
    if not robot.friction.springs:
        return torque
    places = [robot.parameter_names.index(term.parameter) for term in robot.friction.springs]
    springs = np.zeros_like(vector)
    springs[places] = vector[places]
    return np.asarray(torque + _core.inverse_dynamics(robot.core, positions, rest, rest, springs))


def friction_places(robot: Robot) -> tuple[int, ...]:
    """Return the indices of the standard parameters of friction and offset."""
    inertial = (*INERTIAL, "Ia")
    return tuple(k for k, parameter in enumerate(robot.standard_parameters) if parameter.kind not in inertial)


def inertia_matrix(robot: Robot, q: ArrayLike, x: ArrayLike) -> Array:
    """Compute the inertia matrix ``M(q)`` of (1), rotors and coupled motors included.

    Checked against Pinocchio's ``crba`` in ``tests/test_pinocchio.py``.

    Parameters
    ----------
    robot : Robot
        The robot.
    q : (n_samples, n_dof) array
        Positions (rad or m), joint side.
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``.

    Returns
    -------
    (n_samples, n_dof, n_dof) array
        Symmetric matrices (kg.m^2, kg.m or kg), joint side.

    Raises
    ------
    ShapeError
        For a wrong shape, or a NaN; the message gives its position.
    """
    positions = _matrix(robot, "q", q)
    vector = standard_vector(robot, x)
    with CoreErrorsAs(ShapeError):
        return _core.inertia_matrix(robot.core, positions, vector)


def direct_dynamics(robot: Robot, q: ArrayLike, dq: ArrayLike, tau: ArrayLike, x: ArrayLike) -> Array:
    """Compute the accelerations of a robot under torques, equation (4).

    Checked against Pinocchio's ``aba`` in ``tests/test_pinocchio.py``, and as the inverse of
    `inverse_dynamics` in ``tests/test_identities.py``.

    Parameters
    ----------
    robot : Robot
        The robot.
    q, dq : (n_samples, n_dof) arrays
        Positions (rad or m) and velocities, joint side.
    tau : (n_samples, n_dof) array
        Torques (N.m) or forces (N), joint side.
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``.

    Returns
    -------
    (n_samples, n_dof) array
        Accelerations (rad/s^2 or m/s^2), joint side.

    Raises
    ------
    ShapeError
        For a wrong shape, or a NaN; the message gives its position.
    IndefiniteError
        When ``M(q)`` is not positive definite, as for no real robot; the message names sample and joint.
    """
    positions, velocities = _matrix(robot, "q", q), _matrix(robot, "dq", dq)
    torques, vector = _matrix(robot, "tau", tau), standard_vector(robot, x)
    with CoreErrorsAs(ShapeError):
        ddq, indefinite = _core.direct_dynamics(robot.core, positions, velocities, torques, vector)
    if indefinite is not None:
        sample, joint = indefinite
        raise IndefiniteError(
            f"M(q) is not positive definite at sample {sample + 1}: the inertia at joint {joint + 1} "
            "is not positive with these parameters"
        )
    return ddq


def standard_vector(robot: Robot, x: ArrayLike) -> Array:
    """Check a vector of standard parameters, ``(n_parameters,)``.

    Raises
    ------
    ShapeError
        For a wrong length, a result in place of its parameters, or a NaN, with the parameter's name.
    """
    if hasattr(x, "parameters"):
        raise ShapeError(f"x is a result ({type(x).__name__}): pass its standard parameters, fit.parameters")
    vector = real_array("x", x, ShapeError)
    names = robot.parameter_names
    if vector.shape != (len(names),):
        hint = ""
        if vector.shape == (len(robot.base_parameters.names),):
            hint = "; these may be base parameters: lift them with robot.base_parameters.lift(beta)"
        raise ShapeError(
            f"x must have shape ({len(names)},) for robot {robot.name!r}, got {vector.shape}{hint}"
        )
    if surely_within(vector, LARGEST_SQUARED):
        return vector
    bad = np.flatnonzero(~np.isfinite(vector))
    if bad.size:
        raise ShapeError(f"x has {vector[bad[0]]} for parameter {names[bad[0]]}")
    return vector


def _motion(robot: Robot, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> tuple[Array, Array, Array]:
    return _matrix(robot, "q", q), _matrix(robot, "dq", dq), _matrix(robot, "ddq", ddq)


def _temperature(robot: Robot, value: ArrayLike) -> Array:
    array = real_array("temperature", value, ShapeError)
    return _matrix(robot, "temperature", np.tile(array[:, None], robot.n_dof) if array.ndim == 1 else array)


def per_joint(robot: Robot, name: str, value: ArrayLike) -> Array:
    """Return a signal of all driven joints, ``(n_samples, n_dof)``.

    Raises
    ------
    ShapeError
        For an array of another shape (``tests/test_arrays.py``).
    """
    array = real_array(name, value, ShapeError)
    if array.ndim != 2 or array.shape[1] != robot.n_dof:
        hint = "; transpose it?" if array.ndim == 2 and array.shape[0] == robot.n_dof else ""
        raise ShapeError(
            f"{name} must have shape (n_samples, {robot.n_dof}) for robot {robot.name!r}, "
            f"got {array.shape}{hint}"
        )
    return array


def _matrix(robot: Robot, name: str, value: ArrayLike) -> Array:
    array = per_joint(robot, name, value)
    # The core reports numbers that are not finite.
    if name != "q" or surely_within(array, LARGEST_POSITION):
        return array
    beyond = np.argwhere(np.abs(array) > LARGEST_POSITION)
    if beyond.size:
        sample, joint = beyond[0]
        raise ShapeError(
            f"q of joint {joint + 1} is {array[sample, joint]:g} at sample {sample + 1}, where at most "
            f"{LARGEST_POSITION:g} rad or m is possible"
        )
    return array
