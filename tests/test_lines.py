"""How much of the package a run enters, and what tells ideas from ceremony: numbers that only fall."""

from __future__ import annotations

from pathlib import Path

import pytest

import didim
from didim.methods.method import Method
from scripts import script

BENCHES = Path(__file__).resolve().parents[1] / "benches"


@pytest.mark.parametrize(
    ("method", "most"),
    [(didim.IDIMLS(), 45), (didim.DIDIM(), 78), (didim.CLOE(max_iterations=1), 58)],
    ids=lambda each: str(each)[:6],
)
def test_a_run_enters_no_more_files_than_before(method: Method, most: int) -> None:
    lines = script(BENCHES / "lines.py")
    seen = lines.entered(method, lines.simulated_tx40())
    assert len({file for file, _ in seen}) <= most


def test_measures_count_what_they_say() -> None:
    lines = script(BENCHES / "lines.py")
    source = (
        "import os\nfrom sys import (\n    argv,\n)\n\nA = 1\nB = (2, -3.5)\nC = 'text'\nd = 4\n\n\n"
        "def _once(fit):\n    return fit.settings['a'], fit.settings.get('b')\n\n\n"
        "def twice(term):\n    return _once(term) if term.law == 'load' else _often() + _often()\n\n\n"
        "def _often():\n    return 5\n"
    )
    found = lines.measured(
        {"regression/a.py": source, "terms/b.py": "def f(term):\n    return term.law in 'ab'\n"}
    )
    assert list(found) == list(lines.CEILINGS)
    assert list(found.values()) == [2, round(100.0 * 4 / 16, 1), 2, 1, 2, 1]
