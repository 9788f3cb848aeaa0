"""Limbs: groups of joints that share neither link nor motor with the others; on a fixed base they are decoupled.

The inertia matrix has no entry between two limbs, ``M_ij = 0``, and no torque of one depends on the motion of the other:
``tests/test_positions.py`` compares torques of the whole robot and of its limbs.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..robot.placement import Mount
from ..robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Limb:
    """One limb of a robot.

    Attributes
    ----------
    name : str
        Common part of its joints' names, or "joints 1 to 3".
    joints : tuple of int
        Numbers of its joints in the robot, from 0.
    robot : Robot
        The limb as a separate robot.
    indices : (n_limb_parameters,) array
        Indices of its standard parameters in the robot.
    """

    name: str
    joints: tuple[int, ...]
    robot: Robot
    indices: NDArray[np.intp]


def limbs_of(robot: Robot) -> list[Limb]:
    """Return the limbs of a robot in the order of their first joints; a single one for a chain."""
    n, parents = robot.n_dof, robot.geometry.parents
    group = list(range(n))
    coupling = np.array(robot.geometry.coupling) != 0.0

    def merge(a: int, b: int) -> None:
        low, high = sorted((group[a], group[b]))
        group[:] = [low if g == high else g for g in group]

    for joint, parent in enumerate(parents):
        if parent is not None:
            merge(joint, parent)
    for a, b in np.argwhere(coupling | coupling.T):
        merge(int(a), int(b))
    found = []
    for first in dict.fromkeys(group):
        joints = tuple(j for j in range(n) if group[j] == first)
        found.append(_limb(robot, joints))
    return found


def _limb(robot: Robot, joints: tuple[int, ...]) -> Limb:
    if len(joints) == robot.n_dof:
        return Limb("", joints, robot, np.arange(len(robot.parameter_names)))
    place = {joint: k for k, joint in enumerate(joints)}
    geometry, friction = robot.geometry, robot.friction
    mounts = tuple(
        replace(mount, parent=None if mount.parent is None else place[mount.parent])
        for mount in (
            (geometry.mounts or tuple(Mount(parent=p) for p in geometry.parents))[joint] for joint in joints
        )
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
            coupling=tuple(tuple(geometry.coupling[a][b] for b in joints) for a in joints),
            mounts=mounts,
        ),
        friction=replace(
            friction,
            smoothing=tuple(friction.smoothing[j] for j in joints),
            dead_zone=tuple(friction.dead_zone[j] for j in joints),
            terms=tuple(
                replace(term, joint=place[term.joint]) for term in friction.terms if term.joint in place
            ),
        ),
        limits=tuple(robot.limits[j] for j in joints),
        reduction=None,
        gains=None,
        joint_names=tuple(robot.joint_names[j] for j in joints) if robot.joint_names else (),
        correspondence=None,
        collision=(),
        standard=None,
        _named={},
        _own=frozenset(),
    )
    indices = [robot.parameter_names.index(renamed(name, joints)) for name in alone.parameter_names]
    return Limb(_name(robot, joints), joints, alone, np.array(indices))


def renamed(name: str, joints: tuple[int, ...]) -> str:
    """Return the name among the robot's parameters of a parameter of a limb: ``Ia2`` of joints 4 to 6 is ``Ia5``."""
    head, number, tail = re.fullmatch(r"(\D+)(\d+)(\D*)", name).groups()  # type: ignore[union-attr]
    return f"{head}{joints[int(number) - 1] + 1}{tail}"


def _name(robot: Robot, joints: tuple[int, ...]) -> str:
    if robot.joint_names:
        names = [robot.joint_names[j] for j in joints]
        alike = [len(set(letters)) == 1 for letters in zip(*names, strict=False)]
        common = names[0][: [*alike, False].index(False)].rstrip("_-. ")
        if common and len(joints) > 1:
            return common
    return f"joints {joints[0] + 1} to {joints[-1] + 1}" if len(joints) > 1 else robot.joint_label(joints[0])


def role_of(name: str, limb: str) -> str:
    """Return the name of a joint within its limb: ``thigh_joint`` of ``FL_thigh_joint`` in limb ``FL``."""
    return name.removeprefix(limb).strip("_-. ") or name
