"""Outputs of commands, checked before the work and never lost after it. Tested in ``tests/test_outputs.py``."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._tools.files import check_output, write_atomically, write_elsewhere
from .._tools.inputs import same_file
from .._tools.words import printable
from ..errors import OutputError
from .options import CONVERGED, INTERRUPTED, NOT_CONVERGED, shown
from .terminal.messages import message

if TYPE_CHECKING:
    from ..experiment.experiment import Experiment
    from ..formats import Result
    from ..result.verdict import Verdict

RESULT = Path("didim-result.txt")
"""File that receives a result which could not be printed."""


def check_outputs(*paths: Path | None) -> None:
    """Refuse output paths that cannot be written to or that the command reads, and two outputs of one path.

    Raises
    ------
    OSError, OutputError
        The sentence names the path.
    """
    given = [path for path in paths if path is not None]
    for path in given:
        check_output(path)
    for index, path in enumerate(given):
        if any(same_file(path, other) for other in given[:index]) and (path.is_file() or not path.exists()):
            raise FileExistsError(f"two outputs have the same path '{path}'")


def refuse_existing(path: Path | None, *, force: bool) -> None:
    """Refuse to overwrite an output without `force`.

    Raises
    ------
    OutputError
        When the file exists.
    """
    if path is not None and path.exists() and not force:
        raise OutputError(f"{path}: the file is there already; --force overwrites it")


class Saved:
    """Outputs of one run: an output that cannot be written to its path is written elsewhere and reported on stderr.

    Attributes
    ----------
    failed : bool
        Whether an output is not at the requested path.
    lost : bool
        Whether an output could not be written anywhere.
    interrupted : bool
        Whether Ctrl-C was pressed while an output was made: the others and the table are still written.
    """

    def __init__(self) -> None:
        self.failed = self.lost = self.interrupted = False

    def save(self, path: Path | None, write: Callable[[Path], None]) -> None:
        """Write an output, if requested; after a failure, try the next location."""
        if path is None:
            return
        try:
            write(path)
        except KeyboardInterrupt:
            self.failed = self.interrupted = True
            message(f"{path}: interrupted, not written")
        except Exception as error:
            self._elsewhere(path, write, error)

    def write(self, path: Path, content: str | bytes) -> None:
        """Write the file that a command makes, and say so."""
        self.save(path, lambda target: write_atomically(target, content))
        if not self.failed:
            self.show(f"{path}: written", exact=True)

    def save_json(self, path: Path | None, content: object) -> None:
        """Write an output as JSON, if requested."""
        from .._tools.saved import save_json

        self.save(path, lambda target: save_json(target, content))

    def save_report(self, path: Path | None, result: Any, experiment: Experiment | None = None) -> None:
        """Write a result as an HTML page, if requested."""
        if path is not None:
            from ..report import write

            self.save(path, lambda target: write(target, result, experiment))

    def show(self, text: str, verdict: Verdict | None = None, *, exact: bool = False) -> None:
        """Print the result on stdout, in the width of a terminal unless `exact`; its verdict is in colour there."""
        try:
            # Characters outside the encoding of stdout are escaped.
            words = printable(text) if exact else shown(printable(text), verdict)
            try:
                print(words)
            except UnicodeEncodeError:
                encoding = sys.stdout.encoding
                print(words.encode(encoding, "backslashreplace").decode(encoding))
            sys.stdout.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            # The content of the buffer would fail again when the process ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            self._elsewhere(RESULT, lambda path: write_atomically(path, text + "\n"), error, "the output")

    def show_result(
        self, result: Result, form: str, text: str | None = None, verdict: Verdict | None = None
    ) -> None:
        """Print a result in one of the formats; `text` takes the place of its own."""
        if form == "text":
            self.show(str(result) if text is None else text, verdict)
        else:
            from ..formats import render

            self.show(render(result, form), exact=True)

    def end(
        self, text: str, code: int = CONVERGED, *, verdict: Verdict | None = None, exact: bool = False
    ) -> int:
        """Print the last text of a command as `show` does, and return its exit code: 1 in place of 0 for a wrong verdict."""
        self.show(text, verdict, exact=exact)
        wrong = verdict is not None and verdict.state.value == "wrong"
        return self.code(code or (NOT_CONVERGED if wrong else code))

    def code(self, code: int) -> int:
        """Return the exit code: 1 instead of 0 if an output is not at the requested path, 130 after Ctrl-C."""
        if self.interrupted:
            return INTERRUPTED
        return code or (NOT_CONVERGED if self.failed else code)

    def _elsewhere(
        self, path: Path, write: Callable[[Path], None], error: Exception, what: str | None = None
    ) -> None:
        self.failed = True
        elsewhere = write_elsewhere(path, write)
        self.lost = self.lost or elsewhere is None
        ending = (
            f"the content is in '{elsewhere}' instead"
            if elsewhere
            else "it could not be written elsewhere either"
        )
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        message(f"{what or path}: {reason}; {ending}")
