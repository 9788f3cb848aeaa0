"""The command ``didim``: results on stdout, progress on stderr.

Exit codes: 0 converged (or nothing found), 1 not converged (or something found), 2 wrong input (one line), 130 interrupted.
A command is a function that adds its parser, and a function that runs it and returns the exit code.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from .errors import DidimError
from .version import __version__

if TYPE_CHECKING:
    from .formats import Result
    from .status import Status

    # The type of what add_subparsers() returns has no public name.
    Commands = argparse._SubParsersAction["_Parser"]

CONVERGED, NOT_CONVERGED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(WRONG_INPUT, f"didim: {message}; see `{self.prog} --help`\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Without the name of the program; ``sys.argv`` by default.

    Returns
    -------
    int
        Exit code.

    Notes
    -----
    ``test_cli.py`` runs every command, its errors and its interruption.
    """
    options = _parser().parse_args(arguments)
    try:
        code: int = options.run(options)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the result (head, less) has seen enough; nothing may be written at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return CONVERGED
    except KeyboardInterrupt:
        print("didim: interrupted", file=sys.stderr)
        return INTERRUPTED
    except DidimError as error:
        return _refuse(str(error))
    except OSError as error:
        return _refuse(f"{error.filename}: {error.strerror}" if error.strerror else str(error))
    return code


LONGEST_MESSAGE = 1000
"""Characters: a wrong value may be a text or a list of any length."""


def _refuse(message: str) -> int:
    line = " ".join(message.split())
    if len(line) > LONGEST_MESSAGE:
        line = f"{line[: LONGEST_MESSAGE - 300]} [...] {line[-200:]}"
    print(f"didim: {line}", file=sys.stderr)
    return WRONG_INPUT


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="didim", description="Identify the dynamic parameters of robots.")
    parser.add_argument("--version", action="version", version=f"didim {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for add in COMMANDS:
        add(commands)
    return parser


def _command(
    commands: Commands, name: str, run: Callable[[argparse.Namespace], int], help_text: str
) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=help_text, description=help_text)
    parser.set_defaults(run=run)
    return parser


def _add_experiment(parser: argparse.ArgumentParser) -> None:
    """Arguments of every command that reads an experiment."""
    parser.add_argument("experiment", metavar="EXPERIMENT.toml", type=Path, help="experiment file")
    _add_data(parser)


def _add_data(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=Path,
        help="folder of the data files (default: that of the experiment file)",
    )


def _add_report(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--report",
        metavar="FILE.html",
        type=Path,
        help="also write a page with tables and pictures (needs didim[plot])",
    )


def _check_report(options: argparse.Namespace) -> None:
    """Refuse a report that cannot be written before the work, not after it."""
    if options.report is not None:
        from .report import check

        check(options.report)


def _add_format(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--format",
        choices=("text", "markdown", "latex", "csv"),
        default="text",
        help="of what is printed (default: %(default)s)",
    )


def _formatted(result: Result, form: str) -> str:
    if form == "text":
        return str(result)
    from .formats import render

    return render(result, form)


def _add_identify(commands: Commands) -> None:
    parser = _command(
        commands, "identify", _identify, "identify the parameters of a robot from an experiment"
    )
    _add_experiment(parser)
    parser.add_argument("--method", default="idim-ls", help="method of identification (default: %(default)s)")
    parser.add_argument(
        "--start",
        metavar="NAME",
        help="initial parameters of didim and cloe: unit, idim-ls, a set of the robot file, or a file of parameters",
    )
    parser.add_argument(
        "--optimizer",
        choices=("levenberg-marquardt", "nelder-mead"),
        help="of cloe (default: levenberg-marquardt)",
    )
    parser.add_argument(
        "--output", choices=("position", "torque", "both"), help="what cloe compares (default: position)"
    )
    parser.add_argument(
        "--variant",
        choices=("adaptive", "scaled", "literal"),
        help="of cloe's simplex (default: adaptive); literal: as fminsearch has it",
    )
    parser.add_argument(
        "--starts",
        type=int,
        metavar="N",
        help="of cloe: search from N points, and tell how many reached the best optimum",
    )
    parser.add_argument(
        "--checkpoint",
        metavar="FILE.npz",
        type=Path,
        help="of cloe: save the search to a file as it goes on, and continue it from there",
    )
    parser.add_argument("--json", metavar="FILE", type=Path, help="also write the result as JSON")
    parser.add_argument(
        "--save-parameters",
        metavar="FILE.toml|FILE.npz",
        type=Path,
        help="also write the parameters: as a set for a robot file, or as arrays with their covariance",
    )
    _add_format(parser)
    _add_report(parser)
    loudness = parser.add_mutually_exclusive_group()
    loudness.add_argument("--quiet", action="store_true", help="print no table")
    loudness.add_argument("--verbose", action="store_true", help="tell on stderr what goes on")


