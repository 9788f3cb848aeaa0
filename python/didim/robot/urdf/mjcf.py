"""Content of an MJCF as the description of a URDF: bodies with inertia; joints with axis, limits, rotor, friction and spring.

Defaults and classes, the compiler's angles and ``include`` are resolved here. A body with several joints becomes several links,
the last of which has the inertia; free and ball joints are fixed, and so are joints nailed down by their damping. Inertias that
MuJoCo computes from meshes are not supported.
Tested in ``tests/test_mjcf.py`` against MuJoCo.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..._tools.arrays import Array
from ..._tools.inputs import read_small_file
from ..._tools.words import brief, counted, series
from ...errors import RobotError
from ..payload import LARGEST
from ..rigid_body import central, pose, skew, turn
from ..robot import JointLimits
from ..transmission import IMPEDANCE, LARGEST_IMPEDANCE, TIME_CONSTANT_S, softness
from .actuators import read_actuators
from .description import GRAVITY, Description, Inertial, UrdfJoint
from .mjcf_sections import Compiler, Defaults, compiler_of, defaults_of, sprung_tendons, tied, world_notes
from .solids import along, direction_of, solid_inertial
from .xml_spans import Element, parse_xml

WORLD = "world"
"""Name of MuJoCo's outermost body."""

KINDS = {"hinge": "revolute", "slide": "prismatic", "ball": "spherical", "free": "floating"}
"""URDF name of each MJCF joint type."""

LEAST_IMPEDANCE = 1e-4
"""Distance of MuJoCo's impedances from 0 and 1."""
UNREAD = ("replicate", "composite", "flexcomp", "attach")
"""Elements that generate bodies and are not supported by this reader."""


