"""Positions, speeds and torques beyond what the robot file allows, or any robot has. Tested in ``tests/test_check.py``."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from .._tools.arrays import Array
from .._tools.words import joints_text
from ..errors import DidimError
from ..evidence.rows import LogRows
from ..experiment.experiment import Experiment
from ..result.finding import Finding, worded
from ..robot.robot import Robot
from ..signal.window import Window

ROOM = 1.02
"""Ratio to a declared limit that is tolerated: limits are rounded, and controllers overshoot a little."""
LARGEST_RANGE = {"revolute": 8.0 * np.pi, "prismatic": 20.0}
"""Largest range of positions (rad, m) in one log: four turns or twenty metres, more than any joint of an arm moves."""


THOUSAND, SPREAD = 1000.0, 10.0**0.5
"""Factor between N.m and mN.m, and the ratio by which masses and friction of a robot file may be wrong beside it."""
FEW = 2
"""Largest number of joints beyond their limits that have a line each; more have one cause, and one line."""
SEVERAL = 5.0
"""Ratio to a limit beyond which a wrong unit or side is likelier than a fast robot."""
LEAST_EFFORT = 0.01
"""Share of its largest torque that a robot uses at least on a motion to be identified, the median of its joints."""


def check_limits(experiment: Experiment, parts: list[Window]) -> list[Finding]:
    """Compare the log with the limits of the robot, and with those of any robot."""
    robot = experiment.robot
    far, beyond = [], {"position": [], "speed": [], "torque": []}  # type: ignore[var-annotated]
    for joint, kind in enumerate(robot.joint_kinds):
        limits = robot.limits[joint]
        units = ("rad", "rad/s", "N.m") if kind == "revolute" else ("m", "m/s", "N")
        q = np.concatenate([part.q[:, joint] for part in parts])
        if np.ptp(q) > LARGEST_RANGE[kind]:
            turns = f", {np.ptp(q) / (2.0 * np.pi):.3g} turns" if kind == "revolute" else ""
            far.append((joint, float(np.ptp(q)), f"{np.ptp(q):.4g} {units[0]}{turns}"))
            continue
        low, high = limits.position or (-np.inf, np.inf)
        speed, torque = (
            max(float(np.abs(values[:, joint]).max()) for values in arrays)
            for arrays in ([part.dq for part in parts], [part.tau for part in parts])
        )
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        excess = [
            ("position", float(np.abs(q - middle).max()) if limits.position else 0.0, half, units[0]),
            ("speed", speed, limits.velocity, units[1]),
            ("torque", torque, limits.effort, units[2]),
        ]
        for what, value, limit, unit in excess:
            if limit is None or not value > ROOM * limit:
                continue
            seen, ratio = value, value / limit
            if what == "position":
                seen, limit = (
                    (float(q.max()), high) if q.max() - middle >= middle - q.min() else (float(q.min()), low)
                )
            beyond[what].append((joint, seen, ratio, f"{seen:.4g} {unit}", f"{limit:.4g} {unit}"))
    return [
        *_ranges(far),
        *(item for what, each in beyond.items() for item in _limits(robot.name, what, each)),
    ]


def _ranges(far: Sequence[tuple[int, float, str]]) -> list[Finding]:
    advice = "Look at unit and side of [recording.position]: are these degrees, counts or motor angles?"
    if len(far) > FEW:
        largest = max(far, key=lambda each: each[1])
        far_joints = joints_text(joint for joint, _, _ in far)
        text = f"{far_joints} move too far, joint {largest[0] + 1} through {largest[2]}"
        joints = tuple(joint + 1 for joint, _, _ in far)
        return [worded(kind="range", sentence=text, advice=advice, joints=joints, value=largest[1])]
    return [
        worded(
            kind="range",
            sentence=f"joint {joint + 1} moves through {seen}",
            advice=advice,
            joints=(joint + 1,),
            value=value,
        )
        for joint, value, seen in far
    ]


def _limits(robot: str, what: str, beyond: Sequence[tuple[int, float, float, str, str]]) -> list[Finding]:
    def advice(ratio: float) -> str:
        if ratio > SEVERAL:
            return "Look at unit, side, rate and reduction of the log"
        return "Look at the limits of the robot file, and at unit, side and rate of the log"

    if len(beyond) > FEW:
        joint, value, ratio, seen, limit = max(beyond, key=lambda each: each[2])
        return [
            worded(
                kind="limits",
                sentence=f"the {what}s of {joints_text(each[0] for each in beyond)} are beyond the limits of robot '{robot}', "
                f"that of joint {joint + 1} by the most: {seen}, and the limit is {limit}",
                advice=advice(ratio),
                joints=tuple(each[0] + 1 for each in beyond),
                value=value,
            )
        ]
    return [
        worded(
            kind="limits",
            sentence=f"the {what} of joint {joint + 1} reaches {seen}, the limit of robot '{robot}' is {limit}",
            advice=advice(ratio),
            joints=(joint + 1,),
            value=value,
        )
        for joint, value, ratio, seen, limit in beyond
    ]


def check_torque_unit(robot: Robot, rows: LogRows, parts: list[Window]) -> list[Finding]:
    """Try torques in mN.m for N.m, by what known parameters predict, or by the limits of the robot.

    A fit has any scale, so it does not see the unit: parameters of the robot file, which may be some tens of per cent wrong, or the
    largest torques over the limits of effort decide.
    """
    factors = []
    known = [robot.base_parameters.project(x) for x in _sets(robot)]
    for beta in known:
        predicted = rows.w[:, :, : len(beta)] @ beta
        power = np.sum(predicted**2, axis=1)
        moved = power > 0.0
        if moved.any():
            factors.append(float(np.median(np.sum(rows.y * predicted, axis=1)[moved] / power[moved])))
    efforts = [limits.effort for limits in robot.limits]
    if not known and all(efforts):
        largest = np.max([np.abs(part.tau).max(axis=0) for part in parts], axis=0)
        shares = largest / np.array(efforts, dtype=np.float64)
        usual = np.median(shares) > LEAST_EFFORT * THOUSAND and (shares <= ROOM * THOUSAND).all()
        factors.append(THOUSAND if usual else 1.0)
    if not factors or not all(THOUSAND / SPREAD < factor < THOUSAND * SPREAD for factor in factors):
        return []
    return [
        worded(
            kind="torque-unit",
            grade="wrong",
            sentence="the torques look 1000 times too large, as if they were in mN.m, not in N.m: "
            + (
                "by the parameters of the robot file"
                if known
                else f"the limits of robot '{robot.name}' fit a thousandth of them"
            ),
            advice="Write scale = 0.001 under [recording.torque]",
            joints=tuple(range(1, robot.n_dof + 1)),
            value=THOUSAND,
        )
    ]


def _sets(robot: Robot) -> list[Array]:
    """Return the parameter sets of the robot file that are whole."""
    whole = []
    for name in robot.sets:
        with suppress(DidimError):
            whole.append(robot.parameter_set(name))
    return whole
