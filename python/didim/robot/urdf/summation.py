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
from .description import Inertial

STATES = 50
"""Number of random states of the self-test."""


@dataclass(frozen=True, eq=False)
class Body:
    """A link that moves with a joint: its inertia, and the pose of its frame in that of the moving link."""

    inertial: Inertial
    pose: Array


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


def bodies(groups: Sequence[Sequence[Member]], links: dict[str, Inertial | None]) -> list[list[Body]]:
    """Return the links with inertia of each group."""
    bodies_so_far = []
    for group in groups:
        pairs = ((links[member.link], member.pose) for member in group)
        bodies_so_far.append([Body(inertial, pose) for inertial, pose in pairs if inertial is not None])
    return bodies_so_far


def made_up_bodies(n_dof: int) -> list[list[Body]]:
    """Return one body per joint, for files without inertias; each link has its own mass, centre and moments."""
    made_up = []
    for joint in range(n_dof):
        frame = np.eye(4)
        frame[:3, 3] = 0.02 * (joint + 1), -0.03, 0.1 - 0.01 * joint
        inertia = np.array(
            [[0.05, 0.004, -0.003], [0.004, 0.04, 0.002], [-0.003, 0.002, 0.03 + 0.002 * joint]]
        )
        made_up.append([Body(Inertial(4.0 - 0.4 * joint / n_dof, frame, inertia), np.eye(4))])
    return made_up


def torques_by_summation(
    kinds: Sequence[str],
    origins: Sequence[Array],
    axes: Sequence[Array],
    links: Sequence[Sequence[Body]],
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
    links : sequence of sequence of Body
        Bodies that move with each joint.
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
    base = (
        np.broadcast_to(np.eye(3), (n_states, 3, 3)),
        zero,
        zero,
        zero,
        np.tile(-gravity, (n_states, 1)),
    )
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
        motions.append((rotation, position, speed, turning, acceleration))
        joint_places.append(position)
        joint_axes.append(axis)
        for body in links[joint]:
            force, moment, centre = _effort(body, rotation, position, speed, turning, acceleration)
            for i in carriers(parents, joint):
                slides = kinds[i] == "prismatic"
                effect = force if slides else moment + np.cross(centre - joint_places[i], force)
                torque[:, i] += np.einsum("sk,sk->s", joint_axes[i], effect)
    return torque


def _effort(
    body: Body, rotation: Array, position: Array, speed: Array, turning: Array, acceleration: Array
) -> tuple[Array, Array, Array]:
    """Return force on a body, moment about its centre of mass, and this centre, (n_states, 3) each."""
    frame = body.pose @ body.inertial.frame
    arm = rotation @ frame[:3, 3]
    force = body.inertial.mass * (
        acceleration + np.cross(turning, arm) + np.cross(speed, np.cross(speed, arm))
    )
    to_body = rotation @ frame[:3, :3]
    inertia = to_body @ body.inertial.inertia @ np.swapaxes(to_body, 1, 2)
    moment = np.einsum("sij,sj->si", inertia, turning)
    moment += np.cross(speed, np.einsum("sij,sj->si", inertia, speed))
    return force, moment, position + arm


def _turns(axis: Array, angles: Array) -> Array:
    """Return the rotations by several angles about one axis, (n, 3, 3)."""
    cross = skew(axis)
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))
