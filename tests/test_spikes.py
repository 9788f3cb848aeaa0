"""Hampel's filter on measured torques."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import didim
from didim.signal.spikes import hampel
from didim.studies.prediction import predict, relative_errors

pytestmark = pytest.mark.usefixtures("without_verdict")


def torques(seed: int = 0, n: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = np.arange(n) / 1000.0
    motion = np.column_stack([20.0 * np.sin(3.0 * t), 5.0 * np.sign(np.sin(5.0 * t + 0.1)) + np.sin(t)])
    return motion + rng.standard_normal((n, 2)) * [0.5, 0.1]


def test_spikes_are_found_and_replaced() -> None:
    clean = torques()
    rng = np.random.default_rng(1)
    planted = rng.random(clean.shape) < 0.005
    signs = rng.choice([-1.0, 1.0], clean.shape)
    found, spikes = hampel(clean + planted * signs * [15.0, 3.0])
    assert np.mean(spikes[planted]) > 0.97
    # Fewer than one sample in a hundred of the rest is touched, and the torques are those before the spikes.
    assert np.mean(spikes[~planted]) < 0.01
    error, noise = np.std(found - clean, axis=0), np.array([0.5, 0.1])
    assert (error < 0.25 * noise).all()


def test_steps_of_friction_stay() -> None:
    t = np.arange(2000)
    steps = np.where(t // 400 % 2, 5.0, -5.0)[:, None] + 0.01 * np.random.default_rng(0).standard_normal(
        (2000, 1)
    )
    found, _ = hampel(steps)
    assert np.abs(found - steps).max() < 0.1


@pytest.mark.parametrize("resolution", [0.0, 0.5])
def test_constant_and_coarse_signals_are_left_alone(resolution: float) -> None:
    t = np.arange(3000) / 1000.0
    signal = 3.0 * np.sin(t) if resolution else np.full(3000, 7.0)
    if resolution:
        signal = resolution * np.round(signal / resolution)
    found, spikes = hampel(signal[:, None])
    assert not spikes.any()
    assert np.array_equal(found, signal[:, None])


def test_levels_of_a_coarse_signal_that_alternate_are_no_spikes() -> None:
    """Noise below the resolution flips samples one by one, in windows that are otherwise constant; ten steps are a spike."""
    noise = 0.1 * np.random.default_rng(0).standard_normal(3000)
    signal = 0.5 * np.round(6.0 * np.sin(np.arange(3000) / 1000.0) + noise)
    assert not hampel(signal[:, None])[1].any()
    signal[700] += 5.0
    assert np.flatnonzero(hampel(signal[:, None])[1]).tolist() == [700]


def test_a_spike_in_a_constant_signal_is_found() -> None:
    signal = np.zeros((100, 1))
    signal[40] = 1.0
    found, spikes = hampel(signal)
    assert list(np.flatnonzero(spikes)) == [40]
    assert not found.any()


def test_a_record_shorter_than_the_window_is_left_alone() -> None:
    short = np.array([[1.0], [100.0], [1.0]])
    found, spikes = hampel(short)
    assert np.array_equal(found, short)
    assert not spikes.any()


def planted(experiment: didim.Experiment, share: float, seed: int = 0) -> didim.Experiment:
    """The same log with spikes of 30 times the noise of each torque."""
    (recording,) = experiment.recordings
    assert recording.tau is not None
    assert experiment.measurement is not None
    rng = np.random.default_rng(seed)
    where = rng.random(recording.tau.shape) < share
    signs = rng.choice([-1.0, 1.0], recording.tau.shape)
    tau = recording.tau + 30.0 * where * signs * np.array(experiment.measurement.torque_noise)
    return replace(experiment, recordings=(replace(recording, tau=tau),))


@pytest.fixture(scope="module")
def log() -> didim.Experiment:
    experiment = didim.packaged_experiment("tx40")
    experiment = replace(experiment, signal=replace(experiment.signal, cutoff_hz=200.0))
    return didim.simulated_log(experiment, experiment.robot.parameter_set("didim"), seed=1)


def test_the_filter_of_the_experiment_reaches_the_level_without_spikes(log: didim.Experiment) -> None:
    truth = log.robot.base_parameters.project(log.robot.parameter_set("didim"))
    clean = didim.identify(log)
    spoiled = planted(log, 0.005)
    raw = didim.identify(spoiled)
    filtered = didim.identify(replace(spoiled, signal=replace(spoiled.signal, spikes="hampel")))

    def off(fit: didim.Identification) -> float:
        return float(np.sqrt(np.mean(((fit.beta - truth) / clean.std) ** 2)))

    assert off(raw) > 1.7 * off(clean)
    assert off(filtered) < 1.1 * off(clean)
    assert filtered.settings["signal"]["spikes"] == "hampel"


def test_check_names_spikes_and_the_cure(log: didim.Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    # The search for other causes takes most of the time.
    monkeypatch.setattr("didim.diagnosis.check._causes", lambda rows, hints: [])
    assert not [item for item in didim.check(log) if item.kind == "spikes"]
    spoiled = planted(log, 0.001)
    (finding,) = [item for item in didim.check(spoiled) if item.kind == "spikes"]
    assert finding.joints == (1, 2, 3, 4, 5, 6)
    assert 'spikes = "hampel"' in finding.advice
    # Ten in each thousand samples of six joints, of which nearly all are found.
    assert finding.facts["count"] == pytest.approx(0.001 * spoiled.recordings[0].q.size, rel=0.25)
    cured = replace(spoiled, signal=replace(spoiled.signal, spikes="hampel"))
    assert not [item for item in didim.check(cured) if item.kind == "spikes"]


@pytest.mark.slow
def test_didim_and_a_prediction_see_the_same_torques(log: didim.Experiment) -> None:
    spoiled = planted(log, 0.005)
    fit = didim.identify(replace(spoiled, signal=replace(spoiled.signal, spikes="hampel")), didim.DIDIM())
    raw = didim.identify(spoiled, didim.DIDIM())
    assert fit.error_std < 0.7 * raw.error_std
    predicted = predict(fit, spoiled)
    assert relative_errors(predicted) == pytest.approx(fit.relative_error, rel=1e-2)


def test_another_word_is_refused() -> None:
    with pytest.raises(didim.errors.SignalError, match="spikes must be 'hampel', got 'median'"):
        didim.SignalProcessing(spikes="median")  # type: ignore[arg-type]
