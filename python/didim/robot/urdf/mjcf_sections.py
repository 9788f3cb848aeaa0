"""Sections of an MJCF other than its bodies: ``<compiler>``, classes of ``<default>``, ``equality/joint`` and tendons.

Tested in ``tests/test_mjcf.py`` and ``tests/test_couplings.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from ...errors import RobotError
from .description import UrdfJoint
from .xml_spans import Element


@dataclass(frozen=True)
class Compiler:
    """Settings of ``<compiler>`` that affect the description.

    Attributes
    ----------
    degrees : bool
        Whether angles of the file are in degrees.
    eulerseq : str
        Axes of Euler angles: small letters turn with the frame.
    from_geoms : str
        ``inertiafromgeom``: ``true``, ``false`` or ``auto``.
    autolimits : bool
        Whether a range is a limit by itself.
    groups : (int, int)
        First and last group of the geoms that have mass.
    total_mass : float
        Mass (kg) to which all bodies are scaled, zero for none.
    """

    degrees: bool
    eulerseq: str
    from_geoms: str
    autolimits: bool
    groups: tuple[int, int]
    total_mass: float


_Attributes = Mapping[str, Mapping[str, str]]

Defaults = Mapping[str, _Attributes]
"""Attributes by class and tag."""

_Defaults = TypeVar("_Defaults")


def inside(sections: Iterable[Element], tag: str) -> list[Element]:
    """Return what is inside all sections of one name."""
    return [child for section in sections if section.tag == tag for child in section.children]


def merged(elements: Iterable[Element], tag: str) -> dict[str, str]:
    """Return the attributes of all elements of one name, of which later ones count, as in MuJoCo."""
    return {key: value for each in elements if each.tag == tag for key, value in each.attributes.items()}


def compiler_of(sections: list[Element], where: str) -> Compiler:
    """Return the settings of all ``<compiler>`` together.

    Raises
    ------
    RobotError
        For global coordinates, which MuJoCo no longer reads, a wrong order of Euler angles and wrong numbers.
    """
    given = merged(sections, "compiler")
    if given.get("coordinate", "local") != "local":
        raise RobotError(f"{where}: coordinates must be local, got {given['coordinate']!r}")
    eulerseq = given.get("eulerseq", "xyz")
    if len(eulerseq) != 3 or not set(eulerseq.lower()) <= set("xyz"):
        raise RobotError(f"{where}: eulerseq must be three letters of x, y and z, got {eulerseq!r}")
    try:
        first, last = (int(word) for word in given.get("inertiagrouprange", "0 5").split())
        total_mass = float(given.get("settotalmass", "-1"))
    except ValueError:
        raise RobotError(
            f"{where}: inertiagrouprange of <compiler> must be two integers, settotalmass a number"
        ) from None
    return Compiler(
        degrees=given.get("angle", "degree") == "degree",
        eulerseq=eulerseq,
        from_geoms=given.get("inertiafromgeom", "auto"),
        autolimits=given.get("autolimits", "true") == "true",
        groups=(first, last),
        total_mass=total_mass if 0.0 < total_mass < math.inf else 0.0,
    )


def world_notes(sections: list[Element]) -> tuple[bool, list[str]]:
    """Return whether gravity is disabled, and sentences on that and on what else of the simulated world is left out."""
    weightless = merged(inside(sections, "option"), "flag").get("gravity") == "disable"
    notes = []
    if weightless:
        notes.append("gravity is disabled in the file (didim robot --gravity 0 0 -9.81 restores it)")
    options = merged(sections, "option")
    if any(options.get(key, "0").strip("0.") for key in ("density", "viscosity")):
        notes.append("forces of the fluid are left out (density, viscosity)")
    return weightless, notes


def defaults_of(sections: list[Element]) -> Defaults:
    """Return the attributes of all classes, those of an outer class included."""

    def extended(own: _Attributes, child: Element) -> _Attributes:
        return {**own, child.tag: {**own.get(child.tag, {}), **child.attributes}}

    return by_class(sections, {}, extended)


def by_class(
    sections: list[Element], outermost: _Defaults, extended: Callable[[_Defaults, Element], _Defaults]
) -> dict[str, _Defaults]:
    """Return the defaults of each class: those of the class around it, extended by each element of its own."""
    defaults = {"main": outermost}

    def read(element: Element, name: str) -> None:
        for child in element.children:
            if child.tag != "default":
                defaults[name] = extended(defaults[name], child)
        for child in element.all("default"):
            inner = child.attributes.get("class", "")
            defaults[inner] = defaults[name]
            read(child, inner)

    for section in sections:
        if section.tag == "default":
            read(section, "main")
    return defaults


def tied(sections: list[Element], joints: dict[str, UrdfJoint], where: str) -> dict[str, UrdfJoint]:
    """Return the joints with the leader that a linear ``equality/joint`` ties them to; nonlinear ties lock the joint."""
    zeros = {joint.name: joint.zero for joint in joints.values()}
    ties: dict[str, dict[str, Any]] = {}
    for element in inside(sections, "equality"):
        if element.tag == "joint" and element.attributes.get("active", "true") == "true":
            words = element.attributes.get("polycoef", "0 1 0 0 0").split()
            try:
                rest, slope, *more = [float(word) for word in words] + [0.0] * (2 - len(words))
            except ValueError:
                raise RobotError(f"{where}: line {element.line}: polycoef must be five numbers") from None
            name, leader = (element.attributes.get(key, "") for key in ("joint1", "joint2"))
            # Both positions are relative to the pose in which the file draws the joints.
            at_zero = zeros.get(name, 0.0) + rest
            if any(more) or leader not in zeros:
                leader, slope = "", 0.0
            offset = at_zero - slope * zeros.get(leader, 0.0)
            ties[name] = {"mimic": leader, "multiplier": slope, "offset": offset}
    return {child: replace(joint, **ties.get(joint.name, {})) for child, joint in joints.items()}


def sprung_tendons(sections: list[Element], defaults: Defaults) -> list[str]:
    """Return the names of tendons with a stiffness."""
    sprung = []
    for element in inside(sections, "tendon"):
        own = defaults.get(element.attributes.get("class", "main"), {}).get("tendon", {})
        if {**own, **element.attributes}.get("stiffness", "0").strip("0. "):
            sprung.append(element.attributes.get("name", f"line {element.line}"))
    return sprung
