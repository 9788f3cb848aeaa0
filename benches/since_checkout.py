"""Rows of `since_0_2_0.py` on the checkout itself: its tests, its Makefile, its files."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from since_observe import TREE


def tests_of(tree: Path) -> list[Path]:
    return sorted((tree / "tests").glob("*.py"))


def deadlines() -> str:
    """Tests of hypothesis whose deadline depends on the load."""
    if "deadline=None" in (TREE / "tests" / "conftest.py").read_text(encoding="utf-8"):
        return "0 files"  # a profile for all of them
    count = sum(
        "hypothesis import" in text and "@given" in text and "deadline=None" not in text
        for text in (path.read_text(encoding="utf-8") for path in tests_of(TREE))
    )
    return f"{count} file{'' if count == 1 else 's'}"


def outcome_of(name: str, prefix: Sequence[str] = (), environment: dict[str, str] | None = None) -> str:
    """Run tests of this checkout."""
    line = [*prefix, sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", *name.split()]
    child = subprocess.run(
        line, cwd=TREE, env=os.environ | (environment or {}), capture_output=True, text=True, check=False
    )
    return (
        child.stdout.strip().splitlines()[-1].partition(" in ")[0].strip("= ") if child.stdout else "nothing"
    )


def portable_lanes() -> str:
    """A test that read the digits of a diverging run, without vector instructions."""
    name = "tests/test_didim.py -k emps_from_one_kilogram"
    return outcome_of(name, environment={"DIDIM_ISA": "portable"})


def another_solver() -> str:
    """A test against Clarabel, with the kernels of an AVX2 processor."""
    name = "tests/test_consistent_oracle.py -k simulated_log_of_the_paper"
    return outcome_of(name, environment={"OPENBLAS_CORETYPE": "Haswell"})


def ignored_interrupt() -> str:
    """Tests of Ctrl-C in a shell that ignores it."""
    names = (
        "tests/test_outputs.py::test_ctrl_c_while_modules_are_loaded_is_one_line",
        "tests/test_simulation.py::test_ctrl_c_stops_a_long_batch",
    )
    return outcome_of(" ".join(names), ["sh", "-c", 'trap "" INT; exec "$@"', "sh"])


def wheel() -> str:
    """What `make wheel` would run finds the programs of its own environment."""
    child = subprocess.run(
        ["make", "-n", "wheel", "-C", str(TREE)], capture_output=True, text=True, check=False
    )
    head = (TREE / "Makefile").read_text(encoding="utf-8")
    text = child.stdout + "".join(line for line in head.splitlines() if "PATH" in line and "export" in line)
    return "PATH is that of the environment" if re.search(r"\bPATH\b", text) else "PATH is left as it is"


def licences() -> str:
    """Files of licences and components of what is compiled in."""
    found = [
        path.name
        for path in TREE.iterdir()
        if re.search(r"third.?party|sbom|cyclonedx|licen[cs]es", path.name, re.IGNORECASE)
    ]
    return ", ".join(sorted(found)) or "none"


def pages_elsewhere() -> str:
    """Tests that name pages that are not part of the project."""
    pages = re.compile(r"\b(methods|real-robots|findings|workflow|consistent_theory)\.md\b")
    docs = {path.name for path in (TREE / "docs").glob("*.md")}
    count = sum(
        bool({item.group() for item in pages.finditer(path.read_text(encoding="utf-8"))} - docs)
        for path in tests_of(TREE)
        if path.name != "test_pages.py"
    )
    return f"{count} test file{'' if count == 1 else 's'}"
