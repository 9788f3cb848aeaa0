"""``didim init``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .options import (
    CONVERGED,
    NOT_CONVERGED,
    add_command,
    refuse,
    tell,
)
from .outputs import Saved
from .terminal.messages import message

if TYPE_CHECKING:
    from .options import Commands


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands, "init", run, "write a first experiment file for a log, to be confirmed", EXAMPLES
    )
    parser.add_argument(
        "robot", metavar="ROBOT", help="name of a packaged robot, or path of a robot file or a URDF"
    )
    parser.add_argument(
        "logs",
        metavar="LOG",
        type=Path,
        nargs="+",
        help="text with one sample a line, .npz, .mat, .h5, or a ROS bag; several become several recordings",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE.toml",
        type=Path,
        help="experiment file (default: LOG.toml beside the log)",
    )
    parser.add_argument(
        "--rate", metavar="HZ", type=float, help="sampling rate, for a log without time stamps"
    )
    parser.add_argument(
        "--columns",
        metavar="KIND=COLUMNS",
        action="append",
        default=[],
        help="columns of a signal whose names do not say it: --columns position=2-7 --columns current=14-19; kinds are time, "
        "position, velocity, torque, current, voltage, reference",
    )
    parser.add_argument(
        "--gain",
        metavar="GAIN",
        type=float,
        nargs="+",
        default=[],
        help="drive gains, N.m or N per A or V: one for all joints, or one for each",
    )
    parser.add_argument(
        "--values-per-sample",
        metavar="N",
        type=int,
        help="values in each sample, for a text with one value a line",
    )
    parser.add_argument("--topic", metavar="TOPIC", help="topic of joint states, for a ROS bag with several")
    parser.add_argument("--force", action="store_true", help="overwrite an existing file")


EXAMPLES = (
    "didim init ur5e log.csv",
    "didim init arm.urdf log1.csv log2.csv -o logs.toml",
    "didim init ur10e free.csv --columns current=14-19 --gain 14.87 13.26 11.13 10.62 11.03 11.47",
)
"""Examples of the help."""


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from .._tools.files import write_atomically
    from ..experiment.draft import initialise

    chosen = {}
    for text in options.columns:
        kind, sign, columns = text.partition("=")
        if not sign or not columns:
            return refuse(f"--columns takes KIND=COLUMNS, such as --columns torque=14-19, got {text!r}")
        chosen[kind] = columns
    saved = Saved()
    path, draft = initialise(
        options.robot,
        options.logs,
        options.output,
        rate_hz=options.rate,
        columns=chosen,
        gains=options.gain,
        values_per_sample=options.values_per_sample,
        topic=options.topic,
        force=options.force,
        write=lambda path, text: saved.save(path, lambda place: write_atomically(place, text)),
    )
    if not saved.failed:
        print(f"{path}: written")
    tell(draft.notes)
    for sentence in draft.read:
        saved.show(f"- {sentence}")
    for question in draft.questions:
        message(question, "open")
    return saved.code(NOT_CONVERGED if draft.questions else CONVERGED)
