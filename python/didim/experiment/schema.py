"""The schema of robot and experiment files: every key of the readers with type, bounds, default and an example.

Keys are declared once, as rows of `didim._tools.toml.Key`, or requested by the readers. The latter are recorded while the
readers process the sample files of ``packaged/schema``, which contain every table; ``packaged/schema/keys.toml`` has their
sentences. ``docs/robot_keys.md``, ``docs/experiment_keys.md`` and the JSON schemas for editors are generated from this. A new
key is a new row. Tested in ``tests/test_reference_pages.py``.
"""

from __future__ import annotations

import json
import re
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

from .._tools.toml import MISSING, Asked, asked_keys
from ..regression.settings import LeastSquaresSettings
from ..robot.robot_file import PACKAGED, load_robot
from ..signal.processing import SignalProcessing
from .experiment_file import read_experiment

SAMPLES = PACKAGED.parent / "schema"
"""Folder of the sample files."""

FILES = ("robot", "experiment")
"""Kinds of files that have a schema."""

SETTINGS: dict[str, Any] = {"signal": SignalProcessing, "least_squares": LeastSquaresSettings}
"""Settings classes whose defaults are those of the tables."""

NAMES = ("fixed", "lock")
"""Tables of numbers whose keys are free."""

DATA = {
    "log.csv": "t,q1,q2,v1,v2,u1,u2,e1,e2,r1,r2\n"
    + "".join(f"{0.01 * k:.2f},{k % 7},{k % 5},0,0,{k % 3},{k % 4},0,0,0,0\n" for k in range(300)),
    "q1.txt": "".join(f"{0.01 * (k % 7)}\n" for k in range(300)),
    "q2.txt": "".join(f"{0.01 * (k % 5)}\n" for k in range(300)),
    "flat.txt": "".join(f"{k % 11}\n" for k in range(1200)),
}
"""Data files that the sample files refer to."""

UNITS = {
    "rad_s2": "rad/s^2", "m_s2": "m/s^2", "rad_s": "rad/s", "deg_s": "deg/s", "mm_s": "mm/s", "m_s": "m/s", "kg_m2": "kg.m^2",
    "n_m": "N.m", "hz": "Hz", "rad": "rad", "deg": "deg", "mm": "mm", "kg": "kg", "m": "m", "s": "s", "n": "N", "v": "V", "a": "A",
}  # fmt: skip
"""Units by the ending of a key, longest endings first."""


@dataclass(frozen=True)
class Entry:
    """One key of a file.

    Attributes
    ----------
    path, key : str
        Table and key; the path of the file itself is empty.
    kinds : tuple of str
        Its types in words.
    unit : str
        Unit, from the end of the key; empty without one.
    default : str
        Default: a value, "required", or "-" if it depends on other keys.
    choices : tuple of str
        Allowed texts.
    bounds : str
        Bounds of a number in words.
    example : str
        A value from the samples; empty for tables.
    meaning : str
        One sentence.
    always : bool
        Whether every table of this path in the samples has it; a key of one kind of table is not required in others.
    asked : tuple of Asked
        Requests by the readers.
    """

    path: str
    key: str
    kinds: tuple[str, ...]
    unit: str
    default: str
    choices: tuple[str, ...]
    bounds: str
    example: str
    meaning: str
    always: bool
    asked: tuple[Asked, ...]


