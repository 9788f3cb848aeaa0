"""Steps of encoders: how far they move an estimate, and the intervals that include it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.experiment.experiment import Experiment
from didim.result.identification import Identification
from friction_logs import coulomb, logged, robot, truth

pytestmark = pytest.mark.usefixtures("without_verdict")


def errors_in_sigma(arm: str, counts: int) -> tuple[list[Identification], np.ndarray]:
    fits = [
        didim.identify(logged(robot(arm), coulomb, 1000 + seed, of=arm, counts=counts), "idim-ls")
        for seed in range(3)
    ]
    return fits, np.array([fit.beta - truth(arm) for fit in fits])


def rounding(fit: Identification) -> np.ndarray:
    assert fit.uncertainty is not None
    return fit.uncertainty.rounding


@pytest.mark.parametrize("arm", ["planar2", "ur5e-like", "iiwa14-like"])
def test_intervals_of_coarse_encoders_hold(arm: str) -> None:
    fits, errors = errors_in_sigma(arm, 4096)
    inside, before, follows = [], [], []
    for fit, error in zip(fits, errors, strict=True):
        assert fit.uncertainty is not None
        factor, noise = fit.uncertainty.factor(0.95), fit.uncertainty.without_shift(fit.std)
        np.testing.assert_allclose(fit.std**2, noise**2 + rounding(fit) ** 2, rtol=1e-10)
        inside.append(np.abs(error) <= factor * fit.std)
        before.append(np.abs(error) <= factor * noise)
        follows.append(np.corrcoef(error / noise, rounding(fit) / noise)[0, 1])
        assert "the steps of the encoders move parameters by up to" in str(fit)
    assert np.mean(before) < 0.9 < 0.95 < np.mean(inside)
    assert np.mean(follows) > 0.8  # the shift is that of this log, with its sign


def test_fine_encoders_keep_their_intervals() -> None:
    fits, errors = errors_in_sigma("planar2", 2**16)
    inside = []
    for fit, error in zip(fits, errors, strict=True):
        assert fit.uncertainty is not None
        noise = fit.uncertainty.without_shift(fit.std)
        assert 0.0 < np.median(np.abs(rounding(fit)) / noise) < 0.2
        inside.append(np.abs(error) <= fit.uncertainty.factor(0.95) * fit.std)
        assert "steps of the encoders" not in str(fit)
    assert np.mean(inside) > 0.9
    assert not rounding(didim.identify(logged(robot(), coulomb, 1000), "idim-ls")).any()


def test_measured_velocities_and_simulated_motion_have_no_steps() -> None:
    log = logged(robot(), coulomb, 1000, counts=4096)
    (recording,) = log.recordings
    velocity = np.gradient(logged(robot(), coulomb, 1000).recordings[0].q, axis=0) * recording.rate_hz
    measured: Experiment = replace(log, recordings=(replace(recording, dq=velocity),))
    assert not rounding(didim.identify(measured, "idim-ls")).any()


def test_windows_delays_and_other_uncertainties(tmp_path: Path) -> None:
    log = logged(robot(), coulomb, 1000, counts=4096)
    (recording,) = log.recordings
    windows = replace(recording, windows=((0, 2400), (2500, 5000)))
    fit = didim.identify(replace(log, recordings=(windows,)), didim.IDIMLS(compensate_samples=(0.4, 1.3)))
    assert rounding(fit).all()
    fit.save(tmp_path / "fit.json")
    assert np.array_equal(rounding(Identification.load(tmp_path / "fit.json")), rounding(fit))

    white = didim.identify(log, didim.IDIMLS(uncertainty="white"))
    assert white.uncertainty is not None
    assert rounding(white).any()
    np.testing.assert_array_equal(white.std, white.uncertainty.without_shift(white.std))
    assert "sigma does not include this" in str(white)
