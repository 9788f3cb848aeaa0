"""Execution of tasks: a window at a time, with retries for lost workers, and each task counted once.

The function that runs a task returns a row even if the method fails. An exception of a future therefore means that a worker
died, or cannot import didim. Tested in ``tests/test_study_executors.py``.
"""

from __future__ import annotations

import queue
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from typing import Any

from .._tools.words import brief
from ..errors import StudyError
from .executors import Pool

ATTEMPTS = 3
"""Number of times a task is run when its worker dies, before it counts as lost."""

Outcome = tuple[Any, Any, str | None]
"""Task with its result, or with None and a sentence on the failure of its workers."""
WINDOW_PER_WORKER = 4
"""Number of tasks submitted ahead per worker."""
FIRST_LOSSES = 6
"""Number of lost workers before the first result from which the study stops, because no worker works."""


def run_all(
    function: Callable[[Any], Any], tasks: Iterable[Any], pool: Pool, *, window: int | None = None
) -> Iterator[Outcome]:
    """Run a function on tasks, and yield results in order of completion.

    Parameters
    ----------
    function : callable
        Function of a module that workers can import. It must not raise, except for `StudyError`, which ends the run.
    tasks : iterable
        Plain data, consumed on demand.
    pool : Pool
        Workers.
    window : int, optional
        Number of tasks submitted ahead.

    Yields
    ------
    task, result, sentence
        Each task once: with its result, or with None and a sentence on its workers, which failed `ATTEMPTS` times.

    Raises
    ------
    StudyError
        When no worker works, or a broken executor cannot be restarted.
    """
    run = _Run(function, pool, window or WINDOW_PER_WORKER * pool.workers)
    finished = False
    try:
        yield from run.results(iter(tasks))
        finished = True
    finally:
        run.stop(wait=finished)


class _Run:
    """State of one run: submitted tasks, and tasks to be repeated."""

    def __init__(self, function: Callable[[Any], Any], pool: Pool, window: int) -> None:
        self._function, self._pool, self._window = function, pool, window
        self._executor: Executor | None = None
        self._ended: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
        self._running: dict[Future[Any], tuple[int, Any]] = {}
        self._again: deque[tuple[int, Any]] = deque()
        self._alone: deque[tuple[int, Any]] = deque()
        self._attempts: Counter[int] = Counter()
        self._outcomes: deque[Outcome] = deque()
        self._losses = self._results = 0

    def stop(self, *, wait: bool) -> None:
        """Cancel the running tasks, and stop the pool."""
        for future in self._running:
            future.cancel()
        if self._executor is not None:
            self._pool.stop(self._executor, wait)

    def results(self, tasks: Iterator[Any]) -> Iterator[Outcome]:
        """Yield the outcomes of all tasks."""
        numbered = enumerate(tasks)
        exhausted = False
        while True:
            # After a pool broke, its tasks run one at a time, which identifies the one that kills its worker.
            while self._alone and not self._running:
                self._submit(*self._alone.popleft())
            while not self._alone and len(self._running) < self._window:
                numbered_task = self._again.popleft() if self._again else next(numbered, None)
                if numbered_task is None:
                    exhausted = True
                    break
                self._submit(*numbered_task)
            while self._outcomes:
                yield self._outcomes.popleft()
            if self._running:
                future = self._ended.get()
                if future in self._running:  # and not of a pool that broke
                    self._take(future)
            elif exhausted and not self._alone and not self._again and not self._outcomes:
                return

    def _submit(self, number: int, task: Any) -> None:
        if self._executor is None:
            self._executor = self._pool.start()
        try:
            future = self._executor.submit(self._function, task)
        except BrokenExecutor as reason:
            self._broken(reason, [(number, task)])
            return
        self._running[future] = (number, task)
        future.add_done_callback(self._ended.put)

    def _take(self, future: Future[Any]) -> None:
        number, task = self._running[future]
        try:
            result = future.result()
        except StudyError:
            raise
        except BrokenExecutor as reason:
            self._broken(reason, [])
        except (Exception, CancelledError) as reason:
            # Dask and Ray name the task whose workers died.
            del self._running[future]
            self._lost(number, task, reason, self._again)
        else:
            del self._running[future]
            self._results += 1
            self._outcomes.append((task, result, None))

    def _lost(self, number: int, task: Any, reason: BaseException, waiting: deque[tuple[int, Any]]) -> None:
        """Repeat a task whose worker is lost, up to `ATTEMPTS` times."""
        self._attempts[number] += 1
        text = self._count_loss(reason)
        if self._attempts[number] < ATTEMPTS:
            waiting.append((number, task))
        else:
            self._outcomes.append((task, None, f"its worker was lost {ATTEMPTS} times: {text}"))

    def _broken(self, reason: BaseException, also: list[tuple[int, Any]]) -> None:
        """Restart the pool after one of its processes died, which ends all its tasks."""
        executor, self._executor = self._executor, None
        lost = list(also)
        for future, (number, task) in self._running.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                self._results += 1
                self._outcomes.append((task, future.result(), None))
            else:
                lost.append((number, task))
        self._running.clear()
        if executor is not None:
            self._pool.stop(executor, False)
        if not self._pool.restarts:
            raise StudyError(
                f"the executor broke ({type(reason).__name__}); the rows so far are kept, and the study goes on from there with a "
                "new executor"
            ) from reason
        if len(lost) == 1:
            self._lost(*lost[0], reason, self._alone)
        else:
            self._count_loss(reason)
            self._alone.extend(lost)

    def _count_loss(self, reason: BaseException) -> str:
        """Return the reason as text, or raise if no worker has ever returned a result."""
        self._losses += 1
        text = brief(" ".join(f"{type(reason).__name__}: {reason}".split()), 120)
        if not self._results and self._losses >= FIRST_LOSSES:
            raise StudyError(f"no worker of {self._pool.name} has run a task: {text}") from reason
        return text
