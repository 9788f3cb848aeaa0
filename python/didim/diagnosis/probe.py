"""The equations of a log under other readings of it: a sign turned, columns exchanged, another unit, side, rate or gear.

A reading maps the logged positions and torques, ``q' = A q`` and ``tau' = T tau``, and stretches time, ``dq' = r A dq`` and
``ddq' = r^2 A ddq``: filters and decimation are linear, so that nothing is filtered again. What is left of the torques after
the best parameters, or after known ones,

    c^2 = sum_j v_j min_beta |y'_j - W'_j beta|^2,     y'_j = sum_i T_ji y_i

follows from the products ``W'_j^T W'_j``, ``W'_j^T y_i`` and ``y_i^T y_k``, once for all T. Tested in ``tests/test_check.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._tools.arrays import Array
from ..errors import DidimError
from ..methods.job import Job
from ..regression.linear_system import linear_system
from ..signal.decimation import decimate, decimation_stages
from ..signal.segments import Segment

SMALLEST_EIGENVALUE = 1e-12
"""Relative eigenvalue of the products of unit-norm columns below which the columns count as dependent."""

SMALLEST_SHARE = 1e-6
"""Lower bound of a joint's residual, as a share of its torque: weights stay finite on logs without noise."""


@dataclass(frozen=True, eq=False)
class Reading:
    """How logged columns are read.

    Attributes
    ----------
    position, torque : (n_dof, n_dof) array
        A and T.
    rate : float
        r, times the declared rate.
    """

    position: Array
    torque: Array
    rate: float = 1.0

    def after(self, earlier: Reading) -> Reading:
        """Return this reading of what another one read."""
        return Reading(
            self.position @ earlier.position, self.torque @ earlier.torque, self.rate * earlier.rate
        )


@dataclass(frozen=True, eq=False)
class _Products:
    w: Array  # (n, b, b)
    wy: Array  # (n, n, b): rows of joint j, torque of joint i
    scale: Array  # (b,): norms of the columns


class Probe:
    """Residuals of a log under readings.

    Parameters
    ----------
    job : Job
        Robot, filters and parameters that are estimated.
    parts : sequence of Segment
        The log as it is declared.
    beta : (b,) array, optional
        Known parameters that are not estimated.
    """

    def __init__(self, job: Job, parts: Sequence[Segment], beta: Array | None = None) -> None:
        self._job, self._parts, self._beta = job, parts, beta
        self._known: dict[bytes, _Products | None] = {}
        stages = [decimation_stages(part.q.shape[0], job.signal) for part in parts]
        kept = job.signal.kept_rows
        y = [decimate(part.tau, stage)[kept] for part, stage in zip(parts, stages, strict=True)]
        self._y = np.ascontiguousarray(np.concatenate(y).T)
        with np.errstate(over="ignore", invalid="ignore"):  # reported by the fit
            self._yy = self._y @ self._y.T
        self.n_rows = self._y.shape[1]
        self.n_samples = sum(len(part.q) for part in parts)
        self.parameters = job.parameters
        self.names = [job.parameters.names[k] for k in job.selection.estimated]
        self.viscous = [k for k, name in enumerate(self.names) if name.startswith("Fv")]

    def sizes(self, torque: Array) -> Array:
        """Norms of the torques of each joint, (n_dof,)."""
        return np.asarray(np.sqrt(np.einsum("ji,ik,jk->j", torque, self._yy, torque)))

    def _products(self, reading: Reading) -> _Products | None:
        key = reading.position.tobytes() + np.float64(reading.rate).tobytes()
        if key not in self._known:
            self._known[key] = self._made(reading)
        return self._known[key]

    def _made(self, reading: Reading) -> _Products | None:
        a, r = reading.position.T, reading.rate
        moved = [
            replace(
                part,
                q=np.ascontiguousarray(part.q @ a),
                dq=np.ascontiguousarray(r * part.dq @ a),
                ddq=np.ascontiguousarray(r**2 * part.ddq @ a),
            )
            for part in self._parts
        ]
        try:
            system = linear_system(
                self._job.robot, moved, self._job.signal, self._job.selection, logs=self._job.parameters
            )
        except DidimError:  # too large for floating point: this is not how the log is meant
            return None
        n = len(system.joints)
        scale = np.linalg.norm(system.w, axis=0)
        scale[scale == 0.0] = 1.0
        w = (system.w / scale).reshape(n, self.n_rows, -1)
        return _Products(
            w=np.matmul(w.transpose(0, 2, 1), w),
            wy=np.stack([self._y @ rows for rows in w]),
            scale=scale,
        )

    def solve(self, reading: Reading, weights: Array) -> tuple[float, Array]:
        """Return c^2 and the parameters, for weights v_j of the squares of each joint, (n_dof,)."""
        products = self._products(reading)
        if products is None:
            return float("inf"), np.zeros(len(self.names))
        gram = np.einsum("j,jab->ab", weights, products.w)
        told = np.einsum("j,ji,jib->b", weights, reading.torque, products.wy)
        total = float(weights @ self.sizes(reading.torque) ** 2)
        if self._beta is not None:
            x = self._beta * products.scale
            return max(0.0, total - 2.0 * float(told @ x) + float(x @ gram @ x)), self._beta
        values, vectors = np.linalg.eigh(gram)
        kept = values > SMALLEST_EIGENVALUE * values[-1]
        part = vectors[:, kept].T @ told / values[kept]
        x = vectors[:, kept] @ part
        return max(0.0, total - float(told @ x)), x / products.scale

    def relative(self, reading: Reading) -> tuple[float, Array]:
        """Return what is left of the torques, joints counting alike (0.1 = 10 %), and the parameters."""
        sizes = self.sizes(reading.torque)
        if not (sizes > 0.0).all():
            return float("inf"), np.zeros(len(self.names))
        left, solution = self.solve(reading, 1.0 / sizes**2)
        return float(np.sqrt(left / len(sizes))), solution

    def information(self, reading: Reading) -> tuple[Array, Array, Array]:
        """Return ``sum_j W_j^T W_j / sigma_j^2`` (b, b) for sigma_j the residuals of each joint, these, and the parameters."""
        products = self._products(reading)
        assert products is not None
        sizes = self.sizes(reading.torque)
        _, solution = self.solve(reading, 1.0 / np.maximum(sizes, np.finfo(float).tiny) ** 2)
        x = solution * products.scale
        told = np.einsum("ji,jib->jb", reading.torque, products.wy)
        left = sizes**2 - 2.0 * told @ x + np.einsum("a,jab,b->j", x, products.w, x)
        # Rounding, or a log without noise, must not make a joint exact.
        sigma = np.sqrt(np.maximum(left, SMALLEST_SHARE**2 * sizes**2) / self.n_rows)
        gram = np.einsum("j,jab->ab", 1.0 / sigma**2, products.w)
        return gram * np.outer(products.scale, products.scale), sigma, solution
