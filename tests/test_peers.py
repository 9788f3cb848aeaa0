"""Benchmarks beside other programs: peers compute what ours computes, and the tables hold together; how fast is not tested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benches"))
from peer import against_casadi, against_figaroh, against_mujoco, against_pinocchio, against_scipy
from peer.goals import GOALS, Goal
from peer.task import SAMPLES, Task, tx40
from peer.timing import Contestant, DisagreementError, Figures, MissingError, alternate

pytestmark = pytest.mark.tools

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def task() -> Task:
    return tx40()


def test_a_quick_run(project: Path, tmp_path: Path) -> None:
    result = tmp_path / "peers.json"
    command = [sys.executable, str(project / "benches" / "peers.py"), "--quick", "--json", str(result)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(result.read_text(encoding="utf-8"))
    assert set(found) == {"machine", "versions", "threads", "skipped", "contestants", "ratios"}
    for text in (*found["contestants"], *found["ratios"], *found["skipped"]):
        assert text in done.stdout
    # Each peer is measured, or a sentence says why not.
    for program in ("Pinocchio", "CasADi", "MuJoCo", "SciPy"):
        left_out = any(sentence.startswith(f"{program} is left out: ") for sentence in found["skipped"])
        assert left_out != any(name.startswith(program) for name in found["contestants"])
    single = found["contestants"]["RK4 step and candidate, 1 candidate, 1 thread"]
    lanes = found["ratios"]["RK4 step and lane, 4 lanes, one core (us)"]
    assert len(single["rounds"]) == 1
    assert lanes["median"] == found["contestants"]["RK4 step and candidate, 4 candidates, 1 thread"]["median"]
    ratio = found["ratios"].get("4 abaInParallel / RK4 step of one simulation")
    if ratio is not None:
        aba = found["contestants"]["Pinocchio abaInParallel, 1 thread"]
        assert ratio["smallest"] == 4.0 * aba["smallest"] / single["smallest"]
        assert ratio["met_by_smallest"] == (ratio["smallest"] >= ratio["wanted"])


def test_whole_runs_of_the_measured_log(project: Path, shared: Path, tmp_path: Path) -> None:
    script = project / "benches" / "peer" / "run_alone.py"
    experiment = project / "examples" / "tx40_log.toml"
    results: dict[str, dict[str, float]] = {}
    for what in ("idim-ls", "memory"):
        command = [sys.executable, str(script), what, str(experiment), str(shared / "data" / "tx40")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        results[what] = json.loads(done.stdout)
    times = results["idim-ls"]
    assert 0.0 < times["numerics"] < times["first"]
    assert 0.0 < times["numerics again"] < times["again"]
    # Two times six columns of 45 000 numbers at least.
    assert results["memory"]["MB"] > 4.0


def test_a_wrong_folder_is_told(project: Path, tmp_path: Path) -> None:
    command = [sys.executable, str(project / "benches" / "peers.py"), "--data", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert f"there is no motor_position.csv in {tmp_path}" in done.stderr


def test_pinocchio_agrees(task: Task) -> None:
    pytest.importorskip("pinocchio")
    names = [contestant.name for contestant in against_pinocchio.contestants(task, 1)]
    assert "Pinocchio abaInParallel, 2 threads" in names


def test_casadis_code_is_the_forward_dynamics(task: Task) -> None:
    pytest.importorskip("casadi")
    batch, operations = against_casadi.compiled(task)
    found = np.empty((SAMPLES, 6))
    batch(task.q, task.dq, task.tau, found)
    # An independent engine, where there is one; the benchmark itself compares with ours.
    pin = pytest.importorskip("pinocchio")
    model = against_pinocchio.twin(task)
    data = model.createData()
    for k in range(20):
        expected = pin.aba(model, data, task.q[k], task.dq[k], task.tau[k])
        np.testing.assert_allclose(found[k], expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert 500 < operations < 2000  # a few thousand would be code that multiplies by zeros


def test_mujocos_model_has_the_same_inertia(task: Task) -> None:
    mujoco = pytest.importorskip("mujoco")
    model: Any = mujoco.MjModel.from_xml_string(against_mujoco.mjcf(task))
    data = mujoco.MjData(model)
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    expected = didim.inertia_matrix(task.plain, task.q[:20], task.free)
    for k in range(20):
        data.qpos[:] = task.q[k]
        mujoco.mj_forward(model, data)
        full = np.empty((6, 6))
        mujoco.mj_fullM(model, data, full)
        np.testing.assert_allclose(full, expected[k], rtol=0, atol=1e-10 * np.abs(expected[k]).max())
    assert data.nefc == 0  # no constraint is solved
    against_mujoco.contestants(task, 1)  # raises if the accelerations differ


def test_scipy_finds_the_same(task: Task) -> None:
    names = [contestant.name for contestant in against_scipy.contestants(task, 1, quick=True)]
    assert len(names) == len(set(names)) == 5


def test_figaroh_leaves_the_same_error(task: Task, shared: Path) -> None:
    pytest.importorskip("pinocchio")
    try:
        found = against_figaroh.contestants(task, shared / "data" / "tx40", 1)
    except MissingError as reason:
        pytest.skip(str(reason))
    assert [contestant.name for contestant in found] == ["figaroh, TX40 log"]


def test_figaroh_without_data_is_left_out(task: Task) -> None:
    with pytest.raises(MissingError, match="--data FOLDER"):
        against_figaroh.contestants(task, None, 1)


def test_another_robot_is_a_disagreement(task: Task) -> None:
    with pytest.raises(
        DisagreementError, match=r"^MuJoCo and didim differ by 1e-06 \(relative\) in the forward dynamics"
    ):
        task.check("MuJoCo", "the forward dynamics", task.q * (1.0 + 1e-6), task.q)
    with pytest.raises(DisagreementError):
        task.check("MuJoCo", "the forward dynamics", np.full((2, 6), np.nan), np.ones((2, 6)))


def test_rounds_alternate() -> None:
    calls: list[str] = []

    def contestant(name: str, unit: str, rounds: int) -> Contestant:
        def measure() -> float:
            calls.append(name)
            return float(len(calls))

        return Contestant(name=name, measure=measure, unit=unit, rounds=rounds)

    figures = alternate([contestant("a", "us", 3), contestant("b", "s", 2)])
    assert calls == ["a", "a", "b", "a", "b", "a"]  # the first warms up
    assert figures["a"].rounds == (2.0, 4.0, 6.0)
    assert (figures["a"].smallest, figures["a"].median, figures["a"].spread) == (2.0, 4.0, (3.0, 5.0))
    assert figures["b"].rounds == (3.0, 5.0)


def test_goals() -> None:
    figures = {"ours": Figures("us", (1.0, 2.0, 4.0)), "theirs": Figures("us", (6.0, 8.0, 40.0))}
    ratio = Goal("ratio", "ours", "theirs", 4.0, 20.0)
    assert ratio.values(figures) == (16.0, 24.0)
    assert (ratio.met(16.0), ratio.met(24.0)) == (False, True)
    cost = Goal("cost", "ours", wanted=1.5)
    assert cost.values(figures) == (2.0, 1.0)
    assert (cost.met(2.0), cost.met(1.0)) == (False, True)
    assert not Goal("ratio", "ours", "absent").known(figures)
    assert len({goal.text for goal in GOALS}) == len(GOALS)
