"""A robot as MJCF, the model format of MuJoCo, which represents the whole model except torque offsets.

``armature``, ``damping``, ``frictionloss`` and ``stiffness`` of a joint are ``Ia``, ``Fv``, ``Fc`` and ``Ks``; with a spring,
``springref`` contains the offset. A motor that turns with several joints is a fixed tendon over them, with its own armature,
damping and friction loss; its contributions to ``Ia_j``, ``Fv_j`` and ``Fc_j``, (24), are subtracted from the joints. Tested in
``tests/test_export_mjcf.py`` by ``mj_inverse``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array
from ..robot.rigid_body import inverse, quaternion
from ..robot.robot import Robot
from .bodies import CoupledMotor, ExportModel, LinkBody, export_model
from .drives import JointDrive, drives_of_links
from .numbers import inertial, number, numbers, xml


def to_mjcf(robot: Robot, x: ArrayLike) -> str:
    """Write a robot as MJCF.

    Parameters
    ----------
    robot : Robot
        The robot; the names and frames of its URDF are preserved.
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``, SI units, joint side: those of real bodies.

    Returns
    -------
    str
        Content of the file. Gravity is in the frame of the base link, which is the world.

    Raises
    ------
    FitError
        When a link is not a body or a drive has negative parameters (``tests/test_export_mjcf.py``).
    ShapeError
        When `x` has another length, or a NaN.
    """
    return mjcf_text(export_model(robot, x))


def mjcf_text(model: ExportModel) -> str:
    """Return the MJCF of a robot arranged for a file."""
    bodies = _bodies(model, drives_of_links(model).every, model.between(), None)
    if model.base != "world":  # the name of MuJoCo's own outermost body
        bodies = [xml("body", *bodies, name=model.base)]
    tendons = []
    for motor in model.motors:
        joints = [
            xml("joint", joint=link.joint, coef=number(coefficient))
            for link, coefficient in zip(model.links, motor.coefficients, strict=True)
            if coefficient
        ]
        tendons.append(xml("fixed", *joints, name=f"motor{motor.number + 1}", **_drive(motor)))
    # MuJoCo's equality only supports one leader.
    equalities = []
    for link in model.links:
        if link.follower is not None:
            leader, factor = link.leader("an equality of MJCF")
            line = f"{numbers([link.follower.offset, factor])} 0 0 0"
            equalities.append(
                xml("joint", joint1=link.joint, joint2=model.links[leader].joint, polycoef=line)
            )
    sections = {"tendon": tendons, "equality": equalities}
    motors = [_actuator(link) for link in model.links if link.follower is None]
    lines = xml(
        "mujoco",
        xml("compiler", angle="radian", autolimits="true"),
        xml("option", gravity=numbers(model.gravity)),
        xml("worldbody", *bodies),
        *(xml(section, *parts) for section, parts in sections.items() if parts),
        xml("actuator", *motors),
        model=model.name,
    )
    return "\n".join(lines) + "\n"


def _bodies(
    model: ExportModel, drives: Sequence[JointDrive], between: Mapping[int, int], parent: int | None
) -> list[list[str]]:
    """Return the bodies on a link, with all that they carry; links `between` the joints of one body are none."""
    bodies, frames = [], model.frames
    for j, first in enumerate(model.links):
        if first.parent != parent:
            continue
        own = [j]
        while own[-1] in between:
            own.append(between[own[-1]])
        link = model.links[own[-1]]
        frame = frames[own[-1]]
        pose = inverse(frames[parent]) @ frame if own[1:] else link.pose
        places = [*(inverse(frame) @ frames[k] for k in own[:-1]), np.eye(4)]
        parts = [_joint(model.links[k], place, drives[k]) for k, place in zip(own, places, strict=True)]
        parts += [xml("inertial", **inertial(link.pseudo)), *_bodies(model, drives, between, own[-1])]
        turn = numbers(quaternion(pose[:3, :3]))
        bodies.append(xml("body", *parts, name=link.link, pos=numbers(pose[:3, 3]), quat=turn))
    return bodies


def _joint(link: LinkBody, frame: Array, drive: JointDrive) -> list[str]:
    """Return a joint, whose link has a frame in the body."""
    position = link.limits.position
    return xml(
        "joint",
        name=link.joint,
        type="slide" if link.kind == "prismatic" else "hinge",
        pos=numbers(frame[:3, 3]) if frame[:3, 3].any() else None,
        axis=numbers(frame[:3, :3] @ link.axis),
        range=None if position is None else numbers(position),
        **_drive(drive, stiffness=drive.stiffness, springref=drive.rest),
    )


def _drive(drive: JointDrive | CoupledMotor, **further: float) -> dict[str, str]:
    """Return the attributes of a joint or a tendon that are not zero."""
    values = {"armature": drive.rotor, "damping": drive.viscous, "frictionloss": drive.coulomb, **further}
    return {key: number(value) for key, value in values.items() if value}


def _actuator(link: LinkBody) -> list[str]:
    effort = link.limits.effort
    limit = numbers([-effort, effort]) if effort else None
    return xml("motor", name=f"{link.joint}_motor", joint=link.joint, ctrlrange=limit)
