"""Extensions as CONTRIBUTING describes them: a solver and a reader of logs, each one file and a row in a table."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

import didim
import simulated
from didim import IDIMLS, identify, load_robot
from didim.errors import FitError, RecordingError
from didim.experiment.experiment import Experiment
from didim.log.data_file import READERS
from didim.regression.solver import SOLVERS

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))
from least_absolute import LeastAbsolute

MOST_LINES = 60


@pytest.mark.parametrize("name", ["least_absolute", "json_lines"])
def test_the_examples_are_short(project: Path, name: str) -> None:
    assert len((project / "examples" / f"{name}.py").read_text(encoding="utf-8").splitlines()) < MOST_LINES


@pytest.fixture(scope="module")
def log() -> Experiment:
    robot = load_robot("planar2")
    truth = robot.parameter_set("reference")
    return simulated.experiment(robot, simulated.log(robot, truth, n_samples=1500, noise=0.05))


def test_least_absolute_deviations_are_the_optimum_of_the_linear_program(log: Experiment) -> None:
    job = IDIMLS(weights="none").job(log)
    system = job.system(job.parts("fit"))
    fit = LeastAbsolute()(system, replace(job.settings, weights="none"))
    n, b = system.w.shape
    eye = np.eye(n)
    program = linprog(
        np.concatenate([np.zeros(b), np.ones(n)]),
        A_ub=np.block([[system.w, -eye], [-system.w, -eye]]),
        b_ub=np.concatenate([system.y, -system.y]),
        bounds=[(None, None)] * b + [(0.0, None)] * n,
    )
    assert np.abs(fit.residual).sum() == pytest.approx(program.fun, rel=1e-4)
    assert fit.converged


def test_wild_torques_do_not_move_it(log: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SOLVERS, "least-absolute", "least_absolute:LeastAbsolute")
    (recording,) = log.recordings
    assert recording.tau is not None
    tau = recording.tau.copy()
    tau[::97] += 30.0
    signal = replace(log.signal, decimation=())
    wild = replace(log, recordings=(replace(recording, tau=tau),), signal=signal)
    truth = log.robot.base_parameters.project(log.robot.parameter_set("reference"))
    plain, robust = (identify(wild, IDIMLS(solver=name)) for name in ("least-squares", "least-absolute"))
    assert np.linalg.norm(robust.beta - truth) < 0.1 * np.linalg.norm(plain.beta - truth)
    assert robust.settings["solver"]["name"] == "least-absolute"
    assert robust.settings["solver"]["iterations"] == robust.n_iterations
    stopped = identify(wild, IDIMLS(solver="least-absolute"), callback=lambda iteration: True)
    assert stopped.n_iterations == 1
    unfinished = identify(wild, IDIMLS(solver=LeastAbsolute(max_iterations=2)))
    assert not unfinished.converged
    with pytest.raises(FitError, match="did you mean 'least-absolute'"):
        IDIMLS(solver="least-absolut")


EXPERIMENT = """
schema = 1
robot = "planar2"
[signal]
cutoff_hz = 40
[[recording]]
rate_hz = 500
[recording.position]
file = "log.jsonl"
variable = "q"
unit = "rad"
side = "joint"
[recording.torque]
file = "log.jsonl"
columns = ["tau1", "tau2"]
unit = "N.m"
side = "joint"
"""


def write(folder: Path, lines: list[str]) -> Path:
    (folder / "log.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    path = folder / "arm.toml"
    path.write_text(EXPERIMENT, encoding="utf-8")
    return path


def test_a_log_of_json_lines(log: Experiment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (recording,) = log.recordings
    assert recording.tau is not None
    lines = [
        json.dumps({"q": q.tolist(), "tau1": tau[0], "tau2": tau[1]})
        for q, tau in zip(recording.q, recording.tau, strict=True)
    ]
    path = write(tmp_path, lines)
    with pytest.raises(RecordingError, match=r"log.jsonl: the format '.jsonl' is unknown; known are .csv"):
        didim.load_experiment(path)
    monkeypatch.setitem(READERS, ".jsonl", "json_lines:JsonLines")
    (read,) = didim.load_experiment(path).recordings
    np.testing.assert_array_equal(read.q, recording.q)
    np.testing.assert_array_equal(read.tau, recording.tau)
    for wrong, message in (
        ([*lines[:20], "{"], "log.jsonl: line 21 is not JSON"),
        ([*lines[:20], "{}"], "log.jsonl: line 21 does not have the keys of the first line"),
        ([line.replace('"tau1"', '"tau"') for line in lines], "there is no variable 'tau1'"),
        ([lines[0].replace("[", "[[").replace("]", "]]")], "variable 'q' must be a vector or a matrix"),
    ):
        with pytest.raises(RecordingError, match=message):
            didim.load_experiment(write(tmp_path, wrong))
