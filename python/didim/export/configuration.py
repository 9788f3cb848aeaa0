"""Drives of a result as configuration of Isaac Lab and mjlab (Python), and as parameters of BAM's first friction model (JSON).

Tested in ``tests/test_export_drives.py``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence

from ..errors import FitError
from ..result.samples import Samples
from .drives import FIELDS, Drives, JointDrive
from .numbers import number

Ranges = Mapping[str, Mapping[str, tuple[float, float]]]
"""Lower and upper ends by field of a drive and joint."""

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
EVENTS = {"rotor": "joint_armature", "viscous": "joint_damping", "coulomb": "joint_friction"}
"""Functions of mjlab that randomise a field of all joints."""
LOST = "uniform ranges of 5 to 95 %, each by itself: didim export --samples has the same draws with their correlations"
"""Sentence on the events of a simulator."""
BAM = {"armature": "rotor", "friction_base": "coulomb", "friction_viscous": "viscous"}


def isaac_lab(drives: Drives, step_s: float | None = None, ranges: Ranges | None = None) -> str:
    """Return the actuators of an ``ArticulationCfg``, a group for each delay, which is in steps of the physics.

    With `ranges` come event terms that scale armatures, friction and gains. Isaac Lab scales viscous friction by the range of
    Coulomb friction, for it has no other.

    Parameters
    ----------
    drives : Drives
        Drives of a result on positions.
    step_s : float, optional
        Step of the physics, the unit of delays; without it delays are omitted.
    ranges : mapping, optional
        Lower and upper end by field of a drive and joint, see `ranges_of`.

    Raises
    ------
    FitError
        When the result has no gains.
    """
    groups: dict[int, list[JointDrive]] = {}
    for drive in _with_gains(drives):
        groups.setdefault(_delays([drive], step_s)[0], []).append(drive)
    kinds = {
        late: "DelayedPDActuatorCfg" if _delays(groups[late], step_s, ranges)[1] else "IdealPDActuatorCfg"
        for late in sorted(groups)
    }
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
        least, most = _delays(joints, step_s, ranges)
        lines += [f"        min_delay={least},", f"        max_delay={most},"] if most else []
        lines.append("    ),")
    lines.append("}")
    return "\n".join([*lines, *([] if ranges is None else isaac_lab_events(drives, ranges))]) + "\n"


def mjlab(drives: Drives, step_s: float | None = None, ranges: Ranges | None = None) -> str:
    """Return the actuators of an ``EntityArticulationInfoCfg``, and events with `ranges`; all as of `isaac_lab`."""
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
        least, most = _delays([drive], step_s, ranges)
        lines += [f"        delay_min_lag={least},", f"        delay_max_lag={most},"] if most else []
        lines.append("    ),")
    lines.append(")")
    return "\n".join([*lines, *([] if ranges is None else mjlab_events(drives, ranges))]) + "\n"


def isaac_lab_events(drives: Drives, ranges: Ranges) -> list[str]:
    """Return the lines of event terms that scale armatures, friction and gains; arguments as of `isaac_lab`."""
    lines = [
        "",
        f"# In your EventCfg: {LOST}. Viscous friction is scaled as Coulomb friction is.",
        "from isaaclab.envs import mdp",
        "from isaaclab.managers import EventTermCfg, SceneEntityCfg",
        "",
        "EVENTS = {",
    ]
    for title, function, fields in (
        ("joint", "joint_parameters", {"friction": "coulomb", "armature": "rotor"}),
        ("gains", "actuator_gains", {"stiffness": "kp", "damping": "kv"}),
    ):
        for drive in drives.joints:
            own = {
                key: _pair((low / value, high / value))
                for key, field in fields.items()
                if (value := getattr(drive, field)) and drive.joint in ranges.get(field, {})
                for low, high in [ranges[field][drive.joint]]
            }
            scales = "".join(f'"{key}_distribution_params": {ends}, ' for key, ends in own.items())
            scene = f'SceneEntityCfg("robot", joint_names=[{json.dumps(re.escape(drive.joint))}])'
            if own:
                lines.append(
                    f'    {json.dumps(f"{title}_{drive.joint}")}: EventTermCfg(func=mdp.randomize_{function}, mode="startup", '
                    f'params={{"asset_cfg": {scene}, {scales}"operation": "scale"}}),'
                )
    lines.append("}")
    return lines


def mjlab_events(drives: Drives, ranges: Ranges) -> list[str]:
    """Return the lines of events that set armatures, damping, friction, gains and limits; arguments as of `isaac_lab`.

    mjlab's functions of gains take the number of an actuator in ``ACTUATORS``, which has one for each joint.
    """
    lines = [
        "",
        f"# In your events: {LOST}.",
        "from mjlab.envs.mdp import dr",
        "from mjlab.managers.event_manager import EventTermCfg",
        "from mjlab.managers.scene_entity_config import SceneEntityCfg",
        "",
        "EVENTS = {",
    ]
    term = '    {}: EventTermCfg(func=dr.{}, mode="reset", params={{{}"operation": "abs"}}),'
    for field, function in EVENTS.items():
        own = {re.escape(joint): ends for joint, ends in ranges.get(field, {}).items()}
        pairs = ", ".join(f"{json.dumps(joint)}: {_pair(ends)}" for joint, ends in own.items())
        lines += [term.format(f'"{function}"', function, f'"ranges": {{{pairs}}}, ')] if own else []
    for k, drive in enumerate(drives.joints):
        scene = f'"asset_cfg": SceneEntityCfg("robot", actuator_ids=[{k}]), '
        fixed = {field: (getattr(drive, field) or 0.0,) * 2 for field in ("kp", "kv", "effort")}
        own = {field: ranges.get(field, {}).get(drive.joint, ends) for field, ends in fixed.items()}
        gains = f'{scene}"kp_range": {_pair(own["kp"])}, "kd_range": {_pair(own["kv"])}, '
        limits = f'{scene}"effort_limit_range": {_pair(own["effort"])}, '
        if own["kp"] != fixed["kp"] or own["kv"] != fixed["kv"]:
            lines.append(term.format(json.dumps(f"gains_{drive.joint}"), "pd_gains", gains))
        if own["effort"] != fixed["effort"]:
            lines.append(term.format(json.dumps(f"effort_{drive.joint}"), "effort_limits", limits))
    lines.append("}")
    return lines


def ranges_of(drives: Drives, samples: Samples) -> Ranges:
    """Return the 5 and 95 % of the drives' fields, by field and joint; none of what no log tells.

    They are moved as the step of a simulator has moved the drive (`didim.export.drives.for_step`), and not below zero.
    """
    ranges: dict[str, dict[str, tuple[float, float]]] = {}
    known = {drive.joint: drive for drive in drives.joints}
    for k, (kind, joints) in enumerate(zip(samples.kinds, samples.joints, strict=True)):
        low, _, high = samples.ranges[:, k].tolist()
        for joint in joints:
            if kind in FIELDS and joint in known and high > low:
                moved = (getattr(known[joint], FIELDS[kind]) or 0.0) - float(samples.estimate[k])
                ranges.setdefault(FIELDS[kind], {})[joint] = max(low + moved, 0.0), max(high + moved, 0.0)
    return ranges


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


def _delays(
    drives: Sequence[JointDrive], step_s: float | None, ranges: Ranges | None = None
) -> tuple[int, int]:
    """Return the least and the largest delay of drives with equal ones, in steps, none negative."""
    own = {} if ranges is None else ranges.get("delay_s", {})
    ends = [end for drive in drives for end in own.get(drive.joint, (drive.delay_s,) * 2)]
    steps = [0 if step_s is None else max(0, round(end / step_s)) for end in ends]
    return min(steps), max(steps)


def _pair(ends: tuple[float, float]) -> str:
    return f"({number(ends[0])}, {number(ends[1])})"
