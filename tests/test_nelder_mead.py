"""The simplex in batches: iterates of SciPy's sequential algorithm, guesses, and searches that go on where they were left."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from didim.methods.cloe import lookahead, nelder_mead

Array = NDArray[np.float64]


def valley(points: Array) -> Array:
    """Rosenbrock's function, forbidden where the first coordinate is above 1.3."""
    x, y = points[:, :-1], points[:, 1:]
    values = np.sum(100.0 * (y - x**2) ** 2 + (1.0 - x) ** 2, axis=1)
    return np.where(points[:, 0] > 1.3, np.inf, values)


def ripples(points: Array) -> Array:
    """A bowl with so many ripples that the simplex often finds nothing better, and shrinks."""
    return np.asarray(np.sum(points**2 + 0.5 * np.sin(200.0 * points), axis=1))


@pytest.mark.parametrize("adaptive", [False, True])
@pytest.mark.parametrize("n", [2, 5, 12])
@pytest.mark.parametrize("function", [valley, ripples])
def test_the_iterates_are_those_of_scipy(function: Callable[[Array], Array], n: int, adaptive: bool) -> None:
    start = np.linspace(-1.2, 1.1, n)
    start[n // 2] = 0.0
    path: list[Array] = []
    # SciPy ends in the middle of an iteration when evaluations run out; iterations end both alike.
    options: Any = {"adaptive": adaptive, "xatol": 1e-4, "fatol": 1e-4, "maxiter": 500, "maxfev": 10**6}
    scipys_minimize: Any = minimize
    expected = scipys_minimize(
        lambda x: float(function(x[None])[0]),
        start,
        method="Nelder-Mead",
        callback=lambda x: path.append(x.copy()),
        options=options,
    )
    found: list[Array] = []

    def told(simplex: nelder_mead.Simplex) -> bool:
        found.append(simplex.points[0].copy())
        return False

    simplex, converged = nelder_mead.minimise(
        function,
        nelder_mead.started(function, nelder_mead.literal_simplex(start)),
        adaptive=adaptive,
        max_iterations=500,
        max_evaluations=10**6,
        progress=told,
    )
    assert converged == expected.success
    assert simplex.evaluations == expected.nfev
    assert simplex.iterations == expected.nit
    # The sum of two vertices is the same in any order; of more of them SciPy adds the better ones first.
    tolerance = 0.0 if n == 2 else 1e-9
    np.testing.assert_allclose(simplex.points[0], expected.x, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(simplex.values[0], expected.fun, rtol=tolerance, atol=tolerance)
    for ours, scipys in zip(found, path, strict=False):
        np.testing.assert_allclose(ours, scipys, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("function", [valley, ripples])
def test_guesses_change_no_bit(function: Callable[[Array], Array], monkeypatch: pytest.MonkeyPatch) -> None:
    start = nelder_mead.started(function, nelder_mead.literal_simplex(np.linspace(-1.2, 1.1, 6)))
    sizes: list[int] = []

    def batch(points: Array) -> Array:
        sizes.append(len(points))
        return function(points)

    ahead, _ = nelder_mead.minimise(batch, start, max_iterations=200, max_evaluations=10**6)
    batches, made = len(sizes), sum(sizes)
    assert ahead.simulations == start.simulations + made
    monkeypatch.setattr(lookahead, "TOGETHER", 1)
    alone, _ = nelder_mead.minimise(batch, start, max_iterations=200, max_evaluations=10**6)
    np.testing.assert_array_equal(ahead.points, alone.points)
    np.testing.assert_array_equal(ahead.values, alone.values)
    assert ahead.evaluations == alone.evaluations
    assert batches < 0.6 * (len(sizes) - batches)


def test_a_collapsed_simplex_has_no_further_guesses() -> None:
    ahead = lookahead.Lookahead(valley, (1.0, 2.0, 0.5, -0.5))
    point, value = ahead.trial(np.ones((3, 2)), lookahead.REFLECTION)
    assert (point.tolist(), value, ahead.made) == ([1.0, 1.0], 0.0, 1)


def test_a_search_goes_on_where_it_was_left() -> None:
    start = nelder_mead.started(
        valley, nelder_mead.edged_simplex(np.array([-1.2, 1.0]), np.array([0.1, 0.2]))
    )
    whole, _ = nelder_mead.minimise(valley, start, max_iterations=80, max_evaluations=10_000)
    half, converged = nelder_mead.minimise(valley, start, max_iterations=40, max_evaluations=10_000)
    assert not converged
    again, _ = nelder_mead.minimise(valley, half, max_iterations=80, max_evaluations=10_000)
    np.testing.assert_array_equal(again.points, whole.points)
    assert again.evaluations == whole.evaluations
    stopped, _ = nelder_mead.minimise(
        valley, start, max_iterations=80, max_evaluations=10_000, progress=lambda simplex: True
    )
    assert stopped.iterations == start.iterations + 1
