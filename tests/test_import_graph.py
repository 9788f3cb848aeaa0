"""The tree of the package: imports only look down, and nothing imports in a circle."""

from __future__ import annotations

import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from scripts import script

PACKAGE = Path(__file__).resolve().parents[1] / "python" / "didim"

FLOORS = (
    ("errors", "_core"),
    ("_tools",),
    ("robot",),
    ("model",),
    ("log",),
    ("loop",),
    ("signal",),
    ("terms",),
    ("regression",),
    ("solvers",),
    ("experiment",),
    ("result",),
    ("evidence",),
    ("methods",),
    ("export",),
    ("excitation",),
    ("studies",),
    ("monte_carlo",),
    ("plot",),
    ("formats",),
    ("report",),
    ("diagnosis",),
    ("view",),
    ("cli",),
    ("__main__",),
)
"""Folders and modules of the package, from the bottom up: each imports from its own floor and those before it."""

FLOOR_OF = {name: floor for floor, names in enumerate(FLOORS) for name in names}
# Scripts of packaged examples are users of the package, not a part of it.
SOURCES = sorted(path for path in PACKAGE.rglob("*.py") if "packaged" not in path.relative_to(PACKAGE).parts)


def name_of(path: Path) -> str:
    """Dotted name of a module inside the package; that of the package itself is empty."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in SOURCES} | {"_core": PACKAGE / "_core.pyi"}


def imported(module: str, tree: ast.Module, *, is_package: bool) -> set[tuple[str, int]]:
    """Modules of the package that a module imports anywhere, with lines: in functions and for type checkers too."""
    here = module.split(".") if module else []
    package = here if is_package else here[:-1]
    found: set[tuple[str, int]] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                head, _, rest = alias.name.partition(".")
                if head == "didim":
                    found.add((rest, node.lineno))
        elif isinstance(node, ast.ImportFrom):
            name = node.module or ""
            if node.level:
                start = package[: len(package) - node.level + 1]
                base = ".".join([*start, *([name] if name else [])])
            elif name == "didim" or name.startswith("didim."):
                base = name.removeprefix("didim").removeprefix(".")
            else:
                continue
            for alias in node.names:
                inner = f"{base}.{alias.name}" if base else alias.name
                found.add((inner if inner in MODULES else base, node.lineno))
    return found


@cache
def graph() -> dict[str, set[tuple[str, int]]]:
    """What each module imports; read by the tests that ask, not by each process that collects them."""
    return {
        module: imported(
            module, ast.parse(path.read_text(encoding="utf-8")), is_package=path.stem == "__init__"
        )
        for module, path in MODULES.items()
        if path.suffix == ".py"
    }


def floor(module: str) -> int:
    return FLOOR_OF[module.partition(".")[0]]


def test_every_module_has_a_floor() -> None:
    assert {name.partition(".")[0] for name in MODULES if name} == set(FLOOR_OF)


def test_imports_only_look_down() -> None:
    upward = [
        f"{module}:{line} imports {other or 'the package itself'}"
        for module, others in graph().items()
        if module
        for other, line in sorted(others)
        if not other or floor(other) > floor(module)
    ]
    assert not upward, "\n".join(upward)


def test_nothing_imports_in_a_circle() -> None:
    below = {
        module: {other for other, _ in others if other != module}
        for module, others in graph().items()
        if module  # the package itself names everything, and nothing imports it
    }
    try:
        tuple(TopologicalSorter(below).static_order())
    except CycleError as cycle:
        pytest.fail(" <- ".join(cycle.args[1]))


def test_modules_import_names_and_no_modules_of_the_package() -> None:
    # `from . import module` makes every module depend on the file of its folder.
    whole = [
        f"{module}:{node.lineno}"
        for module, path in MODULES.items()
        if path.suffix == ".py" and module
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.level and node.module is None
    ]
    assert not whole


@pytest.mark.parametrize(
    ("module", "source", "expected"),
    [
        ("signal.noise", "from ..log.recording import Recording", {"log.recording"}),
        ("signal.noise", "from . import filters", {"signal.filters"}),
        ("signal", "from .noise import white_noise", {"signal.noise"}),
        ("signal.noise", "from .. import _core", {"_core"}),
        ("signal.noise", "from didim import load_robot", {""}),
        ("signal.noise", "import didim.plot as plot", {"plot"}),
        ("signal.noise", "if TYPE_CHECKING:\n    from ..methods.method import Job", {"methods.method"}),
        ("signal.noise", "def f():\n    from ..cli.main import main", {"cli.main"}),
        ("signal.noise", "import numpy, scipy.signal\nfrom scipy.signal import welch", set()),
    ],
)
def test_the_graph_sees_every_kind_of_import(module: str, source: str, expected: set[str]) -> None:
    found = imported(module, ast.parse(source), is_package=module == "signal")
    assert {name for name, _ in found} == expected


def test_docstrings_of_constants_begin_with_a_noun(project: Path) -> None:
    program = script(project / "benches" / "constant_docstrings.py")
    refused = 'A = 1\n"""Of a filter."""\nclass C:\n    B: int = 2\n    """Times the limit."""\n'
    assert program.headless(refused) == [(2, "A"), (5, "B")]
    accepted = 'A = 1\n"""Order of a filter."""\nb = 2\n"""Of a filter."""\nC = 3\n'
    assert program.headless(accepted) == []
    assert program.headless('A = 1\nB = "b"\nC: float = -2 * 1e-3\nD = f(1)\n', numbers=True) == [
        (1, "A"),
        (3, "C"),
    ]


def test_large_functions_need_a_reason(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(project / "benches")
    program = script(project / "benches" / "function_sizes.py")
    body = "\n".join(f"    a{k} = {k}" for k in range(60))
    documented = f'def f():\n    """What f does."""\n    # Why.\n\n{body}\n'
    assert program.oversized(documented) == [(1, "f has 61 lines")]
    assert program.oversized(documented.replace("def f():", "def f():  # long: one table")) == []
    assert program.oversized(documented.replace("    a0 = 0\n", "")) == []
    method = "class C:\n    def g(self, a, b, c, d, e, f, g, *, h{}):\n        return a\n"
    assert program.oversized(method.format("")) == []
    assert program.oversized(method.format(", i")) == [(2, "g has 9 parameters")]
    wide = method.format(", i").replace(
        "def g(self, ", "def g(  # many parameters: those of a file\n        self, "
    )
    assert program.oversized(wide) == []
