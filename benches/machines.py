"""Does the suite pass on other machines? It runs here as they would run it.

    python benches/machines.py [--only NAME ...] [--processes N] [TEST ...]

A row for each combination: the BLAS kernels of another processor (OPENBLAS_CORETYPE), the core without or with wide vectors
(DIDIM_ISA), the oldest and the newest NumPy and SciPy that pyproject.toml allows, another order of hashes, and four busy
loops beside a niced run. What this processor cannot run is skipped with a sentence. Arguments of pytest choose tests; all run
without. The rows are those of docs/validation.md, with the tests that failed below them; the exit status is 1 where any has.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import subprocess
import sys
import tempfile
import tomllib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import blas_kernels

PROJECT = Path(__file__).resolve().parent.parent
BUSY_LOOPS = 4
NICENESS = 10
VERSIONS = """
import numpy, scipy
from didim import _core
print(f"NumPy {numpy.__version__}, SciPy {scipy.__version__}, {_core.instruction_set()}")
"""


@dataclass(frozen=True)
class Combination:
    """A machine to run the suite as.

    Attributes
    ----------
    name : str
        What is different on it.
    environment : mapping
        Variables of the run.
    packages : tuple of str
        Packages that stand before those installed, as pip is asked for them.
    busy : int
        Busy loops beside the run.
    """

    name: str
    environment: Mapping[str, str] = field(default_factory=dict)
    packages: tuple[str, ...] = ()
    busy: int = 0


@dataclass(frozen=True)
class Outcome:
    """What became of a run: counts of tests, and those that failed, or why there was no run."""

    versions: str = ""
    passed: int = 0
    skipped: int = 0
    failed: tuple[str, ...] = ()
    reason: str = ""

    @property
    def good(self) -> bool:
        """Whether it ran and nothing failed, or could not be run here."""
        return bool(self.reason) or (self.passed > 0 and not self.failed)


def oldest(project: Path) -> tuple[str, ...]:
    """Return the oldest releases that pyproject.toml allows, with pandas and pyarrow of their time: later ones need NumPy 2."""
    content = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))
    asked = [*content["project"]["dependencies"], *content["dependency-groups"]["test"]]
    matches = [re.fullmatch(r"([\w-]+)>=([\d.]+)", text) for text in asked]
    bounds = {match[1]: match[2] for match in matches if match is not None}
    return tuple(f"{name}=={bounds[name]}.*" for name in ("numpy", "scipy", "pandas", "pyarrow"))


def combinations(project: Path) -> tuple[Combination, ...]:
    """Return the machines, the one that this is first."""
    return (
        Combination("as it is"),
        Combination("Haswell, portable", {"OPENBLAS_CORETYPE": "Haswell", "DIDIM_ISA": "portable"}),
        Combination("Nehalem, avx2", {"OPENBLAS_CORETYPE": "Nehalem", "DIDIM_ISA": "avx2"}),
        Combination("SkylakeX, avx512", {"OPENBLAS_CORETYPE": "SkylakeX", "DIDIM_ISA": "avx512"}),
        Combination("oldest NumPy and SciPy", packages=oldest(project)),
        Combination("newest NumPy and SciPy", packages=("numpy", "scipy")),
        Combination("load, another hash seed", {"PYTHONHASHSEED": "1"}, busy=BUSY_LOOPS),
    )


def missing(combination: Combination) -> str:
    """Say what this machine lacks for a combination; empty when it has all."""
    from didim import _core

    isa = combination.environment.get("DIDIM_ISA", "portable")
    if isa not in _core.instruction_sets():
        return f"this processor has no {isa}"
    kernel = combination.environment.get("OPENBLAS_CORETYPE")
    if kernel is not None:
        taken = blas_kernels.kernels_taken(kernel)
        if taken is None or set(taken.values()) != {kernel}:
            return f"this processor does not run the kernels of {kernel}"
    return ""


def install(packages: Sequence[str], folder: Path) -> str:
    """Install packages into a folder of their own; return the last line of pip where that fails."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    command += ["--upgrade", "--only-binary", ":all:", "--target", str(folder), *packages]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return (done.stderr.strip().splitlines() or ["pip failed"])[-1] if done.returncode else ""


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """Keep processors busy meanwhile."""
    loop = [sys.executable, "-c", f"import os; os.nice({NICENESS})\nwhile True: pass"]
    running = [subprocess.Popen(loop) for _ in range(loops)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def versions_of(environment: Mapping[str, str]) -> str:
    """Return the versions of NumPy, SciPy and the core's kernels that a run in this environment has."""
    command = [sys.executable, "-c", VERSIONS]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()


def counted(report: Path) -> tuple[int, int, tuple[str, ...]]:
    """Return how many tests passed and were skipped in pytest's report, and which failed."""
    passed, skipped, failed = 0, 0, []
    for case in ElementTree.parse(report).iter("testcase"):
        kinds = {child.tag for child in case}
        if kinds & {"failure", "error"}:
            failed.append(f"{case.get('classname', '').rpartition('.')[2]}::{case.get('name')}")
        elif "skipped" in kinds:
            skipped += 1
        else:
            passed += 1
    return passed, skipped, tuple(failed)


def run(combination: Combination, tests: Sequence[str], processes: int, project: Path = PROJECT) -> Outcome:
    """Run the suite as on another machine."""
    lacking = missing(combination)
    if lacking:
        return Outcome(reason=f"skipped: {lacking}")
    with tempfile.TemporaryDirectory() as scratch:
        folder, report = Path(scratch, "packages"), Path(scratch, "report.xml")
        if combination.packages:
            refused = install(combination.packages, folder)
            if refused:
                return Outcome(reason=f"skipped: {refused}")
        paths = filter(None, [str(folder), os.environ.get("PYTHONPATH")])
        environment = {**os.environ, **combination.environment, "PYTHONPATH": os.pathsep.join(paths)}
        versions = versions_of(environment)
        if combination.packages and versions == versions_of(os.environ):
            return Outcome(versions, reason="the same versions are installed: nothing else to run")
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junitxml={report}"]
        if processes > 1:
            command += ["-n", str(processes), "--dist", "worksteal"]
        if combination.busy:
            command = ["nice", "-n", str(NICENESS), *command]
        with busy(combination.busy):
            done = subprocess.run(
                [*command, *tests], cwd=project, env=environment, capture_output=True, text=True, check=False
            )
        if not report.exists():
            raise SystemExit(
                f"machines: {combination.name}: pytest made no report\n{done.stdout}{done.stderr}"
            )
        passed, skipped, failed = counted(report)
        if done.returncode and not failed:
            failed = (f"pytest ended with {done.returncode}",)
        return Outcome(versions, passed, skipped, failed)


def row(combination: Combination, outcome: Outcome) -> str:
    """Return the row of the table."""
    if outcome.reason:
        return f"| {combination.name} | {outcome.versions} | {outcome.reason} |"
    counts = f"{outcome.passed} passed, {len(outcome.failed)} failed, {outcome.skipped} skipped"
    return f"| {combination.name} | {outcome.versions} | {counts} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the combinations that were asked for; 1 when one fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    names = [combination.name for combination in combinations(PROJECT)]
    parser.add_argument(
        "--only", nargs="+", choices=names, default=names, metavar="NAME", help="; ".join(names)
    )
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1, help="of pytest")
    parser.add_argument("tests", nargs="*", help="arguments of pytest, after --")
    options = parser.parse_args(arguments)
    print(f"{platform.machine()}, CPython {platform.python_version()}\n")
    print("| machine | runs | tests |\n|---|---|---|", flush=True)
    outcomes = {}
    for combination in combinations(PROJECT):
        if combination.name in options.only:
            outcomes[combination.name] = run(combination, options.tests, options.processes)
            print(row(combination, outcomes[combination.name]), flush=True)
    for name, outcome in outcomes.items():
        for test in outcome.failed:
            print(f"\n{name}: {test}", end="")
    print()
    return 0 if all(outcome.good for outcome in outcomes.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
