"""Huber's and Tukey's estimators, total least squares, ridge regression and the whitening of maximum likelihood."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

import didim
from didim.contrib.sample_weights import sample_covariances, whitened, whitening
from didim.contrib.total import total_least_squares
from didim.regression.block import stacked
from didim.regression.classical.ridge import STRENGTHS, chosen_strength, ridge
from didim.regression.classical.robust import CONSTANTS, psi_weights, reweighted
from didim.regression.classical.solvers import Ridge
from didim.regression.jackknife import intervals


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


def test_total_least_squares_is_the_line_nearest_to_points() -> None:
    # Unit norms on both axes: the slope of the principal axis of the scaled points.
    rng = np.random.default_rng(3)
    t = rng.standard_normal(20_000)
    a, y = (t + 0.3 * rng.standard_normal(t.size))[:, None], 2.0 * t + 0.6 * rng.standard_normal(t.size)
    found = total_least_squares(a, y)
    assert found is not None
    u, v = a[:, 0] / np.linalg.norm(a), y / np.linalg.norm(y)
    angle = 0.5 * np.arctan2(2.0 * u @ v, u @ u - v @ v)
    assert found[0] == pytest.approx(np.tan(angle) * np.linalg.norm(y) / np.linalg.norm(a))
    # The noise of the column attenuates ordinary least squares by 1 / 1.09.
    assert found[0] == pytest.approx(2.0, abs=0.03)
    assert (a[:, 0] @ y) / (a[:, 0] @ a[:, 0]) == pytest.approx(2.0 / 1.09, abs=0.03)


def test_total_least_squares_meets_its_normal_equations() -> None:
    a, y, _ = system()
    found = total_least_squares(a, y)
    assert found is not None
    size, target = np.linalg.norm(a, axis=0), np.linalg.norm(y)
    joined = np.column_stack([a / size, y / target])
    smallest = np.linalg.eigvalsh(joined.T @ joined)[0]
    u = a / size
    expected = np.linalg.solve(u.T @ u - smallest * np.eye(3), u.T @ y / target)
    assert found * size / target == pytest.approx(expected, rel=1e-9)


def test_total_least_squares_without_a_solution_says_so() -> None:
    # The torque is orthogonal to both columns, which are nearly the same: the worst direction does not contain it.
    a = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-12], [0.0, 0.0]])
    assert total_least_squares(a, np.array([0.0, 0.0, 1.0])) is None


def test_ridge_is_its_normal_equations() -> None:
    a, y, _ = system()
    size = np.linalg.norm(a, axis=0)
    prior = np.array([1.0, 0.0, 300.0])
    for strength in (0.0, 1e-3, 1.0):
        normal = a.T @ a + strength * np.diag(size**2)
        expected = np.linalg.solve(normal, a.T @ y + strength * size**2 * prior)
        assert ridge(a, y, strength, prior) == pytest.approx(expected, rel=1e-8)
    assert ridge(a, y, 1e12, prior) == pytest.approx(prior, rel=1e-6)


def test_ridge_helps_where_columns_hardly_differ_and_not_elsewhere() -> None:
    rng = np.random.default_rng(7)
    blocks = [item.rows for item in intervals(stacked(1, [100]), 5)]
    a = rng.standard_normal((100, 3))
    near = a.copy()
    near[:, 1] = near[:, 0] + 1e-2 * rng.standard_normal(100)
    strength, errors = chosen_strength(near, near @ [1.0, 1.0, 1.0] + rng.standard_normal(100), blocks)
    assert strength > STRENGTHS[0]
    assert errors[STRENGTHS.index(strength)] == errors.min() < errors[0]
    clear, _ = chosen_strength(a, a @ [5.0, -5.0, 5.0] + 0.01 * rng.standard_normal(100), blocks)
    assert clear < 1e-4


def test_whitened_errors_have_the_unit_covariance() -> None:
    rng = np.random.default_rng(2)
    n, d = 4, 3
    jacobians = [rng.standard_normal((n, d, d)) for _ in range(3)]
    noise = [np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])]
    torque = np.array([0.5, 0.1, 0.2])
    covariances = sample_covariances(torque, jacobians, noise)
    for k in range(n):
        expected = np.diag(torque**2) + sum(
            jacobian[k] @ np.diag(sigma**2) @ jacobian[k].T
            for jacobian, sigma in zip(jacobians, noise, strict=True)
        )
        assert covariances[k] == pytest.approx(expected)
    whiteners = whitening(covariances)
    for k in range(n):
        assert whiteners[k] @ covariances[k] @ whiteners[k].T == pytest.approx(np.eye(d), abs=1e-9)
    rows = rng.standard_normal((d * n, 2))
    found = whitened(rows, whiteners)
    for k in range(n):
        assert found[k::n] == pytest.approx(whiteners[k] @ rows[k::n])


@pytest.fixture(scope="module")
def tx40() -> tuple[didim.Experiment, didim.Identification]:
    """A log, and its estimate by least squares."""
    experiment = didim.packaged_experiment("tx40")
    log = didim.simulated_log(experiment, experiment.robot.parameter_set("didim"), seed=1)
    return log, didim.identify(log)


@pytest.mark.parametrize("name", ["huber", "bisquare", "didim.contrib.total:Total", "ridge"])
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


def test_ridge_refuses_a_negative_strength() -> None:
    with pytest.raises(didim.errors.FitError, match="strength must be a finite number of at least 0, got -1"):
        Ridge(-1.0)
