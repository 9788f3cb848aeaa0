"""The constrained problem of a robot: conditions, prior and known parameters, solved by the interior point of the core.

    min_x 1/2 |R (B x) - z|^2 + gamma sum_j [-log det F_j + tr F_j] + gamma sum_j [-log a_j + a_j] + small terms    (10), (A)

``F_j`` is the pseudo-inertia of link j in units of the prior's, ``a_j`` a rotor inertia, or its margin for the rates of
a simulation (B). Tested in ``tests/test_consistent.py``, against Clarabel too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

import didim._core as _core

from ..._tools.arrays import Array, unit_diagonal
from ...errors import FitError
from ...model.consistency import Cone, link_cones
from ...model.drive_cones import Drives, friction_cones, rotor_cones, simulable_cones
from ...robot.robot import Robot
from ...terms.model import Model
from ...terms.rows import unit_columns
from .bounds import Bounds
from .logs import log_conditions, log_start
from .prior import GAMMA, Prior, drawn

FRICTION_WEIGHT = 1e-3
"""Weight (nats) of the log-det terms of friction: it keeps the solver inside the constraints without effect on the estimate."""
CURVATURE_ROUNDING = 1e-15
"""Smallest eigenvalue of a scaled curvature, as a share of the largest, that is more than rounding."""
FEASIBLE = 1e-12
"""Eigenvalue of a condition, as a share of its terms, down to which rounding decides: the infeasibility that the solver
allows."""
LEAST_WEIGHT = 3e-8
"""Lower bound of the weight (nats) of each condition's log-det term, for a unique solution."""


@dataclass(frozen=True)
class Simulability:
    """Conditions (B): the robot can be simulated with a step.

    Attributes
    ----------
    step_s : float
        Step (s).
    rate : float
        Largest product of the fastest rate and the step; fourth-order Runge-Kutta is stable up to 2.78.
    damping : tuple of float
        Damping gain of a continuous controller per joint, joint side; zeros for a digital one.
    smoothing : tuple of float
        Smoothing velocity of the friction per joint (rad/s or m/s).
    """

    step_s: float
    rate: float
    damping: tuple[float, ...]
    smoothing: tuple[float, ...]


@dataclass(frozen=True)
class Constrained:
    """Solution of a constrained problem.

    Attributes
    ----------
    x : (p + e,) array
        Standard parameters, and the further ones of the logs.
    half_distance : float
        ``1/2 |R (B x) - z|^2``, in nats for rows of unit noise: the distance of the constrained from the plain estimate.
    ending : str
        "solved", "stalled" or "limit".
    iterations : int
        Number of Newton systems.
    """

    x: Array
    half_distance: float
    ending: str
    iterations: int


