"""``didim simulate``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .options import CONVERGED, NOT_CONVERGED, Commands, add_command, add_experiment, add_option
from .outputs import Saved, check_outputs
from .terminal.messages import message


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "simulate",
        run,
        "simulate the controlled robot of an experiment, and compare it with its recording",
        "didim simulate log.toml --parameters fit.json",
        "didim simulate log.toml --parameters didim -o simulated.csv",
    )
    add_experiment(parser)
    add_option(
        parser,
        "--parameters FILE|NAME",
        "result of an identification (.json) or its parameters (.toml, .npz), or a parameter set of the robot file",
        required=True,
    )
    add_option(parser, "--recording NAME", "recording to simulate (default: the first)")
    add_option(parser, "-o --output FILE.csv", "write the run as CSV", Path)


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
    return saved.end(str(report), CONVERGED if report.outcome.completed else NOT_CONVERGED)
