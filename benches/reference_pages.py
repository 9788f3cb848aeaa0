"""Write docs/keys.md: every key of robot and experiment files, from the readers. Run it when a reader learned a key."""

from __future__ import annotations

import sys
from pathlib import Path

from didim.experiment.schema import FILES, page

PAGE = Path(__file__).resolve().parents[1] / "docs" / "keys.md"


def text(now: str) -> str:
    """Return the page with its introduction and the tables as they are now."""
    head = now.split("## The robot file")[0].rstrip()
    return head + "\n\n" + "\n".join(f"## The {file} file\n\n{page(file)}" for file in FILES)


def main() -> int:
    PAGE.write_text(text(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
