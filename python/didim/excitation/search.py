"""Several starts in parallel, each a chain of descents with two weights of the penalties.

The criterion has very many maxima, and a descent ends in one of them within some 150 evaluations. A perturbation of the best
motion and a short descent from it nearly always end higher, so a start mostly consists of such perturbations (basin hopping).
On the TX40 they raise the log determinant by ten, and the starts end at similar values. A start only depends on its seed, so
the result has the same bits for any number of threads. Tested in ``tests/test_excitation_search.py``,
``tests/test_excitation.py`` and, its progress line, ``tests/test_progress.py``.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait

import numpy as np

from .._tools.arrays import Array
from .._tools.progress import ProgressLine
from .problem import Problem
from .series import POWERS
from .settings import ExcitationSettings

Objective = Callable[[Array], tuple[float, Array]]
"""Value and gradient at a point."""

LINE_SEARCH_HALVINGS = 15
"""Largest number of times a step is halved before the stored pairs are discarded."""
CURVED = 1e-10
"""Smallest cosine between a step and the change of the gradient for a pair to be stored: below it the curvature is rounding."""
CONVERGED = 1e-9
"""Relative decrease in one step below which the descent has converged."""
MEMORY = 60
"""Number of pairs (step, change of the gradient) stored for the quasi-Newton direction."""
DECREASE = 1e-4
"""Share of the decrease predicted by the slope that a step must achieve (Armijo)."""
THINNED = 4
"""Stride of the thinned grid, used until the last descent: five samples per period of the highest harmonic. It takes a third of
the time and starts end as high as with a stride of 2."""
KICK = 0.12
"""Length of a perturbation, as a share of the joint's amplitudes: five of six end higher. 0.2 gains less in the same time; 0.5
loses the best motion so far."""
POLL_S = 0.2
"""Time (s) between two checks for Ctrl-C."""


class Descent:
    """A descent from one point by a quasi-Newton method that can be paused and continued.

    Limited-memory BFGS in the two-loop form (Nocedal and Wright, algorithm 7.4) with a backtracking line search. SciPy's
    implementation factorizes matrices of twice its memory, for which linear algebra libraries start threads beside those of
    the other starts, and it cannot be resumed.

    Parameters
    ----------
    objective : callable
        Value and gradient.
    x : (n,) array
        First point.

    Attributes
    ----------
    x, value : (n,) array, float
        Best point so far, and the objective there.
    converged : bool
        Whether the descent has converged.
    """

    def __init__(self, objective: Objective, x: Array) -> None:
        self._objective, self.x = objective, x
        self.value, self._gradient = objective(x)
        self._pairs: deque[tuple[Array, Array, float]] = deque(maxlen=MEMORY)
        self.converged = False

    def run(self, evaluations: int) -> None:
        """Continue for a number of evaluations of the objective, up to the end of a step; fewer if it converges."""
        while evaluations > 0 and not self.converged:
            evaluations -= self._step()

    def _step(self) -> int:
        """Take one step, and return the number of evaluations."""
        direction = self._direction()
        slope = float(self._gradient @ direction)
        if not slope < 0.0:
            self._give_up()
            return 0
        length = 1.0
        for count in range(1, LINE_SEARCH_HALVINGS + 1):
            x = self.x + length * direction
            value, gradient = self._objective(x)
            if value <= self.value + DECREASE * length * slope:
                self._accept(x, value, gradient)
                return count
            # Minimum of the parabola through both values and the slope, within bounds.
            bent = 2.0 * (value - self.value - length * slope)
            best = -slope * length / bent if np.isfinite(bent) else 0.0
            length *= min(0.5, max(0.1, best))
        self._give_up()
        return LINE_SEARCH_HALVINGS

    def _accept(self, x: Array, value: float, gradient: Array) -> None:
        step, change = x - self.x, gradient - self._gradient
        product = float(step @ change)
        if product > CURVED * float(np.sqrt((step @ step) * (change @ change))):
            self._pairs.append((step, change, 1.0 / product))
        self.converged = self.value - value <= CONVERGED * max(abs(self.value), abs(value), 1.0)
        self.x, self.value, self._gradient = x, value, gradient

    def _give_up(self) -> None:
        """Restart with the steepest descent, which is the last resort."""
        self.converged = not self._pairs
        self._pairs.clear()

    def _direction(self) -> Array:
        """Return the next direction: the negative product of the estimated inverse Hessian and the gradient."""
        direction = self._gradient.copy()
        shares = []
        for step, change, inverse in reversed(self._pairs):
            share = inverse * float(step @ direction)
            shares.append(share)
            direction -= share * change
        if self._pairs:
            _, change, inverse = self._pairs[-1]
            direction /= inverse * float(change @ change)
        else:
            direction *= min(1.0, 1.0 / max(float(np.abs(direction).sum()), np.finfo(float).tiny))
        for (step, change, inverse), share in zip(self._pairs, reversed(shares), strict=True):
            direction += (share - inverse * float(change @ direction)) * step
        return -direction


WEIGHTS = (100.0, 2000.0)
"""Weights of the penalties, in succession: after the second, limits are violated by a few parts in a thousand."""
TRIALS, TRIAL = 3, 0.08
"""Random motions of each start, and the share of the iterations that each gets; the best of them goes on."""
FIRST = 0.24
"""Share of the iterations for the first descent, after its trial."""
HOP, HOPS = 40, 3.0
"""Evaluations after each perturbation, and all of them together as a share of the iterations. Twenty are too few to get back to
the height of the motion that was perturbed."""
LAST = 0.3
"""Share of the iterations for the second weight, on the whole grid."""
REPAIRS, REPAIR = 8, 0.06
"""Largest number of repetitions with tighter limits, until the fine grid keeps them, and the share of iterations of each."""
THINNED_COST = 1.0 / 3.0
"""Time of an evaluation on the thinned grid, as a share of that on the whole grid."""

Progress = Callable[[int, int, float], None]
"""Callback with the number of the start (from 1), the number of the evaluation and the best value of the criterion so far."""


class _StopSearchError(Exception):
    """The user has stopped the search."""


class Search:
    """Search from one start: the objective of a problem is minimised from the best of several motions.

    Parameters
    ----------
    problem : Problem
        Problem; the search leaves it with tightened limits and on its whole grid.
    iterations : int
        Length of the search: a start takes about four times as many evaluations, most of them on a coarse grid.
    seed : int
        Seed of the perturbations.
    stop : threading.Event
        Ends the search; the best variables so far are returned.
    progress : callable, optional
        Callback with evaluations and the least objective.
    """

    def __init__(
        self,
        problem: Problem,
        iterations: int,
        seed: int,
        stop: threading.Event,
        progress: Callable[[int, float], None] | None = None,
    ) -> None:
        self._problem, self._iterations, self._stop, self._progress = problem, iterations, stop, progress
        self._rng = np.random.default_rng([seed, TRIALS])
        self._weight, self._calls = WEIGHTS[0], 0
        self._best, self._least = np.empty(0), np.inf

    def run(self, starts: Sequence[Array]) -> Array:
        """Return the best variables, from those of random motions, (n,) each."""
        self._best = starts[0]
        problem = self._problem
        penalised = problem.x is not None or not problem.clearance.empty
        try:
            problem.series.power, problem.thinning = POWERS[0], THINNED
            self._climb(starts)
            problem.series.power, problem.thinning = POWERS[1], 1
            self._weight = WEIGHTS[1]
            self._descend(LAST)
            for _ in range(REPAIRS if penalised else 0):
                if not problem.tighten(problem.series.build(self._best)[0]):
                    break
                self._descend(REPAIR)
        except _StopSearchError:
            problem.series.power, problem.thinning = POWERS[1], 1
        return self._best

    def _climb(self, starts: Sequence[Array]) -> None:
        """Descend from the best of several motions, then from perturbations of the best one so far."""
        trials = [Descent(self._value, start) for start in starts]
        for trial in trials:
            trial.run(self._evaluations(TRIAL))
        best = min(trials, key=lambda trial: trial.value)
        best.run(self._evaluations(FIRST))
        for _ in range(round(HOPS * self._iterations / HOP)):
            tried = Descent(self._value, self._problem.series.perturbed(best.x, KICK, self._rng))
            tried.run(HOP)
            if tried.value < best.value:
                best = tried
        best.run(self._evaluations(TRIAL))

    def _descend(self, share: float) -> None:
        """Descend from the best motion so far, for a share of the iterations."""
        # The objective has changed, so previous values are not comparable.
        start, self._least = self._best, np.inf
        Descent(self._value, start).run(self._evaluations(share))

    def _evaluations(self, share: float) -> int:
        """Return the evaluations of a share of the iterations, at least one."""
        return max(1, round(share * self._iterations))

    def _value(self, v: Array) -> tuple[float, Array]:
        """Return objective and gradient, and record the best variables so far."""
        if self._stop.is_set():
            raise _StopSearchError
        self._calls += 1
        objective, gradient = self._problem.value(v, self._weight)
        if objective < self._least:
            self._best, self._least = v, objective
        if self._progress is not None:
            self._progress(self._calls, self._least)
        return objective, gradient


def search_all(
    problems: Sequence[Problem],
    starts: Sequence[Sequence[Array]],
    settings: ExcitationSettings,
    progress: Progress,
    executor: Executor | None,
) -> tuple[list[Array], list[Problem], bool]:
    """Run all starts on threads, or on an executor of the caller.

    Parameters
    ----------
    problems, starts : sequences
        A problem for each start, and its random motions.
    settings : ExcitationSettings
        Length of the search, number of parallel starts, and the seed of the first start, which the others follow.
    progress : callable
        See `Progress`.
    executor : Executor or None
        Runs the starts instead of threads.

    Returns
    -------
    found, problems, interrupted
        Result of each start, its problem with tightened limits, and whether Ctrl-C interrupted them, in which case the results
        are the best so far. A remote executor neither reacts to Ctrl-C nor reports progress.
    """
    if executor is not None:
        sent = [
            executor.submit(search_apart, problem, start, settings.iterations, settings.seed + index)
            for index, (problem, start) in enumerate(zip(problems, starts, strict=True))
        ]
        try:
            ends = [future.result() for future in sent]
        except BaseException:
            for future in sent:
                future.cancel()
            raise
        return [vector for vector, _ in ends], [problem for _, problem in ends], False
    stop = threading.Event()

    def one(index: int) -> Array:
        def tell(calls: int, least: float) -> None:
            progress(index + 1, calls, -least)

        search = Search(problems[index], settings.iterations, settings.seed + index, stop, tell)
        return search.run(starts[index])

    interrupted = False
    threads = settings.threads or os.cpu_count() or 1
    with ThreadPoolExecutor(max_workers=max(1, min(threads, len(starts)))) as pool:
        futures: list[Future[Array]] = []
        running = True
        while running:
            try:
                # All of it, for threads search and report before the last one is started, and Ctrl-C may come between two looks.
                while len(futures) < len(starts):
                    futures.append(pool.submit(one, len(futures)))
                while running:
                    running = bool(wait(futures, timeout=POLL_S).not_done)
            except KeyboardInterrupt:
                # A second Ctrl-C while the threads finish is raised as usual.
                interrupted = True
                stop.set()
        return [future.result() for future in futures], list(problems), interrupted


def search_apart(
    problem: Problem, starts: Sequence[Array], iterations: int, seed: int
) -> tuple[Array, Problem]:
    """Run one search in another process, and return its problem too, because the search tightens its limits."""
    return Search(problem, iterations, seed, threading.Event()).run(starts), problem


def share_done(evaluations: int, iterations: int) -> float:
    """Return the elapsed share of a start's time after a number of evaluations, for a Fourier series, at most 1."""
    thinned = (TRIALS * TRIAL + FIRST + HOPS + TRIAL) * iterations
    spent = THINNED_COST * min(evaluations, thinned) + max(0.0, evaluations - thinned)
    return min(1.0, spent / (THINNED_COST * thinned + LAST * iterations))


class DesignLine:
    """Callback of a search (`Progress`) with one line for all its starts, which may run in several threads.

    Parameters
    ----------
    starts : int
        Number of starts.
    iterations : int, optional
        Iterations of each start; None for a search that reports a start only at its end.
    wanted : bool
        Whether the line is shown.
    """

    def __init__(self, starts: int, iterations: int | None, wanted: bool) -> None:
        self._starts, self._iterations = starts, iterations
        self._line, self._lock, self._begin = ProgressLine(wanted), threading.Lock(), time.monotonic()
        self._done: dict[int, float] = {}
        self._values: dict[int, float] = {}

    def __call__(self, start: int, evaluations: int, value: float) -> None:
        """Update the line."""
        with self._lock:
            self._done[start] = 1.0 if self._iterations is None else share_done(evaluations, self._iterations)
            self._values[start] = value
            share = sum(self._done.values()) / self._starts
            left = (time.monotonic() - self._begin) * (1.0 - share) / share
            self._line.show(
                f"excite: {100.0 * share:.0f} %, criterion {max(self._values.values()):.1f}, about {left:.0f} s left"
            )

    def close(self) -> None:
        """Remove the line."""
        with self._lock:
            self._line.close()
