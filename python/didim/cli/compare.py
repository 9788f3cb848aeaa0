"""``didim compare``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .options import (
    INTERRUPTED,
    NOT_CONVERGED,
    Commands,
    add_command,
    add_data,
    add_flag,
    add_format,
    add_option,
    add_regression,
    add_report,
    check_report,
    exit_code,
    refuse,
)
from .outputs import Saved, check_outputs
from .terminal.width import columns

if TYPE_CHECKING:
    from ..experiment.experiment import Experiment


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "compare",
        run,
        "compare all methods with the truth on a simulated log: the paper's experiment",
        "didim compare",
        "didim compare --nelder-mead none --json out.json",
        "didim compare --experiment log.toml --contrast",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--robot", default="tx40", help="robot whose experiment comes with the package (default: %(default)s)"
    )
    add_option(
        what, "--experiment EXPERIMENT.toml", "experiment of your own instead, with a [reference]", Path
    )
    add_data(parser)
    log = parser.add_argument_group("simulated log")
    add_option(
        log,
        "--parameters NAME",
        "parameter set of the robot that is the truth (default: didim_physical, or didim, Table II of the paper)",
    )
    add_option(log, "--seed N", "seed of the noise", int)
    add_flag(log, "--no-noise", "simulate a log without noise")
    method = parser.add_argument_group("methods")
    add_option(
        method,
        "--method NAME",
        "compare this method, one of `didim methods` or module:Class, in place of all; may be given several times",
        action="append",
    )
    method.add_argument(
        "--nelder-mead",
        choices=("short", "full", "none"),
        default="short",
        help="the simplex of CLOE: a thousand iterations (short, the default), as many as the paper's recipe allows (full, "
        "minutes to hours), or not at all",
    )
    method.add_argument(
        "--variant",
        choices=("adaptive", "scaled", "literal"),
        action="append",
        help="variant of the simplex (default: adaptive); give it twice to compare two",
    )
    add_flag(
        method,
        "--contrast",
        "only IDIM-LS, IDIM-IV and DIDIM, on the log of the experiment if it has one: their differences show whether the "
        "filter or the controller is wrong",
    )
    add_regression(method)
    files = parser.add_argument_group("files and printing")
    add_option(files, "--json FILE", "also write everything as JSON", Path)
    add_report(files)
    add_format(files)
    add_flag(files, "--all", "print all parameters, each joint's torque error and all notes")
    add_flag(files, "--quiet", "print nothing on stderr")


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..experiment.experiment_file import load_experiment
    from ..studies.compare import SHORT_SIMPLEX, all_methods, compare
    from ..studies.comparison import COLUMNS as WIDEST
    from ..studies.comparison import text_of
    from ..studies.simulated_log import packaged_experiment

    check_report(options)
    check_outputs(options.json, options.report)
    experiment = (
        packaged_experiment(options.robot)
        if options.experiment is None
        else load_experiment(options.experiment, data=options.data)
    )
    if options.contrast:
        for key in ("uncertainty", "solver"):
            if getattr(options, key) is not None:
                return refuse(f"--{key} is not for --contrast, which compares least squares by the jackknife")
        return _contrast(options, experiment)
    iterations = {"short": SHORT_SIMPLEX, "full": None, "none": 0}[options.nelder_mead]
    comparison = compare(
        experiment,
        methods=options.method
        or all_methods(
            experiment,
            simplex_iterations=iterations,
            variants=options.variant or ["adaptive"],
            uncertainty=options.uncertainty,
            solver=options.solver or "least-squares",
        ),
        parameters=options.parameters,
        noise=not options.no_noise,
        seed=options.seed,
        verbose=not options.quiet,
    )
    saved = Saved()
    saved.save(options.json, comparison.save)
    saved.save_report(options.report, comparison)
    text = text_of(comparison, every=options.all, width=min(WIDEST, columns() or WIDEST))
    saved.show_result(comparison, options.format, text)
    if any(fit.status.name == "INTERRUPTED" for fit in comparison.fits.values()):
        return INTERRUPTED
    if options.method:
        return saved.code(max(map(exit_code, comparison.fits.values())))
    code = exit_code(comparison.fits["didim"]) if "didim" in comparison.fits else NOT_CONVERGED
    return saved.code(code)


def _contrast(options: argparse.Namespace, experiment: Experiment) -> int:
    """Contrast three methods on one log, and return the exit code."""
    from ..studies.compare import contrasts_of, truth_of
    from ..studies.simulated_log import simulated_log

    if not experiment.recordings:
        x = truth_of(experiment, options.parameters)
        experiment = simulated_log(experiment, x, noise=not options.no_noise, seed=options.seed)
    contrasts = contrasts_of(experiment, verbose=not options.quiet)
    saved = Saved()
    saved.save(options.json, contrasts.save)
    return saved.end(str(contrasts), exit_code(contrasts.fits["didim"]))
