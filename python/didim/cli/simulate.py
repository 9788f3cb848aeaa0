"""``didim simulate``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .options import CONVERGED, NOT_CONVERGED, add_command, add_experiment
from .outputs import Saved, check_outputs
from .terminal.messages import message

if TYPE_CHECKING:
    from .options import Commands


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "simulate",
        run,
        "simulate the controlled robot of an experiment, and compare it with its recording",
        (
            "didim simulate log.toml --parameters fit.json",
            "didim simulate log.toml --parameters didim -o simulated.csv",
        ),
    )
    add_experiment(parser)
    parser.add_argument(
        "--parameters",
        metavar="FILE|NAME",
        required=True,
        help="result of an identification (.json) or its parameters (.toml, .npz), or a parameter set of the robot file",
    )
    parser.add_argument("--recording", metavar="NAME", help="recording to simulate (default: the first)")
    parser.add_argument("-o", "--output", metavar="FILE.csv", type=Path, help="write the run as CSV")


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..experiment.experiment_file import load_experiment
    from ..studies.run import simulate_experiment

    check_outputs(options.output)
    report = simulate_experiment(
        load_experiment(options.experiment, data=options.data), options.parameters, options.recording
    )
    for sentence in report.warnings:
        message(sentence, "warning")
    saved = Saved()
    saved.save(options.output, report.write)
    saved.show(str(report))
    return saved.code(CONVERGED if report.outcome.completed else NOT_CONVERGED)
