r"""Dahl's memory: friction that depends on the path since the last reversals, exact in displacement.

The state z of a joint follows its position alone, with the sign s = +-1 of its motion and the displacement h,

    dz/dq = (s - z) s / h,        z(q) = s - (s - z_0) exp(-|q - q_0| / h)        between two reversals

A step along the log is therefore exact for any length, and never stiff. The effect of the start z_0 is linear:
``z = z|_(z_0 = 0) + z_0 exp(-path / h)`` with the length of the path since the start. A log, or a window of it, begins with the
sign of the first velocity: the state of a joint that came from afar, and zero at rest, where nothing tells.

A sign held at rest (``hold``) is the same state with a displacement far below any presliding: it changes with the position, not
with the velocity, and needs no dead zone. Friction between the shafts of coupled motors (``Fcm``) keeps its sign.

The core does not know the path: `memory_columns` adds the effect of memory to its columns. Source: Dahl (1968), with the
exponent one. Tested in
``tests/test_friction_memory.py``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array
from ..robot.friction import HOLD_WIDTH, OF_PATH
from ..robot.parameters import friction_names
from ..robot.robot import Robot

FADED = 60.0
"""Exponent at which a column has faded to 1e-26 and stays: filters are ten times slower on numbers that underflow."""


def state(q: Array, width: ArrayLike, first: ArrayLike = 0.0) -> Array:
    """Compute the state of Dahl's memory along positions.

    Parameters
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Joint positions (rad or m).
    width : float or ndarray, shape (..., n_dof)
        Displacements h over which the memory fades by a factor of e (rad or m), above zero.
    first : float or ndarray, shape (n_dof,)
        State at the first sample.

    Returns
    -------
    ndarray, shape (..., n_samples, n_dof)
        State between -1 and 1, by the leading axes of `width`.

    Notes
    -----
    ``test_friction_memory.py`` compares with steps from sample to sample, and halves the steps.
    """
    n = q.shape[1]
    several = np.asarray(width, dtype=np.float64)
    lead = several.shape[:-1]
    several = np.broadcast_to(several, (*lead, n)).reshape(-1, n)
    starts = np.broadcast_to(np.asarray(first, dtype=np.float64), n)
    states_seen = np.empty((len(several), *q.shape))
    for joint in range(n):
        states_seen[:, :, joint] = states(q[:, joint], several[:, joint], starts[joint]).T
    return states_seen.reshape(*lead, *q.shape)


def states(q: Array, widths: Array, first: float = 0.0) -> Array:
    """Compute the states of one joint for several displacements, as `state` does.

    Parameters
    ----------
    q : ndarray, shape (n_samples,)
        Positions (rad or m).
    widths : ndarray, shape (n_widths,)
        Displacements (rad or m).
    first : float
        State at the first sample: of a joint that came from afar the sign of its velocity.

    Returns
    -------
    ndarray, shape (n_samples, n_widths)
    """
    out = np.full((widths.size, q.size), first)
    moves = np.sign(np.diff(q))
    moving = np.flatnonzero(moves)
    if not moving.size:
        return out.T
    # Rest does not change the state: a stretch ends at the next motion in the other direction.
    turns = moving[1:][moves[moving[1:]] != moves[moving[:-1]]]
    edges = np.array([0, *turns, q.size - 1])
    signs, lengths = moves[[moving[0], *turns]], np.diff(edges)
    travelled = np.abs(q[1:] - np.repeat(q[edges[:-1]], lengths))
    decay = np.exp(-travelled[edges[1:-1] - 1, None] / widths)
    z = np.empty((len(signs), widths.size))
    z[0] = first
    for k, share in enumerate(decay):
        z[k + 1] = signs[k] - (signs[k] - z[k]) * share
    sign, missing = np.repeat(signs, lengths), signs[:, None] - z
    for k, width in enumerate(widths):
        np.subtract(sign, np.repeat(missing[:, k], lengths) * np.exp(travelled / -width), out=out[k, 1:])
    return out.T


def start_column(q: Array, width: ArrayLike) -> Array:
    """Compute the effect of a unit state at the first sample along positions: ``exp(-path / h)``.

    Parameters
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Joint positions (rad or m).
    width : float or ndarray, shape (n_dof,)
        Displacement h (rad or m).

    Returns
    -------
    ndarray, shape (n_samples, n_dof)
    """
    path = np.zeros(q.T.shape)
    np.cumsum(np.abs(np.diff(q.T)), axis=1, out=path[:, 1:])
    widths = np.broadcast_to(np.asarray(width, dtype=np.float64), q.shape[1])
    return np.ascontiguousarray(np.exp(-np.minimum(path / widths[:, None], FADED)).T)


def direction(robot: Robot, q: Array, dq: Array) -> Array:
    """Compute the sign of each joint's friction along a motion, as in the model.

    Parameters
    ----------
    robot : Robot
        Robot whose friction defines for each joint whether the sign is smooth, has a dead zone, or is held at rest.
    q, dq : ndarray, shape (n_samples, n_dof)
        Positions (rad or m) and velocities of consecutive samples.

    Returns
    -------
    ndarray, shape (n_samples, n_dof)
        Between -1 and 1.
    """
    sign = instantaneous(robot, dq)
    for joint in robot.friction.held:
        sign[:, joint] = held_sign(q[:, joint], sign[0, joint], robot.joint_kinds[joint])
    return sign


def held_sign(q: Array, first: float, kind: str) -> Array:
    """Compute the sign of the last motion of a joint, (n_samples,).

    Parameters
    ----------
    q : ndarray, shape (n_samples,)
        Positions of consecutive samples (rad or m).
    first : float
        Sign of the first velocity, zero in its dead zone.
    kind : {"revolute", "prismatic"}
        Kind of the joint.
    """
    return states(q, np.array([HOLD_WIDTH[kind]]), first)[:, 0]


def sliding(robot: Robot, x: Array) -> tuple[Robot, Array]:
    """Return the robot without memory, and its parameters, in steady sliding: ``z = s``."""
    plain = robot.without(*OF_PATH)
    values = dict(zip(robot.parameter_names, x, strict=True))
    for term in robot.friction.of("dahl"):
        for name in friction_names(term.joint, ("Fc",)) & values.keys():
            values[name] += values[term.parameter]
    return plain, np.array([values[name] for name in plain.parameter_names])


def memory_columns(
    robot: Robot, q: Array, dq: Array, load: Array | None = None, temperature: Array | None = None
) -> Iterator[tuple[str, int, Array]]:
    """Yield the terms that memory and temperature add to the columns of the core, which treats each sample separately.

    Parameters
    ----------
    robot : Robot
        Robot; without memory nothing is yielded.
    q, dq : ndarray, shape (n_samples, n_dof)
        Positions (rad or m) and velocities of consecutive samples.
    load : ndarray, shape (n_samples, n_dof), optional
        Torque of links and rotors, for load friction.
    temperature : ndarray, shape (n_samples, n_dof), optional
        Temperature of the joints (degC); the reference temperature without it.

    Yields
    ------
    name : str
        Standard parameter.
    joint : int
        Row of its column, from 0.
    column : ndarray, shape (n_samples,)
        Addition to the column of the core, per unit of the parameter.

    Notes
    -----
    ``test_friction_memory.py`` compares the torques of robots with ``hold`` and ``dahl`` with their formula,
    ``test_friction_temperature.py`` those of laws of temperature.
    """
    friction = robot.friction
    if friction.warmed and temperature is not None:
        sign = direction(robot, q, dq)
        for term in friction.warmed:
            joint, motion = term.joint, dq if term.law == "warm_viscous" else sign
            yield term.parameter, joint, (temperature[:, joint] - term.values[0]) * motion[:, joint]
    for term in friction.of("dahl"):
        first = instantaneous(robot, dq[:1])[0, term.joint]
        yield term.parameter, term.joint, states(q[:, term.joint], np.array([term.velocity]), first)[:, 0]
    joints = friction.held
    if not joints:
        return
    before, held = instantaneous(robot, dq), direction(robot, q, dq)
    change = held - before
    for joint in joints:
        if friction.model == "asymmetric":
            for side, part in (("+", np.maximum), ("-", np.minimum)):
                yield (f"Fc{joint + 1}{side}", joint, part(held[:, joint], 0.0) - part(before[:, joint], 0.0))
        else:
            yield f"Fc{joint + 1}", joint, change[:, joint]
    for term in friction.terms:
        joint = term.joint
        if joint not in joints:
            continue
        speed = np.abs(dq[:, joint])
        if term.law == "stribeck":
            yield term.parameter, joint, change[:, joint] * np.exp(-np.square(speed / term.velocity))
        elif term.law == "root":
            yield term.parameter, joint, change[:, joint] * np.sqrt(speed)
        elif term.law == "load" and load is not None:
            yield term.parameter, joint, change[:, joint] * np.abs(load[:, joint])


def instantaneous(robot: Robot, dq: Array) -> Array:
    """Compute the sign at velocities (n_samples, n_dof) alone, smooth or not, zero in its dead zone."""
    friction = robot.friction
    smooth = friction.coulomb == "tanh"
    sign = np.tanh(dq / np.asarray(friction.smoothing)) if smooth else np.sign(dq)
    return np.asarray(sign * (np.abs(dq) > np.asarray(friction.dead_zone)))
