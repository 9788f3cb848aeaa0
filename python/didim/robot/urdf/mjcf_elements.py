"""Elements of an MJCF and of the files that it includes, beside what MuJoCo compiles of them: an export changes their attributes.

Tested in ``tests/test_export_drives.py`` and ``tests/test_export_links.py``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..._tools.inputs import read_small_file
from ...errors import RobotError
from .chain import Chain
from .mechanism import Description, Servo, UrdfJoint
from .mjcf import Reader
from .mjcf_compiler import compile_mjcf, parts_of
from .tendons import Shares
from .xml_spans import Element, parse_xml

INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast")
"""MuJoCo's integrators, in their order."""


@dataclass(frozen=True)
class Setting:
    """An actuator of an MJCF as MuJoCo compiles it.

    Attributes
    ----------
    tag : str
        Its element.
    gear : float
        Size of its moment arm on the joint.
    is_position : bool
        Whether the force is a gain times the position error plus damping.
    ratio : bool
        Whether the file has a damping ratio, from which MuJoCo computes the velocity gain.
    servo : Servo
        The actuator by its numbers.
    """

    tag: str
    gear: float
    is_position: bool
    ratio: bool
    servo: Servo


@dataclass(frozen=True, eq=False)
class MjcfElements:
    """Elements and values of an MJCF.

    Attributes
    ----------
    outermost : Element
        Content of the file, included ones in their places.
    reader : Reader
        The compiled model.
    description : Description
        The mechanism of the model.
    """

    outermost: Element
    reader: Reader
    description: Description

    @property
    def integrator(self) -> str:
        """MuJoCo's integrator of the file."""
        return INTEGRATORS[int(self.reader.model.opt.integrator)]

    @cached_property
    def joints(self) -> Mapping[str, UrdfJoint]:
        """Armature, damping, friction and spring of each joint, with the defaults of its class, by name."""
        return {joint.name: joint for joint in self.description.joints.values() if joint.moves}

    @cached_property
    def bodies(self) -> Mapping[str, Element]:
        """Element of each body by its name; those that the file generates or attaches have none."""
        worlds = self.outermost.all("worldbody")
        found = [body for world in worlds for body in _bodies(world)]
        names = self.reader.bodies[1:]
        if len(found) != len(names):  # some are generated or attached
            return {name: body for body in found if (name := body.attributes.get("name", "")) in names}
        return dict(zip(names, found, strict=True))

    @cached_property
    def elements(self) -> Mapping[str, Element]:
        """Element of each joint by its name; those that the file generates or attaches have none."""
        reader, elements = self.reader, dict[str, Element]()
        for name, body in self.bodies.items():
            b = reader.bodies.index(name)
            first, count = int(reader.model.body_jntadr[b]), int(reader.model.body_jntnum[b])
            own = [each for each in body.inside("frame") if each.tag in ("joint", "freejoint")]
            if len(own) == count:
                elements |= {reader.names[first + k]: joint for k, joint in enumerate(own)}
        return elements

    def named(self, kind: str) -> Mapping[str, Element]:
        """Element of each "tendon" or "actuator" by its name; those that the file attaches have none."""
        found = [each for section in self.outermost.all(kind) for each in section.inside()]
        model = self.reader.model
        count = {"tendon": model.ntendon, "actuator": len(model.actuator_trntype)}[kind]
        names = [self.reader.name(kind, k) for k in range(count)]
        if len(found) != len(names):
            return {name: each for each in found if (name := each.attributes.get("name", "")) in names}
        return dict(zip(names, found, strict=True))

    def settings(self, chain: Chain, shares: Shares) -> dict[str, tuple[Element, Setting]]:
        """Return element and setting of the last servo of each driven joint of a chain."""
        elements = self.named("actuator")
        servos = {tendon.name: tendon.servo for tendon in self.description.tendons if tendon.servo}
        numbers = {self.reader.name("actuator", k): k for k in range(len(servos))}
        settings = {}
        for joint, pulled in shares.pulled.items():
            name, arm = pulled[-1]
            if name in elements:
                element, ratio = elements[name], numbers[name] in self.reader.compiled.ratios
                steers = element.tag in ("position", "general") and servos[name].kp > 0.0
                setting = Setting(element.tag, abs(arm), len(pulled) == 1 and steers, ratio, servos[name])
                settings[chain.driven[joint].name] = element, setting
        return settings

    def written(self, position: float, turns: bool) -> float:
        """Return a position of a joint (rad or m) in the unit of the file."""
        return math.degrees(position) if turns and self.reader.compiled.degrees else position


def mjcf_elements(path: Path, error: type[Exception] = RobotError) -> MjcfElements:
    """Return the elements of an MJCF, whose includes lie beside it; `error` is raised where it cannot be read.

    Raises
    ------
    RobotError
        As for `load_robot`.
    """
    outermost = parse_xml(read_small_file(path, error), path.name)  # type: ignore[arg-type]
    reader = Reader(compile_mjcf(outermost, path), path.name)
    _include(outermost, path, path)
    return MjcfElements(outermost, reader, reader.description())


def _include(outermost: Element, file: Path, main: Path) -> None:
    """Put included files, which the compiler has checked, in their places."""
    for element in list(outermost.walk()):
        if element.tag == "include":
            inside = parts_of(element, file, main)[0]
            element.part = parse_xml(read_small_file(inside, RobotError), inside.name)
            _include(element.part, inside, main)


def _bodies(parent: Element) -> Iterator[Element]:
    for element in parent.inside("frame"):
        if element.tag == "body":
            yield element
            yield from _bodies(element)
