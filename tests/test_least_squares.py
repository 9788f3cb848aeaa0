"""Weighted least squares: against NumPy's, and whether errors are as large as the covariance says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from didim import _core
from didim.errors import FitError, RankError
from didim.regression.least_squares import solve
from didim.regression.settings import LeastSquaresSettings
from didim.signal.filters import decimate, decimation_stages
from didim.signal.noise import noise_correlation
from didim.signal.processing import SignalProcessing
from didim.terms.rows import LinearSystem, stacked

Array = NDArray[np.float64]

PLAIN = LeastSquaresSettings(weights="none", uncertainty="white")
BETA = np.array([3.0, -0.2, 0.05])
NAMES = ("ZZ1R", "Fv1", "Off2")


def system(sizes: tuple[float, ...] = (1.0,), n_samples: int = 200, seed: int = 0) -> LinearSystem:
    """System of len(sizes) joints whose noise has these standard deviations."""
    rng = np.random.default_rng(seed)
    w = rng.standard_normal((n_samples * len(sizes), 3)) * [1.0, 5.0, 0.3]
    noise = np.repeat(sizes, n_samples) * rng.standard_normal(n_samples * len(sizes))
    return LinearSystem(w=w, y=w @ BETA + noise, blocks=stacked(len(sizes), [n_samples]), names=NAMES)


def test_ordinary_least_squares_and_equations_9_and_10() -> None:
    one = system()
    fit = solve(one, PLAIN)
    beta, squares, _, singular = np.linalg.lstsq(one.w, one.y, rcond=None)
    np.testing.assert_allclose(fit.solution, beta, rtol=1e-12)
    np.testing.assert_allclose(fit.residual, one.y - one.w @ beta, atol=1e-12)
    covariance = squares[0] / (200 - 3) * np.linalg.inv(one.w.T @ one.w)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-10, atol=1e-18)
    assert fit.condition_number == pytest.approx(singular[0] / singular[-1], rel=1e-12)
    np.testing.assert_array_equal(fit.weights, 1.0)


def test_variance_by_r_minus_1() -> None:
    one = system()
    by_b = solve(one, PLAIN).covariance
    by_1 = solve(one, replace(PLAIN, variance="r-1")).covariance
    np.testing.assert_allclose(by_1 * 199, by_b * 197, rtol=1e-12)


def test_the_correlation_changes_the_covariance_only_when_asked() -> None:
    one = system()
    correlation = np.array([1.0, 0.5, 0.1])
    coloured = replace(one, blocks=stacked(1, [200], correlation=correlation))
    plain = solve(coloured, PLAIN)
    np.testing.assert_array_equal(plain.covariance, solve(one, PLAIN).covariance)
    corrected = solve(coloured, replace(PLAIN, uncertainty="decimated"))
    np.testing.assert_array_equal(corrected.solution, plain.solution)
    # By the definition, with the whole matrices; two windows do not see each other.
    for windows in ((), (120, 80)):
        two = replace(one, blocks=stacked(1, windows or (200,), correlation=correlation))
        t = np.zeros((200, 200))
        for start, stop in ((0, 200),) if not windows else ((0, 120), (120, 200)):
            for lag, value in enumerate(correlation):
                block = np.eye(stop - start, k=lag) + np.eye(stop - start, k=-lag)
                t[start:stop, start:stop] += value * (block if lag else np.eye(stop - start))
        p = np.linalg.inv(one.w.T @ one.w)
        left = np.eye(200) - one.w @ p @ one.w.T
        variance = plain.residual @ plain.residual / np.trace(left @ t @ left)
        expected = variance * p @ one.w.T @ t @ one.w @ p
        found = solve(two, replace(PLAIN, uncertainty="decimated")).covariance
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_weights_are_the_inverse_residuals_of_each_joint() -> None:
    two = system((0.1, 10.0))
    fit = solve(two, LeastSquaresSettings())
    first = two.y - two.w @ np.linalg.lstsq(two.w, two.y, rcond=None)[0]
    sigma = np.array([np.sqrt(np.mean(first[:200] ** 2)), np.sqrt(np.mean(first[200:] ** 2))])
    scale = np.repeat(1.0 / sigma, 200)
    np.testing.assert_allclose(fit.weights, scale, rtol=1e-12)
    w, y = two.w * scale[:, None], two.y * scale
    beta, squares, _, _ = np.linalg.lstsq(w, y, rcond=None)
    np.testing.assert_allclose(fit.solution, beta, rtol=1e-12)
    np.testing.assert_allclose(
        fit.covariance, squares[0] / 397 * np.linalg.inv(w.T @ w), rtol=1e-10, atol=1e-18
    )
    # Without weights.
    assert fit.condition_number == pytest.approx(np.linalg.cond(two.w), rel=1e-12)
    # The residual stays in N.m.
    np.testing.assert_allclose(fit.residual, two.y - two.w @ beta, atol=1e-10)


def test_a_common_size_of_the_noise_changes_weights_alone() -> None:
    two = system((0.1, 10.0))
    large = replace(two, w=two.w * 1e3, y=two.y * 1e3)
    np.testing.assert_allclose(
        solve(two, LeastSquaresSettings()).covariance,
        solve(large, LeastSquaresSettings()).covariance,
        rtol=1e-10,
        atol=1e-18,
    )


def test_reweighting_settles() -> None:
    two = system((0.1, 10.0))
    steps: list[Array] = []

    def progress(number: int, beta: Array, residual: Array) -> bool:
        assert number == len(steps) + 1
        assert residual.shape == two.y.shape
        steps.append(beta)
        return False

    solve(two, LeastSquaresSettings(reweightings=6), progress=progress)
    assert len(steps) == 7
    changes = np.linalg.norm(np.diff(steps, axis=0), axis=1)
    assert changes[-1] < 1e-6 * changes[0]


def test_the_callback_stops_between_solutions() -> None:
    two = system((0.1, 10.0))
    fit = solve(two, LeastSquaresSettings(), progress=lambda number, beta, residual: True)
    assert fit.stopped
    np.testing.assert_array_equal(fit.weights, 1.0)
    np.testing.assert_allclose(fit.solution, solve(two, PLAIN).solution, rtol=0, atol=0)
    assert not solve(two, PLAIN, progress=lambda number, beta, residual: True).stopped


def test_a_joint_without_noise_or_torque_gets_a_finite_weight() -> None:
    exact = system((0.0, 0.0))
    fit = solve(exact, LeastSquaresSettings(reweightings=3))
    np.testing.assert_allclose(fit.solution, BETA, rtol=1e-12)
    silent = replace(exact, y=np.zeros_like(exact.y))
    fit = solve(silent, LeastSquaresSettings())
    np.testing.assert_array_equal(fit.solution, 0.0)
    np.testing.assert_array_equal(fit.covariance, 0.0)


def coverage(settings: LeastSquaresSettings, decimated: bool, seeds: int = 400) -> float:
    """Rms error of the estimates, in units of the standard deviations that the fits report."""
    signal = SignalProcessing(decimation=(10,) if decimated else ())
    rng = np.random.default_rng(7)
    n_samples = 20_000 if decimated else 200
    stages = decimation_stages(n_samples, signal)
    t = np.linspace(0.0, 1.0, n_samples)
    # Slow columns go through the decimation filter unchanged.
    w = decimate(np.column_stack([np.sin(9.0 * t), np.cos(14.0 * t), np.ones_like(t)]), stages)
    w = np.concatenate([w, w[::-1] * [1.0, -2.0, 0.5]])
    half = w.shape[0] // 2
    blocks = stacked(2, [half], correlation=noise_correlation(signal))
    errors = []
    for _ in range(seeds):
        noise = decimate(rng.standard_normal((n_samples, 2)) * [0.3, 3.0], stages)
        y = w @ BETA + noise.T.reshape(-1)
        fit = solve(
            LinearSystem(w=np.ascontiguousarray(w), y=y, blocks=blocks, names=NAMES),
            settings,
        )
        errors.append((fit.solution - BETA) / np.sqrt(np.diag(fit.covariance)))
    return float(np.sqrt(np.mean(np.square(errors))))


def test_errors_are_as_large_as_sigma_says() -> None:
    assert coverage(LeastSquaresSettings(), decimated=False) == pytest.approx(1.0, abs=0.06)


@pytest.mark.slow
def test_errors_after_decimation_are_as_large_as_the_corrected_sigma_says() -> None:
    corrected = coverage(LeastSquaresSettings(), decimated=True)
    assert corrected == pytest.approx(1.0, abs=0.06)
    assert coverage(LeastSquaresSettings(uncertainty="white"), decimated=True) > 1.05 * corrected


def test_dependent_columns_are_named() -> None:
    one = system()
    w = one.w.copy()
    w[:, 2] = 2.0 * w[:, 0] - 0.5 * w[:, 1]
    with pytest.raises(RankError, match=r"1 of 3 .*Off2 = 2 ZZ1R -0\.5 Fv1\); excite them, or fix or drop"):
        solve(replace(one, w=w), PLAIN)


def test_a_column_without_excitation_is_named() -> None:
    one = system()
    w = one.w.copy()
    w[:, 1] = 0.0
    with pytest.raises(RankError, match=r"columns of W: Fv1 = 0\)"):
        solve(replace(one, w=w), PLAIN)


@pytest.mark.parametrize(("factor", "size"), [(1e160, "large"), (1e-200, "small")])
def test_torques_whose_squares_no_number_holds(factor: float, size: str) -> None:
    two = system((0.1, 10.0))
    y = two.y.copy()
    y[two.joints[1]] *= factor
    with pytest.raises(
        FitError, match=f"^the torques of joint 2 are too {size} to be squared; check their unit"
    ):
        solve(replace(two, y=y), PLAIN)


def test_columns_that_are_too_large_or_make_sigma_too_large() -> None:
    one = system()
    with pytest.raises(FitError, match=r"^the column of Fv1 is too large to be squared; check the unit"):
        solve(replace(one, w=one.w * [1.0, 1e160, 1.0]), PLAIN)
    # The variance of a parameter of 1e157 N.m is beyond 1e308.
    with pytest.raises(
        FitError, match=r"^parameter .* and its standard deviation cannot be computed in floating"
    ):
        solve(replace(one, w=1e-154 * one.w, y=1e3 * one.y), PLAIN)


def test_what_the_core_refuses_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(w: Array, y: Array) -> None:
        raise ValueError("its singular values cannot be computed")

    monkeypatch.setattr(_core, "least_squares", refuse)
    with pytest.raises(FitError, match=r"^its singular values cannot be computed$"):
        solve(system(), PLAIN)


def test_too_few_rows_and_no_columns() -> None:
    one = system()
    short = replace(one, w=one.w[:3], y=one.y[:3], blocks=stacked(1, [3]))
    with pytest.raises(FitError, match="3 rows cannot determine 3 parameters; use a longer record"):
        solve(short, PLAIN)
    with pytest.raises(FitError, match="no parameter is left to estimate"):
        solve(replace(one, w=one.w[:, :0], names=()), PLAIN)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weights": "joint"}, "weights must be 'none' or 'per-joint', got 'joint'"),
        ({"variance": "r"}, "variance must be 'r-b' or 'r-1', got 'r'"),
        ({"reweightings": -1}, "reweightings must be a whole number from 0 to 1000, got -1"),
        ({"reweightings": True}, "reweightings must be a whole number"),
        ({"reweightings": 1.5}, "reweightings must be a whole number"),
        ({"uncertainty": "hac"}, "uncertainty must be 'jackknife', 'decimated' or 'white', got 'hac'"),
        ({"blocks": 1}, "blocks must be a whole number from 2 to 1000, got 1"),
    ],
)
def test_wrong_settings(options: dict[str, Any], message: str) -> None:
    with pytest.raises(FitError, match=message):
        LeastSquaresSettings(**options)


def test_variances_of_nearly_dependent_columns_are_not_negative() -> None:
    """Columns that differ by 1e-9 of their size: rounding in W^T W would leave nothing of the covariance."""
    rng = np.random.default_rng(5)
    one = system()
    w = rng.standard_normal((200, 3))
    w[:, 2] = w[:, 0] + w[:, 1] + 1e-9 * rng.standard_normal(200)
    blocks = stacked(2, [100], correlation=np.array([1.0, 0.3, 0.1]))
    fit = solve(replace(one, w=w, y=rng.standard_normal(200), blocks=blocks), LeastSquaresSettings())
    variances = np.diag(fit.covariance)
    assert (variances > 0.0).all()
    # The direction that the columns nearly share has the variance of its 200 rows of 1e-9, correlation apart.
    assert 0.3e18 / 200.0 < variances[2] < 3e18 / 200.0
