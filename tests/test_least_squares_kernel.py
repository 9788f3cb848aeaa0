"""The core's QR least squares against NumPy's, and what it says of dependent columns and bad input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from didim import _core

Array = NDArray[np.float64]


def system(rows: int, columns: int, seed: int) -> tuple[Array, Array]:
    """Columns whose sizes differ as those of inertias and frictions do."""
    rng = np.random.default_rng(seed)
    w = rng.standard_normal((rows, columns)) * 10.0 ** rng.integers(-3, 4, columns)
    return w, 100.0 * rng.standard_normal(rows)


@given(columns=st.integers(1, 40), more=st.integers(2, 80), seed=st.integers(0, 10_000))
def test_solution_covariance_and_condition_are_numpys(columns: int, more: int, seed: int) -> None:
    w, y = system(columns + more, columns, seed)
    found = _core.least_squares(w, y)
    assert found.dependent == []
    scale = np.linalg.norm(w, axis=0)
    # Compared in units of the columns, as exactly as their conditioning allows.
    tolerance = 1e-13 * np.linalg.cond(w / scale) ** 2
    expected = np.linalg.lstsq(w / scale, y, rcond=None)[0] / scale
    np.testing.assert_allclose(found.solution * scale, expected * scale, atol=tolerance * np.linalg.norm(y))
    assert found.residual_norm == pytest.approx(float(np.linalg.norm(y - w @ expected)), rel=1e-10)
    covariance = np.linalg.inv((w / scale).T @ (w / scale))
    inverse = scale[:, None] * found.inverse_r
    np.testing.assert_allclose(inverse @ inverse.T, covariance, atol=tolerance * np.abs(covariance).max())
    np.testing.assert_allclose(
        found.singular_values, np.linalg.svd(w, compute_uv=False), rtol=1e-9, atol=1e-13 * scale.max()
    )
    np.testing.assert_allclose(1.0 / np.diag(found.inverse_r), np.abs(np.diag(np.linalg.qr(w)[1])), rtol=1e-9)


def test_more_rows_than_one_block_are_numpys() -> None:
    w, y = system(20_011, 12, 4)
    found = _core.least_squares(w, y)
    np.testing.assert_allclose(found.solution, np.linalg.lstsq(w, y, rcond=None)[0], rtol=1e-10)
    np.testing.assert_allclose(
        1.0 / np.diag(found.inverse_r), np.abs(np.diag(np.linalg.qr(w)[1])), rtol=1e-12
    )


def test_dependent_columns_come_with_what_they_depend_on() -> None:
    w, y = system(200, 8, 1)
    w[:, 3] = 2.0 * w[:, 0] - 0.25 * w[:, 2]
    w[:, 5] = 0.0
    w[:, 7] = w[:, 3] + w[:, 6]
    found = _core.least_squares(w, y)
    assert [column for column, _ in found.dependent] == [3, 5, 7]
    terms = [dict(coefficients) for _, coefficients in found.dependent]
    assert terms[0] == pytest.approx({0: 2.0, 2: -0.25})
    assert terms[1] == {}
    # Column 3 is out by then, so that column 7 is told in columns 0, 2 and 6.
    assert terms[2] == pytest.approx({0: 2.0, 2: -0.25, 6: 1.0})
    kept = [0, 1, 2, 4, 6]
    np.testing.assert_allclose(found.solution, np.linalg.lstsq(w[:, kept], y, rcond=None)[0], rtol=1e-9)


def test_units_do_not_decide_what_depends() -> None:
    w, y = system(300, 6, 2)
    scaled = w / np.linalg.norm(w, axis=0) * np.array([1.0, 1e-4, 1.0, 1e6, 1.0, 1e-5])
    assert _core.least_squares(scaled, y).dependent == []


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_rounding_noise_around_zero_is_no_column(unit: float) -> None:
    w, y = system(300, 6, 2)
    w[:, 4] *= 1e-16 / np.linalg.norm(w[:, 4])
    assert _core.least_squares(unit * w, y).dependent == [(4, [])]


def test_storage_order_does_not_change_a_bit() -> None:
    w, y = system(5000, 9, 3)
    rows, columns = _core.least_squares(w, y), _core.least_squares(np.asfortranarray(w), y)
    np.testing.assert_array_equal(rows.solution, columns.solution)
    np.testing.assert_array_equal(rows.inverse_r, columns.inverse_r)


@pytest.mark.parametrize(
    ("rows", "columns", "bad", "message"),
    [
        (4, 5, None, "at least one column and as many rows as columns, got 4 rows and 5 columns"),
        (9, 5, (7, 2), "row 7, column 2 of the observation matrix is not a finite number"),
    ],
)
def test_bad_input_is_told(rows: int, columns: int, bad: tuple[int, int] | None, message: str) -> None:
    w, y = system(rows, columns, 0)
    if bad is not None:
        w[bad] = np.nan
    with pytest.raises(ValueError, match=message):
        _core.least_squares(w, y)


def test_bad_right_side_is_told() -> None:
    w, y = system(9, 3, 0)
    with pytest.raises(ValueError, match=r"y .*8|8.*y"):
        _core.least_squares(w, y[:8])
    y[3] = np.inf
    with pytest.raises(ValueError, match="value 3 of y is not a finite number"):
        _core.least_squares(w, y)
