r"""Drive gains that a log does not check. Tested in ``tests/test_evidence_causes.py``.

The gain of joint j is checked by the parameters that its torque shares with other joints. With ``p_j`` its modelled torque, on its
own rows, and ``M`` the projection beside all columns W, both weighted by the noise, the log of the gain has the information

    I_j = |M p_j|^2,    sigma_j^2 = m/(m - 1) sum_i (M p_j)_i^T rho_i)^2 / I_j^2

over m intervals of time, where rho is the residual: errors of the model that are correlated in time count as what they are.
"""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array
from ..result.finding import Finding
from .rows import LogRows

UNCHECKED_SIGMA = 0.3
"""Standard deviation of a gain's logarithm from which the log cannot check the gain: doubling it is 2.3 of these."""
INDEPENDENT = 1e-6
"""Singular value of unit-norm columns, as a share of the largest, below which they count as dependent."""
INTERVALS = 20
"""Number of time intervals m, as in the jackknife."""


def unchecked(rows: LogRows) -> list[Finding]:
    """Return a note on the joints whose gain the log does not check; none where it checks all."""
    sigma, share = gain_information(rows)
    joints = [int(joint) for joint in np.flatnonzero(np.logical_not(sigma < UNCHECKED_SIGMA))]
    if rows.n < 2 or not joints:
        return []
    largest = float(sigma[joints].max())
    return [
        Finding(
            code="gain-unchecked",
            grade="note",
            joints=tuple(joint + 1 for joint in joints),
            value=largest if np.isfinite(largest) else None,
            facts={"shares": share[joints].tolist()},
        )
    ]


def gain_information(rows: LogRows) -> tuple[Array, Array]:
    """Return the standard deviation of the log of each joint's gain, and the share of its torque that checks it, (n,) each."""
    n, n_rows, b = rows.w.shape
    root = np.sqrt(n_rows / np.maximum(rows.products.seen(), np.finfo(float).tiny))
    columns = (rows.w * root[:, None, None] / rows.products.scale).reshape(n * n_rows, b)
    left, triangle = np.linalg.qr(columns)
    inner, values, _ = np.linalg.svd(triangle)
    left = left @ inner[:, values > INDEPENDENT * values[0]]
    y = (rows.y * root[:, None]).reshape(-1)
    model = left @ (left.T @ y)
    residual = (y - model).reshape(n, n_rows)
    sigma, share = np.full(n, np.inf), np.zeros(n)
    intervals = np.arange(n_rows) * INTERVALS // n_rows
    for joint in range(n):
        own = np.zeros((n, n_rows))
        own[joint] = model.reshape(n, n_rows)[joint]
        beside = own.reshape(-1) - left @ (left.T @ own.reshape(-1))
        information = float(beside @ beside)
        if not information > 0.0:
            continue
        scores = np.bincount(intervals, np.sum(beside.reshape(n, n_rows) * residual, axis=0), INTERVALS)
        sigma[joint] = np.sqrt(INTERVALS / (INTERVALS - 1) * float(scores @ scores)) / information
        share[joint] = information / float(own[joint] @ own[joint])
    return sigma, share
