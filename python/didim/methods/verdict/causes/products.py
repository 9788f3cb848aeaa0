"""Products of columns and torques, from which a model is fitted on some stretches of a log and judged on the others.

The score of a model is the geometric mean over the joints of the squared errors of torques that it did not see, in units of the
residuals of the declared model,

    log s = 1/n sum_j log( sum_f |y_jf - g_j W_jf beta_(f)|^2 / sigma_j^2 ),      beta_(f) fitted without the stretches f   (1)

which is a likelihood with a variance of its own for each joint: one joint that a hypothesis explains wholly counts for much, as it
should, where friction that the model lacks stays at the others. (1) follows from ``W_jf^T W_jf``, ``W_jf^T y_jf`` and
``y_jf^T y_jf`` of each joint and fold, once for all factors g. Tested in ``tests/test_verdict_rows.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...._tools.arrays import Array

SMALLEST_SQUARES = 1e-6
"""Lower bound of a joint's part of (1): a log without noise has a finite score."""
RIDGE = 1e-13
"""Added to the products of columns with norm 1, times their number: dependent columns then share what they explain together."""


@dataclass(frozen=True, eq=False)
class Products:
    """Products of the columns and torques of each fold and joint.

    Attributes
    ----------
    w : (n_folds, n_dof, b, b) array
        ``W^T W``, columns scaled to norm 1.
    wy : (n_folds, n_dof, b) array
        ``W^T y``.
    yy : (n_folds, n_dof) array
        ``y^T y``.
    scale : (b,) array
        Norms of the columns.
    """

    w: Array
    wy: Array
    yy: Array
    scale: Array

    @classmethod
    def of(cls, columns: Array, torque: Array, folds: Sequence[NDArray[np.intp]]) -> Products:
        """Return the products of columns, (n_dof, n_rows, b), and torques, (n_dof, n_rows); each fold is an array of its rows."""
        parts = [(columns[:, rows], torque[:, rows]) for rows in folds]
        w = np.stack([np.matmul(part.transpose(0, 2, 1), part) for part, _ in parts])
        wy = np.stack([np.matmul(part.transpose(0, 2, 1), told[:, :, None])[:, :, 0] for part, told in parts])
        scale = np.sqrt(np.einsum("fjbb->b", w))
        scale[scale == 0.0] = 1.0
        return cls(
            w=w / (scale[:, None] * scale),
            wy=wy / scale,
            yy=np.stack([np.sum(told**2, axis=1) for _, told in parts]),
            scale=scale,
        )

    def solutions(self, folds: Sequence[int], weights: Array, gains: Array) -> Array:
        """Return the parameters of the scaled columns fitted on some folds, for each row of weights and gains: (k, b)."""
        kept = list(folds)
        w, wy = self.w[kept].sum(axis=0), self.wy[kept].sum(axis=0)
        b = wy.shape[1]
        gram = np.tensordot(weights * gains**2, w, 1)
        gram[:, np.arange(b), np.arange(b)] += RIDGE * b * weights.max(axis=1, keepdims=True)
        return np.asarray(np.linalg.solve(gram, ((weights * gains) @ wy)[:, :, None])[:, :, 0])

    def solution(self, weights: Array) -> Array:
        """Return the parameters of the scaled columns fitted on all rows, (b,)."""
        return np.asarray(self.solutions(range(len(self.w)), weights[None], np.ones((1, len(weights))))[0])

    def squares(self, folds: Sequence[int], x: Array, gains: Array) -> Array:
        """Return the squared errors of each joint on some folds, for each row of parameters and gains: (k, n_dof)."""
        kept = list(folds)
        w, wy, yy = (item[kept].sum(axis=0) for item in (self.w, self.wy, self.yy))
        products = np.matmul(x[None], w)  # (n_dof, k, b)
        error = yy - 2.0 * gains * (x @ wy.T) + gains**2 * np.sum(products * x, axis=2).T
        return np.asarray(np.maximum(error, 0.0))

    def unseen(self, weights: Array, gains: Array) -> Array:
        """Return the squared errors of each joint on stretches not fitted, for each row of weights and gains: (k, n_dof)."""
        every = range(len(self.w))
        return np.asarray(
            sum(
                self.squares([fold], self.solutions([f for f in every if f != fold], weights, gains), gains)
                for fold in every
            )
        )

    def scores(self, weights: Array, gains: Array) -> Array:
        """Return (1) for each row of weights, (k, n_dof), and gains, (k, n_dof)."""
        squares = np.maximum(weights * self.unseen(weights, gains), SMALLEST_SQUARES)
        return np.asarray(np.exp(np.mean(np.log(squares), axis=1)))

    def score(self, weights: Array, gain: Array | None = None) -> float:
        """Return (1) for one row of weights and gains, (n_dof,) each; gains are 1 by default."""
        gains = np.ones_like(weights) if gain is None else gain
        return float(self.scores(weights[None], gains[None])[0])
