"""A hypothesis on why a log contradicts its model: another robot, other positions, or torques read otherwise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..._tools.arrays import Array
from ...model.limbs import Limb
from ...robot.robot import Robot

FACTORS = (0.3, 0.5, 0.7, 0.85, 0.96, 1.0, 1.04, 1.18, 1.4, 2.0, 3.3)
"""Factors of a length, a gear or an encoder that are tried; the best is refined between its neighbours, and the first and last
are not estimates."""
PROMISING = 0.98
"""Ratio of a factor's squared error to that without it, mean of the channels, below which it is refined."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """A possible error of robot file or log; fields left out are as declared.

    Attributes
    ----------
    code : str
        That of the finding which names it.
    joints : tuple of int
        Joints concerned, from 1.
    robot : Robot, optional
        Another robot.
    position : (n, n) array, optional
        A of the positions ``A q``.
    rate : float
        Factor of the rate: ``r dq`` and ``r^2 ddq``.
    order : tuple of int, optional
        Joint, from 0, whose rows predict each torque channel.
    factors : (n,) array, optional
        Factor of the logged torques over those of the joints.
    torque : (n, n) array, optional
        M of the logged torques ``M tau``, in place of the two before, where they are mixed.
    value : float, optional
        The number of the remedy: a gain, a length (m).
    at_end : bool
        Whether the number is an end of its search, and so no estimate.
    facts : mapping
        What the sentence says beside these.
    """

    code: str
    joints: tuple[int, ...] = ()
    robot: Robot | None = None
    position: Array | None = None
    rate: float = 1.0
    order: tuple[int, ...] | None = None
    factors: Array | None = None
    torque: Array | None = None
    value: float | None = None
    at_end: bool = False
    facts: Mapping[str, object] = field(default_factory=dict)

    @property
    def channels(self) -> tuple[tuple[int, ...] | None, Array | None]:
        """Joint whose rows predict each channel, and factors of the channels, as products of columns take them."""
        return self.order, self.factors

    @property
    def needs_columns(self) -> bool:
        """Whether the hypothesis changes the columns; otherwise only the reading of torques."""
        return (
            any(change is not None for change in (self.robot, self.position, self.torque)) or self.rate != 1.0
        )

    @property
    def turns(self) -> bool:
        """Whether it turns the sign of one joint's torque or position, which the sign of friction reveals."""
        return self.code in ("torque-sign", "position-sign", "joint-sign")

    def within(self, limb: Limb, robot: Robot) -> Hypothesis | None:
        """Return the hypothesis for a limb of a declared robot, as a robot of its own; None if it changes more than that limb."""
        at, n = list(limb.joints), robot.n_dof
        inside = bool(self.joints) and all(joint - 1 in limb.links for joint in self.joints)
        if not inside or self.torque is not None or self.rate != 1.0:
            return None
        own = np.ix_(at, at)
        for matrix in (self.position, self.mixing(n)):
            if matrix is not None:
                selection = np.eye(n)
                selection[own] = matrix[own]
                if not np.array_equal(selection, matrix):
                    return None
        if self.robot is not None:
            before, after = robot.geometry, self.robot.geometry
            for key in ("kinds", "alpha", "d", "theta", "r", "mounts"):
                pairs = enumerate(zip(getattr(before, key), getattr(after, key), strict=True))
                if any(a != b for joint, (a, b) in pairs if joint not in limb.links):
                    return None
        return replace(
            self,
            robot=None if self.robot is None else limb.of(self.robot),
            position=None if self.position is None else self.position[own],
            order=None if self.order is None else tuple(at.index(self.order[joint]) for joint in at),
            factors=None if self.factors is None else self.factors[at],
        )

    def mixing(self, n: int) -> Array:
        """Return M of the logged torques ``M tau``, (n, n)."""
        if self.torque is not None:
            return self.torque
        m = np.zeros((n, n))
        m[np.arange(n), range(n) if self.order is None else self.order] = (
            1.0 if self.factors is None else self.factors
        )
        return m


def diagonal(n: int, joint: int, value: float) -> Array:
    """Return ones, (n,), but for a joint, from 0."""
    factors = np.ones(n)
    factors[joint] = value
    return factors


def best_factor(
    squares: Callable[[float], Array], factors: tuple[float, ...] = FACTORS, promising: float = PROMISING
) -> tuple[float, bool]:
    """Return the factor of the least squared errors, (n,), and whether it is an end of the list; 1 where none is clearly better.

    A parabola through the factors next to 1, or next to the middle one, must fall below `promising` times the errors at 1, or the
    others are not tried. Each local minimum is refined, because that at the true factor may be narrow beside one at small factors.
    """
    known: dict[float, float] = {}

    def cost(value: float) -> float:
        if value not in known:
            known[value] = float(np.exp(np.mean(np.log(squares(value)))))
        return known[value]

    def bottom(k: int) -> float:
        x = np.log(factors[k - 1 : k + 2]) - np.log(factors[k])
        y = [cost(factor) for factor in factors[k - 1 : k + 2]]
        if not np.isfinite(y).all():
            return y[1]
        a, b, c = np.polyfit(x, y, 2)
        return float(c - b * b / (4.0 * a)) if a > 0.0 else min(y)

    one = factors.index(1.0) if 1.0 in factors else len(factors) // 2
    wanted = promising * cost(factors[one])
    if not min(bottom(one), cost(factors[one - 1]), cost(factors[one + 1])) < wanted:
        return factors[one], False
    from scipy.optimize import minimize_scalar  # a tenth of a second

    costs = [cost(factor) for factor in factors]
    optima = [
        minimize_scalar(
            lambda value: cost(float(np.exp(value))),
            bounds=(np.log(factors[k - 1]), np.log(factors[k + 1])),
            method="bounded",
            options={"xatol": 5e-3, "maxiter": 10},
        )
        for k in range(1, len(factors) - 1)
        if costs[k] == min(costs[k - 1 : k + 2])
    ]
    best = min(optima, key=lambda optimum: float(optimum.fun), default=None)
    if best is None or best.fun > min(costs[0], costs[-1]):
        return factors[0 if costs[0] < costs[-1] else -1], True
    return float(np.exp(best.x)), False
