r"""Response of the simulated torques to the parameters, compared with the regressor along the motion.

DIDIM approximates ``d tau_s / d beta`` by the regressor W and neglects the dependence of the motion on the parameters. In a
tight loop this dependence is small. In a slack one it is not. With ``S = d tau_s / d beta`` in the rows of (7), ``A`` and
``A_S`` the weighted W and S, ``A = Q R``:

    F(beta) - beta* = P J (beta - beta*),  J = 1 - R^-1 Q^T A_S        one iteration of DIDIM near its fixed point
    beta* = beta + K (F(beta) - beta),     K = (1 - P J)^-1            a step of Newton's method to it
    C = G^-1 Q^T Sigma Q G^-T,             G = Q^T A_S                 covariance of the fixed point, instead of (10)

``P`` is the derivative of the solution with respect to that of plain least squares: 1 without constraints, and a projection if
physical constraints are active. Without P a Newton step would leave the set of robots and stall at its boundary.

The fixed point is the estimate with instruments W: ``W^T (y - tau_s) = 0``. The columns of S are differences of
simulations. Tested in ``tests/test_slack_loop.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array, quotient
from ...model.limbs import Directions
from ...regression.covariance import Factors, covariance_of_columns
from ...regression.fit import Fit
from ...regression.settings import LeastSquaresSettings
from ...robot.robot import Robot
from ...terms.rows import LinearSystem
from ..uncertainty import with_velocities

DIFFERENCE = 1.0
"""Change of the weighted torques in a finite difference, in standard deviations of a row: small enough for a linear
response."""
LARGEST_CONDITION = 1e7
"""Condition number of G beyond which the log does not determine the fixed point."""

Rows = Callable[[Sequence[Array]], list[Array] | None]
"""Torques of the simulated robot in the rows of (7), (r,) each, for changes of the estimated parameters, (n,) each; None if a
simulation ends early."""


def noise_of(fit: Fit) -> float:
    """Return the standard deviation of a weighted row."""
    rows, columns = len(fit.residual), len(fit.solution)
    return float(np.linalg.norm(fit.residual * fit.weights)) / float(np.sqrt(max(1, rows - columns)))


def share_moved(system: LinearSystem, fit: Fit, rows: Rows, base: Array) -> float | None:
    """Estimate the size of J by one random direction: nearly its Frobenius norm, in standard deviations; None if unknown.

    In the coordinates ``R beta`` all directions are equivalent, and the expected square along a random one is the sum of all
    squares.
    """
    weighted = system.w * fit.weights[:, None]
    size = np.linalg.norm(weighted, axis=0)
    if not np.all(size > 0.0):
        return None
    q, triangle = np.linalg.qr(weighted / size)
    n = len(size)
    # The signs of the triangle depend on the library; a positive diagonal makes the direction unique.
    signs = np.where(np.diag(triangle) < 0.0, -1.0, 1.0)
    random = np.random.default_rng(n).choice([-1.0, 1.0], n)
    if abs(np.diag(triangle)).min() < 1.0 / LARGEST_CONDITION:
        return None
    direction = np.linalg.solve(triangle, signs * random) / size
    along = system.w @ direction
    length = DIFFERENCE * noise_of(fit) / float(np.linalg.norm(along * fit.weights))
    row_change = rows([length * direction])
    if row_change is None:
        return None
    moved = q.T @ (((row_change[0] - base) / length - along) * fit.weights)
    return float(np.linalg.norm(moved))


@dataclass(frozen=True)
class Response:
    """The response in all directions.

    Attributes
    ----------
    slopes : (r, n) array
        S, without weights.
    jacobian : (n, n) array
        J.
    gain : (n, n) array
        K.
    rate : float
        Largest absolute eigenvalue of P J: the contraction rate along the slowest direction.
    """

    slopes: Array
    jacobian: Array
    gain: Array
    rate: float

    @classmethod
    def at(
        cls,
        system: LinearSystem,
        fit: Fit,
        rows: Rows,
        base: Array,
        robot: Robot,
        share: Array | None = None,
    ) -> Response | None:
        """Return the response at an iterate, by one simulation per parameter of the largest limb.

        None if one ends early, or G is singular. `share` is P, (n, n); None for 1.
        """
        sizes = np.linalg.norm(system.w * fit.weights[:, None], axis=0)
        if not np.all(sizes > 0.0):
            return None
        lengths = DIFFERENCE * noise_of(fit) / sizes
        acts = np.array([system.w[joint].any(axis=0) for joint in system.joints])
        directions = Directions.of(robot, acts)
        row_change = rows(list(directions.changes(lengths)))
        if row_change is None:
            return None
        slopes = np.column_stack(
            [
                (row_change[number] - base) / length
                for number, length in zip(directions.number, lengths, strict=True)
            ]
        )
        for joint, responding in zip(system.joints, directions.joints.T, strict=True):
            slopes[joint] *= responding
        left, triangle = np.linalg.qr(system.w * (fit.weights[:, None] / sizes))
        middle = left.T @ (slopes * (fit.weights[:, None] / sizes))
        if not np.linalg.cond(middle) < LARGEST_CONDITION:
            return None
        gain = np.linalg.solve(middle, triangle)
        rates = np.abs(1.0 - 1.0 / np.linalg.eigvals(gain))
        jacobian = np.eye(len(sizes)) - np.linalg.solve(triangle, middle)
        response = cls(
            slopes,
            sizes[:, None] ** -1 * jacobian * sizes,
            sizes[:, None] ** -1 * gain * sizes,
            float(rates.max()),
        )
        return response if share is None else response.under(share)

    def under(self, share: Array) -> Response:
        """Return the response of an iteration with constraints and their projection P, (n, n)."""
        held = share @ self.jacobian
        gain = np.asarray(np.linalg.inv(np.eye(len(held)) - held), dtype=np.float64)
        return replace(self, gain=gain, rate=float(np.abs(np.linalg.eigvals(held)).max()))

    def with_errors(self, system: LinearSystem, fit: Fit, settings: LeastSquaresSettings) -> Fit:
        """Return the fit with the covariance of the fixed point."""
        w = with_velocities(system, fit.solution).w
        instruments = w * fit.weights[:, None]
        answers = np.column_stack([self.slopes, w[:, len(system.names) :]]) * fit.weights[:, None]
        size = np.linalg.norm(instruments, axis=0)
        left = np.linalg.qr(instruments / size)[0]
        inverse = np.linalg.inv(left.T @ (answers / size)) / size[:, None]
        residual = fit.residual * fit.weights
        n = len(fit.solution)
        spread = covariance_of_columns(system, settings, left, residual, inverse)
        factors = Factors(left, answers @ inverse, inverse, residual)
        return replace(fit, covariance=spread[:n, :n], factors=factors)

    def wider(self, system: LinearSystem, fit: Fit, settings: LeastSquaresSettings) -> float:
        """Return the largest ratio of the fixed point's standard deviations to those of (10)."""
        before, after = fit.std, self.with_errors(system, fit, settings).std
        return float(np.max(quotient(after, before, 1.0)))
