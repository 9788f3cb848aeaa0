"""Bounds and judgements of the regression turn where their documentation says.

The numbers stand here as they are documented, so that one which is doubled or halved is noticed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
import didim.regression.consistent.nearest as nearest
import didim.regression.friction.alarm as alarm
import didim.regression.friction.velocity as velocity
from didim.regression.classical.instrumental import instrumented
from didim.regression.classical.robust import reweighted
from didim.regression.consistent.prior import Prior, generic_prior
from didim.regression.consistent.solver import Consistent, _inflation
from didim.regression.delay import _Search
from didim.regression.friction.candidates import _offers
from didim.regression.friction.choice import _Search as _LawSearch
from didim.regression.friction.screen import Screen, State, Worth
from didim.regression.gains.maximum_likelihood import expected_sentence
from didim.regression.least_squares import dependence_sentence, joint_sigma, solve
from didim.regression.logs.body import nearest_bodies
from didim.regression.logs.drift import differences
from didim.regression.logs.load import _load
from didim.robot.friction import FrictionTerm, Law
from didim.terms.rows import Block, LinearSystem, stacked
from plain import stub
from test_friction_terms import log, parameters, planar
from test_turning_points_of_fits import Held

Array = NDArray[np.float64]


@pytest.mark.parametrize(("apart", "known"), [(0.8e-9, False), (1.2e-9, True)])
def test_instruments_that_depend_on_each_other(apart: float, known: bool) -> None:
    z = np.array([[1.0, 1.0], [0.0, apart]])
    assert (instrumented(np.eye(2), z, np.ones(2), np.ones(2)) is not None) is known


def test_dependent_columns_of_a_screen_have_a_ridge() -> None:
    """What rounding leaves in their difference is at most 1e12 times as large."""
    product = np.ones((3, 3))
    product[0, 2] += 1e-9
    (first, second), _ = Screen._solved(stub(size=np.ones(3)), product, [0, 1], None)
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
    model = stub(own=robot, unknowns=stub(estimated=[0]))
    found = nearest.nearest_robot(model, np.zeros(1), np.eye(1), nearest.Nearness(), freedom)
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
    """The minimum is where ``(m - m0) / s^2 + 0.01 (1 / 1 - 1 / m)`` is zero: the golden ratio for s = 10."""
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
    part = stub(q=np.cumsum(dq, axis=0), dq=dq, temperature=None)
    terms, _ = _offers(planar(dead_zone=0.05), 0, [part], one, one, [np.ones((2000, 2))], np.inf)
    assert any(term.law == "rest" for term, _ in terms) is offered


@pytest.mark.parametrize(("zone", "slowest"), [(0.024, 0.05), (0.026, 0.12)])
def test_a_law_has_a_velocity_of_two_dead_zones(zone: float, slowest: float) -> None:
    one = [np.ones((20, 1))]
    part = stub(q=np.ones((20, 2)), dq=np.ones((20, 2)), temperature=None)
    terms, _ = _offers(planar(dead_zone=zone), 0, [part], one, one, [np.ones((20, 2))], np.inf)
    assert min(term.velocity for term, _ in terms if term.law == "stribeck") == slowest
    assert min(term.velocity for term, _ in terms if term.law == "atan") >= 2.0 * zone


def test_a_gain_that_the_known_load_hardly_shows() -> None:
    assert expected_sentence(np.array([3.0, 19.5])).endswith("3, 20 %")
    assert expected_sentence(np.array([3.0, 20.5])).endswith("3, 20 %; the known load hardly reaches joint 2")


def test_a_residual_counts_as_a_billionth_of_the_torque_at_least() -> None:
    y = np.repeat([3.0, 0.0, 4.0], 10)
    system = LinearSystem(w=np.ones((30, 1)), y=y, names=("a",), blocks=stacked(3, [10]))
    # A joint without torque: of the largest.
    assert joint_sigma(system, np.zeros(30)) == pytest.approx([3e-9, 4e-9, 4e-9], rel=1e-6, abs=0.0)


def load_of(length: float) -> Any:
    """Return a clear load; in the space of the columns, two of moments and that of mass, the mass has this length."""
    rng = np.random.default_rng(0)
    ones, waves = np.linalg.qr(rng.standard_normal((400, 2)))[0].T
    s = np.sqrt((1.0 - length**2) / (2.0 * length**2))
    columns = np.zeros((400, 10))
    columns[:, 6], columns[:, 7] = (np.sqrt(1.0 - s**2) * ones + side * s * waves for side in (1.0, -1.0))
    columns[:, 9] = waves
    residual = 3.0 * waves + 1e-3 * rng.standard_normal(400)
    system: Any = stub(blocks=[Block(rows=slice(0, 400), joint=0)])
    return _load(system, columns, np.zeros((400, 0)), residual, np.arange(400), 20, "tool")


def test_a_robust_deviation_is_a_billionth_of_the_torque_at_least() -> None:
    found = reweighted(np.ones((6, 1)), np.full(6, 2.0), [slice(0, 6)], np.array([2.0]))
    assert found.scale == pytest.approx([2e-9], rel=1e-3, abs=0.0)


@pytest.mark.parametrize(("length", "known"), [(0.9875, False), (0.9925, True)])
def test_a_mass_that_a_log_shows(length: float, known: bool) -> None:
    assert (load_of(length).mass_or_none is not None) is known


@pytest.mark.parametrize(("probability", "found"), [(0.8e-4, True), (1.2e-4, False)])
def test_a_load_is_a_false_alarm_in_one_of_ten_thousand(
    probability: float, found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scipy.special.fdtrc", lambda rank, freedom, statistic: probability)
    assert (load_of(0.995) is not None) is found


def test_signs_of_twenty_stretches_of_time_are_flipped(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = planar()
    job = didim.IDIMLS().job(log(robot, parameters(robot), noise=0.1))
    parts = job.parts("fit")
    system = job.system(parts)
    counts: list[int] = []

    def tested(columns: Array, rho: object, blocks: Any, *rest: object) -> tuple[Array, Array]:
        counts.append(len(blocks[0]))
        return np.ones(columns.shape[1]), np.zeros(columns.shape[1])

    monkeypatch.setattr(alarm, "joint_test", tested)
    alarm.friction_alarm(
        system,
        solve(system, job.settings),
        alarm.Along(
            robot=robot,
            x=parameters(robot),
            parts=parts,
            signal=job.signal,
            load=[part.tau for part in parts],
        ),
    )
    assert counts == [20, 20]


def test_a_prior_weighs_six_times_as_much_beside_correlated_errors() -> None:
    slow = np.cos(np.arange(400) * np.pi / 400.0)
    blocks = (Block(rows=slice(0, 400), joint=0),)
    w = np.cos(np.arange(400) * 2.0 * np.pi / 400.0)[:, None]
    assert _inflation(LinearSystem(w=w, y=slow, names=("a",), blocks=blocks)) == 6.0


def supports(gain: Array, rows: float = 1000.0) -> bool:
    screen = stub(counts=np.full((10, 1), rows / 10.0))
    screen.needed = cast(Any, Screen.needed).fget(screen)
    return Screen.supported(screen, gain)


@pytest.mark.parametrize(("deviations", "told"), [(2.2, False), (2.32, True)])
def test_a_gain_of_a_law_that_is_clear_of_noise(deviations: float, told: bool) -> None:
    pattern = np.array([-1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 0.0, 0.0, 1.0, -1.0])
    assert supports(10.0 * (pattern / pattern.std(ddof=1) + deviations / np.sqrt(10.0))) is told


@pytest.mark.parametrize(
    ("nats", "rows", "told"), [(2.9, 1e3, False), (3.1, 1e3, True), (19.0, 2e4, False), (21.0, 2e4, True)]
)
def test_a_gain_of_a_law_that_is_worth_a_parameter(nats: float, rows: float, told: bool) -> None:
    assert supports(np.linspace(0.9, 1.1, 10) * nats / 10.0, rows) is told


@pytest.mark.parametrize(("last", "told"), [(-4.1, False), (-3.9, True)])
def test_a_law_gains_in_each_third_of_a_log(last: float, told: bool) -> None:
    assert supports(np.array([2.0, 2.1, 1.9, 2.0, 2.0, 2.1, 1.9, 2.0, 2.0, last])) is told


@pytest.mark.parametrize(
    ("law", "share", "shift", "told"),
    [
        ("atan", 0.5, 0.029, True),
        ("atan", 0.5, 0.031, False),
        ("hold", 0.0, 0.5, True),
        ("spring", 0.095, 0.0, False),
        ("spring", 0.105, 0.5, True),
    ],
)
def test_a_law_that_the_log_tells_from_links(law: Law, share: float, shift: float, told: bool) -> None:
    """A spring takes a tenth of the error; a sign that is kept has no parameter."""
    worth = Worth(nats=10.0, significance=5.0, share=share, shift=shift, supported=True)
    assert Screen.told(stub(), worth, FrictionTerm(law=law, joint=0)) is told


def test_the_choice_ends_after_eight_rounds() -> None:
    """Here each round adds a law."""
    rounds: list[int] = []

    def pick(state: State, joint: int) -> tuple[float, object]:
        rounds.append(joint)
        return 1.0, None

    def added(state: State, change: object) -> State:
        return State((*state.columns, len(state.columns)))

    search = stub(screen=stub(model=stub(own=stub(n_dof=1))), _pick=pick, _added=added)
    assert len(_LawSearch.chosen(search, State()).columns) == len(rounds) == 8


def test_a_prior_weighs_a_hundredth_of_a_nat_beside_a_log(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("didim.regression.consistent.solver._inflation", lambda system: 2.0)
    robot = planar()
    job = didim.IDIMLS().job(log(robot, parameters(robot)))
    problem = Consistent().for_model(job.model).on(job.system(job.parts("fit")))
    assert problem.gamma == pytest.approx(2.0 * 0.01)


def test_a_generic_solid_has_a_hundred_grams_at_least() -> None:
    robot = planar()
    job = didim.IDIMLS().job(log(robot, parameters(robot)))
    system = job.system(job.parts("fit"))
    prior = generic_prior(robot, replace(system, y=0.0 * system.y), job.model.unknowns)
    assert prior.bodies[0][3, 3] == pytest.approx(0.1)


def refined(column: Array, torques: Array) -> tuple[Array, Array]:
    """Return the delay of one joint and its covariance; its column is given, and its torques, whatever their shift."""
    blocks = (Block(rows=slice(0, 60), joint=0),)
    system = LinearSystem(w=np.ones((60, 1)), y=np.ones(60), names=("a",), blocks=blocks)
    search = stub(
        system=system, w=system.w, weights=np.ones(60), solution=np.ones(1), margin=5,
        basis=system.w / np.sqrt(60.0), triangle=np.ones((1, 1)), size=np.array([np.sqrt(60.0)]),
        _derivative=lambda solution, torque: column[:, None], _torques=lambda shift: torques,
    )  # fmt: skip
    return _Search.refine(search, 0.0, cast(Any, None))


@pytest.mark.parametrize(("step", "shift"), [(0.0048, 0.0048), (0.0052, 10 * 0.0052)])
def test_a_delay_is_linearised_ten_times(step: float, shift: float) -> None:
    """All steps have the same size; one below five thousandths of a sample is the last."""
    column = np.cos(np.arange(60.0))
    assert refined(column, 1.0 + step * column)[0][0] == pytest.approx(shift)


@pytest.mark.parametrize(("share", "known"), [(0.8e-9, False), (1.2e-9, True)])
def test_a_torque_that_changes_shows_a_delay(share: float, known: bool) -> None:
    """By more than a billionth of itself."""
    column = np.cos(np.arange(60.0))
    size = share * np.sqrt(60.0) / np.linalg.norm(column)
    assert bool(np.isfinite(refined(size * column, np.ones(60))[1]).all()) is known


@pytest.mark.parametrize(("coefficient", "words"), [(0.8e-6, "MX1 = 0"), (1.2e-6, "MX1 = 1.2e-06 ZZ1")])
def test_coefficients_of_a_dependence_that_are_shown(coefficient: float, words: str) -> None:
    assert f"of W: {words})" in dependence_sentence(("ZZ1", "MX1"), [(1, [(0, coefficient)])])


@pytest.mark.parametrize(("share", "told"), [(0.048, False), (0.052, True)])
def test_an_offset_that_differs_between_recordings(share: float, told: bool) -> None:
    """The limit is a twentieth of the residual; errors of alternating signs make the difference certain."""
    rng = np.random.default_rng(0)
    blocks = tuple(Block(rows=slice(400 * k, 400 * k + 400), joint=0, recording=k) for k in range(2))
    w = np.tile([1.0, 1.0, -1.0, -1.0], 200)[:, None]
    residual = np.tile([1.0, -1.0], 400) + 1e-3 * rng.standard_normal(800)
    residual[400:] += share
    system = LinearSystem(w=w, y=residual, names=("a",), blocks=blocks)
    (found,) = differences(system, cast(Any, stub(weights=np.ones(800), residual=residual)), "offset")
    assert found.clear is told


def searched(
    monkeypatch: pytest.MonkeyPatch, columns: Callable[..., Array]
) -> Callable[[bool], list[LinearSystem]]:
    """Return the search for the velocity of a law with given columns; it returns the systems that it solves."""
    monkeypatch.setattr(velocity, "_columns", columns)
    robot = planar(FrictionTerm(law="atan", joint=0, velocity=0.3, estimated=True))
    w, y = np.eye(9)[:, :2], np.array([1.0, 1.0, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    system = LinearSystem(w=w, y=y, names=("Fv1", "Fa1"), blocks=(Block(rows=slice(0, 9), joint=0),))
    solved: list[LinearSystem] = []

    def solution(system: LinearSystem) -> tuple[Array, Array]:
        solved.append(system)
        return np.zeros(2), np.ones(9)

    def search(on_grid: bool) -> list[LinearSystem]:
        along = velocity._Along(robot, [], cast(Any, None), system)
        velocity._estimate_velocities(along, solution, on_grid)
        return solved

    return search


def test_velocities_are_searched_twice_on_a_grid_of_41(monkeypatch: pytest.MonkeyPatch) -> None:
    grids: list[int] = []

    def columns(robot: object, term: object, velocities: Array, *more: object) -> Array:
        grids.append(velocities.size)
        return np.zeros((9, velocities.size))  # of no use, so that there is nothing to refine

    assert len(searched(monkeypatch, columns)(True)) == 2
    assert grids == [41, 41]


@pytest.mark.parametrize(("gain", "identified"), [(3.9, False), (4.1, True)])
def test_a_velocity_needs_a_law_of_two_standard_deviations(
    gain: float, identified: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gain of four, the square of two."""
    found: list[bool] = []
    monkeypatch.setattr(velocity, "_gains", lambda *given: gain * np.eye(41)[20])

    def inner(robot: object, start: Array, inner: Array, *more: object) -> tuple[Array, Array]:
        found.append(bool(inner[0]))
        return start, np.ones(1)

    monkeypatch.setattr(velocity, "_refined", inner)
    searched(monkeypatch, lambda robot, term, velocities, *more: np.zeros((9, velocities.size)))(True)
    assert found == [identified]


