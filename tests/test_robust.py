"""Huber's and Tukey's estimators."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

import didim
from didim.regression.classical.robust import CONSTANTS, psi_weights, reweighted


def system(seed: int = 0, rows: int = 200, outliers: int = 0) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((2 * rows, 3)) * [1.0, 100.0, 0.01]
    truth = np.array([2.0, -0.03, 400.0])
    noise = rng.standard_normal(2 * rows)
    noise[rows:] *= 0.1  # the second joint is quieter
    y = a @ truth + noise
    y[rng.choice(rows, outliers, replace=False)] += 50.0
    return a, y, truth


JOINTS = (slice(0, 200), slice(200, 400))


def test_huber_minimises_the_sum_of_its_function() -> None:
    a, y, _ = system(outliers=10)
    start = np.linalg.lstsq(a, y, rcond=None)[0]
    found = reweighted(a, y, JOINTS, start, loss="huber")
    assert found.converged
    size = np.linalg.norm(a, axis=0)

    def cost(scaled: np.ndarray) -> float:
        residual = y - a @ (scaled / size)
        u = np.concatenate([residual[rows] / scale for rows, scale in zip(JOINTS, found.scale, strict=True)])
        c = CONSTANTS["huber"]
        return float(np.sum(np.where(np.abs(u) < c, 0.5 * u**2, c * np.abs(u) - 0.5 * c**2)))

    best = minimize(cost, found.solution * size, method="BFGS", options={"gtol": 1e-8})
    assert cost(found.solution * size) <= best.fun + 1e-9
    assert found.solution * size == pytest.approx(best.x, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("loss", ["huber", "bisquare"])
def test_outliers_move_robust_estimates_less(loss: str) -> None:
    a, y, truth = system(outliers=12)
    start = np.linalg.lstsq(a, y, rcond=None)[0]
    found = reweighted(a, y, JOINTS, start, loss=loss)  # type: ignore[arg-type]
    assert found.converged
    size = np.linalg.norm(a, axis=0)
    assert np.linalg.norm((found.solution - truth) * size) < 0.2 * np.linalg.norm((start - truth) * size)
    assert found.weights[np.argsort(np.abs(y - a @ truth))[-12:]].max() < 0.1


def test_weights_of_the_two_functions() -> None:
    u = np.array([0.0, 1.0, 1.345, 2.69, 4.685, 9.0])
    assert psi_weights(u, "huber", 1.345) == pytest.approx([1.0, 1.0, 1.0, 0.5, 1.345 / 4.685, 1.345 / 9.0])
    expected = [
        1.0,
        (1 - 1 / 4.685**2) ** 2,
        (1 - (1.345 / 4.685) ** 2) ** 2,
        (1 - (2.69 / 4.685) ** 2) ** 2,
        0,
        0,
    ]
    assert psi_weights(u, "bisquare", 4.685) == pytest.approx(expected)


def test_without_noise_nothing_is_divided_by_zero() -> None:
    a, _, truth = system()
    found = reweighted(a, a @ truth, JOINTS, truth)
    assert found.converged
    assert found.solution == pytest.approx(truth, rel=1e-9)


@pytest.fixture(scope="module")
def tx40() -> tuple[didim.Experiment, didim.Identification]:
    """A log, and its estimate by least squares."""
    experiment = didim.packaged_experiment("tx40")
    log = didim.simulated_log(experiment, experiment.robot.parameter_set("didim"), seed=1)
    return log, didim.identify(log)


@pytest.mark.parametrize("name", ["huber", "bisquare"])
def test_they_are_solvers_of_the_methods(
    tx40: tuple[didim.Experiment, didim.Identification], name: str
) -> None:
    log, direct = tx40
    fit = didim.identify(log, didim.IDIMLS(solver=name))
    assert fit.converged
    assert fit.settings["solver"]["name"] == name
    assert np.abs((fit.beta - direct.beta) / direct.std).max() < 2.5
    assert fit.uncertainty is not None
    assert fit.uncertainty.kind == "jackknife"
    assert np.median(fit.std / direct.std) == pytest.approx(1.0, abs=0.3)
