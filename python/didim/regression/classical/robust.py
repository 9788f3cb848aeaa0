r"""Robust regression by iteratively reweighted least squares: Huber's and Tukey's M-estimators.

    u = rho / s_j,   s_j = 1.4826 median |rho_j|        the residual of joint j in robust standard deviations
    weight = psi(u) / u      Huber: min(1, c / |u|);   bisquare: (1 - (u / c)^2)^2 within c, else 0

The weighted problem is solved until the estimate converges. Sources: Huber (1964); Beaton and Tukey (1974); Holland and
Welsch (1977). The constants give both an efficiency of 95 % with normal noise.

Residuals of a robot are large at reversals, where the friction model is wrong. These are not outliers, and ignoring them does
not improve the prediction of other motions (docs/idim_ls.md). Spikes are best removed before the decimation (`signal.spikes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..._tools.arrays import Array
from ...signal.spikes import NORMAL_MAD

Loss = Literal["huber", "bisquare"]

CONSTANTS: dict[str, float] = {"huber": 1.345, "bisquare": 4.685}
"""Tuning constants with 95 % efficiency under normal noise."""
SETTLED_ESTIMATE = 1e-8
"""Change of an estimate, in torques relative to its column's share of them, below which the iteration has converged."""
MOST_REWEIGHTINGS = 500
"""Upper bound of the number of reweightings."""
SMALLEST_STD_SHARE = 1e-9
"""Lower bound of a robust standard deviation, as a share of the joint's torque: weights stay finite without noise."""


@dataclass(frozen=True, eq=False)
class RobustSolution:
    """An M-estimate of the linear system.

    Attributes
    ----------
    solution : ndarray, shape (b,)
        Estimate.
    weights : ndarray, shape (r,)
        ``psi(u)/u`` of each row: 1 for full weight.
    scale : ndarray, shape (n_dof,)
        Robust standard deviation of each joint's residual, in the unit of its torque.
    iterations : int
        Solutions of the weighted problem.
    converged : bool
        Whether the estimate converged before the last iteration.
    """

    solution: Array
    weights: Array
    scale: Array
    iterations: int
    converged: bool


def psi_weights(u: Array, loss: Loss, constant: float) -> Array:
    """Return ``psi(u)/u`` of standardised residuals, the same shape."""
    size = np.abs(u)
    if loss == "huber":
        return np.asarray(constant / np.maximum(size, constant))
    return np.asarray(np.where(size < constant, (1.0 - np.minimum(size / constant, 1.0) ** 2) ** 2, 0.0))


def reweighted(
    w: Array,
    y: Array,
    joints: Sequence[slice],
    start: Array,
    *,
    loss: Loss = "huber",
    constant: float | None = None,
) -> RobustSolution:
    """Solve ``W x = Y`` by iteratively reweighted least squares.

    Parameters
    ----------
    w, y : ndarray, shapes (r, b), (r,)
        The system, without weights.
    joints : sequence of slice
        Rows of each joint, each with its own scale.
    start : ndarray, shape (b,)
        First estimate: that of weighted least squares.
    loss : {"huber", "bisquare"}
        Huber's function bounds the influence of a row, Tukey's bisquare reduces it to zero.
    constant : float, optional
        Tuning constant in robust standard deviations; that of `CONSTANTS` by default.

    Returns
    -------
    RobustSolution
        Estimate and weights.

    Notes
    -----
    ``test_robust.py`` minimises the sum of Huber's function directly, and plants outliers.
    """
    constant = CONSTANTS[loss] if constant is None else constant
    x = np.array(start, dtype=np.float64)
    columns = np.linalg.norm(w, axis=0)
    floors = [SMALLEST_STD_SHARE * float(np.sqrt(np.mean(y[rows] ** 2))) for rows in joints]
    scale, weights = np.ones(len(joints)), np.ones(y.size)
    for number in range(1, MOST_REWEIGHTINGS + 1):
        residual = y - w @ x
        root = np.empty(y.size)
        for joint, rows in enumerate(joints):
            scale[joint] = max(NORMAL_MAD * float(np.median(np.abs(residual[rows]))), floors[joint], 1e-300)
            weights[rows] = psi_weights(residual[rows] / scale[joint], loss, constant)
            root[rows] = np.sqrt(weights[rows]) / scale[joint]
        solution = np.linalg.lstsq((w / columns) * root[:, None], y * root, rcond=None)[0] / columns
        change = float(np.max(np.abs(solution - x) * columns)) / max(
            float(np.linalg.norm(w @ solution)), 1e-300
        )
        x = solution
        if change <= SETTLED_ESTIMATE:
            return RobustSolution(x, weights, scale, number, True)
    return RobustSolution(x, weights, scale, MOST_REWEIGHTINGS, False)
