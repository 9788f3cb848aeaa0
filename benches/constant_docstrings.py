"""Refuse constants whose docstring does not begin with the quantity, and numbers of the package without a docstring.

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
NUMBERS = "python/didim/"
"""Folder whose numeric constants must have a docstring."""
REFUSED = (
    *("Of", "Times", "Between", "Where", "From", "What", "It", "So", "How", "And", "As"),
    *("That", "Which", "When", "Beyond", "Below", "Above", "If", "More", "Fewer"),
)
"""First words that say how a number is used, not what it is."""


def headless(source: str, *, numbers: bool = False) -> list[tuple[int, str]]:
    """Return line and name of constants whose docstring begins with a refused word, and of numbers that have none."""
    wrong = []
    module = ast.parse(source)
    scopes: list[ast.Module | ast.ClassDef] = [module]
    scopes += [node for node in module.body if isinstance(node, ast.ClassDef)]
    for scope in scopes:
        for node, after in pairwise([*scope.body, ast.Pass()]):
            if not isinstance(node, ast.Assign | ast.AnnAssign):
                continue
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            name = next((part.id for part in ast.walk(target) if isinstance(part, ast.Name)), "")
            if not name.isupper():
                continue
            match after:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    if text.split()[:1] and text.split()[0] in REFUSED:
                        wrong.append((after.lineno, name))
                case _ if numbers and _is_number(node.value):
                    wrong.append((node.lineno, name))
    return wrong


def _is_number(value: ast.expr | None) -> bool:
    parts = list(ast.walk(value)) if value else []
    return bool(parts) and all(
        isinstance(part, ast.UnaryOp | ast.BinOp | ast.operator | ast.unaryop)
        or (isinstance(part, ast.Constant) and isinstance(part.value, int | float))
        for part in parts
    )


def main() -> None:
    wrong = [
        f"{name}:{line}: the docstring of {constant} must say first what the constant is (not 'Of ...', 'What ...')"
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        for name in [path.relative_to(ROOT).as_posix()]
        for line, constant in headless(path.read_text(encoding="utf-8"), numbers=name.startswith(NUMBERS))
    ]
    sys.exit("\n".join(wrong) or 0)


if __name__ == "__main__":
    main()
