"""SciPy: least squares of the size of a TX40's observation matrix, and the sequential simplex of Nelder and Mead.

Ours also gives R^-1, which the covariance wants, and the singular values, which SciPy's `gelsd` gives too and `gelsy` does not.
Both simplex searches minimise the same cost by our simulation from the same first simplex and make the same iterates: ours
evaluates the trial points of an iteration together.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.linalg import lstsq
from scipy.optimize import minimize

from didim import _core
from didim.methods.cloe import nelder_mead

from .task import Task
from .timing import Contestant, seconds

Array = NDArray[np.float64]

COLUMNS = 60
SIZES = (2_700, 270_000)
"""Rows of 9 s of the TX40 log: decimated by 100, and as logged."""
ITERATIONS = 100
"""Upper bound of the iterations of the simplex."""
DRIVERS: tuple[Literal["gelsd", "gelsy"], ...] = ("gelsd", "gelsy")
"""SciPy's default (singular values) and its QR."""


def versions() -> dict[str, str]:
    """SciPy's version."""
    return {"scipy": scipy.__version__}


def contestants(task: Task, rounds: int, *, quick: bool) -> list[Contestant]:
    """Least squares and simplex, after checks that both find the same."""
    found = []
    for rows in SIZES[:1] if quick else SIZES:
        found += _least_squares(task, rows, rounds if rows < 10_000 else min(rounds, 3))
    return found + _simplex(task, min(rounds, 5), 10 if quick else ITERATIONS)


def _least_squares(task: Task, rows: int, rounds: int) -> list[Contestant]:
    rng = np.random.default_rng(rows)
    w = rng.standard_normal((rows, COLUMNS))
    y = w @ rng.uniform(0.5, 1.5, COLUMNS) + rng.standard_normal(rows)
    task.check(
        "SciPy", "the least squares", lstsq(w, y)[0], np.asarray(_core.least_squares(w, y).solution), 1e-9
    )
    runs: dict[str, Callable[[], object]] = {"least squares": lambda: _core.least_squares(w, y)}
    for driver in DRIVERS:
        runs[f"SciPy lstsq ({driver})"] = partial(lstsq, w, y, lapack_driver=driver, check_finite=False)
    return [
        Contestant(name=f"{name}, {rows} x {COLUMNS}", measure=seconds(run), unit="s", rounds=rounds)
        for name, run in runs.items()
    ]


def _simplex(task: Task, rounds: int, iterations: int) -> list[Contestant]:
    base, loop = task.robot.base_parameters, task.loop
    lift = np.array([base.lift(unit) for unit in np.eye(len(base.names))])
    truth = base.project(task.x)
    (q, _, _, tau), _ = loop.run((truth @ lift)[None], threads=1)
    one, small = np.ones(6), np.zeros(6)

    def batch(points: Array) -> Array:
        found, _ = loop.costs(points @ lift, q[0], tau[0], weight_q=small, weight_tau=one, threads=1)
        return found

    start = nelder_mead.literal_simplex(1.1 * truth)
    limits: dict[str, Any] = {"max_iterations": iterations, "max_evaluations": 10**9}

    def ours() -> Array:
        simplex, _ = nelder_mead.minimise(
            batch,
            nelder_mead.started(batch, start),
            adaptive=True,
            x_tolerance=0.0,
            f_tolerance=0.0,
            **limits,
        )
        return np.asarray(simplex.points[0])

    options: dict[str, Any] = {
        "initial_simplex": start,
        "adaptive": True,
        "xatol": 0.0,
        "fatol": 0.0,
        "maxiter": iterations,
        "maxfev": 10**9,
    }
    sequential: Any = minimize

    def scipys() -> Array:
        result = sequential(
            lambda x: float(batch(x[None])[0]), start[0], method="Nelder-Mead", options=options
        )
        return np.asarray(result.x)

    task.check("SciPy", "the iterates of the simplex", scipys(), ours(), 1e-12)
    words = f"simplex, {iterations} iterations in {start.shape[1]} dimensions"
    return [
        Contestant(name=f"batched {words}", measure=seconds(ours), unit="s", rounds=rounds),
        Contestant(name=f"SciPy's {words}", measure=seconds(scipys), unit="s", rounds=rounds),
    ]
