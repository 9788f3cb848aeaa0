"""Parameters that a log does not identify.

A standard deviation in percent says little: a parameter near zero is never known to 10 %, and need not be. What counts is the
torque that its uncertainty makes. Each standard deviation is multiplied by what its column of the regressor (2) is on a rich motion
(random configurations, every joint as fast as the fastest of its kind in the log) and compared with the torques of the log.
Tested in ``tests/test_check.py``.
"""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array, rms
from .._tools.words import joints_text, series
from ..evidence.rows import LogRows
from ..model.dynamics import regressor
from ..result.finding import Finding, worded

CAP = 1e3
"""Value that replaces the infinite uncertainty of a parameter without any effect, so that the matrix can be inverted."""
RESTING = 0.02
"""Speed, as a share of that of the fastest joint of the same kind, below which a joint rests."""
SMALLEST_SHARE = 1e-6
"""Lower bound of a joint's residual, as a share of its torque: weights stay finite on logs without noise."""
UNCERTAIN_SHARE = 0.1
"""Torque uncertainty on a rich motion due to one parameter, as a share of the joint's torque, from which it is reported. Logs
of a good motion have 0.01 (simulated) to 0.05 (measured), a joint at rest 0.1 to 10 000."""
CONFIGURATIONS = 500
"""Number of random states of the rich motion."""


def check_excitation(rows: LogRows, n_rows: float) -> list[Finding]:
    """Name the base parameters that a log with this number of rows does not identify, and the joints at rest."""
    robot = rows.robot
    q, dq, ddq = (np.concatenate([getattr(part, key) for part in rows.parts]) for key in ("q", "dq", "ddq"))
    alike = np.equal.outer(robot.joint_kinds, robot.joint_kinds)
    speed, acceleration = (rms(values) for values in (dq, ddq))
    fastest, hardest = (np.max(alike * values, axis=1) for values in (speed, acceleration))
    resting = np.flatnonzero(speed <= RESTING * fastest)
    if len(resting) == rows.n:
        return []
    torque = np.sqrt(np.mean(rows.y**2, axis=1))
    sigma = np.maximum(np.sqrt(rows.products.seen() / rows.y.shape[1]), SMALLEST_SHARE * torque)
    information = np.tensordot(1.0 / sigma**2, rows.products.g.sum(axis=1), 1)
    shares = _shares(rows, q, (fastest, hardest), torque, information * (n_rows / rows.y.shape[1]))
    uncertain = tuple(rows.names[k] for k in np.flatnonzero(shares > UNCERTAIN_SHARE))
    if not uncertain:
        return []
    if len(resting):
        ranges = np.ptp(q[:, resting], axis=0)
        units = "rad" if robot.joint_kinds[resting[0]] == "revolute" else "m"
        moves = "moves" if len(resting) == 1 else "move"
        shown = series((f"{value:.2g}" for value in ranges), 24)
        sentence = (
            f"{joints_text(resting)} hardly {moves} (through {shown} {units}), so this log does not identify "
        )
        sentence += series(uncertain, 40)
        advice = "Record a motion in which every joint moves, or drop these parameters under [parameters]"
        advice += "; if the joint did move, its encoder is dead" if 0.0 in ranges else ""
    else:
        values = np.linalg.eigvalsh(information / np.sqrt(np.outer(*[np.diag(information)] * 2)))
        with np.errstate(over="ignore"):  # infinite for a direction that the log does not identify
            condition = float(np.sqrt(values[-1] / max(values[0], np.finfo(float).tiny)))
        names = series(uncertain, 90)
        sentence = f"this log does not separate {names} from others and from noise (condition number {condition:.3g})"
        advice = "Record a richer motion (more configurations and speeds), or drop these parameters under [parameters]"
    joints = tuple(int(joint) + 1 for joint in resting)
    return [worded(kind="excitation", sentence=sentence, advice=advice, joints=joints, parameters=uncertain)]


def _shares(
    rows: LogRows, logged: Array, rich: tuple[Array, Array], torque: Array, information: Array
) -> Array:
    """Torque that the uncertainty of each parameter makes on a rich motion, as a share of the joint's it acts on most."""
    rng, robot = np.random.default_rng(0), rows.robot
    shape = (CONFIGURATIONS, rows.n)
    revolute = np.array([kind == "revolute" for kind in robot.joint_kinds])
    low = np.where(revolute, -np.pi, logged.min(axis=0))
    high = np.where(revolute, np.pi, logged.max(axis=0))
    w = regressor(robot, rng.uniform(low, high, shape), *(rng.normal(0.0, size, shape) for size in rich))
    b = len(rows.beta)
    w = w[:, :, list(robot.base_parameters.indices)] / rows.products.scale[:b]
    effect = np.max(rms(w) / torque[:, None], axis=0)
    # What the logs have beside the robot acts in them alone.
    effect = np.append(effect, np.ones(len(information) - b))
    # A weak prior in these units: it only affects parameters that the log does not identify.
    scaled = information / np.outer(effect, effect) + np.eye(len(effect)) / CAP**2
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(scaled)))[:b])
