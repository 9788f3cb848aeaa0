"""``didim excite``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .options import (
    CONVERGED,
    INTERRUPTED,
    Commands,
    add_command,
    add_flag,
    add_option,
    add_report,
    add_robot,
    check_report,
)
from .outputs import Saved, check_outputs
from .terminal.messages import progress_lines

DESIGN_PROGRESS_S = 1.0
"""Time (s) between two progress lines of a design."""


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "excite",
        run,
        "design the motion that identifies a robot best within its limits",
        "didim excite ur5e -o motion.csv",
        "didim excite arm.toml excite.toml -o motion.script --report motion.html",
        "didim excite so101.xml --positions -o motion.csv -o motion.json",
    )
    add_robot(parser)
    add_option(
        parser,
        "settings EXCITE.toml",
        "settings of the design (default: ten seconds, all parameters)",
        Path,
        nargs="?",
    )
    add_option(
        parser,
        "-o --output FILE",
        "write the motion: .csv, .toml ([reference] of an experiment), .script (URScript) or .yaml (JointTrajectory of "
        "ROS 2); may be given several times",
        Path,
        action="append",
        default=[],
    )
    add_option(parser, "--for NAME", "base parameters that count (default: all)", dest="wanted", nargs="+")
    add_flag(
        parser,
        "--positions",
        "write commands that identify drives and friction by positions alone, for ROBOT with position actuators or an experiment "
        "file with known links: -o motion.csv, or .json with actions of LeRobot",
    )
    add_report(parser)
    add_flag(parser, "--quiet", "no progress on stderr")


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from dataclasses import replace

    from .._tools.progress import shows_progress
    from ..excitation.excite import excite
    from ..excitation.export import check_path, save
    from ..excitation.settings import ExcitationSettings
    from ..excitation.settings_file import read_excitation
    from ..robot.robot_file import load_robot

    if options.positions:
        return _positions(options)
    check_report(options)
    robot = load_robot(options.robot)
    for path in options.output:
        check_path(path, robot)
    settings = ExcitationSettings() if options.settings is None else read_excitation(options.settings, robot)
    if options.wanted is not None:
        settings = replace(settings, wanted=tuple(options.wanted))
    check_outputs(*options.output, options.report)
    line = progress_lines(DESIGN_PROGRESS_S)

    def progress(start: int, evaluations: int, value: float) -> None:
        line(f"start {start}: {evaluations} motions, criterion {value:.1f}", False)

    design = excite(
        robot,
        settings,
        progress=None if options.quiet or shows_progress() else progress,
        verbose=False if options.quiet else None,
    )
    # Files are written first, so the result survives a reader of stdout that stops early.
    saved = Saved()
    for path in options.output:
        saved.save(path, lambda target: save(design, target))
    saved.save_report(options.report, design)
    return saved.end(str(design), INTERRUPTED if design.interrupted else CONVERGED)


def _positions(options: argparse.Namespace) -> int:
    """Design commanded positions for an experiment."""
    from ..excitation.positions import excite_positions
    from ..excitation.settings_file import read_excitation
    from ..robot.robot_file import load_robot

    check_outputs(*options.output)
    settings = options.settings and read_excitation(options.settings, load_robot(options.robot))
    motion = excite_positions(options.robot, settings=settings)
    saved = Saved()
    for path in options.output:
        saved.save(path, motion.save)
    return saved.end(str(motion))
