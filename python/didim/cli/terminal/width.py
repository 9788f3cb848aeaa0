"""Fit printed text into the columns of a terminal. Tested in ``tests/test_terminal.py``.

Sentences wrap between words. A table that is too wide first loses the columns for experts, then the second blank between
columns. Then the text of its last column wraps inside the column. Finally the table is continued below, with names and units
repeated.
"""

from __future__ import annotations

import os
import re
import sys
import textwrap
from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from typing import TextIO

NARROWEST, WIDEST = 60, 160
"""Columns: narrower terminals break lines themselves, and longer lines are hard to read."""

OPTIONAL = ("/ white",)
"""Headings of columns that a narrow terminal omits."""

NARROWEST_TEXT = 24
"""Smallest width (columns) to which the text of a last column is wrapped."""

_NUMBER_AND_UNIT = re.compile(
    r"(?<=\d) (?=%|N\.m|N\b|Hz|m?s\b|m?m\b|rad|deg|kg|A\b)|(?<=N\.m) (?=or N\b)|(?<=or) (?=N\b)"
)
_NO_BREAK = "\N{NO-BREAK SPACE}"

_ROW = re.compile(r"\S {2,}\S|^-{8,}$")
_RULE = re.compile(r"^-{8,}$")


def columns(stream: TextIO | None = None) -> int | None:
    """Return the largest width of a line, or None for any length.

    The variable ``COLUMNS`` decides, then the terminal; a file or a pipe has no width.
    """
    given = os.environ.get("COLUMNS", "")
    stream = sys.stdout if stream is None else stream
    if given.isdecimal() and int(given) > 0:
        return min(max(int(given), NARROWEST), WIDEST)
    try:
        if not stream.isatty():
            return None
        width = os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError):
        return None
    return min(max(width, NARROWEST), WIDEST) if width > 0 else None


def fitted(text: str, width: int | None = None) -> str:
    """Return a text whose lines take at most `width` columns.

    Parameters
    ----------
    text : str
        Sentences, and tables whose columns are two blanks or more apart.
    width : int, optional
        Columns; by default those of the terminal on stdout, unlimited without one.
    """
    width = columns() if width is None else width
    if width is None or all(len(line) <= width for line in text.split("\n")):
        return text
    lines: list[str] = []
    for is_row, group in groupby(text.split("\n"), lambda line: bool(_ROW.search(line))):
        run = list(group)
        if is_row and len(run) > 1:
            lines += _table(run, width)
        else:
            lines += [part for line in run for part in wrapped(line, width)]
    return "\n".join(lines)


def wrapped(line: str, width: int) -> list[str]:
    """Return the lines of one sentence; in a list, all but the first are indented."""
    if len(line) <= width:
        return [line]
    body = line.lstrip(" ")
    indent = " " * (len(line) - len(body))
    further = indent + ("  " if indent or body.startswith(("- ", "* ")) else "")
    return _wrap(body, width, indent, further)


def _wrap(text: str, width: int, indent: str = "", further: str = "") -> list[str]:
    """Wrap between words; a number and its unit stay together."""
    lines = textwrap.wrap(
        _NUMBER_AND_UNIT.sub(_NO_BREAK, text),
        width,
        initial_indent=indent,
        subsequent_indent=further,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace(_NO_BREAK, " ") for line in lines]


def _table(rows: list[str], width: int) -> list[str]:
    """Return the rows of a table in lines of at most `width` columns."""
    if max(map(len, rows)) <= width:
        return rows
    spans = list(_spans(rows))
    rules = [bool(_RULE.match(row)) for row in rows]
    cells = [
        [("" if is_rule else row)[start:end].rstrip() for start, end in spans]
        for row, is_rule in zip(rows, rules, strict=True)
    ]
    left_out = [k for k in range(len(spans)) if cells[0][k].strip() in OPTIONAL]
    if left_out:
        spans = [span for k, span in enumerate(spans) if k not in left_out]
        cells = [[cell for k, cell in enumerate(row) if k not in left_out] for row in cells]
    sizes = [max(len(row[k]) for row in cells) for k in range(len(spans))]
    # The last column may be text of any length, such as a remark or the grouping of a parameter.
    for gap in (2, 1):
        taken = sum(sizes[:-1]) + gap * (len(sizes) - 1)
        last = _is_text(rows, spans[-1])
        if taken + sizes[-1] <= width or (last and width - taken >= NARROWEST_TEXT):
            return _joined(cells, sizes, gap, width if last else None, rules)
    labels = 1 + (len(spans) > 2 and _is_text(rows, spans[1]) and sizes[1] < width // 4)
    lines: list[str] = []
    for chunk in _chunks(sizes, labels, width):
        part = [[row[k] for k in chunk] for row in cells]
        lines += ["", *_joined(part, [sizes[k] for k in chunk], 2, width, rules)]
    return lines[1:]


def _spans(rows: Sequence[str]) -> Iterator[tuple[int, int]]:
    """Yield start and end of each column; columns are separated by two blanks or more in all rows."""
    length = max(map(len, rows))
    texts = [row.ljust(length) for row in rows if not _RULE.match(row)]
    blank = [all(text[k] == " " for text in texts) for k in range(length)]
    first = blank.index(False)
    starts = [k for k in range(first + 2, length) if blank[k - 2] and blank[k - 1] and not blank[k]]
    yield from pairwise([0, *starts, length])


def _is_text(rows: Sequence[str], span: tuple[int, int]) -> bool:
    """Whether a column is left-aligned in all rows, as texts are and numbers are not."""
    start, end = span
    cells = [row[start:end] for row in rows if not _RULE.match(row)]
    return all(not cell or cell[0] != " " or not cell.strip() for cell in cells)


def _joined(
    cells: Sequence[Sequence[str]], sizes: Sequence[int], gap: int, width: int | None, rules: Sequence[bool]
) -> list[str]:
    """Return rows of cells as lines; with a width, the text of the last column wraps inside it."""
    lines: list[str] = []
    total = sum(sizes) + gap * (len(sizes) - 1)
    for row, is_rule in zip(cells, rules, strict=True):
        if is_rule:
            lines.append("-" * min(total, width or total))
            continue
        *first, last = row
        head = "".join(cell.ljust(size + gap) for cell, size in zip(first, sizes, strict=False))
        parts = [last]
        if width is not None and len(head) + len(last) > width >= len(head) + NARROWEST_TEXT:
            parts = _wrap(last, width - len(head))
        lines.append((head + parts[0]).rstrip())
        lines += [" " * len(head) + part for part in parts[1:]]
    return lines


def _chunks(sizes: Sequence[int], labels: int, width: int) -> Iterator[list[int]]:
    """Yield the columns of each part of a table that continues below itself."""
    chunk = list(range(labels))
    for k in range(labels, len(sizes)):
        if len(chunk) > labels and sum(sizes[i] + 2 for i in chunk) + sizes[k] > width:
            yield chunk
            chunk = list(range(labels))
        chunk.append(k)
    yield chunk
