"""The program that runs the published figures under every BLAS kernel: which kernel runs, and what counts as passed."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import pytest

from scripts import script

pytestmark = pytest.mark.tools

KERNEL = "Nehalem"  # every x86 processor of today knows its instructions

TESTS = """
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
    tests.write_text(TESTS + more + "\n", encoding="utf-8")
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
