"""Covariance of an estimate, by the noise model of the rows: white, decimated, or with an estimated correlation.

    C = P (sum_b sigma_b^2 W_b^T T_b W_b) P,   P = (W^T W)^-1

over the blocks of rows, with the correlation T_b of the noise in a block. White noise has T = 1 and one sigma,
which is (10). Decimated noise has the correlation of the filter, and a sigma per joint where weights are per joint:

    sigma_j^2 = |rho_j|^2 / E_j

where E_j is the expectation of ``|rho_j|^2`` for unit noise, which replaces the rows less parameters of (9).
The correlation of CLOE's output errors is estimated from them. Tested in ``tests/test_least_squares.py``, ``tests/test_cloe.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .._tools.arrays import Array
from ..terms.rows import Block, LinearSystem, Rows
from .settings import LeastSquaresSettings

SMALLEST_ROWS_SHARE = 0.05
"""Smallest ratio of a joint's expected squares to its rows for a variance of its own; otherwise it gets that of all joints."""
CORRELATED_ERRORS = 0.1
"""Correlation of neighbouring errors from which they are not treated as white."""


def covariance(
    system: LinearSystem, settings: LeastSquaresSettings, weights: Array, residual: Array, inverse_r: Array
) -> Array:
    """Return the covariance of a least-squares estimate according to the settings: (10), or for decimated noise.

    Parameters
    ----------
    system : LinearSystem
        The solved system; its blocks contain the correlation of decimated noise.
    settings : LeastSquaresSettings
        Variance, weights, and whether to include decimation.
    weights : (r,) array
        Factor of each row.
    residual : (r,) array
        ``Y - W beta``, without weights.
    inverse_r : (b, b) array
        Inverse of the triangle R of the weighted W.
    """
    weighted = residual * weights
    if _includes_decimation(system, settings):
        # In the orthonormal columns Q = W R^-1: with a nearly dependent W rounding could give negative variances.
        starts, stops = np.array([(rows.start, rows.stop) for rows in system.joints]).T
        q: list[tuple[Rows, Array]] = [(np.arange(0), np.zeros((0, 0)))] * len(starts)
        for (rows, columns), w in zip(system.parts, system.matrices, strict=True):
            part = w * weights[rows, None] @ inverse_r[np.ix_(columns, columns)]
            first, last = np.searchsorted(rows, (starts, stops))
            for joint in np.flatnonzero(last > first):
                q[joint] = columns, part[first[joint] : last[joint]]
        return _decimated(system, settings, q, weighted, inverse_r)
    return _white(system, settings, weighted, inverse_r)


def covariance_of_columns(
    system: LinearSystem, settings: LeastSquaresSettings, q: Array, residual: Array, inverse_r: Array
) -> Array:
    """Return the covariance of an estimate whose orthonormal columns are known, as `covariance` does; arguments of `decimated`."""
    if _includes_decimation(system, settings):
        return decimated(system, settings, q, residual, inverse_r)
    return _white(system, settings, residual, inverse_r)


def _includes_decimation(system: LinearSystem, settings: LeastSquaresSettings) -> bool:
    return settings.uncertainty != "white" and any(block.correlation is not None for block in system.blocks)


def _white(system: LinearSystem, settings: LeastSquaresSettings, residual: Array, inverse_r: Array) -> Array:
    """Equation (10): ``sigma^2 R^-1 R^-T``; `residual` is weighted."""
    variance = float(residual @ residual) / settings.divisor(*system.w.shape)
    return variance * np.asarray(inverse_r @ inverse_r.T)


def decimated(
    system: LinearSystem, settings: LeastSquaresSettings, q: Array, residual: Array, inverse_r: Array
) -> Array:
    """Covariance for noise with a known correlation in each block.

    Parameters
    ----------
    system, settings
        As for `covariance`.
    q : (r, b) array
        Orthonormal columns: of the weighted W, or of the weighted instruments.
    residual : (r,) array
        Weighted residual.
    inverse_r : (b, b) array
        Inverse of R, or with instruments of ``Q^T W``.
    """
    every = np.arange(len(inverse_r))
    return _decimated(system, settings, [(every, q[rows]) for rows in system.joints], residual, inverse_r)


