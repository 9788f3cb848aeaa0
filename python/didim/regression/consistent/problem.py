"""The constrained problem of a robot: conditions, prior and known parameters, solved by the interior point of the core.

    min_x 1/2 |R (B x) - z|^2 + gamma sum_j [-log det F_j + tr F_j] + gamma sum_j [-log a_j + a_j] + small terms    (10), (A)

``F_j`` is the pseudo-inertia of link j in units of the prior's, ``a_j`` a rotor inertia, or its margin for the rates of
a simulation (B). Tested in ``tests/test_consistent.py``, against Clarabel too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

import didim._core as _core

from ..._tools.arrays import Array
from ...errors import FitError
from ...model.consistency import Cone, link_cones
from ...model.drive_cones import Drives, friction_cones, rotor_cones, simulable_cones
from ...robot.robot import Robot
from ..selection import Selection
from .bounds import Bounds
from .prior import Prior

FRICTION_WEIGHT = 1e-3
"""Weight of the log-det terms of friction (nats): no effect on an estimate, and the solver stays inside."""
LEAST_WEIGHT = 3e-8
"""Weight of the log-det term of every condition at least (nats), for a unique solution."""


@dataclass(frozen=True)
class Simulability:
    """Conditions (B): the robot can be simulated with a step.

    Attributes
    ----------
    step_s : float
        Step (s).
    rate : float
        Largest product of the fastest rate and the step; Runge-Kutta's fourth order is stable to 2.78.
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
    x : (p,) array
        Standard parameters.
    half_distance : float
        ``1/2 |R (B x) - z|^2``, in nats where rows have unit noise: how far the conditions are from the plain estimate.
    ending : str
        "solved", "stalled" or "limit".
    iterations : int
        Newton systems.
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
    robot : Robot
        The robot.
    selection : Selection
        Base parameters that are fixed or dropped: equalities.
    prior : Prior
        The robot that the estimate is drawn to.
    gamma : float
        Weight of the prior (nats): 1 is one nat per e-fold of volume.
    bounds : Bounds or None
        What is known of masses and centres.
    simulability : Simulability or None
        Conditions (B), which take the place of those on the rotors.
    """

    robot: Robot
    selection: Selection
    prior: Prior
    gamma: float
    bounds: Bounds | None = None
    simulability: Simulability | None = None

    @cached_property
    def conditions(self) -> tuple[Cone, ...]:
        """Conditions with their log-det terms."""
        drives = Drives(self.robot)
        links = []
        for link, body in zip(link_cones(self.robot), self.prior.bodies, strict=True):
            root = np.linalg.inv(np.linalg.cholesky(body))
            links.append(replace(link, basis=root @ link.basis @ root.T, weight=self.gamma, slope=np.eye(4)))
        if self.simulability is None:
            rotors = rotor_cones(drives)
        else:
            wanted = self.simulability
            rotors = simulable_cones(drives, wanted.step_s, wanted.rate, wanted.damping, wanted.smoothing)
        bounds = [] if self.bounds is None else self.bounds.cones(self.robot)
        return (
            *links,
            *(_drawn(rotor, self.gamma) for rotor in rotors),
            *(_drawn(friction, FRICTION_WEIGHT) for friction in friction_cones(drives)),
            *bounds,
        )

    @cached_property
    def start(self) -> Array:
        """Standard parameters that the solver starts from: the prior's, rotors large enough for the conditions."""
        x = self.prior.parameters(self.robot)
        if self.simulability is not None:
            wanted = self.simulability
            rates = 1.0 + np.asarray(wanted.damping) + 1.0 / np.asarray(wanted.smoothing)
            for place, name in enumerate(self.robot.parameter_names):
                if name.startswith("Ia"):
                    x[place] *= 1.0 + 10.0 * wanted.step_s / wanted.rate * float(rates.max())
        return x

    @cached_property
    def matrix(self) -> Array:
        """Rows of ``B`` of the estimated base parameters, (n_estimated, p)."""
        return np.asarray(self.robot.base_parameters.matrix[self.selection.estimated])

    @cached_property
    def _core(self) -> _core.ConsistentProblem:
        base = self.robot.base_parameters
        known = [index for index, role in enumerate(self.selection.roles) if role != "estimated"]
        cones = []
        for condition in self.conditions:
            order = len(condition.constant)
            slope = np.zeros((order, order)) if condition.slope is None else condition.slope
            cones.append(
                (list(condition.indices), condition.basis, condition.constant, condition.weight, slope)
            )
        try:
            return _core.ConsistentProblem(
                len(self.robot.parameter_names),
                cones,
                np.ascontiguousarray(base.matrix[known]),
                np.ascontiguousarray(self.selection.values[known]),
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
        """Solve for several right sides (m, r), on some threads of the core; the bits do not depend on their number."""
        a = np.ascontiguousarray(rows @ self.matrix)
        try:
            solved = self._core.solve(a, np.ascontiguousarray(right), self.start, threads)
        except ValueError as reason:
            raise FitError(f"robot {self.robot.name!r}: {reason}") from None
        found = []
        for x, z, (ending, place), iterations in zip(
            solved.x, right, solved.endings, solved.iterations, strict=True
        ):
            if place is not None:
                raise FitError(
                    f"robot {self.robot.name!r}: no parameters meet all conditions; {self.conditions[place].label} contradicts "
                    "the others, or the parameters that are fixed or dropped"
                )
            error = a @ x - z
            found.append(Constrained(x, 0.5 * float(error @ error), ending, iterations))
        return found

    def marginal(self, x: Array) -> Array:
        """Curvature of the log-det terms at parameters, (p, p): what the prior says there."""
        curvature = np.zeros((len(x), len(x)))
        for condition in self.conditions:
            weight = max(condition.weight, LEAST_WEIGHT)
            inverse = np.linalg.inv(condition.at(x))
            scaled = inverse @ condition.basis
            products = weight * np.einsum("iab,kba->ik", scaled, scaled)
            curvature[np.ix_(condition.indices, condition.indices)] += products
        return curvature


def conditions_of(robot: Robot) -> Sequence[Cone]:
    """Return the conditions on links, rotors and friction in their own units, for a check that needs no solver."""
    drives = Drives(robot)
    return [*link_cones(robot), *rotor_cones(drives), *friction_cones(drives)]


def _drawn(condition: Cone, weight: float) -> Cone:
    return replace(condition, weight=weight, slope=np.eye(len(condition.constant)))
