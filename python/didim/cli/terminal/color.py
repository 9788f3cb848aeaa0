"""Colours of a terminal. Tested in ``tests/test_terminal.py``.

Colours are off for a stream that is not a terminal, with ``NO_COLOR`` set, and with ``TERM=dumb``.
"""

from __future__ import annotations

import os
import re
import sys
from typing import TextIO

BOLD, RED, GREEN, YELLOW, CYAN = "1", "1;31", "1;32", "1;33", "36"
"""Codes of Select Graphic Rendition."""

VERDICTS = {"sound": GREEN, "doubtful": YELLOW, "wrong": RED}
"""Colour of each verdict."""

_TITLE = re.compile(r"^(usage|[A-Za-z][A-Za-z ,]*)(?=:)", re.MULTILINE)


def is_colored(stream: TextIO) -> bool:
    """Whether a stream shows colours."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return False
    try:
        return stream.isatty()
    except ValueError:  # closed
        return False


def painted(text: str, code: str, stream: TextIO | None = None) -> str:
    """Return a text in a colour, line by line; unchanged for a stream without colours."""
    if not text or not is_colored(sys.stdout if stream is None else stream):
        return text
    return "\n".join(f"\033[{code}m{line}\033[0m" if line else line for line in text.split("\n"))


def titled(text: str) -> str:
    """Return a help text with bold titles of sections."""
    if not is_colored(sys.stdout):
        return text
    return _TITLE.sub(lambda match: f"\033[{BOLD}m{match.group()}\033[0m", text)
