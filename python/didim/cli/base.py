"""``didim base``."""

from __future__ import annotations

import argparse

from .options import CONVERGED, Commands, add_command, add_format, add_robot, tell
from .outputs import Saved


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "base",
        run,
        "list the base parameters of a robot, their groupings, its pose at q = 0 and its reach",
        "didim base tx40",
        "didim base arm.urdf --format latex",
    )
    add_robot(parser)
    add_format(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..model.kinematics import pose_lines
    from ..robot.robot_file import load_robot

    robot = load_robot(options.robot)
    tell(robot.notes)
    base = robot.base_parameters
    text = "\n".join([f"{robot.name}: {base}", "", *pose_lines(robot)])
    saved = Saved()
    saved.show_result(base, options.format, text)
    return saved.code(CONVERGED)
