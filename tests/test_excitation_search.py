"""The search for the best series: a descent that can be paused, perturbations, and fine grids by Fourier transforms."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

import didim
from didim._tools.arrays import Array
from didim.excitation import search as starts
from didim.excitation.problem import FINE, Problem
from didim.excitation.search import Descent, Search
from didim.excitation.series import ScaledSeries, Series, SeriesBasis, _norm
from didim.excitation.settings import ExcitationSettings
from didim.excitation.task import Task


def quadratic(x: Array) -> tuple[float, Array]:
    """Condition number 1e4, the least value 3 at 1."""
    curvature = np.logspace(0.0, 4.0, len(x))
    away = x - 1.0
    return 3.0 + 0.5 * float(curvature @ away**2), curvature * away


def test_a_descent_finds_the_minimum() -> None:
    descent = Descent(quadratic, np.zeros(30))
    descent.run(1000)
    assert descent.converged
    assert descent.value == pytest.approx(3.0, abs=1e-6)
    np.testing.assert_allclose(descent.x, 1.0, atol=1e-2)


def test_a_paused_descent_goes_on_where_it_was() -> None:
    ways: list[list[Array]] = []
    for pieces in ([60], [7, 20, 33]):
        way: list[Array] = []

        def seen(x: Array, way: list[Array] = way) -> tuple[float, Array]:
            way.append(x)
            return quadratic(x)

        descent = Descent(seen, np.zeros(12))
        for piece in pieces:
            descent.run(piece)
        ways.append(way)
    count = min(map(len, ways))
    assert count > 50
    np.testing.assert_array_equal(ways[0][:count], ways[1][:count])


def test_a_descent_turns_back_where_there_is_no_value() -> None:
    """A logarithm whose argument a full step makes negative."""

    def barrier(x: Array) -> tuple[float, Array]:
        with np.errstate(invalid="ignore"):
            return float((50.0 * x - np.log(x)).sum()), 50.0 - 1.0 / x

    descent = Descent(barrier, np.array([1.0, 0.5]))
    descent.run(200)
    np.testing.assert_allclose(descent.x, 0.02, rtol=1e-3)


def test_a_descent_without_a_slope_has_converged() -> None:
    descent = Descent(lambda x: (1.0, np.zeros_like(x)), np.ones(3))
    descent.run(10)
    assert descent.converged


@pytest.mark.parametrize("power", [2, 8, 64, 256])
def test_the_norm_is_that_of_its_power(power: int) -> None:
    values = np.abs(np.random.default_rng(0).normal(size=(40, 3)))
    norm, slope = _norm(values, power)
    np.testing.assert_allclose(norm, np.linalg.norm(values, ord=power, axis=0), rtol=1e-12)
    np.testing.assert_allclose((slope * values).sum(axis=0), norm, rtol=1e-12)


def test_a_fine_grid_has_the_values_of_the_series() -> None:
    basis = SeriesBasis(period_s=4.0, harmonics=5)
    rng = np.random.default_rng(1)
    series = Series(basis=basis, scaled=rng.normal(size=(basis.free.shape[1], 3)), offset=rng.normal(size=3))
    tables = basis.derivatives(FINE * basis.samples)
    for order, (found, table) in enumerate(zip(series.motion(FINE), tables, strict=True)):
        expected = table @ series.scaled + (series.offset if order == 0 else 0.0)
        np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def tx40(**more: Any) -> tuple[Task, ScaledSeries, Problem]:
    """The TX40 with few harmonics, within the limits of the packaged experiment."""
    settings = ExcitationSettings(
        harmonics=6,
        duration_s=5.0,
        start=[0.0] * 6,
        position=[(-reach, reach) for reach in (2.6, 1.8, 2.0, 3.5, 1.9, 4.0)],
        acceleration=[25, 25, 35, 60, 60, 90],
        torque_noise=[0.5, 0.5, 0.2, 0.1, 0.1, 0.1],
        **more,
    )
    task = Task(didim.load_robot("tx40"), settings)
    basis = SeriesBasis(period_s=settings.duration_s, harmonics=settings.harmonics)
    series = ScaledSeries(basis, task.limits, task.start, False)
    return task, series, task.problem(series)


def test_a_perturbation_changes_each_shape_by_its_share() -> None:
    _, series, _ = tx40()
    rng = np.random.default_rng(2)
    v = rng.normal(size=series.size)
    other = series.perturbed(v, 0.2, rng)
    shape, change = (values.reshape(series.free, 6) for values in (v, other - v))
    np.testing.assert_allclose(
        np.linalg.norm(change, axis=0), 0.2 * np.linalg.norm(shape, axis=0), rtol=1e-12
    )
    free = ScaledSeries(series.basis, series.limits, None, True)
    v = rng.normal(size=free.size)
    np.testing.assert_array_equal(free.perturbed(v, 0.2, rng)[-12:], v[-12:])


@pytest.mark.slow
def test_perturbations_raise_the_criterion(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many evaluations without perturbations end lower, from any start."""
    found: dict[str, list[float]] = {}
    for name, share, first in (("hops", 3.0, 0.24), ("descent", 0.0, 3.24)):
        monkeypatch.setattr(starts, "HOPS", share)
        monkeypatch.setattr(starts, "FIRST", first)
        found[name] = []
        for seed in (1, 2):
            _, series, problem = tx40()
            v = np.random.default_rng(seed).normal(size=series.size)
            best = Search(problem, 200, seed, threading.Event()).run([v])
            found[name].append(-problem.value(best, 1.0)[0])
    assert min(found["hops"]) > max(found["descent"])
