"""Several starts in parallel, each by a quasi-Newton method with two weights of the penalties.

A start depends on its seed alone, so the result has the same bits for any number of threads. Tested in
``tests/test_excitation.py``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, wait
from typing import Any

import numpy as np
from scipy.optimize import minimize

from .._tools.arrays import Array
from .problem import Problem
from .series import POWERS

WEIGHTS = (100.0, 2000.0)
"""Weights of the penalties, one after the other: the second leaves violations of parts in a thousand."""
SHARES = (0.5, 0.5)
"""Shares of the iterations with each weight."""
TRIALS, TRIAL = 3, 0.32
"""Random motions of each start, and the share of the iterations that each gets; the best of them goes on. Where a search ends
differs by several units of the log determinant from motion to motion, and shows after so many iterations."""
REPAIRS, REPAIR = 8, 0.06
"""Largest number of repetitions with tighter limits, until the fine grid keeps them, and the share of iterations of each."""
MEMORY = 60
"""Pairs of steps and gradients that the quasi-Newton method keeps."""
POLL_S = 0.2
"""Seconds between looks at the keyboard."""

Progress = Callable[[int, int, float], None]
"""Called with the start (from 1), the evaluation and the value of the criterion so far."""


class _StopSearchError(Exception):
    """The user has stopped the search."""


def search(
    problem: Problem,
    starts: Sequence[Array],
    iterations: int,
    stop: threading.Event,
    progress: Callable[[int, float], None] | None = None,
) -> Array:
    """Minimise the objective of a problem from the best of several motions; a stop keeps the best variables so far."""
    best, least, calls = starts[0], np.inf, 0
    penalised = problem.limited or not problem.clearance.empty

    def value(v: Array, weight: float) -> tuple[float, Array]:
        nonlocal best, least, calls
        if stop.is_set():
            raise _StopSearchError
        calls += 1
        objective, gradient = problem.value(v, weight)
        if objective < least:
            best, least = v.copy(), objective
        if progress is not None:
            progress(calls, least)
        return objective, gradient

    def descend(weight: float, count: int, start: Array | None = None) -> None:
        nonlocal least
        if start is None:
            least = np.inf
            start = best
        options = {"maxiter": count, "maxfun": 2 * count, "maxcor": MEMORY, "ftol": 1e-9, "gtol": 1e-6}
        minimise: Any = minimize  # its overloads do not know functions that return value and gradient
        minimise(lambda v: value(v, weight), start, jac=True, method="L-BFGS-B", options=options)

    try:
        problem.series.power = POWERS[0]
        for start in starts if len(starts) > 1 else ():
            descend(WEIGHTS[0], max(1, round(TRIAL * iterations)), start)
        shares = (SHARES[0] if len(starts) == 1 else max(SHARES[0] - TRIAL, 0.0), *SHARES[1:])
        for power, weight, share in zip(POWERS, WEIGHTS, shares, strict=True):
            problem.series.power = power
            descend(weight, max(1, round(share * iterations)))
        for _ in range(REPAIRS if penalised else 0):
            if not problem.tighten(problem.series.build(best)[0]):
                break
            descend(WEIGHTS[-1], max(1, round(REPAIR * iterations)))
    except _StopSearchError:
        problem.series.power = POWERS[-1]
    return best


def search_all(
    problems: Sequence[Problem],
    starts: Sequence[Sequence[Array]],
    iterations: int,
    threads: int,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> tuple[list[Array], list[Problem], bool]:
    """Run all starts on threads, or on an executor of the caller.

    Returns
    -------
    found, problems, interrupted
        The end of each start, its problem with the limits that the search has tightened, and whether the keyboard interrupted
        them: every start keeps its best then. An executor elsewhere hears nothing of the keyboard and tells no progress.
    """
    if executor is not None:
        sent = [
            executor.submit(search_apart, problem, start, iterations)
            for problem, start in zip(problems, starts, strict=True)
        ]
        try:
            ends = [future.result() for future in sent]
        except BaseException:
            for future in sent:
                future.cancel()
            raise
        return [found for found, _ in ends], [problem for _, problem in ends], False
    stop = threading.Event()

    def one(index: int) -> Array:
        tell = None
        if progress is not None:

            def tell(calls: int, least: float) -> None:
                progress(index + 1, calls, -least)

        return search(problems[index], starts[index], iterations, stop, tell)

    interrupted = False
    with ThreadPoolExecutor(max_workers=max(1, min(threads, len(starts)))) as pool:
        futures = [pool.submit(one, index) for index in range(len(starts))]
        pending = set(futures)
        while pending:
            try:
                pending = wait(pending, timeout=POLL_S).not_done
            except KeyboardInterrupt:
                # A second interruption while the threads come to their end leaves as usual.
                interrupted = True
                stop.set()
        return [future.result() for future in futures], list(problems), interrupted


def search_apart(problem: Problem, starts: Sequence[Array], iterations: int) -> tuple[Array, Problem]:
    """Run one search in another process, and return its problem too: a search tightens its limits."""
    return search(problem, starts, iterations, threading.Event()), problem
