"""The body nearest to estimated inertial parameters, for many draws at once.

    min_theta 1/2 |R (theta - theta^)|^2 + gamma (tr(P0^-1 P) - log det P),    P = P(chi_0 + V theta) > 0,    R^T R = C^-1

with the pseudo-inertia P (4, 4) of ten parameters, by Newton steps within the constraints. gamma is small: it only affects
parameters that the log does not identify. Sources: Wensing, Kim and Slotine (2017), Lee, Wensing and Park (2019). Tested in
``tests/test_payload.py``.
"""

from __future__ import annotations

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...robot.rigid_body import body_pseudo_inertia, pose, pseudo_inertia, ten_parameters

GAMMA = 1e-2
"""Weight (nats) of the prior of a payload."""
RADIUS_M = 0.06
"""Radius of gyration (m) of the prior body: that of a load between a fist and a head in size."""
LEAST_MASS_KG = 0.05
"""Lower bound of the prior body's mass (kg)."""
BODY_STEPS = 200
"""Upper bound of the Newton steps."""
SETTLED_NATS = 1e-10
"""Newton decrement (nats) below which the iteration has converged."""


def nearest_bodies(estimates: Array, covariance: Array, known: Array, columns: Array) -> Array:
    """Find the bodies nearest to estimates.

    Parameters
    ----------
    estimates : (m, k) array
        Unknown parameters, one row for each draw.
    covariance : (k, k) array
        Their covariance.
    known : (10,) array
        Known part of the ten parameters.
    columns : (10, k) array
        Columns of the unknown ones.

    Returns
    -------
    (m, 10) array
        Ten parameters of bodies, ``XX XY XZ YY YZ ZZ MX MY MZ M``.

    Raises
    ------
    FitError
        When the estimated parameters do not describe a body, as for a planar arm.
    """
    basis = np.stack([pseudo_inertia(column) for column in columns.T])
    constant = pseudo_inertia(known)
    start = _inside(estimates.mean(axis=0), known, columns)
    theta = np.tile(start, (len(estimates), 1))
    prior = constant + np.tensordot(start, basis, axes=1)
    # A prior at the scale of the estimate does not affect identified parameters.
    slope = GAMMA * np.einsum("ab,kba->k", np.linalg.inv(prior), basis)
    metric = np.linalg.inv(covariance)

    def inverse_of(points: Array) -> tuple[Array, Array]:
        """Inverse pseudo-inertias, and the cost; infinite outside."""
        body = constant + np.tensordot(points, basis, axes=1)
        inside = np.linalg.eigvalsh(body)[:, 0] > 0.0
        safe = np.where(inside[:, None, None], body, np.eye(4))
        away = points - estimates
        cost = 0.5 * np.einsum("mi,ij,mj->m", away, metric, away) + points @ slope
        cost -= GAMMA * np.linalg.slogdet(safe)[1]
        return np.linalg.inv(safe), np.where(inside, cost, np.inf)

    inverse, cost = inverse_of(theta)
    for _ in range(BODY_STEPS):
        weighted = np.einsum("mab,kbc->mkac", inverse, basis)
        gradient = (theta - estimates) @ metric + slope - GAMMA * np.einsum("mkaa->mk", weighted)
        hessian = metric + GAMMA * np.einsum("mkab,mlba->mkl", weighted, weighted)
        size = 1.0 / np.sqrt(np.einsum("mkk->mk", hessian))
        scaled = hessian * size[:, :, None] * size[:, None, :]
        step = -size * np.linalg.solve(scaled, (gradient * size)[:, :, None])[:, :, 0]
        decrement = -np.einsum("mk,mk->m", gradient, step)
        if decrement.max() < SETTLED_NATS:
            break
        length = np.ones(len(theta))
        for _ in range(60):
            _, there = inverse_of(theta + length[:, None] * step)
            worse = there > cost - 0.25 * length * decrement + 1e-12 * np.abs(cost)
            if not worse.any():
                break
            length = np.where(worse, 0.5 * length, length)
        length = np.where(worse, 0.0, length)
        theta = theta + length[:, None] * step
        inverse, cost = inverse_of(theta)
        if not length.any():
            break
    return known + theta @ columns.T


def _inside(estimate: Array, known: Array, columns: Array) -> Array:
    """Return parameters of a body near the estimated mass and centre."""
    ten = known + columns @ estimate
    mass = max(float(ten[9]), LEAST_MASS_KG)
    centre = ten[6:9] / (ten[9] if ten[9] > 0.0 else mass)
    centre *= min(1.0, 1.0 / max(float(np.linalg.norm(centre)), 1e-300))
    inertia = 2.0 * mass * RADIUS_M**2 * np.eye(3)
    body = ten_parameters(body_pseudo_inertia(mass, inertia, pose(np.eye(3), centre)))
    start = np.linalg.lstsq(columns, body - known, rcond=None)[0]
    if not np.linalg.eigvalsh(pseudo_inertia(known + columns @ start))[0] > 0.0:
        raise FitError("the parameters that the arm shows describe no body by themselves")
    return np.asarray(start)
