"""Nelder and Mead's simplex with trial points evaluated in batches.

The iterates are those of SciPy's sequential algorithm, but for the rounding of the centre (``tests/test_nelder_mead.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array
from .lookahead import EXPANSION, INSIDE, OUTSIDE, REFLECTION, Lookahead


@dataclass(frozen=True)
class Simplex:
    """State of a simplex search, sufficient to resume it.

    Attributes
    ----------
    points : (n + 1, n) array
        Vertices, best first.
    values : (n + 1,) array
        Their values.
    iterations, evaluations, simulations : int
        Numbers of iterations, of evaluations in the sequential algorithm, and of those actually made.
    """

    points: Array
    values: Array
    iterations: int
    evaluations: int
    simulations: int


def literal_simplex(x: Array) -> Array:
    """Return the first simplex of ``fminsearch`` and SciPy: +5 % per coordinate, 0.00025 where it is zero; (n + 1, n)."""
    return _simplex(x, np.where(x != 0.0, 1.05 * x, 0.00025))


def edged_simplex(x: Array, edges: Array) -> Array:
    """Return a first simplex with edges of given lengths along the coordinates; (n + 1, n)."""
    return _simplex(x, x + edges)


def _simplex(x: Array, moved: Array) -> Array:
    """Return a point and, for each of its coordinates, one in which that is moved, (n + 1, n)."""
    points = np.tile(x, (x.size + 1, 1))
    np.fill_diagonal(points[1:], moved)
    return points


def started(batch: Callable[[Array], Array], points: Array) -> Simplex:
    """Evaluate a first simplex, and sort its best vertex first."""
    values = batch(points)
    order = np.argsort(values)
    return Simplex(points[order], values[order], 1, len(points), len(points))


def minimise(
    batch: Callable[[Array], Array],
    simplex: Simplex,
    *,
    adaptive: bool = False,
    x_tolerance: float = 1e-4,
    f_tolerance: float = 1e-4,
    max_iterations: int,
    max_evaluations: int,
    progress: Callable[[Simplex], bool] | None = None,
) -> tuple[Simplex, bool]:
    """Continue the search from a simplex.

    Parameters
    ----------
    batch : callable
        Function that returns values of (m, n) points, (m,); infinite for inadmissible points.
    simplex : Simplex
        From `started`, or the end of an earlier search.
    adaptive : bool
        Whether to use the coefficients of Gao and Han (2012), which depend on the dimension, instead of 1, 2, 1/2, 1/2.
    x_tolerance, f_tolerance : float
        Largest distances of all vertices, and of their values, from the best one at which the search ends.
    max_iterations, max_evaluations : int
        Upper bounds, including earlier searches that led to the simplex.
    progress : callable, optional
        Callback with the simplex after every iteration; True stops.

    Returns
    -------
    Simplex, bool
        Final simplex, and whether the tolerances are met.
    """
    n = simplex.points.shape[1]
    chi, psi, sigma = (1.0 + 2.0 / n, 0.75 - 1.0 / (2.0 * n), 1.0 - 1.0 / n) if adaptive else (2.0, 0.5, 0.5)
    ahead = Lookahead(batch, (1.0, chi, psi, -psi))
    points, values = simplex.points.copy(), simplex.values.copy()
    iterations, evaluations, made = simplex.iterations, simplex.evaluations, simplex.simulations
    while evaluations < max_evaluations and iterations < max_iterations:
        with np.errstate(invalid="ignore"):
            spread = np.max(np.abs(values[0] - values[1:]))
        if np.max(np.abs(points[1:] - points[0])) <= x_tolerance and spread <= f_tolerance:
            return Simplex(points, values, iterations, evaluations, made + ahead.made), True
        point, value = ahead.trial(points, REFLECTION)
        evaluations += 1
        shrink = False
        if not values[0] <= value < values[-2]:
            move = EXPANSION if value < values[0] else OUTSIDE if value < values[-1] else INSIDE
            bound = values[-1] if move == INSIDE else value
            other, value_there = ahead.trial(points, move)
            evaluations += 1
            if value_there < bound or (move == OUTSIDE and value_there == bound):
                point, value = other, value_there
            else:
                shrink = move != EXPANSION
        if shrink:
            points[1:] = points[0] + sigma * (points[1:] - points[0])
            values[1:] = batch(points[1:])
            evaluations += n
            made += n
        else:
            points[-1], values[-1] = point, value
        iterations += 1
        order = np.argsort(values)
        points, values = points[order], values[order]
        if progress is not None and progress(
            Simplex(points, values, iterations, evaluations, made + ahead.made)
        ):
            break
    return Simplex(points, values, iterations, evaluations, made + ahead.made), False
