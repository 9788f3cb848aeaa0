"""How much of the package a run enters: numbers that only fall."""

from __future__ import annotations

from pathlib import Path

import pytest

import didim
from didim.methods.method import Method
from scripts import script

BENCHES = Path(__file__).resolve().parents[1] / "benches"


@pytest.mark.parametrize(
    ("method", "most"), [(didim.IDIMLS(), 45), (didim.DIDIM(), 78), (didim.CLOE(), 58)], ids=lambda each: str(each)[:6]
)  # fmt: skip
def test_a_run_enters_no_more_files_than_before(method: Method, most: int) -> None:
    lines = script(BENCHES / "lines.py")
    seen = lines.entered(method, lines.simulated_tx40())
    assert len({file for file, _ in seen}) <= most
