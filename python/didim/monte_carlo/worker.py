"""Work of one task: simulate the log, identify it, and return the row.

A row only depends on its task; times are stored separately. Tested in ``tests/test_study.py``.
"""

from __future__ import annotations

import json
import os
import platform
import threading
import time
import zlib
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from .._tools.arrays import Array, rms
from .._tools.plugins import loaded, search, source_digest
from .._tools.settings import share
from .._tools.threads import VARIABLE
from .._tools.version import __version__
from .._tools.words import did_you_mean
from ..errors import DidimError, StudyError
from ..methods.identify import identify
from ..methods.method import Method
from ..methods.table import method_class
from .logs import Truth, model_of, truth_of
from .spec import canonical, digest
from .tasks import Task

DIGITS = 12
"""Significant digits of the numbers in a row."""
SEAL = "digest"
"""Key of a row's digest over its other keys."""
KEPT_SCENARIOS = 16
"""Number of simulated logs that a worker caches."""
FAILED, ERROR, LOST, TRUTH = "FAILED", "ERROR", "LOST", "TRUTH"
"""Status of rows: an error of didim, an unexpected error, a task whose workers died, and the truth of a scenario."""

OBJECTS = ("signal", "checkpoint", "progress")
"""Settings of methods that are not plain data, or that a study sets by other keys."""

_Made = TypeVar("_Made")


class _Kept:
    """Cache of the last few objects by key; one thread computes an object while others wait for it."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._made: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], _Made]) -> _Made:
        with self._lock:
            if key not in self._made:
                self._made[key] = make()
                while len(self._made) > self._most:
                    self._made.popitem(last=False)
            self._made.move_to_end(key)
            made: _Made = self._made[key]
            return made


_STUDIES, _TRUTHS, _LOGS, _MODELS = _Kept(2), _Kept(KEPT_SCENARIOS), _Kept(4), _Kept(4 * KEPT_SCENARIOS)


def run_task(task: Task) -> dict[str, Any]:
    """Run a task.

    Parameters
    ----------
    task : dict
        From `didim.monte_carlo.tasks.tasks`.

    Returns
    -------
    dict
        ``id`` and ``status`` of the row, ``row`` as a line of JSON, ``times`` as another.

    Raises
    ------
    StudyError
        When the study comes from another version of didim. All other errors become rows.
    """
    if task["version"] != __version__:
        raise StudyError(
            f"the study was made by didim {task['version']}, and the worker on {platform.node()} has didim {__version__}: "
            "install the same version everywhere"
        )
    _shared(task)  # if the study's modules are missing, the study fails instead of its rows
    # Workers already share the cores. An explicit limit is respected.
    os.environ.setdefault(VARIABLE, "1")
    start, spent = time.perf_counter(), time.thread_time()
    seconds: dict[str, float] = {}
    try:
        row = _truth_row(task) if task["method"] is None else _fit_row(task, seconds)
    except DidimError as error:
        row = {"status": FAILED, "sentence": f"{type(error).__name__}: {error}"}
    except Exception as error:
        row = {"status": ERROR, "sentence": f"{type(error).__name__}: {error}"}
    times = {
        "id": task["id"],
        "seconds": round(seconds.get("fit", 0.0), 6),
        "task_seconds": round(time.perf_counter() - start, 6),
        "cpu_seconds": round(time.thread_time() - spent, 6),
        "host": platform.node(),
        "pid": os.getpid(),
        "memory_mb": _memory_mb(),
    }
    return _lines(task, row, _line(times))


def lost_row(task: Task, sentence: str) -> dict[str, Any]:
    """Return the row of a task whose workers died."""
    return _lines(task, {"status": LOST, "sentence": sentence}, None)


def _lines(task: Task, row: dict[str, Any], times: str | None) -> dict[str, Any]:
    """Return the result of a task: the line of its row, which begins with what it says of the task, and that of its times."""
    method = None if task["method"] is None else task["method"]["label"]
    head = {"id": task["id"], "scenario": task["scenario"]["name"], "method": method, "seed": task["seed"]}
    line = _line(sealed({**head, **row}))
    return {"id": task["id"], "status": row["status"], "row": line, "times": times}


def sealed(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row with the digest of its content, which reveals an edited or damaged row."""
    return {**row, SEAL: seal_of(row)}


def seal_of(row: dict[str, Any]) -> str:
    """Return the digest of a row's content, independent of the order of its keys."""
    return digest(canonical({key: value for key, value in row.items() if key != SEAL}))


def _shared(task: Task) -> dict[str, Any]:
    def read() -> dict[str, Any]:
        shared: dict[str, Any] = json.loads(zlib.decompress(task["shared"]))
        search(map(Path, task["folders"]))
        for path, source in shared.get("sources", {}).items():
            loaded(path, "method or law", StudyError)
            if source_digest(path) != source:
                raise StudyError(
                    f"{path} is another one on the worker {platform.node()}: put the same file on all workers"
                )
        return shared

    return _STUDIES.get(task["digest"], read)


