"""Limbs: groups of joints that share neither link nor motor with the others; on a fixed base they are decoupled.

The inertia matrix has no entry between two limbs, ``M_ij = 0``, and no torque of one depends on the motion of the other:
``tests/test_positions.py`` compares torques of the whole robot and of its limbs. So one simulation gives the derivatives with
respect to a parameter of each limb (Curtis, Powell and Reid, 1974): ``tests/test_limbs.py`` compares them with single ones.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..robot.placement import chain, joined
from ..robot.robot import Robot

REMEMBERED = 8
"""Number of robots whose limbs are kept: every closed loop of a log asks for them."""


@dataclass(frozen=True, eq=False)
class Limb:
    """One limb of a robot.

    Attributes
    ----------
    name : str
        Common part of its joints' names, or "joints 1 to 3".
    joints : tuple of int
        Numbers of its driven joints in the robot, from 0.
    links : tuple of int
        Numbers of all its joints in the robot, followers included, from 0.
    robot : Robot
        The limb as a separate robot.
    indices : (n_limb_parameters,) array
        Indices of its standard parameters in the robot.
    """

    name: str
    joints: tuple[int, ...]
    links: tuple[int, ...]
    robot: Robot
    indices: NDArray[np.intp]

    def of(self, robot: Robot) -> Robot:
        """Return the same limb of a robot with the same joints."""
        return limb_of(robot, self.links).robot


@lru_cache(maxsize=REMEMBERED)
def limbs_of(robot: Robot) -> tuple[Limb, ...]:
    """Return the limbs of a robot in the order of their first joints; a single one for a chain."""
    geometry = robot.geometry
    carried = [(joint, parent) for joint, parent in enumerate(geometry.parents) if parent is not None]
    led = [
        (joint, leader)
        for joint, follower in enumerate(geometry.followers, start=robot.n_dof)
        for leader, _ in follower.leaders
    ]
    pairs = [*carried, *np.argwhere(geometry.coupling).tolist(), *led]
    return tuple(limb_of(robot, joints) for joints in joined(robot.n_joints, pairs))


def links_with(robot: Robot, joints: Iterable[int]) -> tuple[int, ...]:
    """Return the numbers of all joints of the limbs that have some of these joints, from 0."""
    some = set(joints)
    return tuple(sorted(link for limb in limbs_of(robot) if some & set(limb.links) for link in limb.links))


def limb_of(robot: Robot, joints: tuple[int, ...]) -> Limb:
    """Return the limb of some joints, or several side by side; followers included, which have the last numbers here too."""
    if len(joints) == robot.n_joints:
        return Limb("", joints[: robot.n_dof], joints, robot, np.arange(len(robot.parameter_names)))
    driven = tuple(joint for joint in joints if joint < robot.n_dof)
    index_of = {joint: k for k, joint in enumerate(joints)}
    geometry, friction = robot.geometry, robot.friction
    every = geometry.mounts or chain(robot.n_joints)
    mounts = tuple(
        replace(mount, parent=None if mount.parent is None else index_of[mount.parent])
        for mount in (every[joint] for joint in joints)
    )
    followers = tuple(
        replace(follower, leaders=tuple((index_of[leader], factor) for leader, factor in follower.leaders))
        for joint, follower in enumerate(geometry.followers, start=robot.n_dof)
        if joint in index_of
    )
    rows = {
        key: tuple(getattr(geometry, key)[joint] for joint in joints)
        for key in ("kinds", "alpha", "d", "theta", "r")
    }
    alone = replace(
        robot,
        geometry=replace(
            geometry,
            **rows,
            coupling=tuple(tuple(geometry.coupling[a][b] for b in driven) for a in driven),
            mounts=mounts,
            followers=followers,
        ),
        friction=replace(
            friction,
            smoothing=tuple(friction.smoothing[j] for j in driven),
            dead_zone=tuple(friction.dead_zone[j] for j in driven),
            terms=tuple(
                replace(term, joint=index_of[term.joint]) for term in friction.terms if term.joint in index_of
            ),
        ),
        limits=tuple(robot.limits[j] for j in driven),
        reduction=None,
        gains=None,
        joint_names=tuple(robot.joint_names[j] for j in driven) if robot.joint_names else (),
        correspondence=None,
        collision=(),
        standard=None,
        _named={},
        _own=frozenset(),
    )
    indices = [robot.parameter_names.index(renamed(name, joints)) for name in alone.parameter_names]
    return Limb(_name(robot, driven), driven, joints, alone, np.array(indices))


def renamed(name: str, joints: tuple[int, ...]) -> str:
    """Return the name among the robot's parameters of a parameter of a limb: ``Ia2`` of joints 4 to 6 is ``Ia5``."""
    head, number, tail = re.fullmatch(r"(.*\D)(\d+)(\D*)", name).groups()  # type: ignore[union-attr]
    return f"{head}{joints[int(number) - 1] + 1}{tail}"


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions of differences: one simulation changes a parameter of each limb.

    Attributes
    ----------
    number : (n,) array of int
        Simulation that changes each parameter.
    joints : (n, n_dof) array of bool
        Joints that respond to each parameter: those of the limbs that it acts on.
    """

    number: NDArray[np.intp]
    joints: NDArray[np.bool_]

    @classmethod
    def of(cls, robot: Robot, acts: NDArray[np.bool_]) -> Directions:
        """Assign parameters to as few simulations as they need, in their order.

        Parameters
        ----------
        robot : Robot
            The simulated robot.
        acts : (n_dof, n) array of bool
            Whether each parameter acts on the torque of a joint along some motion. One that acts on none has a simulation of its
            own.
        """
        joints = np.zeros(acts.T.shape, dtype=bool)
        for limb in limbs_of(robot):
            at = list(limb.joints)
            joints[:, at] = np.asarray(acts[at].any(axis=0))[:, None]
        joints[~joints.any(axis=1)] = True
        number = np.zeros(len(joints), dtype=np.intp)
        taken = np.zeros_like(joints)  # joints that respond in each simulation
        for column, own in enumerate(joints):
            number[column] = np.argmin((taken & own).any(axis=1))
            taken[number[column]] |= own
        return cls(number, joints)

    def changes(self, steps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the change of all parameters in each simulation, (n_simulations, n), from the step of each, (n,)."""
        changes = np.zeros((self.number.max(initial=-1) + 1, len(steps)))
        changes[self.number, np.arange(len(steps))] = steps
        return changes


def _name(robot: Robot, joints: tuple[int, ...]) -> str:
    if robot.joint_names:
        names = [robot.joint_names[j] for j in joints]
        alike = [len(set(letters)) == 1 for letters in zip(*names, strict=False)]
        common = names[0][: [*alike, False].index(False)].rstrip("_-. ")
        if common and len(joints) > 1:
            return common
    return f"joints {joints[0] + 1} to {joints[-1] + 1}" if len(joints) > 1 else robot.joint_label(joints[0])
