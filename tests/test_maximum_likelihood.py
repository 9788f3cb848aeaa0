"""Maximum likelihood with noise in positions and torques, as a method."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

import didim
from didim import Experiment, SignalProcessing, identify
from didim.contrib.maximum_likelihood import MaximumLikelihood
from didim.contrib.partials import torque_partials
from didim.errors import FitError
from didim.signal.decimation import decimate, decimation_stages
from didim.signal.filters import differentiate
from didim.signal.noise import row_noise
from didim.studies.simulated_log import measured


@pytest.fixture(scope="module")
def arm(project: Path) -> Experiment:
    experiment = didim.load_experiment(project / "examples" / "planar2_simulation.toml")
    signal = SignalProcessing(cutoff_hz=100, trim_start=50, trim_end=50)
    experiment = replace(experiment, signal=signal)
    return didim.simulated_log(experiment, experiment.robot.parameter_set("reference"), noise=False)


def noisy(arm: Experiment, factor: float, seed: int) -> Experiment:
    """The log with so many times its encoder noise."""
    assert arm.measurement is not None
    noise = tuple(factor * value for value in (2e-5, 2e-5))
    return measured(replace(arm, measurement=replace(arm.measurement, position_noise=noise)), seed)


@pytest.mark.parametrize(
    "signal",
    [
        SignalProcessing(),
        SignalProcessing(cutoff_hz=100.0),
        SignalProcessing(cutoff_hz=40.0, order=2, decimation=(4,)),
        SignalProcessing(cutoff_hz=100.0, decimation=(3, 5)),
    ],
    ids=["plain", "filtered", "decimated", "two-stages"],
)
def test_noise_of_the_rows_is_that_of_filtered_noise(signal: SignalProcessing) -> None:
    noise = np.random.default_rng(0).standard_normal((6000, 30))
    found = []
    for values in (noise, *differentiate(noise, 500.0, signal)):
        rows = decimate(np.ascontiguousarray(values), decimation_stages(len(values), signal))
        found.append(float(np.std(rows[40:-40])))
    assert row_noise(signal, 500.0) == pytest.approx(found, rel=0.02)


def test_partials_are_the_slopes_of_the_inverse_model() -> None:
    robot = didim.load_robot("tx40").with_smoothing([0.05] * 6)
    x = robot.parameter_set("didim")
    rng = np.random.default_rng(3)
    q, dq, ddq, *moves = (rng.standard_normal((4, 6)) for _ in range(6))
    partials = torque_partials(robot, q, dq, ddq, x)
    slope = sum(np.einsum("tij,tj->ti", part, move) for part, move in zip(partials, moves, strict=True))
    step = 1e-4
    along = [
        didim.inverse_dynamics(
            robot, q + k * step * moves[0], dq + k * step * moves[1], ddq + k * step * moves[2], x
        )
        for k in (-2, -1, 1, 2)
    ]
    fourth = (along[0] - 8.0 * along[1] + 8.0 * along[2] - along[3]) / (12.0 * step)
    assert slope == pytest.approx(fourth, rel=1e-5, abs=1e-4)


def test_without_noise_of_the_motion_it_is_least_squares_with_the_noise_of_the_torques(
    arm: Experiment,
) -> None:
    log = noisy(arm, 1e-3, 1)
    fit = identify(log, MaximumLikelihood(position_noise=[1e-15, 1e-15], torque_noise=[2.0, 0.5]))
    job = MaximumLikelihood().job(log)
    system = job.system(job.parts("fit", job.delay()))
    n = system.y.size // 2
    weights = np.repeat([0.5, 2.0], n)
    expected = np.linalg.lstsq(system.w * weights[:, None], system.y * weights, rcond=None)[0]
    assert fit.beta == pytest.approx(expected, rel=1e-6)
    assert fit.converged
    assert fit.method == "ml"
    assert fit.uncertainty is not None
    assert fit.uncertainty.kind == "jackknife"


def test_it_is_the_definition_computed_from_the_log_in_other_ways(arm: Experiment) -> None:
    """Filter, slopes, noise of the rows, weights and solution by other means than those of the package."""
    log = noisy(arm, 20.0, 2)
    (item,) = log.recordings
    assert item.tau is not None
    sizes, torque_noise = np.array([4e-4, 4e-4]), np.array([0.5, 0.3])
    sos = butter(log.signal.order, 100.0, fs=item.rate_hz, output="sos")

    def motion(q: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        q = sosfiltfilt(sos, q, axis=0)
        dq = np.gradient(q, 1.0 / item.rate_hz, axis=0)
        return [rows[50:-50] for rows in (q, dq, np.gradient(dq, 1.0 / item.rate_hz, axis=0))]

    q, dq, ddq = motion(item.q)
    impulse = np.zeros((len(item.q), 1))
    impulse[len(item.q) // 2] = 1.0
    gains = [np.linalg.norm(response) for response in motion(impulse)]
    robot, tau = log.robot, item.tau[50:-50]
    base = robot.base_parameters
    basis = np.array([base.lift(row) for row in np.eye(len(base.names))])
    w = np.stack([didim.inverse_dynamics(robot, q, dq, ddq, x) for x in basis], axis=2)
    beta = np.linalg.lstsq(w.reshape(-1, w.shape[2]), tau.ravel(), rcond=None)[0]
    first = beta
    for _ in range(20):
        x = base.lift(beta)
        covariance = np.tile(np.diag(torque_noise**2), (len(q), 1, 1))
        for signal, gain in enumerate(gains):
            for joint in range(2):
                step = np.zeros((3, 1, 2))
                step[signal, 0, joint] = 1e-6
                up, down = (
                    didim.inverse_dynamics(
                        robot, q + side * step[0], dq + side * step[1], ddq + side * step[2], x
                    )
                    for side in (1.0, -1.0)
                )
                slope = (up - down) / 2e-6 * gain * sizes[joint]
                covariance += slope[:, :, None] * slope[:, None, :]
        weights = np.linalg.inv(covariance)
        normal = np.einsum("tia,tij,tjb->ab", w, weights, w)
        beta = np.linalg.solve(normal, np.einsum("tia,tij,tj->a", w, weights, tau))
    method = MaximumLikelihood(
        position_noise=sizes.tolist(), torque_noise=torque_noise.tolist(), compensate_samples=0.0
    )
    fit = identify(log, method)
    assert fit.converged
    assert np.abs((fit.beta - beta) / fit.std_white).max() < 0.01
    # The weights matter here: least squares is somewhere else.
    assert np.abs((first - beta) / fit.std_white).max() > 3.0


def test_the_packaged_log_gives_nearly_the_estimate_of_least_squares() -> None:
    experiment = didim.packaged_experiment("tx40")
    log = didim.simulated_log(experiment, experiment.robot.parameter_set("didim"), seed=1)
    fit, plain = identify(log, MaximumLikelihood()), identify(log)
    assert fit.converged
    # Decimation averages the noise of the motion away, so there is little to weight.
    assert np.sqrt(np.mean(((fit.beta - plain.beta) / plain.std) ** 2)) < 0.3
    assert np.median(fit.std / plain.std) == pytest.approx(1.0, abs=0.1)
    noise = fit.settings["maximum_likelihood"]
    assert noise["position_noise"] == pytest.approx([1e-6, 1e-6, 2e-6, 2e-6, 2e-6, 3e-6], rel=0.05)
    share = row_noise(log.signal, 1000.0)[0]
    assert noise["torque_noise"] == pytest.approx(share * np.array([0.5, 0.5, 0.2, 0.1, 0.1, 0.1]), rel=0.15)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"position_noise": [1.0, -1.0]}, "position_noise needs positive numbers, one per joint, got"),
        ({"max_iterations": 0}, "max_iterations must be a whole number of at least 1, got 0"),
    ],
)
def test_wrong_settings(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(FitError, match=message):
        MaximumLikelihood(**wrong)  # type: ignore[arg-type]


def test_noise_of_another_number_of_joints(arm: Experiment) -> None:
    with pytest.raises(FitError, match="torque_noise needs 2 numbers, one per joint, got 3"):
        identify(noisy(arm, 1.0, 0), MaximumLikelihood(torque_noise=[1.0, 1.0, 1.0]))
