"""An executor of threads that pickles what it is given and what comes back, as processes and clusters do."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any


def unpacked(data: bytes) -> bytes:
    """Run a pickled call, and pickle its result."""
    function, arguments = pickle.loads(data)
    return pickle.dumps(function(*arguments))


class Pickling(Executor):
    """Threads that share nothing with the caller."""

    def __init__(self, workers: int) -> None:
        self._threads = ThreadPoolExecutor(workers)
        self.calls = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        assert not kwargs
        self.calls += 1
        data = pickle.dumps((fn, args))
        return self._threads.submit(lambda: pickle.loads(unpacked(data)))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._threads.shutdown(wait=wait, cancel_futures=cancel_futures)
