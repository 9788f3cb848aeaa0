"""The check of the wheel: which wheel it takes, what its environment lacks, and how it measures. `make wheel-check` runs it."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import pytest

from scripts import script

pytestmark = pytest.mark.tools


@pytest.fixture(scope="module")
def check(project: Path) -> ModuleType:
    return script(project / "benches" / "wheel_check.py")


def test_the_newest_wheel_is_taken(check: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"there is no wheel in .*: `make wheel` makes one"):
        check.newest_wheel(tmp_path)
    for name, seconds in (("didim-0.9-x.whl", 1), ("didim-0.10-x.whl", 2), ("other-1-x.whl", 3)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (seconds, seconds))
    assert check.newest_wheel(tmp_path).name == "didim-0.10-x.whl"


def test_the_environment_has_no_rust_and_no_paths_of_python(
    check: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setenv("CARGO_HOME", "/cargo")
    monkeypatch.setenv("PATH", f"/cargo/bin{os.pathsep}{os.environ['PATH']}")
    bare = check.bare_environment(tmp_path)
    assert set(bare) <= {"HOME", "LANG", "TMPDIR", "SYSTEMROOT", "PATH"}
    assert bare["PATH"].split(os.pathsep) == [str(tmp_path), "/usr/bin", "/bin"]


def test_sizes_are_those_of_files_without_what_python_compiles(check: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "a" / "__pycache__").mkdir(parents=True)
    (tmp_path / "a" / "one").write_bytes(bytes(300_000))
    (tmp_path / "two").write_bytes(bytes(200_000))
    (tmp_path / "a" / "__pycache__" / "c.pyc").write_bytes(bytes(900_000))
    assert check.megabytes(tmp_path) == pytest.approx(0.5)
