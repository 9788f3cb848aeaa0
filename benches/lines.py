"""How many lines of code has the package, without docstrings, comments and blanks?

    python benches/lines.py [--before REVISION] [FOLDER ...]
    python benches/lines.py --entered
    python benches/lines.py --measures

The first counts the lines of the syntax tree's statements, folder by folder, those of the folders named or all; with `--before`
beside the same of a revision of git. A docstring is any statement that is only a text. The second counts the files and functions of
the package that `run` of a method enters, without the verdict, on the simulated TX40. The third prints what tells ideas from
ceremony, beside ceilings that only fall, and fails above one; ``make lint`` runs it. Tested in ``tests/test_lines.py``.
"""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import sys
import threading
import tokenize
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import FrameType

import didim
from didim.methods.method import Method
from didim.result.iteration import Reporter

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


CEILINGS = {
    "files": 369,
    "imports, share of the lines of code (%)": 10.6,
    "constants that are numbers": 669,
    "private functions that one place calls": 499,
    "settings of results read as a table": 26,
    "branches on the law of a friction term outside terms/": 67,
}
"""Largest value of each measure: that of the last version which had fewer."""


def measured(modules: Mapping[str, str]) -> dict[str, float]:
    """Return the measures of `CEILINGS` of modules, sources by path inside the package."""
    total = imports = numbers = helpers = settings = laws = 0
    for path, source in modules.items():
        tree = ast.parse(source)
        total += code_lines(source)
        nodes = list(ast.walk(tree))
        imports += sum(
            (node.end_lineno or 0) - node.lineno + 1
            for node in nodes
            if isinstance(node, ast.Import | ast.ImportFrom)
        )
        numbers += sum(_is_number_of_its_own(node) for node in nodes)
        uses = Counter(node.id for node in nodes if isinstance(node, ast.Name))
        private = [
            node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name[0] == "_"
        ]
        helpers += sum(uses[name] == 1 for name in private)
        settings += sum(_reads_settings(node) for node in nodes)
        if not path.startswith("terms/"):
            laws += sum(isinstance(node, ast.Compare) and _is(node.left, "law") for node in nodes)
    values = (len(modules), round(100.0 * imports / max(total, 1), 1), numbers, helpers, settings, laws)
    return dict(zip(CEILINGS, values, strict=True))


def _is(node: ast.AST, name: str) -> bool:
    """Whether a node is an attribute of this name."""
    return isinstance(node, ast.Attribute) and node.attr == name


def _reads_settings(node: ast.AST) -> bool:
    """Whether a node is ``fit.settings[...]`` or ``fit.settings.get``."""
    return (isinstance(node, ast.Subscript) and _is(node.value, "settings")) or (
        isinstance(node, ast.Attribute) and node.attr == "get" and _is(node.value, "settings")
    )


def _is_number_of_its_own(node: ast.AST) -> bool:
    """Whether a node gives a name in capitals a number, or several."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return False
    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
    leaves = [
        part
        for part in ast.walk(node.value)
        if not isinstance(part, ast.operator | ast.unaryop | ast.expr_context)
    ]
    return (
        isinstance(target, ast.Name)
        and target.id.isupper()
        and any(isinstance(part, ast.Constant) for part in leaves)
        and all(
            isinstance(part, ast.UnaryOp | ast.BinOp | ast.Tuple)
            or (isinstance(part, ast.Constant) and isinstance(part.value, int | float))
            for part in leaves
        )
    )


def package() -> dict[str, str]:
    """Return the sources of the package by path."""
    root = ROOT / PACKAGE
    return {
        path.relative_to(root).as_posix(): path.read_text(encoding="utf-8")
        for path in sorted(root.rglob("*.py"))
    }


def entered(method: Method, log: didim.Experiment) -> set[tuple[str, str]]:
    """Return file and function of all code of the package that a run of a method enters, from its second run on."""
    method.run(log, Reporter())  # the first one fills caches
    seen: set[tuple[str, str]] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(str(ROOT / PACKAGE)):
            seen.add((code.co_filename, code.co_qualname))

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        method.run(log, Reporter())
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return seen


def simulated_tx40() -> didim.Experiment:
    """Return the log that methods are counted on."""
    log = didim.packaged_experiment("tx40")
    return didim.simulated_log(log, log.robot.sets["didim_physical"])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folders", nargs="*", help="folders of the package; all by default")
    parser.add_argument("--before", help="a revision of git to compare with")
    parser.add_argument("--entered", action="store_true", help="count what a run of a method enters")
    parser.add_argument("--measures", action="store_true", help="print the measures beside their ceilings")
    asked = parser.parse_args()
    if asked.measures:
        found = measured(package())
        for name, value in found.items():
            print(f"{name:56s} {value:8g} of {CEILINGS[name]:g}")
        sys.exit(int(any(value > CEILINGS[name] for name, value in found.items())))
    if asked.entered:
        log = simulated_tx40()
        for method in (didim.IDIMLS(), didim.DIDIM(), didim.CLOE()):
            seen = entered(method, log)
            print(f"{method.name:16s} {len({file for file, _ in seen}):8d} files {len(seen):8d} functions")
        return
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
