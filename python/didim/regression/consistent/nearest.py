"""The robot nearest to an estimate, with intervals: (10) for base parameters and their covariance.

    min_x 1/2 |R (B x - beta)|^2 + prior,    R^T R = C^-1

Intervals come from draws of beta with its covariance C (Student's distribution if C has few degrees of freedom), each projected
to its nearest robot; the curvature at the solution would be wrong with active constraints. A parameter comes *from the prior*
in two cases. Its standard deviation by the curvature of log and prior exceeds 1.2 times that of the draws (only the prior
determines it, and all draws give the same value), or other priors shift it by more than 0.3 of that deviation. Tested in
``tests/test_consistent.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array, unit_diagonal
from ...errors import FitError
from ...terms.model import Model
from .bounds import Bounds
from .prior import GAMMA, Prior, prior_of
from .problem import ConstrainedProblem

NEAREST_DRAWS = 200
"""Number of draws of the estimate."""
FEWEST_DRAWS = 20
"""Smallest number of draws, for a first look."""
OTHER_PRIORS = (0.5, 2.0)
"""Factors on mass and second moments of the alternative priors, which an identified parameter does not depend on."""
FROM_PRIOR = 0.3
"""Shift of a parameter under another prior, in standard deviations, from which it is reported as coming from the prior: beyond
it, intervals contain the truth too seldom."""
HELD = 1.2
"""Ratio of the curvature's standard deviation to that of the draws from which a parameter is not identified. Both agree for an
identified parameter but for the error of a few hundred draws; unidentified ones of the TX40 start at 3."""
LEAST_FREEDOM = 3.0
"""Lower bound of the degrees of freedom: with two or fewer, Student's distribution has no variance."""
IDENTIFIED_SHARE = 1e-9
"""Change, as a share of the largest parameter of the same kind, below which it is rounding."""


@dataclass(frozen=True, eq=False)
class NearestRobot:
    """Physically consistent standard parameters near an estimate.

    Attributes
    ----------
    x : (p,) array
        Standard parameters.
    std, low, high : (p,) arrays
        Deviation of the draws, and their 2.5 and 97.5 % quantiles.
    identified : (p,) array of bool
        False for parameters from the prior.
    covariance : (b, b) array
        Covariance of the base parameters of the draws.
    half_distance : float
        Half the squared distance from the estimate, in nats. Noise alone gives about half the number of active conditions; a
        value above the number of parameters indicates a wrong model or covariance.
    draws : (n, p) array
        Standard parameters of the draws.
    prior : str
        Name of the prior.
    """

    x: Array
    std: Array
    low: Array
    high: Array
    identified: Array
    covariance: Array
    half_distance: float
    draws: Array
    prior: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Nearness:
    """Settings of the search for the nearest robot.

    Attributes
    ----------
    prior, bounds
        As in `Consistent`.
    gamma : float
        Weight of the prior (nats).
    draws : int
        Number of draws for the intervals, at least `FEWEST_DRAWS`.
    seed : int
        Seed of NumPy's default generator.
    """

    prior: str | Mapping[str, float] | Array | Prior = "generic"
    gamma: float = GAMMA
    bounds: Bounds | None = None
    draws: int = NEAREST_DRAWS
    seed: int = 0


def nearest_robot(
    model: Model,
    beta: Array,
    covariance: Array,
    settings: Nearness,
    degrees_of_freedom: float = np.inf,
) -> NearestRobot:
    """Find the robot nearest to base parameters, in units of their covariance.

    Parameters
    ----------
    model : Model
        Fixed and dropped parameters keep their values.
    beta : (b,) array
        Base parameters.
    covariance : (b, b) array
        Their covariance; zero for fixed and dropped ones.
    settings : Nearness
        Prior and draws.
    degrees_of_freedom : float
        Degrees of freedom of the covariance: for a jackknife its blocks less one. They widen the intervals, not the standard
        deviations.

    Raises
    ------
    FitError
        Without standard deviations, and when no robot meets all conditions.
    """
    if settings.draws < FEWEST_DRAWS:
        raise FitError(f"intervals need at least {FEWEST_DRAWS} draws, got {settings.draws}")
    gamma, bounds, draws = settings.gamma, settings.bounds, settings.draws
    robot, estimated = model.own, model.unknowns.estimated
    part = covariance[np.ix_(estimated, estimated)]
    root = root_of(part)
    chosen = prior_of(robot, settings.prior)
    problem = ConstrainedProblem(model, chosen, gamma, bounds)
    right = root @ beta[estimated]
    best = problem.solve(root, right)
    random = np.random.default_rng(settings.seed)
    noise = random.standard_normal((draws, len(estimated)))
    shrink = 1.0
    if degrees_of_freedom < np.inf:
        freedom = max(degrees_of_freedom, LEAST_FREEDOM)
        noise /= np.sqrt(random.chisquare(freedom, (draws, 1)) / freedom)
        shrink = (freedom - 2.0) / freedom
    drawn = np.array([draw.x for draw in problem.solve_many(root, right + noise)])
    spread = np.sqrt(shrink) * drawn.std(axis=0, ddof=1)
    others = []
    for factor in OTHER_PRIORS:
        other = replace(
            chosen, bodies=tuple(factor * body for body in chosen.bodies), rotors=factor * chosen.rotors
        )
        others.append(ConstrainedProblem(model, other, gamma, bounds).solve(root, right).x)
    moved = np.abs(others[1] - others[0]) / 2.0
    held = np.sqrt(np.diag(problem.covariance(root, best.x))) <= HELD * spread
    size = np.maximum(np.abs(best.x), np.abs(drawn).max(axis=0))
    # Corrected for a few hundred draws, whose plain quantiles would cover a further draw less often than in 95 %.
    low, high = np.quantile(drawn, [0.025, 0.975], axis=0, method="weibull")
    return NearestRobot(
        x=best.x,
        std=spread,
        low=low,
        high=high,
        identified=held & (moved <= FROM_PRIOR * spread) & (spread > IDENTIFIED_SHARE * size),
        covariance=shrink * np.cov(drawn @ robot.base_parameters.matrix.T, rowvar=False),
        half_distance=best.half_distance,
        draws=drawn,
        prior=chosen.name,
    )


def root_of(covariance: Array) -> Array:
    """Return ``R`` with ``R^T R = C^-1``, (b, b).

    Raises
    ------
    FitError
        Without standard deviations, and for a covariance that is not positive definite.
    """
    if not (np.isfinite(covariance).all() and (np.diag(covariance) > 0.0).all()):
        raise FitError(
            "the estimate has no standard deviations, so the nearest robot is undefined: let the method converge first"
        )
    try:
        scaled, std = unit_diagonal(covariance)
        root = np.linalg.inv(np.linalg.cholesky(scaled)) / std
    except np.linalg.LinAlgError:
        raise FitError("the covariance of the estimate is not positive definite") from None
    return np.asarray(root, dtype=np.float64)