@dataclass(frozen=True, eq=False)
class ConstrainedProblem:
    """Conditions of a robot and the prior.

    Attributes
    ----------
    model : Model
        Its fixed or dropped unknowns are equalities; the e of its shares continue the standard parameters.
    prior : Prior
        Robot at the centre of the prior.
    gamma : float
        Weight of the prior (nats): 1 is one nat per e-fold of volume.
    bounds : Bounds or None
        Bounds on masses and centres.
    simulability : Simulability or None
        Conditions (B), which replace those on the rotors.
    """

    model: Model
    prior: Prior
    gamma: float
    bounds: Bounds | None = None
    simulability: Simulability | None = None

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.model.own

    @cached_property
    def conditions(self) -> tuple[Cone, ...]:
        """Conditions with their log-det terms."""
        drives = Drives(self.robot)
        bodies = zip(link_cones(self.robot), self.prior.bodies, strict=True)
        links = [drawn(link, body, self.gamma) for link, body in bodies]
        if self.simulability is None:
            rotors = rotor_cones(drives)
        else:
            wanted = self.simulability
            rotors = simulable_cones(drives, wanted.step_s, wanted.rate, wanted.damping, wanted.smoothing)
        bounds = [] if self.bounds is None else self.bounds.cones(self.robot)
        of_drives = [
            *(_drawn(rotor, min(self.gamma, GAMMA)) for rotor in rotors),
            *(_drawn(friction, FRICTION_WEIGHT) for friction in friction_cones(drives)),
        ]
        # The prior counts a rotor once, independently of the number of recordings with their own friction.
        weak = [replace(drive, weight=min(drive.weight, FRICTION_WEIGHT)) for drive in of_drives]
        return (*links, *of_drives, *bounds, *log_conditions(self.model, self.gamma, weak))

    @cached_property
    def start(self) -> Array:
        """Return the solver's start, (p + e,): the prior's parameters, with rotors large enough for the conditions."""
        x = self.prior.parameters(self.robot)
        if self.simulability is not None:
            wanted = self.simulability
            rates = 1.0 + np.asarray(wanted.damping) + 1.0 / np.asarray(wanted.smoothing)
            for index, parameter in enumerate(self.robot.standard_parameters):
                if parameter.kind == "Ia":
                    x[index] *= 1.0 + 10.0 * wanted.step_s / wanted.rate * float(rates.max())
        return np.append(x, log_start(self.model))

    @cached_property
    def matrix(self) -> Array:
        """Return the rows of ``B`` of the estimated parameters, (n_estimated, p + e), with unit rows for those of logs."""
        return _beside(self.robot.base_parameters.matrix, self.model.n_further)[self.model.unknowns.estimated]

    @cached_property
    def unknowns(self) -> Array:
        """``T`` with ``x = T u``, (p + e, p + e): ``u`` are the standard parameters that regroup, then the base parameters.

        The core solves for ``u``. The rows of a log do not depend on the first of them, so rounding of a strong log does not
        hide a weak prior.
        """
        base, others = self.robot.base_parameters, self._regrouped
        columns = np.eye(len(self.robot.parameter_names))[:, [*others, *base.indices]]
        columns[np.ix_(base.indices, range(len(others)))] = -base.matrix[:, others]
        return _beside(columns, self.model.n_further)

    @cached_property
    def _regrouped(self) -> list[int]:
        """Return the standard parameters that do not give a base parameter its name."""
        return sorted(set(range(len(self.robot.parameter_names))) - set(self.robot.base_parameters.indices))

    @cached_property
    def _problem(self) -> _core.ConsistentProblem:
        p, b = len(self.unknowns), len(self.model.unknowns.roles)
        known = [index for index, role in enumerate(self.model.unknowns.roles) if role != "estimated"]
        cones = []
        for condition in self.conditions:
            order = len(condition.constant)
            slope = np.zeros((order, order)) if condition.slope is None else condition.slope
            shares = self.unknowns[list(condition.indices)]
            places = np.flatnonzero(shares.any(axis=0))
            basis = np.ascontiguousarray(np.tensordot(shares[:, places].T, condition.basis, 1))
            cones.append((places.tolist(), basis, condition.constant, condition.weight, slope))
        try:
            return _core.ConsistentProblem(
                p,
                cones,
                np.eye(p)[p - b :][known],
                np.ascontiguousarray(self.model.unknowns.values[known]),
                LEAST_WEIGHT,
            )
        except ValueError as reason:
            raise FitError(f"robot {self.robot.name!r}: {reason}") from None

    def solve(self, rows: Array, right: Array) -> Constrained:
        """Solve for rows ``R`` (r, n_estimated) and a right side ``z`` (r,), in units of the noise.

        Raises
        ------
        FitError
            When no parameters meet the conditions; the sentence names one of them.
        """
        return self.solve_many(rows, right[None], threads=1)[0]

    def solve_many(self, rows: Array, right: Array, threads: int = 2) -> list[Constrained]:
        """Solve for several right sides (m, r), on threads of the core; the result does not depend on their number."""
        solved, solutions = self._solved(rows, right, threads), []
        for u, z, (ending, broken), iterations in zip(
            solved.x, right, solved.endings, solved.iterations, strict=True
        ):
            if broken is not None:
                raise FitError(
                    f"robot {self.robot.name!r}: no parameters meet all conditions; {self.conditions[broken].label} contradicts "
                    "the others, or what is fixed or dropped; physical = false asks for none"
                )
            x = self.unknowns @ u
            error = rows @ (self.matrix @ x) - z
            solutions.append(Constrained(x, 0.5 * float(error @ error), ending, iterations))
        return solutions

    def _solved(self, rows: Array, right: Array, threads: int) -> _core.ConsistentSolutions:
        p, b = len(self.unknowns), len(self.model.unknowns.roles)
        a = np.zeros((len(rows), p))
        a[:, [p - b + index for index in self.model.unknowns.estimated]] = rows
        base = _beside(self.robot.base_parameters.matrix, self.model.n_further)
        start = np.append(self.start[self._regrouped], base @ self.start)
        try:
            return self._problem.solve(a, np.ascontiguousarray(right), start, threads)
        except ValueError as reason:
            raise FitError(f"robot {self.robot.name!r}: {reason}") from None

    def covariance(self, rows: Array, x: Array) -> Array:
        """Return the covariance of the standard parameters by the curvature of log and prior at ``x``, (p, p).

        It is large for a parameter determined only by a weak prior, even if noise hardly moves that parameter.
        """
        columns, others = self._free(x)
        root = self.root(x) @ columns
        curvature = root.T @ root
        curvature[others:, others:] += rows.T @ rows
        scaled, sizes = unit_diagonal(curvature)
        values, vectors = np.linalg.eigh(scaled)
        root = (columns / sizes) @ (vectors / np.sqrt(np.maximum(values, CURVATURE_ROUNDING * values[-1])))
        return np.asarray(root @ root.T)

    def precision(self, x: Array) -> Array:
        """Return what prior and constraints add to the information of a log on the estimated parameters, (n, n).

        It is their curvature at standard parameters ``x``, (p,), with all other parameters free; ``test_consistent.py`` compares
        deletions that it holds with solutions without each block.
        """
        columns, others = self._free(x)
        rows, size = unit_columns(self.root(x) @ columns)
        # Orthogonal to the other parameters, so no difference of large numbers: curvature at a bound has no limit.
        free, own = rows[:, :others], rows[:, others:]
        left = (own - free @ (np.linalg.pinv(free) @ own)) * size[others:]
        return np.asarray(left.T @ left)

    def _free(self, x: Array) -> tuple[Array, int]:
        """Return columns of ``T`` for parameters that are not given, and how many of them regroup."""
        others = len(x) - len(self.model.unknowns.roles)
        return self.unknowns[
            :, [*range(others), *(others + k for k in self.model.unknowns.estimated)]
        ], others

    def root(self, x: Array) -> Array:
        """Return rows K whose products ``K^T K`` are the curvature of the log-det terms at parameters, (m, p)."""
        roots = []
        for condition in self.conditions:
            weight = max(condition.weight, LEAST_WEIGHT)
            # Terms may cancel to zero, such as the friction of a robot and the difference of a recording.
            sizes = np.linalg.norm(condition.basis, axis=(1, 2)) * np.abs(x[list(condition.indices)])
            size = float(np.sum(sizes) + np.linalg.norm(condition.constant))
            values, vectors = np.linalg.eigh(condition.at(x))
            half = vectors / np.sqrt(np.maximum(values, FEASIBLE * size if size > 0.0 else FEASIBLE))
            own = half.T @ condition.basis @ half
            rows = np.zeros((half.size, len(x)))
            rows[:, condition.indices] = np.sqrt(weight) * own.reshape(len(own), -1).T
            roots.append(rows)
        return np.concatenate(roots) if roots else np.zeros((0, len(x)))


def _beside(matrix: Array, count: int) -> Array:
    """Return a matrix extended by the identity for further parameters."""
    rows, columns = matrix.shape
    extended = np.eye(rows + count, columns + count, columns - rows)
    extended[:rows, :] = 0.0
    extended[:rows, :columns] = matrix
    return extended


def _drawn(condition: Cone, weight: float) -> Cone:
    return replace(condition, weight=weight, slope=np.eye(len(condition.constant)))
