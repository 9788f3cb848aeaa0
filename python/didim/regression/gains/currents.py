"""Motor currents as the output: rows for the maximum likelihood and classical estimates of drive gains.

    i_m = (W_m theta + t_m) / K_m + e_m,     W_m = R^-T W,   t_m = R^-T t

with the torque t of the known parameters (known part of a payload, fixed parameters) and the reduction R. K is on the motor
side unless R is the identity. Tested in ``tests/test_drive_gains.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array
from ...robot.parameters import friction_names
from ...terms.rows import LinearSystem, unit_columns


@dataclass(frozen=True, eq=False)
class Currents:
    """The rows of a linear system on the motor side.

    Attributes
    ----------
    system : LinearSystem
        Joint-side system with ``R^T i`` (A) as its torques; its last n columns, which are zero, are those of the gains.
    current : (r,) array
        Motor currents (A).
    columns : (r, q) array
        Motor torques per unit of every parameter except the gains.
    known : (r,) array
        Motor torques of the known parameters.
    motor : (r,) array of int
        Motor of each row, from 0.
    """

    system: LinearSystem
    current: Array
    columns: Array
    known: Array
    motor: Array

    @classmethod
    def of(cls, system: LinearSystem, reduction: Array) -> Currents:
        """Convert the rows of a system to the motor side, with the (n, n) reduction matrix R."""
        n = len(system.joints)
        to_motor = np.linalg.inv(reduction).T

        def on_motor_side(values: Array) -> Array:
            parts = values.reshape(n, values.shape[0] // n, -1)
            return np.asarray(np.tensordot(to_motor, parts, axes=1), dtype=np.float64).reshape(values.shape)

        rows = system.y.size // n
        known = np.zeros_like(system.y) if system.known is None else system.known
        return cls(
            system=system,
            current=on_motor_side(system.measured),
            columns=on_motor_side(np.ascontiguousarray(system.w[:, :-n])),
            known=on_motor_side(known),
            motor=np.repeat(np.arange(n), rows),
        )

    def linearised(self, theta: Array, gains: Array) -> LinearSystem:
        """Return the rows as a system linearised in the parameters and the gains.

            K0 e = K0 i - t - T0 - W_m theta + T0/K0 K,     T0 = W_m theta0 + t

        Its rows are errors of the currents times `gains`, so residuals are motor torques, and its measured torques are ``K0
        i``. At the solution it is the Gauss-Newton step of the likelihood.

        Parameters
        ----------
        theta : (q,) array
            Parameters.
        gains : (n,) array
            Drive gains.
        """
        torque = self.columns @ theta + self.known
        own = gains[self.motor]
        return replace(
            self.system,
            w=np.ascontiguousarray(np.hstack([self.columns, self.motors * (-torque / own)[:, None]])),
            y=own * self.current - self.known - torque,
            known=self.known + torque,
            slopes={},
            alternatives=(),
        )

    def parameters(self, gains: Array) -> Array:
        """Estimate the parameters by least squares, for given gains, (q,)."""
        torques = gains[self.motor] * self.current - self.known
        return np.asarray(np.linalg.lstsq(self.columns / self.scale, torques, rcond=None)[0] / self.scale)

    @property
    def n_motors(self) -> int:
        """Number of motors."""
        return len(self.system.joints)

    @property
    def motors(self) -> Array:
        """Indicator of the motor of each row, (r, n)."""
        return np.asarray(np.eye(self.n_motors)[self.motor])

    @property
    def scale(self) -> Array:
        """Size of each column, (q,), for conditioning."""
        return unit_columns(self.columns)[1]

    def spread(self, errors: Array) -> Array:
        """Root mean square of the errors of each motor, (n,), never zero."""
        floor = 1e-9 * max(float(np.sqrt(np.mean(self.current**2))), np.finfo(float).tiny)
        squares = np.bincount(self.motor, weights=errors**2, minlength=self.n_motors)
        return np.asarray(np.maximum(np.sqrt(squares / np.bincount(self.motor)), floor))

    def inverse_gain(self) -> float:
        """Return 1/K of one gain K of all motors, the start of the others: ``i = W (theta/K) + t/K`` is linear in both."""
        a, size = unit_columns(np.column_stack([self.columns, self.known]))
        return float(np.linalg.lstsq(a, self.current, rcond=1e-10)[0][-1] / size[-1])

    def signs(self) -> Array:
        """Return the sign of each motor's gain, (n,), with which friction brakes."""
        names = self.system.names
        signs = np.ones(self.n_motors)
        for motor in range(self.n_motors):
            rows = self.motor == motor
            a = self.columns[rows] / self.scale
            used = np.linalg.norm(a, axis=0) > 0.0
            solution = np.zeros(a.shape[1])
            solution[used] = np.linalg.lstsq(a[:, used], self.current[rows], rcond=1e-8)[0]
            friction = [k for k in np.flatnonzero(used) if names[k] in friction_names(motor)]
            if friction and sum(solution[k] for k in friction) < 0.0:
                signs[motor] = -1.0
        return signs
