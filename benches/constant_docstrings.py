"""Refuse docstrings of constants that do not begin with what the number is.

    python benches/constant_docstrings.py

``make lint`` runs it. "Of the Butterworth filter" and "Times the limit" make a reader guess the noun, so these words must not open
the docstring of a constant (an assignment to a name in capitals). Tested in ``tests/test_import_graph.py``.
"""

from __future__ import annotations

import ast
import sys
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("python", "tests", "benches", "examples", "docs")
"""Folders whose Python files are read."""
NOT_YET = ("python/didim/diagnosis/", "python/didim/methods/verdict/", "python/didim/methods/didim/")
"""Folders whose docstrings are still to be corrected."""
REFUSED = ("Of", "Times", "Between", "Where", "From")
"""First words that say how a number is used, not what it is."""


def headless(source: str) -> list[tuple[int, str]]:
    """Return line and name of constants whose docstring begins with one of the refused words."""
    found = []
    module = ast.parse(source)
    scopes: list[ast.Module | ast.ClassDef] = [module]
    scopes += [node for node in module.body if isinstance(node, ast.ClassDef)]
    for scope in scopes:
        for node, after in pairwise(scope.body):
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            names = [
                name.id
                for target in targets
                if target
                for name in ast.walk(target)
                if isinstance(name, ast.Name)
            ]
            text = (
                after.value.value
                if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                else None
            )
            if (
                isinstance(text, str)
                and names
                and names[0].isupper()
                and text.split()[:1]
                and text.split()[0] in REFUSED
            ):
                found.append((after.lineno, names[0]))
    return found


def main() -> None:
    wrong = [
        f"{place}:{line}: the docstring of {name} must begin with what the number is, not with {', '.join(REFUSED)}"
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        if not (place := path.relative_to(ROOT).as_posix()).startswith(NOT_YET)
        for line, name in headless(path.read_text(encoding="utf-8"))
    ]
    sys.exit("\n".join(wrong) or 0)


if __name__ == "__main__":
    main()
