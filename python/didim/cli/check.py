"""``didim check``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .options import CONVERGED, NOT_CONVERGED, Commands, add_command, add_experiment, add_option
from .outputs import Saved, check_outputs


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "check",
        run,
        "look for errors of a log before it is fitted; exit code 1 when something is found",
        "didim check log.toml",
        "didim check log.toml --parameters fit.json --json findings.json",
    )
    add_experiment(parser)
    add_option(
        parser,
        "--parameters FILE|NAME",
        "known parameters, to check the scale of each joint: result of an identification (.json) or its parameters "
        "(.toml, .npz), or a parameter set of the robot file",
    )
    add_option(parser, "--json FILE", "also write the findings as JSON", Path)


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..diagnosis.check import check

    check_outputs(options.json)
    findings = check(options.experiment, options.parameters, data=options.data)
    saved = Saved()
    saved.save(options.json, findings.save)
    return saved.end(str(findings), NOT_CONVERGED if findings else CONVERGED)
