"""The reference of robot and experiment files: every key that a reader asks for, with a sentence, and a page that is current."""

from __future__ import annotations

import ast
import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

import didim
from didim.cli.main import main
from didim.experiment.schema import FILES, SAMPLES, entries, json_schema
from didim.regression.settings import LeastSquaresSettings
from didim.robot.robot_file import PACKAGED
from didim.signal.processing import SignalProcessing

PACKAGE = PACKAGED.parents[1]
READERS = [
    "robot/robot_file.py", "robot/standard_dh.py", "robot/friction.py", "robot/collision.py", "robot/correspondence.py",
    "robot/transmission.py", "robot/payload.py", "log/recording_file.py", "log/data_folder.py", "log/units.py",
    "experiment/experiment_file.py", "experiment/loop_tables.py", "experiment/unknown.py",
]  # fmt: skip
METHODS = (
    "number",
    "integer",
    "text",
    "boolean",
    "numbers",
    "spread",
    "texts",
    "matrix",
    "table",
    "tables",
    "raw",
    "has",
)


def keys_of(path: Path) -> Iterator[str]:
    """Keys that a reader asks for by a literal."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in METHODS
            and node.args
            and isinstance(node.args[0], ast.Constant)
            and isinstance(node.args[0].value, str)
        ):
            yield node.args[0].value


def known() -> set[str]:
    return {entry.key for file in FILES for entry in entries(file)}


@pytest.mark.parametrize("module", READERS)
def test_every_key_that_a_reader_asks_for_is_in_the_schema(module: str) -> None:
    asked = set(keys_of(PACKAGE / module))
    assert asked
    assert asked <= known(), f"{module}: no sample of packaged/schema has {sorted(asked - known())}"


def test_no_reader_of_tables_is_forgotten() -> None:
    """Every module that reads tables of these files is looked at above."""
    others = {"experiment/draft.py", "experiment/schema.py", "robot/parameter_file.py", "robot/robot.py"}
    for folder in ("robot", "log", "experiment"):
        for path in (PACKAGE / folder).rglob("*.py"):
            name = path.relative_to(PACKAGE).as_posix()
            if name not in others and "Table" in path.read_text(encoding="utf-8"):
                found = set(keys_of(path))
                assert not found or name in READERS, name


@pytest.mark.parametrize("file", FILES)
def test_every_key_has_a_sentence_and_no_sentence_is_left_over(file: str) -> None:
    found = {(entry.path or "file", entry.key): entry.meaning for entry in entries(file)}
    assert [place for place, meaning in found.items() if not meaning] == []
    written = tomllib.loads((SAMPLES / "keys.toml").read_text(encoding="utf-8"))[file]
    assert {(path, key) for path, keys in written.items() for key in keys} <= found.keys()


@pytest.mark.parametrize("file", FILES)
def test_the_page_is_current(project: Path, file: str) -> None:
    """Else run ``python benches/reference_pages.py``."""
    import sys

    sys.path.insert(0, str(project / "benches"))
    try:
        from reference_pages import PAGES, text
    finally:
        sys.path.pop(0)
    now = PAGES[file].read_text(encoding="utf-8")
    assert now == text(file, now)


def test_the_schema_is_printed(capsys: pytest.CaptureFixture[str], project: Path) -> None:
    pages = [(project / "docs" / f"{file}_keys.md").read_text(encoding="utf-8") for file in FILES]
    assert main(["schema"]) == 0
    printed = capsys.readouterr().out
    robot, title, experiment = printed.partition("## The experiment file")
    assert robot.rstrip("\n") + "\n" in pages[0]
    assert title + experiment in pages[1]
    assert main(["schema", "robot"]) == 0
    assert capsys.readouterr().out == printed.split("## The experiment file")[0].rstrip("\n") + "\n"
    assert main(["schema", "--json"]) == 0
    both = json.loads(capsys.readouterr().out)
    assert (both["then"]["title"], both["else"]["title"]) == ("didim robot file", "didim experiment file")
    assert main(["schema", "experiment", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json_schema("experiment")


def test_types_bounds_and_defaults_are_those_of_the_readers() -> None:
    found = {(entry.path, entry.key): entry for entry in entries("experiment")}
    assert found["recording", "role"].choices == ("fit", "held-out")
    assert found["recording", "role"].default == '"fit"'
    assert found["signal", "cutoff_hz"].bounds == "above 0"
    assert found["signal", "cutoff_hz"].unit == "Hz"
    assert found["controller", "delay_samples"].bounds == "at least 0, at most 1000"
    assert found["recording.position", "file"].default == "required"
    assert found["recording.time", "resample"].default == "false"
    for table, settings in (("signal", SignalProcessing), ("least_squares", LeastSquaresSettings)):
        names = {item.name for item in fields(settings)}
        keys = {key for path, key in found if path == table}
        assert keys <= names


def fits(value: Any, schema: Mapping[str, Any]) -> bool:
    """Whether a value is as the schema says: the part of JSON schema that is used."""
    if "anyOf" in schema:
        return any(fits(value, one) for one in schema["anyOf"])
    kinds: dict[str, Any] = {
        "object": dict,
        "array": list,
        "string": str,
        "boolean": bool,
        "integer": int,
        "number": (int, float),
    }
    wanted = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    if not any(
        isinstance(value, kinds[kind]) and (kind == "boolean") == isinstance(value, bool) for kind in wanted
    ):
        return False
    if isinstance(value, dict):
        others = schema.get("additionalProperties", True)
        return all(key in value for key in schema.get("required", ())) and all(
            fits(item, schema["properties"][key])
            if key in schema.get("properties", {})
            else others is True or (others is not False and fits(item, others))
            for key, item in value.items()
        )
    if isinstance(value, list):
        return all(fits(item, schema["items"]) for item in value) if "items" in schema else True
    if isinstance(value, str):
        return value in schema.get("enum", [value])
    return not (
        value < schema.get("minimum", value) or value > schema.get("maximum", value)
    ) and value > schema.get("exclusiveMinimum", value - 1)


@pytest.mark.parametrize("file", FILES)
def test_json_schemas_take_what_the_readers_take(file: str, project: Path) -> None:
    schema = json_schema(file)
    folder = "robots" if file == "robot" else "experiments"
    paths = [*(SAMPLES / file).glob("*.toml"), *(PACKAGED.parent / folder).glob("*.toml")]
    if file == "experiment":
        paths += [
            path
            for path in (project / "examples").glob("*.toml")
            if "recording" in path.read_text() and "scenario" not in path.read_text()
        ]
    for path in paths:
        assert fits(tomllib.loads(path.read_text(encoding="utf-8")), schema), path.name


def test_json_schemas_refuse_what_the_readers_refuse() -> None:
    schema = json_schema("experiment")
    good = tomllib.loads((SAMPLES / "experiment" / "recorded.toml").read_text(encoding="utf-8"))
    assert fits(good, schema)
    changes: list[dict[str, Any]] = [
        {"signl": {}},
        {"signal": {"cutoff_hz": 0}},
        {"signal": {"cutof_hz": 10}},
        {"least_squares": {"variance": "r"}},
        {"recording": [{"position": {"file": "a.csv"}}]},
        {"schema": "1"},
    ]
    for change in changes:
        assert not fits({**good, **change}, schema), change


def test_samples_are_real_files() -> None:
    """They load; so do the examples in the page, which are taken from them."""
    assert didim.load_robot(SAMPLES / "robot" / "standard.toml").standard is not None
    assert all(
        entry.example or "table" in " ".join(entry.kinds) or entry.path
        for file in FILES
        for entry in entries(file)
    )
