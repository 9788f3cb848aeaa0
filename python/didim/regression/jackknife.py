r"""Standard deviations by leaving parts of the log out: the delete-block jackknife.

The rows of all joints within a time interval form a block. Model error and noise that are correlated within a block, or that
change along the motion, then count as the uncertainty that they are, which (10) does not know of. With ``A`` the weighted
observation matrix, ``rho`` the weighted residual and ``Q_i``, ``rho_i`` the rows of block i, for ``A = Q R``:

    b_(i) - b = -R^-1 (I - Q_i^T Q_i)^-1 Q_i^T rho_i          exact, with the weights of the whole log
    C_J = (m - 1)/m sum_i (b_(i) - mean)(b_(i) - mean)^T
    C = D C_now D,    D = diag sqrt(C_J,kk / C_now,kk)

``C`` has the variances of ``C_J``, whose rank is only m - 1, and the correlations of ``C_now``. Estimates with instruments
``Z = Q R`` in place of ``A`` have ``-G^-1 (I - Q_i^T A_i G^-1)^-1 Q_i^T rho_i`` with ``G = Q^T A``, so that both are one
function of a left factor ``Q``, a right factor ``A G^-1`` and ``G^-1``.

Sources: Quenouille (1956), Tukey (1958); Kuensch (1989) for blocks; Cameron and Miller (2015) for clusters.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array

Rows = NDArray[np.intp]

BLOCKS = 20
"""Default number of blocks: 10 to 20 serve alike on real logs, with 30 the blocks of a log of 9 s are no longer independent."""
DECISIVE_SHARE = 0.9
"""Share of the information on a parameter from which a single block determines it: without the block its standard deviation
is more than three times as large, and the spread of the estimates is that of a single number."""
LARGEST_EIGENVALUE = 1.0 - 1e-9
"""Eigenvalue of ``Q_i^T Q_i`` from which the other blocks do not determine a direction: the estimate keeps its value there."""


@dataclass(frozen=True, eq=False)
class Jackknife:
    """Estimates with one block left out at a time.

    Attributes
    ----------
    deletions : ndarray, shape (m, b)
        Estimate without block i less that of the whole log.
    information : ndarray, shape (m, b)
        Share of the information on each parameter that block i holds: one less the ratio of its variances, for white noise, with
        and without the block.
    leverage : float
        Largest eigenvalue of all ``Q_i^T Q_i``; a value near one belongs to a direction that a single block determines.
    """

    deletions: Array
    information: Array
    leverage: float

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


def time_blocks(windows: Sequence[Sequence[slice]], seconds: Sequence[float], count: int) -> list[Rows]:
    """Divide the rows of windows into blocks of about equal duration; no block spans two windows.

    Parameters
    ----------
    windows : sequence of sequence of slice
        Rows of each joint (and output) in each window, all of one window with the same number of rows.
    seconds : sequence of float
        Duration of each window.
    count : int
        Blocks wanted; with more windows than that every window is a block.

    Returns
    -------
    list of ndarray of int
        Rows of each block, all joints.

    Notes
    -----
    ``test_jackknife.py`` checks that every row is in one block and that no block spans two windows.
    """
    lengths = [len(range(*rows[0].indices(rows[0].stop))) for rows in windows]
    parts = _shares(lengths, seconds, count)
    blocks: list[Rows] = []
    for rows, length, number in zip(windows, lengths, parts, strict=True):
        index = [np.arange(*joint.indices(joint.stop)) for joint in rows]
        edges = np.linspace(0, length, number + 1).round().astype(int)
        for start, stop in itertools.pairwise(edges):
            blocks.append(np.concatenate([joint[start:stop] for joint in index]))
    return blocks


def _shares(lengths: Sequence[int], seconds: Sequence[float], count: int) -> list[int]:
    """Return the number of blocks of each window: one at least, the rest where the blocks are longest."""
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


def jackknife(
    left: Array, right: Array, inverse: Array, residual: Array, blocks: Sequence[Rows]
) -> Jackknife:
    """Compute the estimates without each block, from the factors of the whole system.

    Parameters
    ----------
    left : ndarray, shape (r, b)
        ``Q`` of the weighted observation matrix, or of the weighted instruments.
    right : ndarray, shape (r, b)
        The same ``Q``, or with instruments ``A G^-1``.
    inverse : ndarray, shape (b, b)
        ``R^-1``, or ``G^-1``.
    residual : ndarray, shape (r,)
        Weighted residual of the estimate.
    blocks : sequence of ndarray of int
        Rows of each block: at least two blocks.

    Returns
    -------
    Jackknife
        Changes of the estimate, in the units of the parameters.

    Notes
    -----
    A direction that the other blocks do not determine keeps its value. ``test_jackknife.py`` solves the system again without each
    block.
    """
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
        without = np.einsum("mki,mi->mk", spread, 1.0 / np.maximum(1.0 - values, 1e-300))
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
    return Jackknife(deletions, 1.0 - variances / np.maximum(without, variances), leverage)


def deletion_covariance(deletions: Array) -> Array:
    """Return ``(m - 1)/m sum_i (d_i - mean)(d_i - mean)^T``, shape (b, b), for the changes d_i of m deletions, (m, b)."""
    centred = deletions - deletions.mean(axis=0)
    m = len(deletions)
    return np.asarray((m - 1) / m * centred.T @ centred)


def rescaled(covariance: Array, variances: Array) -> Array:
    """Return a covariance with the correlations of one, (b, b), and the variances of another, (b,)."""
    known = np.diag(covariance)
    size = np.sqrt(np.divide(variances, known, out=np.zeros_like(known), where=known > 0.0))
    return np.asarray(covariance * np.outer(size, size))
