"""Messages on stderr: one line each, wrapped only where a terminal shows them. Tested in ``tests/test_terminal.py``."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

from ..._tools.words import printable
from .color import CYAN, RED, YELLOW, painted
from .width import columns, wrapped

KINDS = {"": RED, "warning": YELLOW, "open": YELLOW, "note": CYAN}
"""Colour of each kind of message; errors have no label."""


def message(text: str, kind: str = "") -> None:
    """Print a message on stderr, after the name of the program and its kind."""
    head = f"didim: {kind}: " if kind else "didim: "
    line = head + printable(" ".join(text.split()))
    # Programs get one line per message; on a terminal it is wrapped.
    width = columns(sys.stderr) if sys.stderr.isatty() else None
    lines = [line] if width is None else wrapped(line, width)
    lines[0] = painted(head.rstrip(), KINDS[kind], sys.stderr) + lines[0][len(head) - 1 :]
    print("\n".join(lines), file=sys.stderr, flush=True)


def progress_lines(seconds: float) -> Callable[[str, bool], None]:
    """Return a printer of progress for files and pipes, on stderr and from any thread.

    It prints at most one line in so many seconds, but always a line that is the last one.
    """
    lock, printed = threading.Lock(), time.monotonic()

    def line(text: str, is_last: bool) -> None:
        nonlocal printed
        with lock:
            now = time.monotonic()
            if is_last or now - printed >= seconds:
                printed = now
                print(text, file=sys.stderr, flush=True)

    return line
