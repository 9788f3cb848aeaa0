r"""Corrections of CLOE's optimum for time steps finer than those of its search.

    beta <- beta - (G^T G)^-1 G^T e_f(beta)                                                       (A)

``e_f`` are the weighted output errors of a simulation with divided steps, and ``G`` the derivatives of the search, which are
accurate enough: the optimum satisfies ``G^T e_f = 0``. Time steps that suffice for the simulation may be too coarse for the
estimate, because the integration error repeats with the motion and does not average out like encoder noise. With halved steps,
fourth-order Runge-Kutta has a sixteenth of this error. Tested in ``tests/test_cloe.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from ..._tools.arrays import Array
from .output_error import OutputError

STEP_PARTS = 2
"""Number of parts that each step of the search is divided into."""
SHORTEST_CORRECTION = 0.01
"""Length of a correction, in standard deviations of the estimate, below which the optimum is reached."""
MOST_CORRECTIONS = 5
"""Upper bound of the corrections (A): two are usual, and each takes one simulation with divided steps."""


def corrected(
    problem: OutputError,
    candidate: Array,
    normal: Array,
    advance: Callable[[Array, Array], Array],
    point_of: Callable[[Array], Array],
) -> tuple[OutputError, Array, Array, float] | None:
    """Iterate the correction (A) from the optimum of the search.

    Parameters
    ----------
    problem : OutputError
        The problem with the steps of the search.
    candidate : array
        The optimum of the search: a point, or standard parameters.
    normal : (n, n) array
        ``G^T G``, the weighted normal matrix at the optimum.
    advance : callable
        Function that corrects a candidate with the errors of divided steps.
    point_of : callable
        Function that returns the estimated base parameters of a candidate, (n,).

    Returns
    -------
    problem, candidate, errors, shift : OutputError, array, (n_rows,) array and float, or None
        The problem with divided steps, the last candidate, its weighted errors, and the length of the correction in standard
        deviations for white noise, an upper bound of that of each parameter. None if a run with divided steps does not complete.
    """
    finer = problem.divided(STEP_PARTS)
    begun = point = point_of(candidate)
    every, completed = finer.errors(point[None])
    if not completed[0]:
        return None
    errors = every[0]
    rows = max(1, errors.size - point.size)
    for _ in range(MOST_CORRECTIONS):
        trial = advance(candidate, errors)
        there = point_of(trial)
        if _length(there - point, normal, errors, rows) <= SHORTEST_CORRECTION:
            break
        every, completed = finer.errors(there[None])
        if not completed[0] or not every[0] @ every[0] < errors @ errors:
            break
        candidate, point, errors = trial, there, every[0]
    return finer, candidate, errors, _length(point - begun, normal, errors, rows)


def _length(step: Array, normal: Array, errors: Array, rows: int) -> float:
    """Return the length of a step in standard deviations, an upper bound for every parameter."""
    variance = float(errors @ errors) / rows
    return math.sqrt(max(0.0, float(step @ normal @ step)) / variance) if variance > 0.0 else 0.0
