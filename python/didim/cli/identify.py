"""``didim identify``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .options import (
    Commands,
    Options,
    add_command,
    add_experiment,
    add_flag,
    add_format,
    add_option,
    add_regression,
    add_report,
    check_report,
    exit_code,
    refuse,
    tell,
)
from .outputs import Saved, check_outputs


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "identify",
        run,
        "identify the parameters of a robot from an experiment",
        "didim identify log.toml",
        "didim identify log.toml --method didim --json fit.json --report fit.html",
        "didim identify log.toml --physical --save-parameters found.toml",
    )
    add_experiment(parser)
    method = parser.add_argument_group("method")
    add_option(
        method,
        "--method NAME",
        "one of `didim methods`, or module:Class (default: idim-ls, and cloe where the file says links = 'fixed')",
    )
    add_option(
        method,
        "--start NAME",
        "initial parameters of didim, idim-iv and cloe: consistent, prior, unit, idim-ls, a set of the robot file, or a "
        "file of parameters",
    )
    add_regression(method)
    physical = method.add_mutually_exclusive_group()
    physical.add_argument(
        "--physical",
        action="store_true",
        default=None,
        help="solve under the conditions of a robot: physically consistent parameters (default of didim)",
    )
    physical.add_argument(
        "--plain",
        action="store_false",
        dest="physical",
        help="solve without these conditions, as in the paper (default of the other methods)",
    )
    _add_cloe(parser.add_argument_group("method cloe"))
    files = parser.add_argument_group("files")
    add_option(files, "--json FILE", "also write the result as JSON", Path)
    add_option(
        files,
        "--save-parameters FILE.toml|FILE.npz",
        "also write the parameters: as a set for a robot file, or as arrays with their covariance",
        Path,
    )
    add_report(files)
    printed = parser.add_argument_group("printing")
    add_format(printed)
    add_flag(printed, "--strict", "exit code 1 for a doubtful verdict too, not only for a wrong one")
    loudness = printed.add_mutually_exclusive_group()
    add_flag(loudness, "--quiet", "print no table and no progress")
    add_flag(loudness, "--verbose", "print every iteration on stderr")


def _add_cloe(cloe: Options) -> None:
    """Add the settings of CLOE."""
    cloe.add_argument(
        "--optimizer",
        choices=("levenberg-marquardt", "nelder-mead"),
        help="optimizer of the search (default: levenberg-marquardt)",
    )
    cloe.add_argument(
        "--output",
        choices=("position", "torque", "both"),
        help="signals that are compared (default: position)",
    )
    cloe.add_argument(
        "--variant",
        choices=("adaptive", "scaled", "literal"),
        help="variant of the simplex (default: adaptive); literal: as fminsearch has it",
    )
    add_option(cloe, "--starts N", "search from N points, and report how many reached the best optimum", int)
    add_option(
        cloe,
        "--checkpoint FILE.npz",
        "save the search to a file while it runs, and resume it from there",
        Path,
    )


CHOICES = (
    "start", "uncertainty", "solver", "physical", "optimizer", "output", "variant", "starts",
    "checkpoint",
)  # fmt: skip
"""Options of `identify` that set a field of the method's settings."""


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..experiment.experiment_file import load_experiment
    from ..methods.identify import default_method, identify
    from ..methods.table import method_class

    make = None if options.method is None else method_class(options.method)
    check_report(options)
    check_outputs(options.json, options.save_parameters, options.report, options.checkpoint)
    if options.save_parameters is not None:
        from ..robot.parameter_file import check_path

        check_path(options.save_parameters)
    experiment = load_experiment(options.experiment, data=options.data)
    tell(experiment.notes)
    settings = {key: getattr(options, key) for key in CHOICES}
    settings = {key: value for key, value in settings.items() if value is not None}
    make = make or method_class(default_method(experiment))
    method = make()
    for key in settings:
        if not hasattr(method, key):
            key = "plain" if key == "physical" and not options.physical else key
            return refuse(f"--{key} is not for method '{options.method or default_method(experiment)}'")
    fit = identify(
        experiment, make(**settings), verbose=True if options.verbose else False if options.quiet else None
    )
    # Files are written first, so the result survives a reader of stdout that stops early.
    saved = Saved()
    saved.save(options.json, fit.save)
    saved.save(options.save_parameters, fit.save_parameters)
    saved.save_report(options.report, fit, experiment)
    if not options.quiet or saved.failed:
        saved.show_result(fit, options.format, verdict=fit.verdict)
    return saved.code(exit_code(fit, strict=options.strict))
