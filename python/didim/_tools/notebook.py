"""How results show themselves in notebooks: tables as tables, sentences as text. Tested in ``tests/test_notebook.py``.

A class that shows itself defines ``_repr_html_`` by `page`; nothing here knows what it shows.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

from ..errors import DidimError

Rows = Sequence[Sequence[str]]
"""Heading and cells of a table."""


def page(title: str, *parts: str | Rows) -> str:
    """Return HTML that a notebook displays.

    Parameters
    ----------
    title : str
        Above everything.
    *parts : str or rows
        Text, whose lines and columns stay as they are, and tables: the first row is the heading. Empty parts are left out.
    """
    lines = [f"<strong>{html.escape(title)}</strong>"]
    for part in parts:
        if not part:
            continue
        lines.append(f"<pre>{html.escape(part)}</pre>" if isinstance(part, str) else _table(part))
    return "<div>" + "\n".join(lines) + "</div>"


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
    """Whether a cell belongs on the right: a number, or nothing in its place."""
    if cell in ("", "-") or cell.startswith(">"):
        return True
    try:
        float(cell)
    except ValueError:
        return False
    return True


def pandas() -> Any:
    """Import pandas.

    Raises
    ------
    DidimError
        When it is not installed.
    """
    try:
        import pandas as module
    except ImportError:
        raise DidimError("to_dataframe() needs pandas: pip install pandas") from None
    return module
