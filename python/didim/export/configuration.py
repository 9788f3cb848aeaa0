"""Drives of a result as configuration of Isaac Lab and mjlab (Python), and as parameters of BAM's first friction model (JSON).

Tested in ``tests/test_export_drives.py``.
"""

from __future__ import annotations

import json
import re

from ..errors import FitError
from .drives import Drives, JointDrive
from .numbers import number


def isaac_lab(drives: Drives, step_s: float | None = None) -> str:
    """Return the actuators of an ``ArticulationCfg``, a group for each delay, which is in steps of the physics.

    Parameters
    ----------
    drives : Drives
        Drives of a result on positions.
    step_s : float, optional
        Step of the physics, the unit of delays; without it delays are omitted.

    Raises
    ------
    FitError
        When the result has no gains.
    """
    groups: dict[int, list[JointDrive]] = {}
    for drive in _with_gains(drives):
        groups.setdefault(_steps(drive, step_s), []).append(drive)
    kinds = {late: "DelayedPDActuatorCfg" if late else "IdealPDActuatorCfg" for late in sorted(groups)}
    lines = [
        "# Written by didim for Isaac Lab 3. In your ArticulationCfg: actuators=ACTUATORS",
        "# Isaac Lab 2 calls actuator_effort_limit effort_limit.",
        *_comments(drives),
        f"from isaaclab.actuators import {', '.join(dict.fromkeys(kinds.values()))}",
        "",
        "ACTUATORS = {",
    ]
    for late, kind in kinds.items():
        joints = groups[late]
        name = "servos" if len(groups) == 1 else f"servos_{late}_steps_late"
        tables: dict[str, dict[str, float | None]] = {
            "stiffness": {drive.joint: drive.kp for drive in joints},
            "damping": {drive.joint: drive.kv or 0.0 for drive in joints},
            "actuator_effort_limit": {
                drive.joint: drive.effort for drive in joints if drive.effort is not None
            },
            "armature": {drive.joint: drive.rotor for drive in joints},
            "friction": {drive.joint: drive.coulomb for drive in joints},
            "dynamic_friction": {drive.joint: drive.coulomb for drive in joints},
            "viscous_friction": {drive.joint: drive.viscous for drive in joints},
        }
        lines += [
            f'    "{name}": {kind}(',
            f"        joint_names_expr={json.dumps([re.escape(drive.joint) for drive in joints])},",
        ]
        for key, values in tables.items():
            inside = ", ".join(
                f"{json.dumps(re.escape(joint))}: {number(value or 0.0)}" for joint, value in values.items()
            )
            lines += [f"        {key}={{{inside}}},"] if values else []
        lines += [f"        min_delay={late},", f"        max_delay={late},"] if late else []
        lines.append("    ),")
    return "\n".join([*lines, "}"]) + "\n"


def mjlab(drives: Drives, step_s: float | None = None) -> str:
    """Return the actuators of an ``EntityArticulationInfoCfg``; parameters and errors as of `isaac_lab`."""
    lines = [
        "# Written by didim. In your EntityArticulationInfoCfg: actuators=ACTUATORS",
        *_comments(drives),
        "from mjlab.actuator import BuiltinPositionActuatorCfg",
        "",
        "ACTUATORS = (",
    ]
    for drive in _with_gains(drives):
        values = {
            "stiffness": drive.kp,
            "damping": drive.kv or 0.0,
            "effort_limit": drive.effort,
            "armature": drive.rotor,
            "frictionloss": drive.coulomb,
            "viscous_damping": drive.viscous,
        }
        lines += [
            "    BuiltinPositionActuatorCfg(",
            f"        target_names_expr=({json.dumps(re.escape(drive.joint))},),",
        ]
        lines += [f"        {key}={number(value)}," for key, value in values.items() if value is not None]
        if steps := _steps(drive, step_s):
            lines += [f"        delay_min_lag={steps},", f"        delay_max_lag={steps},"]
        lines.append("    ),")
    return "\n".join([*lines, ")"]) + "\n"


def bam(drive: JointDrive, actuator: str | None = None) -> str:
    """Return the parameters of a joint for BAM's model M1, without the motor constants kt and R.

    BAM's ``load_parameters`` reads them into a model, and ``load_model`` makes one where BAM's name of the actuator is there.
    """
    keys = {
        "model": "m1",
        **({"actuator": actuator} if actuator else {}),
        "armature": drive.rotor,
        "friction_base": drive.coulomb,
        "friction_viscous": drive.viscous,
    }
    return json.dumps(keys, indent=2) + "\n"


def _with_gains(drives: Drives) -> list[JointDrive]:
    lacking = next((drive.joint for drive in drives.joints if drive.kp is None), None)
    if lacking is not None:
        raise FitError(
            f"the result has no gains of joint {lacking!r}; one on positions has (links = 'fixed')"
        )
    return list(drives.joints)


def _steps(drive: JointDrive, step_s: float | None) -> int:
    return 0 if step_s is None else round(drive.delay_s / step_s)


def _comments(drives: Drives) -> list[str]:
    return [f"# {sentence}" for sentence in drives.sentences]
