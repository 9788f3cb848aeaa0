"""Module constants of heuristics, doubled and halved, and the lines that use them.

`benches/mutations.py --constants` plants these errors. Constants come from the syntax tree, so that a new one is drawn as soon as
it exists; so do the lines that use one, in other modules too, and through constants made of it. `benches/reach.py` knows which
tests run a line.
"""

from __future__ import annotations

import ast
import random
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

FOLDERS = ("methods", "diagnosis", "evidence", "excitation", "regression")
"""Folders of the package whose numbers are judgements; one that is not there is left out."""


@dataclass(frozen=True, order=True)
class Planted:
    """A constant with another value.

    Attributes
    ----------
    file, line, name : str, int, str
        Where it stands, from the project's root, and what it is called.
    old, new : str
        Source of its value, as it is and changed.
    column, end : int
        Where the value begins, and the line and column where it ends.
    """

    file: str
    line: int
    name: str
    old: str
    new: str
    column: int
    end: tuple[int, int]

    def apply(self, text: str) -> str:
        """Return the text of the file with the other value."""
        lines = text.splitlines(keepends=True)
        head = "".join(lines[: self.line - 1]) + _cut(lines[self.line - 1], 0, self.column)
        tail = _cut(lines[self.end[0] - 1], self.end[1], None) + "".join(lines[self.end[0] :])
        return head + self.new + tail

    def __str__(self) -> str:
        return f"{self.file}: {self.name} = {self.new} instead of {self.old}"


def _cut(line: str, start: int, stop: int | None) -> str:
    """Return part of a line, counted in bytes as syntax trees do."""
    return line.encode()[start:stop].decode()


def constants(project: Path) -> Iterator[Planted]:
    """Yield every numeric constant of the folders but seeds, doubled and halved: whole numbers stay whole."""
    package = project / "python" / "didim"
    for folder in FOLDERS:
        for path in sorted((package / folder).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            for statement in ast.parse(text).body:
                yield from _of(statement, text, path.relative_to(project).as_posix())


def _of(statement: ast.stmt, text: str, file: str) -> Iterator[Planted]:
    match statement:
        case ast.Assign(targets=[ast.Name(id=name)], value=value):
            pass
        case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
            pass
        case _:
            return
    number = value.operand if isinstance(value, ast.UnaryOp) else value
    # Another seed is as good.
    if not name.strip("_").isupper() or name.endswith("SEED") or not isinstance(number, ast.Constant):
        return
    if isinstance(number.value, bool) or not isinstance(number.value, int | float) or number.value == 0:
        return
    old = ast.get_source_segment(text, value) or ""
    whole = isinstance(number.value, int)
    assert value.end_lineno is not None
    assert value.end_col_offset is not None
    end = (value.end_lineno, value.end_col_offset)
    for new in (f"{old} * 2", f"{old} // 2" if whole else f"{old} / 2"):
        if not (whole and new.endswith("// 2") and number.value < 2):
            yield Planted(file, value.lineno, name, old, new, value.col_offset, end)


def drawn(project: Path, count: int, seed: int) -> list[Planted]:
    """Return constants drawn without replacement; the same for a seed and a tree."""
    every = sorted(constants(project))
    return random.Random(seed).sample(every, min(count, len(every)))


def lines_using(planted: Planted, project: Path) -> dict[Path, set[int]]:
    """Return the lines that run with a constant, by file: those that name it or, for a default, the first of their function.

    Where nothing that runs names it, such as the default of a field, all lines of its file are returned.
    """
    home = project / planted.file
    found: dict[Path, set[int]] = {}
    for path, tree in _trees(project).items():
        lines = (
            _lines(tree, {planted.name}) if path == home or _imports(tree, home.stem, planted.name) else set()
        )
        if lines:
            found[path] = lines
    return found or {home: set(range(1, len(home.read_text(encoding="utf-8").splitlines()) + 1))}


@cache
def _trees(project: Path) -> dict[Path, ast.Module]:
    files = (project / "python" / "didim").rglob("*.py")
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(files)}


def _imports(tree: ast.Module, module: str, name: str) -> bool:
    """Whether a module imports a name, or the module that has it, from one of that name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            names = {alias.name for alias in node.names}
            if module in names or (name in names and (node.module or "").rpartition(".")[2] == module):
                return True
    return False


def _lines(tree: ast.Module, names: set[str]) -> set[int]:
    lines: set[int] = set()
    for statement in tree.body:
        match statement:
            case ast.Assign(targets=[ast.Name(id=other)], value=value) if other not in names:
                if _mentions(value, names):
                    lines |= _lines(tree, {other})
            case ast.FunctionDef() | ast.ClassDef():
                for function in ast.walk(statement):
                    if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
                        lines.update(*(_mentions(part, names) for part in function.body))
                        if _mentions(function.args, names):
                            lines.add(function.body[-1].lineno)
    return lines


def _mentions(tree: ast.AST, names: set[str]) -> set[int]:
    """Return the lines that name one of some constants, and those on which their statements begin."""
    lines: set[int] = set()
    for statement in ast.walk(tree):
        named = [
            node.lineno
            for child in ast.iter_child_nodes(statement)
            if not isinstance(child, ast.stmt)
            for node in ast.walk(child)
            if (isinstance(node, ast.Name) and node.id in names)
            or (isinstance(node, ast.Attribute) and node.attr in names)
        ]
        if named:
            lines.update(named, [statement.lineno] if isinstance(statement, ast.stmt) else [])
    return lines
