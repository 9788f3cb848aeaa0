"""``didim residual``. Tested in ``tests/test_residual.py``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .options import Commands, add_command, add_data, add_option
from .outputs import Saved, check_outputs


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "residual",
        run,
        "find external torques along a log: contacts, and changes of the payload",
        "didim residual fit.json log.toml",
        "didim residual fit.json log.toml -o torques.csv --plot torques.svg",
    )
    add_option(parser, "fit FIT.json", "result of an identification", Path)
    add_option(parser, "log LOG.toml", "experiment file of the log", Path)
    add_data(parser)
    add_option(parser, "--json FILE", "also write the detections as JSON", Path)
    add_option(parser, "-o --output FILE.csv", "also write the torques as CSV", Path)
    add_option(parser, "--plot FILE.svg", "also draw the torques (needs didim[plot])", Path)
    add_option(
        parser, "--bandwidth-hz HZ", "bandwidth of the observer (default: %(default)g)", float, default=8.0
    )
    add_option(
        parser,
        "--threshold SIGMA",
        "standard deviations from which the observer reports (default: %(default)g)",
        float,
        default=6.0,
    )


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from .._tools.files import write_atomically
    from ..experiment.experiment_file import load_experiment
    from ..result.identification import Identification
    from ..studies.loads.residual import residual_torques

    fit = Identification.load(options.fit)
    check_outputs(options.json, options.output, options.plot)
    if options.plot is not None:
        from ..plot.style import require

        require()
    experiment = load_experiment(options.log, data=options.data)
    residual = residual_torques(
        fit, experiment, bandwidth_hz=options.bandwidth_hz, threshold=options.threshold
    )
    saved = Saved()
    saved.save_json(options.json, residual.to_dict())
    saved.save(options.output, lambda path: write_atomically(path, residual.csv()))
    if options.plot is not None:
        from ..plot.external import external
        from ..plot.style import svg

        saved.save(options.plot, lambda path: write_atomically(path, svg(external(residual))))
    return saved.end(str(residual), verdict=residual.verdict)
