"""Executors: the same rows from all of them, and workers that die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from didim.errors import StudyError
from didim.monte_carlo.engine import ATTEMPTS, run_all
from didim.monte_carlo.executors import Pool, SerialExecutor, pool, worker_environment
from didim.monte_carlo.spec import read_study
from didim.monte_carlo.study import study
from small_study import PLACE, small_study

SPEC = read_study(small_study(), PLACE)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Sorted rows of the small study."""
    path = tmp_path_factory.mktemp("study") / "rows.jsonl"
    study(SPEC, path, executor="serial")
    return sorted(path.read_text().splitlines())


class Fragile(SerialExecutor):
    """Breaks as a pool of processes does when the task that it runs is in `deadly`."""

    def __init__(self, deadly: set[int], broken: list[int]) -> None:
        self._deadly, self._log, self._is_broken = deadly, broken, False
        self._waiting: list[tuple[Future[Any], Callable[..., Any], Any]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if self._is_broken:
            raise BrokenProcessPool("broken")
        future: Future[Any] = Future()
        self._waiting.append((future, fn, args[0]))
        if len(self._waiting) >= 4 or args[0] in self._deadly or args[0] >= 90:
            self._run()
        return future

    def _run(self) -> None:
        deadly = [task for _, _, task in self._waiting if task in self._deadly]
        for future, fn, task in self._waiting:
            if deadly:
                future.set_exception(BrokenProcessPool("a process died"))
            else:
                future.set_result(fn(task))
        self._waiting.clear()
        if deadly:
            self._is_broken = True
            self._log.append(deadly[0])


def double(task: int) -> int:
    return 2 * task


def fragile(deadly: set[int], broken: list[int], window: int = 4) -> Pool:
    return Pool("fragile", lambda: Fragile(deadly, broken), lambda executor, wait: None, window)


def test_a_task_that_kills_its_worker_is_found_and_no_other_is_lost() -> None:
    broken: list[int] = []
    # Numbers of 90 and more run at once: a task that runs alone has no neighbours to wait for.
    tasks = [90, 91, 92, 93, 94, 95, 96, 97]
    outcomes = list(run_all(double, tasks, fragile({94}, broken), window=1))
    assert sorted(task for task, _, _ in outcomes) == tasks
    lost = {task: sentence for task, result, sentence in outcomes if result is None}
    assert list(lost) == [94]
    assert lost[94] == f"its worker was lost {ATTEMPTS} times: BrokenProcessPool: a process died"
    assert len(broken) == ATTEMPTS


class Dying(SerialExecutor):
    """Breaks once, with everything that is submitted and not yet finished."""

    left = 1

    def __init__(self) -> None:
        self._held: list[tuple[Future[Any], Callable[..., Any], Any]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if Dying.left == 0:
            return super().submit(fn, *args, **kwargs)
        future: Future[Any] = Future()
        self._held.append((future, fn, args[0]))
        if len(self._held) == 4:
            Dying.left -= 1
            # One of the tasks had ended before the process died.
            first, *others = self._held
            first[0].set_result(first[1](first[2]))
            for other, _, _ in others:
                other.set_exception(BrokenProcessPool("a process died"))
        return future


def test_a_pool_that_breaks_is_started_again_and_no_result_counts_twice() -> None:
    Dying.left = 1
    starts: list[Executor] = []

    def start() -> Executor:
        starts.append(Dying())
        return starts[-1]

    some = Pool("dying", start, lambda executor, wait: None, 1)
    outcomes = list(run_all(double, range(20), some))
    assert sorted(outcomes) == [(task, 2 * task, None) for task in range(20)]
    assert len(starts) == 2


def test_lost_tasks_of_a_cluster_run_again_and_then_count_as_lost() -> None:
    calls: dict[int, int] = {}

    class Cluster(SerialExecutor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            task = args[0]
            calls[task] = calls.get(task, 0) + 1
            if task == 5 or (task == 7 and calls[task] == 1):
                future: Future[Any] = Future()
                future.set_exception(RuntimeError("the worker died"))
                return future
            return super().submit(fn, *args, **kwargs)

    outcomes = {
        task: (result, sentence) for task, result, sentence in run_all(double, range(10), _of(Cluster()))
    }
    assert outcomes[7] == (14, None)
    assert outcomes[5] == (None, "its worker was lost 3 times: RuntimeError: the worker died")
    assert (calls[5], calls[7], calls[3]) == (ATTEMPTS, 2, 1)
    assert len(outcomes) == 10


def _of(executor: Executor) -> Pool:
    return Pool("cluster", lambda: executor, lambda executor, wait: None, 1, restarts=False)


def test_workers_that_never_work_end_the_study() -> None:
    class Hopeless(SerialExecutor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            future: Future[Any] = Future()
            future.set_exception(ModuleNotFoundError("No module named 'didim'"))
            return future

    with pytest.raises(
        StudyError, match="no worker of cluster has run a task: ModuleNotFoundError: No module"
    ):
        list(run_all(double, range(10), _of(Hopeless())))


def test_an_executor_of_the_caller_that_breaks_is_said() -> None:
    broken: list[int] = []
    some = Pool("own", lambda: Fragile({91}, broken), lambda executor, wait: None, 1, restarts=False)
    with pytest.raises(StudyError, match="the executor broke"):
        list(run_all(double, [90, 91], some, window=1))


def test_workers_have_one_thread_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    monkeypatch.delenv("DIDIM_THREADS", raising=False)
    with worker_environment():
        assert (os.environ["OPENBLAS_NUM_THREADS"], os.environ["DIDIM_THREADS"]) == ("1", "1")
    assert os.environ["OPENBLAS_NUM_THREADS"] == "3"
    assert "DIDIM_THREADS" not in os.environ


def test_unknown_executors_and_wrong_numbers_of_workers() -> None:
    with pytest.raises(StudyError, match="there is no executor 'proces'"), pool("proces"):
        pass
    with pytest.raises(StudyError, match="workers must be a whole number"), pool("thread", 0):
        pass


def test_an_executor_of_the_caller_is_left_as_it_is(expected: list[str], tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as own:
        study(SPEC, tmp_path / "rows.jsonl", executor=own)
        assert own.submit(double, 3).result() == 6
    assert sorted((tmp_path / "rows.jsonl").read_text().splitlines()) == expected


PROGRAM = """
import sys
from didim.monte_carlo.study import study
sys.path.insert(0, {tests!r})
from small_study import PLACE, small_study
from didim.monte_carlo.spec import read_study
if __name__ == "__main__":
    study(read_study(small_study(), PLACE), sys.argv[1], executor="process", workers=2)
"""


@contextmanager
def running(tmp_path: Path, rows: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run the small study with two processes, in a program of its own."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM.format(tests=str(Path(__file__).parent)))
    process = subprocess.Popen([sys.executable, str(program), str(rows)])
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def children(parent: int) -> list[int]:
    """Worker processes of a parent, which begin as `multiprocessing.spawn`."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            fields = (place / "stat").read_text().rpartition(")")[2].split()
            command = (place / "cmdline").read_bytes()
        except OSError:
            continue
        if int(fields[1]) == parent and b"spawn_main" in command and fields[0] != "Z":
            found.append(int(place.name))
    return found


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_a_study_that_is_killed_twice_has_the_same_rows(expected: list[str], tmp_path: Path) -> None:
    rows = tmp_path / "rows.jsonl"

    def count() -> int:
        return rows.read_bytes().count(b"\n") if rows.exists() else 0

    with running(tmp_path, rows) as process:
        wait_for(lambda: count() >= 2)
        workers = children(process.pid)
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert len(workers) == 2
    # Workers end with their parent, although it took no leave.
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))
    assert not any(Path(f"/proc/{pid}").exists() for pid in workers)
    before = count()
    with running(tmp_path, rows) as process:
        wait_for(lambda: count() > before or process.poll() is not None)
        for worker in children(process.pid)[:1]:
            os.kill(worker, signal.SIGKILL)
        assert process.wait(timeout=120) == 0
    assert sorted(rows.read_text().splitlines()) == expected


@pytest.mark.tools
@pytest.mark.parametrize(
    ("package", "run"),
    [("loky", "loky"), ("distributed", "dask"), ("distributed", "vanished"), ("ray", "ray")],
)
def test_other_executors_give_the_same_rows(project: Path, package: str, run: str) -> None:
    pytest.importorskip(package)
    command = [
        sys.executable,
        str(project / "benches" / "study_executors.py"),
        "--seeds",
        "2",
        "--only",
        "process-1",
        run,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("all the same\n")
    assert "not run" not in done.stdout