def _truth(task: Task, shared: dict[str, Any]) -> Truth:
    keys = task["scenario"]["keys"]

    def make() -> Truth:
        truth = truth_of(shared, keys)
        if shared["noise_in_loop_hz"] is None:
            truth.clean  # noqa: B018 - one thread simulates it here
        return truth

    return _TRUTHS.get((task["digest"], canonical(keys)), make)


def _truth_row(task: Task) -> dict[str, Any]:
    """Return the row of a scenario: the truth, and the ratio of noise to signal."""
    shared = _shared(task)
    truth = _truth(task, shared)
    model = model_of(shared, task["scenario"]["keys"], {}, truth)
    base = model.experiment.robot.base_parameters
    clean, noisy = truth.clean.recordings[0], truth.noisy(0).recordings[0]
    assert clean.tau is not None
    assert noisy.tau is not None
    return {
        "status": TRUTH,
        "keys": task["scenario"]["keys"],
        "names": list(base.names),
        "units": list(base.units),
        "truth": _plain(model.beta),
        "samples": len(clean.q),
        "rate_hz": clean.rate_hz,
        "torque_rms": _plain(rms(clean.tau)),
        "torque_noise": _plain(rms(noisy.tau - clean.tau)),
        "position_noise": _plain(rms(noisy.q - clean.q)),
    }


def _fit_row(task: Task, seconds: dict[str, float]) -> dict[str, Any]:
    """Row of an identification."""
    shared, keys, asked, seed = _shared(task), task["scenario"]["keys"], task["method"], task["seed"]
    truth = _truth(task, shared)
    where = (task["digest"], canonical(keys), canonical(asked["keys"]))
    model = _MODELS.get(where, lambda: model_of(shared, keys, asked["keys"], truth))
    noisy = _LOGS.get((task["digest"], truth.key, seed), lambda: truth.noisy(seed))
    method = method_of(asked["name"], {**asked["settings"], **model.method}, truth.starts(seed, model))
    log = replace(model.experiment, recordings=noisy.recordings)
    start = time.perf_counter()
    fit = identify(log, method, verbose=False)
    seconds["fit"] = time.perf_counter() - start
    off = fit.beta - model.beta
    known = np.isfinite(off) & (fit.std > 0.0)
    sigmas = np.abs(off[known]) / fit.std[known]
    torque, joints = model.torque_errors(fit.parameters)
    return {
        "status": fit.status.name,
        "sentence": fit.conclusion,
        "beta": _plain(fit.beta),
        "std": _plain(fit.std),
        "factor": _number(fit.interval_factor(0.95)),
        "error_sigmas": _number(float(np.sqrt(np.mean(sigmas**2))) if known.any() else np.nan),
        "coverage": _number(float(np.mean(sigmas <= fit.interval_factor(0.95))) if known.any() else np.nan),
        "torque_error": _number(torque),
        "torque_errors": _plain(joints),
        "iterations": fit.n_iterations,
        "simulations": fit.n_simulations,
        "rows": fit.n_rows,
        "relative_error": _plain(fit.relative_error),
    }


def method_of(
    name: str, settings: Mapping[str, Any], start: Callable[[float], Array] | None = None
) -> Method:
    """Make a method.

    Parameters
    ----------
    name : str
        Name such as "didim".
    settings : mapping
        Plain data. ``start = { spread = 0.15 }`` is a random start within 15 % of the truth, a different one for each seed.
    start : callable, optional
        Function that draws a start with a spread.

    Raises
    ------
    StudyError
        For a setting that the method does not have.
    FitError
        For an unknown method, or a wrong value.
    """
    made = method_class(name)
    options = dict(settings)
    known = [option.name for option in fields(made) if option.init] if is_dataclass(made) else list(options)
    for key in options:
        if key in OBJECTS:
            raise StudyError(
                f'method {name!r}: {key} cannot be set in a study; keys of the experiment such as "signal.cutoff_hz" can'
            )
        if key not in known:
            raise StudyError(f"method {name!r} has no setting {key!r}{did_you_mean(key, known)}")
    wanted = options.get("start")
    if isinstance(wanted, Mapping) and set(wanted) == {"spread"}:
        spread = share("start.spread", wanted["spread"], StudyError)
        # Without a seed the settings are only checked.
        options["start"] = "unit" if start is None else start(spread)
    method: Method = made(**options)
    return method


def _number(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None


def _plain(values: Array) -> list[float | None]:
    return [_number(value) for value in values.tolist()]


def _line(row: dict[str, Any]) -> str:
    return json.dumps(row, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def _memory_mb() -> float | None:
    """Return the peak memory of this process (MB); None if unknown."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1e6 if platform.system() == "Darwin" else 1e3
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit, 1)
