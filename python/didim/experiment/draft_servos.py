"""Lines of an experiment file for servos: the fit on positions, and logs of pendulums, whose files have their gains and loads.

The gain of a pendulum's log is in the servo's own unit, so that kp (N.m/rad for each unit) is an unknown, which the known loads
identify. Tested in ``tests/test_bam.py`` and ``tests/test_init_positions.py``.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from .._tools.toml import quoted
from .._tools.words import counted, series
from ..log.bam_file import Pendulum
from ..model.limbs import limbs_of
from ..robot.robot import Robot
from .loop_tables import of_actuators

THIN = 1e-6
"""Moment of inertia (kg.m^2) of a load about its own arm: a body needs one, and the axis of the servo does not turn it."""


DELAY = (
    "# What else is unknown of the drives: kp, kv, saturation, lag_s, acceleration, bias_rad; each with start, min, max, sigma,",
    "# shared.",
    "[unknown]",
    "delay_s = { max = 0.025, shared = true }",
    "# acceleration = { start = 39.0, min = 38.0, max = 40.0 } # rad/s^2, of set-points: 254 in the register of an STS3215",
)
"""Lines that declare the unknowns of servos: all motors on one bus share one delay."""


def pendulum_of(log: object) -> Pendulum | None:
    """Return gain and load of a log; None for logs of other containers."""
    return getattr(getattr(log, "data", None), "pendulum", None)


def recording_lines(log: object) -> list[str]:
    """Return the lines of a recording with the gain and the load of its log."""
    pendulum = pendulum_of(log)
    if pendulum is None:
        return []
    return [f"kp = {pendulum.kp:.9g} # in the unit of the servo", f"payload = {quoted(_name(pendulum))}"]


def payload_lines(logs: Iterable[object]) -> list[str]:
    """Return the tables of the loads of logs, each once."""
    lines = []
    for name, pendulum in {_name(each): each for each in map(pendulum_of, logs) if each is not None}.items():
        mass, distance, moment = pendulum.body
        across = f"{moment + THIN:.6g}"
        lines += [
            "",
            f"[payload.{name}]",
            f"mass_kg = {mass:.9g}",
            f"com_m = [0, 0, {-distance:.9g}] # confirm: frame of the robot file's last body, whose z axis points up at zero",
            f"inertia_kg_m2 = [{across}, 0, 0, {across}, 0, {THIN:g}]",
        ]
    return lines


def gain_lines(
    robot: Robot, logs: Sequence[object], servo: Mapping[str, Sequence[float]]
) -> tuple[str, str] | None:
    """Return the lines of kp for the controller and for the unknowns; None for logs of other containers.

    `servo` has the gains of the user, kp in N.m/rad for each unit. The default is the file's kp at the median gain of the logs.
    """
    gains = [pendulum.kp for pendulum in map(pendulum_of, logs) if pendulum is not None]
    if not gains:
        return None
    if servo.get("kp"):
        start = servo["kp"][0]
    else:  # the writer of recordings asks for gains that no actuator has
        start = next(
            (pendulum.kp for pendulum in robot.actuators if pendulum is not None and pendulum.kp), 1.0
        )
        start /= statistics.median(gains)
    return "kp = 1.0 # one unit of the servo", f"kp = {{ start = {start:.6g} }} # N.m/rad for each unit"


def _name(pendulum: Pendulum) -> str:
    return f"m{1e3 * pendulum.body[0]:.0f}g_{1e3 * pendulum.length_m:.0f}mm"


def servo_lines(
    robot: Robot, logs: Sequence[object], servo: Mapping[str, Sequence[float]], told: list[str]
) -> list[str]:
    """Return the lines of a fit on positions: fixed links, held commands, the law of the servos, and an unknown delay.

    `servo` has the gains of the user, ``kp`` and ``kv``; sentences go to `told`.
    """
    limbs = [limb for limb in limbs_of(robot) if len(limb.joints) < robot.n_dof]
    if limbs:
        names = series(f"{limb.name} ({counted(len(limb.joints), 'joint')})" for limb in limbs)
        told.append(f"{counted(len(limbs), 'limb')}, each a problem of its own: {names}")
    told.append(
        "no torques: drives and friction are fitted on positions, links held at the values of the robot file"
    )
    lines = [
        "",
        "# Masses and inertias are those of the robot file; rotor inertias, friction and offsets are identified.",
        "[parameters]",
        'links = "fixed"',
        "",
        "[reference]",
        'kind = "recorded"',
        'between_samples = "held" # confirm: commands jump from sample to sample',
        "",
        "# tau = kp (command - q) - kv dq, up to the limit",
        "[controller]",
        'kind = "pd"',
    ]
    of_logs = gain_lines(robot, logs, servo)
    of_file = of_actuators(robot)
    if of_logs is None and servo.get("kp") and not servo.get("kv") and {"kp", "kv"} <= of_file.keys():
        # One file of an SO-101 has kp 998 and kv 2.7, where its servos have 17.8 and none.
        kp = np.broadcast_to(servo["kp"], robot.n_dof).tolist()
        kv = [of if k == at else 0.0 for k, at, of in zip(kp, of_file["kp"], of_file["kv"], strict=True)]
        if kv != of_file["kv"]:
            servo = {**servo, "kv": kv}
            told.append(
                "kv of the robot file goes with its kp; where yours differs kv is 0, and Fv has the servo's damping too (--kv, if "
                "you know it)"
            )
    for key in ("kp", "kv"):
        values = ", ".join(f"{value:.9g}" for value in servo.get(key, ()))
        if key == "kp" and of_logs is not None:
            lines.append(of_logs[0])
        elif values:
            lines.append(f"{key} = [{values}]" if "," in values else f"{key} = {values}")
        else:
            lines.append(f"# {key}: those of the actuators of the robot file")
    lines.append("reference_velocity = 0.0")
    return [*lines, *_limits(robot), "", *DELAY, *(of_logs or ())[1:]]


def _limits(robot: Robot) -> list[str]:
    """Return the line of the servos' largest torques, if actuators or joints have them."""
    if "saturation" in of_actuators(robot):
        return ["# saturation_n_m: that of the actuators of the robot file"]
    efforts = [limits.effort for limits in robot.limits]
    if any(effort is None for effort in efforts):
        return ["# saturation_n_m = 3.0 # largest torque of a servo, where the log reaches it"]
    return [
        f"saturation_n_m = [{', '.join(f'{effort:.9g}' for effort in efforts)}] # confirm: limits of the robot file"
    ]
