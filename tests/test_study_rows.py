"""Rows of studies as JSON lines: torn lines, duplicates, locks."""

from __future__ import annotations

import json
import os
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from didim.errors import StudyError
from didim.monte_carlo.results import StudyResults
from didim.monte_carlo.rows import RowFile, read_rows, times_path
from didim.monte_carlo.worker import sealed

FIT = {"beta": [1.0], "std": [0.1], "factor": 2.0, "torque_error": None, "simulations": 0}


def row(name: str, **more: Any) -> dict[str, Any]:
    head = {"id": name, "scenario": "s", "method": "m", "seed": 0, "status": "SOLVED"}
    return head | ({"sentence": "the worker died"} if more.get("status") == "LOST" else FIT) | more


def truth(name: str, **more: Any) -> dict[str, Any]:
    own: dict[str, Any] = {"method": None, "seed": None, "status": "TRUTH", "truth": [1.0, None], "keys": {}}
    return {"id": name, "scenario": "s"} | own | more


def without(count: int) -> str:
    """Remark on rows of version 0.2.0."""
    rows = "1 row" if count == 1 else f"{count} rows"
    return f"rows.jsonl: {rows} without a digest, as before version 0.3.0: changes would not be seen"


def write(path: Path, *rows: dict[str, Any], end: str = "") -> Path:
    path.write_text("".join(json.dumps(item) + "\n" for item in rows) + end)
    return path


def test_an_unfinished_line_is_cut_off_before_more_is_appended(tmp_path: Path) -> None:
    path = write(tmp_path / "rows.jsonl", sealed(row("a")), end='{"id": "b", "scen')
    before = path.read_text()
    with closing(RowFile(path)) as file:
        assert path.read_text() == before
        file.append(json.dumps(sealed(row("b"))))
    rows = read_rows(path)
    assert list(rows.fits) == ["a", "b"]
    assert rows.remarks == ()


@pytest.mark.parametrize("size", [10, 65_536, 200_000])
def test_an_unfinished_line_of_any_length_is_cut_off(tmp_path: Path, size: int) -> None:
    for start in ("", json.dumps(row("a")) + "\n"):
        path = tmp_path / "rows.jsonl"
        path.write_text(start + '{"id":' + "x" * size)
        with closing(RowFile(path)) as file:
            file.append("next")
        assert path.read_text() == start + "next\n"


@pytest.mark.parametrize("content", ["notes\nof mine", "schema = 1\n", "[1]\n", '{"name": 1}\n', "\0"])
def test_a_file_of_something_else_is_left_as_it_is(tmp_path: Path, content: str) -> None:
    path = tmp_path / "notes.txt"
    path.write_text(content)
    with pytest.raises(StudyError, match=r"notes[.]txt: this file holds no rows of a study"):
        RowFile(path)
    assert path.read_text() == content


def test_a_row_is_looked_for_in_the_first_64_megabytes(tmp_path: Path) -> None:
    """The hole of a sparse file has no end that could be waited for."""
    path = tmp_path / "rows.jsonl"
    path.touch()
    os.truncate(path, 1 << 42)
    with pytest.raises(StudyError, match="holds no rows of a study"):
        RowFile(path)
    path.write_text("damaged\n" + json.dumps(row("a")) + "\n")
    RowFile(path).close()


def test_rows_are_not_appended_to_a_device() -> None:
    with pytest.raises(StudyError, match="/dev/null: rows are appended to a file"):
        RowFile(Path("/dev/null"))


def test_a_damaged_or_edited_row_is_dropped_and_named(tmp_path: Path) -> None:
    lines = [json.dumps(sealed(item)) for item in (truth("t"), row("a"), row("b"), row("c"))]
    lines[1] = lines[1].replace('"beta": [1.0]', '"beta": [1.5]')
    lines[2] = lines[2][:-1]
    lines[3] = lines[3].replace('"beta": [1.0]', '"beta": [NaN]')
    path = tmp_path / "rows.jsonl"
    path.write_text("\n".join(lines) + "\n")
    rows = read_rows(path)
    assert not rows.fits
    assert rows.done == {"t"}
    assert rows.remarks == (
        "rows.jsonl: line 3 is no row (unfinished or damaged), dropped",
        "rows.jsonl: lines 2, 4 are not as written (digests differ), dropped",
    )


def test_a_digest_does_not_depend_on_how_a_row_is_written(tmp_path: Path) -> None:
    item = sealed(row("a"))
    path = tmp_path / "rows.jsonl"
    path.write_text(json.dumps(dict(sorted(item.items())), separators=(" , ", " : ")) + "\n")
    assert read_rows(path).remarks == ()


