"""Module constants of heuristics, doubled and halved, and the tests that reach their module.

`benches/mutations.py --constants` plants these errors. Constants come from the syntax tree, so that a new one is drawn as soon as
it exists. How far a test is from a module is the number of imports between them; tests that a module's own docstring names, or
that name the constant, are nearest.
"""

from __future__ import annotations

import ast
import random
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

FOLDERS = ("methods", "diagnosis", "evidence", "excitation", "regression")
"""Folders of the package whose numbers are judgements; one that is not there is left out."""
FAR = 3
"""Imports between a test and a module at most: beyond them everything reaches everything."""


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
    """Yield every numeric constant of the folders, doubled and halved: whole numbers stay whole."""
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
    if not name.strip("_").isupper() or not isinstance(number, ast.Constant):
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


def module_of(path: Path, root: Path) -> str:
    """Return the dotted name of a file below a folder of imports."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def imports(project: Path) -> dict[str, frozenset[str]]:
    """Return which modules each module imports, the package's and those of tests/, those inside functions too."""
    found: dict[str, frozenset[str]] = {}
    files = {}
    for root in (project / "python", project / "tests"):
        for path in root.rglob("*.py"):
            files[module_of(path, root)] = path
    for module, path in files.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        package = module if path.name == "__init__.py" else module.rpartition(".")[0]
        names: set[str] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                names.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
                source = ".".join([*base, *([node.module] if node.module else [])])
                names.update([source, *(f"{source}.{alias.name}" for alias in node.names)])
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                # Tables of names that are loaded late: "didim.methods.cloe.cloe:CLOE", or without the package.
                text = node.value.partition(":")[0].lstrip(".")
                names.update(name for name in (text, f"didim.{text}") if re.fullmatch(r"[\w.]+", name))
        # A package's own page loads all of it late: it is no way from a test to a module.
        found[module] = frozenset(name for name in names if name in files and name not in (module, "didim"))
    return found


def tests_of(planted: Planted, project: Path) -> list[str]:
    """Return the files of tests that reach a constant, the nearest first."""
    module = module_of(project / planted.file, project / "python")
    users: dict[str, set[str]] = {}
    for user, used in imports(project).items():
        for name in used:
            users.setdefault(name, set()).add(user)
    distance, waiting = {module: 0}, deque([module])
    while waiting:
        here = waiting.popleft()
        for user in users.get(here, ()) if distance[here] < FAR else ():
            if user not in distance:
                distance[user] = distance[here] + 1
                waiting.append(user)
    text = (project / planted.file).read_text(encoding="utf-8")
    for name in re.findall(r"\b(test_\w+)\.py", ast.get_docstring(ast.parse(text)) or ""):
        distance[name] = 0
    ordered = []
    for path in sorted((project / "tests").glob("test_*.py")):
        if path.stem in distance:
            named = re.search(rf"\b{planted.name}\b", path.read_text(encoding="utf-8")) is not None
            ordered.append((-1 if named else distance[path.stem], path.stat().st_size, f"tests/{path.name}"))
    return [name for _, _, name in sorted(ordered)]
