"""Drives of a result as configuration of Isaac Lab and mjlab (Python), and as parameters of BAM's first friction model (JSON).

Tested in ``tests/test_export_drives.py``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping

from ..errors import FitError
from .drives import Drives, JointDrive
from .numbers import number

ISAAC_LAB = {
    "stiffness": "kp",
    "damping": "kv",
    "actuator_effort_limit": "effort",
    "armature": "rotor",
    "friction": "coulomb",
    "dynamic_friction": "coulomb",
    "viscous_friction": "viscous",
}
"""Fields of a drive by the keys of Isaac Lab; those of the other programs likewise."""
MJLAB = {
    "stiffness": "kp",
    "damping": "kv",
    "effort_limit": "effort",
    "armature": "rotor",
    "frictionloss": "coulomb",
    "viscous_damping": "viscous",
}
BAM = {"armature": "rotor", "friction_base": "coulomb", "friction_viscous": "viscous"}


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
        *(f"# {sentence}" for sentence in drives.sentences),
        f"from isaaclab.actuators import {', '.join(dict.fromkeys(kinds.values()))}",
        "",
        "ACTUATORS = {",
    ]
    for late, kind in kinds.items():
        joints = groups[late]
        name = "servos" if len(groups) == 1 else f"servos_{late}_steps_late"
        expressions = json.dumps([re.escape(drive.joint) for drive in joints])
        lines += [f'    "{name}": {kind}(', f"        joint_names_expr={expressions},"]
        values = {drive.joint: _values(drive, ISAAC_LAB) for drive in joints}
        for key in ISAAC_LAB:
            entries = [
                f"{json.dumps(re.escape(joint))}: {own[key]}" for joint, own in values.items() if key in own
            ]
            lines += [f"        {key}={{{', '.join(entries)}}},"] if entries else []
        lines += [f"        min_delay={late},", f"        max_delay={late},"] if late else []
        lines.append("    ),")
    return "\n".join([*lines, "}"]) + "\n"


def mjlab(drives: Drives, step_s: float | None = None) -> str:
    """Return the actuators of an ``EntityArticulationInfoCfg``; parameters and errors as of `isaac_lab`."""
    lines = [
        "# Written by didim. In your EntityArticulationInfoCfg: actuators=ACTUATORS",
        *(f"# {sentence}" for sentence in drives.sentences),
        "from mjlab.actuator import BuiltinPositionActuatorCfg",
        "",
        "ACTUATORS = (",
    ]
    for drive in _with_gains(drives):
        expression = json.dumps(re.escape(drive.joint))
        lines += ["    BuiltinPositionActuatorCfg(", f"        target_names_expr=({expression},),"]
        lines += [f"        {key}={value}," for key, value in _values(drive, MJLAB).items()]
        if steps := _steps(drive, step_s):
            lines += [f"        delay_min_lag={steps},", f"        delay_max_lag={steps},"]
        lines.append("    ),")
    return "\n".join([*lines, ")"]) + "\n"


def bam(drive: JointDrive, actuator: str | None = None) -> str:
    """Return the parameters of a joint for BAM's model M1, without the motor constants kt and R.

    BAM's ``load_parameters`` reads them into a model, and ``load_model`` makes one where BAM's name of the actuator is there.
    """
    keys = {"model": "m1", **({"actuator": actuator} if actuator else {})}
    keys |= {key: getattr(drive, field) for key, field in BAM.items()}
    return json.dumps(keys, indent=2) + "\n"


def _values(drive: JointDrive, keys: Mapping[str, str]) -> dict[str, str]:
    """Return the numbers of a drive by keys of a program; one without a limit has no effort."""
    values = {key: getattr(drive, field) for key, field in keys.items()}
    absent = {key for key, field in keys.items() if field == "effort" and drive.effort is None}
    return {key: number(value or 0.0) for key, value in values.items() if key not in absent}


def _with_gains(drives: Drives) -> list[JointDrive]:
    lacking = next((drive.joint for drive in drives.joints if drive.kp is None), None)
    if lacking is not None:
        raise FitError(
            f"the result has no gains of joint {lacking!r}; one on positions has (links = 'fixed')"
        )
    return list(drives.joints)


def _steps(drive: JointDrive, step_s: float | None) -> int:
    return 0 if step_s is None else round(drive.delay_s / step_s)
