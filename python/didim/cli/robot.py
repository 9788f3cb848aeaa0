"""``didim robot``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import OutputError
from .options import Commands, add_chain, add_command, add_flag, add_option, locked, refuse, tell
from .outputs import Saved, check_outputs, refuse_existing
from .terminal.messages import message

if TYPE_CHECKING:
    from ..robot.robot import Robot


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "robot",
        run,
        "print the rows and frames of a robot, or make a robot file of a URDF",
        "didim robot ur5e",
        "didim robot arm.urdf -o arm.toml",
        "didim robot arm.urdf --tip tool0 --lock finger_joint=0.02",
    )
    add_option(parser, "robot ROBOT", "URDF, robot file, or name of a packaged robot")
    add_option(
        parser,
        "-o --output ARM.toml",
        "robot file to write, of a URDF or as a copy of a packaged one (default: only describe it)",
        Path,
    )
    add_flag(parser, "--force", "overwrite an existing file")
    add_chain(parser, "the end of the only path that moves")
    parser.add_argument(
        "--gravity",
        metavar=("X", "Y", "Z"),
        nargs=3,
        type=float,
        help="gravity in the base link, m/s^2 (default: the z axis of the root link points up)",
    )
    add_option(
        parser,
        "--snap RAD",
        "largest angle by which rounded right angles are snapped (default: 1e-4; 0 for none)",
        float,
        default=None,
    )


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..robot.right_angles import SNAP
    from ..robot.robot_text import robot_text
    from ..robot.urdf.reading import read_urdf
    from ..robot.urdf.summary import rows_and_frames, summary

    if Path(options.robot).suffix.lower() not in (".urdf", ".xml", ".mjcf"):
        return _described(options, rows_and_frames)
    still = locked(options)
    _check_output(options)
    reading = read_urdf(
        Path(options.robot),
        tip=options.tip,
        base=options.base,
        lock=still,
        gravity=options.gravity,
        snap=SNAP if options.snap is None else options.snap,
        open=options.open,
    )
    if reading.suspicion is not None and options.snap is None:
        message(reading.suspicion, "warning")
    tell(reading.robot.notes)
    saved = Saved()
    if options.output is not None:
        saved.write(options.output, robot_text(reading.robot))
    return saved.end(summary(reading))


def _described(options: argparse.Namespace, rows_and_frames: Callable[[Robot], str]) -> int:
    """Print rows and frames of a robot that is not a URDF."""
    from ..robot.robot_file import PACKAGED, load_robot

    for name in ("tip", "base", "gravity", "lock", "open"):
        if getattr(options, name) not in (None, [], False):
            return refuse(f"--{name} is for a URDF, and {options.robot} is not one")
    robot = load_robot(options.robot, snap=options.snap)
    saved = Saved()
    if options.output is not None:
        file = PACKAGED / f"{options.robot}.toml"
        if not file.is_file():
            return refuse(
                f"-o is for a URDF or the name of a packaged robot, and {options.robot} is a file already"
            )
        _check_output(options)
        saved.write(options.output, file.read_bytes())
    tell(robot.notes)
    return saved.end(rows_and_frames(robot))


def _check_output(options: argparse.Namespace) -> None:
    """Refuse, before the work, a robot file that cannot be written."""
    if options.output is not None and options.output.suffix != ".toml":
        raise OutputError(f"-o {options.output}: the name of a robot file ends in .toml")
    check_outputs(options.output)
    refuse_existing(options.output, force=options.force)
