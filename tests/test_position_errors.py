"""Noise and steps of positions: the motion between steps, how far both move an estimate, and the intervals that include it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.experiment.experiment import Experiment
from didim.result.identification import Identification
from didim.signal.steps import between_steps
from friction_logs import coulomb, logged, robot, stribeck, subject, truth
from simulated import closed_loop_log

pytestmark = pytest.mark.usefixtures("without_verdict")

STEP = 2.0 * np.pi / 4096


def fits_of(arm: str, counts: int) -> list[Identification]:
    return [
        didim.identify(logged(robot(arm), coulomb, 1000 + seed, of=arm, counts=counts), "idim-ls")
        for seed in range(3)
    ]


def shift(fit: Identification) -> np.ndarray:
    assert fit.uncertainty is not None
    return fit.uncertainty.positions


def negligible(fit: Identification) -> bool:
    """Whether the shift is that of the noise of numbers: 1e-9 of a motion without any."""
    return bool(np.all(np.abs(shift(fit)) < 1e-6 * fit.std))


def noisy() -> Experiment:
    """Return a log whose positions have noise of one step before they are rounded, which is too much to smooth it away."""
    log = logged(robot(), coulomb, 1000)
    (recording,) = log.recordings
    q = recording.q + STEP * np.random.default_rng(1).standard_normal(recording.q.shape)
    return replace(log, recordings=(replace(recording, q=np.round(q / STEP) * STEP),))


def moved(q: np.ndarray, **settings: object) -> np.ndarray:
    """Return what `between_steps` makes of rounded positions at 500 Hz."""
    signal = replace(didim.SignalProcessing(cutoff_hz=50.0), **settings)  # type: ignore[arg-type]
    return between_steps(np.round(q / STEP) * STEP, 500.0, signal, np.array([STEP]))


@pytest.mark.parametrize(("frequency", "amplitude", "least"), [(1.03, 1.0, 4.0), (9.17, 0.2, 2.0)])
def test_motion_lies_between_the_steps(frequency: float, amplitude: float, least: float) -> None:
    """Its error is a fraction of that of the readings, also if the lowest low pass would lose the motion."""
    q = amplitude * np.sin(2.0 * np.pi * frequency * np.arange(5000)[:, None] / 500.0)
    readings, made = np.round(q / STEP) * STEP, moved(q)
    assert np.abs(made - readings).max() <= 0.5001 * STEP
    assert np.std(readings - q) > least * np.std(made - q)


def test_readings_that_do_not_show_the_motion_stay_as_they_are() -> None:
    t = np.arange(5000)[:, None] / 500.0
    q, noise = np.sin(2.0 * np.pi * t), STEP * np.random.default_rng(1).standard_normal((5000, 1))
    for values in (
        q + noise,
        25.0 * STEP * q,
        q + 0.05 * np.sin(2.0 * np.pi * 45.0 * t),
        0.1 * np.sin(2.0 * np.pi * 20.3 * t),
    ):
        np.testing.assert_array_equal(moved(values), np.round(values / STEP) * STEP)
    for settings in ({"cutoff_hz": None}, {"ends": "first-order"}):
        np.testing.assert_array_equal(moved(q, **settings), np.round(q / STEP) * STEP)
    np.testing.assert_array_equal(moved(q[:14]), np.round(q[:14] / STEP) * STEP)  # too short to be filtered


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["planar2", "ur5e-like", "iiwa14-like"])
def test_coarse_encoders_keep_estimates_and_intervals(arm: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fits = fits_of(arm, 4096)
    errors = np.array([fit.beta - truth(arm) for fit in fits])
    inside = []
    for fit, error in zip(fits, errors, strict=True):
        assert fit.uncertainty is not None
        noise = fit.uncertainty.without_shift(fit.std)
        np.testing.assert_allclose(fit.std**2, noise**2 + shift(fit) ** 2, rtol=1e-10)
        inside.append(np.abs(error) <= fit.uncertainty.factor(0.95) * fit.std)
        assert "steps of the positions" not in str(fit)
    assert np.mean(inside) > 0.9
    monkeypatch.setattr("didim.signal.window.between_steps", lambda q, *more: q)
    before = np.array([fit.beta - truth(arm) for fit in fits_of(arm, 4096)])
    gains = np.sqrt(np.mean(before**2, axis=0) / np.mean(errors**2, axis=0))
    assert np.median(gains) > 4.0


def test_coarse_encoders_do_not_hide_missing_friction() -> None:
    fit = didim.identify(logged(robot(), stribeck(0.2), 1000, counts=4096), "idim-ls")
    assert fit.uncertainty is not None
    assert fit.uncertainty.friction is not None
    assert fit.uncertainty.friction.raised


def test_fine_encoders_keep_their_intervals() -> None:
    inside = []
    for fit in fits_of("planar2", 2**16):
        assert fit.uncertainty is not None
        noise = fit.uncertainty.without_shift(fit.std)
        assert 0.0 < np.median(np.abs(shift(fit)) / noise) < 0.2
        error = np.abs(fit.beta - truth("planar2"))
        inside.append(error <= fit.uncertainty.factor(0.95) * fit.std)
        assert "steps of the positions" not in str(fit)
    assert np.mean(inside) > 0.9
    assert negligible(didim.identify(logged(robot(), coulomb, 1000), "idim-ls"))


def test_intervals_include_what_noisy_readings_move() -> None:
    fit = didim.identify(noisy(), "idim-ls")
    assert fit.uncertainty is not None
    factor, noise = fit.uncertainty.factor(0.95), fit.uncertainty.without_shift(fit.std)
    error = fit.beta - truth()
    assert np.mean(np.abs(error) <= factor * noise) < 0.9 < 0.95 < np.mean(np.abs(error) <= factor * fit.std)
    assert (
        np.corrcoef(error / noise, shift(fit) / noise)[0, 1] > 0.8
    )  # the shift is that of this log, with its sign
    assert "noise and steps of the positions move parameters by up to" in str(fit)


@pytest.mark.parametrize("measured", [False, True], ids=["positions", "velocities"])
def test_intervals_include_the_bias_of_noisy_columns(measured: bool) -> None:
    """Noise of positions or of measured velocities shortens inertias in every stretch alike, in this log with its sign."""
    log = logged(robot(), coulomb, 1000)
    (recording,) = log.recordings
    rng = np.random.default_rng(1)
    if measured:
        velocity = np.gradient(recording.q, axis=0) * recording.rate_hz
        noisy = replace(recording, dq=velocity + 0.05 * rng.standard_normal(velocity.shape))
    else:
        noisy = replace(recording, q=recording.q + 5e-4 * rng.standard_normal(recording.q.shape))
    fit = didim.identify(replace(log, recordings=(noisy,)), "idim-ls")
    assert fit.uncertainty is not None
    noise, error = fit.uncertainty.without_shift(fit.std), fit.beta - truth()
    assert np.corrcoef(error / noise, shift(fit) / noise)[0, 1] > 0.9
    factor = fit.uncertainty.factor(0.95)
    assert np.mean(np.abs(error) <= factor * noise) < 0.85 < 0.9 < np.mean(np.abs(error) <= factor * fit.std)
    assert "noise and steps of the positions move parameters by up to" in str(fit)


def test_measured_velocities_and_simulated_motion_have_no_steps() -> None:
    log = logged(robot(), coulomb, 1000, counts=4096)
    (recording,) = log.recordings
    velocity = np.gradient(logged(robot(), coulomb, 1000).recordings[0].q, axis=0) * recording.rate_hz
    measured: Experiment = replace(log, recordings=(replace(recording, dq=velocity),))
    assert negligible(didim.identify(measured, "idim-ls"))
    simulated = closed_loop_log(subject().robot, subject().x, duration_s=4.0)
    assert not shift(didim.identify(simulated, "didim")).any()


def test_windows_delays_and_other_uncertainties(tmp_path: Path) -> None:
    log = logged(robot(), coulomb, 1000, counts=4096)
    (recording,) = log.recordings
    windows = replace(recording, windows=((0, 2400), (2500, 5000)))
    fit = didim.identify(replace(log, recordings=(windows,)), didim.IDIMLS(compensate_samples=(0.4, 1.3)))
    assert shift(fit).all()
    fit.save(tmp_path / "fit.json")
    assert np.array_equal(shift(Identification.load(tmp_path / "fit.json")), shift(fit))

    white = didim.identify(noisy(), didim.IDIMLS(uncertainty="white"))
    assert white.uncertainty is not None
    assert shift(white).any()
    np.testing.assert_array_equal(white.std, white.uncertainty.without_shift(white.std))
    assert "sigma does not include this" in str(white)
