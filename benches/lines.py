"""How many lines of code has the package, without docstrings, comments and blanks?

    python benches/lines.py [--before REVISION] [FOLDER ...]

counts the lines of the syntax tree's statements, folder by folder, those of the folders named or all; with `--before` beside
the same of a revision of git. A docstring is any statement that is only a text.
"""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "python/didim"


def code_lines(text: str) -> int:
    """Return how many lines of a module hold code."""
    texts: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            texts.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    skipped = {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    }
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in skipped:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - texts)


def folder_of(path: str) -> str:
    """Return the folder of the package that a module belongs to."""
    inside = Path(path).relative_to(PACKAGE).parts
    return inside[0] if len(inside) > 1 else "(modules)"


def counted_now() -> Counter[str]:
    """Return the lines of code by folder."""
    found: Counter[str] = Counter()
    for path in sorted((ROOT / PACKAGE).rglob("*.py")):
        found[folder_of(str(path.relative_to(ROOT)))] += code_lines(path.read_text(encoding="utf-8"))
    return found


def counted_before(revision: str) -> Counter[str]:
    """Return the lines of code by folder, of a revision."""

    def git(*words: str) -> str:
        run = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
        return run.stdout

    found: Counter[str] = Counter()
    for path in git("ls-tree", "-r", "--name-only", revision, PACKAGE).splitlines():
        if path.endswith(".py"):
            found[folder_of(path)] += code_lines(git("show", f"{revision}:{path}"))
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folders", nargs="*", help="folders of the package; all by default")
    parser.add_argument("--before", help="a revision of git to compare with")
    asked = parser.parse_args()
    now = counted_now()
    before = counted_before(asked.before) if asked.before else None
    chosen = asked.folders or sorted({*now, *(before or {})})
    for name in chosen:
        past = "" if before is None else f"{before[name]:8d} {now[name] - before[name]:+8d}"
        print(f"{name:16s} {now[name]:8d} {past}")
    total = sum(now[name] for name in chosen)
    past = "" if before is None else f"{sum(before[n] for n in chosen):8d}"
    print(f"{'all':16s} {total:8d} {past}")


if __name__ == "__main__":
    main()
