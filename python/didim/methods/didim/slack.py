"""The end of DIDIM in a slack loop: Newton's method to the fixed point, and its standard deviations.

If the motion depends on the parameters, DIDIM contracts slowly and stops before its fixed point, and (10) ignores this. One
simulation in a random direction detects it. Tested in ``tests/test_slack_loop.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..._tools.arrays import Array, quotient, ratio
from ..._tools.words import counted
from ...errors import DidimError
from ...loop.outcome import Outcome
from ...result.iteration import Iteration
from ...terms.model import torques
from .convergence import SAFETY, Contraction
from .problem import Problem
from .response import Response, noise_of, share_moved
from .windows import Iterate, Simulated, Solved, along_motion

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
MOST_HALVINGS = 3
"""Upper bound of the lengths tried for a step of Newton's method."""
MOST_SOLUTIONS = 10
"""Upper bound of the solutions of (7), without a simulation, for the fixed point that a response predicts."""
PREDICTED = 0.01
"""Change, in standard deviations, below which the predicted fixed point has converged."""
MOST_ATTEMPTS = 2
"""Upper bound of a run's attempts at its fixed point: each costs one simulation per parameter."""


@dataclass(frozen=True)
class FixedPointRun:
    """The end of a run in a slack loop.

    Attributes
    ----------
    solved : Solved
        The last iterate; its fit has the residual there, and the covariance of the fixed point.
    rate : float
        Contraction rate of a plain iteration along the slowest direction.
    distances : tuple of float
        Distance from the fixed point, initially and after each step, in its standard deviations.
    wider : float
        Largest ratio of the fixed point's standard deviations to those for a tight loop.
    history : tuple of Iteration
        Steps to the fixed point.
    reached : bool
        False if a step made no progress: the response then differs from that at the fixed point, and the distance is unknown.
    """

    solved: Solved
    rate: float
    distances: tuple[float, ...]
    wider: float
    history: tuple[Iteration, ...]
    reached: bool

    @property
    def remaining(self) -> float:
        """Upper estimate of the largest distance of a parameter from the fixed point, in standard deviations."""
        return SAFETY * self.distances[-1]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return remarks for the result."""
        if not self.reached:
            return (
                "slow contraction: in this slack loop no step came nearer to the fixed point, and the distance from it is unknown; "
                "a stiffer controller contracts faster",
            )
        if self.rate < NOTABLE and self.remaining < NOTABLE:
            return ()
        steps = len(self.history)
        after = f", and at most {self.remaining:.2g} after {counted(steps, 'Newton step')}" if steps else ""
        return (
            f"slow contraction: an iteration in this slack loop leaves {self.rate:.2g} of the distance; it ended at "
            f"most {SAFETY * self.distances[0]:.2g} sigma from the fixed point{after}",
            f"standard deviations are up to {self.wider:.2g} times those of a tight loop, because the motion follows the "
            "parameters; a stiffer controller makes them smaller",
        )

    def continued(self, history: Sequence[Iteration]) -> list[Iteration]:
        """Return the history of the run with the steps, and with the distances before them, now known."""
        known = {"contraction": self.rate}
        if self.reached:
            known["remaining_sigma"] = SAFETY * self.distances[0]
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
    rows = partial(torques_after, problem, iterate.x)
    try:
        solved, origin = _solved(problem, iterate), simulated_rows(problem, iterate.simulated)
        share = share_moved(solved.system, solved.fit, rows, origin)
        if share is None or (share < SLACK and not (slow is not None and slow.rate > FAST)):
            return None
        response = Response.at(
            solved.system, solved.fit, rows, origin, problem.robot, projection(problem, solved)
        )
    except (DidimError, np.linalg.LinAlgError):
        return None
    if response is None:
        return None
    distances, steps, reached = [_distance(problem, solved, response)], [], True
    most = min(len(history) + MOST_STEPS, problem.method.max_iterations)
    for number in range(len(history) + 1, most + 1):
        if distances[-1] <= NEAR:
            break
        after, length = _newton(problem, solved, response, distances[-1])
        if after is None:
            reached = False
            break
        distances.append(_distance(problem, after, response))
        steps.append(_entry(number, solved, after, length, response, distances))
        solved = after
        if problem.reporter.progress(steps[-1]):
            break
    settings = problem.job.settings
    return FixedPointRun(
        _with_errors(problem, solved, response),
        response.rate,
        tuple(distances),
        response.wider(solved.system, solved.fit, settings),
        tuple(steps),
        reached,
    )


def simulated_rows(problem: Problem, run: Simulated) -> Array:
    """Return the simulated torques in the rows of (7), (r,)."""
    parts = along_motion(problem.simulator.windows, run)
    simulated = [replace(part, tau=motion[3]) for part, motion in zip(parts, run.motions, strict=True)]
    return np.concatenate([torques(part, problem.job.signal) for part in simulated], axis=1).reshape(-1)


def torques_after(problem: Problem, x: Array, changes: Sequence[Array]) -> list[Array] | None:
    """Return `simulated_rows` after changes of the estimated base parameters, (n,) each; None if a run ends early."""
    beta = map(problem.job.model.unknowns.among_all, changes)
    runs = problem.simulator.simulate_all([x + problem.base.lift(change) for change in beta])
    torques = [simulated_rows(problem, run) for run in runs if isinstance(run, Simulated)]
    return torques if len(torques) == len(runs) else None


def projection(problem: Problem, solved: Solved) -> Array | None:
    """Return P, the derivative of a solution with respect to that of plain least squares, (n, n); None for 1."""
    conditions, fit = problem.conditions, solved.fit
    if conditions is None or fit.standard is None:
        return None
    rows = solved.system.w * (fit.weights / noise_of(fit))[:, None]
    triangle = np.ascontiguousarray(np.linalg.qr(rows, mode="r"))
    spread = conditions.matrix @ conditions.covariance(triangle, fit.standard) @ conditions.matrix.T
    return np.asarray(spread @ triangle.T @ triangle)


def _solved(problem: Problem, iterate: Iterate) -> Solved:
    system = problem.observe(iterate)
    return problem.solved(iterate, system, problem.solution(system))


def _with_errors(problem: Problem, solved: Solved, response: Response) -> Solved:
    """Return a point with the residual of its own parameters, instead of the solution along its motion, and their covariance."""
    system, beta = solved.system, problem.job.estimated(solved.along.x)
    fit = replace(solved.fit, solution=beta, residual=system.y - system.w @ beta)
    return replace(solved, fit=response.with_errors(system, fit, problem.job.settings))


def _distance(problem: Problem, solved: Solved, response: Response) -> float:
    """Return the largest distance of a parameter from the fixed point, in its standard deviations."""
    std = response.with_errors(solved.system, solved.fit, problem.job.settings).std
    left = np.abs(response.gain @ (solved.fit.solution - problem.job.estimated(solved.along.x)))
    return float(np.max(quotient(left, std)))


def _newton(
    problem: Problem, solved: Solved, response: Response, distance: float
) -> tuple[Solved | None, float]:
    """Take a Newton step, shortened until it makes progress; return also its length.

    It is a solution of (7) with shifted torques, and therefore a robot under physical constraints.
    """
    target = _fixed_point(problem, solved, response).target
    along, length = solved.along, 1.0
    for _ in range(MOST_HALVINGS):
        x = along.x + length * (target - along.x)
        (run,) = problem.simulator.simulate_all([x])
        if not isinstance(run, Outcome):
            after = _solved(problem, Iterate(x, run, along.iteration + 1))
            if _distance(problem, after, response) < distance:
                return after, length
        length *= 0.5
    return None, 0.0


def _fixed_point(problem: Problem, solved: Solved, response: Response) -> Solved:
    """Return the fixed point for a linear response of the motion, as a solution of (7).

    With constraints P changes along the step, so Newton's method iterates with torques predicted by the response, without a
    simulation. Without constraints one step suffices.
    """
    system, std = solved.system, solved.fit.std
    here = problem.job.estimated(solved.along.x)
    change = np.zeros_like(here)
    for _ in range(MOST_SOLUTIONS if problem.conditions is not None else 1):
        share = projection(problem, solved)
        off = solved.fit.solution - here - change
        change = change + (response if share is None else response.under(share)).gain @ off
        fit = problem.solution(replace(system, y=system.y + system.w @ (response.jacobian @ change)))
        solved = problem.solved(solved.along, system, fit)
        if np.all(np.abs(fit.solution - here - change) <= PREDICTED * std):
            break
    return solved


def _entry(
    number: int, before: Solved, after: Solved, length: float, response: Response, distances: Sequence[float]
) -> Iteration:
    """Return the entry of the history for a step."""
    old, new = (float(np.linalg.norm(solved.fit.residual)) for solved in (before, after))
    start, end = before.along, after.along
    return Iteration(
        iteration=number,
        relative_error=after.system.relative_error(after.fit.residual),
        step=ratio(np.linalg.norm(end.x - start.x), np.linalg.norm(end.x)),
        more={
            "step_length": length,
            "largest_safe_step": 1.0,
            "largest_change_in_sigma": distances[-2],
            "residual_change": ratio(abs(new - old), old),
            "output_error_before": start.simulated.error,
            "output_error_after": end.simulated.error,
            "condition_number": after.fit.condition_number,
            "contraction": response.rate,
            "remaining_sigma": SAFETY * distances[-1],
        },
    )
