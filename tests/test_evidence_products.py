"""The engine of hypotheses beside plain least squares, and the rougher look beside the columns of a fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.evidence.hypotheses.geometry import lengths, twists, with_geometry
from didim.evidence.hypotheses.hypothesis import Hypothesis
from didim.evidence.products import BLOCKS, REWEIGHTINGS, Products
from didim.evidence.rows import ROWS, LogRows
from didim.evidence.screen import Screen
from didim.robot.robot import Robot
from didim.terms.model import Model
from verdict_arms import ARMS, built

Array = NDArray[np.float64]


def rows_of(experiment: didim.Experiment) -> LogRows:
    job = didim.IDIMLS().job(experiment)
    return LogRows(job.robot, job.signal, job.parts("fit", job.declared_delay))


@pytest.fixture(scope="module")
def experiment() -> didim.Experiment:
    return built(ARMS["arm7"], None).noisy(3, 0.01)


@pytest.fixture(scope="module")
def rows(experiment: didim.Experiment) -> LogRows:
    return rows_of(experiment)


def turned(robot: Robot) -> Robot:
    """A robot whose file has another twist, and another gravity."""
    alpha = list(robot.geometry.alpha)
    alpha[2] = -alpha[2]
    return with_geometry(robot, alpha=tuple(alpha), gravity=(0.0, 9.81, 0.0))


@pytest.mark.parametrize(("order", "factors"), [((0, 1, 2), (1.0, 1.0, 1.0)), ((1, 0, 2), (1.0, -1.0, 2.5))])
def test_errors_are_those_of_least_squares_on_blocks_left_out(
    order: tuple[int, ...], factors: tuple[float, ...]
) -> None:
    rng = np.random.default_rng(4)
    n, length, p = 3, 103, 5
    w, y = rng.standard_normal((n, length, p)), rng.standard_normal((n, length)) * [[1.0], [3.0], [0.2]]
    own = np.stack([factors[c] * w[order[c]] for c in range(n)])

    def solved(kept: NDArray[np.intp], weights: Array) -> Array:
        root = np.sqrt(weights)[:, None]
        columns = (own[:, kept] * root[:, :, None]).reshape(-1, p)
        return np.asarray(np.linalg.lstsq(columns, (y[:, kept] * root).reshape(-1), rcond=None)[0])

    everything = np.arange(length)
    weights = 1.0 / np.sum(y**2, axis=1)
    for _ in range(REWEIGHTINGS):
        squares = np.sum((y - own @ solved(everything, weights)) ** 2, axis=1)
        weights = 1.0 / squares
    products = Products.of(w, y)
    judged = products.judged(order, np.array(factors))
    np.testing.assert_allclose(products.seen(order, np.array(factors)), squares, rtol=1e-8)
    np.testing.assert_allclose(judged.beta, solved(everything, weights), rtol=1e-7)
    for block, left_out in enumerate(np.array_split(everything, BLOCKS)):
        beta = solved(np.setdiff1d(everything, left_out), weights)
        wanted = np.sum((y[:, left_out] - own[:, left_out] @ beta) ** 2, axis=1)
        np.testing.assert_allclose(judged.unseen[:, block], wanted, rtol=1e-7)
    other = np.sum((y - own @ np.ones(p)) ** 2, axis=1)
    np.testing.assert_allclose(products.predicted(np.ones(p), order, np.array(factors)), other, rtol=1e-9)


def test_no_fit_leaves_less_of_a_channel_than_one_joint_alone() -> None:
    """Two parts of two joints each, which share columns 1 to 3 and 4 to 6; the other columns of their rows are empty."""
    rng = np.random.default_rng(5)
    w, y = np.zeros((4, 90, 6)), rng.standard_normal((4, 90))
    w[:2, :, :3], w[2:, :, 3:] = rng.standard_normal((2, 2, 90, 3))
    products = Products.of(w, y)
    single = np.array([np.sum((y.T - c @ np.linalg.lstsq(c, y.T, rcond=None)[0]) ** 2, axis=0) for c in w])
    np.testing.assert_allclose(products.alone, single, rtol=1e-9)
    for order in ((0, 1, 2, 3), (1, 0, 2, 3), (2, 1, 0, 3), (0, 3, 2, 1)):
        assert np.all(products.seen(order) >= single[list(order), range(4)] * (1.0 - 1e-9))
    known = replace(products, given=np.ones(6), _solutions={})
    np.testing.assert_allclose(known.alone, np.sum((y - w.sum(axis=2)[:, None]) ** 2, axis=2), rtol=1e-9)


def test_d_of_one_halved_error_is_that_of_a_quarter() -> None:
    rng = np.random.default_rng(1)
    w, noise = rng.standard_normal((2, 400, 2)), rng.standard_normal((2, 400))
    half = noise * [[0.5], [1.0]]
    one, other = (Products.of(w, w @ np.ones(2) + error).judged() for error in (half, noise))
    assert one.against(other) == pytest.approx(np.log(0.25), abs=0.02)


def test_rows_are_those_of_a_fit(rows: LogRows) -> None:
    system = Model(rows.robot).rows(rows.parts, rows.signal)
    y = system.y.reshape(rows.n, -1)
    thin = max(1, y.shape[1] // ROWS)
    assert 200 < rows.y.shape[1] < 2 * ROWS
    np.testing.assert_array_equal(rows.y, y[:, ::thin])
    np.testing.assert_array_equal(rows.w, system.w.reshape(rows.n, -1, system.w.shape[1])[:, ::thin])


def test_the_rougher_look_at_the_declared_robot_is_exact(rows: LogRows) -> None:
    assert rows.rough(Hypothesis(code="x", robot=rows.robot)) == pytest.approx(0.0, abs=1e-6)


def test_the_rougher_look_at_other_robots_and_positions(rows: LogRows) -> None:
    """It ranks: what is hopeless by far, and what is near."""
    g = rows.robot.geometry
    longer = with_geometry(rows.robot, d=tuple(1.3 * value for value in g.d))
    found = rows.exact(Hypothesis(code="x", robot=longer))
    assert found is not None
    exact = Products.of(found.w, rows.y).judged().against(rows.declared)
    assert rows.rough(Hypothesis(code="x", robot=longer)) == pytest.approx(exact, rel=0.5)
    assert rows.rough(Hypothesis(code="x", robot=turned(rows.robot))) > 4.0
    assert rows.rough(Hypothesis(code="x", position=np.diag([1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0]))) > 4.0


@pytest.mark.parametrize("family", [twists, lengths])
def test_the_rougher_look_needs_the_declared_base_columns_alone(
    rows: LogRows, family: Callable[[LogRows], Iterator[Hypothesis]]
) -> None:
    """The other columns of a robot with another twist or length depend on them as well, up to the decimation."""
    screen = rows.screened.screen
    every = range(screen.exact.shape[2])
    motion = [values.T for values in screen.motion]
    whole = replace(rows.screened, screen=Screen(rows.robot, motion, screen.exact, every), _latest={})
    for item in [*family(rows)][:4]:
        few, all_of_them = np.log(rows.screened.ratios(item)), np.log(whole.ratios(item))
        np.testing.assert_allclose(few, all_of_them, atol=0.3, rtol=0.02)


def test_the_right_robot_for_a_wrong_file(experiment: didim.Experiment) -> None:
    wrong = rows_of(replace(experiment, robot=turned(experiment.robot)))
    found = wrong.exact(Hypothesis(code="x", robot=experiment.robot))
    assert found is not None
    right = rows_of(experiment)
    np.testing.assert_array_equal(found.w, right.w)
    assert Products.of(found.w, wrong.y).judged().against(wrong.declared) < -10.0


def test_a_consistent_fit_cannot_swallow_a_wrong_sign(rows: LogRows) -> None:
    right = rows.consistent(rows.robot, rows.w, rows.y)
    assert right is not None
    np.testing.assert_allclose(np.sum(right**2, axis=1), rows.products.seen(), rtol=0.2)
    signs = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0])
    wrong = rows.consistent(rows.robot, rows.w, rows.y * signs[:, None])
    assert wrong is not None
    assert np.sum(wrong[6] ** 2) > 100.0 * np.sum(right[6] ** 2)


def test_few_rows_are_refused(experiment: didim.Experiment) -> None:
    (recording,) = experiment.recordings
    short = replace(experiment, recordings=(replace(recording, windows=((0, 260),)),))
    with pytest.raises(didim.DidimError):
        rows_of(short)
