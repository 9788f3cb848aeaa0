"""Rows of studies as JSON lines: torn lines, duplicates, locks."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from didim.errors import StudyError
from didim.monte_carlo.rows import RowFile, read_rows, times_path


def row(name: str, **more: Any) -> dict[str, Any]:
    return {"id": name, "scenario": "s", "method": "m", "seed": 0, "status": "SOLVED"} | more


def write(path: Path, *rows: dict[str, Any], end: str = "") -> Path:
    path.write_text("".join(json.dumps(item) + "\n" for item in rows) + end)
    return path


def test_an_unfinished_line_is_cut_off_before_more_is_appended(tmp_path: Path) -> None:
    path = write(tmp_path / "rows.jsonl", row("a"), end='{"id": "b", "scen')
    with RowFile(path) as file:
        assert path.read_text() == json.dumps(row("a")) + "\n"
        file.append(json.dumps(row("b")))
    rows = read_rows(path)
    assert list(rows.fits) == ["a", "b"]
    assert rows.remarks == ()


@pytest.mark.parametrize("size", [10, 65_536, 200_000])
def test_an_unfinished_line_of_any_length_is_cut_off(tmp_path: Path, size: int) -> None:
    for start in ("", "first\n"):
        path = tmp_path / "rows.jsonl"
        path.write_text(start + "x" * size)
        RowFile(path).close()
        assert path.read_text() == start


def test_torn_lines_are_dropped_with_a_remark(tmp_path: Path) -> None:
    # The end of one file and the beginning of the next, as cat joins them.
    path = write(
        tmp_path / "rows.jsonl", row("a"), end='{"id": "b", "scen' + json.dumps(row("c")) + "\n[1]\n\n"
    )
    rows = read_rows(path)
    assert list(rows.fits) == ["a"]
    assert rows.remarks == ("rows.jsonl: 2 unfinished lines dropped",)


def test_merged_files_count_each_row_once(tmp_path: Path) -> None:
    first = write(tmp_path / "one.jsonl", row("a"), row("b", status="LOST"))
    second = write(
        tmp_path / "two.jsonl", row("b"), row("a"), row("b", status="LOST"), row("c", status="LOST")
    )
    rows = read_rows(first, second)
    assert {key: item["status"] for key, item in rows.fits.items()} == {
        "a": "SOLVED",
        "b": "SOLVED",
        "c": "LOST",
    }
    assert rows.done == {"a", "b"}
    assert rows.remarks == ()
    other = write(tmp_path / "three.jsonl", row("a", beta=[1.0]))
    assert read_rows(first, other).remarks == (
        "three.jsonl: 1 row differ from earlier ones of the same task, which count",
    )


def test_truths_and_times_are_kept_apart(tmp_path: Path) -> None:
    path = write(
        tmp_path / "rows.jsonl", row("a"), row("t", method=None, seed=None, status="TRUTH", truth=[1.0])
    )
    write(times_path(path), {"id": "a", "seconds": 2.0})
    rows = read_rows(path)
    assert list(rows.fits) == ["a"]
    assert rows.truths["s"]["truth"] == [1.0]
    assert rows.times["a"]["seconds"] == 2.0
    assert rows.done == {"a", "t"}


def test_two_studies_cannot_write_to_one_file(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    path = tmp_path / "rows.jsonl"
    with RowFile(path), pytest.raises(StudyError, match="another process writes to this file"):
        RowFile(path)
    RowFile(path).close()


def test_a_line_that_does_not_fit_on_the_disk_is_taken_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rows.jsonl"
    whole = os.write
    with RowFile(path) as file:
        file.append("first")
        monkeypatch.setattr(os, "write", lambda handle, data: whole(handle, data[:3]))
        with pytest.raises(OSError, match="No space left"):
            file.append("second")
        monkeypatch.undo()
        file.append("third")
    assert path.read_text() == "first\nthird\n"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [('{"id": "a"}\n', "a row of a study has the key 'scenario'"), (None, "cannot be read")],
)
def test_files_of_something_else_are_refused(tmp_path: Path, content: str | None, sentence: str) -> None:
    path = tmp_path / "rows.jsonl"
    if content is not None:
        path.write_text(content)
    with pytest.raises(StudyError, match=sentence):
        read_rows(path)


@pytest.mark.parametrize("key", ["id", "scenario", "status", "method"])
@pytest.mark.parametrize("value", [0.5, ["a"], {"a": 1}])
def test_a_row_whose_texts_are_something_else_is_refused(tmp_path: Path, key: str, value: object) -> None:
    path = write(tmp_path / "rows.jsonl", row("a", **{key: value}))
    with pytest.raises(StudyError, match=f"'{key}' of a row must be text"):
        read_rows(path)
