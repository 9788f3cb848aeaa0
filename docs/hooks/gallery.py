"""Hook of mkdocs: the Python of the gallery runs when the pages are built, and each block's `figure` stands below it.

The pictures are not files of the project. Tested in ``tests/test_pages.py``.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from typing import Any

PAGE = "gallery.md"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def drawn(markdown: str) -> Iterator[tuple[int, bytes]]:
    """Run the blocks of a page in one namespace; yield the end of each block that draws, with its picture as PNG."""
    names: dict[str, Any] = {}
    for block in BLOCK.finditer(markdown):
        names.pop("figure", None)
        exec(block[1], names)  # the page is the project's own
        if "figure" in names:
            picture = io.BytesIO()
            names["figure"].savefig(picture, format="png", dpi=80)
            yield block.end(), picture.getvalue()


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Any) -> str:
    """Put the pictures into the gallery."""
    if page.file.src_uri != PAGE:
        return markdown
    from mkdocs.structure.files import File  # the tests run without mkdocs

    text, end = "", 0
    for number, (place, picture) in enumerate(drawn(markdown), 1):
        name = f"img/gallery_{number}.png"
        files.append(File.generated(config, name, content=picture))
        text += f"{markdown[end:place]}\n\n![Picture {number}]({name})"
        end = place
    return text + markdown[end:]