CHOICES = ("start", "optimizer", "output", "variant", "starts", "checkpoint")
"""Options of `identify` that are settings of a method."""


def _identify(options: argparse.Namespace) -> int:
    from .experiment import load_experiment
    from .identify import identify
    from .methods import METHODS

    if options.method not in METHODS:
        return _refuse(f"there is no method '{options.method}'; available: {', '.join(METHODS)}")
    _check_report(options)
    if options.save_parameters is not None:
        from .parameter_files import check_path

        check_path(options.save_parameters)
    experiment = load_experiment(options.experiment, data=options.data)
    settings = {key: getattr(options, key) for key in CHOICES}
    settings = {key: value for key, value in settings.items() if value is not None}
    method = METHODS[options.method]()
    for key in settings:
        if not hasattr(method, key):
            return _refuse(f"--{key} is not for method '{options.method}'")
    fit = identify(experiment, METHODS[options.method](**settings), verbose=options.verbose)
    # The file first: a reader of stdout that stops early must not cost the result.
    if options.json is not None:
        fit.save(options.json)
    if options.save_parameters is not None:
        from .parameter_files import save_parameters

        save_parameters(fit, options.save_parameters)
    if options.report is not None:
        from .report import write

        write(options.report, fit, experiment)
    if not options.quiet:
        print(_formatted(fit, options.format))
    return _code(fit.status)


def _code(status: Status) -> int:
    """Exit code of an identification."""
    from .status import Status

    if status is Status.INTERRUPTED:
        return INTERRUPTED
    return CONVERGED if status.converged else NOT_CONVERGED


def _add_compare(commands: Commands) -> None:
    parser = _command(
        commands,
        "compare",
        _compare,
        "the paper's experiment: all methods on a simulated log, beside the truth",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--robot", default="tx40", help="robot whose experiment comes with the package (default: %(default)s)"
    )
    what.add_argument(
        "--experiment",
        metavar="EXPERIMENT.toml",
        type=Path,
        help="experiment of your own instead, with a [reference]",
    )
    _add_data(parser)
    parser.add_argument(
        "--parameters",
        metavar="NAME",
        default="didim",
        help="parameter set of the robot: the truth (default: %(default)s)",
    )
    parser.add_argument("--seed", type=int, help="seed of the noise")
    parser.add_argument(
        "--nelder-mead",
        choices=("short", "full", "none"),
        default="short",
        help="the simplex of CLOE: a thousand iterations, as many as the paper's recipe allows (minutes to hours), or not at all",
    )
    parser.add_argument(
        "--variant",
        choices=("adaptive", "scaled", "literal"),
        action="append",
        help="of the simplex (default: adaptive); give it twice to see two beside each other",
    )
    parser.add_argument("--no-noise", action="store_true", help="a log without noise")
    parser.add_argument("--json", metavar="FILE", type=Path, help="also write everything as JSON")
    _add_format(parser)
    _add_report(parser)
    parser.add_argument("--quiet", action="store_true", help="tell nothing on stderr")


def _compare(options: argparse.Namespace) -> int:
    from .compare import SHORT_SIMPLEX, all_methods, compare, packaged_experiment
    from .experiment import load_experiment

    _check_report(options)
    experiment = (
        packaged_experiment(options.robot)
        if options.experiment is None
        else load_experiment(options.experiment, data=options.data)
    )
    iterations = {"short": SHORT_SIMPLEX, "full": None, "none": 0}[options.nelder_mead]
    comparison = compare(
        experiment,
        methods=all_methods(
            experiment, simplex_iterations=iterations, variants=options.variant or ["adaptive"]
        ),
        parameters=options.parameters,
        noise=not options.no_noise,
        seed=options.seed,
        verbose=not options.quiet,
    )
    if options.json is not None:
        comparison.save(options.json)
    if options.report is not None:
        from .report import write

        write(options.report, comparison)
    print(_formatted(comparison, options.format))
    if any(fit.status.name == "INTERRUPTED" for fit in comparison.fits.values()):
        return INTERRUPTED
    return _code(comparison.fits["didim"].status) if "didim" in comparison.fits else NOT_CONVERGED


