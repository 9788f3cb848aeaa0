"""Write the pages of all declared keys, docs/*_keys.md. Run it after a change of packaged/schema."""

from __future__ import annotations

import sys
from pathlib import Path

from didim.cli.schema import FILES, page

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = {file: DOCS / f"{file}_keys.md" for file in FILES}


def text(file: str, now: str) -> str:
    """Return the page of a kind of file with its introduction and the tables as they are now."""
    title = f"## The {file} file"
    return f"{now.split(title)[0].rstrip()}\n\n{title}\n\n{page(file)}"


def main() -> int:
    for file, path in PAGES.items():
        path.write_text(text(file, path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
