"""The command ``didim``: results on stdout, progress on stderr.

Exit codes: 0 converged (or no findings), 1 not converged (or findings, or an output that had to be written elsewhere), 2 wrong
input (one line), 130 interrupted. A command is a module with ``add``, which adds its parser, and ``run``, which returns the
exit code.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from functools import partial
from importlib import import_module

from .._tools.inputs import Run, one_run
from .._tools.threads import core_threads
from .._tools.version import __version__
from ..errors import DidimError, RobotWarning
from .options import CONVERGED, INTERRUPTED, refuse
from .terminal.guide import MainParser, Parser, examples
from .terminal.messages import message as tell_user


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments without the name of the program; ``sys.argv`` by default.

    Returns
    -------
    int
        Exit code.

    Notes
    -----
    ``test_cli.py`` runs every command, its errors and its interruption.
    """
    options = _parser().parse_args(arguments)
    with one_run() as files:
        return _run(options, files)


def _run(options: argparse.Namespace, files: Run) -> int:
    """Run a command; any error of its input ends in one sentence."""
    try:
        core_threads()  # a wrong DIDIM_THREADS is refused before the work
        with warnings.catch_warnings():
            warnings.simplefilter("always", RobotWarning)
            late: list[str] = []
            warnings.showwarning = partial(_show_warning, late)
            code: int = options.run(options)
        for text in late:
            tell_user(text, "warning")
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the result (head, less) has closed the pipe, so nothing may be written at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return CONVERGED
    except KeyboardInterrupt:
        tell_user("interrupted")
        return INTERRUPTED
    except DidimError as error:
        return refuse(str(error))
    except (MemoryError, RecursionError, ValueError) as error:
        kind = next((base.__name__ for base in type(error).__mro__ if base.__name__ in BEYOND), None)
        if kind is None:
            raise
        last = f"{next(reversed(files.read))}: " if files.read else ""
        return refuse(f"{last}{BEYOND[kind]}{f' ({error})' if str(error) else ''}")
    except OSError as error:
        if error.strerror is None:
            return refuse(str(error))
        return refuse(
            f"{error.filename}: {error.strerror}" if error.filename else f"cannot write: {error.strerror}"
        )
    return code


BEYOND = {
    "MemoryError": "there is not enough memory for this",
    "RecursionError": "this is nested too deeply",
    "UnicodeError": "a text is not UTF-8",
    "LinAlgError": "its numbers have no solution",
}
"""Sentences for exceptions that no reader raises on purpose, by class name (NumPy is loaded late). The message names the file
that was read last, because its numbers are the likely cause."""


def _show_warning(
    late: list[str], message: Warning | str, category: type[Warning], *_: object, **__: object
) -> None:
    """Print a warning without file and line of the code.

    NumPy's on rounding and overflow waits in `late` for the end: before a refusal, which names the number, it says nothing.
    """
    if issubclass(category, RuntimeWarning):
        late.append(str(message))
    else:
        tell_user(str(message), "warning")


def _parser() -> argparse.ArgumentParser:
    parser = MainParser(
        prog="didim",
        description="Identify masses, inertias and friction of a robot arm from a log of its motion and torques.",
        epilog=examples(EXAMPLES),
    )
    parser.add_argument("--version", action="version", version=f"didim {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)
    for name in COMMANDS:
        import_module(f".{name}", __package__).add(commands)
    return parser


COMMANDS = (
    "robot", "excite", "init", "check", "compare", "identify", "validate", "payload", "residual", "simulate",
    "study", "export", "base", "view", "lists", "terminal.completion",
)  # fmt: skip
"""Modules of the commands, in the order in which they are added."""

EXAMPLES = (
    "didim compare                             the paper's experiment, simulated",
    "didim init ur5e log.csv                   a first experiment file, log.toml",
    "didim identify log.toml --json fit.json   parameters, sigma, verdict",
    "didim export fit.json --urdf arm.urdf -o new.urdf",
)
"""Examples of the help."""
