"""Results in notebooks: tables as HTML tables, sentences as text. Tested in ``tests/test_notebook.py``.

A class defines ``_repr_html_`` by `page`, which is independent of the class.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from ..errors import DidimError
from .plugins import optional
from .words import number_of

Rows = Sequence[Sequence[str]]
"""Heading and cells of a table."""

PRE = "white-space: pre-wrap; word-break: normal; overflow-wrap: break-word"
"""Style of text: notebooks break lines within a word otherwise."""
LONGEST_VALUE = 60
"""Largest number of characters of a field in a repr."""


def page(title: str, *parts: str | Rows) -> str:
    """Return HTML that a notebook displays.

    Parameters
    ----------
    title : str
        Title on top.
    *parts : str or rows
        Preformatted text, and tables with the heading in the first row. Empty parts are omitted.
    """
    lines = [f"<strong>{html.escape(title)}</strong>"]
    for part in parts:
        if not part:
            continue
        lines.append(
            f'<pre style="{PRE}">{html.escape(part)}</pre>' if isinstance(part, str) else _table(part)
        )
    return "<div>" + "\n".join(lines) + "</div>"


class Printed:
    """Base of a class with a readable text: a notebook shows the text, and the repr is one line of it."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {str(self).partition(chr(10))[0]}>"

    def _repr_html_(self) -> str:
        title, _, rest = str(self).partition("\n")
        return page(title, rest.strip("\n"))


class Brief:
    """Base of a frozen dataclass whose repr shows the shapes of arrays instead of their numbers."""

    def __repr__(self) -> str:
        shown = (f"{attribute.name}={_brief(getattr(self, attribute.name))}" for attribute in fields(self))  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(shown)})"


def _brief(value: object) -> str:
    shape = getattr(value, "shape", None)
    if shape is not None:
        return f"array{tuple(shape)}"
    text = repr(value)
    return text if len(text) <= LONGEST_VALUE else f"{type(value).__name__}(...)"


def _table(rows: Rows) -> str:
    head, *body = rows
    numeric = [all(_is_number(row[k]) for row in body) and bool(body) for k in range(len(head))]
    align = ["right" if is_number else "left" for is_number in numeric]

    def line(cells: Sequence[str], tag: str) -> str:
        styled = (
            f'<{tag} style="text-align: {where}">{html.escape(cell)}</{tag}>'
            for cell, where in zip(cells, align, strict=True)
        )
        return f"<tr>{''.join(styled)}</tr>"

    shown = [line(row, "td") for row in body]
    return f"<table><thead>{line(head, 'th')}</thead><tbody>{''.join(shown)}</tbody></table>"


def _is_number(cell: str) -> bool:
    """Whether a cell is right-aligned: a number, or the mark of a missing one."""
    return cell in ("", "-") or cell.startswith(">") or number_of(cell) is not None


def pandas() -> Any:
    """Import pandas.

    Raises
    ------
    DidimError
        When it is not installed.
    """
    return optional("pandas", DidimError, "to_dataframe() needs pandas: pip install pandas")
