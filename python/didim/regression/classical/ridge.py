r"""Ridge regression: least squares with a penalty on the distance from prior values.

    min |A x - y|^2 + k |D (x - x_0)|^2,      D = diag of the norms of the columns of A

With unit columns the penalty does not depend on the units of parameters. The strength k is given, or chosen on a grid by
cross-validation over blocks of time. Sources: Hoerl and Kennard (1970); Golub, Heath and Wahba (1979) for the choice by
prediction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._tools.arrays import Array
from ...terms.rows import Rows, unit_columns

STRENGTHS = tuple(10.0**power for power in np.arange(-8.0, 0.01, 0.5))
"""Ridge strengths that are compared, as shares of a column's squared norm."""


def ridge(a: Array, y: Array, strength: float, prior: Array | None = None) -> Array:
    """Solve ``A x = y`` with a penalty on the distance from prior values.

    Parameters
    ----------
    a, y : ndarray, shapes (r, b), (r,)
        Weighted observation matrix and torques.
    strength : float
        ``k``, not negative; 0 is least squares.
    prior : ndarray, shape (b,), optional
        ``x_0``; zero by default.

    Returns
    -------
    ndarray, shape (b,)
        Estimate.

    Notes
    -----
    ``test_robust.py`` compares with the normal equations.
    """
    unit, size = unit_columns(a)
    known = np.zeros(a.shape[1]) if prior is None else prior
    rows = np.vstack([unit, np.sqrt(strength) * np.eye(a.shape[1])])
    target = np.concatenate([y - a @ known, np.zeros(a.shape[1])])
    return np.asarray(known + np.linalg.lstsq(rows, target, rcond=None)[0] / size)


def chosen_strength(a: Array, y: Array, blocks: Sequence[Rows]) -> tuple[float, Array]:
    """Choose the strength of `STRENGTHS` with the smallest error on held-out blocks of time.

    Parameters
    ----------
    a, y
        As for `ridge`.
    blocks : sequence of ndarray of int
        Rows of each block.

    Returns
    -------
    strength : float
        The best one.
    errors : ndarray, shape (n_strengths,)
        Root mean square of the weighted errors of prediction, per strength.
    """
    rows, _ = unit_columns(a)
    parts = [(rows[index], y[index]) for index in blocks]
    grams = np.stack([part.T @ part for part, _ in parts])
    sides = np.stack([part.T @ value for part, value in parts])
    gram, side = grams.sum(axis=0), sides.sum(axis=0)
    identity = np.eye(a.shape[1])
    errors = []
    for strength in STRENGTHS:
        estimates = np.linalg.solve(gram - grams + strength * identity, (side - sides)[:, :, None])[:, :, 0]
        squares = sum(
            float(np.sum((value - part @ estimate) ** 2))
            for (part, value), estimate in zip(parts, estimates, strict=True)
        )
        errors.append(np.sqrt(squares / y.size))
    return float(STRENGTHS[int(np.argmin(errors))]), np.array(errors)
