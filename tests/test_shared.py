"""Tests that need ../shared are counted in one line where it is absent, and run where it is there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

TESTS = """
import pytest

def test_a(shared): assert shared.name == "shared"
def test_b(shared): pass
def test_c(): pytest.skip("of another cause")
"""


def run(folder: Path) -> str:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stdout


def test_absence_is_one_line_and_presence_none(tmp_path: Path) -> None:
    tests = tmp_path / "project" / "tests"
    tests.mkdir(parents=True)
    (tests / "test_it.py").write_text(TESTS, encoding="utf-8")
    conftest = Path(__file__).with_name("conftest.py").read_text(encoding="utf-8")
    (tests / "conftest.py").write_text(conftest, encoding="utf-8")
    absent = run(tests)
    assert absent.count("2 tests were skipped because ../shared is absent") == 1
    assert "3 skipped" in absent
    (tmp_path / "shared").mkdir()
    present = run(tests)
    assert "because ../shared" not in present
    assert "2 passed, 1 skipped" in present
