"""A progress line that updates itself, on terminals and in notebooks only. Tested in ``tests/test_progress.py``."""

from __future__ import annotations

import sys
import time
from importlib import import_module
from typing import Any

from .words import brief

DELAY_S = 1.0
"""Work (s) before the progress line appears: shorter work needs none."""
EVERY_S = 0.1
"""Time (s) between updates of the progress line."""
WIDEST = 78
"""Largest number of characters of the progress line: a wrapped line cannot be overwritten."""


class ProgressLine:
    """A line with the progress of a long calculation.

    On a terminal it is the current line of stderr, in a notebook an updated output; `close` removes it. Nothing is written to
    files and pipes, and nothing at all unless it is `wanted`.
    """

    def __init__(self, wanted: bool = True) -> None:
        self._begin = time.monotonic()
        self._last = 0.0
        self._shown = False
        self._display: Any = None
        self._terminal = wanted and _is_terminal()
        self._notebook = wanted and not self._terminal and in_notebook()

    def show(self, text: str) -> None:
        """Update the line, if the work has taken longer than `DELAY_S`."""
        now = time.monotonic()
        if (
            not (self._terminal or self._notebook)
            or now - self._begin < DELAY_S
            or now - self._last < EVERY_S
        ):
            return
        self._last, self._shown = now, True
        line = brief(" ".join(text.split()), WIDEST)
        if self._terminal:
            print(f"\r\033[K{line}", end="", file=sys.stderr, flush=True)
        else:
            self._update(line)

    def close(self) -> None:
        """Remove the line."""
        if self._shown and self._terminal:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
        elif self._shown:
            self._update("")
        self._shown = False

    def _update(self, line: str) -> None:
        shown = import_module("IPython.display")  # optional, and without types
        if self._display is None:
            self._display = shown.display(shown.Pretty(line), display_id=True)
        else:
            self._display.update(shown.Pretty(line))


def shows_progress() -> bool:
    """Whether a progress line is visible: stderr is a terminal, or the program runs in a notebook."""
    return _is_terminal() or in_notebook()


def in_notebook() -> bool:
    """Whether the program runs in a notebook, without importing a module."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return type(shell).__name__ == "ZMQInteractiveShell"


def _is_terminal() -> bool:
    try:
        return sys.stderr.isatty()
    except (AttributeError, ValueError):  # no stderr, or a closed one
        return False
