"""Options, messages and exit codes that the commands share. Tested in ``tests/test_cli.py``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from .._tools.words import printable

if TYPE_CHECKING:
    from ..formats import Result
    from ..result.identification import Identification
    from ..result.verdict import Verdict

    # The type of what add_subparsers() returns has no public name.
    Commands = argparse._SubParsersAction["Parser"]

CONVERGED, NOT_CONVERGED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit codes."""


class Parser(argparse.ArgumentParser):
    """Parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Leave with one line."""
        self.exit(WRONG_INPUT, f"didim: {message}; see `{self.prog} --help`\n")


LONGEST_MESSAGE = 1000
"""Characters: a wrong value may be a text or a list of any length."""


def refuse(message: str) -> int:
    """Print one line on stderr, and return the exit code of wrong input."""
    line = printable(" ".join(message.split()))
    if len(line) > LONGEST_MESSAGE:
        line = f"{line[: LONGEST_MESSAGE - 300]} [...] {line[-200:]}"
    print(f"didim: {line}", file=sys.stderr)
    return WRONG_INPUT


def tell(notes: Iterable[str]) -> None:
    """Print on stderr what reading a file changed, a line each."""
    for note in notes:
        print(f"didim: note: {printable(note)}", file=sys.stderr)


def add_command(
    commands: Commands, name: str, run: Callable[[argparse.Namespace], int], help_text: str
) -> argparse.ArgumentParser:
    """Add the parser of a command, and the function that runs it."""
    parser = commands.add_parser(name, help=help_text, description=help_text)
    parser.set_defaults(run=run)
    return parser


def add_experiment(parser: argparse.ArgumentParser) -> None:
    """Arguments of every command that reads an experiment."""
    parser.add_argument("experiment", metavar="EXPERIMENT.toml", type=Path, help="experiment file")
    add_data(parser)


def add_data(parser: argparse.ArgumentParser) -> None:
    """Add ``--data``, the folder of the data files."""
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=Path,
        help="folder of the data files (default: that of the experiment file)",
    )


def add_report(parser: argparse.ArgumentParser) -> None:
    """Add ``--report``."""
    parser.add_argument(
        "--report",
        metavar="FILE.html",
        type=Path,
        help="also write a page with tables and pictures (needs didim[plot])",
    )


def check_report(options: argparse.Namespace) -> None:
    """Refuse a report that cannot be written before the work, not after it."""
    if options.report is not None:
        from ..report import check

        check(options.report)


def add_regression(parser: argparse.ArgumentParser) -> None:
    """Add ``--uncertainty`` and ``--solver``, settings that several methods share."""
    parser.add_argument(
        "--uncertainty",
        choices=("jackknife", "decimated", "white"),
        help="where standard deviations come from (default: that of the experiment file, the jackknife)",
    )
    parser.add_argument(
        "--solver",
        metavar="NAME",
        help="how idim-ls and didim solve the linear system: least-squares, huber, bisquare, total, ridge or consistent "
        "(default: least-squares, of didim consistent)",
    )


def add_format(parser: argparse.ArgumentParser) -> None:
    """Add ``--format``."""
    parser.add_argument(
        "--format",
        choices=("text", "markdown", "latex", "csv"),
        default="text",
        help="of what is printed (default: %(default)s)",
    )


def formatted(result: Result, form: str) -> str:
    """Return the text of a result in one of the formats."""
    if form == "text":
        return str(result)
    from ..formats import render

    return render(result, form)


def add_strict(parser: argparse.ArgumentParser) -> None:
    """Add ``--strict``."""
    parser.add_argument(
        "--strict",
        action="store_true",
        help="exit code 1 for a doubtful verdict too, not only for a wrong one",
    )


def exit_code(fit: Identification, *, strict: bool = False) -> int:
    """Exit code of an identification, by its status and its verdict."""
    from ..result.status import Status
    from ..result.verdict import State

    if fit.status is Status.INTERRUPTED:
        return INTERRUPTED
    refused = (State.WRONG, State.DOUBTFUL) if strict else (State.WRONG,)
    return CONVERGED if fit.status.converged and fit.verdict.state not in refused else NOT_CONVERGED


COLORS = {"sound": "32", "doubtful": "33", "wrong": "31"}
"""Colours of a terminal by verdict: green, yellow and red."""


def colored(text: str, verdict: Verdict) -> str:
    """Return a text whose last line, the verdict, has its colour on a terminal; as it is elsewhere, or with NO_COLOR set."""
    if not sys.stdout.isatty() or os.environ.get("NO_COLOR"):
        return text
    body, line, last = text.rpartition("\n")
    return f"{body}{line}\033[1;{COLORS[verdict.state.value]}m{last}\033[0m"
