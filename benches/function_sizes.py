"""Refuse functions of the package above 60 lines or 8 parameters, unless a comment in the line of ``def`` gives the reason.

    python benches/function_sizes.py

``make lint`` runs it. Lines are lines of code with the signature, without docstring, comments and blanks; parameters do not count
``self`` and ``cls``. The comment begins with "long:" or "many parameters:". Tested in ``tests/test_import_graph.py``.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

from lines import code_lines

ROOT = Path(__file__).resolve().parents[1]
MOST_LINES = 60
"""Largest number of lines of code of a function."""
MOST_PARAMETERS = 8
"""Largest number of parameters of a function."""


def oversized(source: str) -> list[tuple[int, str]]:
    """Return line and complaint for each function that is too large and gives no reason."""
    lines, wrong = source.splitlines(), []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        comment = lines[node.lineno - 1].partition("#")[2]
        every = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        parameters = [item.arg for item in every if item.arg not in ("self", "cls")]
        if len(parameters) > MOST_PARAMETERS and "many parameters:" not in comment:
            wrong.append((node.lineno, f"{node.name} has {len(parameters)} parameters"))
        size = code_lines(_text(lines, node)) - bool(node.col_offset)
        if size > MOST_LINES and "long:" not in comment:
            wrong.append((node.lineno, f"{node.name} has {size} lines"))
    return wrong


def _text(lines: list[str], node: ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    """Return the text of a function with its indentation removed."""
    text = "\n".join(lines[node.lineno - 1 : node.end_lineno])
    return f"if True:\n{text}" if node.col_offset else text


def main() -> None:
    wrong = [
        f"{path.relative_to(ROOT).as_posix()}:{line}: {complaint}; name its parts, or say why not in a comment behind def"
        for path in sorted((ROOT / "python").rglob("*.py"))
        for line, complaint in oversized(path.read_text(encoding="utf-8"))
    ]
    sys.exit("\n".join(wrong) or 0)


if __name__ == "__main__":
    main()