def _add_validate(commands: Commands) -> None:
    parser = _command(
        commands, "validate", _validate, "errors of a result on another log, predicted and simulated"
    )
    parser.add_argument("fit", metavar="FIT.json", type=Path, help="result of an identification")
    _add_experiment(parser)
    parser.add_argument("--json", metavar="FILE", type=Path, help="also write the errors as JSON")
    _add_report(parser)


def _validate(options: argparse.Namespace) -> int:
    import json

    from .experiment import load_experiment
    from .files import write_atomically
    from .identification import Identification
    from .validate import validate

    fit = Identification.load(options.fit)
    _check_report(options)
    experiment = load_experiment(options.experiment, data=options.data)
    found = validate(fit, experiment)
    if options.json is not None:
        write_atomically(options.json, json.dumps(found.to_dict(), indent=1, allow_nan=False) + "\n")
    if options.report is not None:
        from .report import write

        write(options.report, found, experiment)
    print(found)
    return CONVERGED if found.completed else NOT_CONVERGED


def _add_base(commands: Commands) -> None:
    parser = _command(commands, "base", _base, "list the base parameters of a robot and their groupings")
    parser.add_argument("robot", metavar="ROBOT", help="name of a packaged robot, or path of a robot file")
    _add_format(parser)


def _base(options: argparse.Namespace) -> int:
    from .robot import load_robot

    robot = load_robot(options.robot)
    base = robot.base_parameters
    print(f"{robot.name}: {base}" if options.format == "text" else _formatted(base, options.format))
    return CONVERGED


def _add_simulate(commands: Commands) -> None:
    parser = _command(
        commands,
        "simulate",
        _simulate,
        "simulate the controlled robot of an experiment, beside its recording",
    )
    _add_experiment(parser)
    parser.add_argument(
        "--parameters",
        metavar="FILE|NAME",
        required=True,
        help="result of an identification (.json) or its parameters (.toml, .npz), or a parameter set of the robot file",
    )
    parser.add_argument("--recording", metavar="NAME", help="recording to simulate (default: the first)")
    parser.add_argument("-o", "--output", metavar="FILE.csv", type=Path, help="write the run as CSV")


def _simulate(options: argparse.Namespace) -> int:
    from .experiment import load_experiment
    from .simulate_command import simulate_experiment

    report = simulate_experiment(
        load_experiment(options.experiment, data=options.data), options.parameters, options.recording
    )
    for sentence in report.warnings:
        print(f"didim: warning: {sentence}", file=sys.stderr)
    if options.output is not None:
        report.write(options.output)
    print(report)
    return CONVERGED if report.outcome.completed else NOT_CONVERGED


def _add_init(commands: Commands) -> None:
    parser = _command(commands, "init", _init, "write a first experiment file for a log, to be confirmed")
    parser.add_argument("robot", metavar="ROBOT", help="name of a packaged robot, or path of a robot file")
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


def _init(options: argparse.Namespace) -> int:
    from .init_command import initialise

    path, draft = initialise(
        options.robot, options.log, options.output, rate_hz=options.rate, force=options.force
    )
    print(f"{path}: written")
    for sentence in draft.read:
        print(f"- {sentence}")
    for question in draft.questions:
        print(f"didim: open: {question}", file=sys.stderr)
    return NOT_CONVERGED if draft.questions else CONVERGED


def _add_check(commands: Commands) -> None:
    parser = _command(
        commands, "check", _check, "look at a log before it is fitted: exit code 1 when something is found"
    )
    _add_experiment(parser)
    parser.add_argument(
        "--parameters",
        metavar="FILE|NAME",
        help="known parameters, which tell the scale of each joint: result of an identification (.json) or its parameters "
        "(.toml, .npz), or a parameter set of the robot file",
    )
    parser.add_argument("--json", metavar="FILE", type=Path, help="also write the findings as JSON")


def _check(options: argparse.Namespace) -> int:
    from .checking import check

    found = check(options.experiment, options.parameters, data=options.data)
    if options.json is not None:
        found.save(options.json)
    print(found)
    return NOT_CONVERGED if found else CONVERGED


COMMANDS: tuple[Callable[[Commands], None], ...] = (
    _add_init,
    _add_check,
    _add_compare,
    _add_identify,
    _add_validate,
    _add_simulate,
    _add_base,
)
