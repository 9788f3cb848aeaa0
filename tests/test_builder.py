"""One builder for the result of every method: rows, degrees of freedom and errors agree with `predict` and `validate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from didim import CLOE, DIDIM, IDIMLS, Identification, identify, validate
from didim.errors import FitError
from didim.experiment.experiment import Experiment
from didim.experiment.experiment_file import load_experiment
from didim.regression.settings import LeastSquaresSettings
from didim.signal.window import DelaySettings
from didim.studies.prediction import predict, relative_errors
from didim.studies.simulated_log import simulated_log

Array = NDArray[np.float64]
Method = IDIMLS | DIDIM | CLOE

SEARCH = CLOE(start="idim-ls", max_iterations=3)
METHODS = (IDIMLS(), DIDIM(), SEARCH, replace(SEARCH, optimizer="nelder-mead"))


def short(experiment: Experiment, n_samples: int = 1500) -> Experiment:
    """Return the experiment with a short window of its only recording, trimmed unevenly."""
    (recording,) = experiment.recordings
    windows = ((0, n_samples),)
    signal = replace(experiment.signal, trim_start=40, trim_end=90)
    return replace(experiment, recordings=(replace(recording, windows=windows),), signal=signal)


@pytest.fixture(scope="module")
def arm(project: Path) -> Experiment:
    experiment = load_experiment(project / "examples" / "planar2_simulation.toml")
    return short(simulated_log(experiment, experiment.robot.parameter_set("reference")))


def late(experiment: Experiment, samples: int) -> Experiment:
    """Return the experiment with torques recorded late, and compensated."""
    (recording,) = experiment.recordings
    assert recording.tau is not None
    tau = np.roll(recording.tau, samples, axis=0)
    return replace(
        experiment,
        recordings=(replace(recording, tau=tau),),
        delay=DelaySettings(compensate_samples=float(samples)),
    )


def check(fit: Identification, experiment: Experiment, tolerance: float) -> None:
    """Rows, errors and degrees of freedom of a result are those of its predictions."""
    predictions = predict(fit, experiment)
    rows = sum(item.measured.size for item in predictions)
    assert fit.n_rows == rows
    np.testing.assert_allclose(fit.relative_error, relative_errors(predictions), rtol=tolerance)
    norm = np.linalg.norm(np.concatenate([item.residual for item in predictions]))
    assert fit.error_norm == pytest.approx(norm, rel=tolerance)
    estimated = sum(role == "estimated" for role in fit.roles)
    assert fit.error_std == pytest.approx(norm / np.sqrt(rows - estimated), rel=tolerance)


@pytest.mark.parametrize("samples", [0, 3])
@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_errors_are_those_of_the_predictions(method: Method, samples: int, arm: Experiment) -> None:
    experiment = late(arm, samples)
    # The errors of DIDIM are those along the motion before its last step.
    check(identify(experiment, method), experiment, 0.02 if isinstance(method, DIDIM) else 1e-6)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_the_divisor_of_the_settings_counts_for_every_method(method: Method, arm: Experiment) -> None:
    by_1 = replace(arm, least_squares=LeastSquaresSettings(variance="r-1"))
    fit = identify(by_1, method)
    assert fit.error_std == pytest.approx(fit.error_norm / np.sqrt(fit.n_rows - 1), rel=1e-12)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_trimming_that_leaves_nothing_is_refused_by_every_method(method: Method, arm: Experiment) -> None:
    nothing = replace(arm, signal=replace(arm.signal, trim_start=800, trim_end=800))
    with pytest.raises(
        FitError,
        match=r"recording 'simulated log', window of samples 0 to 1500: trimming 800 and 800 samples leaves nothing of 1(500|497)",
    ):
        identify(nothing, method)


@pytest.mark.parametrize("method", METHODS[:3], ids=lambda method: method.name)
def test_recordings_held_out_have_the_errors_of_predict_and_validate(method: Method, arm: Experiment) -> None:
    """Along the measured motion the friction is that of the experiment, not the smooth one of its simulation."""
    (recording,) = arm.recordings
    other = replace(recording, name="other", role="held-out", windows=((0, 2500),))
    robot = arm.robot.with_friction(coulomb="sign")
    simulation = replace(arm.simulation, smoothing=(0.05, 0.05))
    both = replace(arm, recordings=(recording, other), robot=robot, simulation=simulation)
    fit = identify(both, method)
    (held_out,) = fit.held_out
    predicted = relative_errors(predict(fit, both, role="held-out"))
    np.testing.assert_allclose(held_out.relative_error, predicted, rtol=1e-12)
    validated = validate(fit, replace(both, recordings=(other,)))
    direct = validated.recordings[0].direct
    assert direct is not None
    np.testing.assert_allclose(held_out.relative_error, direct, rtol=1e-12)


def test_trim_and_delay_of_cloe_can_be_given_to_the_method(arm: Experiment) -> None:
    plain = replace(arm, signal=replace(arm.signal, trim_start=0, trim_end=0))
    method = CLOE(start="idim-ls", max_iterations=2)
    given = identify(late(plain, 2), replace(method, signal=arm.signal, compensate_samples=2.0))
    asked = identify(late(arm, 2), method)
    assert given.n_rows == asked.n_rows == (1500 - 130 - 2) * 2
    np.testing.assert_allclose(given.relative_error, asked.relative_error, rtol=0.05)


def test_results_of_version_0_1_0_are_predicted_along_the_motion_of_their_method(arm: Experiment) -> None:
    fit = identify(arm, CLOE(start="idim-ls", max_iterations=2))
    assert fit.settings["prediction"] == {"motion": "simulated", "raw": True}
    old = replace(fit, settings={key: value for key, value in fit.settings.items() if key != "prediction"})
    np.testing.assert_array_equal(predict(old, arm)[0].predicted, predict(fit, arm)[0].predicted)
