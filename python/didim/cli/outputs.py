"""Outputs of commands: checked before the work, and never lost after it. Tested in ``tests/test_outputs.py``."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from .._tools.files import check_output, write_atomically, write_elsewhere
from .._tools.words import printable
from .options import NOT_CONVERGED, shown
from .terminal.messages import message

if TYPE_CHECKING:
    from ..result.verdict import Verdict

RESULT = Path("didim-result.txt")
"""Name of the file that takes a result which could not be printed."""


def check_outputs(*paths: Path | None) -> None:
    """Refuse output paths that cannot be written to, and two outputs of one path.

    Raises
    ------
    OSError
        Its sentence names the path.
    """
    given = [path for path in paths if path is not None]
    for path in given:
        check_output(path)
    for index, path in enumerate(given):
        if path.resolve() in [other.resolve() for other in given[:index]] and (
            path.is_file() or not path.exists()
        ):
            raise FileExistsError(f"two outputs have the same path '{path}'")


class Saved:
    """Outputs of one run: what could not be written where it was asked for is written elsewhere, and said on stderr.

    Attributes
    ----------
    failed : bool
        Whether an output is not where it was asked for.
    lost : bool
        Whether an output could not be written anywhere.
    """

    def __init__(self) -> None:
        self.failed = self.lost = False

    def save(self, path: Path | None, write: Callable[[Path], None]) -> None:
        """Write an output, if it was asked for."""
        if path is None:
            return
        try:
            write(path)
        except OSError as error:
            self._elsewhere(path, write, error)

    def save_json(self, path: Path | None, content: object) -> None:
        """Write an output as JSON, if it was asked for."""
        if path is not None:
            text = json.dumps(content, indent=1, allow_nan=False) + "\n"
            self.save(path, lambda place: write_atomically(place, text))

    def show(self, text: str, verdict: Verdict | None = None, *, exact: bool = False) -> None:
        """Print the result on stdout, in the width of a terminal unless `exact`; its verdict is in colour there."""
        try:
            print(printable(text) if exact else shown(printable(text), verdict))
            sys.stdout.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            # What is left in the buffer would fail again when the process ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            self._elsewhere(RESULT, lambda path: write_atomically(path, text + "\n"), error, "the output")

    def code(self, code: int) -> int:
        """Return the exit code: 1 instead of 0 when an output is not where it was asked for."""
        return code or (NOT_CONVERGED if self.failed else code)

    def _elsewhere(
        self, path: Path, write: Callable[[Path], None], error: OSError, what: str | None = None
    ) -> None:
        self.failed = True
        place = write_elsewhere(path, write)
        self.lost = self.lost or place is None
        ending = (
            f"the content is in '{place}' instead" if place else "it could not be written elsewhere either"
        )
        reason = error.strerror or str(error)
        message(f"{what or path}: {reason}; {ending}")
