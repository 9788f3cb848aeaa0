"""A robot as SDF, the model format of Gazebo and Drake.

Poses of links are in the model's frame, which is that of the base; joints have damping and friction. SDF cannot represent rotor
inertias and coupled motors. Tested in ``tests/test_export_sdf.py``, which reads the file with Pinocchio's algorithms.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from xml.sax.saxutils import escape

from numpy.typing import ArrayLike

from .._tools.words import series
from ..robot.rigid_body import central, inverse, roll_pitch_yaw
from ..robot.robot import Robot
from .bodies import ExportModel, export_model
from .numbers import moments, number, xml

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
    frames, links = model.frames, list(model.links)
    between = model.between()
    for j, carried in between.items():
        body = carried
        while body in between:
            body = between[body]
        part, seen = SHARE * model.links[body].pseudo, inverse(frames[j]) @ frames[body]
        links[j] = replace(links[j], pseudo=seen @ part @ seen.T)
        links[body] = replace(links[body], pseudo=links[body].pseudo - part)
    parts: list[list[str]] = []
    if model.base != "world":  # a name reserved by SDF
        ends = _text(parent="world", child=model.base)
        parts += [xml("link", name=model.base), xml("joint", ends, name="world_to_base", type="fixed")]
    for j in model.outwards:
        link = links[j]
        parent = model.base if link.parent is None else model.links[link.parent].link
        frame = frames[j]
        mass, centre, inertia = central(link.pseudo)
        solid = _text(pose=[*centre, 0.0, 0.0, 0.0], mass=mass)
        place = _text(pose=[*frame[:3, 3], *roll_pitch_yaw(frame[:3, :3])])
        entries = xml("inertia", _text(**moments(inertia)))
        lower, upper = link.limits.position or (None, None)
        limit = _text(lower=lower, upper=upper, effort=link.limits.effort, velocity=link.limits.velocity)
        dynamics = _text(damping=link.viscous, friction=link.coulomb)
        if link.stiffness:
            dynamics += _text(spring_reference=link.rest, spring_stiffness=link.stiffness)
        axis = [_text(xyz=link.axis), xml("limit", limit) if limit else [], xml("dynamics", dynamics)]
        if link.follower is not None:
            leader, factor = link.leader("a mimic joint of SDF")
            relation = [*_text(multiplier=factor, offset=link.follower.offset), "<reference>0</reference>"]
            axis.append(xml("mimic", relation, joint=model.links[leader].joint))
        pair = _text(parent=parent, child=link.link)
        parts += [
            xml("link", place, xml("inertial", solid, entries), name=link.link),
            xml("joint", pair, xml("axis", *axis), name=link.joint, type=link.kind),
        ]
    lines = xml("sdf", xml("model", *parts, name=model.name), version=VERSION)
    return "\n".join(['<?xml version="1.0"?>', *lines]) + "\n"


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


def _text(**values: str | float | Iterable[float] | None) -> list[str]:
    """Return an element of text or numbers for each value that is there."""
    lines = []
    for tag, value in values.items():
        if value is not None:
            words = [value] if isinstance(value, str | float | int) else value
            text = " ".join(escape(word) if isinstance(word, str) else number(word) for word in words)
            lines.append(f"<{tag}>{text}</{tag}>")
    return lines
