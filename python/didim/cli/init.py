"""``didim init``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from .options import (
    CONVERGED,
    NOT_CONVERGED,
    add_command,
    tell,
)

if TYPE_CHECKING:
    from .options import Commands


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(commands, "init", run, "write a first experiment file for a log, to be confirmed")
    parser.add_argument(
        "robot", metavar="ROBOT", help="name of a packaged robot, or path of a robot file or a URDF"
    )
    parser.add_argument("log", metavar="LOG.csv", type=Path, help="text file with one sample a line")
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
    parser.add_argument("--force", action="store_true", help="overwrite an existing file")


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..experiment.draft import initialise

    path, draft = initialise(
        options.robot, options.log, options.output, rate_hz=options.rate, force=options.force
    )
    print(f"{path}: written")
    tell(draft.notes)
    for sentence in draft.read:
        print(f"- {sentence}")
    for question in draft.questions:
        print(f"didim: open: {question}", file=sys.stderr)
    return NOT_CONVERGED if draft.questions else CONVERGED
