"""The program that runs the suite as other machines would: its combinations, what it counts, what it cannot run."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

from didim import _core

pytestmark = pytest.mark.tools

TESTS = """
import os
import pytest

def test_hash(): assert os.environ["PYTHONHASHSEED"] == "1"
def test_other(): pytest.skip("here")
"""


@pytest.fixture
def machines(project: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(project / "benches"))
    return importlib.import_module("machines")


def test_the_oldest_versions_are_those_of_pyproject(machines: ModuleType, project: Path) -> None:
    packages = machines.oldest(project)
    assert [name.partition("==")[0] for name in packages] == ["numpy", "scipy", "pandas", "pyarrow"]
    text = (project / "pyproject.toml").read_text(encoding="utf-8")
    for package in packages:
        assert f'"{package.removesuffix(".*").replace("==", ">=")}"' in text


def test_what_the_processor_lacks_is_a_sentence(machines: ModuleType) -> None:
    unknown = machines.Combination("tomorrow's", {"DIDIM_ISA": "avx4096"})
    assert machines.missing(unknown) == "this processor has no avx4096"
    for name in _core.instruction_sets():
        assert machines.missing(machines.Combination("today's", {"DIDIM_ISA": name})) == ""
    assert machines.run(unknown, [], 1).reason == "skipped: this processor has no avx4096"


@pytest.mark.parametrize(
    ("more", "status", "counts"),
    [
        ("", 0, "1 passed, 0 failed, 1 skipped"),
        ("def test_b(): assert False", 1, "1 passed, 1 failed, 1 skipped"),
    ],
)
def test_the_table_counts_and_failures_are_named(
    machines: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    more: str,
    status: int,
    counts: str,
) -> None:
    tests = tmp_path / "test_it.py"
    tests.write_text(TESTS + more + "\n", encoding="utf-8")
    assert (
        machines.main(["--only", "load, another hash seed", "--processes", "1", "--", str(tests)]) == status
    )
    out = capsys.readouterr().out
    assert f"| {counts} |" in out
    assert ("load, another hash seed: test_it::test_b" in out) == bool(status)
