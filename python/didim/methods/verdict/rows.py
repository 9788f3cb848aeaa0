"""Rows of a log for hypotheses: fitted on some stretches of time, judged on the others. Tested in ``tests/test_verdict_faults.py``.

A hypothesis changes the columns of the regressor, or the scale of a joint's torque. Its score is the geometric mean over the joints
of the squared errors of torques that it did not see, in units of the residuals of the declared model,

    log s = 1/n sum_j log( sum_f |y_jf - g_j W_jf beta_(f)|^2 / sigma_j^2 ),      beta_(f) fitted without the stretches f   (1)

which is a likelihood with a variance of its own for each joint: one joint that a hypothesis explains wholly counts for much, as it
should, where friction that the model lacks stays at the others. (1) follows from ``W_jf^T W_jf``, ``W_jf^T y_jf`` and
``y_jf^T y_jf`` of each joint and fold, once for all factors g.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array
from ...errors import DidimError
from ...regression.linear_system import linear_system
from ...regression.selection import select
from ...robot.robot import Robot
from ...signal.decimation import decimate, decimation_stages
from ...signal.processing import SignalProcessing
from ...signal.segments import Segment, stretches
from ..job import Job

FOLDS = 2
"""Parts of the log: each is predicted from the other."""
STRETCHES = 10
"""Stretches of time that the folds take in turn: several reversals each, and no hypothesis fits one motion alone."""
ROWS = 300
"""Rows of a joint that hypotheses are tried on at least, where the log has them."""
SAMPLES = 6000
"""Samples that they are tried on at least."""
SMALLEST_EIGENVALUE = 1e-13
"""Of the products of columns with norm 1, against the largest: below it a combination of columns is rounding."""
SMALLEST_SQUARES = 1e-6
"""Lower bound of a joint's part of (1): a log without noise has a finite score."""
SMALLEST_SHARE = 1e-4
"""Lower bound of a joint's residual as a share of its torque: a log without noise has finite weights."""


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

    def solution(self, fold: int | None, weights: Array, gain: Array) -> Array:
        """Parameters of the scaled columns fitted without a fold; None for on all rows."""
        kept = [f for f in range(len(self.w)) if f != fold]
        gram = np.einsum("j,fjab->ab", weights * gain**2, self.w[kept])
        told = np.einsum("j,fjb->b", weights * gain, self.wy[kept])
        values, vectors = np.linalg.eigh(gram)
        good = values > SMALLEST_EIGENVALUE * values[-1]
        return np.asarray(vectors[:, good] @ ((vectors[:, good].T @ told) / values[good]))

    def squares(self, folds: Sequence[int], x: Array, gain: Array) -> Array:
        """Squared errors of each joint on some folds, (n_dof,)."""
        f = list(folds)
        error = (
            self.yy[f]
            - 2.0 * gain * np.einsum("fjb,b->fj", self.wy[f], x)
            + gain**2 * np.einsum("a,fjab,b->fj", x, self.w[f], x, optimize=True)
        )
        return np.asarray(np.maximum(error, 0.0).sum(axis=0))

    def score(self, weights: Array, gain: Array | None = None) -> float:
        """Return (1)."""
        factor = np.ones(self.w.shape[1]) if gain is None else gain
        squares = np.zeros(len(factor))
        for fold in range(len(self.w)):
            x = self.solution(fold, weights, factor)
            squares += weights * self.squares([fold], x, factor)
        return float(np.exp(np.mean(np.log(np.maximum(squares, SMALLEST_SQUARES)))))


