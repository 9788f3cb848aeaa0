"""Parameters that a log does not identify.

A standard deviation in percent says little: a parameter near zero is never known to 10 %, and need not be. What counts is the
torque that its uncertainty makes. Each standard deviation is multiplied by what its column of the regressor (2) is on a rich motion
(random configurations, every joint as fast as the fastest of its kind in the log) and compared with the torques of the log.
Tested in ``tests/test_check.py``.
"""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array
from ..model.dynamics import regressor
from ..robot.robot import Robot
from ..signal.segments import Segment
from .finding import Finding
from .probe import Probe, Reading

UNTOLD = 0.1
"""Share of the torque of a joint that the uncertainty of one parameter may make on a rich motion. Logs of a good motion have 0.01
(simulated) to 0.05 (measured), a joint that rests 0.1 to 10 000."""
RESTING = 0.02
"""Speed, against the fastest joint of its kind, below which a joint rests."""
CAP = 1e3
"""Share that a parameter without any effect gets, so that it can be inverted with the others."""
CONFIGURATIONS = 500
"""Random states of the rich motion."""


def check_excitation(robot: Robot, parts: list[Segment], probe: Probe, reading: Reading) -> list[Finding]:
    """Name the base parameters that the log cannot tell, and the joints that rest."""
    speed = _rms([part.dq for part in parts])
    acceleration = _rms([part.ddq for part in parts])
    torque = probe.sizes(reading.torque) / np.sqrt(probe.n_rows)
    fastest = np.array([_fastest(robot, speed, joint) for joint in range(robot.n_dof)])
    hardest = np.array([_fastest(robot, acceleration, joint) for joint in range(robot.n_dof)])
    resting = tuple(joint + 1 for joint in range(robot.n_dof) if speed[joint] <= RESTING * fastest[joint])
    if len(resting) == robot.n_dof or not (torque > 0.0).all():
        return []
    shares = _shares(robot, parts, probe, reading, (fastest, hardest), torque)
    untold = tuple(probe.names[k] for k in np.flatnonzero(shares > UNTOLD))
    if not untold:
        return []
    which = f"{', '.join(untold)}"
    if resting:
        joints = (
            f"joint {resting[0]} hardly moves"
            if len(resting) == 1
            else f"joints {', '.join(map(str, resting))} hardly move"
        )
        ranges = [np.ptp(np.concatenate([part.q[:, joint - 1] for part in parts])) for joint in resting]
        shown = ", ".join(f"{value:.2g}" for value in ranges)
        units = "rad" if robot.joint_kinds[resting[0] - 1] == "revolute" else "m"
        sentence = f"{joints} (through {shown} {units}), so that this log cannot tell {which}"
        advice = "Record a motion in which every joint moves, or drop these parameters under [parameters]"
        if 0.0 in ranges:
            advice += "; if the joint did move, its encoder is dead"
    else:
        condition = _condition(probe, reading)
        sentence = (
            f"this log cannot tell {which} from the others and from noise (condition number {condition:.3g})"
        )
        advice = (
            "Record a richer motion (more configurations, speeds and accelerations), or drop these parameters under "
            "[parameters]"
        )
    return [Finding(kind="excitation", sentence=sentence, advice=advice, joints=resting, parameters=untold)]


def _rms(arrays: list[Array]) -> Array:
    return np.asarray(np.sqrt(np.mean(np.concatenate(arrays) ** 2, axis=0)))


def _fastest(robot: Robot, values: Array, joint: int) -> float:
    return float(
        max(
            value
            for value, kind in zip(values, robot.joint_kinds, strict=True)
            if kind == robot.joint_kinds[joint]
        )
    )


def _shares(
    robot: Robot,
    parts: list[Segment],
    probe: Probe,
    reading: Reading,
    rich: tuple[Array, Array],
    torque: Array,
) -> Array:
    """Torque that the uncertainty of each parameter makes on a rich motion, as a share of the joint's it acts on most."""
    rng = np.random.default_rng(0)
    shape = (CONFIGURATIONS, robot.n_dof)
    logged = np.concatenate([part.q for part in parts])
    revolute = np.array([kind == "revolute" for kind in robot.joint_kinds])
    low = np.where(revolute, -np.pi, logged.min(axis=0))
    high = np.where(revolute, np.pi, logged.max(axis=0))
    w = regressor(
        robot, rng.uniform(low, high, shape), rng.normal(0.0, rich[0], shape), rng.normal(0.0, rich[1], shape)
    )
    w = w[:, :, list(robot.base_parameters.indices)]
    w = np.concatenate([w, w @ probe.parameters.own_columns()], axis=2)
    names = probe.parameters.names
    w = w[:, :, [names.index(name) for name in probe.names]]
    effect = np.max(np.sqrt(np.mean(w**2, axis=0)) / torque[:, None], axis=0)
    information, _, _ = probe.information(reading)
    # A weak prior in these units: it only affects parameters that the log does not identify.
    scaled = information / np.outer(effect, effect) + np.eye(len(effect)) / CAP**2
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(scaled))))


def _condition(probe: Probe, reading: Reading) -> float:
    """Condition number of the weighted observation matrix with columns of norm 1."""
    information, _, _ = probe.information(reading)
    size = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    values = np.linalg.eigvalsh(information / np.outer(size, size))
    with np.errstate(over="ignore"):  # infinite for a direction that the log does not identify
        return float(np.sqrt(values[-1] / max(values[0], np.finfo(float).tiny)))
