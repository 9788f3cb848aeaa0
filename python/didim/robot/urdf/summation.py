"""Inverse dynamics of a URDF by direct summation over its links: the proof that a robot made from it is the same robot.

Each link moves as the file places it. Its ``<inertial>`` gives the inertial force and moment, and these the work on each joint
axis (d'Alembert). No frame, pseudo-inertia or recursion of the robot model is used.
Tested in ``tests/test_urdf.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array
from ..placement import carriers, in_line
from ..rigid_body import skew
from .chain import Member
from .mechanism import Inertial

STATES = 50
"""Number of random states of the self-test."""


@dataclass(frozen=True, eq=False)
class States:
    """Positions, velocities and accelerations, (n_states, n_dof) each (rad or m)."""

    q: Array
    dq: Array
    ddq: Array


def random_states(n_dof: int) -> States:
    """Return the states of the self-test: within a turn, and a few units per second."""
    rng = np.random.default_rng(0)
    shape = (STATES, n_dof)
    return States(rng.uniform(-3.0, 3.0, shape), rng.uniform(-2.0, 2.0, shape), rng.uniform(-5.0, 5.0, shape))


def made_up_bodies(n_dof: int) -> list[list[Member]]:
    """Return one body per joint, for files without inertias; each link has its own mass, centre and moments."""
    made_up = []
    for joint in range(n_dof):
        frame = np.eye(4)
        frame[:3, 3] = 0.02 * (joint + 1), -0.03, 0.1 - 0.01 * joint
        inertia = np.array(
            [[0.05, 0.004, -0.003], [0.004, 0.04, 0.002], [-0.003, 0.002, 0.03 + 0.002 * joint]]
        )
        inertial = Inertial(4.0 - 0.4 * joint / n_dof, frame, inertia)
        made_up.append([Member("", np.eye(4), False, inertial)])
    return made_up


def torques_by_summation(
    kinds: Sequence[str],
    origins: Sequence[Array],
    axes: Sequence[Array],
    links: Sequence[Sequence[Member]],
    gravity: Array,
    states: States,
    parents: Sequence[int | None] | None = None,
) -> Array:
    """Return the torques of a motion, without friction and rotors, (n_states, n_dof).

    Parameters
    ----------
    kinds : sequence of str
        Type of each joint.
    origins, axes
        As in `Chain`.
    links : sequence of sequence of Member
        Links that move with each joint.
    gravity : (3,) array
        Acceleration of gravity in the base (m/s^2).
    states : States
        The motion.
    parents : sequence of int or None, optional
        As in `Chain`; by default those of a chain.
    """
    n_states, n_dof = states.q.shape
    parents = in_line(n_dof) if parents is None else parents
    zero = np.zeros((n_states, 3))
    # Per link: rotation, origin, angular velocity and acceleration, acceleration of the origin (the base accelerates upwards).
    base = (np.broadcast_to(np.eye(3), (n_states, 3, 3)), zero, zero, zero, np.tile(-gravity, (n_states, 1)))
    motions: list[tuple[Array, Array, Array, Array, Array]] = []
    joint_places, joint_axes = [], []
    torque = np.zeros((n_states, n_dof))
    for joint, kind in enumerate(kinds):
        parent = parents[joint]
        rotation, position, speed, turning, acceleration = base if parent is None else motions[parent]
        q, dq, ddq = (values[:, joint, None] for values in (states.q, states.dq, states.ddq))
        arm = rotation @ origins[joint][:3, 3]
        acceleration = acceleration + np.cross(turning, arm) + np.cross(speed, np.cross(speed, arm))
        position = position + arm
        rotation = rotation @ origins[joint][:3, :3]
        axis = rotation @ axes[joint]
        if kind == "prismatic":
            slide = axis * q
            acceleration = (
                acceleration
                + np.cross(turning, slide)
                + np.cross(speed, np.cross(speed, slide))
                + 2.0 * np.cross(speed, axis * dq)
                + axis * ddq
            )
            position = position + slide
        else:
            rotation = rotation @ _turns(axes[joint], states.q[:, joint])
            turning = turning + axis * ddq + np.cross(speed, axis * dq)
            speed = speed + axis * dq
        motion = (rotation, position, speed, turning, acceleration)
        motions.append(motion)
        joint_places.append(position)
        joint_axes.append(axis)
        for inertial, frame in ((member.inertial, member.pose) for member in links[joint]):
            if inertial is None:
                continue
            force, moment, centre = _effort(inertial, frame @ inertial.frame, *motion)
            for i in carriers(parents, joint):
                slides = kinds[i] == "prismatic"
                effect = force if slides else moment + np.cross(centre - joint_places[i], force)
                torque[:, i] += np.einsum("sk,sk->s", joint_axes[i], effect)
    return torque


def _effort(
    inertial: Inertial,
    frame: Array,
    rotation: Array,
    position: Array,
    speed: Array,
    turning: Array,
    acceleration: Array,
) -> tuple[Array, Array, Array]:
    """Return force on a body, moment about its centre of mass, and this centre, (n_states, 3) each."""
    arm = rotation @ frame[:3, 3]
    force = inertial.mass * (acceleration + np.cross(turning, arm) + np.cross(speed, np.cross(speed, arm)))
    to_body = rotation @ frame[:3, :3]
    inertia = to_body @ inertial.inertia @ np.swapaxes(to_body, 1, 2)
    moment = np.einsum("sij,sj->si", inertia, turning)
    moment += np.cross(speed, np.einsum("sij,sj->si", inertia, speed))
    return force, moment, position + arm


def _turns(axis: Array, angles: Array) -> Array:
    """Return the rotations by several angles about one axis, (n, 3, 3)."""
    cross = skew(axis)
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))
