"""Hook of mkdocs: tables of all declared keys, made when the pages are built. Tested in ``tests/test_reference_pages.py``."""

from __future__ import annotations

from typing import Any

PAGE = "keys.md"


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Put the tables below the text of the page of keys."""
    if page.file.src_uri != PAGE:
        return markdown
    from didim.cli.schema import FILES
    from didim.cli.schema import page as tables

    return "\n\n".join([markdown.rstrip(), *(f"## The {file} file\n\n{tables(file)}" for file in FILES)])
