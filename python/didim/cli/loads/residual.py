"""``didim residual``. Tested in ``tests/test_residual.py``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..options import CONVERGED, add_command, add_data
from ..outputs import Saved, check_outputs

if TYPE_CHECKING:
    from ..options import Commands


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "residual",
        run,
        "find external torques along a log: contacts, and changes of the payload",
        (
            "didim residual fit.json log.toml",
            "didim residual fit.json log.toml -o torques.csv --plot torques.svg",
        ),
    )
    parser.add_argument("fit", metavar="FIT.json", type=Path, help="result of an identification")
    parser.add_argument("log", metavar="LOG.toml", type=Path, help="experiment file of the log")
    add_data(parser)
    parser.add_argument("--json", metavar="FILE", type=Path, help="also write the detections as JSON")
    parser.add_argument("-o", "--output", metavar="FILE.csv", type=Path, help="also write the torques as CSV")
    parser.add_argument(
        "--plot", metavar="FILE.svg", type=Path, help="also draw the torques (needs didim[plot])"
    )
    parser.add_argument(
        "--bandwidth-hz",
        metavar="HZ",
        type=float,
        default=8.0,
        help="bandwidth of the observer (default: %(default)g)",
    )
    parser.add_argument(
        "--threshold",
        metavar="SIGMA",
        type=float,
        default=6.0,
        help="standard deviations from which the observer reports (default: %(default)g)",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..._tools.files import write_atomically
    from ...experiment.experiment_file import load_experiment
    from ...result.identification import Identification
    from ...studies.loads.residual import residual_torques

    fit = Identification.load(options.fit)
    check_outputs(options.json, options.output, options.plot)
    if options.plot is not None:
        from ...plot.style import require

        require()
    experiment = load_experiment(options.log, data=options.data)
    residual = residual_torques(
        fit, experiment, bandwidth_hz=options.bandwidth_hz, threshold=options.threshold
    )
    saved = Saved()
    saved.save_json(options.json, residual.to_dict())
    saved.save(options.output, lambda path: write_atomically(path, residual.csv()))
    if options.plot is not None:
        from ...plot.external import external
        from ...plot.style import svg

        saved.save(options.plot, lambda path: write_atomically(path, svg(external(residual))))
    saved.show(str(residual))
    return saved.code(CONVERGED)
