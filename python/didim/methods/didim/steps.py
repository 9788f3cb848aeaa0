"""Length of the step towards a solution: by M(q) > 0, or by secant steps among robots without loss of fit.

Tested in ``tests/test_didim.py`` and ``tests/test_consistent.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array
from ...loop.outcome import Outcome, SimulationStatus
from ...model.safe_step import safe_step, thinned
from ...regression.covariance import inverse
from .problem import CHECKED_POSITIONS, Iterate, Part, Problem, Simulated, Solved

MOST_HALVINGS = 20
"""Largest number of times a step is halved when the simulation after it ends early."""
SHORTEST = 0.3
"""Shortest secant step, as a share of the full step."""
RISE = 1.02
"""Largest ratio by which the cost of the simulated torques may rise in a step."""
FEWER_HALVINGS = 4
"""Largest number of times a secant step is halved when its run ends early or its cost rises."""


@dataclass(frozen=True, eq=False)
class Step:
    """A step from one iterate to the next.

    Attributes
    ----------
    after : Iterate or Outcome
        Iterate after the step, or how the simulation of the shortest step ended.
    lengths : (n_parts,) array
        Share of the way to the solution, of each part.
    changes : (n,) array
        Changes of the estimated parameters on the whole way, in standard deviations.
    largest : float
        Largest share that keeps M(q) positive definite.
    wanted : float
        Share that was asked for before anything shortened it: a secant step is shorter by design.
    repeated : bool
        Whether the step keeps the parameters and only simulates them with smaller steps in time.
    """

    after: Iterate | Outcome
    lengths: Array
    changes: Array
    largest: float = 1.0
    wanted: float = 1.0
    repeated: bool = False

    @property
    def length(self) -> float:
        """Shortest of the lengths."""
        return float(self.lengths.min())

    @property
    def largest_change(self) -> float:
        """Largest of the changes."""
        return float(self.changes.max(initial=0.0))


def halved(
    problem: Problem,
    solved: Solved,
    lengths: Array,
    most: int,
    scale: Callable[[float, Array], Array | None],
    *,
    may_be_last: bool,
) -> Iterator[tuple[Array, Iterate | Outcome]]:
    """Yield the iterates after steps of a length of each part, half of it, and so on, or how their simulation ended.

    Only a step that may be the last is also simulated with half the time steps; `scale` gives the factors of the gains.
    """
    for _ in range(most):
        x, length = solved.at(problem.shares(lengths)), float(lengths.min())
        run = problem.simulate(x, scale(length, x), may_be_last)
        if isinstance(run, Outcome):
            problem.reporter.say(f"with a step of {length:.3g} the simulation {run}; half of it")
            yield lengths, run
            lengths = problem.shortened(lengths, run)
        else:
            yield lengths, Iterate(x, run, solved.along.iteration + 1)
            lengths = 0.5 * lengths


class SafeSteps:
    """Steps with M(q) > 0, halved until the simulation completes."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def step(self, solved: Solved) -> Step:
        """Take the longest step towards the solution with M(q) > 0 and a complete simulation."""
        problem, iterate = self.problem, solved.along
        changes, largest = problem.changes_in_sigma(solved), self._largest(solved)
        may_be_last = bool(changes.max(initial=0.0) <= problem.method.sigma_fraction)
        lengths = np.zeros(len(largest))
        after: Iterate | Outcome = Outcome(SimulationStatus.DIVERGED)
        trials = halved(problem, solved, largest, MOST_HALVINGS, self._scale, may_be_last=may_be_last)
        for tried, after in trials:
            if isinstance(after, Iterate):
                lengths = tried
                break
        step = Step(after, lengths, changes, float(largest.min()))
        if np.any(lengths < largest) and problem.take_small_steps():
            # With M(q) > 0 the iterate is a robot; a failed simulation then needs smaller time steps.
            again = problem.simulate(iterate.x, iterate.simulated.scale)
            if isinstance(again, Simulated):
                return replace(step, after=replace(iterate, simulated=again), repeated=True)
        return step

    def _scale(self, length: float, x: Array) -> Array | None:
        """Return the factors of the gains; with "first" none, which after a full step would falsify known gains."""
        updating = self.problem.method.gain_updating == "always" and length < 1.0
        return self.problem.gain_scale(x) if updating else None

    def _largest(self, solved: Solved) -> Array:
        """Return the largest share of the step of each part with M(q) > 0 for every payload, (n_parts,)."""
        problem, iterate, model = self.problem, solved.along, self.problem.base
        groups: dict[int, list[Array]] = {}
        for window, motion in zip(problem.windows, iterate.simulated.motions, strict=True):
            groups.setdefault(-1 if model.simple else window.recording, []).append(motion[0])
        positions = {
            recording: thinned(np.concatenate(q), CHECKED_POSITIONS) for recording, q in groups.items()
        }

        def largest(target: Array) -> float:
            return min(
                safe_step(
                    problem.robot,
                    q,
                    model.standard(iterate.x, recording),
                    model.standard(target, recording),
                    problem.method.margin,
                )
                for recording, q in positions.items()
            )

        def of_part(part: Part) -> float:
            target = iterate.x.copy()
            target[part.indices] = solved.target[part.indices]
            return largest(target)

        # Limbs have blocks of M(q) of their own: where the whole step is safe, each of theirs is.
        every = largest(solved.target)
        if every == 1.0 or len(problem.parts) == 1:
            return np.full(len(problem.parts), every)
        return np.array([of_part(part) for part in problem.parts])


