r"""Covariance of an estimate: by the noise model of the rows, and by leaving parts of the log out.

    C = P (sum_b sigma_b^2 W_b^T T_b W_b) P,   P = (W^T W)^-1

over the blocks of rows, with the correlation T_b of the noise in a block. White noise has T = 1 and one sigma,
which is (10). Decimated noise has the correlation of the filter, and a sigma per joint where weights are per joint:

    sigma_j^2 = |rho_j|^2 / E_j

where E_j is the expectation of ``|rho_j|^2`` for unit noise, which replaces the rows less parameters of (9).
The correlation of CLOE's output errors is estimated from them. Tested in ``tests/test_least_squares.py``, ``tests/test_cloe.py``.

The delete-block jackknife leaves parts of the log out. The rows of all joints within a time interval form a block. Model error and
noise that are correlated within a block, or change along the motion, are then included in the uncertainty, unlike in (10). With
``A`` the weighted observation matrix, ``rho`` the weighted residual and ``Q_i``, ``rho_i`` the rows of block i, for ``A = Q R``:

    b_(i) - b = -R^-1 (I - Q_i^T Q_i)^-1 Q_i^T rho_i          exact, with the weights of the whole log
    C_J = (m - 1)/m sum_i (b_(i) - mean)(b_(i) - mean)^T
    C = D C_now D,    D = diag sqrt(C_J,kk / C_now,kk)

``C`` has the variances of ``C_J``, whose rank is only m - 1, and the correlations of ``C_now``. Estimates with instruments
``Z = Q R`` in place of ``A`` have ``-G^-1 (I - Q_i^T A_i G^-1)^-1 Q_i^T rho_i`` with ``G = Q^T A``, so both are one function of
a left factor ``Q``, a right factor ``A G^-1`` and ``G^-1``. Branches that share no columns, such as the legs of a trunk, have
factors and deletions of their own.

Sources: Quenouille (1956), Tukey (1958); Kuensch (1989) for blocks; Cameron and Miller (2015) for clusters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array, quotient, unit_diagonal
from ..terms.rows import Block, LinearSystem, Rows, by_window, unit_columns
from .settings import BLOCKS, LeastSquaresSettings

FEWEST_ROWS = 3
"""Smallest number of rows per joint in a block: shorter blocks of correlated noise are not independent."""
FEWEST_BLOCKS = 5
"""Smallest number of blocks of a short log: the spread of fewer estimates is too uncertain."""
DECISIVE_SHARE = 0.9
"""Share of the information on a parameter in one block from which that block determines it. Without it the standard deviation
is three times as large, and the spread of the estimates rests on a single number."""
CORRELATED = 1.645
"""Correlation of neighbouring blocks, over its standard error, above which blocks are doubled: 5 % of independent ones at most."""
LARGEST_EIGENVALUE = 1.0 - 1e-9
"""Eigenvalue of ``Q_i^T Q_i`` from which the other blocks do not determine a direction: the estimate then stays unchanged
there."""


@dataclass(frozen=True, eq=False)
class Jackknife:
    """Estimates with one block left out at a time.

    Attributes
    ----------
    deletions : ndarray, shape (m, b)
        Estimate without block i less that of the whole log.
    information : ndarray, shape (m, b)
        Share of the information on each parameter in block i: one less the ratio of its variances with and without the block,
        for white noise.
    leverage : float
        Largest eigenvalue of all ``Q_i^T Q_i``; a value near one means that a single block determines a direction.
    scores : ndarray, shape (m, k)
        ``Q_i^T rho_i`` of each block.
    """

    deletions: Array
    information: Array
    leverage: float
    scores: Array

    @property
    def covariance(self) -> Array:
        """``C_J``, shape (b, b), of rank m - 1."""
        return deletion_covariance(self.deletions)

    @property
    def decisive(self) -> NDArray[np.intp]:
        """Block that alone determines each parameter, or -1, shape (b,)."""
        blocks = np.argmax(self.information, axis=0)
        share = np.max(self.information, axis=0)
        return np.where(share > DECISIVE_SHARE, blocks, -1)


@dataclass(frozen=True)
class Interval:
    """Rows of all joints within a time interval: one block of the jackknife.

    Attributes
    ----------
    rows : ndarray of int
        Rows of the system.
    recording, window : int
        Recording among those of the experiment, and window of the recording, from 0.
    start_s, stop_s : float
        Times in the rows of the window (s), from its first row.
    """

    rows: Rows
    recording: int
    window: int
    start_s: float
    stop_s: float


def intervals(blocks: Sequence[Block], count: int = BLOCKS) -> list[Interval]:
    """Divide the rows of a system into intervals of about equal duration; none spans two windows.

    Parameters
    ----------
    blocks : sequence of Block
        Rows of each joint in each window.
    count : int
        Requested number of intervals. It is reduced if an interval would have fewer than `FEWEST_ROWS` rows of a joint, and
        raised to the number of windows.

    Returns
    -------
    list of Interval
        Every row is in one of them.

    Notes
    -----
    ``test_jackknife.py`` checks that every row is in one interval and that none spans two windows.
    """
    windows = by_window(blocks)
    lengths = [rows[0].n_rows for rows in windows]
    seconds = [length / rows[0].rate_hz for length, rows in zip(lengths, windows, strict=True)]
    wanted = min(count, max(FEWEST_BLOCKS, sum(lengths) // FEWEST_ROWS))
    cut: list[Interval] = []
    for rows, length, number in zip(windows, lengths, _shares(lengths, seconds, wanted), strict=True):
        index = [block.numbers for block in rows]
        edges = np.linspace(0, length, number + 1).round().astype(int)
        window = rows[0]
        cut += [
            Interval(
                np.concatenate([joint[start:stop] for joint in index]),
                window.recording,
                window.window,
                float(start / window.rate_hz),
                float(stop / window.rate_hz),
            )
            for start, stop in pairwise(edges)
        ]
    return cut


def _shares(lengths: Sequence[int], seconds: Sequence[float], count: int) -> list[int]:
    """Return the number of intervals of each window: at least one, further ones where the intervals are longest."""
    parts = [1] * len(lengths)
    while sum(parts) < count:
        longest = [
            duration / part if part < length else 0.0
            for duration, part, length in zip(seconds, parts, lengths, strict=True)
        ]
        if max(longest) == 0.0:
            break
        parts[int(np.argmax(longest))] += 1
    return parts


def inverse_root(information: Array) -> Array:
    """Return S with ``S S^T`` the inverse of an information, (b, b): zero in directions of which nothing but rounding is known."""
    # By the size of each column: one that a log hardly has is known by a prior alone.
    scaled, size = unit_diagonal(information)
    values, vectors = np.linalg.eigh(scaled)
    known = values > np.finfo(float).eps * values[-1]
    return np.asarray(
        vectors * np.where(known, 1.0 / np.sqrt(np.where(known, values, 1.0)), 0.0) / size[:, None]
    )


@dataclass(frozen=True, eq=False)
class Factors:
    """Factors of a weighted system for its deletions.

    Attributes
    ----------
    left : ndarray, shape (r, b)
        ``Q`` of the weighted observation matrix A, or of the weighted instruments.
    right : ndarray, shape (r, b)
        The same ``Q``, or with instruments ``A G^-1``.
    inverse : ndarray, shape (b, b)
        ``R^-1``, or ``G^-1``.
    residual : ndarray, shape (r,)
        Weighted residual of the estimate.
    """

    left: Array
    right: Array
    inverse: Array
    residual: Array

    @classmethod
    def of(cls, a: Array, residual: Array) -> Factors:
        """Return the factors of least squares with a weighted matrix and the weighted residual of its solution."""
        unit, size = unit_columns(a)
        left, triangle = np.linalg.qr(unit)
        inverse = np.linalg.solve(triangle, np.eye(a.shape[1])) / size[:, None]
        return cls(left, left, inverse, residual)

    @classmethod
    def held(cls, a: Array, residual: Array, precision: Array) -> Factors:
        """Return the factors of an estimate that a prior or constraints hold with a precision, (k, k), in the first k columns.

        Without block i it moves by ``-(A^T A + P - A_i^T A_i)^-1 A_i^T rho_i``: with ``A^T A + P = S^-T S^-1`` the factors are
        ``A S`` and S. ``test_consistent.py`` solves the constrained problem again without each block.
        """
        k, information = len(precision), a.T @ a
        information[:k, :k] += precision
        root = inverse_root(information)
        left = a @ root
        return cls(left, left, root, residual)

    def left_out(self, blocks: Sequence[Rows]) -> Array:
        """Compute the weighted residual of each block with the estimate without it, (r,): of least squares, held or not.

        ``test_consistent.py`` compares with the constrained problem solved again without each block.
        """
        unseen = np.zeros(len(self.residual))
        for rows in blocks:
            part, own = self.left[rows], self.residual[rows]
            values, vectors = np.linalg.eigh(part.T @ part)
            remaining = np.where(values < LARGEST_EIGENVALUE, 1.0 - values, np.inf)
            turned = part @ vectors
            unseen[rows] = own + turned @ ((turned.T @ own) / remaining)
        return unseen

    def jackknife(self, blocks: Sequence[Rows]) -> Jackknife:
        """Compute the estimates without each block, from the factors of the whole system.

        Parameters
        ----------
        blocks : sequence of ndarray of int
            Rows of each block: at least two blocks.

        Returns
        -------
        Jackknife
            Changes of the estimate, in the units of the parameters.

        Notes
        -----
        A direction that the other blocks do not determine keeps its value. ``test_jackknife.py`` solves the system again without
        each block.
        """
        left, right, inverse, residual = self.left, self.right, self.inverse, self.residual
        b = inverse.shape[0]
        gram, scores = np.empty((len(blocks), b, b)), np.empty((len(blocks), b))
        for index, rows in enumerate(blocks):
            part = left[rows]
            gram[index] = part.T @ (part if right is left else right[rows])
            scores[index] = part.T @ residual[rows]
        if right is left:
            values, vectors = np.linalg.eigh(gram)
            remaining = np.where(values < LARGEST_EIGENVALUE, 1.0 - values, np.inf)
            turned = np.einsum("mki,mk->mi", vectors, scores) / remaining
            deletions = -np.einsum("mki,mi->mk", vectors, turned) @ inverse.T
            # Variances without a block: diag(R^-1 (I - Q_i^T Q_i)^-1 R^-T).
            spread = np.matmul(inverse, vectors) ** 2
            without = np.einsum(
                "mki,mi->mk", spread, 1.0 / np.maximum(1.0 - values, 1.0 - LARGEST_EIGENVALUE)
            )
            leverage = float(values.max())
        else:
            rest = np.eye(b) - gram
            leverage = float(np.linalg.eigvalsh(0.5 * (gram + gram.transpose(0, 2, 1))).max())
            deletions = -np.linalg.solve(rest, scores[:, :, None])[:, :, 0] @ inverse.T
            # diag(H_i^-1 (I - L_i^T L_i) H_i^-T) with H_i = (I - L_i^T M_i) G.
            ahead = np.matmul(inverse, np.linalg.inv(rest))
            own = np.stack([np.eye(b) - left[rows].T @ left[rows] for rows in blocks])
            without = np.einsum("mij,mjk,mik->mi", ahead, own, ahead, optimize=True)
        variances = np.sum(inverse**2, axis=1)
        return Jackknife(deletions, 1.0 - variances / np.maximum(without, variances), leverage, scores)


@dataclass(frozen=True, eq=False)
class Branches:
    """Factors of independent branches, such as the legs of one trunk.

    Attributes
    ----------
    parts : list of (ndarray of int, ndarray of int, Factors)
        Rows, columns and factors of each branch.
    inverse : ndarray, shape (b, b)
        ``R^-1`` of all columns.
    residual : ndarray, shape (r,)
        Weighted residual of all rows.
    """

    parts: list[tuple[Rows, Rows, Factors]]
    inverse: Array
    residual: Array

    @classmethod
    def of(cls, system: LinearSystem, weights: Array, residual: Array) -> Branches:
        """Return the factors of weighted least squares, from the weights (r,) and the residual (r,) without them."""
        parts = []
        for (rows, columns), w in zip(system.parts, system.matrices, strict=True):
            if not columns.size:
                continue  # joints without unknowns, because all columns are dropped or fixed
            part = Factors.of(w * weights[rows, None], residual[rows] * weights[rows])
            parts.append((rows, columns, part))
        return cls.joined(parts, len(system.names), residual * weights)

    @classmethod
    def joined(cls, parts: list[tuple[Rows, Rows, Factors]], n_columns: int, residual: Array) -> Branches:
        """Return branches side by side, of so many columns and the weighted residual (r,) of all rows."""
        inverse = np.zeros((n_columns, n_columns))
        for _, columns, part in parts:
            inverse[np.ix_(columns, columns)] = part.inverse
        return cls(parts, inverse, residual)

    def jackknife(self, blocks: Sequence[Rows]) -> Jackknife:
        """Compute the estimates without each block of rows, branch by branch; see `Factors.jackknife`."""
        deletions, information = np.zeros((2, len(blocks), len(self.inverse)))
        leverage, scores = 0.0, [np.zeros((len(blocks), 0))]
        for rows, columns, factors in self.parts:
            index = np.full(len(self.residual), -1)
            index[rows] = np.arange(len(rows))
            own = [inside[inside >= 0] for inside in (index[block] for block in blocks)]
            variances = factors.jackknife(own)
            deletions[:, columns], information[:, columns] = variances.deletions, variances.information
            scores.append(variances.scores)
            leverage = max(leverage, variances.leverage)
        return Jackknife(deletions, information, leverage, np.hstack(scores))


def independent(
    factors: Factors | Branches, blocks: Sequence[Block], parts: Sequence[Interval], deleted: Jackknife
) -> Jackknife:
    """Return the jackknife of intervals that err independently: `deleted` of `parts`, or one of half as many, and again.

    Errors of a model that last longer than an interval make neighbours err alike, and the jackknife too narrow. With the scores
    ``u_i = Q_i^T rho_i`` the correlation of neighbours in a window, over its standard error, is
    ``sum_i u_i^T u_(i+1) / sqrt(sum_i (u_i^T u_(i+1))^2)``: random signs of the intervals, which independence allows, give it a
    mean of zero and a variance of one. The mean of the scores is subtracted: a least-squares solution has none, which makes the
    correlation somewhat negative. Above `CORRELATED` intervals are halved in number; at least `FEWEST_BLOCKS` remain.
    """
    while len(parts) >= 2 * FEWEST_BLOCKS:
        windows = np.array([(part.recording, part.window) for part in parts])
        same = (windows[1:] == windows[:-1]).all(axis=1)
        scores = deleted.scores - deleted.scores.mean(axis=0)
        products = np.sum(scores[1:] * scores[:-1], axis=1)[same]
        fewer = intervals(blocks, len(parts) // 2)
        if products.sum() <= CORRELATED * np.linalg.norm(products) or len(fewer) == len(parts):
            break
        parts, deleted = fewer, factors.jackknife([part.rows for part in fewer])
    return deleted


def deletion_covariance(deletions: Array) -> Array:
    """Return ``(m - 1)/m sum_i (d_i - mean)(d_i - mean)^T``, shape (b, b), for the changes d_i of m deletions, (m, b)."""
    centred = deletions - deletions.mean(axis=0)
    m = len(deletions)
    return np.asarray((m - 1) / m * centred.T @ centred)


def rescaled(covariance: Array, variances: Array) -> Array:
    """Return a covariance with the correlations of one, (b, b), and the variances of another, (b,)."""
    known = np.diag(covariance)
    size = np.sqrt(quotient(variances, known))
    return np.asarray(covariance * np.outer(size, size))


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
