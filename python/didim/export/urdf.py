"""New inertias and friction in the user's URDF; no other byte changes.

Only ``<inertial>`` of the moving links and ``<dynamics>`` of their joints change; comments, order, white space and elements of
other programs do not. The inertia of a group of links that move together is written to its moving link, and the links fixed to
it lose their ``<inertial>``. Links behind locked joints, such as fingers, keep theirs, and the moving link gets the difference.
Tested in ``tests/test_export_urdf.py`` with Pinocchio, MuJoCo and yourdfpy.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from numpy.typing import ArrayLike

from .._tools.arrays import Array
from .._tools.inputs import read_small_file
from .._tools.words import series
from ..errors import FitError
from ..robot.rigid_body import central, why_no_body
from ..robot.robot import Robot
from ..robot.urdf.chain import choose_chain
from ..robot.urdf.description import read_description
from ..robot.urdf.xml_spans import Edit, Element, attribute_edit, edited, first_child, parse_xml
from .bodies import ExportModel, LinkBody, export_model
from .drives import Drives, JointDrive
from .numbers import moments, number, numbers, xml

ROTOR_NOTE = " didim: rotor inertia "
"""First words of the comment on a rotor inertia; a later export replaces the comment."""


def to_urdf(robot: Robot, x: ArrayLike, urdf: str | Path, *, keep_lumped: bool = False) -> bytes:
    """Write parameters into the URDF that a robot was read from.

    Parameters
    ----------
    robot : Robot
        A robot read from a URDF, or from a robot file with a ``[urdf]`` table.
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``, SI units, joint side: those of real bodies.
    urdf : str or Path
        The URDF.
    keep_lumped : bool
        Leave the ``<inertial>`` of fixed links and write the difference to the moving link.

    Returns
    -------
    bytes
        Content of the new file.

    Raises
    ------
    FitError
        When the file is not the one that the robot was read from, a link is not a body, or a drive has negative parameters
        (``tests/test_export_urdf.py``).
    ShapeError
        When `x` has another length, or a NaN.
    """
    data = urdf_bytes(robot, Path(urdf))
    return edited_urdf(robot, export_model(robot, x), data, Path(urdf).name, keep_lumped)


def edited_urdf(robot: Robot, model: ExportModel, data: bytes, where: str, keep_lumped: bool) -> bytes:
    """Return the content of a robot's URDF with the links and drives arranged for a file; errors as of `to_urdf`."""
    places = robot.correspondence
    assert places is not None
    lock = {joint: value for joint, value in places.lock if joint not in robot.all_joint_names}
    description = read_description(data, where)
    chain = choose_chain(description, base=places.base, tip=places.tip, lock=lock).numbered()
    outermost = parse_xml(data, where)
    links = {element.attributes.get("name"): element for element in outermost.all("link")}
    joints = {element.attributes.get("name"): element for element in outermost.all("joint")}
    changes = []
    for body, group in zip(model.links, chain.groups, strict=True):
        pseudo = body.pseudo.copy()
        untouched = []
        for member in group[1:]:
            if member.inertial is None:
                continue
            if keep_lumped or member.locked:
                pseudo -= member.pseudo
                untouched.append(member.link)
            else:
                element = links[member.link].find("inertial")
                assert element is not None
                # A comment of XML has no two hyphens in a row.
                note = f"<!-- inertial: part of link {re.sub(r'-(?=-)', '- ', body.link)} -->"
                changes.append(
                    Edit(element.data, element.start, element.end, note.encode("ascii", "replace"))
                )
        # A link between joints may have no mass.
        reason = why_no_body(pseudo) if pseudo.any() or links[body.link].find("inertial") else None
        if reason is not None:
            without = f" without {series(untouched, 30)}" if untouched else ""
            raise FitError(f"link {body.link!r} is not a body{without}: {reason}")
        if pseudo.any():
            changes.append(_inertial(links[body.link], pseudo))
        changes += _dynamics(joints[body.joint], body)
    return edited(outermost, changes)


def urdf_bytes(robot: Robot, urdf: Path) -> bytes:
    """Return the content of the URDF, which must be the one that the robot was read from."""
    places = robot.correspondence
    if places is None:
        raise FitError(
            f"robot {robot.name!r} was not read from a URDF: its file has no [urdf] table "
            f"(make one: didim robot {urdf.name} -o arm.toml)"
        )
    data = read_small_file(urdf, FitError)
    if hashlib.sha256(data).hexdigest() != places.sha256:
        raise FitError(
            f"{urdf.name} is not the file that robot {robot.name!r} was read from ({places.file}, whose digest the robot has); "
            "read it again: didim robot"
        )
    return data


def _inertial(link: Element, pseudo: Array) -> Edit:
    """Return the edit that replaces the inertial element of a link, or adds one as its first child."""
    mass, centre, inertia = central(pseudo)
    old = link.find("inertial")
    lines = xml(
        "inertial",
        xml("origin", xyz=numbers(centre), rpy="0 0 0"),
        xml("mass", value=number(mass)),
        xml("inertia", **moments(inertia)),
    )
    if old is None:
        return first_child(link, lines)
    text = (link.newline + old.indent).join(line.encode() for line in lines)
    return Edit(link.data, old.start, old.end, text)


def edit_dynamics(drives: Drives, path: Path) -> bytes:
    """Return a URDF with the friction and rotor inertias of drives and unchanged links.

    Raises
    ------
    FitError
        When a joint is not in the file.
    RobotError
        When the file is not a URDF.
    """
    data = read_small_file(path, FitError)
    read_description(data, path.name)
    outermost = parse_xml(data, path.name)
    joints = {str(joint.attributes.get("name")): joint for joint in outermost.all("joint")}
    drives.check_joints(joints, path.name)
    changes: list[Edit] = []
    for drive in drives.every:
        changes += _dynamics(joints[drive.joint], drive)
    return edited(outermost, changes)


def _dynamics(joint: Element, body: LinkBody | JointDrive) -> list[Edit]:
    """Return the friction of a joint, and its rotor inertia as a comment, because URDF has no element for it."""
    changes = []
    values = {"damping": body.viscous, "friction": body.coulomb}
    old = joint.find("dynamics")
    behind = b""
    if old is not None:
        changed = {
            key: value for key, value in values.items() if float(old.attributes.get(key, "0")) != value
        }
        changes += [attribute_edit(old, key, number(value)) for key, value in changed.items()]
    newline, indent = joint.newline, joint.children[-1].indent
    if old is None and any(values.values()):
        (line,) = xml("dynamics", **{key: number(value) for key, value in values.items()})
        behind += newline + indent + line.encode()
    note = next((comment for comment in joint.comments if comment.text.startswith(ROTOR_NOTE)), None)
    unit = "kg" if body.kind == "prismatic" else "kg.m^2"
    text = f"<!--{ROTOR_NOTE}{number(body.rotor)} {unit} (armature), which URDF has no place for -->".encode()
    if note is not None:
        changes.append(Edit(joint.data, note.start, note.end, text))
    elif body.rotor:
        behind += newline + indent + text
    if behind:
        last = max(joint.children, key=lambda child: child.end).end
        changes.append(Edit(joint.data, last, last, behind))
    return changes
