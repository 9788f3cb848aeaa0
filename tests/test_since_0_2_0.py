"""The program that compares with version 0.2.0: rows that are quick hold in the present version, and open rows are called open."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import didim

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benches"))
import since_0_2_0
from since_0_2_0 import ROWS

pytestmark = pytest.mark.tools

QUICK = (
    "snap 0",
    "load friction",
    "friction picture",
    "never change",
    "position limits",
    "standard names",
    "gravity compensation",
)
"""Words of the rows that take less than a second each."""


def test_rows_that_are_quick_hold_now(tmp_path: Path) -> None:
    chosen = [index for index, row in enumerate(ROWS) if any(word in row.what for word in QUICK)]
    assert len(chosen) == len(QUICK)
    package = Path(didim.__file__).resolve().parent.parent
    now = since_0_2_0.measure(package, tmp_path, chosen)
    assert {
        ROWS[index].what: now[str(index)] for index in chosen if not ROWS[index].settled(now[str(index)])
    } == {}
    # Beside itself no row shows a difference.
    _, wrong = since_0_2_0.table(chosen, now, now)
    assert len(wrong) == len(chosen)
    assert all("settled in 0.2.0 already" in text for text in wrong)


def test_what_is_not_settled_is_called_open() -> None:
    lines, wrong = since_0_2_0.table([0], {"0": "6 of 6 destroyed"}, {"0": "1 of 6 destroyed"})
    assert lines[2] == f"| {ROWS[0].what} | 6 of 6 destroyed | 1 of 6 destroyed | open |"
    assert wrong == [f"{ROWS[0].what}: open: 1 of 6 destroyed"]
    lines, wrong = since_0_2_0.table([0], {"0": "6 of 6 destroyed"}, {"0": "0 of 6 destroyed"})
    assert lines[2].endswith("| settled |")
    assert wrong == []


def test_the_page_has_a_line_for_every_row(project: Path) -> None:
    text = (project / "docs" / "since_0_2_0.md").read_text(encoding="utf-8")
    lines = text[text.index(since_0_2_0.HEAD) :].strip().splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    assert [row[0] for row in cells] == [row.what for row in ROWS]
    for row, (_, before, after, word) in zip(ROWS, cells, strict=True):
        assert not row.settled(before), row.what
        assert word == ("settled" if row.settled(after) else "open"), row.what


def test_another_package_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="the package was taken from"):
        since_0_2_0.measure(tmp_path, tmp_path, [25])
