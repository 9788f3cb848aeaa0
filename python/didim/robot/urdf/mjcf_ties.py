"""Ties between the joints of an MJCF: ``equality/joint``. Tested in ``tests/test_couplings.py`` and ``tests/test_mjcf.py``."""

from __future__ import annotations

from dataclasses import replace

from ...errors import RobotError
from .description import UrdfJoint
from .xml_spans import Element


def tied(sections: list[Element], joints: dict[str, UrdfJoint], where: str) -> dict[str, UrdfJoint]:
    """Return the joints with the leader that a linear ``equality/joint`` ties them to; nonlinear ties lock the joint."""
    zeros = {joint.name: joint.zero for joint in joints.values()}
    ties: dict[str, tuple[str, float, float]] = {}
    for section in sections:
        for element in section.children if section.tag == "equality" else ():
            if element.tag == "joint" and element.attributes.get("active", "true") == "true":
                words = element.attributes.get("polycoef", "0 1 0 0 0").split()
                try:
                    rest, slope, *more = [float(word) for word in words] + [0.0] * (2 - len(words))
                except ValueError:
                    raise RobotError(f"{where}: line {element.line}: polycoef must be five numbers") from None
                name, leader = (element.attributes.get(key, "") for key in ("joint1", "joint2"))
                # Both positions are relative to the pose in which the file draws the joints.
                at_zero = zeros.get(name, 0.0) + rest
                line = not any(more) and leader in zeros
                ties[name] = (leader, slope, at_zero - slope * zeros[leader]) if line else ("", 0.0, at_zero)
    return {
        child: replace(
            joint, mimic=ties[joint.name][0], multiplier=ties[joint.name][1], offset=ties[joint.name][2]
        )
        if joint.name in ties
        else joint
        for child, joint in joints.items()
    }
