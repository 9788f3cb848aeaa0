"""Covariance of the estimate for noise that decimation has correlated: ``C = P (sum_j sigma_j^2 W_j^T T W_j) P``.

Tested in ``tests/test_least_squares.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._tools.arrays import Array
from .linear_system import LinearSystem
from .settings import LeastSquaresSettings

# A joint with fewer expected squares than this share of its rows takes the variance of all joints.
SMALLEST_SHARE = 0.05


def correlated_covariance(
    system: LinearSystem,
    settings: LeastSquaresSettings,
    scale: Array,
    residual: Array,
    inverse_r: Array,
    correlation: Array,
) -> Array:
    """Covariance for noise with a correlation in each window of each joint; rows and residual are divided by the weights."""
    b = inverse_r.shape[0]
    colored, plain = np.empty((len(system.joints), b, b)), np.empty((len(system.joints), b, b))
    for joint, rows in enumerate(system.joints):
        # In the orthonormal columns Q = W R^-1: in those of a nearly dependent W rounding would make variances negative.
        q = (system.w[rows] * scale[rows, None]) @ inverse_r
        plain[joint] = q.T @ q
        colored[joint] = q.T @ _apply_correlation(q, system.windows or (len(q),), correlation)
    squares = np.array([residual[rows] @ residual[rows] for rows in system.joints])
    sizes = np.array([rows.stop - rows.start for rows in system.joints], dtype=np.float64)
    # What is left of unit noise: the trace of (1 - H) T (1 - H) within the rows of the joint, H = Q Q^T.
    traces = np.trace(colored, axis1=1, axis2=2)
    expected = sizes - 2.0 * traces + np.einsum("jab,ab->j", plain, colored.sum(axis=0))
    if settings.weights == "none":
        variances = np.full(len(squares), squares.sum() / expected.sum())
    else:
        # A joint whose rows hardly outnumber its own parameters cannot tell its noise: all joints together can.
        pooled = squares.sum() / expected.sum()
        told_by_itself = expected > SMALLEST_SHARE * sizes
        variances = np.where(told_by_itself, squares / np.where(told_by_itself, expected, 1.0), pooled)
    return np.asarray(inverse_r @ np.einsum("j,jab->ab", variances, colored) @ inverse_r.T)


def _apply_correlation(w: Array, windows: Sequence[int], correlation: Array) -> Array:
    """``T w`` with a symmetric Toeplitz matrix in each window of rows."""
    out = np.empty_like(w)
    start = 0
    for length in windows:
        lags = np.zeros(length)
        known = min(length, correlation.size)
        lags[:known] = correlation[:known]
        # The matrix is a corner of a circulant one, which the Fourier transform makes diagonal.
        circle = np.concatenate([lags, [0.0], lags[:0:-1]])
        spectrum = np.fft.rfft(circle)[:, None] * np.fft.rfft(w[start : start + length], circle.size, axis=0)
        out[start : start + length] = np.fft.irfft(spectrum, circle.size, axis=0)[:length]
        start += length
    return out
