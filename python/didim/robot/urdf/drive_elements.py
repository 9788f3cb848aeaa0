"""Elements of an MJCF that define the drives of its joints: an export changes their attributes.

Tested in ``tests/test_export_drives.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..transmission import Actuator
from .actuators import Setting, actuator_settings, read_actuators
from .description import UrdfJoint
from .mjcf import walked
from .mjcf_sections import merged
from .xml_spans import Element


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
        Element and setting of the joint's actuator; those of included files are missing.
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
    outermost, sections, reader = walked(data, path)
    inside = [outermost]
    for element in inside:  # which grows meanwhile
        inside += element.children
    own = set(map(id, inside))
    settings = actuator_settings(sections, path.name)
    actuators, _ = read_actuators(sections, reader.own_limits, reader.compiler.autolimits, path.name)
    return DriveElements(
        joints={joint.name: joint for joint in reader.joints.values() if joint.moves},
        elements={name: element for name, element in reader.elements.items() if id(element) in own},
        settings={name: setting for name, setting in settings.items() if id(setting[0]) in own},
        actuators=actuators,
        degrees=reader.compiler.degrees,
        integrator=merged(sections, "option").get("integrator", "Euler"),
    )