@cache
def entries(file: str) -> tuple[Entry, ...]:
    """Return the keys of robot or experiment files in the order in which they are read."""
    found: dict[tuple[str, str], list[Asked]] = {}
    examples: dict[tuple[str, str], Any] = {}
    always: dict[str, set[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, text in DATA.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        for sample in sorted((SAMPLES / file).glob("*.toml")):
            content = tomllib.loads(sample.read_text(encoding="utf-8"))
            for place, value in _values(content, ""):
                examples.setdefault(place, value)
            for path, keys in _tables(content, ""):
                always[path] = always.get(path, keys) & keys
            with asked_keys() as asked:
                if file == "robot":
                    load_robot(sample)
                else:
                    read_experiment(content, sample, data=folder)
            for item in asked:
                if item.where == sample.name:
                    found.setdefault((_general(item.path), item.name), []).append(item)
    meanings = tomllib.loads((SAMPLES / "keys.toml").read_text(encoding="utf-8"))[file]
    return tuple(
        _entry(
            path,
            key,
            asked,
            examples,
            meanings.get(path or "file", {}).get(key)
            or next((item.meaning for item in asked if item.meaning), ""),
            key in always.get(path, ()),
        )
        for (path, key), asked in found.items()
        if not _free(path, key) and any(item.kind for item in asked)
    )


def _values(content: Mapping[str, Any], path: str) -> Iterator[tuple[tuple[str, str], Any]]:
    """Values of a file by table and key."""
    for key, value in content.items():
        inside = _general(f"{path}.{key}" if path else key)
        if isinstance(value, dict):
            yield from _values(value, inside)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for item in value:
                yield from _values(item, inside)
        else:
            yield (path, key), value


def _tables(content: Mapping[str, Any], path: str) -> Iterator[tuple[str, set[str]]]:
    """Keys of all tables of a file."""
    yield path, set(content)
    for key, value in content.items():
        inside = _general(f"{path}.{key}" if path else key)
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, dict):
                yield from _tables(item, inside)


def _general(path: str) -> str:
    """Return a path without table numbers and free names."""
    path = re.sub(r" \d+", "", path)
    return re.sub(r"^(parameters|payload|unknown)\.(?!fixed)[^.]+", r"\1.NAME", path)


def _free(path: str, key: str) -> bool:
    """Whether a key is a free name, or that of a parameter."""
    return (
        (path in ("parameters", "payload", "unknown") and key not in ("fixed", "dropped", "links"))
        or path in ("parameters.fixed", "urdf.lock")
        or (path == "parameters.NAME" and key != "frames")
    )


def _entry(
    path: str,
    key: str,
    asked: list[Asked],
    examples: Mapping[tuple[str, str], Any],
    meaning: str,
    always: bool,
) -> Entry:
    kinds = tuple(dict.fromkeys(item.kind for item in asked if item.kind))
    # A type in words is complete if given.
    said = [kind for kind in kinds if " or " in kind or kind.startswith("list of [")]
    bounds = {
        "at least": [item.minimum for item in asked if item.minimum is not None],
        "at most": [item.maximum for item in asked if item.maximum is not None],
        "above": [item.above for item in asked if item.above is not None],
    }
    declared = next((item.example for item in asked if item.example is not None), None)
    shown = examples.get((path, key), declared)
    return Entry(
        path=path,
        key=key,
        kinds=tuple(said[:1]) or kinds,
        unit=next((unit for end, unit in UNITS.items() if key.endswith(f"_{end}")), ""),
        default=_default(path, key, asked),
        choices=tuple(dict.fromkeys(choice for item in asked for choice in item.choices)),
        bounds=", ".join(f"{words} {values[0]:g}" for words, values in bounds.items() if values),
        example=f"{key} = {_toml(shown)}" if shown is not None else "",
        meaning=meaning,
        always=always,
        asked=tuple(asked),
    )


def _default(path: str, key: str, asked: list[Asked]) -> str:
    defaults = [item.default for item in asked]
    # A reader that tests for a key does not require it.
    if all(value is MISSING for value in defaults):
        return "required"
    settings = {item.name: item.default for item in fields(SETTINGS[path])} if path in SETTINGS else {}
    if settings.get(key) is not None:
        defaults = [list(value) if isinstance(value := settings[key], tuple) else value]
    plain = {
        _toml(_one(value))
        for value in defaults
        if value is not MISSING and isinstance(value, str | int | float | list)
    }
    return plain.pop() if len(plain) == 1 else "-"


def _one(value: Any) -> Any:
    """Return one number for a list of equal ones, such as one per joint."""
    equal = isinstance(value, list) and len(value) > 1 and all(item == value[0] for item in value)
    return value[0] if equal else value


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value, ensure_ascii=False)


def page(file: str) -> str:
    """Return the reference of one kind of file as Markdown: a table of keys for each table of the file."""
    lines: list[str] = []
    for path in dict.fromkeys(entry.path for entry in entries(file)):
        array = any(
            "array of tables" in item.kinds and _joined(item.path, item.key) == path for item in entries(file)
        )
        name = f"`[[{path}]]`" if array else f"`[{path}]`"
        lines += ["", f"### {name if path else 'The file itself'}", ""]
        lines += ["| key | type | default | meaning | example |", "|---|---|---|---|---|"]
        for entry in entries(file):
            if entry.path == path:
                lines.append(f"| {' | '.join(cells(entry))} |")
    return "\n".join(lines[1:]) + "\n"


