"""The end of DIDIM in a slack loop: Newton's method to the fixed point, and its standard deviations.

If the motion depends on the parameters, DIDIM contracts slowly and stops before its fixed point, and (10) ignores this. One
simulation in a random direction detects it. Tested in ``tests/test_slack_loop.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array, quotient
from ..._tools.words import counted
from ...errors import DidimError
from ...loop.outcome import Outcome
from ...regression.consistent.problem import ConstrainedProblem
from ...regression.fit import Fit
from ...regression.linear_system import LinearSystem, torque_rows
from ...regression.logs.parameters import LogParameters
from ...result.iteration import Iteration
from ...robot.parameters import BaseParameters
from ..job import Job, ratio
from .convergence import SAFETY, Contraction
from .response import Response, noise_of, share_moved
from .windows import Simulated, Window, segments_of, simulated_all

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


@dataclass
class Attempts:
    """Attempts of a run to reach its fixed point, with a bounded number of simulations.

    Attributes
    ----------
    most_iterations : int
        Upper bound of the run's iterations.
    made : int
        Number of attempts so far.
    patience : int
        Number of iterations after which the stopping rule is evaluated again.
    """

    most_iterations: int
    made: int = 0
    patience: int = 0

    def failed(self, n_iterations: int) -> None:
        """Record an attempt without progress, made too far from the fixed point."""
        self.made += 1
        # The rule is also evaluated at the last iteration, at which the run may have converged.
        self.patience = min(2 * n_iterations, self.most_iterations)

    @property
    def exhausted(self) -> bool:
        """Whether no attempts remain, and the run ends by its rule."""
        return self.made >= MOST_ATTEMPTS


@dataclass(frozen=True)
class Loop:
    """The closed loops of a log, and the solution of (7) along their motion."""

    job: Job
    windows: Sequence[Window]
    parameters: BaseParameters | LogParameters
    solve: Callable[[LinearSystem], Fit]
    conditions: ConstrainedProblem | None = None
    """Conditions of a robot that the solutions meet."""

    def projection(self, iterate: SolvedIterate) -> Array | None:
        """Return P, the derivative of a solution with respect to that of plain least squares, (n, n); None for 1."""
        problem, fit = self.conditions, iterate.fit
        if problem is None or fit.standard is None:
            return None
        rows = iterate.system.w * (fit.weights / noise_of(fit))[:, None]
        triangle = np.ascontiguousarray(np.linalg.qr(rows, mode="r"))
        spread = problem.matrix @ problem.covariance(triangle, fit.standard) @ problem.matrix.T
        return np.asarray(spread @ triangle.T @ triangle)

    def torques(self, run: Simulated) -> Array:
        """Return the simulated torques in the rows of (7), (r,)."""
        parts = segments_of(self.windows, run)
        simulated = [replace(part, tau=motion[3]) for part, motion in zip(parts, run.motions, strict=True)]
        return torque_rows(simulated, self.job.signal)

    def estimates(self, x: Array) -> Array:
        """Return the estimated base parameters of standard ones."""
        return np.asarray(self.parameters.project(x)[self.job.selection.estimated])

    def changed_by(self, x: Array, change: Array) -> Array:
        """Return the standard parameters after a change of the estimated base parameters."""
        full = np.zeros(len(self.job.selection.roles))
        full[self.job.selection.estimated] = change
        return np.asarray(x + self.parameters.lift(full))

    def standard(self, fit: Fit) -> Array:
        """Return the standard parameters of a solution."""
        if fit.standard is not None:
            return fit.standard
        return np.asarray(self.parameters.lift(self.job.selection.expand(fit.solution)))


@dataclass(frozen=True)
class SolvedIterate:
    """An iterate with (7) along its motion.

    Attributes
    ----------
    x : (p,) array
        Standard parameters.
    simulated : Simulated
        Simulated motion.
    system, fit
        The system (7) along it, and its solution.
    """

    x: Array
    simulated: Simulated
    system: LinearSystem
    fit: Fit

    @classmethod
    def along(cls, loop: Loop, x: Array, simulated: Simulated) -> SolvedIterate:
        """Solve (7) along a motion."""
        system = loop.job.system(segments_of(loop.windows, simulated), loop.parameters.project(x))
        return cls(x, simulated, system, loop.solve(system))


@dataclass(frozen=True)
class FixedPointRun:
    """The end of a run in a slack loop.

    Attributes
    ----------
    iterate : SolvedIterate
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

    iterate: SolvedIterate
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
    loop: Loop,
    x: Array,
    simulated: Simulated,
    slow: Contraction | None,
    history: Sequence[Iteration],
    most_iterations: int,
    progress: Callable[[Iteration], bool],
) -> tuple[FixedPointRun | None, int]:
    """Continue to the fixed point if the loop is slack; otherwise, or without a response, return None; also the simulations.

    A step without progress was made too far from the fixed point; the run then continues with its own iterations.

    Parameters
    ----------
    loop : Loop
        The closed loops, with the time steps of the point.
    x, simulated : (p,) array and Simulated
        End of the iteration.
    slow : Contraction or None
        Contraction of its last steps.
    history, most_iterations, progress
        Iterations so far, their upper bound, and the callback for each; True ends the steps.
    """
    count = 0

    def rows(changes: Sequence[Array]) -> list[Array] | None:
        nonlocal count
        runs = simulated_all(loop.windows, [loop.changed_by(x, change) for change in changes])
        count += len(runs) * len(loop.windows)
        torques = [loop.torques(run) for run in runs if isinstance(run, Simulated)]
        return torques if len(torques) == len(runs) else None

    try:
        iterate, origin = SolvedIterate.along(loop, x, simulated), loop.torques(simulated)
        share = share_moved(iterate.system, iterate.fit, rows, origin)
        if share is None or (share < SLACK and not (slow is not None and slow.rate > FAST)):
            return None, count
        response = Response.at(
            iterate.system, iterate.fit, rows, origin, loop.job.robot, loop.projection(iterate)
        )
    except (DidimError, np.linalg.LinAlgError):
        return None, count
    if response is None:
        return None, count
    distances, steps, reached = [_distance(loop, iterate, response)], [], True
    for number in range(len(history) + 1, min(len(history) + MOST_STEPS, most_iterations) + 1):
        if distances[-1] <= NEAR:
            break
        after, length, tried = _newton(loop, iterate, response, distances[-1])
        count += tried * len(loop.windows)
        if after is None:
            reached = False
            break
        distances.append(_distance(loop, after, response))
        steps.append(_entry(number, iterate, after, length, response, distances))
        iterate = after
        if progress(steps[-1]):
            break
    end = FixedPointRun(
        _with_errors(loop, iterate, response),
        response.rate,
        tuple(distances),
        response.wider(iterate.system, iterate.fit, loop.job.settings),
        tuple(steps),
        reached,
    )
    return end, count


