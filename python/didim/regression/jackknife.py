r"""Standard deviations by leaving parts of the log out: the delete-block jackknife.

The rows of all joints within a time interval form a block. Model error and noise that are correlated within a block, or change
along the motion, are then included in the uncertainty, unlike in (10). With ``A`` the weighted observation matrix, ``rho`` the
weighted residual and ``Q_i``, ``rho_i`` the rows of block i, for ``A = Q R``:

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

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array, quotient
from ..terms.rows import Block, LinearSystem, Rows, by_window, unit_columns
from .settings import BLOCKS

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
