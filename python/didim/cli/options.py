"""Options, messages and exit codes that the commands share. Tested in ``tests/test_cli.py``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._tools.words import number_of, printable
from ..errors import RobotError
from .terminal.color import VERDICTS, painted
from .terminal.guide import Formatter
from .terminal.guide import examples as examples_text
from .terminal.messages import message
from .terminal.width import fitted

if TYPE_CHECKING:
    from ..result.identification import Identification
    from ..result.verdict import Verdict
    from .terminal.guide import Parser

    # The type of what add_subparsers() returns has no public name.
    Commands = argparse._SubParsersAction[Parser]
    Options = argparse.ArgumentParser | argparse._ArgumentGroup
else:  # they are types only, and costly to load
    Commands = Options = Any

CONVERGED, NOT_CONVERGED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit codes."""


LONGEST_MESSAGE = 1000
"""Largest number of characters of an error message: a wrong value may be a text or a list of any length."""


def refuse(text: str) -> int:
    """Print one line on stderr, and return the exit code of wrong input."""
    line = printable(" ".join(text.split()))
    if len(line) > LONGEST_MESSAGE:
        line = f"{line[: LONGEST_MESSAGE - 300]} [...] {line[-200:]}"
    message(line)
    return WRONG_INPUT


def tell(notes: Iterable[str]) -> None:
    """Print the changes made while reading a file on stderr, one per line."""
    for note in notes:
        message(note, "note")


def add_command(
    commands: Commands, name: str, run: Callable[[argparse.Namespace], int], help_text: str, *examples: str
) -> argparse.ArgumentParser:
    """Add the parser of a command, and the function that runs it.

    Parameters
    ----------
    commands
        Commands of the main parser.
    name : str
        Name of the command.
    run : callable
        Function of the options that returns the exit code.
    help_text : str
        Sentence on the command, without a full stop.
    *examples : str
        Command lines that the help shows below the options.
    """
    parser = commands.add_parser(
        name,
        help=help_text,
        description=f"{help_text[:1].upper()}{help_text[1:]}.",
        epilog=examples_text(examples) if examples else None,
        formatter_class=Formatter,
    )
    parser.set_defaults(run=run)
    return parser


def add_flag(parser: Options, name: str, help_text: str) -> None:
    """Add an option without a value."""
    parser.add_argument(name, action="store_true", help=help_text)


def add_option(
    parser: Options, form: str, help_text: str, kind: Callable[[str], Any] = str, **settings: Any
) -> None:
    """Add an argument as the help shows it, such as ``-o --output FILE``: its names, then that of its value."""
    *names, metavar = form.split()
    parser.add_argument(*names, metavar=metavar, type=kind, help=help_text, **settings)


def add_experiment(parser: argparse.ArgumentParser) -> None:
    """Arguments of every command that reads an experiment."""
    add_option(parser, "experiment EXPERIMENT.toml", "experiment file", Path)
    add_data(parser)


def add_data(parser: argparse.ArgumentParser) -> None:
    """Add ``--data``, the folder of the data files."""
    add_option(parser, "--data DIR", "folder of the data files (default: that of the experiment file)", Path)


def add_robot(parser: Options) -> None:
    """Add the robot, the first argument of a command."""
    add_option(parser, "robot ROBOT", "name of a packaged robot, or path of a robot file or a URDF")


def add_chain(parser: Options, tip: str) -> None:
    """Add ``--tip``, `tip` of which is the default in words, ``--base`` and ``--lock``: the part of a URDF that is meant."""
    add_option(parser, "--tip LINK", f"last link of the chain (default: {tip})")
    add_option(parser, "--base LINK", "first link of the chain (default: the root)")
    add_option(
        parser,
        "--lock JOINT=VALUE",
        "keep a joint still at a position (rad or m); may be given several times",
        action="append",
        default=[],
    )
    add_flag(
        parser, "--open", "closed loops of an MJCF are cut on purpose: a fit takes the tree that is left"
    )


def locked(options: argparse.Namespace) -> dict[str, float]:
    """Return the positions of ``--lock`` (rad or m) by name of the joint.

    Raises
    ------
    RobotError
        For a text of another form (``test_urdf.py``).
    """
    angles: dict[str, float] = {}
    for text in options.lock:
        joint, _, value = text.rpartition("=")
        angle = number_of(value)
        if not joint or angle is None:
            raise RobotError(f"--lock takes JOINT=VALUE, such as --lock finger_joint=0.02, got {text!r}")
        angles[joint] = angle
    return angles


def add_report(parser: Options) -> None:
    """Add ``--report``."""
    add_option(
        parser, "--report FILE.html", "also write a page with tables and pictures (needs didim[plot])", Path
    )


def check_report(options: argparse.Namespace) -> None:
    """Refuse, before the work, a report that cannot be written."""
    if options.report is not None:
        from ..report import check

        check(options.report)


def add_regression(parser: Options) -> None:
    """Add ``--uncertainty`` and ``--solver``, settings that several methods share."""
    parser.add_argument(
        "--uncertainty",
        choices=("jackknife", "decimated", "white"),
        help="source of the standard deviations (default: that of the experiment file, else the jackknife)",
    )
    add_option(
        parser,
        "--solver NAME",
        "solver of the linear system in idim-ls and didim: least-squares, huber, bisquare, consistent or "
        "module:object (default: least-squares; consistent for didim)",
    )


def add_format(parser: Options) -> None:
    """Add ``--format``."""
    parser.add_argument(
        "--format",
        choices=("text", "markdown", "latex", "csv"),
        default="text",
        help="format of the printed table (default: %(default)s)",
    )


def exit_code(fit: Identification, *, strict: bool = False) -> int:
    """Exit code of an identification, by its status and its verdict."""
    from ..result.iteration import Status
    from ..result.verdict import State

    if fit.status is Status.INTERRUPTED:
        return INTERRUPTED
    refused = (State.WRONG, State.DOUBTFUL) if strict else (State.WRONG,)
    return CONVERGED if fit.status.converged and fit.verdict.state not in refused else NOT_CONVERGED


def shown(text: str, verdict: Verdict | None = None) -> str:
    """Return a text in the width of the terminal, with the verdict at its end in colour."""
    body, line, last = text.rpartition("\nVerdict: ")
    if verdict is None or not line:
        return fitted(text)
    return f"{fitted(body)}\n{painted(fitted(line[1:] + last), VERDICTS[verdict.state.value])}"