def _with_errors(loop: Loop, iterate: SolvedIterate, response: Response) -> SolvedIterate:
    """Return a point with the residual of its own parameters, instead of the solution along its motion, and their covariance."""
    beta = loop.estimates(iterate.x)
    fit = replace(iterate.fit, solution=beta, residual=iterate.system.y - iterate.system.w @ beta)
    return replace(iterate, fit=response.with_errors(iterate.system, fit, loop.job.settings))


def _distance(loop: Loop, iterate: SolvedIterate, response: Response) -> float:
    """Return the largest distance of a parameter from the fixed point, in its standard deviations."""
    std = response.with_errors(iterate.system, iterate.fit, loop.job.settings).std
    left = np.abs(response.gain @ (iterate.fit.solution - loop.estimates(iterate.x)))
    return float(np.max(quotient(left, std)))


def _newton(
    loop: Loop, iterate: SolvedIterate, response: Response, distance: float
) -> tuple[SolvedIterate | None, float, int]:
    """Take a Newton step, shortened until it makes progress; return also its length and the number of simulations.

    It is a solution of (7) with shifted torques, and therefore a robot under physical constraints.
    """
    target = loop.standard(_fixed_point(loop, iterate, response))
    length = 1.0
    for tried in range(1, MOST_HALVINGS + 1):
        x = iterate.x + length * (target - iterate.x)
        (run,) = simulated_all(loop.windows, [x])
        if not isinstance(run, Outcome):
            after = SolvedIterate.along(loop, x, run)
            if _distance(loop, after, response) < distance:
                return after, length, tried
        length *= 0.5
    return None, 0.0, MOST_HALVINGS


def _fixed_point(loop: Loop, iterate: SolvedIterate, response: Response) -> Fit:
    """Return the fixed point for a linear response of the motion, as a solution of (7).

    With constraints P changes along the step, so Newton's method iterates with torques predicted by the response, without a
    simulation. Without constraints one step suffices.
    """
    here = loop.estimates(iterate.x)
    change, fit = np.zeros_like(here), iterate.fit
    for _ in range(MOST_SOLUTIONS if loop.conditions is not None else 1):
        off = fit.solution - here - change
        projection = loop.projection(replace(iterate, fit=fit))
        change = change + (response if projection is None else response.under(projection)).gain @ off
        ahead = iterate.system.w @ (response.jacobian @ change)
        fit = loop.solve(replace(iterate.system, y=iterate.system.y + ahead))
        if np.all(np.abs(fit.solution - here - change) <= PREDICTED * iterate.fit.std):
            break
    return fit


def _entry(
    number: int,
    before: SolvedIterate,
    after: SolvedIterate,
    length: float,
    response: Response,
    distances: Sequence[float],
) -> Iteration:
    """Return the entry of the history for a step."""
    old, new = (float(np.linalg.norm(iterate.fit.residual)) for iterate in (before, after))
    return Iteration(
        iteration=number,
        relative_error=ratio(new, np.linalg.norm(after.system.measured)),
        step=ratio(np.linalg.norm(after.x - before.x), np.linalg.norm(after.x)),
        more={
            "step_length": length,
            "largest_safe_step": 1.0,
            "largest_change_in_sigma": distances[-2],
            "residual_change": ratio(abs(new - old), old),
            "output_error_before": before.simulated.error,
            "output_error_after": after.simulated.error,
            "condition_number": after.fit.condition_number,
            "contraction": response.rate,
            "remaining_sigma": SAFETY * distances[-1],
        },
    )
