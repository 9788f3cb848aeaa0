r"""The end of DIDIM in a slack loop: Newton's method to the fixed point, and its standard deviations.

DIDIM approximates ``d tau_s / d beta`` by the regressor W and neglects the dependence of the motion on the parameters. In a
tight loop this dependence is small. In a slack one DIDIM contracts slowly and stops before its fixed point, and (10) ignores
this. With ``S = d tau_s / d beta`` in the rows of (7), about an iterate beta_0:

    F(beta) = argmin | W b - y - (W - S)(beta - beta_0) |        the next iterate, within physical constraints if there are any
    beta* = F(beta*)                                             the fixed point; without constraints W^T (y - tau_s) = 0
    C = G^-1 Q^T Sigma Q G^-T,   G = Q^T S,   W = Q R            covariance of the fixed point, instead of (10)

So the fixed point is the estimate with instruments W of the system whose columns are S, which `instrumented` solves. The columns
of S are differences of simulations; one simulation in a random direction shows whether they are needed. Tested in
``tests/test_slack_loop.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array, quotient, ratio
from ..._tools.words import counted
from ...errors import DidimError
from ...loop.outcome import Outcome
from ...model.limbs import Directions
from ...regression.classical.instrumental import Instrumented, instrumented
from ...regression.covariance import Factors, covariance_of_columns
from ...regression.fit import Fit
from ...result.iteration import Iteration
from ...terms.rows import unit_columns
from .convergence import SAFETY, Contraction
from .problem import Iterate, Problem, Solved

DIFFERENCE = 1.0
"""Change of the weighted torques in a finite difference, in standard deviations of a row: small enough for a linear
response."""
LARGEST_CONDITION = 1e7
"""Ratio of the entries of R beyond which the log does not determine the fixed point."""
SLACK = 0.5
"""Smallest size of J (`share_moved`) of a slack loop."""
FAST = 0.5
"""Contraction rate of the last steps above which the loop counts as slack without the random test."""
NOTABLE = 0.3
"""Contraction rate along the slowest direction from which a result reports it."""
NEAR = 0.1
"""Distance from the fixed point, in standard deviations, at which Newton's method ends."""
MOST_STEPS = 6
"""Upper bound of the steps of Newton's method."""
MOST_LENGTHS = 3
"""Upper bound of the lengths tried for a step of Newton's method."""
MOST_SOLUTIONS = 20
"""Upper bound of the solutions of (7), without a simulation, for the fixed point that a response predicts."""
PREDICTED = 1e-3
"""Change, in standard deviations, below which the predicted fixed point has converged."""
MOST_ATTEMPTS = 2
"""Upper bound of a run's attempts at its fixed point: each costs one simulation per parameter."""


@dataclass(frozen=True, eq=False)
class Ahead:
    """An iterate with the fixed point that the response predicts from it.

    Attributes
    ----------
    solved : Solved
        (7) along the iterate; its fit has the residual there, and the covariance of the fixed point.
    target : (n_parameters,) array
        Standard parameters of the fixed point.
    distance : float
        Largest distance of a parameter from it, in its standard deviations.
    rate : float
        Contraction rate of a plain iteration along the slowest direction: the largest eigenvalue of ``1 - R^-1 Q^T S``;
        constraints that hold this direction make it less.
    wider : float
        Largest ratio of the fixed point's standard deviations to those of (10), for a tight loop.
    """

    solved: Solved
    target: Array
    distance: float
    rate: float
    wider: float

    @classmethod
    def of(cls, problem: Problem, solved: Solved, slopes: Array) -> Ahead | None:
        """Return the fixed point by a response S, (r, n), at this or a nearby iterate; None if the log does not determine it."""
        system, fit, weights = solved.system, solved.fit, solved.fit.weights
        here = problem.job.estimated(solved.along.x)
        newton = instrumented(slopes, system.w, system.y + (slopes - system.w) @ here, weights)
        if newton is None:
            return None
        fit, wider = _with_errors(problem, solved, slopes, here, newton)
        gain = newton.inverse @ (newton.left.T @ (system.w * weights[:, None]))
        rate = float(np.abs(1.0 - 1.0 / np.linalg.eigvals(gain)).max())
        change = newton.solution - here
        # Constraints hold some directions, so F is applied until it rests; without them it rests at once.
        tried: list[Array] = []
        rests: list[Array] = []
        least = np.inf
        for _ in range(MOST_SOLUTIONS):
            moved = replace(system, y=system.y + (system.w - slopes) @ change)
            there = problem.solved(solved.along, moved, problem.solution(moved))
            tried, rests = [*tried, change], [*rests, there.fit.solution - here - change]
            rest = float(np.max(quotient(np.abs(rests[-1]), fit.std)))
            if rest < least:
                least, nearest = rest, there
            if rest <= PREDICTED:
                break
            change = _mixed(tried, rests, fit.std)
        far = float(np.max(quotient(np.abs(nearest.fit.solution - here), fit.std)))
        return cls(replace(solved, fit=fit), nearest.target, far + least, rate, wider)


