r"""Maximum likelihood with noise in positions, velocities and accelerations: Olsen, Swevers and Verdonck (2003).

    G = S_tau + J_q S_q J_q^T + J_v S_v J_v^T + J_a S_a J_a^T      J = d tau / d (q, dq, ddq)
    min sum_t e_t^T G_t^-1 e_t,   e_t = tau_t - W_t x              iterated, as J depends on x

Every sample has its own covariance G over the joints. The noise of the derivatives is that of the positions times the gains of
filter and differences. The weights change the variance of the estimate but not its bias due to noise in W (docs/robust.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._tools.arrays import Array

SMALLEST_EIGENVALUE_SHARE = 1e-12
"""Lower bound of the eigenvalues of a covariance, as a share of the largest: noise-free torques keep finite weights."""


def sample_covariances(
    torque_noise: Array, jacobians: Sequence[Array], motion_noise: Sequence[Array]
) -> Array:
    """Return the covariance of the torque error of each sample, (n, d, d).

    Parameters
    ----------
    torque_noise : ndarray, shape (d,)
        Standard deviations of the torques of the rows (N.m or N).
    jacobians : sequence of ndarray, shape (n, d, d)
        Derivatives of the torques with respect to positions, velocities and accelerations.
    motion_noise : sequence of ndarray, shape (d,)
        Standard deviations of the same signals.
    """
    total = np.zeros_like(jacobians[0]) + np.diag(torque_noise**2)
    for jacobian, noise in zip(jacobians, motion_noise, strict=True):
        scaled = jacobian * noise
        total += scaled @ scaled.transpose(0, 2, 1)
    return total


def whitening(covariances: Array) -> Array:
    """Return ``L^-1`` of each ``G = L L^T``, (n, d, d): the rows of a sample times it have the unit covariance."""
    d = covariances.shape[1]
    trace = np.trace(covariances, axis1=1, axis2=2)[:, None, None]
    lower = np.linalg.cholesky(covariances + SMALLEST_EIGENVALUE_SHARE * trace * np.eye(d))
    return np.asarray(np.linalg.inv(lower))


def whitened(rows: Array, whiteners: Array) -> Array:
    """Multiply the rows of each sample by its whitener.

    Parameters
    ----------
    rows : ndarray, shape (d * n, m)
        Joint by joint.
    whiteners : ndarray, shape (n, d, d)
        From `whitening`.

    Returns
    -------
    ndarray, shape (d * n, m)
        Joint by joint.
    """
    n, d = whiteners.shape[:2]
    by_sample = rows.reshape(d, n, -1).transpose(1, 0, 2)
    return np.ascontiguousarray((whiteners @ by_sample).transpose(1, 0, 2)).reshape(d * n, -1)
