"""Drives of a result in the user's MJCF: attributes of joints and actuators; no other byte changes.

A joint gets ``armature``, ``damping``, ``frictionloss``, ``stiffness`` and ``springref``, and ``solreffriction`` and
``solimpfriction`` where a result on positions has another softness than the file. Its position actuator gets ``kp``, ``kv`` and
``forcerange``, a general one ``gainprm`` and ``biasprm``; values already in the file, also by a default class, do not change. The
spring of a coupled joint is part of its leader's, so its own element loses it. Tested in ``tests/test_export_drives.py``,
in ``tests/test_softness.py`` and in ``tests/test_couplings.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.inputs import read_small_file
from .._tools.words import listing
from ..errors import FitError
from ..model.dynamics import inertia_matrix
from ..robot.robot import Robot
from ..robot.robot_file import load_robot
from ..robot.transmission import LARGEST_IMPEDANCE
from ..robot.urdf.drive_elements import DriveElements, drive_elements
from ..robot.urdf.mjcf import LEAST_IMPEDANCE
from ..robot.urdf.reading import MJCF_SET
from .drives import Drives, JointDrive, for_step
from .numbers import number, numbers
from .urdf import Edit, attribute_edit, edited

SAME = 1e-9
"""Largest relative difference of two equal values: the file then keeps its digits."""


def edit_mjcf(drives: Drives, path: Path, *, step_s: float | None = None) -> tuple[bytes, Drives]:
    """Write drives into an MJCF.

    Parameters
    ----------
    drives : Drives
        Drives of a result.
    path : Path
        The MJCF; joints are matched by name.
    step_s : float, optional
        Step of the simulation, for which the values are compensated.

    Returns
    -------
    bytes, Drives
        Content of the new file, and its drives with sentences on compensation and omissions.

    Raises
    ------
    FitError
        When a joint is not in the file, or its element is in an included one.
    RobotError
        When the file cannot be read.
    """
    data = read_small_file(path, FitError)
    elements = drive_elements(data, path)
    drives.check_joints(elements.joints, path.name)
    for drive in drives.every:
        if drive.joint not in elements.elements:
            raise FitError(f"{path.name}: joint {drive.joint!r} is in an included file; export into that one")
    motors = [
        drive.joint
        for drive in drives.joints
        if drive.kp is not None
        and (drive.joint not in elements.settings or not elements.settings[drive.joint][1].is_position)
    ]
    if step_s is not None:
        drives = for_step(drives, step_s, elements.integrator, explicit_kv=bool(motors))
    sentences = list(drives.sentences)
    if motors:
        sentences.append(
            f"{listing(motors, 60)} of {path.name} have no position actuator: compute kp (command - q) - kv dq in your own code"
        )
    sentences += softness(drives, path, elements, step_s or 0.0)
    edits: list[Edit] = []
    for drive in drives.every:
        edits += _joint_edits(data, elements, drive)
        if drive.joint in elements.settings and drive.kp is not None:
            edits += _actuator_edits(data, elements, drive)
    return edited(data, edits), replace(drives, sentences=tuple(sentences))


def _joint_edits(data: bytes, elements: DriveElements, drive: JointDrive) -> list[Edit]:
    old = elements.joints[drive.joint]
    values = {"armature": (old.armature, drive.rotor), "damping": (old.damping, drive.viscous)}
    values |= {"frictionloss": (old.friction, drive.coulomb), "stiffness": (old.stiffness, drive.stiffness)}
    if drive.stiffness:
        turns = old.kind == "revolute"
        values["springref"] = (elements.written(old.rest, turns), elements.written(drive.rest, turns))
    element = elements.elements[drive.joint]
    edits = [
        attribute_edit(data, element, key, number(new))
        for key, (before, new) in values.items()
        if not _same(before, new)
    ]
    new = drive.softness
    if new is not None and not (_same(old.softness[0], new[0]) and _same(old.softness[1], new[1])):
        creep, rest = new
        least = min(max(rest / (rest + creep), LEAST_IMPEDANCE), 1.0 - LEAST_IMPEDANCE)
        edits += [
            attribute_edit(data, element, "solreffriction", numbers([2.0 * rest / LARGEST_IMPEDANCE, 1.0])),
            attribute_edit(data, element, "solimpfriction", numbers([least, LARGEST_IMPEDANCE])),
        ]
    return edits


def _actuator_edits(data: bytes, elements: DriveElements, drive: JointDrive) -> list[Edit]:
    element, setting = elements.settings[drive.joint]
    if not setting.is_position or drive.kp is None:
        return []
    old = elements.actuators[drive.joint]
    kp, kv = drive.kp / setting.gear**2, (drive.kv or 0.0) / setting.gear**2
    edits = []
    same_kp, same_kv = _same(old.kp or 0.0, drive.kp), _same(old.kv or 0.0, drive.kv or 0.0)
    if setting.tag == "position":
        edits += [] if same_kp else [attribute_edit(data, element, "kp", number(kp))]
        edits += [] if same_kv else [attribute_edit(data, element, "kv", number(kv))]
    elif not (same_kp and same_kv):
        edits += [
            attribute_edit(data, element, "gainprm", number(kp)),
            attribute_edit(data, element, "biasprm", numbers([0.0, -kp, -kv])),
        ]
    if drive.effort is not None and not _same(old.effort or 0.0, drive.effort):
        force = drive.effort / setting.gear
        edits.append(attribute_edit(data, element, "forcerange", numbers([-force, force])))
    return edits


def _same(before: float, new: float) -> bool:
    return abs(before - new) <= SAME * max(abs(before), abs(new))


def softness(drives: Drives, path: Path, elements: DriveElements, step_s: float) -> list[str]:
    """Return a sentence that compares the speed below which MuJoCo's friction loss is viscous with the result's smoothing.

    ``frictionloss`` is a soft constraint: below ``Fc A (1 - d) / d dmax timeconst / 2``, A the joint's own entry of the inverse
    inertia matrix, its force is proportional to the speed. The time constant is at least two steps.
    """
    robot = load_robot(path)
    if MJCF_SET not in robot.sets:
        return []
    inverse = _inverse_inertia(robot, drives)
    speeds = []
    for drive in drives.joints:
        creep, rest = drive.softness or elements.joints[drive.joint].softness
        creep *= max(1.0, LARGEST_IMPEDANCE * step_s / rest)
        speeds.append(drive.coulomb * inverse.get(drive.joint, 0.0) * creep)
    if not any(speeds):
        return []
    own = max(drive.smoothing for drive in drives.joints)
    beside = f"; the result's is smooth below {own:.2g}" if own else ""
    return [
        f"MuJoCo's frictionloss is viscous below {min(speeds):.2g} to {max(speeds):.2g} rad/s (m/s){beside}"
    ]


def _inverse_inertia(robot: Robot, drives: Drives) -> Mapping[str, float]:
    """Diagonal of the inverse inertia matrix at position zero with the new armatures, by name of the joint."""
    rotors = {drive.joint: drive.rotor for drive in drives.joints}
    x: Array = robot.parameter_set(MJCF_SET).copy()
    for j, name in enumerate(robot.joint_names):
        x[robot.parameter_names.index(f"Ia{j + 1}")] = rotors.get(name, 0.0)
    matrix = inertia_matrix(robot, np.zeros((1, robot.n_dof)), x)[0]
    return dict(zip(robot.joint_names, np.diag(np.linalg.inv(matrix)).tolist(), strict=True))
