"""README.md as a package index shows it: its picture and its pages by absolute links.

    python benches/index_readme.py URL [-o README.md]

An index shows the README without the project's files, so the relative picture is missing there and pages are mere names.
``URL`` is where the site of `make docs` is served. The README in which every picture of ``docs/`` and every page that stands as
``docs/NAME.md`` is a link into that site is printed, or written with ``-o``. Tested in ``tests/test_readme.py``.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from urllib.parse import urlsplit

ROOT = Path(__file__).resolve().parents[1]


def absolute(text: str, url: str) -> str:
    """Return a README whose pictures and pages are links into the site at a URL.

    Raises
    ------
    ValueError
        For a URL that is not an absolute one, and for a picture or a page that the site does not have.
    """
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.netloc:
        raise ValueError(
            f"the address of the site must begin with https:// or http:// and a host, got {url!r}"
        )
    base = url.rstrip("/")

    def target(name: str) -> str:
        if not (ROOT / "docs" / name).is_file():
            raise ValueError(f"docs/{name} is not there")
        return f"{base}/{name.removesuffix('.md')}.html" if name.endswith(".md") else f"{base}/{name}"

    text = re.sub(r"(!\[[^\]]*\]\()docs/([^)]+)\)", lambda m: f"{m[1]}{target(m[2])})", text)
    return re.sub(r"`docs/(\w+\.md)`", lambda m: f"[`docs/{m[1]}`]({target(m[1])})", text)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("url", help="where the site of `make docs` is served")
    parser.add_argument("-o", "--output", type=Path, help="file to write; printed without it")
    options = parser.parse_args()
    try:
        text = absolute((ROOT / "README.md").read_text(encoding="utf-8"), options.url)
    except ValueError as error:
        sys.exit(str(error))
    if options.output is None:
        print(text, end="")
    else:
        options.output.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
