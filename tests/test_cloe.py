"""CLOE: Levenberg and Marquardt arrive, the simplex walks, and what cannot be simulated stops neither."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.compare import packaged_experiment, simulated_log
from didim.errors import FitError
from didim.experiment import Experiment
from didim.identification import Identification, Iteration
from didim.signals import white_noise
from didim.status import Status


@pytest.fixture(scope="module")
def tx40() -> Experiment:
    experiment = packaged_experiment("tx40")
    return simulated_log(experiment, experiment.robot.parameter_set("didim"))


@pytest.fixture(scope="module")
def truth(tx40: Experiment) -> np.ndarray:
    return tx40.robot.base_parameters.project(tx40.robot.parameter_set("didim"))


@pytest.fixture(scope="module")
def arrived(tx40: Experiment) -> Identification:
    return didim.identify(tx40, didim.CLOE())


def test_levenberg_marquardt_arrives_from_21(
    tx40: Experiment, truth: np.ndarray, arrived: Identification
) -> None:
    assert arrived.status is Status.CONVERGED
    assert arrived.method == "cloe-levenberg-marquardt"
    well = arrived.relative_std_percent < 20.0
    off = (arrived.beta - truth) / arrived.std
    assert np.abs(off[well]).max() < 3.5
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.4
    # No higher than at the truth: the norm (19) there is that of the encoder noise.
    at_truth = didim.identify(tx40, didim.CLOE(start="didim", max_iterations=1))
    norm = "position_error_norm"
    assert arrived.settings["cloe"][norm] <= at_truth.settings["cloe"][norm] * (1.0 + 1e-4)
    assert arrived.history[-1].more["cost_per_row"] == pytest.approx(1.0, abs=0.03)
    correlation = arrived.covariance / np.outer(arrived.std, arrived.std)
    assert np.abs(correlation).max() <= 1.0 + 1e-9


def test_the_noise_of_the_encoders_is_seen(tx40: Experiment) -> None:
    noise = white_noise(tx40.recordings[0].q)
    np.testing.assert_allclose(noise, [1e-6, 1e-6, 2e-6, 2e-6, 2e-6, 3e-6], rtol=0.06)


def test_the_simplex_goes_down_and_counts() -> None:
    arm = short_arm()
    told: list[Iteration] = []

    def callback(iteration: Iteration) -> bool:
        told.append(iteration)
        return False

    start = 0.8 * arm.robot.base_parameters.project(arm.robot.parameter_set("reference"))
    fit = didim.identify(
        arm, didim.CLOE(optimizer="nelder-mead", start=start, max_iterations=25), callback=callback
    )
    assert fit.status is Status.NOT_CONVERGED
    record = fit.settings["cloe"]
    assert record["final_norm"] < record["initial_norm"]
    assert record["iterations"] == 25
    assert record["evaluations"] <= fit.n_simulations
    assert not fit.std.any()
    assert told
    assert "no standard deviations" in fit.remarks[0]


def test_emps_by_both_optimisers(project: Path, shared: Path) -> None:
    experiment = didim.load_experiment(project / "examples" / "emps.toml", data=shared / "data" / "emps")
    fits = [didim.identify(experiment, didim.CLOE(start=start)) for start in ("idim-ls", {"M1R": 80.0})]
    for fit in fits:
        assert fit.converged
        np.testing.assert_allclose(fit.beta, fits[0].beta, rtol=1e-5)
        assert (fit.std > 0.0).all()
    for start in ("idim-ls", {"M1R": 80.0}):
        simplex = didim.identify(
            experiment, didim.CLOE(optimizer="nelder-mead", start=start, variant="scaled")
        )
        np.testing.assert_allclose(simplex.beta, fits[0].beta, rtol=1e-3)
    published = didim.identify(experiment, didim.CLOE(start="published", max_iterations=1))
    key = "position_error_norm"
    assert fits[0].settings["cloe"][key] <= published.settings["cloe"][key]
    torque = didim.identify(experiment, didim.CLOE(output="torque", start="idim-ls"))
    assert torque.method == "clie-levenberg-marquardt"
    np.testing.assert_allclose(torque.beta, fits[0].beta, rtol=0.02)


def short_arm() -> Experiment:
    """A planar arm for a second: quick, and with friction everywhere."""
    robot = didim.load_robot("planar2").with_friction(coulomb="tanh", smoothing_rad_s=0.05)
    reference = didim.Reference.random_fourier(
        harmonics=6,
        period_s=1.0,
        max_position=[1.0, 1.0],
        max_velocity=[4.0, 4.0],
        max_acceleration=[60.0, 60.0],
        seed=2,
    )
    controller = didim.Controller.tuned([15.0, 15.0], 0.7, [1.0, 0.3])
    experiment = Experiment(
        name="arm", robot=robot, recordings=(), reference=reference, controller=controller
    )
    return simulated_log(experiment, robot.parameter_set("reference"))


@pytest.mark.parametrize("output", ["position", "torque", "both"])
def test_every_output_finds_the_truth_without_noise(output: str) -> None:
    arm = short_arm()
    truth = arm.robot.base_parameters.project(arm.robot.parameter_set("reference"))
    start = truth * np.linspace(0.7, 1.4, truth.size)
    fit = didim.identify(arm, didim.CLOE(output=output, start=start))  # type: ignore[arg-type]
    np.testing.assert_allclose(fit.beta, truth, rtol=1e-3, atol=1e-3 * np.abs(truth).max())


def test_a_start_that_cannot_be_simulated_is_named() -> None:
    arm = short_arm()
    wrong = -arm.robot.base_parameters.project(arm.robot.parameter_set("reference"))
    for optimizer in ("levenberg-marquardt", "nelder-mead"):
        with pytest.raises(
            FitError, match=r"^arm: CLOE cannot start from these parameters: .* joint 1 feels"
        ):
            didim.identify(arm, didim.CLOE(optimizer=optimizer, start=wrong))


def test_stopping_keeps_the_best_point() -> None:
    arm = short_arm()
    truth = arm.robot.base_parameters.project(arm.robot.parameter_set("reference"))
    start = truth * np.linspace(0.7, 1.4, truth.size)
    fit = didim.identify(arm, didim.CLOE(start=start), callback=lambda iteration: True)
    assert fit.status is Status.STOPPED
    assert fit.n_iterations == 1
    assert fit.history[0].relative_error < 0.5
    assert not np.array_equal(fit.beta, start)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: didim.CLOE(optimizer="magic"), "optimizer must be one of"),  # type: ignore[arg-type]
        (lambda: didim.CLOE(output="speed"), "output must be one of"),  # type: ignore[arg-type]
        (lambda: didim.CLOE(max_iterations=0), "max_iterations must be a whole number"),
        (lambda: didim.CLOE(tolerance=2.0), "tolerance must be at least 0"),
    ],
)
def test_wrong_settings(make: Callable[[], object], message: str) -> None:
    with pytest.raises(FitError, match=message):
        make()
