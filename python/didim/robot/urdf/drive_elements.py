"""Elements of an MJCF that define the drives of its joints: an export changes their attributes.

Tested in ``tests/test_export_drives.py``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..transmission import Actuator
from .mechanism import UrdfJoint
from .mjcf import Reader
from .mjcf_compiler import compile_mjcf
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
        Size of the gear ratio.
    is_position : bool
        Whether the force is a gain times the position error plus damping.
    ratio : bool
        Whether the file has a damping ratio, from which MuJoCo computes the velocity gain.
    """

    tag: str
    gear: float
    is_position: bool
    ratio: bool


@dataclass(frozen=True, eq=False)
class DriveElements:
    """Elements and values of the drives of an MJCF, by name of the joint.

    Attributes
    ----------
    joints : mapping of str to UrdfJoint
        Armature, damping, friction and spring of each joint, with the defaults of its class.
    elements : mapping of str to Element
        Element of the joint; joints of included files have none.
    settings : mapping of str to (Element, Setting)
        Element and setting of the joint's last actuator; those of included files are missing.
    actuators : mapping of str to Actuator
        Gains and limit of the actuator, joint side.
    degrees : bool
        Whether angles of the file are in degrees.
    integrator : str
        Integrator of ``<option>``: "Euler", "implicit", "implicitfast" or "RK4".
    """

    joints: Mapping[str, UrdfJoint]
    elements: Mapping[str, Element]
    settings: Mapping[str, tuple[Element, Setting]]
    actuators: Mapping[str, Actuator]
    degrees: bool
    integrator: str

    def written(self, position: float, turns: bool) -> float:
        """Return a position of a joint (rad or m) in the unit of the file."""
        return math.degrees(position) if turns and self.degrees else position


def drive_elements(data: bytes, path: Path) -> DriveElements:
    """Return the drives of an MJCF.

    Parameters
    ----------
    data : bytes
        Content of the file.
    path : Path
        The file; files that it includes lie beside it.

    Raises
    ------
    RobotError
        As for `load_robot`.
    """
    outermost = parse_xml(data, path.name)
    reader = Reader(compile_mjcf(outermost, path), path.name)
    description = reader.description()
    joints = {joint.name: joint for joint in description.joints.values() if joint.moves}
    return DriveElements(
        joints=joints,
        elements={name: element for name, element in _joint_elements(outermost) if name in joints},
        settings=dict(_settings(outermost, reader)),
        actuators={name: joint.actuator for name, joint in joints.items() if joint.actuator},
        degrees=reader.compiled.degrees,
        integrator=INTEGRATORS[int(reader.model.opt.integrator)],
    )


def _settings(outermost: Element, reader: Reader) -> Iterator[tuple[str, tuple[Element, Setting]]]:
    """Return joint, element and setting of the actuators in a file."""
    model = reader.model
    own: dict[str, list[int]] = {}
    for k in range(len(model.actuator_trntype)):
        arms = reader.moments(k)
        if arms is not None and not reader.on_tendon(k):
            own.setdefault(next(iter(arms)), []).append(k)
    for element in [child for section in outermost.all("actuator") for child in section.children]:
        joint = element.attributes.get("joint") or element.attributes.get("jointinparent", "")
        if joint in own:
            k = own[joint][-1]
            gains = reader.gains(k)
            yield (
                joint,
                (
                    element,
                    Setting(
                        tag=element.tag,
                        gear=abs(float(model.actuator_gear[k, 0])),
                        is_position=len(own[joint]) == 1 and gains is not None and gains[0] > 0.0,
                        ratio=k in reader.compiled.ratios,
                    ),
                ),
            )


def _joint_elements(parent: Element) -> Iterator[tuple[str, Element]]:
    """Return name and element of the joints of all bodies inside an element."""
    for element in parent.children:
        if element.tag == "body":
            own = list(_own_joints(element))
            for number, joint in enumerate(own, start=1):
                made_up = f"{element.attributes.get('name', '')}_joint{'' if len(own) == 1 else number}"
                yield joint.attributes.get("name") or made_up, joint
        yield from _joint_elements(element)


def _own_joints(body: Element) -> Iterator[Element]:
    for element in body.children:
        if element.tag in ("joint", "freejoint"):
            yield element
        elif element.tag == "frame":
            yield from _own_joints(element)
