"""Bounded Levenberg-Marquardt: each step is a linear least-squares problem between bounds.

With the Gauss-Newton model of the errors ``e + J s``, a step solves ``min |e + J s|^2 + damping |D s|^2`` within the bounds
of the parameters, ``D`` the lengths of the columns: a step that is clipped afterwards points elsewhere, and takes five times
the iterations. Priors add rows. Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array
from ...errors import FitError
from ...result.iteration import Iteration, Reporter, Status
from .problem import Problem

FIRST_DAMPING, LEAST_DAMPING = 1e-4, 1e-9
"""Damping of the first step, and its lower bound, as shares of the squared lengths of the columns."""
RAISE, LOWER = 10.0, 10.0
"""Factors of the damping after a step that was refused, and after one that was taken."""
DAMPINGS = 10.0 ** np.arange(-6.0, 1.0)
"""Dampings of the steps that are tried at once between kinks: with the point they start from two registers of four lanes."""
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
    problem : Problem
        The unknowns, and the errors that they leave.
    theta : (n_columns,) array
        The unknowns.
    errors, blocks : list of array
        Errors of each rollout there, and their derivatives with respect to its own columns.
    cost : float
        Sum of squares of the errors and of the priors.
    initial : float
        The same at the start.
    held : dict of int to str
        Columns that are not estimated because the log does not identify them, and a sentence on what is known in their place,
        without their joint.
    status : Status
        How the search ended.
    history : list of Iteration
        One per accepted step.
    fresh : bool
        Whether the derivatives were simulated there; otherwise they are those of a point before, corrected by the errors since.
    other : list of array, optional
        The derivatives by differences to the other side, once they are simulated; `blocks` are then the means of both. The same as
        `blocks` where the other side cannot be simulated.
    """

    problem: Problem
    theta: Array
    errors: list[Array]
    blocks: list[Array]
    cost: float
    initial: float
    held: dict[int, str] = field(default_factory=dict)
    status: Status = Status.NOT_CONVERGED
    history: list[Iteration] = field(default_factory=list)
    fresh: bool = True
    other: list[Array] | None = None

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which columns are estimated, (n_columns,)."""
        return np.array([k not in self.held for k in range(len(self.theta))])

    @property
    def rows(self) -> int:
        """Number of the errors of all rollouts, at least 1."""
        return max(1, sum(e.size for e in self.errors))

    @property
    def squares(self) -> float:
        """Sum of squares of the errors alone."""
        return sum(float(e @ e) for e in self.errors)

    def normal(self, errors: Sequence[Array] | None = None) -> tuple[Array, Array]:
        """Return the normal matrix ``J^T J``, and the gradient ``J^T e`` of its own or other errors, of all rollouts."""
        count = len(self.theta)
        a, b = np.zeros((count, count)), np.zeros(count)
        own_errors = self.errors if errors is None else errors
        for rollout, e, g in zip(self.problem.rollouts, own_errors, self.blocks, strict=True):
            own = self.problem.own(rollout)
            a[np.ix_(own, own)] += g.T @ g
            b[own] += g.T @ e
        return a, b

    def renew(self) -> None:
        """Take the derivatives at the point where the search stands; those before remain where that cannot be simulated.

        With the steps of all candidates a simulation may fail that the errors alone do not, at the edge of what can be simulated.
        """
        errors, blocks = self.problem.derivatives(self.theta)
        self.fresh, self.other = True, None
        if all(np.isfinite(e).all() for e in errors):
            self.errors, self.blocks = errors, blocks
            self.cost = _cost(self, errors, self.theta)

    def look_back(self) -> None:
        """Simulate the derivatives to the other side, and take the means of both in place of those to one."""
        errors, blocks = self.problem.derivatives(self.theta, side=-1.0)
        self.other = self.blocks
        if all(np.isfinite(e).all() for e in errors):
            self.other = blocks
            self.blocks = [(a + b) / 2.0 for a, b in zip(self.blocks, blocks, strict=True)]

    def learn(self, step: Array, errors: Sequence[Array], squares: Array) -> None:
        """Correct the derivatives by the errors after a step, as Broyden (1965) does; `squares` are squared lengths of columns."""
        blocks = []
        for rollout, e, before, j in zip(
            self.problem.rollouts, errors, self.errors, self.blocks, strict=True
        ):
            own = self.problem.own(rollout)
            s, weight = step[own], squares[own] * step[own]
            size = float(s @ weight)
            blocks.append(j + np.outer(e - before - j @ s, weight / size) if size > 0.0 else j)
        self.blocks, self.fresh, self.other = blocks, False, None

    def blocks_in(self, problem: Problem) -> list[Array] | None:
        """Return the derivatives in the rows of a problem of the same unknowns; None unless all of its rows are there."""
        blocks = []
        for rollout in problem.rollouts:
            begin, size = rollout.window.begin, len(rollout.joints)
            for other, block in zip(self.problem.rollouts, self.blocks, strict=True):
                first = begin + rollout.first - other.window.begin - other.first
                last = begin + len(rollout.q) - other.window.begin - other.first
                same = (rollout.recording, rollout.joints) == (other.recording, other.joints)
                if same and first >= 0 and last * size <= len(block):
                    blocks.append(block[first * size : last * size])
                    break
            else:
                return None
        return blocks

    def used(self, a: Array) -> NDArray[np.intp]:
        """Return the estimated columns that move the robot, by a normal matrix."""
        return np.flatnonzero(self.free & (np.diag(a) > 0.0))


def begun(
    problem: Problem,
    theta: Array | None = None,
    before: Search | None = None,
    *,
    screening: bool = False,
    kept: bool = False,
) -> Search:
    """Return a search that stands at a point, by default the start, and goes on from an earlier one.

    `screening` keeps the derivatives of that one, and adds those of unknowns that it does not have; `kept` keeps those of its rows
    until the search asks for new ones, if it has all rows.

    Raises
    ------
    FitError
        Where the robot cannot be simulated there.
    """
    theta = problem.start if theta is None else theta
    old = None if before is None or not kept else before.blocks_in(problem)
    if old is not None:
        errors, blocks = problem.errors(theta), old
    elif before is None or not screening:
        errors, blocks = problem.derivatives(theta)
    else:
        errors, blocks = problem.derivatives(theta, first=len(before.theta))
        blocks = [np.hstack(pair) for pair in zip(before.blocks, blocks, strict=True)]
    if not all(np.isfinite(e).all() for e in errors):
        raise FitError(
            "the robot cannot be simulated with the parameters to start from: give other starts, or a smaller step_s"
        )
    now = Search(problem, theta, errors, blocks, 0.0, 0.0, fresh=old is None and not screening)
    now.cost = now.initial = _cost(now, errors, theta)
    if before is not None:
        now.initial, now.history, now.held = before.initial, before.history, dict(before.held)
    return now


def search(now: Search, *, most: int, tolerance: float, reporter: Reporter, exact: bool = True) -> Search:
    """Search from where one stands, by at most so many steps, until the cost falls by less than `tolerance`.

    `exact` simulates the derivatives at each point, and ends by those of the last one; otherwise the errors after a step correct
    them, and they are simulated anew where a step brings less than half of what they promise.
    """
    now.status = Status.NOT_CONVERGED
    if now.problem.sticks:
        return _search_between_kinks(now, most, tolerance, reporter, exact)
    problem = now.problem
    low, high = problem.bounds
    damping, done, raised = FIRST_DAMPING, len(now.history), 0
    while len(now.history) < done + most:
        a, b = now.normal()
        step = bounded_step(now, a, b, damping)
        trial = np.clip(now.theta + step, low, high)
        promise = -promised(a, b, step)
        # The step that promises less than the tolerance is the last one, and the derivatives before it are good enough.
        last = promise <= tolerance * now.cost
        if last and exact and not now.fresh:
            now.renew()
            continue
        # Most steps are taken: the derivatives there share the lanes of the errors. After a refusal the errors come first.
        shared = exact and not (raised or last)
        tried, derivatives = problem.derivatives(trial) if shared else (problem.errors(trial), None)
        cost = _cost(now, tried, trial)
        accepted = cost < now.cost  # not so where a run has ended early, for NaN is not smaller
        if not (accepted or last) and (not now.fresh or raised < MOST_RAISES):
            if now.fresh:
                damping, raised = damping * RAISE, raised + 1
            else:
                now.renew()
            continue
        fall = now.cost - cost
        ends, before = not accepted or last or fall < tolerance * now.cost, (now.theta, now.cost)
        if accepted:
            if not (exact or ends):
                now.learn(trial - now.theta, tried, np.diag(a))
            now.theta, now.errors, now.cost, raised = trial, tried, cost, 0
            damping = max(damping / LOWER, LEAST_DAMPING)
            if derivatives is not None:
                now.blocks, now.fresh = derivatives, True
            elif not last and (exact or not (ends or 2.0 * fall > promise)):
                now.renew()
        if _stopped(now, before, a, damping, reporter):
            return now
        if ends:
            now.status = (
                Status.CONVERGED if accepted or last or len(now.history) > done + 1 else Status.NO_STEP
            )
            return now
    return now


def _search_between_kinks(
    now: Search, most: int, tolerance: float, reporter: Reporter, exact: bool
) -> Search:
    """Search where the errors have kinks, until the best of steps of many lengths brings less than `tolerance`.

    Where a joint sticks changes with each parameter, so that a step may be refused and a shorter one bring little, and the cost
    still have far to fall. Steps of all dampings are lanes of one batch, and the best is taken. Where it brings little, derivatives
    are simulated anew, and then to the other side too: kinks spoil one side more than the other, so that steps by the other side
    and steps by the means of both are tried.
    """
    problem, done = now.problem, len(now.history)
    while len(now.history) < done + most:
        a, b = now.normal()
        models = [(a, b)] if now.other is None else [(a, b), replace(now, blocks=now.other).normal()]
        steps = np.array([bounded_step(now, *model, damping) for model in models for damping in DAMPINGS])
        # The steps of a simulation depend on its candidates, and errors with kinks on these: so the point itself is the first,
        # and the best counts by its own.
        trials = np.clip(np.vstack([now.theta, now.theta + steps]), *problem.bounds)
        tried = problem.errors_of(trials)
        costs = np.array([_cost(now, *pair) for pair in zip(tried, trials, strict=True)])
        if np.isfinite(costs[0]):
            now.errors, now.cost = tried[0], float(costs[0])
        ran = np.isfinite(costs)
        ran[0] = False
        best = int(np.argmin(np.where(ran, costs, np.inf)))
        before = now.theta, now.cost
        taken = bool(ran.any() and now.cost - costs[best] > tolerance * now.cost)
        if taken:
            tried[best] = problem.errors(trials[best])
            costs[best] = _cost(now, tried[best], trials[best])
            ran[best] = np.isfinite(costs[best])
        fall = now.cost - costs[best]
        taken = taken and bool(fall > tolerance * now.cost)
        if not (taken or (now.fresh and now.other is not None)):
            if now.fresh:
                now.look_back()
            else:
                now.renew()
            continue
        if taken:
            learns = not exact and 2.0 * fall > -promised(a, b, trials[best] - now.theta)
            if learns:
                now.learn(trials[best] - now.theta, tried[best], np.diag(a))
            now.theta, now.errors, now.cost = trials[best], tried[best], float(costs[best])
            if not learns:
                now.renew()
        if _stopped(now, before, a, float(DAMPINGS[(max(best, 1) - 1) % len(DAMPINGS)]), reporter):
            return now
        if not taken:
            moved = ran.any() or len(now.history) > done + 1
            now.status = Status.CONVERGED if moved else Status.NO_STEP
            return now
    return now


def _stopped(now: Search, before: tuple[Array, float], a: Array, damping: float, reporter: Reporter) -> bool:
    """Note a step from a point and a cost, with a normal matrix there; return whether the search was asked to stop."""
    step = np.abs(now.theta - before[0]) * np.sqrt(np.diag(a))
    rms = math.sqrt(now.cost / now.rows)
    now.history.append(
        Iteration(
            iteration=len(now.history) + 1,
            relative_error=math.sqrt(now.cost / now.initial) if now.initial > 0.0 else 0.0,
            step=float(np.max(step)) / math.sqrt(max(before[1], 1e-300)),
            more={"rms": rms, "damping": damping, "simulations": float(now.problem.n_simulations)},
        )
    )
    reporter.say(
        f"iteration {len(now.history)}: rms {1e3 * rms:.4f} mrad, damping {damping:.0g}, "
        f"{now.problem.n_simulations} simulations of a limb"
    )
    if reporter.progress(now.history[-1]):
        now.status = Status.STOPPED
        return True
    return False


def _prior(now: Search, theta: Array, scale: float) -> tuple[Array, Array]:
    """Return the weights of the priors in units of squared errors of variance `scale`, and the distances to their centres."""
    weight = np.array([scale / column.sigma**2 for column in now.problem.columns])
    return weight, theta - now.problem.start


def _cost(now: Search, errors: Sequence[Array], theta: Array) -> float:
    squares = float(sum(e @ e for e in errors))
    weight, off = _prior(now, theta, squares / now.rows)
    return squares + float(weight @ off**2) if weight.any() else squares


def promised(a: Array, b: Array, step: Array) -> float:
    """Return the change of the squared errors by a step, with ``a = J^T J`` and ``b = J^T e``."""
    return float(2.0 * b @ step + step @ a @ step)


def bounded_step(now: Search, a: Array, b: Array, damping: float = 0.0) -> Array:
    """Return the step that solves the damped problem ``min |e + J s|^2`` between the bounds, with ``a = J^T J``, ``b = J^T e``."""
    weight, off = _prior(now, now.theta, now.cost / now.rows)
    low, high = now.problem.bounds
    at = now.used(a)
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


def at_bound(now: Search) -> NDArray[np.bool_]:
    """Return which unknowns ended at a bound."""
    low, high = now.problem.bounds
    span = 1e-3 * np.array([column.step for column in now.problem.columns])
    return np.asarray((now.theta <= low + span) | (now.theta >= high - span))
