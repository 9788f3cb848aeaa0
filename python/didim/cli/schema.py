"""Declared keys as text: the page of keys (``docs/keys.md``), JSON schemas for editors, and lists for terminals.

The declarations are the rows of ``packaged/schema`` (`didim._tools.keys`). Tested in ``tests/test_reference_pages.py``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from .._tools.keys import NAME, Key, declared, path_inside
from ..excitation.settings import ExcitationSettings
from ..regression.settings import LeastSquaresSettings
from ..signal.processing import SignalProcessing
from .terminal.color import BOLD, painted

FILES = ("robot", "experiment", "study", "excitation")
"""Kinds of files that have a schema."""

SETTINGS: dict[str, Any] = {
    "signal": SignalProcessing,
    "least_squares": LeastSquaresSettings,
    "excitation": ExcitationSettings,
}
"""Settings classes whose defaults are those of the tables."""

MARKS = {"experiment": "robot", "study": "method", "robot": "joint"}
"""Keys at the top of a file by which its kind is known; a file without one of them is the settings of an excitation."""

DRAFT = "http://json-schema.org/draft-07/schema#"
"""Version of JSON schema that editors of TOML read."""

NUMBERS = ("fixed", "lock")
"""Tables of numbers whose keys are free."""

_NUMBERS = {"type": "array", "items": {"type": "number"}}
_TEXTS = {"type": "array", "items": {"type": "string"}}
SHAPES: dict[str, list[dict[str, Any]]] = {
    "number": [{"type": "number"}],
    "integer": [{"type": "integer"}],
    "text": [{"type": "string"}],
    "true or false": [{"type": "boolean"}],
    "list of numbers": [_NUMBERS],
    "number, or list of numbers": [{"type": "number"}, _NUMBERS],
    "list of texts": [_TEXTS],
    "text, or list of texts": [{"type": "string"}, _TEXTS],
    "matrix, row by row": [{"type": "array", "items": _NUMBERS}],
    "list of [start, stop]": [{"type": "array", "items": _NUMBERS}],
    "true, false, or text": [{"type": "boolean"}, {"type": "string"}],
    "true, false, or list of joints": [{"type": "boolean"}, _NUMBERS],
    "integer, or list of integers": [{"type": "integer"}, _NUMBERS],
    'number, list of numbers, "hold" or "estimate"': [{"type": "number"}, _NUMBERS, {"type": "string"}],
    'number, list of numbers, or "estimate"': [{"type": "number"}, _NUMBERS, {"type": "string"}],
    "list of names, list of numbers from 1, or table of columns by joint": [{"type": ["array", "object"]}],
    "text, list of texts, or array of tables": [{"type": ["string", "array"]}],
    "table of dotted keys": [{"type": "object"}],
    "list of tables of dotted keys": [{"type": "array", "items": {"type": "object"}}],
}
"""JSON schemas of the types."""


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return (
            "{ " + ", ".join(f"{json.dumps(key)} = {_toml(element)}" for key, element in value.items()) + " }"
        )
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value, ensure_ascii=False)


def page(file: str) -> str:
    """Return the reference of one kind of file as Markdown: a table of keys for each table of the file."""
    tables = declared(file).tables
    arrays = {path_inside(path, key.name) for path, key in _keys(file) if key.type == "array of tables"}
    lines: list[str] = []
    for path, rows in tables.items():
        name = f"`[[{path}]]`" if path in arrays else f"`[{path}]`"
        lines += ["", "### The file itself" if path == "file" else f"### {name}", ""]
        lines += ["| key | type | default | meaning | example |", "|---|---|---|---|---|"]
        lines += [f"| {' | '.join(cells(path, key))} |" for key in rows.values()]
    return "\n".join(lines[1:]) + "\n"


def _keys(file: str) -> Iterator[tuple[str, Key]]:
    """Give all keys of a kind of file with the paths of their tables."""
    for path, rows in declared(file).tables.items():
        for key in rows.values():
            yield path, key


def cells(path: str, key: Key) -> list[str]:
    """Return the cells of a key in the reference: key, type, default, meaning and example."""
    kind = ", ".join(f"`{_toml(choice)}`" for choice in key.choices) or key.type
    bounds = {"at least": key.minimum, "at most": key.maximum, "above": key.above}
    details = [key.unit, *(f"{words} {bound:g}" for words, bound in bounds.items() if bound is not None)]
    kind += f" ({', '.join(filter(None, details))})" if any(details) else ""
    value = getattr(SETTINGS.get(path), key.name, key.default)
    default = list(value) if isinstance(value, tuple) else value
    given = "-" if default is None else f"`{_toml(default)}`"
    if key.required:
        given = "required" if key.required is True else f"required {key.required}"
    example = next((value for value in (key.example, default, *key.choices) if value is not None), None)
    shown = (
        ""
        if example is None or key.type in ("table", "array of tables")
        else f"`{key.name} = {_toml(example)}`"
    )
    return [f"`{key.name}`", kind, given, key.meaning, shown.replace("|", r"\|")]


def listed(file: str) -> str:
    """Return the keys of one kind of file as a list, for a terminal that is too narrow for the tables of the page."""
    lines = [painted(f"The {file} file", BOLD)]
    for path, rows in declared(file).tables.items():
        lines += ["", painted("at the top" if path == "file" else f"[{path}]", BOLD)]
        for key in rows.values():
            name, kind, default, meaning, example = (cell.replace("`", "") for cell in cells(path, key))
            given = default if key.required else f"default {default}"
            lines += [f"{name}: {kind}{'' if default == '-' else f', {given}'}", f"  {meaning}"]
            lines += [f"  {example}"] if example else []
    return "\n".join(lines)


def json_schema(file: str) -> dict[str, Any]:
    """Return the JSON schema of one kind of file, or of "any" of them, for editors of TOML."""
    if file == "any":
        any_file = json_schema("excitation")
        for kind, mark in MARKS.items():
            any_file = {"if": {"required": [mark]}, "then": json_schema(kind), "else": any_file}
        return {"$schema": DRAFT, **any_file}
    root: dict[str, Any] = {"$schema": DRAFT, "title": f"didim {file} file", **_object()}
    for path, key in _keys(file):
        # Free names are further properties.
        node = root
        for part in path.split(".") if path != "file" else []:
            if part == NAME:
                if node["additionalProperties"] is False:
                    node["additionalProperties"] = {**_object(), "additionalProperties": {"type": "number"}}
                node = node["additionalProperties"]
                continue
            node = node["properties"].setdefault(part, _object())
            node = node.get("items", node)
        if key.type in ("table", "array of tables"):
            inside = node["properties"].setdefault(key.name, _object())
            if key.name in NUMBERS:
                inside["additionalProperties"] = {"type": "number"}
            if key.type == "array of tables":
                node["properties"][key.name] = {"type": "array", "items": inside}
        else:
            node["properties"][key.name] = _value(key)
        node["properties"][key.name]["description"] = key.meaning
        if key.required is True:
            node.setdefault("required", []).append(key.name)
    return root


def _object() -> dict[str, Any]:
    return {"type": "object", "properties": {}, "additionalProperties": False}


def _value(key: Key) -> dict[str, Any]:
    """Return the JSON schema of a value."""
    bounds = {"minimum": key.minimum, "maximum": key.maximum, "exclusiveMinimum": key.above}
    given = {name: bound for name, bound in bounds.items() if bound is not None}
    shapes = [
        {
            **shape,
            **(given if shape["type"] in ("number", "integer") else {}),
            **({"enum": key.choices} if key.choices and shape["type"] == "string" else {}),
        }
        for shape in SHAPES[key.type]
    ]
    return shapes[0] if len(shapes) == 1 else {"anyOf": shapes}
