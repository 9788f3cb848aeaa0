"""Executors by name: local processes, threads, loky, and the workers of Dask, Ray and MPI.

Any other `concurrent.futures.Executor` can be passed as an object. Tested in ``tests/test_study_executors.py``.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import Any

from .._tools.plugins import optional
from .._tools.settings import whole
from .._tools.threads import NUMPY_VARIABLES, VARIABLE
from .._tools.words import series
from ..errors import StudyError

NAMES = ("process", "thread", "serial", "loky", "dask", "ray", "mpi")
"""Names of the executors."""
MALLOC_VARIABLE, LARGE_BYTES = "MALLOC_MMAP_THRESHOLD_", 1_000_000
"""Arrays of so many bytes go back to the system when they are freed (glibc reads the variable when a process starts). Otherwise the
heap of a worker grows with every task: on the TX40 to 300 MB, and to 190 MB with it."""
MOST_WORKERS = 10_000
"""Upper bound of the number of workers that a user may ask for."""
UNKNOWN_WORKERS = 16
"""Number of workers assumed for an executor that does not report it."""


@dataclass(frozen=True)
class Pool:
    """Source of executors, with restart of a broken one.

    Attributes
    ----------
    name : str
        Name in messages.
    start : callable
        Function that returns an executor.
    stop : callable
        Function ``stop(executor, wait)`` that shuts one down, at once without `wait`.
    workers : int
        Number of parallel tasks.
    restarts : bool
        Whether `start` may be called again.
    """

    name: str
    start: Callable[[], Executor]
    stop: Callable[[Executor, bool], None]
    workers: int
    restarts: bool = True


@contextlib.contextmanager
def pool(
    executor: Executor | str = "process", workers: int | None = None, address: str | None = None
) -> Iterator[Pool]:
    """Return workers by the name of their executor, or those of an existing executor.

    Parameters
    ----------
    executor : Executor or str
        One of `NAMES`, or any executor, which is not shut down.
    workers : int, optional
        Number of processes or threads; by default all processors of this process. Dask, Ray and MPI have their own number.
    address : str, optional
        Address of Dask's scheduler or Ray's head; without one they start local workers.

    Raises
    ------
    StudyError
        For an unknown name, or a package that is missing.
    """
    if workers is not None:
        workers = whole("workers", workers, StudyError, least=1, most=MOST_WORKERS)
    if isinstance(executor, Executor):
        yield Pool(
            type(executor).__name__,
            lambda: executor,
            _leave,
            workers or _workers_of(executor),
            restarts=False,
        )
        return
    if executor not in NAMES:
        raise StudyError(f"there is no executor {executor!r} (there are: {series(NAMES)})")
    own = workers or _cores()
    with worker_environment(), contextlib.ExitStack() as stack:
        if executor == "process":
            yield Pool("process", lambda: _processes(own), _stop_processes, own)
        elif executor == "thread":
            yield Pool("thread", lambda: ThreadPoolExecutor(own), _stop, own)
        elif executor == "serial":
            yield Pool("serial", SerialExecutor, _stop, 1)
        elif executor == "loky":
            loky = _needed("loky", "loky")
            yield Pool(
                "loky",
                lambda: loky.get_reusable_executor(max_workers=own, initializer=start_worker),
                _stop_loky,
                own,
            )
        elif executor == "dask":
            client = stack.enter_context(_dask_client(workers, address))
            threads = sum(client.nthreads().values())
            # Dask itself repeats the tasks of a lost worker.
            yield Pool("dask", lambda: client.get_executor(pure=False), _stop_dask, max(1, threads))
        elif executor == "ray":
            ray = stack.enter_context(_ray_session(workers, address))
            yield Pool(
                "ray", lambda: RayExecutor(ray), _stop, max(1, int(ray.cluster_resources().get("CPU", 1)))
            )
        else:
            mpi = _needed("mpi4py.futures", "mpi4py")
            started = stack.enter_context(mpi.MPIPoolExecutor())
            yield Pool("mpi", lambda: started, _leave, max(1, started.num_workers), restarts=False)


@contextlib.contextmanager
def worker_environment() -> Iterator[None]:
    """Limit processes started in this context to one thread each, for NumPy and the core, and to little memory."""
    changes = dict.fromkeys((VARIABLE, *NUMPY_VARIABLES), "1") | {MALLOC_VARIABLE: str(LARGE_BYTES)}
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


class SerialExecutor(Executor):
    """Executor that runs each task immediately in the calling thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a function."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class RayExecutor(Executor):
    """Ray as an executor: one task with one processor per call.

    Parameters
    ----------
    ray : module
        Ray, connected.
    """

    def __init__(self, ray: Any) -> None:
        self._ray = ray
        self._remote: dict[Callable[..., Any], Any] = {}

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a function of a module that workers can import."""
        if fn not in self._remote:
            self._remote[fn] = self._ray.remote(fn)
        future: Future[Any] = self._remote[fn].remote(*args, **kwargs).future()
        return future


def start_worker() -> None:
    """Prepare a worker process: no warnings on stderr, and termination with its parent."""
    warnings.simplefilter("ignore")
    parent = multiprocessing.parent_process()
    if (
        parent is not None and parent.sentinel is not None
    ):  # loky has no parent process, and ends its workers itself
        threading.Thread(target=_die_with, args=(parent.sentinel,), daemon=True).start()


def _die_with(sentinel: int) -> None:
    """End this process with its parent: workers of a killed parent would wait for tasks for ever."""
    wait([sentinel])
    os._exit(1)


def _cores() -> int:
    """Count the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        allowed: set[int] = os.sched_getaffinity(0)
        return len(allowed)
    return os.cpu_count() or 1