def _decimated(
    system: LinearSystem,
    settings: LeastSquaresSettings,
    q: Sequence[tuple[Rows, Array]],
    residual: Array,
    inverse_r: Array,
) -> Array:
    """Compute the covariance of `decimated`; `q` has the columns of Q in which each joint may have entries, with these entries."""
    b, n = inverse_r.shape[0], len(system.joints)
    coloured, plain = np.zeros((n, b, b)), np.zeros((n, b, b))
    for joint, (rows, blocks) in enumerate(zip(system.joints, system.joint_blocks, strict=True)):
        columns, entries = q[joint]
        seen = entries.any(axis=0)
        part, square = np.ascontiguousarray(entries[:, seen]), np.ix_(columns[seen], columns[seen])
        plain[joint][square] = part.T @ part
        coloured[joint][square] = part.T @ _correlated(part, blocks, rows.start)
    squares = np.array([residual[rows] @ residual[rows] for rows in system.joints])
    # Expected squares of the residual of unit noise: the trace of (1 - H) T (1 - H) within the rows of the joint, H = Q Q^T.
    traces = np.trace(coloured, axis1=1, axis2=2)
    expected = system.counts - 2.0 * traces + np.einsum("jab,ab->j", plain, coloured.sum(axis=0))
    pooled = squares.sum() / expected.sum()
    if settings.weights == "none":
        variances = np.full(n, pooled)
    else:
        # A joint with hardly more rows than parameters cannot identify its noise, so all joints together are used.
        by_itself = expected > SMALLEST_ROWS_SHARE * system.counts
        variances = np.where(by_itself, squares / np.where(by_itself, expected, 1.0), pooled)
    return np.asarray(inverse_r @ np.einsum("j,jab->ab", variances, coloured) @ inverse_r.T)


def _correlated(w: Array, blocks: Sequence[Block], first: int) -> Array:
    """Return ``T w`` with each block's Toeplitz correlation matrix; row 0 of `w` is row `first` of the system."""
    out = np.empty_like(w)
    for block in blocks:
        rows = slice(block.rows.start - first, block.rows.stop - first)
        if block.correlation is None:
            out[rows] = w[rows]
            continue
        length = block.n_rows
        lags = np.zeros(length)
        known = min(length, block.correlation.size)
        lags[:known] = block.correlation[:known]
        # The matrix is a corner of a circulant one, which the Fourier transform makes diagonal.
        circle = np.concatenate([lags, [0.0], lags[:0:-1]])
        spectrum = np.fft.rfft(circle)[:, None] * np.fft.rfft(w[rows], circle.size, axis=0)
        out[rows] = np.fft.irfft(spectrum, circle.size, axis=0)[:length]
    return out


def autocorrelated(
    columns: Array, errors: Array, blocks: Sequence[Block], inverse: Array
) -> tuple[Array, list[int]]:
    """Return the covariance with the correlation estimated from the errors, and a variance per block.

    Parameters
    ----------
    columns : (r, b) array
        Weighted columns, or derivatives of weighted errors.
    errors : (r,) array
        Weighted errors at the estimate.
    blocks : sequence of Block
        Rows of each joint in each window.
    inverse : (b, b) array
        Inverse of ``columns^T columns``.

    Returns
    -------
    (b, b) array
        Covariance.
    list of int
        Joint of each block whose errors are correlated.
    """
    middle = np.zeros_like(inverse)
    correlated: list[int] = []
    for block in blocks:
        part, rows = errors[block.rows], columns[block.rows].T
        product = rows @ rows.T
        freedom = max(1.0, part.size - float(np.sum(inverse * product)))
        squares = float(part @ part)
        if squares > 0.0 and abs(float(part[1:] @ part[:-1])) > CORRELATED_ERRORS * squares:
            product = _coloured(rows, part)
            correlated.append(block.joint)
        middle += squares / freedom * product
    return inverse @ middle @ inverse, correlated


def _coloured(rows: Array, errors: Array) -> Array:
    """Return ``J R J'`` with the estimated correlation R of a joint's errors, tapered by Parzen's window to stay definite."""
    n = errors.size
    length = 2 ** math.ceil(math.log2(2 * n))
    # As long as the longest plausible correlation, and short enough for an accurate estimate at each lag.
    lags = min(n - 1, max(2, n // 10))
    spectrum = np.abs(np.fft.rfft(errors, length)) ** 2
    correlation = np.fft.irfft(spectrum, length)[: lags + 1]
    correlation /= correlation[0]
    u = np.arange(lags + 1) / lags
    correlation *= np.where(u <= 0.5, 1.0 - 6.0 * u**2 * (1.0 - u), 2.0 * (1.0 - u) ** 3)
    symmetric = np.zeros(length)
    symmetric[: lags + 1] = correlation
    symmetric[length - lags :] = correlation[:0:-1]
    weights = np.maximum(np.fft.rfft(symmetric).real, 0.0)
    filtered = np.fft.irfft(np.fft.rfft(rows, length, axis=1) * weights, length, axis=1)[:, :n]
    product = np.asarray(filtered @ rows.T)
    return 0.5 * (product + product.T)


def inverse(covariance: Array) -> Array:
    """Return the inverse of a covariance whose parameters have different units; zero for those without a standard deviation."""
    std = np.sqrt(np.diag(covariance))
    std = np.where(std > 0.0, std, 1.0)
    return np.asarray(np.linalg.pinv(covariance / np.outer(std, std), hermitian=True) / np.outer(std, std))
