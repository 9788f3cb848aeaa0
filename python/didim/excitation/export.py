"""Motions as files: a table, a ``[reference]`` for experiments, a URScript program, a trajectory for ROS 2.

Tested in ``tests/test_excitation_files.py``: each is read back.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator, Mapping
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
    # Line by line: a million lines of text in memory take four times as much as their bytes.
    text = io.BytesIO()
    text.writelines(f"{line}\n".encode() for line in WRITERS[path.suffix](design))
    write_atomically(path, text.getvalue(), (design.robot.digest,))


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


def csv(design: Excitation) -> Iterator[str]:
    """Table with a header ``t,q1,...,dq1,...,ddq1,...``."""
    t, *values = design.sampled()
    n = design.robot.n_dof
    names = ["t", *(f"{kind}{j + 1}" for kind in ("q", "dq", "ddq") for j in range(n))]
    yield ",".join(names)
    yield from (",".join(map(repr, row.tolist())) for row in np.column_stack([t, *values]))


def reference_toml(design: Excitation) -> Iterator[str]:
    """Table ``[reference]`` of an experiment file."""
    yield f"# {design.robot.name}: {design.reference.duration:g} s, designed by didim excite; ramps are not in it"
    yield "[reference]"
    for key, value in design.tables.items():
        if isinstance(value, str):
            yield f'{key} = "{value}"'
        elif isinstance(value, list) and isinstance(value[0], list):
            yield from (f"{key} = [", *(f"    {_numbers(row)}," for row in value), "]")
        elif isinstance(value, list):
            yield f"{key} = {_numbers(value)}"
        else:
            yield f"{key} = {float(value)!r}"  # type: ignore[arg-type]


def urscript(design: Excitation) -> Iterator[str]:
    """Program for a UR controller: a move to the first point, then one ``servoj`` per sample."""
    t, q, _, _ = design.sampled()
    period = 1.0 / design.settings.rate_hz
    name = "".join(letter if letter.isalnum() else "_" for letter in design.robot.name)
    yield f"# {design.robot.name}: {t[-1]:g} s at {design.settings.rate_hz:g} Hz, designed by didim excite"
    yield f"def excite_{name}():"
    yield f"  movej({_numbers(q[0])}, a=0.5, v=0.3)"
    for row in q[1:]:
        yield f"  servoj({_numbers(row)}, 0, 0, {period!r}, {SERVO_LOOKAHEAD_S}, {SERVO_GAIN})"
    yield from ("  stopj(2.0)", "end", f"excite_{name}()")


def joint_trajectory(design: Excitation) -> Iterator[str]:
    """Message ``trajectory_msgs/JointTrajectory`` of ROS 2 as YAML."""
    t, q, dq, ddq = design.sampled()
    yield from ("joint_names:", *(f"- {json.dumps(name)}" for name in joint_names(design.robot)), "points:")
    for at, position, velocity, acceleration in zip(t, q, dq, ddq, strict=True):
        nanoseconds = round(at * 1e9)
        yield f"- positions: {_numbers(position)}"
        yield f"  velocities: {_numbers(velocity)}"
        yield f"  accelerations: {_numbers(acceleration)}"
        yield f"  time_from_start: {{sec: {nanoseconds // 10**9}, nanosec: {nanoseconds % 10**9}}}"


def joint_names(robot: Robot) -> tuple[str, ...]:
    """Names of the joints: those of the robot's description, or ``joint_1``, ``joint_2``, ..."""
    return robot.joint_names or tuple(f"joint_{joint + 1}" for joint in range(robot.n_dof))


def _numbers(row: Array | list[float]) -> str:
    return "[" + ", ".join(repr(float(value) + 0.0) for value in row) + "]"


WRITERS: Mapping[str, Callable[[Excitation], Iterator[str]]] = {
    ".csv": csv,
    ".toml": reference_toml,
    ".script": urscript,
    ".yaml": joint_trajectory,
}
"""Function that yields the lines of a format, by file suffix."""