def _workers_of(executor: Executor) -> int:
    for name in ("_max_workers", "num_workers"):
        number = getattr(executor, name, None)
        if isinstance(number, int) and number > 0:
            return number
    client = getattr(executor, "_client", None)
    if client is not None and hasattr(client, "nthreads"):
        return max(1, int(sum(client.nthreads().values())))
    return UNKNOWN_WORKERS


def _processes(workers: int) -> Executor:
    # A forked child would inherit its parent's threads in an unknown state.
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, mp_context=context, initializer=start_worker)


def _stop(executor: Executor, wait_for_it: bool) -> None:
    executor.shutdown(wait=wait_for_it, cancel_futures=True)


def _stop_dask(executor: Executor, wait_for_it: bool) -> None:
    # Without waiting it cancels its tasks; it has no other option.
    executor.shutdown(wait=wait_for_it)


def _leave(executor: Executor, wait_for_it: bool) -> None:
    """Do not shut down the executor of the caller."""


def _stop_processes(executor: Executor, wait_for_it: bool) -> None:
    # Read before the shutdown, which deletes them.
    processes = list((getattr(executor, "_processes", None) or {}).values())
    executor.shutdown(wait=wait_for_it, cancel_futures=True)
    if not wait_for_it:
        for process in processes:
            process.terminate()


def _stop_loky(executor: Any, wait_for_it: bool) -> None:
    executor.shutdown(wait=wait_for_it, kill_workers=not wait_for_it)


@contextlib.contextmanager
def _dask_client(workers: int | None, address: str | None) -> Iterator[Any]:
    distributed = _needed("distributed", "didim[dask]")
    try:
        if address is not None:
            client = distributed.Client(address, set_as_default=False, timeout=30)
        else:
            client = distributed.Client(
                n_workers=workers or _cores(),
                threads_per_worker=1,
                dashboard_address=None,
                set_as_default=False,
            )
    except OSError as reason:
        raise StudyError(f"no scheduler of Dask answers at {address} ({reason})") from None
    with client:
        yield client


@contextlib.contextmanager
def _ray_session(workers: int | None, address: str | None) -> Iterator[Any]:
    ray = _needed("ray", "didim[ray]")
    ours = not ray.is_initialized()
    if ours:
        options: dict[str, Any] = {
            "include_dashboard": False,
            "log_to_driver": False,
            "configure_logging": False,
        }
        if address is not None:
            options = {"address": address, "log_to_driver": False}
        elif workers is not None:
            options["num_cpus"] = workers
        ray.init(**options)
    try:
        yield ray
    finally:
        if ours:
            ray.shutdown()


def _needed(module: str, install: str) -> Any:
    return optional(module, StudyError, f"this executor needs {module}: pip install {install}")
