"""Bounds and judgements of the regression turn where their documentation says.

The numbers stand here as they are documented, so that one which is doubled or halved is noticed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim.regression.consistent.nearest as nearest
from didim.regression.block import Block, stacked
from didim.regression.classical.instrumental import instrumented
from didim.regression.consistent.prior import Prior
from didim.regression.friction.candidates import _offers
from didim.regression.friction.screen import _Fold, _solved
from didim.regression.gains.maximum_likelihood import expected_sentence
from didim.regression.linear_system import LinearSystem
from didim.regression.logs.body import nearest_bodies
from didim.regression.logs.load import _load
from didim.regression.weights import joint_sigma
from plain import stub
from test_friction_terms import planar
from test_turning_points_of_fits import Held

Array = NDArray[np.float64]


@pytest.mark.parametrize(("apart", "known"), [(0.8e-9, False), (1.2e-9, True)])
def test_instruments_that_depend_on_each_other(apart: float, known: bool) -> None:
    z = np.array([[1.0, 1.0], [0.0, apart]])
    assert (instrumented(np.eye(2), z, np.ones(2), np.ones(2)) is not None) is known


def test_dependent_columns_of_a_screen_have_a_ridge() -> None:
    """What rounding leaves in their difference is at most 1e12 times as large."""
    fold = _Fold(held=np.zeros((3, 3)), fitted=np.ones((3, 3)))
    first, second = _solved(fold, [0, 1], np.array([1.0 + 1e-9, 1.0]))
    assert first - second == pytest.approx(1e-9 / 1e-12, rel=0.01)
    assert first + second == pytest.approx(1.0)


@pytest.mark.parametrize("freedom", [1.0, 2.0, 3.0])
def test_deviations_of_few_degrees_of_freedom_are_those_of_three(
    freedom: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Draws of Student's distribution have a variance of ``f / (f - 2)``, which the deviation leaves out."""
    monkeypatch.setattr(nearest, "ConstrainedProblem", Held(1.0, 0.0))
    monkeypatch.setattr(nearest, "prior_of", lambda robot, choice: Prior("given", (), np.ones(1)))
    robot = stub(base_parameters=stub(matrix=np.ones((1, 1))))
    found = nearest.nearest_robot(
        robot, stub(estimated=[0]), np.zeros(1), np.eye(1), nearest.Nearness(), freedom
    )
    assert found.std[0] == pytest.approx(np.sqrt(1.0 / 3.0))


def masses(estimates: list[float], std: float) -> Array:
    """Masses of the bodies nearest to estimated ones of this deviation."""
    known = np.zeros(10)
    known[[0, 3, 5]] = 0.01
    mass = np.eye(10)[:, 9:]
    return nearest_bodies(np.array(estimates)[:, None], np.array([[std**2]]), known, mass)[:, 9]


@pytest.mark.parametrize(("nats", "moved"), [(0.8e-10, False), (1.2e-10, True)])
def test_bodies_that_rest(nats: float, moved: bool) -> None:
    """The decrement of Newton's first step is the square of the distance in standard deviations."""
    off = 1e-3 * np.sqrt(nats)
    found = masses([2.0 - off, 2.0 + off], 1e-3)
    assert bool(found[1] - found[0] > off) is moved


def test_the_prior_of_a_body_weighs_a_hundredth_of_a_nat() -> None:
    """Of deviation s: ``(m - m0) / s^2 + 0.01 (1 / 1 - 1 / m)`` is zero, for s = 10 at the golden ratio."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    assert masses([0.0, 2.0], 10.0) == pytest.approx([golden - 1.0, golden])


def test_a_body_that_does_not_settle_takes_200_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    solve, steps = np.linalg.solve, []

    def short(a: Array, b: Array) -> Array:
        steps.append(1)
        return 1e-4 * np.asarray(solve(a, b))

    monkeypatch.setattr("numpy.linalg.solve", short)
    masses([1.9, 2.1], 0.1)
    assert len(steps) == 200


@pytest.mark.parametrize(("samples", "offered"), [(19, False), (21, True)])
def test_standstill_of_a_hundredth_of_a_log(samples: int, offered: bool) -> None:
    dq = np.ones((2000, 2))
    dq[:samples] = 0.0
    one = [np.ones((2000, 1))]
    part = stub(q=np.cumsum(dq, axis=0), dq=dq)
    terms, _ = _offers(planar(dead_zone=0.05), 0, [part], one, one, [np.ones((2000, 2))], np.inf)
    assert any(term.law == "rest" for term, _ in terms) is offered


def test_a_gain_that_the_known_load_hardly_shows() -> None:
    assert expected_sentence(np.array([3.0, 19.5])).endswith("3, 20 %")
    assert expected_sentence(np.array([3.0, 20.5])).endswith("3, 20 %; the known load hardly reaches joint 2")


def test_a_residual_counts_as_a_billionth_of_the_torque_at_least() -> None:
    y = np.repeat([3.0, 0.0, 4.0], 10)
    system = LinearSystem(w=np.ones((30, 1)), y=y, names=("a",), blocks=stacked(3, [10]))
    # A joint without torque: of the largest.
    assert joint_sigma(system, np.zeros(30)) == pytest.approx([3e-9, 4e-9, 4e-9], rel=1e-6, abs=0.0)


@pytest.mark.parametrize(("length", "known"), [(0.9875, False), (0.9925, True)])
def test_a_mass_that_a_log_shows(length: float, known: bool) -> None:
    """The length of its direction in the space that the columns of mass and of two moments, a little apart, leave."""
    rng = np.random.default_rng(0)
    ones, waves = np.linalg.qr(rng.standard_normal((400, 2)))[0].T
    s = np.sqrt((1.0 - length**2) / (2.0 * length**2))
    columns = np.zeros((400, 10))
    columns[:, 6], columns[:, 7] = (np.sqrt(1.0 - s**2) * ones + side * s * waves for side in (1.0, -1.0))
    columns[:, 9] = waves
    residual = 3.0 * waves + 1e-3 * rng.standard_normal(400)
    system: Any = stub(blocks=[Block(rows=slice(0, 400), joint=0)])
    found = _load(system, columns, np.zeros((400, 0)), residual, np.arange(400), 20)
    assert found is not None
    assert (found.mass_or_none is not None) is known
