"""Which tests run a line of the package, and how long each takes: the whole suite once, under coverage.

    python benches/reach.py

`benches/mutations.py --constants` makes and reads it, in ``out/mutations/``. To pytest this file is a plugin that names each
test to coverage.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

import coverage
import pytest

PROJECT = Path(__file__).resolve().parent.parent
LINES = PROJECT / "out" / "mutations" / "lines.coverage"
SECONDS = PROJECT / "out" / "mutations" / "seconds.json"
"""Seconds of each test, by its name."""

_seconds: dict[str, float] = {}


def pytest_runtest_logstart(nodeid: str) -> None:
    """Count the lines that run from here on for the test that begins."""
    if (running := coverage.Coverage.current()) is not None:
        running.switch_context(nodeid)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up what preparation, test and cleaning took."""
    _seconds[report.nodeid] = _seconds.get(report.nodeid, 0.0) + report.duration


def pytest_sessionfinish() -> None:
    """Write how long each test took."""
    SECONDS.write_text(json.dumps(_seconds), encoding="utf-8")


def record() -> None:
    """Run the whole suite under coverage; SystemExit where a test fails."""
    LINES.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "coverage", "run", "--rcfile=", "--source=didim", f"--data-file={LINES}"]
    command += ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "reach"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    done = subprocess.run(command, cwd=PROJECT, env=environment, check=False)
    if done.returncode:
        raise SystemExit("reach: the tests fail as they are")


def tests_of(lines: Mapping[Path, Iterable[int]]) -> list[str]:
    """Return the tests that run one of some lines, the shortest first, then the others of their files.

    A fixture that several tests share runs in the first of them, so the others of a file may be those that check its result.
    """
    if not LINES.exists():
        record()
    data = coverage.CoverageData(str(LINES))
    data.read()
    seconds: dict[str, float] = json.loads(SECONDS.read_text(encoding="utf-8"))
    tests: set[str] = set()
    for path, wanted in lines.items():
        contexts = data.contexts_by_lineno(str(path))
        tests.update(*(contexts.get(line, ()) for line in wanted))
    tests &= seconds.keys()
    files = {name.partition("::")[0] for name in tests}
    others = {name for name in seconds if name.partition("::")[0] in files} - tests
    return [*sorted(tests, key=seconds.__getitem__), *sorted(others, key=seconds.__getitem__)]


if __name__ == "__main__":
    record()
