"""Programs of benches: suites as on other machines and BLAS kernels, and exponents of growth; how fast is not tested."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from didim import _core
from scripts import script

pytestmark = pytest.mark.tools

TESTS = """
import os
import pytest

def test_hash(): assert os.environ["PYTHONHASHSEED"] == "1"
def test_other(): pytest.skip("here")
"""


@pytest.fixture
def bench(project: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """A program of benches, or what it is made of, by its name."""
    monkeypatch.syspath_prepend(str(project / "benches"))
    return importlib.import_module


@pytest.fixture
def machines(bench: Callable[[str], ModuleType]) -> ModuleType:
    return bench("machines")


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


KERNEL = "Nehalem"  # every x86 processor of today knows its instructions

KERNEL_TESTS = """
import os
import pytest

def test_kernel(): assert os.environ["OPENBLAS_CORETYPE"] == "Nehalem"
"""


@pytest.fixture(scope="module")
def kernels(project: Path) -> ModuleType:
    return script(project / "benches" / "blas_kernels.py")


def test_the_kernel_asked_for_is_taken_in_the_child_only(kernels: ModuleType) -> None:
    before = os.environ.get("OPENBLAS_CORETYPE")
    taken = kernels.kernels_taken(KERNEL)
    if taken is None or set(taken) != {"numpy", "scipy"} or not set(taken.values()) <= {*kernels.KERNELS}:
        pytest.skip(f"NumPy and SciPy have no OpenBLAS for x86 here: {taken}")
    assert taken == {"numpy": KERNEL, "scipy": KERNEL}
    assert os.environ.get("OPENBLAS_CORETYPE") == before


@pytest.mark.parametrize(
    ("more", "status", "told"),
    [
        ("", 0, "1 passed"),
        ("def test_b(): assert False", 1, "1 failed, 1 passed"),
        ("def test_c(): pytest.skip()", 1, "1 passed, 1 skipped"),
    ],
)
def test_every_test_must_run_and_pass(
    kernels: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    more: str,
    status: int,
    told: str,
) -> None:
    tests = tmp_path / "test_it.py"
    tests.write_text(KERNEL_TESTS + more + "\n", encoding="utf-8")
    command = ["--kernels", KERNEL, "--tests", str(tests), "--data", str(tmp_path / "absent")]
    assert kernels.main(command) == status
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith(f"{KERNEL}: numpy runs ")
    assert line.endswith(told)


def test_kernels_with_one_result_share_a_row_and_the_spread_is_in_sigmas(kernels: ModuleType) -> None:
    def fit(value: float) -> dict[str, object]:
        cells = {"errors": ["1.0"] * 6, "distance": f"{value:.3f} (`b`)"}
        names = {"filter": "sections, scipy", "names": ["a", "b"], "units": ["m", "s"]}
        return {**names, **cells, "beta": [1.0, value], "std": [1.0, 0.5]}

    measured = {"Haswell": [fit(2.0)], "Zen": [fit(2.0)], "SkylakeX": [fit(3.0)]}
    assert [row[:2] for row in kernels.filters(measured)][1:] == [
        ["sections, scipy", "Haswell, Zen"],
        ["sections, scipy", "SkylakeX"],
    ]
    assert list(kernels.spread(measured))[1:] == [["`b`", "s", "2", "3", "2.00"]]


@pytest.mark.parametrize("power", [0.0, 1.0, 2.5])
def test_exponent_of_a_power_with_a_constant(bench: Callable[[str], ModuleType], power: float) -> None:
    growth, Figures = bench("growth"), bench("peer.timing").Figures
    # The small sizes hide the power; medians are noise.
    figures = {
        size: Figures("s", (3.0 * size**power if size > 10 else 1e3, 1e9))
        for size in (1, 3, 10, 30, 100, 300, 1000)
    }
    assert growth.exponent({size: figures[size] for size in (30, 100, 300, 1000)}) == pytest.approx(power)
    figures[30] = Figures("s", (3.0 * 30**power,))
    upper = {size: figure for size, figure in figures.items() if size != 10}
    assert growth.exponent(upper) == pytest.approx(power)


def test_no_exponent_of_two_sizes(bench: Callable[[str], ModuleType]) -> None:
    growth, Figures = bench("growth"), bench("peer.timing").Figures
    assert growth.exponent({1: Figures("s", (1.0,)), 2: Figures("s", (0.5,))}) is None


def test_growth_in_a_quick_run(project: Path, tmp_path: Path) -> None:
    result = tmp_path / "growth.json"
    script = str(project / "benches" / "growth.py")
    command = [sys.executable, script, "--quick", "--json", str(result)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    curves = json.loads(result.read_text(encoding="utf-8"))["curves"]
    assert {curve["over"] for curve in curves} == {
        "seconds of the log",
        "seconds of the motion",
        "joints",
        "legs",
        "candidates",
        "threads",
    }
    for curve in curves:
        assert curve["name"] in done.stdout
        assert len(curve["sizes"]) == len(curve["smallest_s"]) == len(curve["rounds_s"])
        assert all(
            0.0 < least <= middle
            for least, middle in zip(curve["smallest_s"], curve["median_s"], strict=True)
        )
