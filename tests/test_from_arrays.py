"""Calls as people make them: arrays, recordings, paths and names; what is wrong is one sentence."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import didim
import simulated
from didim.cli.main import main
from didim.loop.controller import Controller


@pytest.fixture(scope="module")
def log(project: Path) -> didim.Experiment:
    experiment = didim.load_experiment(project / "examples" / "planar2_simulation.toml")
    return didim.simulated_log(experiment, experiment.robot.parameter_set("reference"), seed=1)


def test_arrays_have_the_filters_of_init(
    log: didim.Experiment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (item,) = log.recordings
    assert item.tau is not None
    made = didim.Experiment.from_arrays("planar2", item.q, item.tau, rate_hz=item.rate_hz)
    table = np.column_stack([item.t, item.q, item.tau])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    monkeypatch.chdir(tmp_path)
    main(["init", "planar2", "log.csv", "-o", "log.toml"])
    capsys.readouterr()
    signal = tomllib.loads(Path("log.toml").read_text(encoding="utf-8"))["signal"]
    for key, value in signal.items():
        chosen = getattr(made.signal, key)
        assert (list(chosen) if isinstance(chosen, tuple) else chosen) == value, key
    assert made.signal.cutoff_hz is not None
    (note,) = made.remarks
    assert note.startswith(f"filters were chosen, cut-off {made.signal.cutoff_hz:g} Hz")
    fit = didim.identify(made)
    assert note in fit.remarks
    truth = log.robot.base_parameters.project(log.robot.parameter_set("reference"))
    assert np.sqrt(np.mean(((fit.beta - truth) / fit.std) ** 2)) < 3.0


def test_a_recording_with_its_robot(log: didim.Experiment) -> None:
    (item,) = log.recordings
    fit = didim.identify(item, didim.IDIMLS, robot="planar2")
    np.testing.assert_array_equal(fit.beta, didim.identify([item], robot=didim.load_robot("planar2")).beta)


def test_arrays_with_a_closed_loop_are_for_didim() -> None:
    robot = didim.load_robot("planar2")
    truth = robot.parameter_set("reference")
    recording = simulated.log(robot, truth, n_samples=600)
    assert recording.tau is not None
    made = didim.Experiment.from_arrays(
        robot,
        recording.q,
        recording.tau,
        rate_hz=recording.rate_hz,
        reference="measured",
        controller=Controller.pd(kp=[900.0, 900.0], kv=[60.0, 60.0]),
        signal=didim.SignalProcessing(),
        name="mine",
    )
    assert made.name == "mine"
    assert not made.remarks
    sampled = didim.Experiment.from_arrays(
        robot, recording.q, recording.tau, rate_hz=recording.rate_hz, reference=recording.q
    )
    assert sampled.recordings[0].q_ref is not None
    assert getattr(sampled.reference, "kind", None) == "recorded"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda log: didim.identify(log.recordings[0]), "a recording does not name its robot"),
        (lambda log: didim.identify(log, robot="planar2"), "has its robot already"),
        (lambda log: didim.identify(log.recordings[0].q), "from_arrays.robot, q, tau, rate_hz=.... takes arrays"),
        (lambda log: didim.identify("no_such.toml"), "no such file"),
        (
            lambda log: didim.identify(log, 3),  # type: ignore[arg-type]
            "a method is settings such as",
        ),
        (
            lambda log: didim.Experiment.from_arrays(
                "planar2", log.recordings[0].q, rate_hz=100.0, reference="x"
            ),
            "reference must be an array of positions",
        ),
        (lambda log: didim.Experiment.from_arrays("planar2", log.recordings[0].q.T, rate_hz=100.0), "transpose it"),
    ],
)  # fmt: skip
def test_a_wrong_call_is_one_sentence(log: didim.Experiment, call: object, message: str) -> None:
    assert callable(call)
    with pytest.raises(didim.DidimError, match=message) as told:
        call(log)
    assert "\n" not in str(told.value)
    assert len(str(told.value)) <= 200
