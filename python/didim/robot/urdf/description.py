"""Content of a URDF: links with their inertia; joints with their origin, axis, limits and friction.

Tested in ``tests/test_urdf.py``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import series
from ...errors import RobotError
from ..payload import LARGEST
from ..rigid_body import body_pseudo_inertia, pose, rotation_of, turn
from ..robot import JointLimits
from ..transmission import SOFTNESS, Actuator
from .xml_spans import Element, parse_xml

MOVING = ("revolute", "continuous", "prismatic")
"""Types of joints with one degree of freedom."""

GRAVITY = (0.0, 0.0, -9.81)
"""Gravity in the root link of a URDF (m/s^2)."""


KNOWN = (
    *MOVING,
    "fixed",
    "floating",
    "planar",
    "spherical",
    "ball",
    "universal",
    "screw",
    "gearbox",
    "revolute2",
)
"""Types of joints in descriptions; those that are neither fixed nor have one coordinate are fixed at zero."""

NOT_FINITE = ("nan", "inf", "infinity", "-nan(ind)", "nan(ind)", "1.#qnan", "1.#inf")
"""Spellings of nan and infinity by various programs (lower case, without sign)."""

IMPLICIT = "world"
"""Link that a joint may stand on without its element, as parsers of Gazebo and MuJoCo allow."""

EXPANDED = ("xacro:property", "xacro:arg")
"""Xacro elements that an expanded file may still contain, and that define neither links nor joints."""


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
    actuator : Actuator or None
        Gains and limit of the joint's drive, only in an MJCF.
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
    actuator: Actuator | None = None
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


@dataclass(frozen=True)
class Tendon:
    """A fixed tendon of an MJCF, of length ``sum of coefficient times q``: it moves with its joints.

    Attributes
    ----------
    name : str
        Its name, or that of the actuator whose rotor it stands for.
    coefficients : mapping of str to float
        By name of the joint (m/rad, or 1).
    armature, damping, friction, stiffness, rest : float
        As of a joint, per unit of its length; `rest` is its length without a force of the spring.
    """

    name: str
    coefficients: Mapping[str, float]
    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0


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
        Motors and springs that move with several joints, only in an MJCF.
    loops : tuple of Loop
        Constraints that close loops, only in an MJCF.
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


def read_description(data: bytes, where: str) -> Description:
    """Read a URDF.

    Parameters
    ----------
    data : bytes
        Content of the file.
    where : str
        Its name, which opens each message.

    Raises
    ------
    RobotError
        For XML that is broken or of another kind, a link or joint with missing elements, and links that do not form a tree.
    """
    outermost = parse_xml(data, where)
    if outermost.tag != "robot":
        kinds = {"sdf": "SDF", "mujoco": "MJCF", "mujocoinclude": "a part that an MJCF includes"}
        kind = kinds.get(outermost.tag, f"<{outermost.tag}>")
        raise RobotError(f"{where}: this is {kind}, a URDF has <robot> outermost")
    macros = [
        child.tag
        for child in outermost.children
        if child.tag.startswith("xacro:") and child.tag not in EXPANDED
    ]
    if not macros:
        return _tree(outermost, where)
    try:
        description = _tree(outermost, where)
    except RobotError:
        description = None
    complete = description is not None and len(description.links) == len(description.joints) + 1
    if description is None or not complete or not any(j.kind in MOVING for j in description.joints.values()):
        raise RobotError(
            f"{where}: it has xacro macros ({macros[0]}); expand it first: xacro {where} > arm.urdf"
        )
    note = f"xacro macros that were not expanded are left out: {series(dict.fromkeys(macros), 60)}"
    return replace(description, notes=(*description.notes, note))


def _tree(outermost: Element, where: str) -> Description:
    """Read links and joints."""
    links: dict[str, Inertial | None] = {}
    notes: list[str] = []
    for element in outermost.all("link"):
        name = _name(element, where)
        if name in links:
            raise RobotError(f"{where}: line {element.line}: there are two links {name!r}")
        inertial = element.find("inertial")
        lacks = inertial and _lacks(inertial)
        links[name] = None if inertial is None or lacks else _inertial(inertial, f"{where}: link {name!r}:")
        if lacks:
            notes.append(f"the <inertial> of link {name} is left out: {lacks}")
    joints: dict[str, UrdfJoint] = {}
    names: set[str] = set()
    for element in outermost.all("joint"):
        joint = _joint(element, where)
        if joint.parent == IMPLICIT:
            links.setdefault(IMPLICIT, None)
        for end in (joint.parent, joint.child):
            if end not in links:
                raise RobotError(f"{where}: joint {joint.name!r}: there is no link {end!r}")
        if joint.name in names:
            raise RobotError(f"{where}: line {element.line}: there are two joints {joint.name!r}")
        if joint.child in joints:
            raise RobotError(
                f"{where}: link {joint.child!r} is the child of two joints, {joints[joint.child].name!r} and {joint.name!r}"
            )
        names.add(joint.name)
        joints[joint.child] = joint
    roots = [name for name in links if name not in joints]
    if not links:
        raise RobotError(f"{where}: it has no <link>")
    if not roots:
        raise RobotError(f"{where}: its links must be one tree, and it has no link without a parent")
    name = outermost.attributes.get("name", "")
    description = Description(where, name, links, joints, roots[0])
    reached = set(description.order)
    lost = [link for link in links if link not in reached]
    if lost:
        raise RobotError(f"{where}: link {lost[0]!r} is its own ancestor; its links must be one tree")
    return _of_largest_tree(description, roots, notes)


def _of_largest_tree(description: Description, roots: list[str], notes: list[str]) -> Description:
    """Choose the root with the most moving joints, the first of several; a note reports the other trees, which are ignored."""
    if len(roots) > 1:
        moving = {
            root: sum(
                description.joints[link].kind in MOVING
                for link in description.carried(root)
                if link in description.joints
            )
            for root in roots
        }
        root = max(roots, key=lambda root: moving[root])
        others = [other for other in roots if other != root]
        left = series(others, 60)
        notes = [
            *notes,
            f"the robot stands on link {root}; no joint holds {left}, left out (--base takes another)",
        ]
        description = replace(description, root=root)
    return replace(description, notes=tuple(notes))


def _name(element: Element, where: str) -> str:
    name = element.attributes.get("name", "")
    if not name:
        raise RobotError(f"{where}: line {element.line}: <{element.tag}> has no name")
    return name


def _numbers(element: Element | None, key: str, default: tuple[float, ...], where: str) -> tuple[float, ...]:
    text = element.attributes.get(key) if element is not None else None
    if element is None or text is None:
        return default
    try:
        # Some exporters write commas between the numbers.
        values = tuple(float(word) for word in re.split(r"\s*,\s*|\s+", text.strip()))
    except ValueError:
        values = ()
    if len(values) != len(default) or not all(abs(value) <= LARGEST for value in values):
        wanted = "a number" if len(default) == 1 else f"{len(default)} numbers"
        if "${" in text or "$(" in text:
            file = where.partition(":")[0]
            raise RobotError(
                f"{where} {key} of <{element.tag}> is {text!r}; expand the file first: xacro {file} > arm.urdf"
            )
        raise RobotError(
            f"{where} {key} of <{element.tag}> must be {wanted} of at most {LARGEST:g}, got {text!r}"
        )
    return values


def _bound(limit: Element, key: str, where: str) -> float | None:
    """Return a number of a ``<limit>``; None if it is so large that it means no limit."""
    text = limit.attributes[key]
    try:
        value = float(text)
    except ValueError:
        raise RobotError(f"{where} {key} of <limit> must be a number, got {text!r}") from None
    return value if abs(value) <= LARGEST else None


def _limit(limit: Element | None, key: str, where: str) -> float | None:
    """Return a limit of speed or effort; None if it is missing or zero."""
    if limit is None or key not in limit.attributes:
        return None
    value = _bound(limit, key, where)
    return value if value is not None and value > 0.0 else None


def _number(element: Element | None, key: str, where: str) -> float:
    """Return a number; zero where the element or its attribute is absent."""
    return _numbers(element, key, (0.0,), where)[0]


def _lacks(inertial: Element) -> str | None:
    """Return the missing part of an ``<inertial>``, or None if it is complete: exporters may write half of it, or NaN."""
    wanted = {"mass": ("value",), "inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")}
    for tag, keys in wanted.items():
        element = inertial.find(tag)
        for key in keys:
            text = element.attributes.get(key) if element is not None else None
            if text is None and key in ("value", "ixx", "iyy", "izz"):
                return f"it has no <{tag} {key}=...>"
            if text is not None and text.strip().lower().lstrip("+-") in NOT_FINITE:
                return f"{key} of <{tag}> is {text.strip()}"
    return None


def frame_of(element: Element, where: str) -> Array:
    """Return the pose (4, 4) of an element with an ``<origin>``, of which both parts may be missing."""
    origin = element.find("origin")
    zero = (0.0, 0.0, 0.0)
    return pose(rotation_of(_numbers(origin, "rpy", zero, where)), _numbers(origin, "xyz", zero, where))


def _inertial(element: Element, where: str) -> Inertial:
    mass, inertia = element.find("mass"), element.find("inertia")
    diagonal = [_number(inertia, key, where) for key in ("ixx", "iyy", "izz")]
    xy, xz, yz = (_number(inertia, key, where) for key in ("ixy", "ixz", "iyz"))
    return Inertial(
        mass=_number(mass, "value", where),
        frame=frame_of(element, where),
        inertia=np.diag(diagonal) + np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]]),
    )


def _joint(element: Element, where: str) -> UrdfJoint:
    name = _name(element, where)
    where = f"{where}: joint {name!r}:"
    kind = element.attributes.get("type", "")
    if kind not in KNOWN:
        raise RobotError(f"{where} its type must be revolute, continuous, prismatic or fixed, got {kind!r}")
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        link = end.attributes.get("link", "") if end is not None else ""
        if not link:
            raise RobotError(f"{where} it has no <{tag} link=...>")
        ends.append(link)
    axis = np.array(_numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), where))
    length = float(np.linalg.norm(axis))
    if kind in MOVING and not length > 0.0:
        kind = f"{kind} about no axis"  # fixed at zero, as joints of unknown type
    limit, dynamics, mimic = (element.find(tag) for tag in ("limit", "dynamics", "mimic"))
    position = None
    if kind != "continuous" and limit is not None and {"lower", "upper"} <= set(limit.attributes):
        lower, upper = (_bound(limit, key, where) for key in ("lower", "upper"))
        if lower is not None and upper is not None and lower < upper:
            position = lower, upper
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=ends[0],
        child=ends[1],
        origin=frame_of(element, where),
        axis=axis / length if length > 0.0 else axis,
        limits=JointLimits(
            position=position,
            velocity=_limit(limit, "velocity", where),
            effort=_limit(limit, "effort", where),
        ),
        damping=_number(dynamics, "damping", where),
        friction=_number(dynamics, "friction", where),
        mimic=mimic.attributes.get("joint", "") if mimic is not None else None,
        multiplier=_numbers(mimic, "multiplier", (1.0,), where)[0],
        offset=_number(mimic, "offset", where),
    )
