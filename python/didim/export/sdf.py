"""A robot as SDF, the model format of Gazebo and Drake.

Poses of links are in the model's frame, which is that of the base; joints have damping and friction. SDF cannot represent rotor
inertias and coupled motors. Tested in ``tests/test_export_sdf.py``, which reads the file with Pinocchio's algorithms.
"""

from __future__ import annotations

from dataclasses import replace
from xml.sax.saxutils import escape, quoteattr

from numpy.typing import ArrayLike

from .._tools.arrays import Array
from .._tools.words import series
from ..robot.rigid_body import central, inverse, roll_pitch_yaw
from ..robot.robot import Robot
from .bodies import ExportModel, LinkBody, export_model
from .numbers import moments, number, numbers

VERSION = "1.6"
"""SDF version of the output: in every version the poses of links are given in the frame of the model."""


SHARE = 1e-9
"""Share of a body's inertia that each link between its joints gets at position zero: readers of SDF refuse links without mass, and
torques change by as much."""


def to_sdf(robot: Robot, x: ArrayLike) -> str:
    """Write a robot as SDF.

    Parameters
    ----------
    robot : Robot
        The robot; the names and frames of its URDF are preserved.
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``, SI units, joint side: those of real bodies.

    Returns
    -------
    str
        Content of the file: a model that is fixed to the world. Gravity belongs to the world and is not included.

    Raises
    ------
    FitError
        When a link is not a body or a drive has negative parameters (``tests/test_export_sdf.py``).
    ShapeError
        When `x` has another length, or a NaN.
    """
    return sdf_text(export_model(robot, x))


def sdf_text(model: ExportModel) -> str:
    """Return the SDF of a robot arranged for a file."""
    lines = ['<?xml version="1.0"?>', f'<sdf version="{VERSION}">', f"  <model name={quoteattr(model.name)}>"]
    if model.base != "world":  # a name reserved by SDF
        lines += [
            f"    <link name={quoteattr(model.base)}/>",
            '    <joint name="world_to_base" type="fixed">',
            "      <parent>world</parent>",
            f"      <child>{escape(model.base)}</child>",
            "    </joint>",
        ]
    frames, links = model.frames, list(model.links)
    between = model.between()
    for j, carried in between.items():
        body = carried
        while body in between:
            body = between[body]
        part, seen = SHARE * model.links[body].pseudo, inverse(frames[j]) @ frames[body]
        links[j] = replace(links[j], pseudo=seen @ part @ seen.T)
        links[body] = replace(links[body], pseudo=links[body].pseudo - part)
    for j in model.outwards:
        link = links[j]
        parent = model.base if link.parent is None else model.links[link.parent].link
        lines += _link(link, frames[j]) + _joint(link, parent, model)
    return "\n".join([*lines, "  </model>", "</sdf>"]) + "\n"


def no_drives(model: ExportModel, format_name: str) -> list[str]:
    """Return sentences on rotor inertias, coupled motors and springs, for a format without them, and of SDF on massless links."""
    sentences = []
    if format_name == "SDF" and (between := model.between()):
        names = series((model.links[j].link for j in between), 60)
        sentences.append(f"SDF has no links without mass: {names} get {SHARE:g} of the body that they carry")
    springs = [f"{link.joint} {link.stiffness:.4g}" for link in model.links if link.stiffness]
    if springs and format_name != "SDF":
        sentences.append(f"{format_name} has no place for springs (N.m/rad or N/m): {series(springs)}")
    rotors = [f"{link.joint} {link.rotor:.4g}" for link in model.links if link.rotor]
    if rotors:
        sentences.append(f"{format_name} has no place for rotor inertias (kg.m^2 or kg): {series(rotors)}")
    motors = series((str(motor.number + 1) for motor in model.motors), 60)
    if motors:
        sentences.append(
            f"{format_name} has no place for motors that turn several joints: {motors} (MJCF has)"
        )
    return sentences


def _link(link: LinkBody, frame: Array) -> list[str]:
    mass, centre, inertia = central(link.pseudo)
    pose = numbers([*frame[:3, 3], *roll_pitch_yaw(frame[:3, :3])])
    return [
        f"    <link name={quoteattr(link.link)}>",
        f"      <pose>{pose}</pose>",
        "      <inertial>",
        f"        <pose>{numbers([*centre, 0.0, 0.0, 0.0])}</pose>",
        f"        <mass>{number(mass)}</mass>",
        "        <inertia>",
        *(f"          <{key}>{number(value)}</{key}>" for key, value in moments(inertia).items()),
        "        </inertia>",
        "      </inertial>",
        "    </link>",
    ]


def _mimic(link: LinkBody, model: ExportModel) -> list[str]:
    """Return the lines on a coupled joint's leader."""
    if link.follower is None:
        return []
    leader, factor = link.leader("a mimic joint of SDF")
    return [
        f"        <mimic joint={quoteattr(model.links[leader].joint)}>",
        f"          <multiplier>{number(factor)}</multiplier>",
        f"          <offset>{number(link.follower.offset)}</offset>",
        "          <reference>0</reference>",
        "        </mimic>",
    ]


def _joint(link: LinkBody, parent: str, model: ExportModel) -> list[str]:
    limits = link.limits
    entries = [
        ("lower", limits.position and limits.position[0]),
        ("upper", limits.position and limits.position[1]),
        ("effort", limits.effort),
        ("velocity", limits.velocity),
    ]
    spring = (
        f"          <spring_{key}>{number(value)}</spring_{key}>"
        for key, value in (("reference", link.rest), ("stiffness", link.stiffness))
        if link.stiffness
    )
    limit = [f"          <{key}>{number(value)}</{key}>" for key, value in entries if value is not None]
    return [
        f'    <joint name={quoteattr(link.joint)} type="{link.kind}">',
        f"      <parent>{escape(parent)}</parent>",
        f"      <child>{escape(link.link)}</child>",
        "      <axis>",
        f"        <xyz>{numbers(link.axis)}</xyz>",
        *(["        <limit>", *limit, "        </limit>"] if limit else []),
        "        <dynamics>",
        f"          <damping>{number(link.viscous)}</damping>",
        f"          <friction>{number(link.coulomb)}</friction>",
        *spring,
        "        </dynamics>",
        *_mimic(link, model),
        "      </axis>",
        "    </joint>",
    ]