@pytest.mark.parametrize(("factor", "kept"), [(3.9, True), (4.1, False)])
def test_a_velocity_is_refined_by_a_factor_of_four(
    factor: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refined(robot: object, start: Array, *more: object) -> tuple[Array, Array]:
        return factor * start, np.ones(1)

    monkeypatch.setattr(velocity, "_refined", refined)
    robot = planar(FrictionTerm(law="atan", joint=0, velocity=0.3, estimated=True))
    blocks = (Block(rows=slice(0, 9), joint=0),)
    system = LinearSystem(w=np.ones((9, 1)), y=np.ones(9), names=("Fa1",), blocks=blocks)
    along = velocity._Along(robot, [], cast(Any, None), system)
    found, _ = velocity._estimate_velocities(along, lambda system: (np.zeros(1), np.ones(9)), False)
    assert found.friction.terms[0].velocity == pytest.approx(0.3 * factor if kept else 0.3)


@pytest.mark.parametrize(("change", "passes"), [(0.8e-6, 2), (1.2e-6, 3)])
def test_a_load_that_rests(change: float, passes: int) -> None:
    robot = planar(FrictionTerm(law="load", joint=1))
    job = didim.IDIMLS().job(log(robot, parameters(robot)))
    sizes = iter([1.0, 1.0, *[1.0 + change] * 9])

    def solved(system: LinearSystem) -> tuple[Array, Array]:
        return np.full(system.w.shape[1], next(sizes)), np.ones(len(system.y))

    assert velocity.settled(job.model, job.parts("fit"), job.signal, solved).passes == passes