def _mixed(tried: Sequence[Array], rests: Sequence[Array], std: Array) -> Array:
    """Return the next point of an iteration x + rest(x) by Anderson's mixing: the least rest, in `std`, as if it were linear."""
    steps = np.diff(np.array(tried), axis=0).T
    falls = np.diff(np.array(rests), axis=0).T
    shares = np.linalg.lstsq(falls / std[:, None], rests[-1] / std, rcond=None)[0]
    return np.asarray(tried[-1] + rests[-1] - (steps + falls) @ shares)


def _with_errors(
    problem: Problem, solved: Solved, slopes: Array, here: Array, newton: Instrumented
) -> tuple[Fit, float]:
    """Return the fit at an iterate with the covariance of the fixed point, and how much wider that is than (10)."""
    system, fit, weights = solved.system, solved.fit, solved.fit.weights
    n, wide = len(system.names), system.with_velocities(fit.solution)
    made: Instrumented | None = newton
    if wide is not system:
        made = instrumented(np.column_stack([slopes, wide.w[:, n:]]), wide.w, system.y, weights)
    if made is None:
        raise np.linalg.LinAlgError("singular response")
    residual = system.y - system.w @ here
    errors = residual * weights
    spread = covariance_of_columns(system, problem.job.settings, made.left, errors, made.inverse)[:n, :n]
    wider = float(np.max(quotient(np.sqrt(np.diag(spread)), fit.std, 1.0)))
    factors = Factors(made.left, made.right, made.inverse, errors)
    return replace(fit, solution=here, residual=residual, covariance=spread, factors=factors), wider


