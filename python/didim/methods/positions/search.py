"""Bounded Levenberg-Marquardt: each step is a linear least-squares problem between bounds.

With the Gauss-Newton model of the errors ``e + J s``, a step solves ``min |e + J s|^2 + damping |D s|^2`` within the bounds
of the parameters, ``D`` the lengths of the columns: a step that is clipped afterwards points elsewhere, and takes five times
the iterations. Priors add rows. Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array
from ...errors import FitError
from ...result.iteration import Iteration, Reporter
from ...result.status import Status
from .problem import Problem

FIRST_DAMPING, LEAST_DAMPING = 1e-4, 1e-9
"""Damping of the first step, and its lower bound, as shares of the squared lengths of the columns."""
RAISE, LOWER = 10.0, 10.0
"""Factors of the damping after a step that was refused, and after one that was taken."""
MOST_RAISES = 10
"""Number of damping increases in a row after which the search ends."""
SLOPE = 1e-9
"""Slope at a bound, as a share of the largest one, that counts as zero."""
TINY = 1e-12
"""Scaled distance to a bound below which a parameter counts as being at the bound."""


@dataclass(eq=False)
class Search:
    """State of a search.

    Attributes
    ----------
    theta : (n_columns,) array
        The unknowns.
    errors, blocks : list of array
        Errors of each rollout there, and their derivatives with respect to its own columns.
    cost : float
        Sum of squares of the errors and of the priors.
    initial : float
        The same at the start.
    status : Status
        How the search ended.
    history : list of Iteration
        One per accepted step.
    free : (n_columns,) array of bool
        Columns that are estimated; the others are held.
    """

    theta: Array
    errors: list[Array]
    blocks: list[Array]
    cost: float
    initial: float
    free: NDArray[np.bool_]
    status: Status = Status.NOT_CONVERGED
    history: list[Iteration] = field(default_factory=list)


def normal_of(problem: Problem, errors: Sequence[Array], blocks: Sequence[Array]) -> tuple[Array, Array]:
    """Return the normal matrix and the gradient ``J^T e`` of all rollouts, with the priors."""
    count = len(problem.columns)
    a, b = np.zeros((count, count)), np.zeros(count)
    for rollout, e, g in zip(problem.rollouts, errors, blocks, strict=True):
        own = problem.own(rollout)
        a[np.ix_(own, own)] += g.T @ g
        b[own] += g.T @ e
    return a, b


def _prior(problem: Problem, theta: Array, scale: float) -> tuple[Array, Array]:
    """Return the weights of the priors in units of squared errors of variance `scale`, and the distances to their centres."""
    weight = np.array([scale / column.sigma**2 for column in problem.columns])
    return weight, theta - problem.start


def begun(
    problem: Problem,
    theta: Array,
    free: NDArray[np.bool_],
    before: Search | None = None,
    *,
    screening: bool = False,
) -> Search:
    """Return a search that stands at a point, after an earlier one or none; `screening` keeps the derivatives of that one.

    Raises
    ------
    FitError
        Where the robot cannot be simulated there.
    """
    if before is None or not screening:
        errors, blocks = problem.derivatives(theta)
    else:
        errors, blocks = problem.derivatives(theta, first=len(before.theta))
        blocks = [np.hstack(pair) for pair in zip(before.blocks, blocks, strict=True)]
    if not all(np.isfinite(e).all() for e in errors):
        raise FitError(
            "the robot cannot be simulated with the parameters to start from: give other starts, or a smaller step_s"
        )
    cost = _cost(problem, errors, theta, max(1, sum(e.size for e in errors)))
    now = Search(theta, errors, blocks, cost, cost if before is None else before.initial, free)
    now.history = [] if before is None else before.history
    return now


def search(
    problem: Problem,
    now: Search,
    *,
    most: int,
    tolerance: float,
    reporter: Reporter,
) -> Search:
    """Search from where one stands until the cost falls by less than `tolerance`."""
    low, high = problem.bounds
    rows = max(1, sum(e.size for e in now.errors))
    damping, done = FIRST_DAMPING, len(now.history)
    while len(now.history) < most:
        a, b = normal_of(problem, now.errors, now.blocks)
        accepted, last, fall, size = False, False, 0.0, 0.0
        for raised in range(MOST_RAISES):
            step = bounded_step(problem, now, a, b, damping, rows)
            trial = np.clip(now.theta + step, low, high)
            # The step that promises less than the tolerance is the last one, and the derivatives before it are good enough.
            last = -float(2.0 * b @ step + step @ a @ step) <= tolerance * now.cost
            # Most steps are taken: the derivatives there share the lanes of the errors. After a refusal the errors come first.
            tried, derivatives = (
                (problem.errors(trial), None) if raised or last else problem.derivatives(trial)
            )
            cost = _cost(problem, tried, trial, rows)
            if cost < now.cost:  # not so where a run has ended early, for NaN is not smaller
                accepted = True
                break
            if last:
                break
            damping *= RAISE
        if accepted:
            fall = 1.0 - cost / now.cost
            size = float(np.max(np.abs(trial - now.theta) * np.sqrt(np.diag(a)))) / math.sqrt(
                max(now.cost, 1e-300)
            )
            now.theta, now.cost, damping = trial, cost, max(damping / LOWER, LEAST_DAMPING)
            if derivatives is None and not last:
                tried, derivatives = problem.derivatives(trial)
            now.errors, now.blocks = tried, now.blocks if derivatives is None else derivatives
        rms = math.sqrt(now.cost / rows)
        now.history.append(
            Iteration(
                iteration=len(now.history) + 1,
                relative_error=math.sqrt(now.cost / now.initial) if now.initial > 0.0 else 0.0,
                step=size,
                more={"rms": rms, "damping": damping, "simulations": float(problem.n_simulations)},
            )
        )
        reporter.say(
            f"iteration {len(now.history)}: rms {1e3 * rms:.4f} mrad, damping {damping:.0g}, "
            f"{problem.n_simulations} simulations of a limb"
        )
        if reporter.progress(now.history[-1]):
            now.status = Status.STOPPED
            return now
        if not accepted or last or fall < tolerance:
            now.status = (
                Status.CONVERGED if accepted or last or len(now.history) > done + 1 else Status.NO_STEP
            )
            return now
    return now


def _cost(problem: Problem, errors: Sequence[Array], theta: Array, rows: int) -> float:
    squares = float(sum(e @ e for e in errors))
    weight, off = _prior(problem, theta, squares / rows)
    return squares + float(weight @ off**2) if weight.any() else squares


def bounded_step(problem: Problem, now: Search, a: Array, b: Array, damping: float, rows: int) -> Array:
    """Return the step that solves the damped problem ``min |e + J s|^2`` between the bounds, with ``a = J^T J``, ``b = J^T e``."""
    weight, off = _prior(problem, now.theta, now.cost / rows)
    low, high = problem.bounds
    at = np.flatnonzero(now.free & (np.diag(a) > 0.0))
    step = np.zeros(len(now.theta))
    if not at.size:
        return step
    matrix = a[np.ix_(at, at)] + np.diag(weight[at])
    size = np.sqrt(np.diag(matrix))
    scaled = matrix / np.outer(size, size) + (damping + 1e-12) * np.eye(len(at))
    gradient = (b[at] + weight[at] * off[at]) / size
    ends = (low - now.theta)[at] * size - TINY, (high - now.theta)[at] * size + TINY
    step[at] = _between(scaled, gradient, *ends) / size
    return step


def _between(matrix: Array, gradient: Array, low: Array, high: Array) -> Array:
    """Return the minimum of ``g^T s + s^T M s / 2`` between bounds: those that it leaves are held, unless they would come back."""
    free, s = np.ones(len(gradient), dtype=bool), np.zeros(len(gradient))
    while free.any():
        pulled = gradient[free] + matrix[np.ix_(free, ~free)] @ s[~free]
        s[free] = np.linalg.solve(matrix[np.ix_(free, free)], -pulled)
        out = free & ((s < low) | (s > high))
        if not out.any():
            break
        s[out] = np.clip(s[out], low[out], high[out])
        free &= ~out
    slope = gradient + matrix @ s
    held = ~free
    if (np.where(s <= low, slope, -slope)[held] >= -SLOPE * np.abs(gradient).max()).all():
        return s
    from scipy.optimize import lsq_linear  # loads much else

    root = np.linalg.cholesky(matrix)
    return np.asarray(lsq_linear(root.T, np.linalg.solve(root, -gradient), (low, high)).x)


def at_bound(problem: Problem, now: Search) -> NDArray[np.bool_]:
    """Return which unknowns ended at a bound."""
    low, high = problem.bounds
    span = np.array([column.step for column in problem.columns])
    return np.asarray((now.theta <= low + 1e-3 * span) | (now.theta >= high - 1e-3 * span))
