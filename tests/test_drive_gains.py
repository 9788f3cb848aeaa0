"""Drive gains by maximum likelihood, beside ordinary least squares (benches/payloads.py has 40 seeds of a UR5e)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim import Experiment
from didim.errors import FitError
from didim.log.recording import Recording
from didim.methods.method import MethodSettings
from didim.regression.gains.currents import Currents
from didim.regression.gains.maximum_likelihood import drive_gains, expected_percent
from didim.regression.settings import LeastSquaresSettings
from didim.robot.friction import FrictionTerm
from didim.robot.payload import Payload, last_link
from didim.terms.rows import LinearSystem
from several import DISC, arm_logs

pytestmark = pytest.mark.usefixtures("without_verdict")

Array = NDArray[np.float64]

GAINS = np.array([9.0, 5.0])
NOISE = np.array([0.05, 0.05])
WHITE = LeastSquaresSettings(weights="per-joint", uncertainty="white")
MASS = {"disc": Payload(name="disc", mass_kg=float(DISC[9]))}
WRIST = np.array([[20.0, 0.0], [10.0, 30.0]])
"""Reduction of an arm whose second motor turns with the first joint."""


def currents(reduction: Array, gains: Array, noise: Array = NOISE, seed: int = 0) -> Experiment:
    """Two logs of the planar arm, the second with the disc, as currents of its motors."""
    experiment = arm_logs([False, True], payloads=MASS)
    rng = np.random.default_rng(seed)
    recordings = []
    for item in experiment.recordings:
        assert item.tau is not None
        current = item.tau @ np.linalg.inv(reduction) / gains
        current += rng.standard_normal(current.shape) * noise
        recordings.append(
            replace(item, tau=current @ reduction, drives=tuple(map(tuple, reduction.tolist())))
        )
    return replace(experiment, recordings=tuple(recordings))


def system_of(experiment: Experiment) -> LinearSystem:
    job = didim.IDIMLS().job(experiment)
    return job.system(job.parts("fit"))


@pytest.mark.parametrize("reduction", [np.eye(2), WRIST], ids=["joints", "coupled motors"])
def test_gains_are_found_without_noise_from_any_start(reduction: Array) -> None:
    gains = GAINS / np.diag(reduction)
    system = system_of(currents(reduction, gains, 0.0 * NOISE))
    for start in (None, 0.7 * gains, 1.3 * gains, np.ones(2)):
        found = drive_gains(system, reduction, WHITE, start)
        # The filter of the positions is in it, as for every estimate along measured motion.
        np.testing.assert_allclose(found.gains, gains, rtol=3e-3)
        assert found.fit.converged


def test_a_motor_that_runs_backwards_has_a_negative_gain() -> None:
    gains = GAINS * [1.0, -1.0]
    fit = didim.identify(currents(np.eye(2), gains), didim.IDIMLS())
    assert fit.further is not None
    assert fit.further.gains is not None
    np.testing.assert_allclose(fit.further.gains, gains, rtol=0.05)


@pytest.mark.slow
def test_maximum_likelihood_is_unbiased_and_calibrated_where_ols_is_not() -> None:
    scores, ols = [], []
    exact = drive_gains(system_of(currents(np.eye(2), GAINS, 0.0 * NOISE)), np.eye(2), WHITE).gains
    for seed in range(12):
        system = system_of(currents(np.eye(2), GAINS, 20.0 * NOISE, seed))
        found = drive_gains(system, np.eye(2), replace(WHITE, uncertainty="decimated"))
        off = drive_gains(system, np.eye(2), WHITE, start=0.7 * GAINS)
        np.testing.assert_allclose(off.gains, found.gains, rtol=1e-6)
        std = np.sqrt(np.diag(found.fit.covariance))[-2:]
        scores.append((found.gains - exact) / std)
        of_motors = Currents.of(system, np.eye(2))
        # The noisy currents are columns: [diag(i) -W] [K; theta] = t.
        a = np.hstack([of_motors.motors * of_motors.current[:, None], -of_motors.columns])
        ols.append(np.linalg.lstsq(a, of_motors.known, rcond=None)[0][:2])
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.4
    # Ordinary least squares is biased towards small gains, beyond all spread.
    many = np.array(ols)
    assert (many.mean(axis=0) + 3.0 * many.std(axis=0) < exact).any()
    assert (many.mean(axis=0) < exact).all()


def test_what_a_log_promises_of_the_gains_is_what_it_gives() -> None:
    system = system_of(currents(np.eye(2), np.array([7.0, 7.0])))
    expected = expected_percent(system, np.eye(2))
    found = drive_gains(system, np.eye(2), WHITE)
    std = 100.0 * np.sqrt(np.diag(found.fit.covariance))[-2:] / found.gains
    np.testing.assert_allclose(expected, std, rtol=0.35)


def truth_of(experiment: Experiment, gains: Array) -> Array:
    """Base parameters, payload and gains, in the order of a result."""
    robot = experiment.robot
    beta = robot.base_parameters.project(robot.parameter_set("reference"))
    return np.concatenate([beta, DISC[[5, 6, 7]], gains])


def estimate_of(fit: didim.Identification) -> tuple[Array, Array]:
    """All parameters of a result, and their standard deviations."""
    assert fit.further is not None
    return np.concatenate([fit.beta, fit.further.values]), np.concatenate([fit.std, fit.further.std])


@pytest.mark.parametrize("reduction", [np.eye(2), WRIST], ids=["joints", "coupled motors"])
def test_didim_finds_gains_robot_and_payload_without_noise(reduction: Array) -> None:
    gains = GAINS / np.diag(reduction)
    experiment = currents(reduction, gains, 0.0 * NOISE)
    # From unit rotors, which know nothing of the torques, and from IDIM-LS.
    for start in (None, "idim-ls"):
        fit = didim.identify(experiment, didim.DIDIM(start=start))
        assert fit.converged
        np.testing.assert_allclose(estimate_of(fit)[0], truth_of(experiment, gains), atol=1e-5)
        assert fit.output_error is not None
        assert fit.output_error[1] < 1e-6
    # Along the measured motion the filter of the positions is in the estimate.
    fit = didim.identify(experiment, didim.IDIMIV())
    np.testing.assert_allclose(estimate_of(fit)[0], truth_of(experiment, gains), atol=1e-2)
    assert fit.further is not None
    np.testing.assert_allclose(fit.further.values[-2:], gains, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("method", [didim.IDIMIV(), didim.DIDIM()], ids=lambda item: item.name)
def test_errors_of_gains_and_all_else_are_as_large_as_sigma_says(method: didim.DIDIM) -> None:
    scores = []
    for seed in range(6):
        experiment = currents(np.eye(2), GAINS, 4.0 * NOISE, seed)
        value, std = estimate_of(didim.identify(experiment, method))
        scores.append((value - truth_of(experiment, GAINS)) / std)
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.3
    # With gains that are known the parameters are known better: their part of sigma is in it.
    fit = didim.identify(experiment, method)
    known = didim.identify(experiment.with_gains(GAINS), method)
    assert fit.std[0] > 1.2 * known.std[0]


def test_cloe_compares_positions_and_has_the_gains_of_idim_ls() -> None:
    experiment = currents(np.eye(2), GAINS)
    # Encoder noise well above the integration error of the logs, whose steps are those of the experiment.
    rng = np.random.default_rng(1)
    experiment = replace(
        experiment,
        recordings=tuple(
            replace(item, q=item.q + 1e-6 * rng.standard_normal(item.q.shape))
            for item in experiment.recordings
        ),
    )
    fit = didim.identify(experiment, didim.CLOE(start="idim-ls"))
    direct = didim.identify(experiment, didim.IDIMLS())
    assert fit.further is not None
    assert direct.further is not None
    np.testing.assert_array_equal(fit.further.values[-2:], direct.further.values[-2:])
    np.testing.assert_array_equal(fit.further.std[-2:], direct.further.std[-2:])
    value, std = estimate_of(fit)
    assert np.sqrt(np.mean(((value - truth_of(experiment, GAINS)) / std) ** 2)) < 2.0
    assert any("positions do not identify drive gains" in text for text in fit.remarks)
    # Estimates of the robot are those of CLOE on torques that these gains give.
    torques = didim.identify(experiment.with_gains(direct.further.values[-2:]), didim.CLOE(start="idim-ls"))
    np.testing.assert_allclose(fit.beta, torques.beta, rtol=1e-9)


def test_results_print_and_keep_gains_and_predict_currents_as_torques(tmp_path: Path) -> None:
    experiment = currents(np.eye(2), GAINS)
    fit = didim.identify(experiment, didim.IDIMLS())
    assert "drive gains" in str(fit)
    assert any(text.startswith("expected standard deviations of the drive gains") for text in fit.remarks)
    fit.save(tmp_path / "fit.json")
    again = didim.Identification.load(tmp_path / "fit.json")
    assert again.further is not None
    gains = again.further.gains
    assert gains is not None
    np.testing.assert_allclose(gains, GAINS, rtol=0.02)
    validation = didim.validate(again, replace(experiment, reference=None))
    assert all(item.direct is not None and (item.direct < 0.1).all() for item in validation.recordings)


def test_what_cannot_be_known_is_said() -> None:
    experiment = currents(np.eye(2), GAINS)
    with pytest.raises(FitError, match="only ratios of parameters to drive gains"):
        didim.identify(replace(experiment, payloads={"disc": Payload(name="disc")}), didim.IDIMLS())
    with pytest.raises(FitError, match="drive gains are unknown: identify them by idim-ls"):
        MethodSettings().job(experiment)
    with pytest.raises(FitError, match=r"compares torques, but experiment .* has currents"):
        didim.identify(experiment, didim.CLOE(output="torque"))
    with pytest.raises(FitError, match="physically consistent solution needs torques"):
        didim.identify(experiment, didim.DIDIM(physical=True))
    with pytest.raises(FitError, match="delay of currents with unknown gains is not estimated"):
        didim.identify(experiment, didim.DIDIM(compensate_samples="estimate"))
    asked = FrictionTerm(law="atan", joint=0, velocity=0.1, estimated=True)
    with pytest.raises(FitError, match="need torques, and recordings have currents"):
        didim.identify(replace(experiment, robot=experiment.robot.with_terms([asked])), didim.IDIMLS())
    one, two = experiment.recordings
    with pytest.raises(FitError, match="do not both have currents"):
        didim.identify(replace(experiment, recordings=(one, replace(two, drives=None))), didim.IDIMLS())
    bare = didim.identify(arm_logs([False]), didim.IDIMLS())
    with pytest.raises(FitError, match="has no drive gains"):
        didim.validate(bare, replace(experiment, recordings=(one,)))


def test_a_load_that_a_joint_does_not_feel_leaves_its_gain_unknown() -> None:
    """A vertical first axis and a load on it: gravity does not reach its motor, and nothing is known of the inertia."""
    robot = didim.load_robot("tx40")
    frame = np.eye(4)
    place = last_link(robot, frame)
    assert place.shape == (len(robot.parameter_names), 10)
    recordings = []
    for seed, payload in ((1, "none"), (2, "load")):
        reference = didim.Reference.random_fourier(
            harmonics=6, period_s=6.0, max_position=[1.5] * 6, max_velocity=[2.0] * 6, max_acceleration=[8.0] * 6, seed=seed
        )  # fmt: skip
        t = np.arange(0.0, 6.0, 0.005)
        q, dq, ddq = reference.at(t)
        x = robot.parameter_set("didim") + (0.0 if payload == "none" else place[:, 9] * 2.0)
        tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
        tau += np.random.default_rng(seed).standard_normal(tau.shape) * 0.3
        item = Recording.from_arrays(q, tau / 10.0, rate_hz=200.0, name=payload)
        recordings.append(replace(item, payload=payload, drives=tuple(map(tuple, np.eye(6).tolist()))))
    experiment = Experiment(
        name="tx40",
        robot=robot,
        recordings=tuple(recordings),
        signal=didim.SignalProcessing(cutoff_hz=30.0, trim_start=20, trim_end=20, decimation=(4,)),
        payloads={"load": Payload(name="load", mass_kg=2.0)},
    )
    percent = expected_percent(system_of(experiment), np.eye(6))
    assert percent[0] > 2.5 * percent[1]


@pytest.mark.slow
def test_a_real_ur10e_pair_of_currents(shared: Path) -> None:
    """The gains of an independent prototype, and the mass of the load with these (docs/several_logs.md)."""
    file = Path(__file__).resolve().parents[1] / "examples" / "ur10e_currents.toml"
    experiment = didim.load_experiment(file, data=shared / "data" / "ur10e")
    fit = didim.identify(experiment, didim.IDIMLS())
    assert fit.further is not None
    prototype = np.array([10.56, 12.38, 9.95, 10.38, 10.27, 10.31])
    sigma = np.array([0.67, 0.16, 0.12, 0.24, 0.23, 0.23])
    assert fit.further.gains is not None
    assert (np.abs(fit.further.gains - prototype) < np.minimum(sigma, fit.further.std[-6:])).all()
    np.testing.assert_allclose(fit.further.gains, [10.87, 12.31, 10.00, 10.39, 10.30, 10.27], atol=0.02)
    np.testing.assert_allclose(fit.further.std[-6:], [0.78, 0.26, 0.21, 0.24, 0.26, 0.18], atol=0.02)
    assert "centre of mass: 28.6 +- 1.8, 163.9 +- 3.0, 41.2 +- 4.1 mm" in str(fit)
    torques = replace(
        experiment,
        recordings=tuple(item.with_gains(prototype) for item in experiment.recordings),
        payloads={"load": Payload(name="load")},
    )
    weighed = didim.identify(torques, didim.IDIMLS())
    assert weighed.further is not None
    mass, std = weighed.further.values[-1], weighed.further.std[-1]
    assert std < 0.06
    assert abs(mass - 2.805) < 2.0 * std