@dataclass(frozen=True)
class FixedPointRun:
    """The end of a run in a slack loop.

    Attributes
    ----------
    points : sequence of Ahead
        The iterates, from the end of the run on.
    history : tuple of Iteration
        Steps to the fixed point, between them.
    reached : bool
        False if a step made no progress: the response then differs from that at the fixed point, and the distance is unknown.
    """

    points: Sequence[Ahead]
    history: tuple[Iteration, ...]
    reached: bool

    @property
    def solved(self) -> Solved:
        """The last iterate."""
        return self.points[-1].solved

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return remarks for the result."""
        first, last = self.points[0], self.points[-1]
        if not self.reached:
            return (
                "slow contraction: in this slack loop no step came nearer to the fixed point, and the distance from it is unknown; "
                "a stiffer controller contracts faster",
            )
        remaining = SAFETY * last.distance
        if last.rate < NOTABLE and remaining < NOTABLE:
            return ()
        steps = len(self.history)
        after = f", and at most {remaining:.2g} after {counted(steps, 'Newton step')}" if steps else ""
        return (
            f"slow contraction: an iteration in this slack loop leaves {last.rate:.2g} of the distance; it ended at "
            f"most {SAFETY * first.distance:.2g} sigma from the fixed point{after}",
            f"standard deviations are up to {last.wider:.2g} times those of a tight loop, because the motion follows the "
            "parameters; a stiffer controller makes them smaller",
        )

    def continued(self, history: Sequence[Iteration]) -> list[Iteration]:
        """Return the history of the run with the steps, and with the distances before them, now known."""
        known = {"contraction": self.points[-1].rate}
        if self.reached:
            known["remaining_sigma"] = SAFETY * self.points[0].distance
        last = replace(history[-1], more={**history[-1].more, **known})
        return [*history[:-1], last, *self.history]


def run_to_fixed_point(
    problem: Problem, iterate: Iterate, slow: Contraction | None, history: Sequence[Iteration]
) -> FixedPointRun | None:
    """Continue from the end of an iteration to the fixed point if the loop is slack; otherwise, or without a response, return None.

    A step without progress was made too far from the fixed point; the run then continues with its own iterations.

    Parameters
    ----------
    problem : Problem
        Problem with the time steps of the iterate.
    iterate : Iterate
        End of the iteration.
    slow : Contraction or None
        Contraction of its last steps.
    history : sequence of Iteration
        Iterations so far.
    """
    try:
        solved, origin = _solved(problem, iterate), problem.simulated_rows(iterate.simulated)
        share = share_moved(problem, solved, origin)
        if share is None or (share < SLACK and not (slow is not None and slow.rate > FAST)):
            return None
        slopes = response(problem, solved, origin)
        point = None if slopes is None else Ahead.of(problem, solved, slopes)
    except (DidimError, np.linalg.LinAlgError):
        return None
    if slopes is None or point is None:
        return None
    points = [point]
    steps: list[Iteration] = []
    most = min(len(history) + MOST_STEPS, problem.method.max_iterations)
    for number in range(len(history) + 1, most + 1):
        if point.distance <= NEAR:
            break
        after, length = _newton(problem, point, slopes)
        if after is None:
            return FixedPointRun(points, tuple(steps), reached=False)
        steps.append(_entry(number, point, after, length))
        points.append(after)
        point = after
        if problem.reporter.progress(steps[-1]):
            break
    return FixedPointRun(points, tuple(steps), reached=True)


def noise_of(fit: Fit) -> float:
    """Return the standard deviation of a weighted row."""
    rows, columns = len(fit.residual), len(fit.solution)
    return float(np.linalg.norm(fit.residual * fit.weights)) / float(np.sqrt(max(1, rows - columns)))


def share_moved(problem: Problem, solved: Solved, origin: Array) -> float | None:
    """Estimate the size of J = 1 - R^-1 Q^T S by one random direction: nearly its Frobenius norm; None if unknown.

    In the coordinates ``R beta`` all directions are equivalent, and the expected square along a random one is the sum of all
    squares: those of the limb that moves most, where limbs rest by themselves.
    """
    system, weights = solved.system, solved.fit.weights[:, None]
    unit, size = unit_columns(system.w * weights)
    q, triangle = np.linalg.qr(unit)
    diagonal = np.diag(triangle)
    if abs(diagonal).min() < 1.0 / LARGEST_CONDITION:
        return None
    # The signs of the triangle depend on the library; a positive diagonal makes the direction unique.
    random = np.random.default_rng(len(size)).choice([-1.0, 1.0], len(size))
    direction = np.linalg.solve(triangle, np.where(diagonal < 0.0, -1.0, 1.0) * random) / size
    along = system.w @ direction
    length = DIFFERENCE * noise_of(solved.fit) / float(np.linalg.norm(along * weights[:, 0]))
    after = problem.torques_after(solved.along.x, [length * direction])
    if after is None:
        return None
    moved = q.T @ (((after[0] - origin) / length - along) * weights[:, 0])
    return max(float(np.linalg.norm(moved[part.columns])) for part in problem.parts)


def response(problem: Problem, solved: Solved, origin: Array) -> Array | None:
    """Return S at an iterate, (r, n), by one simulation per parameter of the largest limb; None if one ends early."""
    system, fit = solved.system, solved.fit
    sizes = np.linalg.norm(system.w * fit.weights[:, None], axis=0)
    if not np.all(sizes > 0.0):
        return None
    lengths = DIFFERENCE * noise_of(fit) / sizes
    acts = np.array([system.w[joint].any(axis=0) for joint in system.joints])
    directions = Directions.of(problem.robot, acts)
    after = problem.torques_after(solved.along.x, list(directions.changes(lengths)))
    if after is None:
        return None
    pairs = zip(directions.number, lengths, strict=True)
    slopes = np.column_stack([(after[number] - origin) / length for number, length in pairs])
    for joint, responding in zip(system.joints, directions.joints.T, strict=True):
        slopes[joint] *= responding
    return slopes


def _solved(problem: Problem, iterate: Iterate) -> Solved:
    system = problem.observe(iterate)
    return problem.solved(iterate, system, problem.solution(system))


def _newton(problem: Problem, point: Ahead, slopes: Array) -> tuple[Ahead | None, float]:
    """Take a step to the predicted fixed point, shortened until it makes progress; return also its length."""
    along, length = point.solved.along, 1.0
    for _ in range(MOST_LENGTHS):
        x = along.x + length * (point.target - along.x)
        (run,) = problem.simulate_all([x])
        if not isinstance(run, Outcome):
            with suppress(DidimError, np.linalg.LinAlgError):
                after = Ahead.of(problem, _solved(problem, Iterate(x, run, along.iteration + 1)), slopes)
                if after is not None and after.distance < point.distance:
                    return after, length
        length *= 0.5
    return None, 0.0


def _entry(number: int, before: Ahead, after: Ahead, length: float) -> Iteration:
    """Return the entry of the history for a step."""
    old, new = (float(np.linalg.norm(point.solved.fit.residual)) for point in (before, after))
    start, end = before.solved.along, after.solved.along
    return Iteration(
        iteration=number,
        relative_error=after.solved.system.relative_error(after.solved.fit.residual),
        step=ratio(np.linalg.norm(end.x - start.x), np.linalg.norm(end.x)),
        more={
            "step_length": length,
            "largest_safe_step": 1.0,
            "largest_change_in_sigma": before.distance,
            "residual_change": ratio(abs(new - old), old),
            "output_error_before": start.simulated.error,
            "output_error_after": end.simulated.error,
            "condition_number": after.solved.fit.condition_number,
            "contraction": after.rate,
            "remaining_sigma": SAFETY * after.distance,
        },
    )