class SecantSteps:
    """Steps among robots: from the third on secant steps of at most 1, shortened if the torques fit clearly worse.

    The robots are a convex set, so M(q) need not be checked; secant steps break two-cycles.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._before: Array | None = None
        self._length = 1.0

    def step(self, solved: Solved) -> Step:
        """Take a secant step towards the solution, halved if a run ends early or the torque cost rises."""
        problem, iterate = self.problem, solved.along
        ahead = problem.job.estimated(solved.target - iterate.x)
        wanted = self._secant(ahead, inverse(solved.fit.covariance)) if iterate.iteration >= 2 else 1.0
        changes = problem.changes_in_sigma(solved)
        weights = np.array([solved.fit.weights[joint.start] for joint in solved.system.joints])
        cost = self._cost(iterate.simulated, weights)
        # The first motion may have used other gains, so its cost is not comparable.
        may_be_last = bool(changes.max(initial=0.0) <= problem.method.sigma_fraction)
        free = iterate.simulated.scale is not None or may_be_last
        tried: list[tuple[float, float, Iterate]] = []
        ended: Iterate | Outcome | None = None
        whole = np.array([wanted])
        trials = halved(
            problem, solved, whole, FEWER_HALVINGS + 1, lambda *step: None, may_be_last=may_be_last
        )
        for lengths, ended in trials:
            if isinstance(ended, Iterate):
                tried.append((self._cost(ended.simulated, weights), float(lengths[0]), ended))
                if free or tried[-1][0] <= RISE * cost:
                    break
        self._before, self._length = ahead, 0.0
        if not tried:
            assert ended is not None
            return Step(ended, np.zeros(1), changes, wanted=wanted)
        _, self._length, chosen = min(tried, key=lambda trial: trial[0])
        problem.choose_steps(chosen.x)
        return Step(chosen, np.array([self._length]), changes, wanted=wanted)

    def _secant(self, ahead: Array, metric: Array) -> float:
        """Return the length at which the gradient along the last step would have vanished; at most 1."""
        before = self._before
        old = 0.0 if before is None else float(before @ metric @ before)
        if before is None or not old > 0.0:
            return 1.0
        share = float(ahead @ metric @ before) / old
        return float(np.clip(self._length / max(1.0 - share, 1e-3), SHORTEST, 1.0))

    def _cost(self, simulated: Simulated, weights: Array) -> float:
        """Return the mean square of the weighted torque errors."""
        count = sum(window.tau.size for window in self.problem.windows)
        return float(simulated.errors @ weights**2) / count
