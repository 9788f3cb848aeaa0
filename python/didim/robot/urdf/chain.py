"""The chain or tree of a URDF that becomes the robot, and the links that move with each of its joints.

Without a ``tip`` the chain follows, from the base on, the only child with moving joints. If it is an arm and branches into
something shorter, the fingers of a gripper, it ends there; else the robot is the whole tree. Links behind fixed joints belong to
the moving link that carries them. So do links behind moving joints outside the chain, which are locked. Floating, planar and
spherical joints are fixed at zero. A joint that mimics another follows it, and is locked if that one is.
`chain_of_names` finds the chain that a log names.
Tested in ``tests/test_urdf_chain.py``, ``tests/test_trees.py``, ``tests/test_couplings.py`` and ``tests/test_init_files.py``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import did_you_mean, series
from ...errors import RobotError
from ..robot import MOST_JOINTS
from .description import read_description
from .mechanism import MOVING, Description, Inertial, UrdfJoint

WHOLE = ""
"""Value of ``tip`` for the whole tree."""

ARM = 3
"""Smallest number of joints of a chain that counts as an arm: what branches off is a gripper if it is shorter."""


@dataclass(frozen=True, eq=False)
class Member:
    """A link that moves with a joint of the chain.

    Attributes
    ----------
    link : str
        Its name.
    pose : (4, 4) array
        Its frame in that of the moving link.
    locked : bool
        Whether a locked joint, and not only fixed ones, lies between.
    inertial : Inertial or None
        Its inertia, if it has one.
    """

    link: str
    pose: Array
    locked: bool
    inertial: Inertial | None

    @property
    def pseudo(self) -> Array:
        """Pseudo-inertia (4, 4) in the frame of the moving link; zero without an inertia."""
        return np.zeros((4, 4)) if self.inertial is None else self.pose @ self.inertial.pseudo @ self.pose.T


@dataclass(frozen=True, eq=False)
class Chain:
    """The joints of the robot, branch by branch from the base.

    Attributes
    ----------
    base, tip : str
        First and last link; the tip of a tree is `WHOLE`.
    base_pose : (4, 4) array
        Pose of the base link in the root link, locked joints at their values.
    joints : tuple of UrdfJoint
        Moving joints.
    parents : tuple of int or None
        Antecedent of each joint, from 0; None for the base.
    origins : tuple of (4, 4) array
        Pose of each moving link at position zero in the moving link that it stands on, or in the base.
    groups : tuple of tuple of Member
        Links that move with each joint, the moving link first.
    locked : mapping of str to float
        Positions of the locked joints (rad or m).
    mimics : mapping of str to (str, float, float)
        Driven joint, multiplier and offset of each coupled joint.
    """

    base: str
    tip: str
    base_pose: Array
    joints: tuple[UrdfJoint, ...]
    parents: tuple[int | None, ...]
    origins: tuple[Array, ...]
    groups: tuple[tuple[Member, ...], ...]
    locked: Mapping[str, float]
    mimics: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)

    @property
    def axes(self) -> tuple[Array, ...]:
        """Unit axis of each joint in its own moving link."""
        return tuple(joint.axis for joint in self.joints)

    @cached_property
    def frames(self) -> Mapping[str, Array]:
        """Frame (4, 4) of each moving link in the base at position zero, by name of the joint."""

        def frame(k: int) -> Array:
            parent = self.parents[k]
            return self.origins[k] if parent is None else frame(parent) @ self.origins[k]

        return {joint.name: frame(k) for k, joint in enumerate(self.joints)}

    @property
    def driven(self) -> tuple[UrdfJoint, ...]:
        """Joints that are not coupled to others."""
        return tuple(joint for joint in self.joints if joint.name not in self.mimics)

    def numbered(self) -> Chain:
        """Return the chain with driven joints numbered first, coupled ones last."""
        order = self.order
        places = {joint: column for column, joint in enumerate(order)}
        return replace(
            self,
            joints=tuple(self.joints[k] for k in order),
            parents=tuple(
                None if parent is None else places[parent] for parent in (self.parents[k] for k in order)
            ),
            origins=tuple(self.origins[k] for k in order),
            groups=tuple(self.groups[k] for k in order),
        )

    @property
    def order(self) -> tuple[int, ...]:
        """Joints in the order of their numbers."""
        return tuple(sorted(range(len(self.joints)), key=lambda k: (self.joints[k].name in self.mimics, k)))

    @property
    def pseudo_inertias(self) -> list[Array]:
        """Pseudo-inertia (4, 4) of each group in the frame of its moving link."""
        return [np.sum([member.pseudo for member in group], axis=0) for group in self.groups]


def choose_chain(
    description: Description,
    *,
    base: str | None = None,
    tip: str | None = None,
    lock: Mapping[str, float] | None = None,
) -> Chain:
    """Find the chain of a robot.

    Parameters
    ----------
    description : Description
        The URDF.
    base : str, optional
        First link, the root by default.
    tip : str, optional
        Last link; by default the end of an arm with a gripper, or else `WHOLE` for a tree.
    lock : mapping of str to float, optional
        Positions (rad or m) of joints to be locked; joints outside the chain are locked at zero by default.

    Raises
    ------
    RobotError
        For an unknown name, no moving joint or more than `MOST_JOINTS`, and unsupported joint types on the path to a `tip`.
    """
    where = description.where
    lock = dict(lock or {})
    joints = {joint.name: joint for joint in description.joints.values()}
    for name, value in lock.items():
        if name not in joints or not joints[name].moves:
            hint = did_you_mean(name, [joint.name for joint in joints.values() if joint.moves])
            raise RobotError(f"{where}: there is no moving joint {name!r} to lock{hint}")
        if not math.isfinite(value) or (joints[name].kind not in MOVING and value != 0.0):
            raise RobotError(
                f"{where}: joint {name!r} of type {joints[name].kind} cannot be locked at {value!r}"
            )
    for option, link in (("base", base), ("tip", tip)):
        if link is not None and link not in description.links and (option, link) != ("tip", WHOLE):
            hint = did_you_mean(link, description.links)
            raise RobotError(f"{where}: there is no link {link!r} ({option}){hint}")
    base = description.root if base is None else base
    tip = _tip(description, base, lock) if tip is None else tip
    path = _branches(description, base) if tip == WHOLE else description.path(base, tip)
    if path is None:
        raise RobotError(f"{where}: link {base!r} (base) does not carry link {tip!r} (tip)")
    moving = [joint for joint in path if _free(joint, lock)]
    mimics = _mimics(joints, moving, lock)
    moving = [joint for joint in moving if joint.mimic is None or joint.name in mimics]
    where = description.where
    if not moving:
        unmoved = [joint for joint in description.joints.values() if joint.moves and joint.kind not in MOVING]
        held = series([f"{joint.name} ({joint.kind})" for joint in unmoved], 80)
        why = f"; joints of this type are held: {held}" if unmoved else ""
        raise RobotError(f"{where}: no joint moves between base and tip{why}")
    if len(moving) > MOST_JOINTS:
        names = series((joint.name for joint in moving), 40)
        raise RobotError(
            f"{where}: a robot has at most {MOST_JOINTS} joints, not {len(moving)} ({names}); "
            "choose a part (--base, --tip), or lock joints (--lock)"
        )
    return replace(_assemble(description, base, tip, path, moving, lock), mimics=mimics)


def _mimics(
    joints: Mapping[str, UrdfJoint], moving: list[UrdfJoint], lock: dict[str, float]
) -> dict[str, tuple[str, float, float]]:
    """Return driven joint, multiplier and offset of each coupled joint; those with a locked leader join `lock`."""
    names = {joint.name for joint in moving}
    mimics: dict[str, tuple[str, float, float]] = {}
    for joint in joints.values():
        if joint.mimic is None or joint.kind not in MOVING or joint.name in lock:
            continue
        leader, factor, offset, seen = joint, 1.0, 0.0, {joint.name}
        # A leader may itself be coupled to another joint.
        while leader.mimic is not None and leader.name not in lock:
            offset += factor * leader.offset
            factor *= leader.multiplier
            if leader.mimic not in joints or leader.mimic in seen or factor == 0.0:
                factor = 0.0
                break
            leader = joints[leader.mimic]
            seen.add(leader.name)
        if factor and leader.name in names:
            if joint.name in names:
                mimics[joint.name] = (leader.name, factor, offset)
        else:
            value = offset + factor * lock.get(leader.name, 0.0)
            if value:
                lock[joint.name] = value
    return mimics


def _branches(description: Description, base: str) -> list[UrdfJoint]:
    """All joints that a link carries, branch by branch."""
    tree: list[UrdfJoint] = []
    waiting = list(reversed(description.outgoing.get(base, ())))
    while waiting:
        tree.append(waiting.pop())
        waiting += reversed(description.outgoing.get(tree[-1].child, ()))
    return tree


def _tip(description: Description, base: str, lock: Mapping[str, float]) -> str:
    """Return the last link of the only moving path from the base, or of the arm before its gripper; `WHOLE` for other trees."""
    # The largest number of moving joints on a path that begins with the parent joint of each link.
    reach: dict[str, int] = {}
    for link in reversed(description.order):
        beyond = max((reach[joint.child] for joint in description.outgoing.get(link, ())), default=0)
        reach[link] = beyond + (link in description.joints and _free(description.joints[link], lock))
    link = base
    seen = 0
    while True:
        moving = [joint for joint in description.outgoing.get(link, ()) if reach[joint.child]]
        if len(moving) > 1 and (seen < ARM or any(reach[joint.child] >= ARM for joint in moving)):
            return WHOLE
        if len(moving) != 1:
            return link
        seen += _free(moving[0], lock)
        link = moving[0].child


def _free(joint: UrdfJoint, lock: Mapping[str, float]) -> bool:
    return joint.kind in MOVING and joint.name not in lock


def _still(joint: UrdfJoint, lock: Mapping[str, float]) -> Array:
    """Pose of the child link in the parent link, the joint at its locked position."""
    return joint.origin @ joint.motion(lock.get(joint.name, 0.0))


def _assemble(
    description: Description,
    base: str,
    tip: str,
    path: list[UrdfJoint],
    moving: list[UrdfJoint],
    lock: Mapping[str, float],
) -> Chain:
    names = {joint.name for joint in moving}
    locked: dict[str, float] = {}

    def gather(link: str) -> tuple[Member, ...]:
        """All links that move with one, itself first."""
        group = [Member(link, np.eye(4), False, description.links[link])]
        for member in group:  # the list grows during the loop
            for joint in description.outgoing.get(member.link, ()):
                if joint.name in names:
                    continue
                if joint.moves:
                    locked[joint.name] = lock.get(joint.name, 0.0)
                frame = member.pose @ _still(joint, lock)
                inertial = description.links[joint.child]
                group.append(Member(joint.child, frame, member.locked or joint.moves, inertial))
        return tuple(group)

    origins: list[Array] = []
    groups: list[tuple[Member, ...]] = []
    parents: list[int | None] = []
    # The moving joint that carries each link, and the pose of the link in its moving link.
    carried: dict[str, tuple[int | None, Array]] = {base: (None, np.eye(4))}
    for joint in path:
        parent, frame = carried[joint.parent]
        if joint.name in names:
            origins.append(frame @ joint.origin)
            parents.append(parent)
            carried[joint.child] = (len(groups), np.eye(4))
            groups.append(gather(joint.child))
        else:
            carried[joint.child] = (parent, frame @ _still(joint, lock))
    base_pose = np.eye(4)
    for joint in description.path(description.root, base) or []:
        base_pose = base_pose @ _still(joint, lock)
    # Joints before the first moving one are locked too.
    for joint in path:
        if joint.moves and joint.name not in names:
            locked[joint.name] = lock.get(joint.name, 0.0)
    return Chain(
        base=base,
        tip=tip,
        base_pose=base_pose,
        joints=tuple(moving),
        parents=tuple(parents),
        origins=tuple(origins),
        groups=tuple(groups),
        locked=locked,
    )


def chain_of_names(path: Path, names: Sequence[str]) -> tuple[str, list[str]] | None:
    """Return last link and locked joints of the chain whose joints are named.

    Parameters
    ----------
    path : Path
        URDF.
    names : sequence of str
        Names in a log; they may contain the name of a joint: ``arm_1_joint_position``.

    Returns
    -------
    (str, list of str) or None
        Link behind the last named joint, and moving joints before it that are not named; None if no joint is named, or if the
        named joints do not lie on one chain.

    Raises
    ------
    RobotError
        When the file cannot be read.
    """
    description = read_description(path.read_bytes(), path.name)
    joints = {joint.name: joint for joint in description.joints.values() if joint.kind in MOVING}
    named = {joint_name for name in names if (joint_name := _longest(name, list(joints)))}
    best: list[tuple[str, list[str]]] = []
    for name in named:
        path_there = description.path(description.root, joints[name].child) or []
        moving = [joint.name for joint in path_there if joint.moves]
        if named <= set(moving):
            best.append((joints[name].child, [other for other in moving if other not in named]))
    return best[0] if len(best) == 1 else None


def _longest(name: str, joints: Sequence[str]) -> str | None:
    """Return the longest joint name in a text that is delimited by characters other than letters and digits."""
    there = [
        joint
        for joint in joints
        if re.search(rf"(?<![A-Za-z0-9]){re.escape(joint)}(?![A-Za-z0-9])", name, flags=re.IGNORECASE)
    ]
    return max(there, key=len, default=None)
