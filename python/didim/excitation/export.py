"""Motions as files: a table, a ``[reference]`` for experiments, a URScript program, a trajectory for ROS 2.

Tested in ``tests/test_excitation_files.py``: each is read back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.files import write_atomically
from .._tools.words import listing
from ..errors import ExcitationError
from ..robot.robot import Robot
from .design import Excitation

SERVO_LOOKAHEAD_S, SERVO_GAIN = 0.1, 300
"""Settings of ``servoj``: the maker's defaults."""


def save(design: Excitation, path: str | Path) -> None:
    """Write a motion to a file.

    Parameters
    ----------
    design : Excitation
        The motion.
    path : str or Path
        The suffix selects the format, at the controller's rate and with ramps: ``.csv`` a table of times, positions,
        velocities and accelerations; ``.toml`` the ``[reference]`` of an experiment (without ramps); ``.script`` a URScript
        program; ``.yaml`` a JointTrajectory of ROS 2.

    Raises
    ------
    ExcitationError
        For another suffix, and for a URScript program of a robot that does not have six revolute joints.
    OSError
        When the file cannot be written.
    """
    path = Path(path)
    check_path(path, design.robot)
    write_atomically(path, WRITERS[path.suffix](design), (design.robot.digest,))


def check_path(path: Path, robot: Robot) -> None:
    """Refuse a file that `save` cannot write, before the work.

    Raises
    ------
    ExcitationError
        The message names the valid suffixes.
    """
    if path.suffix not in WRITERS:
        raise ExcitationError(f"'{path.name}': the file of a motion ends in one of {listing(WRITERS)}")
    if path.suffix == ".script" and robot.joint_kinds != ("revolute",) * 6:
        raise ExcitationError(
            f"'{path.name}': URScript is for robots with six revolute joints, and {robot.name!r} is not one"
        )


def reference_table(robot: Robot, table: Mapping[str, object]) -> Mapping[str, object]:
    """Entries of a table ``[reference]`` with units in their keys."""
    kinds = set(robot.joint_kinds)
    unit = {"revolute": "rad", "prismatic": "m"}
    both = "si" if len(kinds) == 2 else unit[next(iter(kinds))]
    entries: dict[str, object] = {}
    for key, value in table.items():
        if key in ("sine", "cosine", "points"):
            entries[f"{key}_{both}"] = np.asarray(value).tolist()
        elif key in ("offset", "max_velocity", "max_acceleration"):
            per = {"offset": "", "max_velocity": "_s", "max_acceleration": "_s2"}[key]
            for kind in sorted(kinds, reverse=True):
                entries[f"{key}_{unit[kind]}{per}"] = np.asarray(value).tolist()
        else:
            entries[key] = value
    return entries


def csv(design: Excitation) -> str:
    """Table with a header ``t,q1,...,dq1,...,ddq1,...``."""
    t, *values = design.sampled()
    n = design.robot.n_dof
    names = ["t", *(f"{kind}{j + 1}" for kind in ("q", "dq", "ddq") for j in range(n))]
    rows = np.column_stack([t, *values])
    return "\n".join([",".join(names), *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n"


def reference_toml(design: Excitation) -> str:
    """Table ``[reference]`` of an experiment file."""
    lines = [
        f"# {design.robot.name}: {design.reference.duration:g} s, designed by didim excite; ramps are not in it",
        "[reference]",
    ]
    for key, value in design.tables.items():
        if isinstance(value, str):
            lines.append(f'{key} = "{value}"')
        elif isinstance(value, list) and isinstance(value[0], list):
            lines += [f"{key} = [", *(f"    {_numbers(row)}," for row in value), "]"]
        elif isinstance(value, list):
            lines.append(f"{key} = {_numbers(value)}")
        else:
            lines.append(f"{key} = {float(value)!r}")  # type: ignore[arg-type]
    return "\n".join(lines) + "\n"


def urscript(design: Excitation) -> str:
    """Program for a UR controller: a move to the first point, then one ``servoj`` per sample."""
    t, q, _, _ = design.sampled()
    period = 1.0 / design.settings.rate_hz
    name = "".join(letter if letter.isalnum() else "_" for letter in design.robot.name)
    lines = [
        f"# {design.robot.name}: {t[-1]:g} s at {design.settings.rate_hz:g} Hz, designed by didim excite",
        f"def excite_{name}():",
        f"  movej({_numbers(q[0])}, a=0.5, v=0.3)",
        *(f"  servoj({_numbers(row)}, 0, 0, {period!r}, {SERVO_LOOKAHEAD_S}, {SERVO_GAIN})" for row in q[1:]),
        "  stopj(2.0)",
        "end",
        f"excite_{name}()",
    ]
    return "\n".join(lines) + "\n"


def joint_trajectory(design: Excitation) -> str:
    """Message ``trajectory_msgs/JointTrajectory`` of ROS 2 as YAML."""
    t, q, dq, ddq = design.sampled()
    lines = ["joint_names:", *(f"- {name}" for name in joint_names(design.robot)), "points:"]
    for at, position, velocity, acceleration in zip(t, q, dq, ddq, strict=True):
        nanoseconds = round(at * 1e9)
        lines += [
            f"- positions: {_numbers(position)}",
            f"  velocities: {_numbers(velocity)}",
            f"  accelerations: {_numbers(acceleration)}",
            f"  time_from_start: {{sec: {nanoseconds // 10**9}, nanosec: {nanoseconds % 10**9}}}",
        ]
    return "\n".join(lines) + "\n"


def joint_names(robot: Robot) -> tuple[str, ...]:
    """Names of the joints: those of the robot's description, or ``joint_1``, ``joint_2``, ..."""
    names = getattr(robot, "joint_names", None) or ()
    if len(names) == robot.n_dof:
        return tuple(names)
    return tuple(f"joint_{joint + 1}" for joint in range(robot.n_dof))


def _numbers(row: Array | list[float]) -> str:
    return "[" + ", ".join(repr(float(value) + 0.0) for value in row) + "]"


WRITERS: Mapping[str, Callable[[Excitation], str]] = {
    ".csv": csv,
    ".toml": reference_toml,
    ".script": urscript,
    ".yaml": joint_trajectory,
}
"""Function that writes a format, by file suffix."""
