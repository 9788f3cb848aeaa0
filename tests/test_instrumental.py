"""Instrumental variables: the estimate, the strength of the instruments and the Durbin-Wu-Hausman test."""

from __future__ import annotations

import numpy as np
import pytest

from didim.regression.classical.instrumental import (
    durbin_watson,
    exogeneity_test,
    instrument_strength,
    instrumented,
)

TRUTH = np.array([2.0, -0.03, 400.0])


def noisy_system(seed: int, noise: float, rows: int = 2000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matrix with noise in it, the matrix without, and torques of the latter."""
    rng = np.random.default_rng(seed)
    size = np.array([1.0, 100.0, 0.01])
    clean = rng.standard_normal((rows, 3)) * size
    noisy = clean + noise * rng.standard_normal((rows, 3)) * size
    return noisy, clean, clean @ TRUTH + 0.1 * rng.standard_normal(rows)


def test_the_estimate_is_that_of_the_normal_equations() -> None:
    a, z, y = noisy_system(0, 0.3)
    found = instrumented(a, z, y, np.ones(len(y)))
    assert found is not None
    assert found.solution == pytest.approx(np.linalg.solve(z.T @ a, z.T @ y), rel=1e-9)
    # The covariance for white noise of unit size is G^-1 G^-T.
    inverse = np.linalg.inv(z.T @ a)
    assert found.inverse @ found.inverse.T == pytest.approx(inverse @ z.T @ z @ inverse.T, rel=1e-8)


def test_with_the_matrix_as_instruments_it_is_least_squares() -> None:
    a, _, y = noisy_system(1, 0.1)
    found = instrumented(a, a, y, np.ones(len(y)))
    assert found is not None
    assert found.solution == pytest.approx(np.linalg.lstsq(a, y, rcond=None)[0], rel=1e-9)


def test_instruments_remove_the_bias_of_noise_in_the_matrix() -> None:
    direct, instrumental = [], []
    for seed in range(30):
        a, z, y = noisy_system(seed, 0.3)
        found = instrumented(a, z, y, np.ones(len(y)))
        assert found is not None
        direct.append(np.linalg.lstsq(a, y, rcond=None)[0] / TRUTH - 1.0)
        instrumental.append(found.solution / TRUTH - 1.0)
    # Noise of 0.3 of a column attenuates it by 1 / 1.09.
    assert np.mean(direct, axis=0) == pytest.approx(np.full(3, 1.0 / 1.09 - 1.0), abs=0.01)
    assert np.abs(np.mean(instrumental, axis=0)).max() < 0.01


def test_instruments_that_say_nothing_on_a_parameter_give_no_estimate() -> None:
    a, z, y = noisy_system(2, 0.1)
    z = z.copy()
    z[:, 1] = 0.0
    assert instrumented(a, z, y, np.ones(len(y))) is None


def test_the_strength_is_the_share_that_the_instruments_miss() -> None:
    a, z, _ = noisy_system(3, 0.3)
    left = np.linalg.qr(z)[0]
    assert instrument_strength(a, left) == pytest.approx(np.full(3, 0.3 / np.sqrt(1.09)), rel=0.1)
    assert instrument_strength(z, left) == pytest.approx(np.zeros(3), abs=1e-12)


def test_the_test_of_exogeneity_sees_noise_and_keeps_its_level() -> None:
    a, z, y = noisy_system(4, 0.3)
    found = exogeneity_test(a, np.linalg.qr(z)[0], y)
    assert found is not None
    assert found.added == 3
    assert found.remaining == 1994
    assert found.p_value < 1e-6
    # Another matrix without noise of its own: the columns differ, the error of the torques is independent of it.
    p_values = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        exact = rng.standard_normal((300, 3))
        target = exact @ [1.0, 2.0, 3.0] + rng.standard_normal(300)
        instruments = exact + 0.3 * rng.standard_normal(exact.shape)
        test = exogeneity_test(exact, np.linalg.qr(instruments)[0], target)
        assert test is not None
        p_values.append(test.p_value)
    assert 0.35 < np.mean(p_values) < 0.65
    assert exogeneity_test(z, np.linalg.qr(z)[0], y) is None


def test_durbin_and_watsons_statistic() -> None:
    rng = np.random.default_rng(0)
    white = rng.standard_normal(5000)
    assert durbin_watson([white[:2000], white[2000:]]) == pytest.approx(2.0, abs=0.1)
    assert durbin_watson([np.cumsum(white)]) < 0.05
    assert np.isnan(durbin_watson([np.zeros(5)]))
