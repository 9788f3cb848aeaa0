"""The extended Kalman filter: near the truth from a near start, and a named end where it diverges."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim import Experiment, identify
from didim.contrib.ekf import EKF
from didim.log.recording import Recording
from didim.studies.simulated_log import measured, simulated_log


@pytest.fixture(scope="module")
def log(project: Path) -> Experiment:
    experiment = didim.load_experiment(project / "examples" / "planar2_simulation.toml")
    signal = didim.SignalProcessing(cutoff_hz=100, trim_start=50, trim_end=50, decimation=(10,))
    # A filter that takes every sample as it comes is thrown off by the jump of a controller that takes over a held robot.
    simulation = replace(experiment.simulation, controller_start="zero")
    experiment = replace(experiment, signal=signal, simulation=simulation)
    exact = simulated_log(experiment, experiment.robot.parameter_set("reference"), noise=False)
    return measured(exact, 1)


def test_it_comes_near_the_truth(log: Experiment) -> None:
    truth = log.robot.base_parameters.project(log.robot.parameter_set("reference"))
    fit = identify(log, EKF(start=1.1 * truth))
    assert fit.converged
    assert fit.method == "ekf"
    known = np.abs(truth) > 0.2
    assert np.abs(fit.beta[known] / truth[known] - 1.0).max() < 0.05
    assert len(fit.history) == 10
    assert any("too small" in remark for remark in fit.remarks)
    assert fit.overall_relative_error < 0.1


def test_a_far_start_diverges_with_a_sentence(log: Experiment) -> None:
    truth = log.robot.base_parameters.project(log.robot.parameter_set("reference"))
    fit = identify(log, EKF(start=0.02 * truth, prior=30.0))
    if fit.status is didim.Status.NOT_CONVERGED:
        assert any("diverged after" in remark for remark in fit.remarks)
        assert not fit.std.any()
    else:
        assert fit.converged


def test_the_callback_stops_it(log: Experiment) -> None:
    fit = identify(log, EKF(), callback=lambda iteration: iteration.iteration == 3)
    assert fit.status is didim.Status.STOPPED
    assert len(fit.history) == 3


def test_wrong_calls(log: Experiment) -> None:
    with pytest.raises(didim.errors.FitError, match="prior must be a positive number"):
        EKF(prior=0.0)
    with pytest.raises(didim.errors.FitError, match="takes no delay"):
        identify(log, EKF(compensate_samples=1.0))


def test_a_log_of_more_than_half_a_million_samples_is_refused(log: Experiment) -> None:
    rest = np.zeros((500_001, 2))
    long = Recording.from_arrays(rest, rest, rate_hz=250.0, name="long")
    with pytest.raises(didim.errors.FitError, match="at most 500000 samples, and the log has 500001"):
        identify(replace(log, recordings=(long,)), EKF())
