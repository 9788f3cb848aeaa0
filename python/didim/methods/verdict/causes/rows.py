"""Rows of a log for hypotheses: fitted on some stretches of time, judged on the others. Tested in ``tests/test_verdict_rows.py``.

A hypothesis changes the columns of the regressor, or the scale of a joint's torque. Most are hopeless, which a rougher look tells
(`screen`); the others get their columns filtered as those of a fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...._tools.arrays import Array
from ....errors import DidimError, FitError
from ....regression.linear_system import linear_system
from ....regression.selection import select
from ....robot.robot import Robot
from ....signal.decimation import decimate, decimation_stages
from ....signal.processing import SignalProcessing
from ....signal.segments import Segment, stretches
from ...job import Job
from .products import Products
from .screen import MOTION, Screen

FOLDS = 2
"""Parts of the log: each is predicted from the other."""
STRETCHES = 10
"""Stretches of time that the folds take in turn: several reversals each, and no hypothesis fits one motion alone."""
ROWS = 300
"""Rows of a joint that hypotheses are tried on, where the log has them: at least as many, and less than twice that."""
SAMPLES = 6000
"""Samples that they are tried on at least."""
HOPELESS = 0.97
"""Share of the declared model's score, both by the rougher look, from which a hypothesis is hopeless."""
SMALLEST_SHARE = 1e-4
"""Lower bound of a joint's residual as a share of its torque: a log without noise has finite weights."""


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
    w, y : (n_dof, n_rows, b), (n_dof, n_rows) arrays
        Base columns of the declared robot, and torques.
    declared : Products
        Of the declared robot and log, and of the columns beside it.
    x : (b,) array
        Its parameters, those of the scaled columns.
    weights : (n_dof,) array
        One over the mean square of the residual of each joint, as declared.
    score, rough_score : float
        (1) of `products` as declared, and by the rougher look.
    screen : Screen
        The rougher look.

    Raises
    ------
    DidimError
        For a log that has no rows, or whose numbers are too large.
    """

    def __init__(self, job: Job, parts: Sequence[Segment]) -> None:
        self.robot, self.signal = job.robot, job.signal
        self.parts = stretches(parts, samples_wanted(job.signal, parts))
        self.thin = 1
        w, y = self._system(self.robot, self.parts)
        self.thin = max(1, y.shape[1] // ROWS)
        self.w, self.y = w[:, :: self.thin], np.ascontiguousarray(y[:, :: self.thin])
        self.n_rows = self.y.shape[1]
        if self.n_rows < STRETCHES:
            raise FitError(f"{self.n_rows} rows are too few for hypotheses on a log")
        if not y.any(axis=1).all():
            raise FitError("a joint without torque says nothing of hypotheses on a log")
        self.folds = self._folds()
        self.beside: Array | None = None
        motion = [self.reduced([getattr(part, key) for part in self.parts]) for key in MOTION]
        self.screen = Screen(self.robot, motion, self.w)
        self._weigh()

    def _weigh(self) -> None:
        """Fit the declared model, and weigh the joints by their residuals."""
        self.declared = self.products(self.w)
        sizes = self.declared.yy.sum(axis=0)
        ones = np.ones((1, len(sizes)))
        weights = 1.0 / np.maximum(sizes, np.finfo(float).tiny)
        for _ in range(2):  # weights of the residuals, not of the torques
            self.x = self.declared.solution(weights)
            squares = self.declared.squares(range(FOLDS), self.x[None], ones)[0]
            weights = self.n_rows / np.maximum(squares, SMALLEST_SHARE**2 * sizes + np.finfo(float).tiny)
        self.weights = weights
        self.score = self.declared.score(weights)
        self.rough_score = self.products(self.screen.declared).score(weights)

    def widened(self, columns: Array) -> Rows:
        """Return rows whose every model has further columns beside its own, (n_dof, n_rows, m)."""
        found = copy(self)
        found.beside = columns
        found._weigh()
        return found

    def products(self, w: Array) -> Products:
        """Return the products of columns, (n_dof, n_rows, b), and of those beside them, with the torques."""
        if self.beside is not None:
            w = np.concatenate([w, self.beside], axis=2)
        return Products.of(w, self.y, self.folds)

    def with_columns(self, columns: Array) -> Products:
        """Return the products with further columns, (n_dof, n_rows, m)."""
        return self.products(np.concatenate([self.w, columns], axis=2))

    def rough_share(self, robot: Robot) -> float:
        """Return about what another robot leaves of the declared model's score; infinity where it cannot be computed."""
        try:
            return self.products(self.screen.of_robot(robot)).score(self.weights) / self.rough_score
        except DidimError:
            return math.inf

    def of_robot(self, robot: Robot) -> Products | None:
        """Return the products for another robot along the same motion; None where it is hopeless or cannot be computed."""
        if not self.rough_share(robot) < HOPELESS:
            return None
        return self._exact(robot, self.parts)

    def of_motion(self, position: Array, gains: Array) -> Products | None:
        """Return the products for positions ``A q``, A (n_dof, n_dof); None where all gains, (k, n_dof), are hopeless."""
        rough = self.products(self.screen.of_motion(position))
        scores = rough.scores(np.tile(self.weights, (len(gains), 1)), gains)
        if not scores.min() < HOPELESS * self.rough_score:
            return None
        moved = [
            replace(part, q=part.q @ position.T, dq=part.dq @ position.T, ddq=part.ddq @ position.T)
            for part in self.parts
        ]
        return self._exact(self.robot, moved)

    def reduced(self, signals: Sequence[Array]) -> Array:
        """Return signals of each part, (n_samples, n_dof) each, on the rows, (n_dof, n_rows)."""
        kept = self.signal.kept_rows
        found = [decimate(values, decimation_stages(len(values), self.signal))[kept] for values in signals]
        return np.ascontiguousarray(np.concatenate(found)[:: self.thin].T)

    def _exact(self, robot: Robot, parts: Sequence[Segment]) -> Products | None:
        try:
            return self.products(self._system(robot, parts)[0][:, :: self.thin])
        except DidimError:
            return None

    def _system(self, robot: Robot, parts: Sequence[Segment]) -> tuple[Array, Array]:
        """Return base columns, (n_dof, n, b), and torques, (n_dof, n), as those of a fit, before they are thinned out."""
        system = linear_system(robot, parts, self.signal, select(robot, {}, ()))
        n = robot.n_dof
        return system.w.reshape(n, -1, system.w.shape[1]), system.y.reshape(n, -1)

    def _folds(self) -> list[NDArray[np.intp]]:
        """Rows of each fold: stretches of time in turn."""
        fold = np.arange(self.n_rows) * STRETCHES // self.n_rows % FOLDS
        return [np.flatnonzero(fold == number) for number in range(FOLDS)]


def samples_wanted(signal: SignalProcessing, parts: Sequence[Segment]) -> int:
    """Return how many samples hypotheses are tried on."""
    rows = ROWS + 6 * signal.edge_rows * max(1, len(parts))
    return max(SAMPLES, rows * math.prod(signal.decimation))