def test_a_truth_that_was_damaged_leaves_its_runs_out_with_a_sentence(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    damaged = json.dumps(sealed(truth("t")))[1:]
    path.write_text("\n".join([damaged, *(json.dumps(sealed(row(name))) for name in "ab")]) + "\n")
    found = StudyResults.read(path)
    assert found.rows.remarks == ("rows.jsonl: line 1 is no row (unfinished or damaged), dropped",)
    assert "1 scenario without the row of the truth: s; 2 runs not in this table" in str(found)


def test_torn_lines_are_dropped_with_a_remark(tmp_path: Path) -> None:
    # The end of one file and the beginning of the next, as cat joins them.
    path = write(
        tmp_path / "rows.jsonl", row("a"), end='{"id": "b", "scen' + json.dumps(row("c")) + "\n[1]\n\n"
    )
    rows = read_rows(path)
    assert list(rows.fits) == ["a"]
    assert rows.remarks == ("rows.jsonl: lines 2, 3 are no row (unfinished or damaged), dropped", without(1))


def test_merged_files_count_each_row_once(tmp_path: Path) -> None:
    first = write(tmp_path / "one.jsonl", *map(sealed, (row("a"), row("b", status="LOST"))))
    more = (row("b"), row("a"), row("b", status="LOST"), row("c", status="LOST"))
    second = write(tmp_path / "two.jsonl", *map(sealed, more))
    rows = read_rows(first, second)
    assert {key: item["status"] for key, item in rows.fits.items()} == {
        "a": "SOLVED",
        "b": "SOLVED",
        "c": "LOST",
    }
    assert rows.done == {"a", "b"}
    assert rows.remarks == ()
    other = write(tmp_path / "three.jsonl", sealed(row("a", beta=[2.0])))
    assert read_rows(first, other).remarks == (
        "three.jsonl: 1 row differ from earlier ones of the same task, which count",
    )


def test_truths_and_times_are_kept_apart(tmp_path: Path) -> None:
    path = write(tmp_path / "rows.jsonl", row("a"), truth("t"))
    write(times_path(path), {"id": "a", "seconds": 2.0})
    rows = read_rows(path)
    assert list(rows.fits) == ["a"]
    assert rows.truths["s"]["truth"] == [1.0, None]
    assert rows.times["a"]["seconds"] == 2.0
    assert rows.done == {"a", "t"}


def test_two_studies_cannot_write_to_one_file(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    path = tmp_path / "rows.jsonl"
    with closing(RowFile(path)), pytest.raises(StudyError, match="another process writes to this file"):
        RowFile(path)
    RowFile(path).close()


def test_a_line_that_does_not_fit_on_the_disk_is_taken_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rows.jsonl"
    whole = os.write
    with closing(RowFile(path)) as file:
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


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        *((row("b", **{key: 0.5}), f"'{key}' of a row must be text") for key in ("id", "scenario", "status")),
        *((row("b", method=value), "'method' of a row must be text or null") for value in (0.5, True, ["a"])),
        *((row("b", seed=value), "'seed' of a row must be a whole number") for value in ("1", 0.5, -1, True)),
        (row("b", seed=None), "'seed' of a row must be a whole number, got null"),
        (row("b", status="SOLVED?"), "'status' of a row is unknown, got \"SOLVED\\?\""),
        (row("b", status="TRUTH"), "'status' of a row is unknown"),
        (truth("b", status="SOLVED"), "'status' of a row is unknown"),
        (row("b", status="LOST", sentence=1.0), "'sentence' of a row must be text, got 1.0"),
        *(
            (row("b", beta=value), "'beta' of a row must be a list of numbers")
            for value in (1.0, ["a"], [[1.0]], [True], [10**400], [float("nan")], {"a": 1.0})
        ),
        (row("b", beta=[1.0, 2.0]), "'std' of a row must have a value for each of 'beta', got 1 for 2"),
        (row("b", torque_error="0.1"), "'torque_error' of a row must be a number or null, got \"0.1\""),
        (row("b", factor=[2.0]), "'factor' of a row must be a number or null"),
        (row("b", simulations=0.5), "'simulations' of a row must be a whole number"),
        (truth("b", truth=["a" * 5000]), "'truth' of a row must be a list of numbers, got .{40}[.]{3}$"),
        (truth("b", keys=[]), "'keys' of a row must be a table"),
    ],
)
def test_a_damaged_row_is_one_sentence_with_file_line_and_key(
    tmp_path: Path, wrong: dict[str, Any], sentence: str
) -> None:
    path = write(tmp_path / "rows.jsonl", row("a"), wrong)
    with pytest.raises(StudyError, match=f"^rows.jsonl: line 2: {sentence}"):
        StudyResults.read(path)


@pytest.mark.parametrize("key", ["seed", "status", *FIT])
def test_a_row_without_a_key_is_refused(tmp_path: Path, key: str) -> None:
    wrong = row("b")
    del wrong[key]
    with pytest.raises(StudyError, match=f"line 1: a row of a study has the key '{key}'"):
        read_rows(write(tmp_path / "rows.jsonl", wrong))


@pytest.mark.parametrize("value", ["1", None, [1.0], 10**400])
def test_damaged_times_are_refused(tmp_path: Path, value: object) -> None:
    path = write(tmp_path / "rows.jsonl", row("a"))
    write(times_path(path), {"id": "a", "seconds": 2.0}, {"id": "b", "seconds": value})
    with pytest.raises(
        StudyError, match=r"^rows[.]times[.]jsonl: line 2: 'seconds' of a row must be a number"
    ):
        read_rows(path)


def test_brackets_within_brackets_are_an_unfinished_line(tmp_path: Path) -> None:
    path = write(tmp_path / "rows.jsonl", row("a"), end="[" * 100_000 + "\n")
    assert read_rows(path).remarks == (
        "rows.jsonl: line 2 is no row (unfinished or damaged), dropped",
        without(1),
    )


@pytest.mark.filterwarnings("error")
def test_numbers_whose_squares_are_infinite_have_figures_without_a_warning(tmp_path: Path) -> None:
    rows = [row(str(k), seed=k, beta=[1e300 * k], std=[1e-300]) for k in range(3)]
    found = StudyResults.read(write(tmp_path / "rows.jsonl", truth("t", truth=[0.0]), *rows))
    assert found.figures[0].runs == 3
    assert str(found)


def test_times_stand_beside_their_rows(tmp_path: Path) -> None:
    assert times_path(tmp_path / "rows.csv") == tmp_path / "rows.times.csv"
    assert times_path(tmp_path / "rows") == tmp_path / "rows.times.jsonl"
    assert times_path(Path()) == Path(".times.jsonl")  # a folder, which is refused as an output
