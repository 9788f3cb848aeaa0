"""Globalisation: length of the step towards the solution, by M(q) > 0, or by secant steps without loss of fit.

Tested in ``tests/test_didim.py`` and ``tests/test_consistent.py``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array
from ...loop.outcome import Outcome, SimulationStatus
from ...model.safe_step import safe_step, thinned
from ...regression.covariance import inverse
from .problem import ConsistentProblem, Problem
from .simulator import CHECKED_POSITIONS
from .windows import Iterate, Simulated, Solved, Step

MOST_HALVINGS = 20
"""Largest number of times a step is halved when the simulation after it ends early."""
SHORTEST = 0.3
"""Shortest secant step, as a share of the full step."""
RISE = 1.02
"""Largest ratio by which the cost of the simulated torques may rise in a step."""
FEWER_HALVINGS = 4
"""Largest number of times a secant step is halved when its run ends early or its cost rises."""


class SafeSteps:
    """Steps with M(q) > 0, halved until the simulation completes."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.reporter = problem, problem.reporter
        self.method, self.simulator = problem.method, problem.simulator

    def step(self, solved: Solved) -> Step:
        """Take the longest step towards the solution with M(q) > 0 and a complete simulation."""
        iterate, largest = solved.along, self._largest(solved)
        largest_change = self.problem.change_in_sigma(solved)
        # If this simulation may be the last one, its time steps are checked in parallel.
        length, after = self._advance(solved, largest, largest_change <= self.method.sigma_fraction)
        if length < largest and self.simulator.take_small_steps():
            # With M(q) > 0 the iterate is a robot; a failed simulation then needs smaller time steps.
            again = self.simulator.simulate(iterate.x, iterate.simulated.scale)
            if isinstance(again, Simulated):
                return Step(length, largest, largest_change, replace(iterate, simulated=again), repeated=True)
        return Step(length, largest, largest_change, after)

    def _largest(self, solved: Solved) -> float:
        """Return the largest share of the step with M(q) > 0 for every payload."""
        iterate, parameters = solved.along, self.problem.base
        groups: dict[int, list[Array]] = {}
        for window, motion in zip(self.simulator.windows, iterate.simulated.motions, strict=True):
            groups.setdefault(-1 if parameters.simple else window.recording, []).append(motion[0])
        return min(
            safe_step(
                self.problem.robot,
                thinned(np.concatenate(q), CHECKED_POSITIONS),
                parameters.standard(iterate.x, recording),
                parameters.standard(solved.target, recording),
                self.method.margin,
            )
            for recording, q in groups.items()
        )

    def _advance(self, solved: Solved, largest: float, checked: bool) -> tuple[float, Iterate | Outcome]:
        """Halve the step until the simulation completes; keep the iterate if none does."""
        length, ended = largest, Outcome(SimulationStatus.DIVERGED)
        for _ in range(MOST_HALVINGS):
            x = solved.at(length)
            # With "first" the scale is no longer needed; after a full step it would falsify known gains.
            updating = self.method.gain_updating == "always" and length < 1.0
            outcome = self.simulator.simulate(x, self.simulator.gain_scale(x) if updating else None, checked)
            if isinstance(outcome, Simulated):
                return length, Iterate(x, outcome, solved.along.iteration + 1)
            ended = outcome
            self.reporter.say(f"with a step of {length:.3g} the simulation {outcome}; half of it")
            length *= 0.5
        return 0.0, ended


class SecantSteps:
    """Steps among robots: from the third on secant steps of at most 1, shortened if the torques fit clearly worse.

    The robots are a convex set, so M(q) need not be checked; secant steps break two-cycles.
    """

    def __init__(self, problem: ConsistentProblem) -> None:
        self.problem, self.reporter = problem, problem.reporter
        self.method, self.simulator = problem.method, problem.simulator
        self._before: Array | None = None
        self._length = 1.0

    def step(self, solved: Solved) -> Step:
        """Take a secant step towards the solution, halved if a run ends early or the torque cost rises."""
        ahead = self.problem.job.estimated(solved.target - solved.along.x)
        late = solved.along.iteration >= 2
        wanted = self._secant(ahead, inverse(solved.fit.covariance)) if late else 1.0
        largest_change = self.problem.change_in_sigma(solved)
        length, after = self._advance(solved, wanted, largest_change)
        self._before, self._length = ahead, length
        return Step(length, 1.0, largest_change, after, wanted)

    def _secant(self, ahead: Array, metric: Array) -> float:
        """Return the length at which the gradient along the last step would have vanished; at most 1."""
        before = self._before
        old = 0.0 if before is None else float(before @ metric @ before)
        if before is None or not old > 0.0:
            return 1.0
        share = float(ahead @ metric @ before) / old
        return float(np.clip(self._length / max(1.0 - share, 1e-3), SHORTEST, 1.0))

    def _advance(
        self, solved: Solved, length: float, largest_change: float
    ) -> tuple[float, Iterate | Outcome]:
        iterate = solved.along
        weights = np.array([solved.fit.weights[joint.start] for joint in solved.system.joints])
        cost = self._cost(iterate.simulated, weights)
        tried: list[tuple[float, float, Iterate]] = []
        ended: Outcome | None = None
        for _ in range(FEWER_HALVINGS + 1):
            x = solved.at(length)
            outcome = self.simulator.simulate(x)
            if isinstance(outcome, Outcome):
                ended = outcome
                self.reporter.say(f"with a step of {length:.3g} the simulation {outcome}; half of it")
            else:
                after = self._cost(outcome, weights)
                tried.append((after, length, Iterate(x, outcome, iterate.iteration + 1)))
                # The first motion may have used other gains, so its cost is not comparable.
                free = iterate.simulated.scale is not None or largest_change <= self.method.sigma_fraction
                if free or after <= RISE * cost:
                    break
            length *= 0.5
        if not tried:
            assert ended is not None
            return 0.0, ended
        _, length, chosen = min(tried, key=lambda trial: trial[0])
        self.simulator.choose_steps(chosen.x)
        return length, chosen

    def _cost(self, simulated: Simulated, weights: Array) -> float:
        squares, count = 0.0, 0
        for window, motion in zip(self.simulator.windows, simulated.motions, strict=True):
            squares += float(np.sum(((window.tau - motion[3]) * weights) ** 2))
            count += window.tau.size
        return squares / count
