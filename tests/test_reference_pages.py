"""Declared keys: every key that a reader asks for has a row, every row is read, and the page of keys has it."""

from __future__ import annotations

import ast
import json
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import didim
from didim._tools.keys import declared
from didim._tools.toml import Table
from didim.cli.main import main
from didim.cli.schema import FILES, SETTINGS, SHAPES, json_schema, page
from didim.excitation.settings_file import read_excitation
from didim.monte_carlo.spec import load_study
from didim.robot.robot_file import PACKAGED
from scripts import script

PACKAGE = PACKAGED.parents[1]
SAMPLES = Path(__file__).parent / "schema"
DATA = {
    "log.csv": "t,q1,q2,v1,v2,u1,u2,e1,e2,r1,r2\n"
    + "".join(f"{0.01 * k:.2f},{k % 7},{k % 5},0,0,{k % 3},{k % 4},0,0,0,0\n" for k in range(300)),
    "q1.txt": "".join(f"{0.01 * (k % 7)}\n" for k in range(300)),
    "q2.txt": "".join(f"{0.01 * (k % 5)}\n" for k in range(300)),
    "flat.txt": "".join(f"{k % 11}\n" for k in range(1200)),
}
"""Data files that the sample files refer to."""
ARM = didim.load_robot("planar2")
READ: dict[str, Callable[[Path, Path], object]] = {
    "robot": lambda sample, _: didim.load_robot(sample),
    "experiment": lambda sample, data: didim.load_experiment(sample, data=data),
    "study": lambda sample, _: load_study(sample),
    "excitation": lambda sample, _: ARM.with_friction(**read_excitation(sample, ARM).friction),
}
READERS = [
    "robot/robot_file.py", "robot/standard_dh.py", "robot/friction.py", "robot/collision.py", "robot/correspondence.py",
    "robot/transmission.py", "robot/payload.py", "log/recording_file.py", "log/data_folder.py", "log/units.py",
    "experiment/experiment_file.py", "experiment/loop_tables.py", "experiment/unknown.py",
    "excitation/settings_file.py", "monte_carlo/spec.py",
]  # fmt: skip
METHODS = (
    "number",
    "integers",
    "integer",
    "text",
    "boolean",
    "numbers",
    "spread",
    "texts",
    "matrix",
    "table",
    "part",
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


def declared_names() -> set[str]:
    return {key for file in FILES for rows in declared(file).tables.values() for key in rows}


@pytest.mark.parametrize("module", READERS)
def test_every_key_that_a_reader_asks_for_is_declared(module: str) -> None:
    asked = set(keys_of(PACKAGE / module))
    assert asked
    assert asked <= declared_names(), f"{module}: packaged/schema lacks {sorted(asked - declared_names())}"


@pytest.mark.parametrize("file", FILES)
def test_readers_ask_for_every_declared_key(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The samples have every table."""
    for name, text in DATA.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    asked: set[tuple[str, str]] = set()
    raw, has = Table.raw, Table.has

    def noted(read: Callable[..., Any]) -> Callable[..., Any]:
        def reading(table: Table, key: str, *rest: object) -> Any:
            asked.add((table._keys.path, key))
            return read(table, key, *rest)

        return reading

    monkeypatch.setattr(Table, "raw", noted(raw))
    monkeypatch.setattr(Table, "has", noted(has))
    for sample in sorted((SAMPLES / file).glob("*.toml")):
        READ[file](sample, tmp_path)
    rows = {(path, key) for path, keys in declared(file).tables.items() for key in keys}
    assert rows - asked == set()


def test_no_reader_of_tables_is_forgotten() -> None:
    """Every module that reads tables of these files is looked at above."""
    others = {"experiment/draft.py", "robot/parameter_file.py", "robot/robot.py"}
    for folder in ("robot", "log", "experiment", "excitation", "monte_carlo"):
        for path in (PACKAGE / folder).rglob("*.py"):
            name = path.relative_to(PACKAGE).as_posix()
            if name not in others and "Table" in path.read_text(encoding="utf-8"):
                found = set(keys_of(path))
                assert not found or name in READERS, name


@pytest.mark.parametrize("file", FILES)
def test_every_key_has_a_type_and_a_sentence(file: str) -> None:
    for rows in declared(file).tables.values():
        for key in rows.values():
            assert key.meaning.endswith("."), key.name
            assert key.type in SHAPES or key.type in ("table", "array of tables"), key.name


def test_the_page_of_keys_has_every_table(project: Path) -> None:
    hook = script(project / "docs" / "hooks" / "keys.py")
    text = (project / "docs" / hook.PAGE).read_text(encoding="utf-8")
    made = hook.on_page_markdown(text, page=SimpleNamespace(file=SimpleNamespace(src_uri=hook.PAGE)))
    assert all(f"## The {file} file\n\n{page(file)}" in made for file in FILES)
    other = SimpleNamespace(file=SimpleNamespace(src_uri="index.md"))
    assert hook.on_page_markdown(text, page=other) == text


def test_the_schema_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    printed = capsys.readouterr().out
    assert printed == "\n".join(f"## The {file} file\n\n{page(file)}" for file in FILES)
    assert main(["schema", "robot"]) == 0
    assert capsys.readouterr().out == f"## The robot file\n\n{page('robot')}"
    assert main(["schema", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["$schema"] == json_schema("robot")["$schema"]
    for file in ("robot", "study", "experiment"):
        assert found["then"] == json_schema(file)
        found = found["else"]
    assert found == json_schema("excitation")
    assert main(["schema", "experiment", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json_schema("experiment")


def test_keys_of_settings_are_their_fields() -> None:
    """The defaults of these tables are those of the classes."""
    for table, settings in SETTINGS.items():
        file = "excitation" if table == "excitation" else "experiment"
        names = {item.name for item in fields(settings)}
        keys = declared(file, table).rows
        assert file == "excitation" or keys.keys() <= names
        assert all(key.default is None for name, key in keys.items() if name in names - {"prior"})


def test_rows_of_other_tables_and_of_several_units() -> None:
    experiment = declared("experiment").tables
    assert experiment["friction"] == declared("robot").tables["friction"]
    assert (
        experiment["recording.position"]["counts_per_rev"]
        == experiment["recording.reference"]["counts_per_rev"]
    )
    speeds = {key: row.unit for key, row in experiment["reference"].items() if key.startswith("max_velocity")}
    assert speeds == {f"max_velocity_{unit}_s": f"{unit}/s" for unit in ("rad", "deg", "m", "mm")}


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
    paths = [*(SAMPLES / file).glob("*.toml")]
    if file in ("robot", "experiment"):
        paths += (PACKAGED.parent / f"{file}s").glob("*.toml")
    marks = {"experiment": "[[recording]]", "study": "[repeat]"}
    if file in marks:
        paths += [path for path in (project / "examples").glob("*.toml") if marks[file] in path.read_text()]
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
