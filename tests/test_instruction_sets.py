"""Sets of instructions: chosen by the environment, the same results under each that the processor has."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim._core as _core
from arm import arm_file, arm_log

RESULTS = """
import sys
import numpy as np
import didim
import didim._core as core
from arm import arm_log
from didim.experiment.loop import closed_loop

log = arm_log(1)
(recording,) = log.recordings
x = log.robot.parameter_set("reference")
candidates = x * np.linspace(0.9, 1.1, 11)[:, None]
ones = np.ones(2)
costs, _ = closed_loop(log, recording).costs(
    candidates, recording.q, recording.tau, weight_q=ones, weight_tau=ones, threads=1
)
alone, _ = closed_loop(log, recording).costs(
    candidates[4:5], recording.q, recording.tau, weight_q=ones, weight_tau=ones, threads=1
)
arm = didim.load_robot("tx40")
motion = [np.random.default_rng(k).normal(size=(13, 6)) for k in range(3)]
np.savez(
    sys.argv[1],
    set=core.instruction_set(),
    costs=costs,
    alone=alone,
    regressor=didim.regressor(arm, *motion),
    torques=didim.inverse_dynamics(arm, *motion, arm.parameter_set("didim")),
)
"""


def _under(name: str, arguments: list[str]) -> subprocess.CompletedProcess[str]:
    """Run Python with a set of instructions."""
    tests = str(Path(__file__).parent)
    path = os.pathsep.join(filter(None, [tests, os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path, "DIDIM_ISA": name}
    return subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True, check=False
    )


def test_every_set_has_the_same_results(tmp_path: Path) -> None:
    """Wider vectors give the same bits; code for any processor rounds products and sums one by one."""
    found: dict[str, dict[str, Any]] = {}
    for name in _core.instruction_sets():
        run = _under(name, ["-c", RESULTS, str(tmp_path / f"{name}.npz")])
        assert run.returncode == 0, run.stderr
        found[name] = dict(np.load(tmp_path / f"{name}.npz"))
        assert found[name].pop("set") == name
        assert found[name]["costs"][4] == found[name]["alone"][0]
        assert len(set(found[name]["costs"])) == 11
    widest = found[_core.instruction_sets()[-1]]
    for name, results in found.items():
        for what, value in results.items():
            if name == "portable":
                np.testing.assert_allclose(value, widest[what], rtol=1e-8, atol=1e-9, err_msg=what)
            else:
                np.testing.assert_array_equal(value, widest[what], err_msg=f"{name}, {what}")


def test_the_widest_is_the_default() -> None:
    code = "import didim._core as core; print(core.instruction_set() == core.instruction_sets()[-1])"
    assert _under("auto", ["-c", code]).stdout == "True\n"
    assert _core.instruction_sets()[0] == "portable"


@pytest.mark.parametrize("name", ["", "sse9", "AVX2 "])
def test_a_wrong_variable_is_one_sentence(name: str, tmp_path: Path) -> None:
    file = arm_file(arm_log(1), tmp_path, tmp_path / "arm.toml")
    run = _under(name, ["-m", "didim", "identify", str(file)])
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr == f'didim: DIDIM_ISA must be auto, portable, avx2 or avx512, got "{name}"\n'


def test_a_wrong_variable_is_an_error_of_the_package() -> None:
    code = "import didim\ntry:\n    didim.load_robot('tx40')\nexcept didim.errors.InstructionSetError as e: print(e)"
    assert _under("none", ["-c", code]).stdout.startswith("DIDIM_ISA must be auto, ")
