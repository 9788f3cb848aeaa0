"""A robot as MJCF, the model format of MuJoCo, which represents the whole model except torque offsets.

``armature``, ``damping``, ``frictionloss`` and ``stiffness`` of a joint are ``Ia``, ``Fv``, ``Fc`` and ``Ks``; with a spring,
``springref`` contains the offset. A motor that turns with several joints is a fixed tendon over them, with its own armature,
damping and friction loss; its contributions to ``Ia_j``, ``Fv_j`` and ``Fc_j``, (24), are subtracted from the joints. Tested in
``tests/test_export_mjcf.py`` by ``mj_inverse``.
"""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array
from ..robot.rigid_body import inverse, quaternion
from ..robot.robot import Robot
from .bodies import ExportModel, LinkBody, export_model
from .numbers import attributes, inertial, number, numbers


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
    rotor, viscous, coulomb = (model.own_share(key) for key in ("rotor", "viscous", "coulomb"))
    lines = [
        f"<mujoco model={quoteattr(model.name)}>",
        '  <compiler angle="radian" autolimits="true"/>',
        f'  <option gravity="{numbers(model.gravity)}"/>',
        "  <worldbody>",
    ]
    indent = "    "
    own_base = model.base != "world"  # the name of MuJoCo's own outermost body
    if own_base:
        lines.append(f"{indent}<body name={quoteattr(model.base)}>")
        indent += "  "
    open_bodies: list[int] = []
    between, frames = model.between(), model.frames
    before: list[int] = []
    for j in model.outwards:
        before.append(j)
        if j in between:
            continue
        parent = model.links[before[0]].parent
        while open_bodies and open_bodies[-1] != parent:
            open_bodies.pop()
            lines.append(f"{indent}{'  ' * len(open_bodies)}</body>")
        inner = indent + "  " * len(open_bodies)
        joints = [
            _joint(
                model.links[k],
                np.eye(4) if k == j else inverse(frames[j]) @ frames[k],
                rotor[k],
                viscous[k],
                coulomb[k],
            )
            for k in before
        ]
        pose = inverse(frames[parent]) @ frames[j] if before[:-1] else model.links[j].pose
        lines += [inner + line for line in _body(model.links[j], pose, joints)]
        open_bodies.append(j)
        before.clear()
    lines += [f"{indent}{'  ' * depth}</body>" for depth in reversed(range(len(open_bodies)))]
    if own_base:
        lines.append("    </body>")
    lines.append("  </worldbody>")
    if model.motors:
        lines += ["  <tendon>", *_tendons(model), "  </tendon>"]
    lines += _equalities(model)
    lines += [
        "  <actuator>",
        *(f"    {_actuator(link)}" for link in model.links if link.follower is None),
        "  </actuator>",
        "</mujoco>",
    ]
    return "\n".join(lines) + "\n"


def _joint(link: LinkBody, frame: Array, rotor: float, viscous: float, coulomb: float) -> str:
    """Return a joint, whose link has a frame in the body."""
    own = f' name={quoteattr(link.joint)} type="{"slide" if link.kind == "prismatic" else "hinge"}"'
    if frame[:3, 3].any():
        own += f' pos="{numbers(frame[:3, 3])}"'
    own += f' axis="{numbers(frame[:3, :3] @ link.axis)}"'
    if link.limits.position is not None:
        own += f' range="{numbers(link.limits.position)}"'
    return f"  <joint{own}{_drive(rotor, viscous, coulomb, stiffness=link.stiffness, springref=link.rest)}/>"


def _body(link: LinkBody, pose: Array, joints: list[str]) -> list[str]:
    own = "".join(f' {key}="{value}"' for key, value in inertial(link.pseudo).items())
    return [
        f'<body name={quoteattr(link.link)} pos="{numbers(pose[:3, 3])}" '
        f'quat="{numbers(quaternion(pose[:3, :3]))}">',
        *joints,
        f"  <inertial{own}/>",
    ]


def _drive(rotor: float, viscous: float, coulomb: float, **further: float) -> str:
    """Return the attributes of a joint or a tendon that are not zero."""
    values = {"armature": rotor, "damping": viscous, "frictionloss": coulomb, **further}
    return attributes({key: value for key, value in values.items() if value})


def _tendons(model: ExportModel) -> list[str]:
    lines = []
    for motor in model.motors:
        drive = _drive(motor.rotor, motor.viscous, motor.coulomb)
        lines.append(f"    <fixed name={quoteattr(f'motor{motor.number + 1}')}{drive}>")
        lines += [
            f'      <joint joint={quoteattr(link.joint)} coef="{number(coefficient)}"/>'
            for link, coefficient in zip(model.links, motor.coefficients, strict=True)
            if coefficient
        ]
        lines.append("    </fixed>")
    return lines


def _equalities(model: ExportModel) -> list[str]:
    """Return the lines on coupled joints; MuJoCo's equality only supports one leader."""
    lines = []
    for link in model.links:
        if link.follower is None:
            continue
        leader, factor = link.leader("an equality of MJCF")
        lines.append(
            f"    <joint joint1={quoteattr(link.joint)} joint2={quoteattr(model.links[leader].joint)} "
            f'polycoef="{numbers([link.follower.offset, factor])} 0 0 0"/>'
        )
    return ["  <equality>", *lines, "  </equality>"] if lines else []


def _actuator(link: LinkBody) -> str:
    effort = link.limits.effort
    limit = f' ctrlrange="{numbers([-effort, effort])}"' if effort else ""
    return f"<motor name={quoteattr(f'{link.joint}_motor')} joint={quoteattr(link.joint)}{limit}/>"
