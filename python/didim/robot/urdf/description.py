"""Content of a URDF: links with their inertia; joints with their origin, axis, limits and friction.

Tested in ``tests/test_urdf.py``.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import series
from ...errors import RobotError
from ..payload import LARGEST
from ..rigid_body import pose, rotation_of
from ..robot import JointLimits
from .mechanism import MOVING, Description, Inertial, UrdfJoint
from .xml_spans import Element, parse_xml

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
    beside, within = _macros(outermost)
    if not beside and not within:
        return _tree(outermost, where)
    try:
        description = None if within else _tree(outermost, where)
    except RobotError:
        description = None
    complete = description is not None and len(description.links) == len(description.joints) + 1
    if description is None or not complete or not any(j.kind in MOVING for j in description.joints.values()):
        raise RobotError(
            f"{where}: it has xacro macros ({[*within, *beside][0]}); expand it first: xacro {where} > arm.urdf"
        )
    note = f"xacro macros that were not expanded are left out: {series(dict.fromkeys(beside), 60)}"
    return replace(description, notes=(*description.notes, note))


def _macros(outermost: Element) -> tuple[list[str], list[str]]:
    """Return the xacro elements beside all that a robot is made of, and those that may stand for a value of it.

    A link with an ``<inertial>`` needs no more; what is in its shapes has no part in a robot.
    """
    beside: list[str] = []
    within: list[str] = []
    for part in outermost.children:
        whole = part.tag not in ("link", "joint") or part.find("inertial") is not None
        waiting = [part] if part.tag.startswith("xacro:") else part.children * (part.tag in ("link", "joint"))
        for top in waiting:
            found = beside if whole and top.tag != "inertial" else within
            below = [top]
            for element in below:  # which grows meanwhile
                if element.tag.startswith("xacro:"):
                    found += [element.tag] * (element.tag not in EXPANDED)
                elif element.tag not in ("visual", "collision"):
                    below += element.children
    return beside, within


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
            file = where.partition(": ")[0]  # a drive of Windows has a colon, too
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
