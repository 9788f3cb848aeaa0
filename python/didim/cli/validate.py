"""``didim validate``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .options import (
    CONVERGED,
    NOT_CONVERGED,
    add_command,
    add_experiment,
    add_report,
    check_report,
)
from .outputs import Saved, check_outputs

if TYPE_CHECKING:
    from .options import Commands


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "validate",
        run,
        "compare a result with another log: predicted and simulated torques",
        ("didim validate fit.json other.toml --report other.html",),
    )
    parser.add_argument("fit", metavar="FIT.json", type=Path, help="result of an identification")
    add_experiment(parser)
    parser.add_argument("--json", metavar="FILE", type=Path, help="also write the errors as JSON")
    add_report(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..experiment.experiment_file import load_experiment
    from ..result.identification import Identification
    from ..studies.validation import validate

    fit = Identification.load(options.fit)
    check_report(options)
    check_outputs(options.json, options.report)
    experiment = load_experiment(options.experiment, data=options.data)
    found = validate(fit, experiment)
    saved = Saved()
    saved.save_json(options.json, found.to_dict())
    if options.report is not None:
        from ..report import write

        saved.save(options.report, lambda path: write(path, found, experiment))
    saved.show(str(found))
    return saved.code(CONVERGED if found.completed else NOT_CONVERGED)
