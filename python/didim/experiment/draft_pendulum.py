"""Lines of an experiment file for logs of servos on pendulums, whose files have their gains and loads.

The gain is in the servo's own unit, so that kp (N.m/rad for each unit) is an unknown, which the known loads identify. Tested in
``tests/test_bam.py``.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence

from .._tools.toml import quoted
from ..log.formats.bam_file import Pendulum
from ..robot.robot import Robot

THIN = 1e-6
"""Moment of inertia (kg.m^2) of a load about its own arm: a body needs one, and the axis of the servo does not turn it."""


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