class Rows:
    """The declared log, and what hypotheses make of it.

    Parameters
    ----------
    job : Job
        Robot and filters.
    parts : sequence of Segment
        Filtered windows of the log.

    Attributes
    ----------
    declared : Products
        Of the declared robot and log.
    weights : (n_dof,) array
        One over the mean square of the residual of each joint, as declared.
    score : float
        (1) as declared.
    """

    def __init__(self, job: Job, parts: Sequence[Segment]) -> None:
        self.robot, self.signal = job.robot, job.signal
        self.parts = stretches(parts, samples_wanted(job.signal, parts))
        system = self._system(self.robot, self.parts)
        self.w, self.y = system
        self.n_rows = self.y.shape[1]
        self.fold = self._folds()
        self.beside: Array | None = None
        self._kept: dict[str, Array | None] = {}
        self._weigh()

    def _weigh(self) -> None:
        """Fit the declared model, and weigh the joints by their residuals."""
        self.declared = self.products(self.w)
        sizes = self.declared.yy.sum(axis=0)
        ones = np.ones(len(sizes))
        weights = 1.0 / np.maximum(sizes, np.finfo(float).tiny)
        for _ in range(2):  # weights of the residuals, not of the torques
            self.x = self.declared.solution(None, weights, ones)
            squares = self.declared.squares(range(FOLDS), self.x, ones)
            weights = self.n_rows / np.maximum(squares, SMALLEST_SHARE**2 * sizes + np.finfo(float).tiny)
        self.weights = weights
        self.score = self.declared.score(weights)

    def widened(self, columns: Array) -> Rows:
        """Return rows whose every model has further columns beside its own, (n_dof, n_rows, m)."""
        found = copy(self)
        found.beside = columns
        found._weigh()
        return found

    def products(self, w: Array, y: Array | None = None) -> Products:
        """Return the products of columns, (n_dof, n_rows, b), and torques, (n_dof, n_rows), those of the log by default."""
        torque = self.y if y is None else y
        if self.beside is not None:
            w = np.concatenate([w, self.beside], axis=2)
        scale = np.sqrt(np.einsum("jrb,jrb->b", w, w))
        scale[scale == 0.0] = 1.0
        scaled = w / scale
        parts = [(scaled[:, self.fold == f], torque[:, self.fold == f]) for f in range(FOLDS)]
        return Products(
            w=np.stack([np.matmul(rows.transpose(0, 2, 1), rows) for rows, _ in parts]),
            wy=np.stack([np.einsum("jrb,jr->jb", rows, told) for rows, told in parts]),
            yy=np.stack([np.einsum("jr,jr->j", told, told) for _, told in parts]),
            scale=scale,
        )

    def of_robot(self, robot: Robot) -> Products | None:
        """Return the products for another robot along the same motion; None where it cannot be computed."""
        columns = self._columns(repr(robot.geometry), robot, self.parts)
        return None if columns is None else self.products(columns)

    def of_motion(self, position: Array, rate: float = 1.0) -> Products | None:
        """Return the products for positions ``A q``, (n_dof, n_dof), and a rate so many times the declared one."""
        moved = [
            replace(
                part,
                q=np.ascontiguousarray(part.q @ position.T),
                dq=np.ascontiguousarray(rate * part.dq @ position.T),
                ddq=np.ascontiguousarray(rate**2 * part.ddq @ position.T),
            )
            for part in self.parts
        ]
        columns = self._columns(f"{position.tolist()} {rate}", self.robot, moved)
        return None if columns is None else self.products(columns)

    def _columns(self, key: str, robot: Robot, parts: Sequence[Segment]) -> Array | None:
        """Return the columns of a robot along a motion, kept for the rows with further columns; None where there are none."""
        if key not in self._kept:
            try:
                self._kept[key] = self._system(robot, parts)[0]
            except DidimError:
                self._kept[key] = None
        return self._kept[key]

    def with_columns(self, columns: Array) -> Products:
        """Return the products with further columns, (n_dof, n_rows, m)."""
        return self.products(np.concatenate([self.w, columns], axis=2))

    def reduced(self, signals: Sequence[Array]) -> Array:
        """Return signals of each part, (n_samples, n_dof) each, on the rows, (n_dof, n_rows)."""
        kept = self.signal.kept_rows
        found = [decimate(values, decimation_stages(len(values), self.signal))[kept] for values in signals]
        return np.ascontiguousarray(np.concatenate(found).T)

    def _system(self, robot: Robot, parts: Sequence[Segment]) -> tuple[Array, Array]:
        system = linear_system(robot, parts, self.signal, select(robot, {}, ()))
        n = robot.n_dof
        return system.w.reshape(n, -1, system.w.shape[1]), system.y.reshape(n, -1)

    def _folds(self) -> Array:
        """Fold of each row: stretches of time in turn."""
        return np.asarray(np.arange(self.n_rows) * STRETCHES // max(self.n_rows, 1) % FOLDS)


def samples_wanted(signal: SignalProcessing, parts: Sequence[Segment]) -> int:
    """Return how many samples hypotheses are tried on."""
    rows = ROWS + 6 * signal.edge_rows * max(1, len(parts))
    return max(SAMPLES, rows * math.prod(signal.decimation))