@dataclass
class Reader:
    """The bodies of a file, collected link by link."""

    where: str
    compiler: Compiler
    defaults: Defaults
    links: dict[str, Inertial | None] = field(default_factory=dict)
    joints: dict[str, UrdfJoint] = field(default_factory=dict)
    meshes: list[str] = field(default_factory=list)
    curved: list[str] = field(default_factory=list)
    own_limits: dict[str, float] = field(default_factory=dict)
    elements: dict[str, Element] = field(default_factory=dict)

    def angle(self, value: float) -> float:
        """Angle of the file in rad."""
        return math.radians(value) if self.compiler.degrees else value

    def attributes(self, element: Element, childclass: str) -> dict[str, str]:
        """Return the attributes of an element; its own override those of its class."""
        name = element.attributes.get("class", childclass)
        if name not in self.defaults:
            raise RobotError(f"{self.where}: line {element.line}: there is no default class {name!r}")
        return {**self.defaults[name].get(element.tag, {}), **element.attributes}

    def numbers(self, element: Element, attributes: Mapping[str, str], key: str, *default: float) -> Array:
        """Return the numbers of an attribute, as many as its default has."""
        text = attributes.get(key)
        if text is None:
            return np.array(default)
        try:
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = np.array([np.nan])
        if len(values) != len(default) or not (np.abs(values) <= LARGEST).all():
            raise RobotError(
                f"{self.where}: line {element.line}: {key} of <{element.tag}> must be {counted(len(default), 'number')} "
                f"of at most {LARGEST:g}, got {text!r}"
            )
        return values

    def frame(self, element: Element, attributes: Mapping[str, str]) -> Array:
        """Pose (4, 4) of an element in its parent, from ``pos`` and one of the five orientations."""
        position = self.numbers(element, attributes, "pos", 0.0, 0.0, 0.0)
        return pose(self._rotation(element, attributes), position)

    def _rotation(self, element: Element, attributes: Mapping[str, str]) -> Array:
        if "quat" in attributes:
            return _of_quaternion(self.numbers(element, attributes, "quat", 1.0, 0.0, 0.0, 0.0))
        if "axisangle" in attributes:
            four = self.numbers(element, attributes, "axisangle", 0.0, 0.0, 1.0, 0.0)
            return turn(direction_of(four[:3]), self.angle(float(four[3])))
        if "euler" in attributes:
            rotation = np.eye(3)
            angles = self.numbers(element, attributes, "euler", 0.0, 0.0, 0.0)
            for letter, angle in zip(self.compiler.eulerseq, angles, strict=True):
                step = turn(np.eye(3)["xyz".index(letter.lower())], self.angle(float(angle)))
                rotation = rotation @ step if letter.islower() else step @ rotation
            return rotation
        if "xyaxes" in attributes:
            six = self.numbers(element, attributes, "xyaxes", 1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
            x = direction_of(six[:3])
            y = direction_of(six[3:] - (six[3:] @ x) * x)
            return np.column_stack([x, y, np.cross(x, y)])
        if "zaxis" in attributes:
            return along(direction_of(self.numbers(element, attributes, "zaxis", 0.0, 0.0, 1.0)))
        return np.eye(3)

    def walk(self, parent: Element, link: str, before: Array, childclass: str) -> None:
        """Read the bodies on a link; `before` is the pose of the element's frame in that of the link."""
        for element in parent.children:
            if element.tag in UNREAD:
                raise RobotError(
                    f"{self.where}: line {element.line}: <{element.tag}> is not read; let MuJoCo write the file out "
                    "(mj_saveLastXML)"
                )
            own = element.attributes.get("childclass", childclass)
            if element.tag == "frame":
                self.walk(element, link, before @ self.frame(element, element.attributes), own)
            elif element.tag == "body":
                self.body(element, link, before @ self.frame(element, element.attributes), own)

    def body(self, body: Element, parent: str, origin: Array, childclass: str) -> None:
        """Read a body: one link per joint, the last of which is the body itself."""
        name = body.attributes.get("name", f"body_{len(self.links)}")
        if name in self.links:
            raise RobotError(f"{self.where}: line {body.line}: there are two bodies {name!r}")
        joints = [child for child in body.children if child.tag in ("joint", "freejoint")]
        # Each joint turns about an anchor, where the intermediate links have their frames.
        for number, element in enumerate(joints, start=1):
            joint, anchor = self._joint(element, name, number, len(joints), childclass)
            last = number == len(joints) and not anchor.any()
            child = name if last else f"{name}/{joint.name}"
            # The file draws a joint at its reference position.
            at_zero = origin @ pose(np.eye(3), anchor) @ joint.motion(-joint.zero)
            self._connect(joint, parent, child, at_zero)
            parent, origin = child, pose(np.eye(3), -anchor)
        if parent != name:
            nothing = UrdfJoint(f"{name}_fixed", "fixed", "", "", np.eye(4), np.array([0.0, 0.0, 1.0]))
            self._connect(nothing, parent, name, origin)
        self.links[name] = self._inertial(body, name, childclass)
        self.walk(body, name, np.eye(4), childclass)

    def _connect(self, joint: UrdfJoint, parent: str, child: str, origin: Array) -> None:
        joint = replace(joint, parent=parent, child=child, origin=origin)
        if any(other.name == joint.name for other in self.joints.values()):
            raise RobotError(f"{self.where}: there are two joints {joint.name!r}")
        self.links.setdefault(child, None)
        self.joints[child] = joint

    def _joint(
        self, element: Element, body: str, number: int, count: int, childclass: str
    ) -> tuple[UrdfJoint, Array]:
        """Return a joint without parent and child, and its anchor in the body's frame."""
        free = element.tag == "freejoint"
        given = {"type": "free", **element.attributes} if free else self.attributes(element, childclass)
        kind = KINDS.get(given.get("type", "hinge"))
        if kind is None:
            raise RobotError(
                f"{self.where}: line {element.line}: a joint is a hinge or a slide, got type {given['type']!r}"
            )
        name = given.get("name") or (f"{body}_joint" if count == 1 else f"{body}_joint{number}")
        turns = kind == "revolute"
        self.elements[name] = element

        def number_of(key: str) -> float:
            return float(self.numbers(element, given, key, 0.0)[0])

        # MuJoCo takes polynomials here; the first coefficient is the linear one.
        for key in ("stiffness", "damping"):
            first, *others = given.get(key, "0").split() or ["0"]
            given[key] = first
            if any(word.strip("0.") for word in others):
                self.curved.append(f"{key} of {name}")
        nailed = _beyond(given["damping"])
        if nailed:
            kind, given["damping"] = f"{kind} with a damping of {given['damping']}", "0"

        scale = self.angle(1.0) if turns else 1.0
        low, high = scale * self.numbers(element, given, "range", 0.0, 0.0)
        limited = given.get("limited", "auto")
        bounded = low < high and (limited == "true" or (limited == "auto" and self.compiler.autolimits))
        low_force, high_force = self.numbers(element, given, "actuatorfrcrange", 0.0, 0.0)
        if low_force < high_force and given.get("actuatorfrclimited", "auto") != "false":
            self.own_limits[name] = float(max(-low_force, high_force))
        joint = UrdfJoint(
            name=name,
            kind=kind,
            parent="",
            child="",
            origin=np.eye(4),
            axis=direction_of(self.numbers(element, given, "axis", 0.0, 0.0, 1.0)),
            limits=JointLimits(position=(float(low), float(high)) if bounded else None),
            damping=number_of("damping"),
            friction=number_of("frictionloss"),
            armature=number_of("armature"),
            stiffness=number_of("stiffness"),
            rest=scale * number_of("springref"),
            zero=0.0 if nailed else scale * number_of("ref"),
            softness=self._softness(element, given),
        )
        anchored = kind in ("revolute", "prismatic")
        return joint, self.numbers(element, given, "pos", 0.0, 0.0, 0.0) if anchored else np.zeros(3)

    def _softness(self, element: Element, given: Mapping[str, str]) -> tuple[float, float]:
        """Return creep and rest (s) of a joint's friction loss, `didim.robot.transmission.softness`.

        Two negative numbers of ``solreffriction`` are stiffness and damping, and friction takes the damping. Of a positive and a
        negative one MuJoCo takes neither, but its defaults.
        """

        def first_of(key: str, *usual: float) -> tuple[float, float]:
            words = given.get(key, "").split()[:2]
            numbers = self.numbers(
                element, {key: " ".join(words)} if words else {}, key, *usual[: len(words) or 2]
            )
            first, second = np.append(numbers, usual[len(numbers) :])
            return float(first), float(second)

        limit = LEAST_IMPEDANCE
        least, largest = np.clip(first_of("solimpfriction", IMPEDANCE, LARGEST_IMPEDANCE), limit, 1.0 - limit)
        time, damping = first_of("solreffriction", TIME_CONSTANT_S, 1.0)
        if (time > 0.0) != (damping > 0.0):
            time, damping = TIME_CONSTANT_S, 1.0
        return softness(
            float(least), float(largest), time if time > 0.0 else 2.0 / max(-damping, 1.0 / LARGEST)
        )

    def _inertial(self, body: Element, name: str, childclass: str) -> Inertial | None:
        element = body.find("inertial")
        geoms = self._geoms(body, np.eye(4), childclass)
        if self.compiler.from_geoms == "true" or (element is None and self.compiler.from_geoms == "auto"):
            solids = []
            for geom, frame in geoms:
                given = self.attributes(geom, childclass)
                first, last = self.compiler.groups
                if not first <= self.numbers(geom, given, "group", 0.0)[0] <= last:
                    continue
                if given.get("type") == "mesh" or "mesh" in given:
                    self.meshes.append(name)
                else:
                    solids.append(solid_inertial(given, frame, f"{self.where}: line {geom.line}:"))
            return _together(solids)
        if element is None:
            return None
        own = element.attributes
        mass = float(self.numbers(element, own, "mass", 0.0)[0])
        if "fullinertia" in own:
            xx, yy, zz, xy, xz, yz = self.numbers(element, own, "fullinertia", *[0.0] * 6)
            inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        else:
            inertia = np.diag(self.numbers(element, own, "diaginertia", 0.0, 0.0, 0.0))
        return Inertial(mass=mass, frame=self.frame(element, own), inertia=inertia)

    def _geoms(self, parent: Element, before: Array, childclass: str) -> Iterator[tuple[Element, Array]]:
        for element in parent.children:
            if element.tag == "geom":
                yield element, before @ self.frame(element, self.attributes(element, childclass))
            elif element.tag == "frame":
                yield from self._geoms(element, before @ self.frame(element, element.attributes), childclass)


def read_mjcf(data: bytes, path: Path) -> Description:
    """Read an MJCF.

    Parameters
    ----------
    data : bytes
        Content of the file.
    path : Path
        The file, whose name prefixes each message; included files are relative to its folder.

    Raises
    ------
    RobotError
        For XML that is broken, wrong numbers, unknown classes, and elements that generate bodies.
    """
    where = path.name
    outermost, sections, reader = walked(data, path)
    gravity = np.array(GRAVITY)
    for section in sections:
        if section.tag == "option":
            gravity = reader.numbers(section, section.attributes, "gravity", *gravity)
    weightless, notes = world_notes(sections)
    gravity = 0.0 * gravity if weightless else gravity
    actuators, unread = read_actuators(sections, reader.own_limits, reader.compiler.autolimits, where)
    driven = dict(reader.joints)
    for child, joint in reader.joints.items():
        if (actuator := actuators.get(joint.name)) is not None:
            limits = replace(joint.limits, effort=actuator.effort)
            driven[child] = replace(joint, actuator=actuator, limits=limits)
    joints = tied(sections, driven, where)
    links = reader.links
    if reader.meshes:
        names = series(dict.fromkeys(reader.meshes))
        notes.append(f"inertias of meshes are not computed: {names} (MuJoCo writes them: mj_saveLastXML)")
    elif reader.compiler.total_mass:
        links = _scaled(links, reader.compiler.total_mass)
    if reader.curved:
        notes.append(f"nonlinear parts are left out: {series(reader.curved)}")
    if tendons := sprung_tendons(sections, reader.defaults):
        notes.append(f"springs of tendons are left out: {series(tendons)}")
    if unread:
        notes.append(f"not read: {brief('; '.join(unread), 120)}")
    name = outermost.attributes.get("model", "")
    return Description(where, name, links, joints, WORLD, tuple(float(g) for g in gravity), tuple(notes))


def walked(data: bytes, path: Path) -> tuple[Element, list[Element], Reader]:
    """Return the outermost element of an MJCF, its sections with those of included files, and the reader of its bodies.

    Raises
    ------
    RobotError
        As for `read_mjcf`.
    """
    where = path.name
    outermost = parse_xml(data, where)
    sections = _included(outermost, path, (path,))
    reader = Reader(where, compiler_of(sections, where), defaults_of(sections))
    reader.links[WORLD] = None
    for section in sections:
        if section.tag == "worldbody":
            reader.walk(section, WORLD, np.eye(4), section.attributes.get("childclass", "main"))
    if not reader.joints:
        raise RobotError(f"{where}: it has no <body>")
    return outermost, sections, reader


def _included(element: Element, main: Path, above: tuple[Path, ...]) -> list[Element]:
    """Return what is inside an element of the last file of `above`, with the content of included files at any depth.

    As in MuJoCo, the names of included files are relative to the folder of the main file.
    """
    file, inside = above[-1], []
    for child in element.children:
        if child.tag == "include":
            part = main.parent / child.attributes.get("file", "")
            where = f"{file.name}: line {child.line}"
            if part in above:
                raise RobotError(f"{where}: {part.name} includes itself")
            try:
                data = read_small_file(part, RobotError)
            except RobotError as reason:
                raise RobotError(f"{where}: {reason}") from None
            inside += _included(parse_xml(data, part.name), main, (*above, part))
            continue
        content = _included(child, main, above)
        # Elements without includes stay themselves: an export looks for them in their file.
        same = len(content) == len(child.children) and all(map(operator.is_, content, child.children))
        inside.append(child if same else replace(child, children=content))
    return inside


def _beyond(text: str) -> bool:
    """Whether a damping is finite and beyond the largest number of a parameter: the joint is meant to stand still."""
    try:
        return LARGEST < float(text) < math.inf
    except ValueError:
        return False


def _together(inertials: list[Inertial]) -> Inertial | None:
    """Return the sum of several inertials about their common centre of mass."""
    if not sum(inertial.mass for inertial in inertials) > 0.0:
        return None
    mass, centre, inertia = central(np.sum([inertial.pseudo for inertial in inertials], axis=0))
    return Inertial(mass=mass, frame=pose(np.eye(3), centre), inertia=inertia)


def _scaled(links: Mapping[str, Inertial | None], mass: float) -> dict[str, Inertial | None]:
    """Return the bodies scaled to a total mass (kg)."""
    ratio = mass / (sum(body.mass for body in links.values() if body is not None) or math.inf)
    return {
        name: body and replace(body, mass=ratio * body.mass, inertia=ratio * body.inertia)
        for name, body in links.items()
    }


def _of_quaternion(values: Array) -> Array:
    w, *vector = direction_of(values)
    cross = skew(vector)
    return np.asarray(np.eye(3) + 2.0 * (w * cross + cross @ cross))
