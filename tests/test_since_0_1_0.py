"""The program that compares with version 0.1.0: every row holds in the present version, and the table says what does not."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import didim

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benches"))
import since_0_1_0
from since_logs import write_logs
from since_rows import ROWS

pytestmark = pytest.mark.tools


def test_every_row_holds_now(tmp_path: Path) -> None:
    write_logs(tmp_path)
    package = Path(didim.__file__).resolve().parent.parent
    now = since_0_1_0.measure(package, tmp_path, tmp_path / "absent", [])
    assert {
        row.what: now[str(index)] for index, row in enumerate(ROWS) if not row.holds(now[str(index)])
    } == {}
    assert len(str(now["names"]).split()) == 60
    # Beside itself no row shows a difference.
    _, wrong = since_0_1_0.table(list(range(len(ROWS))), now, now)
    assert len(wrong) == len(ROWS)
    assert all("held in 0.1.0 already" in text for text in wrong)


def test_what_does_not_hold_is_told() -> None:
    assert not ROWS[0].holds("refused")
    assert not ROWS[6].holds("a result of 0 rows")
    old, now = {"0": 40.0, "names": "A B"}, {"0": 5.0, "names": "A C"}
    lines, wrong = since_0_1_0.table([0], old, now)  # type: ignore[arg-type]
    assert lines[2] == f"| 1 | {ROWS[0].what} | 40 sigma | 5 sigma | 3 sigma |"
    assert lines[3].endswith("| different | equal |")
    assert len(wrong) == 2
    assert since_0_1_0.table([0], now | {"0": 40.0}, now | {"0": 1.0})[1] == []  # type: ignore[arg-type]


def test_another_package_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="the package was taken from"):
        since_0_1_0.measure(tmp_path, tmp_path, tmp_path, [23])
