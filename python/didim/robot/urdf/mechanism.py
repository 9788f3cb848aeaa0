"""A mechanism as a robot file describes it: a tree of links and joints, and what of an MJCF ties them together.

Tested in ``tests/test_urdf.py`` and ``tests/test_mjcf.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..._tools.arrays import Array
from ..rigid_body import body_pseudo_inertia, pose, turn
from ..robot import JointLimits
from ..transmission import SOFTNESS

MOVING = ("revolute", "continuous", "prismatic")
"""Types of joints with one degree of freedom."""

UNLIMITED = (-np.inf, np.inf)
"""Limits of a force that has none."""

GRAVITY = (0.0, 0.0, -9.81)
"""Gravity in the root link of a URDF (m/s^2)."""


@dataclass(frozen=True, eq=False)
class Inertial:
    """The ``<inertial>`` of a link.

    Attributes
    ----------
    mass : float
        Mass (kg).
    frame : (4, 4) array
        Pose of the inertial frame, at the centre of mass, in the link's frame.
    inertia : (3, 3) array
        Inertia about the centre of mass in the inertial frame (kg.m^2).
    """

    mass: float
    frame: Array
    inertia: Array

    @property
    def pseudo(self) -> Array:
        """Pseudo-inertia (4, 4) in the link's frame."""
        return body_pseudo_inertia(self.mass, self.inertia, self.frame)


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint of a URDF.

    Attributes
    ----------
    name, kind, parent, child : str
        As the file has them.
    origin : (4, 4) array
        Pose of the child link's frame in the parent link's, at position zero.
    axis : (3,) array
        Unit vector in the child link's frame.
    limits : JointLimits
        Limits; None where the file has none, or a zero in its place.
    damping, friction : float
        Viscous (N.m.s/rad or N.s/m) and Coulomb (N.m or N) friction.
    mimic : str or None
        Name of its leader; an empty name for a locked joint.
    multiplier, offset : float
        The position is the multiplier times that of the leader, plus the offset (rad or m).
    armature : float
        Rotor inertia (kg.m^2 or kg), only in an MJCF.
    stiffness, rest : float
        Spring of the joint (N.m/rad or N/m), and its position (rad or m) without a torque, only in an MJCF.
    zero : float
        Position (rad or m) at which an MJCF draws the joint.
    forces : (float, float)
        Limits of the torque (N.m or N) of all actuators on the joint, only in an MJCF.
    softness : (float, float)
        Creep and rest (s) of its friction loss, `didim.robot.transmission.softness`.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Array
    axis: Array
    limits: JointLimits = field(default_factory=JointLimits)
    damping: float = 0.0
    friction: float = 0.0
    mimic: str | None = None
    multiplier: float = 1.0
    offset: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    zero: float = 0.0
    forces: tuple[float, float] = UNLIMITED
    softness: tuple[float, float] = SOFTNESS

    @property
    def moves(self) -> bool:
        """Whether its type has a degree of freedom, driven or coupled."""
        return self.kind != "fixed"

    def motion(self, position: float) -> Array:
        """Return the motion of its child (4, 4) to a position (rad or m); types without one coordinate stay."""
        if self.kind == "prismatic":
            return pose(np.eye(3), position * self.axis)
        return pose(turn(self.axis, position)) if self.kind in MOVING else np.eye(4)


@dataclass(frozen=True, kw_only=True)
class Servo:
    """An actuator of an MJCF, per unit of the length that it pulls: ``kp (slope command + offset - length) - kv speed``.

    Attributes
    ----------
    kp : float
        Gain on the length; zero for torques and velocity servos.
    kv : float or None
        Gain on the speed; None where the file lacks what it depends on.
    forces : (float, float)
        Limits of its force.
    lag_s : float
        Time constant of the filter of the command (s).
    slope, offset : float
        From the command to the length, without kp the speed, that it steers to.
    linear : bool
        Whether it is a torque, position or velocity servo; a robot has no other actuator.
    """

    kp: float = 0.0
    kv: float | None = 0.0
    forces: tuple[float, float] = UNLIMITED
    lag_s: float = 0.0
    slope: float = 1.0
    offset: float = 0.0
    linear: bool = True


@dataclass(frozen=True)
class Tendon:
    """A fixed tendon of an MJCF, of length ``sum of coefficient times q``: it moves with its joints.

    Attributes
    ----------
    name : str
        Its name, or that of an actuator.
    coefficients : mapping of str to float
        By name of the joint (m/rad, or 1); none where the length is another function.
    armature, damping, friction, stiffness, rest : float
        As of a joint, per unit of its length; `rest` is its length without a force of the spring.
    servo : Servo or None
        The actuator.
    """

    name: str
    coefficients: Mapping[str, float]
    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    servo: Servo | None = None


@dataclass(frozen=True)
class Loop:
    """A constraint of an MJCF that a tree does not have: it ties two links, or joints.

    Attributes
    ----------
    name : str
        Name or kind of the constraint.
    links : tuple of str
        The two links; empty where it ties joints.
    joints : tuple of str
        The joints.
    """

    name: str
    links: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Description:
    """A URDF: a tree of links.

    Attributes
    ----------
    where : str
        Name of the file, which opens messages.
    name : str
        Name of the robot.
    links : mapping of str to Inertial or None
        Inertia by name of the link.
    joints : mapping of str to UrdfJoint
        Joint by the name of its child link.
    root : str
        The link without a parent.
    gravity : tuple of float
        Acceleration of gravity in the root (m/s^2): a URDF has its z axis point up.
    notes : tuple of str
        Sentences on ignored parts of the file.
    tendons : tuple of Tendon
        Tendons and actuators, only in an MJCF.
    loops : tuple of Loop
        Constraints that close loops, only in an MJCF.
    gravcomp : mapping of str to float
        Share of its weight that a link does not feel, only in an MJCF.
    incomplete : tuple of str
        Links whose mass comes from meshes that cannot be read, only in an MJCF.
    """

    where: str
    name: str
    links: Mapping[str, Inertial | None]
    joints: Mapping[str, UrdfJoint]
    root: str
    gravity: tuple[float, ...] = GRAVITY
    notes: tuple[str, ...] = ()
    tendons: tuple[Tendon, ...] = ()
    loops: tuple[Loop, ...] = ()
    gravcomp: Mapping[str, float] = field(default_factory=dict)
    incomplete: tuple[str, ...] = ()

    @cached_property
    def outgoing(self) -> Mapping[str, tuple[UrdfJoint, ...]]:
        """Joints by the name of their parent link, in the order of the file."""
        outgoing: dict[str, tuple[UrdfJoint, ...]] = {}
        for joint in self.joints.values():
            outgoing[joint.parent] = (*outgoing.get(joint.parent, ()), joint)
        return outgoing

    @cached_property
    def order(self) -> tuple[str, ...]:
        """Links of the root's tree, each after its parent; then those of other roots."""
        others = [link for link in self.links if link not in self.joints and link != self.root]
        return tuple(self.carried(self.root, *others))

    def carried(self, *links: str) -> list[str]:
        """Return links and their descendants, each after its parent."""
        links_carried = list(links)
        for link in links_carried:  # which grows meanwhile
            links_carried += [joint.child for joint in self.outgoing.get(link, ())]
        return links_carried

    def path(self, base: str, tip: str) -> list[UrdfJoint] | None:
        """Return the joints from a link to a descendant, or None if it is not one."""
        joints = []
        link = tip
        while link != base:
            if link not in self.joints:
                return None
            joints.append(self.joints[link])
            link = joints[-1].parent
        return joints[::-1]
