"""`study`: run or resume a Monte Carlo study. Tested in ``tests/test_study.py``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .._tools.progress import ProgressLine
from ..errors import DidimError, StudyError
from .engine import run_all
from .executors import pool
from .logs import model_of, truth_of
from .results import StudyResults
from .rows import RowFile, Rows, read_rows, rows_of, times_path
from .spec import StudySpec, load_study, read_study
from .tasks import count, tasks
from .worker import ERROR, FAILED, LOST, lost_row, method_of, run_task


@dataclass
class Progress:
    """Progress of a study.

    Attributes
    ----------
    total, done : int
        Number of tasks, and of tasks with a row.
    truths : int
        Number of these tasks that compute the truth of a scenario, and are no run.
    earlier : int
        Number of rows from earlier runs.
    failed, lost : int
        Number of rows with errors, and of tasks whose workers died.
    seconds : float
        Time since the start.
    """

    total: int
    done: int = 0
    truths: int = 0
    earlier: int = 0
    failed: int = 0
    lost: int = 0
    seconds: float = 0.0

    def __str__(self) -> str:
        """Return one line with the remaining time."""
        rate = (self.done - self.earlier) / max(self.seconds, 1e-9)
        left = (self.total - self.done) / max(rate, 1e-9)
        earlier = f", {self.earlier} from before" if self.earlier else ""
        of = f"{self.total} rows ({self.total - self.truths} runs)" if self.truths else f"{self.total} rows"
        return (
            f"{self.done} of {of}{earlier}, {self.failed} failed, {rate:.3g} rows a second, {left:.0f} s left"
        )


def study(
    spec: str | Path | Mapping[str, Any] | StudySpec,
    output: str | Path | None = None,
    *,
    executor: Executor | str = "process",
    workers: int | None = None,
    address: str | None = None,
    window: int | None = None,
    progress: Callable[[Progress], None] | None = None,
    verbose: bool | None = None,
) -> StudyResults:
    """Simulate many logs, identify each by several methods, and record every result.

    Tested in ``tests/test_study.py``.

    Parameters
    ----------
    spec : path, mapping or StudySpec
        Study file, or its content (docs/studies.md).
    output : path, optional
        File of JSON lines to which rows are appended. Existing rows are not computed again, so the same call resumes an
        interrupted study.
    executor : Executor or str
        "process" (spawned), "thread", "serial", "loky", "dask", "ray" or "mpi", or any `concurrent.futures.Executor`.
        A program with processes needs the guard ``if __name__ == "__main__":``.
    workers : int, optional
        Number of processes or threads; by default all cores available to this process.
    address : str, optional
        Scheduler of Dask, or head of Ray.
    window : int, optional
        Number of tasks submitted ahead; by default four per worker.
    progress : callable, optional
        Callback after each row.
    verbose : bool, optional
        By default a terminal or a notebook shows one line with the number of rows and the remaining time, and removes it at the
        end; False hides it.

    Returns
    -------
    StudyResults
        All rows, those of failures included. They are the same for any executor and number of workers.

    Raises
    ------
    StudyError
        For a wrong study, an output file that is in use or contains other than rows of this study, or failing workers.
    DidimError
        For a wrong experiment, robot or method, before the work begins.
    """
    if not isinstance(spec, StudySpec):
        spec = read_study(spec) if isinstance(spec, Mapping) else load_study(spec)
    check_study(spec)
    with ExitStack() as stack:
        known = Rows()
        lines: dict[str, list[str]] = {"row": [], "times": []}
        append: dict[str, Callable[[str], None]] = {key: kept.append for key, kept in lines.items()}
        if output is not None:
            path = Path(output)
            files = {"row": path, "times": times_path(path)}
            append = {key: stack.enter_context(closing(RowFile(file))).append for key, file in files.items()}
            known = read_rows(path, appended=True)
            # Rows of two studies are not mixed.
            ids = known.statuses
            if ids and not any(task["id"] in ids for task in tasks(spec)):
                raise StudyError(
                    f"{path}: its rows are of another study, or of another version of didim; give -o another file"
                )
        state = Progress(total=count(spec), truths=len(spec.scenarios))
        line = stack.enter_context(closing(ProgressLine(verbose is not False)))
        start = time.perf_counter()
        for result in _run(spec, known, state, executor, workers, address, window):
            append["row"](result["row"])
            if result["times"] is not None:
                append["times"](result["times"])
            state.done += 1
            state.failed += result["status"] in (FAILED, ERROR)
            state.lost += result["status"] == LOST
            state.seconds = time.perf_counter() - start
            line.show(f"study: {state}")
            if progress is not None:
                progress(state)
        rows = rows_of(*lines.values()) if output is None else read_rows(path, appended=True)
    return StudyResults.of(spec, rows)


def _run(
    spec: StudySpec,
    known: Rows,
    state: Progress,
    executor: Executor | str,
    workers: int | None,
    address: str | None,
    window: int | None,
) -> Iterator[dict[str, Any]]:
    """Run the tasks without a row."""
    done = known.done
    state.earlier = state.done = sum(task["id"] in done for task in tasks(spec))
    if state.done == state.total:
        return
    missing = (task for task in tasks(spec) if task["id"] not in done)
    with pool(executor, workers, address) as some:
        for task, result, sentence in run_all(run_task, missing, some, window=window):
            yield lost_row(task, sentence or "") if result is None else result


def check_study(spec: StudySpec) -> None:
    """Refuse a study with invalid scenarios or methods, before any work.

    Raises
    ------
    DidimError
        The sentence names the scenario or the method.
    """
    shared = spec.shared()
    for scenario in spec.scenarios:
        try:
            truth = truth_of(shared, scenario.keys)
            models = {repr(method.keys): method.keys for method in spec.methods}
            for own in models.values():
                common = model_of(shared, scenario.keys, own, truth).method
        except DidimError as error:
            raise type(error)(f"scenario {scenario.name!r}: {error}") from None
        for method in spec.methods:
            try:
                method_of(method.name, {**method.settings, **common})
            except DidimError as error:
                raise type(error)(f"scenario {scenario.name!r}, method {method.label!r}: {error}") from None
