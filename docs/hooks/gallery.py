"""Hook of mkdocs: the Python of the gallery runs when the pages are built, and each block's `figure` stands below it.

The pictures are not files of the project but those of reports.
Tested in ``tests/test_pages.py``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

PAGE = "results.md"
HEADING = "\n## Gallery\n"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def drawn(markdown: str) -> Iterator[tuple[int, str]]:
    """Run the blocks of a page in one namespace; yield the end of each block that draws, with its picture as HTML."""
    from didim.report.page import picture

    names: dict[str, Any] = {}
    for block in BLOCK.finditer(markdown):
        names.pop("figure", None)
        exec(block[1], names)  # the page is the project's own
        if "figure" in names:
            yield block.end(), picture(names["figure"], block[1].strip().splitlines()[-1]).text


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Put the pictures into the gallery."""
    if page.file.src_uri != PAGE:
        return markdown
    from didim.report.page import PICTURE_STYLE

    text, end = "", 0
    before, heading, gallery = markdown.partition(HEADING)
    for place, html in drawn(gallery):
        text += f"{gallery[end:place]}\n\n{html}"
        end = place
    return f"{before}{heading}{text}{gallery[end:]}\n\n<style>\n{PICTURE_STYLE}</style>\n"
