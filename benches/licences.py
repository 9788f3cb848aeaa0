"""Licences of the Rust packages inside the wheel: THIRD_PARTY_LICENSES.txt, which travels with it.

    python benches/licences.py [--check]

writes the file anew from Cargo.lock and the sources that cargo keeps; ``--check`` only says whether it is as it would be
written. Packages that are linked into the core or expanded into it count, those of tests, benchmarks and build scripts do not.
Where a package may be taken under MIT or another licence, it is MIT. The list of all packages that a build looks at, with
their hashes, is the SBOM that maturin writes into the wheel.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parent.parent
FILE = PROJECT / "THIRD_PARTY_LICENSES.txt"
ROOT = "didim-python"
TARGET = "x86_64-unknown-linux-gnu"
NAMES = re.compile(r"(licen[cs]e|copying|notice|copyright)", re.IGNORECASE)
RULE = "=" * 80
MIT = """Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or substantial portions of the
Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE."""
HEAD = """The compiled core of didim contains the Rust packages below, each under its own licence. didim itself is under the
licence in LICENSE. Written by benches/licences.py."""


def metadata() -> dict[str, Any]:
    """Return what cargo knows of the packages."""
    command = ["cargo", "metadata", "--locked", "--format-version", "1", "--filter-platform", TARGET]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"licences: {done.stderr.strip()}")
    content: dict[str, Any] = json.loads(done.stdout)
    return content


def linked(content: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the foreign packages that the binding depends on when it is compiled, by name and version."""
    packages = {package["id"]: package for package in content["packages"]}
    nodes = {node["id"]: node for node in content["resolve"]["nodes"]}
    waiting = [key for key, package in packages.items() if package["name"] == ROOT]
    seen: set[str] = set()
    while waiting:
        key = waiting.pop()
        if key not in seen:
            seen.add(key)
            waiting += [
                dependency["pkg"]
                for dependency in nodes[key]["deps"]
                if any(kind["kind"] is None for kind in dependency["dep_kinds"])
            ]
    foreign = [packages[key] for key in seen if packages[key]["source"] is not None]
    yield from sorted(foreign, key=lambda package: (package["name"], package["version"]))


def terms(package: dict[str, Any]) -> str:
    """Return the texts of a package's licence, or its words where it brings none.

    Raises
    ------
    SystemExit
        When it brings none and is not under MIT: somebody has to look.
    """
    folder = Path(package["manifest_path"]).parent
    files = sorted(path for path in folder.iterdir() if path.is_file() and NAMES.match(path.name))
    mit = [path for path in files if "mit" in path.name.lower()]
    others = [path for path in files if re.search(r"apache|zlib|unlicense|boost", path.name, re.IGNORECASE)]
    chosen = [path for path in files if path not in others] if mit else files
    own = [path for path in chosen if path.name.lower().startswith(("licen", "copyright"))]
    texts = [path.read_text(encoding="utf-8").strip() for path in chosen]
    if not own:
        if "MIT" not in (package["license"] or ""):
            raise SystemExit(
                f"licences: {package['name']} ({package['license']}) brings no text of its licence"
            )
        authors = ", ".join(re.sub(r"\s*<.*?>", "", author) for author in package["authors"])
        texts.insert(0, f"Copyright (c) {authors or 'the authors of ' + package['name']}\n\n{MIT}")
    return "\n\n".join("\n".join(line.rstrip() for line in text.splitlines()) for text in texts)


def document() -> str:
    """Return the whole file: the list of packages, then each text once."""
    packages = list(linked(metadata()))
    texts: dict[str, list[str]] = {}
    for package in packages:
        texts.setdefault(terms(package), []).append(f"{package['name']} {package['version']}")
    rows = [f"{package['name']} {package['version']}: {package['license']}" for package in packages]
    parts = [f"{RULE}\n{', '.join(names)}\n{RULE}\n\n{text}" for text, names in texts.items()]
    return "\n\n".join([HEAD, "\n".join(rows), *parts]) + "\n"


def main() -> int:
    """Write the file, or look whether it is up to date."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--check", action="store_true", help="write nothing; 1 where the file is not as it would be written"
    )
    options = parser.parse_args()
    text = document()
    if options.check:
        if not FILE.exists() or FILE.read_text(encoding="utf-8") != text:
            print(f"{FILE.name} is not that of Cargo.lock: python benches/licences.py")
            return 1
        return 0
    FILE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
