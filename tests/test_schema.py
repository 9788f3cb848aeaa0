"""Strict TOML tables: values come out typed, and every fault is one sentence with file, table and key."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from didim._tools.keys import Keys
from didim._tools.toml import Table, read_toml
from didim.errors import ExperimentError, RobotError
from tables import row


def table(**content: Any) -> Table:
    return Table({"signal": content}, "emps.toml", ExperimentError).table("signal")


def test_values_come_out_typed() -> None:
    found = table(n=3, x=2, name="a", flag=True, list=[1, 2.5], words=["u", "v"], m=[[1, 0], [0, 1]])
    assert found.integer("n") == 3
    assert isinstance(found.number("x"), float)
    assert found.text("name") == "a"
    assert found.boolean("flag") is True
    assert found.numbers("list", 2) == [1.0, 2.5]
    assert found.spread("x", 3) == [2.0, 2.0, 2.0]
    assert found.spread("list", 2) == [1.0, 2.5]
    assert found.texts("words") == ["u", "v"]
    assert found.matrix("m", 2, 2) == [[1.0, 0.0], [0.0, 1.0]]
    found.done()


ROWS = (
    row("x_hz", "number", above=0.0),
    row("n", "integer", minimum=1, maximum=9),
    row("kind", "text", default="a", choices=["a", "b"]),
    row("flag", "true or false"),
    row("gains", "number, or list of numbers", minimum=0.0, default=1.0),
    row("words", "list of texts"),
    row("factors", "integer, or list of integers"),
)


def declared_table(**content: Any) -> Table:
    return Table(
        content, "emps.toml", ExperimentError, "signal", Keys({"file": {key.name: key for key in ROWS}})
    )


def test_declared_keys_are_read_by_their_types() -> None:
    content = {"x_hz": 2, "n": 3, "kind": "b", "flag": False, "words": ["v"], "factors": [5, 10]}
    found = declared_table(**content)
    assert found.given() == content
    found.done()
    assert declared_table(n=3).given() == {"n": 3}
    assert declared_table(factors=7).given() == {"factors": [7]}
    assert declared_table().text("kind") == "a"
    assert declared_table().spread("gains", 2) == [1.0, 1.0]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"x_hz": 0}, r"\[signal\] x_hz must be above 0.0, got 0.0"),
        ({"n": 10}, "n must be at most 9, got 10"),
        ({"kind": "c"}, "kind must be one of 'a', 'b', got 'c'"),
        ({"flag": 1}, "flag must be true or false, got 1"),
        ({"gains": -1}, "gains must be at least 0.0, got -1.0"),
        ({"gains": [1, -1]}, "gains number 2 must be at least 0.0, got -1.0"),
        ({"factors": [5, 2.5]}, "factors must be a list of integers, got"),
    ],
)
def test_declared_keys_have_their_bounds(content: dict[str, Any], message: str) -> None:
    found = declared_table(**content)
    with pytest.raises(ExperimentError, match=message):
        found.spread("gains", 2) if "gains" in content else found.given()


def test_errors_of_what_a_table_makes_are_those_of_the_table() -> None:
    assert table().checked(lambda: 3) == 3

    def refused() -> None:
        raise RobotError("no")

    with pytest.raises(ExperimentError, match=r"^emps\.toml: \[signal\] no$"):
        table().checked(refused)


def test_defaults_stand_for_absent_keys_only() -> None:
    found = table()
    assert found.number("x", 1.5) == 1.5
    assert found.number("x", None) is None
    assert found.integer("n", 2) == 2
    assert found.text("name", "a") == "a"
    assert found.boolean("flag", False) is False
    assert found.numbers("list", 2, None) is None
    assert found.spread("list", 2, None) is None
    assert found.matrix("m", 1, 1, None) is None
    assert found.table("t", None) is None
    assert found.tables("ts", None) is None
    assert not found.has("x")
    found.done()


@pytest.mark.parametrize(
    ("ask", "content", "message"),
    [
        (lambda t: t.number("x"), {}, "key 'x' is missing"),
        (lambda t: t.number("cutoff_hz"), {"cutof_hz": 1}, "key 'cutoff_hz' is missing; is 'cutof_hz' meant to be it?"),
        (lambda t: t.number("x"), {"x": True}, "x must be a finite number, got True"),
        (lambda t: t.number("x"), {"x": float("nan")}, "x must be a finite number, got nan"),
        (lambda t: t.integer("n"), {"n": 3.0}, "n must be an integer, got 3.0"),
        (lambda t: t.text("s"), {"s": 1}, "s must be a text, got 1"),
        (lambda t: t.boolean("b"), {"b": 1}, "b must be true or false, got 1"),
        (lambda t: t.numbers("l"), {"l": 1}, "l must be a list of numbers, got 1"),
        (lambda t: t.numbers("l", 3), {"l": [1, 2]}, "l must hold 3 numbers, got 2"),
        (lambda t: t.numbers("l"), {"l": [1, "a"]}, "l number 2 must be a finite number, got 'a'"),
        (lambda t: t.texts("l"), {"l": ["a", 1]}, "l must be a list of texts, got ['a', 1]"),
        (lambda t: t.matrix("m", 2, 2), {"m": [[1, 2]]}, "m must be a matrix of 2 rows and 2 columns, got 1 row"),
        (lambda t: t.matrix("m", 1, 2), {"m": [[1]]}, "m, row 1, must hold 2 numbers, got 1"),
        (lambda t: t.numbers("l", 1), {"l": []}, "l must hold 1 number, got 0"),
        (lambda t: t.table("t"), {"t": 1}, "t must be a table, got 1"),
        (lambda t: t.tables("t"), {"t": {}}, "t must be an array of tables, [[t]]"),
        (lambda t: t.done(), {"zeal": 1}, "unknown key 'zeal'"),
    ],
)  # fmt: skip
def test_messages(ask: Callable[[Table], object], content: dict[str, Any], message: str) -> None:
    with pytest.raises(ExperimentError) as caught:
        ask(table(**content))
    assert str(caught.value) == f"emps.toml: [signal] {message}"


def test_an_unknown_key_gets_a_suggestion() -> None:
    found = table(cutof_hz=100)
    found.number("cutoff_hz", None)
    with pytest.raises(ExperimentError) as caught:
        found.done()
    expected = "emps.toml: [signal] unknown key 'cutof_hz'; did you mean 'cutoff_hz'?"
    assert str(caught.value) == expected


def test_an_unknown_key_like_no_other_gets_the_list() -> None:
    found = table(zeal=1, order=4)
    found.integer("order")
    found.number("cutoff_hz", None)
    with pytest.raises(ExperimentError) as caught:
        found.done()
    assert str(caught.value) == "emps.toml: [signal] unknown key 'zeal'; known here are 'order', 'cutoff_hz'"


def test_tables_of_an_array_are_numbered_when_there_are_several() -> None:
    top = Table({"joint": [{"a": 1}, {"b": 2}], "one": [{"c": 3}]}, "r.toml", RobotError)
    with pytest.raises(RobotError, match=r"^r\.toml: \[joint 2\] unknown key 'b'$"):
        top.tables("joint")[1].done()
    with pytest.raises(RobotError, match=r"^r\.toml: \[one\] unknown key 'c'$"):
        top.tables("one")[0].done()
    with pytest.raises(RobotError, match=r"^r\.toml: key 'name' is missing$"):
        top.text("name")


def test_files_that_are_no_toml(tmp_path: Path) -> None:
    with pytest.raises(ExperimentError, match=r"none\.toml: no such file$"):
        read_toml(tmp_path / "none.toml", ExperimentError)
    bad = tmp_path / "bad.toml"
    bad.write_text("a = 1\nb 2\n", encoding="utf-8")
    with pytest.raises(RobotError, match=r"^bad\.toml: not valid TOML, .*line 2"):
        read_toml(bad, RobotError)
    bad.write_bytes(b"a = '\xff'")
    with pytest.raises(RobotError, match=r"^bad\.toml: not a TOML file, byte 5 is not UTF-8$"):
        read_toml(bad, RobotError)
    mark = tmp_path / "mark.toml"
    mark.write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert read_toml(mark, RobotError) == {"a": 1}
    data = tmp_path / "data.csv"
    data.write_text("a,b\n", encoding="utf-8")
    with pytest.raises(
        RobotError, match=r"^data\.csv: not valid TOML, .*; a file of this kind ends in \.toml$"
    ):
        read_toml(data, RobotError)
    with pytest.raises(RobotError, match=r"/bad: no such file; did you mean 'bad\.toml'\?$"):
        read_toml(tmp_path / "bad", RobotError)
    with pytest.raises(RobotError, match="cannot be read"):
        read_toml(tmp_path, RobotError)