def _joined(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def cells(entry: Entry) -> list[str]:
    """Return the cells of a key in the reference: key, type, default, meaning and example."""
    kind = (
        " or ".join(entry.kinds)
        if not entry.choices
        else ", ".join(f"`{_toml(choice)}`" for choice in entry.choices)
    )
    details = [part for part in (entry.unit, entry.bounds) if part]
    kind = f"{kind} ({', '.join(details)})" if details else kind
    default = entry.default if entry.default in ("required", "-") else f"`{entry.default}`"
    example = f"`{entry.example}`" if entry.example else ""
    return [f"`{entry.key}`", kind, default, entry.meaning, example.replace("|", r"\|")]


def json_schema(file: str) -> dict[str, Any]:
    """Return the JSON schema of one kind of file, or of "any" of them, for editors of TOML."""
    if file == "any":
        robot, experiment = json_schema("robot"), json_schema("experiment")
        return {
            "$schema": robot.pop("$schema"),
            "if": {"required": ["joint"]},
            "then": robot,
            "else": experiment,
        }
    root: dict[str, Any] = {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": f"didim {file} file",
        **_object(),
    }
    found = entries(file)
    for entry in found:
        node = _node(root, entry.path)
        if "table" in entry.kinds or "array of tables" in entry.kinds:
            inside = node["properties"].setdefault(entry.key, _object())
            if entry.key in NAMES:
                inside["additionalProperties"] = {"type": "number"}
            if "array of tables" in entry.kinds and inside.get("type") != "array":
                node["properties"][entry.key] = {"type": "array", "items": inside}
        else:
            node["properties"][entry.key] = _value(entry)
        if entry.meaning:
            node["properties"][entry.key]["description"] = entry.meaning
        if entry.default == "required" and entry.always:
            node.setdefault("required", []).append(entry.key)
    return root


def _object() -> dict[str, Any]:
    return {"type": "object", "properties": {}, "additionalProperties": False}


def _node(root: dict[str, Any], path: str) -> dict[str, Any]:
    """Return the object of a table; free names are further properties."""
    node = root
    for part in path.split(".") if path else []:
        if part == "NAME":
            if node["additionalProperties"] is False:
                node["additionalProperties"] = {**_object(), "additionalProperties": {"type": "number"}}
            node = node["additionalProperties"]
            continue
        node = node["properties"].setdefault(part, _object())
        node = node.get("items", node)
    return node


def _value(entry: Entry) -> dict[str, Any]:
    number: dict[str, Any] = {"type": "number"}
    for item in entry.asked:
        bounds = {"minimum": item.minimum, "maximum": item.maximum, "exclusiveMinimum": item.above}
        number |= {key: bound for key, bound in bounds.items() if bound is not None}
    numbers = {"type": "array", "items": {"type": "number"}}
    texts = {"type": "array", "items": {"type": "string"}}
    text = {"type": "string", **({"enum": list(entry.choices)} if entry.choices else {})}
    shapes: dict[str, list[dict[str, Any]]] = {
        "number": [number],
        "integer": [{**number, "type": "integer"}],
        "text": [text],
        "true or false": [{"type": "boolean"}],
        "list of numbers": [numbers],
        "number, or list of numbers": [number, numbers],
        "list of texts": [texts],
        "text, or list of texts": [text, texts],
        "matrix, row by row": [{"type": "array", "items": numbers}],
        "list of [start, stop]": [{"type": "array", "items": numbers}],
        "true, false, or text": [{"type": "boolean"}, text],
        "true, false, or list of joints": [{"type": "boolean"}, numbers],
        "integer, or list of integers": [{"type": "integer"}, numbers],
        'number, list of numbers, "hold" or "estimate"': [number, numbers, {"type": "string"}],
        'number, list of numbers, or "estimate"': [number, numbers, {"type": "string"}],
        "list of names, list of numbers from 1, or table of columns by joint": [
            {"type": ["array", "object"]}
        ],
    }
    found = [shape for kind in entry.kinds for shape in shapes[kind]]
    return dict(found[0]) if len(found) == 1 else {"anyOf": found}
