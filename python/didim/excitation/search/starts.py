"""Several starts in parallel, each a chain of descents with two weights of the penalties.

The criterion has very many maxima, and a descent ends in one of them within some 150 evaluations. A perturbation of the best
motion and a short descent from it nearly always end higher, so a start mostly consists of such perturbations (basin hopping).
On the TX40 they raise the log determinant by ten, and the starts end at similar values. A start only depends on its seed, so
the result has the same bits for any number of threads. Tested in ``tests/test_excitation_search.py`` and
``tests/test_excitation.py``.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait

import numpy as np

from ..._tools.arrays import Array
from ..problem import Problem
from ..series import POWERS
from ..settings import ExcitationSettings
from .descent import Descent

WEIGHTS = (100.0, 2000.0)
"""Weights of the penalties, in succession: after the second, limits are violated by a few parts in a thousand."""
TRIALS, TRIAL = 3, 0.08
"""Random motions of each start, and the share of the iterations that each gets; the best of them goes on."""
FIRST = 0.24
"""Share of the iterations for the first descent, after its trial."""
HOP, HOPS = 40, 3.0
"""Evaluations after each perturbation, and all of them together as a share of the iterations. Twenty are too few to get back to
the height of the motion that was perturbed."""
KICK = 0.12
"""Length of a perturbation, as a share of the joint's amplitudes: five of six end higher. 0.2 gains less in the same time; 0.5
loses the best motion so far."""
LAST = 0.3
"""Share of the iterations for the second weight, on the whole grid."""
REPAIRS, REPAIR = 8, 0.06
"""Largest number of repetitions with tighter limits, until the fine grid keeps them, and the share of iterations of each."""
THINNED = 4
"""Stride of the thinned grid, used until the last descent: five samples per period of the highest harmonic. It takes a third of
the time and starts end as high as with a stride of 2."""
THINNED_COST = 1.0 / 3.0
"""Time of an evaluation on the thinned grid, as a share of that on the whole grid."""
POLL_S = 0.2
"""Time (s) between two checks for Ctrl-C."""

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
