"""The serial chain of a URDF that becomes the robot, and the links that move with each of its joints.

Without a ``tip`` the chain follows, from the base on, the only child that moves anything. It ends where several do, as at the
fingers of a gripper; where one of those is an arm of its own, the user is asked. Links behind fixed joints belong to the moving
link that carries them, links behind other joints too, and those joints are locked. Tested in ``tests/test_urdf_chain.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import counted, did_you_mean
from ...errors import RobotError
from ..rigid_body import pose, turn
from .description import MOVING, Description, UrdfJoint

LARGEST_CHAIN = 12
"""Most joints of a robot."""

ARM = 3
"""Joints of a branch from which on it counts as an arm of its own, not as a finger."""


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
    """

    link: str
    pose: Array
    locked: bool


@dataclass(frozen=True, eq=False)
class Chain:
    """The joints of the robot, in order from the base.

    Attributes
    ----------
    base, tip : str
        First and last link.
    base_pose : (4, 4) array
        Pose of the base link in the root link, locked joints at their values.
    joints : tuple of UrdfJoint
        Moving joints.
    origins : tuple of (4, 4) array
        Pose of each moving link at position zero in the moving link before it (the base for the first).
    axes : tuple of (3,) array
        Unit axis of each joint in its own moving link.
    groups : tuple of tuple of Member
        Links that move with each joint, the moving link first.
    locked : mapping of str to float
        Positions of the joints that do not move although they could (rad or m).
    """

    base: str
    tip: str
    base_pose: Array
    joints: tuple[UrdfJoint, ...]
    origins: tuple[Array, ...]
    axes: tuple[Array, ...]
    groups: tuple[tuple[Member, ...], ...]
    locked: Mapping[str, float]

    def pseudo_inertias(self, description: Description) -> list[Array]:
        """Pseudo-inertia (4, 4) of each group in the frame of its moving link."""
        found = []
        for group in self.groups:
            total = np.zeros((4, 4))
            for member in group:
                inertial = description.links[member.link]
                if inertial is not None:
                    total += member.pose @ inertial.pseudo @ member.pose.T
            found.append(total)
        return found


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
        Last link; by default the end of the only path that moves.
    lock : mapping of str to float, optional
        Positions (rad or m) of joints that are to be locked; joints off the chain are locked at zero by default.

    Raises
    ------
    RobotError
        For an unknown name, several arms and no `tip`, no moving joint or more than 12, and joints that do not form a serial robot.
    """
    where = description.where
    lock = dict(lock or {})
    joints = {joint.name: joint for joint in description.joints.values()}
    for name, value in lock.items():
        if name not in joints or not joints[name].moves:
            hint = did_you_mean(name, [joint.name for joint in joints.values() if joint.moves])
            raise RobotError(f"{where}: there is no moving joint {name!r} to lock{hint}")
        if joints[name].kind not in MOVING or not math.isfinite(value):
            raise RobotError(
                f"{where}: joint {name!r} of type {joints[name].kind} cannot be locked at {value!r}"
            )
    for option, link in (("base", base), ("tip", tip)):
        if link is not None and link not in description.links:
            hint = did_you_mean(link, description.links)
            raise RobotError(f"{where}: there is no link {link!r} ({option}){hint}")
    base = description.root if base is None else base
    tip = _tip(description, base, lock) if tip is None else tip
    path = description.path(base, tip)
    if path is None:
        raise RobotError(f"{where}: link {base!r} (base) does not carry link {tip!r} (tip)")
    moving = [joint for joint in path if joint.moves and joint.name not in lock]
    _check_joints(where, moving)
    return _assemble(description, base, tip, path, moving, lock)


def _check_joints(where: str, moving: list[UrdfJoint]) -> None:
    for joint in moving:
        if joint.kind not in MOVING:
            raise RobotError(
                f"{where}: joint {joint.name!r} is {joint.kind}, and a serial robot has revolute and prismatic joints only; "
                "begin the chain behind it (didim robot --base) or end it before (didim robot --tip)"
            )
        if joint.mimic is not None:
            raise RobotError(
                f"{where}: joint {joint.name!r} mimics {joint.mimic!r}; lock it (didim robot --lock {joint.name}=0), or "
                "describe a motor that drives both as [transmission] coupling of the robot file"
            )
    if not moving:
        raise RobotError(f"{where}: no joint moves between base and tip")
    if len(moving) > LARGEST_CHAIN:
        names = ", ".join(joint.name for joint in moving)
        raise RobotError(
            f"{where}: a robot has at most {LARGEST_CHAIN} joints, and this chain has {len(moving)} ({names}); "
            "choose a part (didim robot --base --tip), or lock joints (didim robot --lock)"
        )


def _tip(description: Description, base: str, lock: Mapping[str, float]) -> str:
    """Last link of the only path that moves, followed from the base."""
    reach = _reach(description, lock)
    link = base
    seen = 0
    while True:
        moving = [joint for joint in description.outgoing.get(link, ()) if reach[joint.child]]
        if len(moving) > 1 and (not seen or any(reach[joint.child] >= ARM for joint in moving)):
            raise RobotError(
                f"{description.where}: several chains move ({_ends(description, base, lock)}); "
                "choose one by its last link: didim robot --tip LINK"
            )
        if len(moving) != 1:
            return link
        seen += _free(moving[0], lock)
        link = moving[0].child


def _free(joint: UrdfJoint, lock: Mapping[str, float]) -> bool:
    return joint.moves and joint.name not in lock


def _reach(description: Description, lock: Mapping[str, float]) -> dict[str, int]:
    """For each link, the most moving joints on a path that begins with the joint of which it is the child."""
    reach: dict[str, int] = {}
    for link in reversed(description.order):
        beyond = max((reach[joint.child] for joint in description.outgoing.get(link, ())), default=0)
        reach[link] = beyond + (link in description.joints and _free(description.joints[link], lock))
    return reach


def _ends(description: Description, base: str, lock: Mapping[str, float]) -> str:
    """Last moving links of all branches, each with the number of joints before it, longest first."""
    reach = _reach(description, lock)
    found: list[tuple[int, str]] = []
    walks = [(base, 0)]
    while walks:
        link, count = walks.pop()
        moving = [joint for joint in description.outgoing.get(link, ()) if reach[joint.child]]
        if not moving and count:
            found.append((count, link))
        walks += [(joint.child, count + _free(joint, lock)) for joint in reversed(moving)]
    found.sort(key=lambda end: -end[0])
    names = [f"{link} with {counted(count, 'joint')}" for count, link in found]
    return "; ".join(names if len(names) <= 8 else [*names[:8], f"and {len(names) - 8} more"])


def _still(joint: UrdfJoint, lock: Mapping[str, float]) -> Array:
    """Pose of the child link in the parent link, the joint at its locked position."""
    value = lock.get(joint.name, 0.0)
    if not value:
        return joint.origin
    motion = (
        pose(np.eye(3), value * joint.axis) if joint.kind == "prismatic" else pose(turn(joint.axis, value))
    )
    return joint.origin @ motion


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
        group = [Member(link, np.eye(4), False)]
        for member in group:  # which grows meanwhile
            for joint in description.outgoing.get(member.link, ()):
                if joint.name in names:
                    continue
                if joint.moves:
                    locked[joint.name] = lock.get(joint.name, 0.0)
                frame = member.pose @ _still(joint, lock)
                group.append(Member(joint.child, frame, member.locked or joint.moves))
        return tuple(group)

    origins, groups = [], []
    frame = np.eye(4)
    for joint in path:
        if joint.name in names:
            origins.append(frame @ joint.origin)
            frame = np.eye(4)
            groups.append(gather(joint.child))
        else:
            frame = frame @ _still(joint, lock)
    before = description.path(description.root, base) or []
    base_pose = np.eye(4)
    for joint in before:
        base_pose = base_pose @ _still(joint, lock)
    # Joints before the first moving one stand still as well.
    for joint in path:
        if joint.moves and joint.name not in names:
            locked[joint.name] = lock.get(joint.name, 0.0)
    return Chain(
        base=base,
        tip=tip,
        base_pose=base_pose,
        joints=tuple(moving),
        origins=tuple(origins),
        axes=tuple(joint.axis for joint in moving),
        groups=tuple(groups),
        locked=locked,
    )
