"""Longest text of an expression, read off the sources: names, lists and numbers have the lengths of a robot with many joints."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path

import didim
from didim._tools.words import ROOM

SOURCES = Path(didim.__file__).parent
LENGTHS = {
    **dict.fromkeys(("name", "joint", "link", "column", "parameter", "recording", "frame", "owner"), 28),
    **dict.fromkeys(("path", "file", "where", "place", "text", "reason", "error"), 36),
    **dict.fromkeys(("sentence", "advice", "conclusion"), 95),
    **dict.fromkeys(("number", "row", "line", "sample", "count", "torque_unit", "speed_unit"), 6),
}
"""Number of characters of a value by the name of its variable or attribute: a name such as left_front_knee_pitch_joint, the name of
a file, a message that another one quotes, a count or a unit. Any other value has `ANY`."""
PRINTED = {
    f"{path}.py"
    for path in (
        "_tools/notebook",
        "_tools/words",
        "cli/lists",
        "cli/schema",
        "cli/terminal/completion",
        "cli/terminal/guide",
        "diagnosis/finding",
        "excitation/export",
        "experiment/draft",
        "experiment/draft_files",
        "export/code/c_header",
        "export/configuration",
        "export/mjcf",
        "export/mjcf_edit",
        "export/numbers",
        "export/write",
        "export/sdf",
        "export/urdf",
        "formats",
        "model/kinematics",
        "monte_carlo/spec",
        "monte_carlo/text",
        "report/fit",
        "report/page",
        "result/further",
        "experiment/draft_servos",
        "result/identification",
        "result/words/causes",
        "robot/parameters",
        "robot/robot_text",
        "robot/urdf/summary",
        "studies/comparison",
        "studies/loads/payload_result",
    )
}
"""Modules that write lines of files, pages and tables, which have all entries of a list: there it counts as one entry."""
ANY = 10
"""Number of characters of any other value, and of a number with a format."""
ENTRIES = 12
"""Number of entries of a list: the joints of a quadruped."""
RETURNED = {
    **dict.fromkeys(("two_digits", "percent"), 6),
    **dict.fromkeys(("percents", "between", "duration"), 14),
    **{
        "counted": 20,
        "title_of": 25,
        "_vector": 30,
        "joint_label": 40,
        "did_you_mean": 47,
        "joints_text": 48,
        "known_names": 114,
    },
}
"""Largest number of characters that functions of texts return, in these or in their longest words."""
MORE = len(" and 35 more")
SAME = {
    "lower",
    "upper",
    "capitalize",
    "strip",
    "rstrip",
    "lstrip",
    "replace",
    "removeprefix",
    "removesuffix",
}
"""Methods of a text whose result is about as long."""

Names = Mapping[str, Sequence[ast.expr]]


@cache
def modules() -> dict[Path, Module]:
    """Return all modules of the package by path."""
    return {path: Module(path) for path in sorted(SOURCES.rglob("*.py"))}


@cache
def functions() -> dict[str, list[tuple[Module, ast.FunctionDef]]]:
    """Return the functions and properties of the package that return a text, by name."""
    by_name: dict[str, list[tuple[Module, ast.FunctionDef]]] = {}
    for module in modules().values():
        for node in ast.walk(module.tree):
            if isinstance(node, ast.FunctionDef) and ast.unparse(node.returns or ast.Constant(None)) in (
                "str",
                "str | None",
            ):
                by_name.setdefault(node.name, []).append((module, node))
    return by_name


@cache
def constants() -> dict[str, ast.expr]:
    """Return the values of module constants by name."""
    return {
        name: values[-1]
        for module in modules().values()
        for name, values in assigned(module.tree).items()
        if name.isupper()
    }


@cache
def assigned(scope: ast.AST) -> dict[str, list[ast.expr]]:
    """Return the values given to each name by assignments in a module or a function; those of ``+=`` under ``name+``."""
    values: dict[str, list[ast.expr]] = {}
    for node in scope.body if isinstance(scope, ast.Module) else ast.walk(scope):
        match node:
            case ast.Assign(targets=[ast.Name(id=name), *_], value=value):
                values.setdefault(name, []).append(value)
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
                values.setdefault(name, []).append(value)
            case ast.AugAssign(target=ast.Name(id=name), value=value):
                values.setdefault(f"{name}+", []).append(value)
    return values


class Module:
    """A module, whose functions come before those of the same name elsewhere."""

    def __init__(self, path: Path, source: str | None = None) -> None:
        self.path = path
        self.entries = 1 if str(path.relative_to(SOURCES)) in PRINTED else ENTRIES
        self.tree = ast.parse(path.read_text(encoding="utf-8") if source is None else source)
        self._sources = {
            alias.asname or alias.name: (node.module or "").rpartition(".")[2]
            for node in ast.walk(self.tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        self._entered: set[str] = set()
        self._known: dict[str, int] = {}

    @cached_property
    def texts(self) -> list[tuple[int, int, str]]:
        """Return line, longest length and source of each text, without docstrings, rows of tables, XML and several lines."""
        lines = []
        nodes: list[tuple[ast.AST, Names]] = [(self.tree, {})]
        while nodes:
            node, names = nodes.pop()
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                continue
            if isinstance(node, ast.FunctionDef):
                names = assigned(node)
            if isinstance(node, (ast.JoinedStr, ast.BinOp, ast.Constant)):
                values = (part.value for part in ast.walk(node) if isinstance(part, ast.Constant))
                words = [value for value in values if isinstance(value, str)]
                if words and not any(mark in word for word in words for mark in ("\n", "  ", "</", "/>")):
                    lines.append((node.lineno, self.length(node, names), ast.unparse(node)))
                if not isinstance(node, ast.BinOp):
                    continue
            nodes += ((child, names) for child in ast.iter_child_nodes(node))
        return sorted(lines)

    def length(self, node: ast.expr, names: Names) -> int:
        """Return the largest number of characters of an expression; `names` has the values of local names."""
        match node:
            case ast.Constant():
                return len(str(node.value))
            case ast.JoinedStr():
                return sum(self.length(part, names) for part in node.values)
            case ast.FormattedValue(format_spec=ast.JoinedStr(values=[ast.Constant(value=str(form))])) if (
                form[-1:] == "g"
            ):
                return 6 + int(form[:-1].rpartition(".")[2] or 6)
            case ast.FormattedValue(format_spec=None):
                return self.length(node.value, names) + 2 * (node.conversion == ord("r"))
            case ast.IfExp():
                return max(self.length(node.body, names), self.length(node.orelse, names))
            case ast.BoolOp():
                return max(self.length(value, names) for value in node.values)
            case ast.BinOp(right=ast.Constant(value=int())) | ast.BinOp(left=ast.Constant(value=int())):
                return 4
            case ast.BinOp(op=ast.Add()):
                return self.length(node.left, names) + self.length(node.right, names)
            case ast.Name(id=name) if name in names:
                others = {other: values for other, values in names.items() if other != name}
                added = sum(self.length(value, others) for value in names.get(f"{name}+", ()))
                return added + max(self.length(value, others) for value in names[name])
            case ast.Name(id=name) if name in constants():
                return self.length(constants()[name], {})
            case ast.Name(id=name):
                return LENGTHS.get(name, ANY)
            case ast.Attribute(attr=name):
                return LENGTHS.get(name) or self.returned(name, of="property")
            case ast.Subscript(value=ast.Name(id=name)) if isinstance(
                table := constants().get(name), ast.Dict
            ):
                return max(self.length(value, names) for value in table.values)
            case ast.Call():
                return self._call(node, names)
        return ANY

    def _call(self, node: ast.Call, names: Names) -> int:
        """Return the largest number of characters of what a call returns."""
        function = node.func
        name = function.id if isinstance(function, ast.Name) else getattr(function, "attr", "")
        if name in ("series", "listing", "brief"):
            rooms = [*node.args[1:], *(keyword.value for keyword in node.keywords)]
            room = next((room.value for room in rooms if isinstance(room, ast.Constant)), None)
            assert room is None or isinstance(room, int)
            return (room or (60 if name == "brief" else ROOM)) + MORE * (name != "brief")
        if name in RETURNED:
            return RETURNED[name]
        if name == "join" and isinstance(function, ast.Attribute):
            return self._joined(node.args[0], self.length(function.value, names), names)
        if name in ("str", "repr") and node.args:
            return self.length(node.args[0], names) + 2 * (name == "repr")
        if name in SAME and isinstance(function, ast.Attribute):
            return self.length(function.value, names)
        return (
            self.returned(name)
            if isinstance(function, ast.Name)
            else LENGTHS.get(name) or self.returned(name)
        )

    def _joined(self, entries: ast.expr, between: int, names: Names) -> int:
        """Return the largest number of characters of joined entries."""
        if isinstance(entries, ast.Name):
            entries = names.get(entries.id, [constants().get(entries.id, entries)])[-1]
        match entries:
            case ast.List(elts=parts) | ast.Tuple(elts=parts):
                return sum(
                    self._joined(part.value, between, names)
                    if isinstance(part, ast.Starred)
                    else between + self.length(part, names)
                    for part in parts
                )
            case ast.IfExp(body=one, orelse=other):
                return max(self._joined(one, between, names), self._joined(other, between, names))
            case ast.GeneratorExp(
                elt=part, generators=[ast.comprehension(iter=ast.Subscript(slice=ast.Slice() as cut))]
            ):
                begin, end = (
                    int(ast.literal_eval(bound or ast.Constant(0))) for bound in (cut.lower, cut.upper)
                )
                return (end - begin) * (between + self.length(part, names))
            case ast.Dict(keys=keys):
                return sum(between + self.length(key, names) for key in keys if key is not None)
            case ast.Call(func=ast.Name(id="map"), args=[ast.Name(id="str"), *_]):
                return self.entries * (between + 4)
            case ast.ListComp(elt=part, generators=[ast.comprehension(iter=ast.Tuple(elts=over))]):
                return len(over) * (between + self.length(part, names))
            case ast.ListComp(elt=part) | ast.GeneratorExp(elt=part):
                return self.entries * (between + self.length(part, names))
        return self.entries * (between + LENGTHS["name"])

    def returned(self, name: str, of: str = "") -> int:
        """Return the largest number of characters that functions of a name return, or properties; `ANY` for a recursion."""
        if name in self._entered or name not in functions():
            return ANY
        if name not in self._known:
            self._entered.add(name)
            those = functions()[name]
            source = self._sources.get(name, self.path.stem)
            own = [each for each in those if each[0].path.stem == source]
            self._known[name] = max(
                (
                    module.length(node.value, assigned(function))
                    for module, function in own or those
                    if not of or of in map(ast.unparse, function.decorator_list)
                    for node in ast.walk(function)
                    if isinstance(node, ast.Return) and node.value is not None
                ),
                default=ANY,
            )
            self._entered.discard(name)
        return self._known[name]
