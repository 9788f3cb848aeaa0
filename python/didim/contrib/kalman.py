r"""The extended Kalman filter for state and parameters: measured torques in, measured positions out.

    state (q, dq, beta);   dq' = ddq(q, dq, tau, beta) = M^-1 (tau - N),   beta' = 0
    d ddq / d beta = -M^-1 Y,   d ddq / d(q, dq) = -M^-1 d tau/d(q, dq)      tau(q, dq, ddq), at constant ddq
    dq+ = dq + h (I - h d ddq/d dq)^-1 ddq,   q+ = q + h dq+                  linearly implicit Euler
    noise of a step: h K M^-1 S_tau M^-T K^T h,   K = (I - h d ddq/d dq)^-1

The step must be implicit, because friction near standstill is stiff: with 18 000 1/s on the TX40, an explicit Euler step of 0.1
ms diverges. Measured limits are in docs/robust.md. Sources: Gautier and Poignet (2001); Ljung (1979) for the bias of its
covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from ..robot.robot import Robot
from .partials import CENTRAL_DIFFERENCE


@dataclass(eq=False)
class Filter:
    """State of the filter.

    Parameters
    ----------
    robot : Robot
        Robot with the smooth friction of a simulation.
    state : ndarray, shape (2 d + b,)
        Positions, velocities and the estimated parameters.
    covariance : ndarray, shape (2 d + b, 2 d + b)
        Covariance of the state.
    known : ndarray, shape (n_base,)
        Values of fixed parameters, zero elsewhere.
    estimated : sequence of int
        Base parameters in the state.
    torque_noise, position_noise : ndarray, shape (d,)
        Standard deviations of a sample.
    """

    robot: Robot
    state: Array
    covariance: Array
    known: Array
    estimated: list[int]
    torque_noise: Array
    position_noise: Array

    def __post_init__(self) -> None:
        base = self.robot.base_parameters
        self._columns = [base.indices[index] for index in self.estimated]
        d = self.robot.n_dof
        step, zero = CENTRAL_DIFFERENCE * np.eye(d), np.zeros((d, d))
        self._q = np.vstack([step, -step, zero, zero])
        self._dq = np.vstack([zero, zero, step, -step])

    @property
    def beta(self) -> Array:
        """All base parameters, (n_base,)."""
        beta = self.known.copy()
        beta[self.estimated] = self.state[2 * self.robot.n_dof :]
        return beta

    def predict(self, tau: Array, step: float) -> bool:
        """Advance by a step (s) under measured torques, (d,).

        Returns False after a divergence: M(q) is not positive definite, or a number is not finite.
        """
        robot, d = self.robot, self.robot.n_dof
        q, dq = self.state[:d], self.state[d : 2 * d]
        x = robot.base_parameters.lift(self.beta)
        if not np.isfinite(self.state).all() or np.abs(q).max() > 1e3 or np.abs(dq).max() > 1e4:
            return False
        here = np.ascontiguousarray(q[None])
        inertia = np.asarray(_core.inertia_matrix(robot.core, here, x))[0]
        try:
            factor = np.linalg.cholesky(inertia)
        except np.linalg.LinAlgError:
            return False
        inverse = np.linalg.inv(factor)
        inverse = inverse.T @ inverse
        zero = np.zeros((1, d))
        rest = np.asarray(_core.inverse_dynamics(robot.core, here, np.ascontiguousarray(dq[None]), zero, x))[
            0
        ]
        ddq = inverse @ (tau - rest)
        # Torques at shifted positions and velocities, at this acceleration: differences are its derivatives.
        shifted = np.asarray(
            _core.inverse_dynamics(robot.core, q + self._q, dq + self._dq, np.tile(ddq, (4 * d, 1)), x)
        )
        up_q, down_q, up_dq, down_dq = shifted.reshape(4, d, d)
        by_q, by_dq = (
            (up_q - down_q).T / (2.0 * CENTRAL_DIFFERENCE),
            (up_dq - down_dq).T / (2.0 * CENTRAL_DIFFERENCE),
        )
        columns = np.asarray(
            _core.observation(
                robot.core,
                here,
                np.ascontiguousarray(dq[None]),
                np.ascontiguousarray(ddq[None]),
                self._columns,
                [],
                1,
            )
        )
        implicit = np.linalg.inv(np.eye(d) + step * inverse @ by_dq)
        gain = step * implicit @ inverse
        velocity = dq + step * (implicit @ ddq)
        n = self.state.size
        # Rows of the transition of q and dq; the parameters are constant.
        top = np.zeros((2 * d, n))
        top[d:, :d] = -gain @ by_q
        top[d:, d : 2 * d] = np.eye(d) - gain @ by_dq
        top[d:, 2 * d :] = -gain @ columns
        top[:d] = step * top[d:]
        top[:d, :d] += np.eye(d)
        self.state[:d], self.state[d : 2 * d] = q + step * velocity, velocity
        moved = top @ self.covariance
        self.covariance[: 2 * d] = moved
        self.covariance[: 2 * d, : 2 * d] = moved @ top.T
        self.covariance[2 * d :, : 2 * d] = moved[:, 2 * d :].T
        noise = gain * self.torque_noise
        spread = np.vstack([step * noise, noise])
        self.covariance[: 2 * d, : 2 * d] += spread @ spread.T
        return True

    def correct(self, q: Array) -> None:
        """Update the state with measured positions, (d,)."""
        d = q.size
        columns = self.covariance[:, :d]
        innovation = columns[:d] + np.diag(self.position_noise**2)
        gain = np.linalg.solve(innovation, columns.T).T
        self.state += gain @ (q - self.state[:d])
        self.covariance -= gain @ columns.T
        self.covariance = 0.5 * (self.covariance + self.covariance.T)
