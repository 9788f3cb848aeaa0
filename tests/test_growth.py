"""The benchmark of growth: exponents of known powers, and a quick run; how fast is not tested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benches"))
import growth
from peer.timing import Figures

pytestmark = pytest.mark.tools


@pytest.mark.parametrize("power", [0.0, 1.0, 2.5])
def test_exponent_of_a_power_with_a_constant(power: float) -> None:
    # The small sizes hide the power; medians are noise.
    figures = {
        size: Figures("s", (3.0 * size**power if size > 10 else 1e3, 1e9))
        for size in (1, 3, 10, 30, 100, 300, 1000)
    }
    assert growth.exponent({size: figures[size] for size in (30, 100, 300, 1000)}) == pytest.approx(power)
    figures[30] = Figures("s", (3.0 * 30**power,))
    upper = {size: figure for size, figure in figures.items() if size != 10}
    assert growth.exponent(upper) == pytest.approx(power)


def test_no_exponent_of_two_sizes() -> None:
    assert growth.exponent({1: Figures("s", (1.0,)), 2: Figures("s", (0.5,))}) is None


def test_a_quick_run(project: Path, tmp_path: Path) -> None:
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
