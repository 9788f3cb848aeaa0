"""Rows of a log for hypotheses: those of a fit, a rougher look at other columns, and rows of the consistent fit.

Tested in ``tests/test_evidence_products.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from .._tools.arrays import Array
from ..errors import DidimError, FitError
from ..regression.block import stacked
from ..regression.consistent.solver import Consistent, ConsistentSolver
from ..regression.linear_system import LinearSystem, linear_system, observation
from ..regression.selection import select
from ..regression.settings import LeastSquaresSettings
from ..robot.robot import Robot
from ..signal.decimation import decimate, decimation_stages
from ..signal.processing import SignalProcessing
from ..signal.segments import Segment, stretches
from .products import BLOCKS, Products
from .screen import MOTION, Screen

ROWS = 300
"""Rows of a joint that hypotheses are tried on, where the log has them: at least as many, and less than twice that."""
SAMPLES = 6000
"""Samples that they are tried on at least."""
FEWEST_ROWS = 3
"""Rows of a joint in each block at least."""


class LogRows:
    """The rows of a log as declared, and what hypotheses make of them.

    Parameters
    ----------
    robot : Robot
        As declared; terms of load friction, which are not linear, are left out.
    signal : SignalProcessing
        Decimation.
    parts : sequence of Segment
        Filtered windows of the log.
    whole : bool
        Whether all of the log is taken, and not stretches of it.

    Attributes
    ----------
    w, y : (n, n_rows, p), (n, n_rows) arrays
        Base columns and torques.
    names : tuple of str
        Names of the columns.
    products : Products
        Of both.
    declared : Judged
        Errors of the declared model.

    Raises
    ------
    DidimError
        For a log that has too few rows, or whose numbers are too large.
    """

    def __init__(
        self, robot: Robot, signal: SignalProcessing, parts: Sequence[Segment], *, whole: bool = False
    ) -> None:
        linear = [term for term in robot.friction.terms if term.law != "load"]
        self.robot = robot if len(linear) == len(robot.friction.terms) else robot.with_terms(linear)
        self.signal = signal
        self.parts = list(parts) if whole else stretches(parts, samples_wanted(signal, parts))
        self._thin = 1
        w, y, self.names = self._system(self.robot, self.parts)
        self._thin = 1 if whole else max(1, y.shape[1] // ROWS)
        self.w, self.y = np.ascontiguousarray(w[:, :: self._thin]), np.ascontiguousarray(y[:, :: self._thin])
        if self.y.shape[1] < FEWEST_ROWS * BLOCKS:
            raise FitError(f"{self.y.shape[1]} rows are too few for hypotheses on a log")
        if not y.any(axis=1).all():
            raise FitError("a joint without torque says nothing of hypotheses on a log")
        self.products = Products.of(self.w, self.y)
        self.declared = self.products.judged()

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n_dof

    @cached_property
    def screen(self) -> Screen:
        """The rougher look."""
        motion = [self.reduced([getattr(part, key) for part in self.parts]) for key in MOTION]
        return Screen(self.robot, motion, self._whole())

    @cached_property
    def _rough(self) -> Array:
        return Products.of(self.screen.exact, self.y, blocks=1).seen()

    def rough(
        self, robot: Robot | None = None, position: Array | None = None, factors: Array | None = None
    ) -> float:
        """Return about the D of another robot, or of positions ``A q``, in sample; infinity where it cannot be computed."""
        return float(np.sum(np.log(self.rough_ratios(robot, position, factors))))

    def rough_ratios(
        self, robot: Robot | None = None, position: Array | None = None, factors: Array | None = None
    ) -> Array:
        """Return about the squared error of each channel over that of the declared model, (n,), in sample."""
        try:
            w = self.screen.of_robot(robot) if robot is not None else None
            w = self.screen.of_motion(np.asarray(position)) if w is None else w
        except DidimError:
            return np.full(self.n, math.inf)
        return Products.of(w, self.y, blocks=1).seen(None, factors) / self._rough

    def exact(
        self, robot: Robot | None = None, position: Array | None = None
    ) -> tuple[Array, tuple[str, ...]] | None:
        """Return columns as those of a fit, (n, n_rows, p), with their names; None where they cannot be computed."""
        parts = self.parts
        if position is not None:
            a = np.asarray(position).T
            parts = [replace(part, q=part.q @ a, dq=part.dq @ a, ddq=part.ddq @ a) for part in parts]
        try:
            w, _, names = self._system(robot or self.robot, parts)
        except DidimError:
            return None
        return np.ascontiguousarray(w[:, :: self._thin]), names

    def reduced(self, signals: Sequence[Array]) -> Array:
        """Return signals of each part, (n_samples, n) each, on the rows, (n, n_rows)."""
        kept = self.signal.kept_rows
        found = [decimate(values, decimation_stages(len(values), self.signal))[kept] for values in signals]
        return np.ascontiguousarray(np.concatenate(found)[:: self._thin].T)

    def with_columns(self, columns: Array) -> Products:
        """Return the products with further columns, (n, n_rows, m)."""
        return Products.of(np.concatenate([self.w, columns], axis=2), self.y)

    def consistent(self, robot: Robot, w: Array, y: Array) -> Array | None:
        """Return the squared errors of each row joint, (n,), of the physically consistent fit; None where there is none.

        Parameters
        ----------
        robot : Robot
            Whose base columns these are.
        w, y : (n, n_rows, p), (n, n_rows) arrays
            Columns, and the torques of the joints that they belong to.
        """
        n, rows, p = w.shape
        system = LinearSystem(
            w=w.reshape(n * rows, p),
            y=np.ascontiguousarray(y).reshape(-1),
            blocks=stacked(n, [rows]),
            names=robot.base_parameters.names,
        )
        solver = ConsistentSolver(
            settings=Consistent(gamma=self._gamma), robot=robot, selection=select(robot, {}, ())
        )
        try:
            fit = solver(system, LeastSquaresSettings(weights="per-joint", reweightings=1))
        except DidimError:
            return None
        return np.asarray(np.sum(fit.residual.reshape(n, rows) ** 2, axis=1))

    @cached_property
    def _gamma(self) -> float:
        """Weight of the prior, by the correlation of the residuals of the declared model."""
        n, rows, p = self.w.shape
        system = LinearSystem(
            w=self.w.reshape(n * rows, p), y=self.y.reshape(-1), blocks=stacked(n, [rows]), names=self.names
        )
        problem = Consistent().for_robot(self.robot, select(self.robot, {}, ())).on(system).problem
        assert problem is not None
        return problem.gamma

    def _whole(self) -> Array:
        """Return the columns of all standard parameters as those of a fit, (n, n_rows, m)."""
        columns = list(range(len(self.robot.parameter_names)))
        found = []
        for part in self.parts:
            stages = decimation_stages(part.q.shape[0], self.signal)
            w = observation(self.robot, part, columns, stages)
            found.append(w.reshape(self.n, -1, len(columns))[:, self.signal.kept_rows])
        return np.ascontiguousarray(np.concatenate(found, axis=1)[:, :: self._thin])

    def _system(self, robot: Robot, parts: Sequence[Segment]) -> tuple[Array, Array, tuple[str, ...]]:
        """Return base columns, (n, rows, p), and torques, (n, rows), as those of a fit, before they are thinned out."""
        system = linear_system(robot, parts, self.signal, select(robot, {}, ()))
        n = robot.n_dof
        return system.w.reshape(n, -1, system.w.shape[1]), system.y.reshape(n, -1), system.names


def samples_wanted(signal: SignalProcessing, parts: Sequence[Segment]) -> int:
    """Return how many samples hypotheses are tried on."""
    rows = ROWS + 6 * signal.edge_rows * max(1, len(parts))
    return max(SAMPLES, rows * math.prod(signal.decimation))
