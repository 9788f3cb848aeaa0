"""Positions, speeds and torques beyond what the robot file allows, or any robot has. Tested in ``tests/test_check.py``."""

from __future__ import annotations

import numpy as np

from ..experiment.experiment import Experiment
from ..result.finding import Finding, worded
from ..signal.window import Window

ROOM = 1.02
"""Ratio to a declared limit that is tolerated: limits are rounded, and controllers overshoot a little."""
SEVERAL = 5.0
"""Ratio to a limit beyond which a wrong unit or side is likelier than a fast robot."""
LARGEST_RANGE = {"revolute": 8.0 * np.pi, "prismatic": 20.0}
"""Largest range of positions (rad, m) in one log: four turns or twenty metres, more than any joint of an arm moves."""


def check_limits(experiment: Experiment, parts: list[Window]) -> list[Finding]:
    """Compare the log with the limits of the robot, and with those of any robot."""
    robot = experiment.robot
    findings = []
    for joint, kind in enumerate(robot.joint_kinds):
        limits = robot.limits[joint]
        units = ("rad", "rad/s", "N.m") if kind == "revolute" else ("m", "m/s", "N")
        q = np.concatenate([part.q[:, joint] for part in parts])
        if np.ptp(q) > LARGEST_RANGE[kind]:
            turns = f", {np.ptp(q) / (2.0 * np.pi):.3g} turns" if kind == "revolute" else ""
            findings.append(
                worded(
                    kind="range",
                    sentence=f"joint {joint + 1} moves through {np.ptp(q):.4g} {units[0]}{turns}",
                    advice="Look at unit and side of [recording.position]: are these degrees, counts or motor angles?",
                    joints=(joint + 1,),
                    value=float(np.ptp(q)),
                )
            )
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
            seen = value
            if what == "position":
                seen, limit = (
                    (float(q.max()), high) if q.max() - middle >= middle - q.min() else (float(q.min()), low)
                )
            wrong = value > SEVERAL * (half if what == "position" else limit)
            findings.append(
                worded(
                    kind="limits",
                    sentence=f"the {what} of joint {joint + 1} reaches {seen:.4g} {unit}, the limit of robot "
                    f"'{robot.name}' is {limit:.4g} {unit}",
                    advice="Look at unit, side, rate and reduction of the log"
                    if wrong
                    else "Look at the limits of the robot file, and at unit, side and rate of the log",
                    joints=(joint + 1,),
                    value=seen,
                )
            )
    return findings
