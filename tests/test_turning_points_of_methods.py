"""Judgements of fits, methods and designs turn where their documentation says, and defaults are the documented ones.

The numbers stand here as they are documented, so that a threshold which is doubled or halved is noticed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
import didim.methods.builder as builder
import didim.regression.friction.alarm as flips
from didim.errors import ExcitationError, FitError
from didim.evidence.gain_check import unchecked
from didim.evidence.loop.simulated import (
    MotionComparison,
    _slope,
    motion_findings,
    slope_findings,
    worse_findings,
)
from didim.evidence.torques import following_findings
from didim.excitation.design import Excitation
from didim.excitation.limits import motion_limits
from didim.excitation.settings import ExcitationSettings
from didim.excitation.task import Task
from didim.methods.didim.convergence import Path, contraction_of
from didim.methods.didim.problem import Iterate, Solved
from didim.methods.didim.steps import SecantSteps
from didim.methods.idim_iv import _sentences
from didim.regression.consistent.diagnosis import diagnosis
from didim.regression.consistent.prior import generic_prior, prior_near
from didim.regression.covariance import Jackknife, autocorrelated, intervals
from didim.regression.delay import _shared
from didim.regression.friction.alarm import Along, FrictionAlarm, joint_test, laws_to_test
from didim.regression.friction.screen import Screen
from didim.regression.logs.body import _inside
from didim.regression.logs.load import Load
from didim.regression.settings import LeastSquaresSettings
from didim.result.iteration import Status
from didim.signal.processing import SignalProcessing
from didim.terms.rows import Block
from plain import stub

Array = NDArray[np.float64]


@pytest.mark.parametrize(
    ("plain", "constrained", "found"),
    [
        (0.10, 0.145, None),
        (0.10, 0.155, False),
        (0.45, 0.48, None),
        (0.45, 0.52, True),
    ],
)
def test_only_parameters_of_no_robot_explain_a_log(
    plain: float, constrained: float, found: bool | None
) -> None:
    """None: nothing found; True: the model explains hardly anything."""
    record = {
        "plain_relative_error": plain,
        "constrained_relative_error": constrained,
        "plain_relative_errors": [],
        "constrained_relative_errors": [],
    }
    told = diagnosis(stub(record=record))
    assert (told[0].hopeless if told else None) == found


def test_the_generic_prior_is_a_solid_of_three_kilograms() -> None:
    arm = didim.load_robot("planar2")
    length = sum(abs(d) for d in arm.geometry.d)
    prior = generic_prior(arm)
    for body in prior.bodies:
        np.testing.assert_allclose(np.diag(body), [3.0 * (0.08 * length) ** 2] * 3 + [3.0])
    slide = generic_prior(didim.load_robot("emps"))
    assert np.diag(slide.bodies[0])[0] == pytest.approx(3.0 * (0.08 * 0.1) ** 2)
    # A hundredth of the generic solid, scaled by the mass, is mixed into the bodies of a given robot.
    x = np.array([6.0 if name == "M1" else 0.0 for name in arm.parameter_names])
    mixed = prior_near(arm, x, "given").bodies[0]
    assert mixed[3, 3] == pytest.approx(6.0 + 0.01 * 2.0 * 3.0)


def test_a_starting_body_has_the_estimated_mass_or_50_g() -> None:
    columns = np.eye(10)
    for mass, wanted in ((2.0, 2.0), (0.01, 0.05)):
        estimate = np.zeros(10)
        estimate[9] = mass
        start = _inside(estimate, np.zeros(10), columns)
        assert start[9] == pytest.approx(wanted)
        # A sphere, with twice 60 mm squared about each axis.
        assert start[0] == pytest.approx(2.0 * wanted * 0.06**2)


@pytest.mark.parametrize(("correlation", "told"), [(0.095, []), (0.105, [0])])
def test_errors_that_count_as_correlated(correlation: float, told: list[int]) -> None:
    errors = np.zeros(400)
    errors[0::4], errors[1::4] = 1.0, 0.0
    # Neighbours multiply to the wanted share of the squares.
    errors[1::4] = (1.0 - np.sqrt(1.0 - 4.0 * correlation**2)) / (2.0 * correlation)
    share = float(errors[1:] @ errors[:-1]) / float(errors @ errors)
    assert share == pytest.approx(correlation, rel=1e-3)
    columns = np.ones((400, 1))
    blocks = [Block(rows=slice(0, 400), joint=0)]
    assert autocorrelated(columns, errors, blocks, np.array([[1.0 / 400.0]]))[1] == told


@pytest.mark.parametrize(("share", "block"), [(0.88, -1), (0.92, 0)])
def test_a_block_that_alone_determines_a_parameter(share: float, block: int) -> None:
    found = Jackknife(np.zeros((2, 1)), np.array([[share], [0.0]]), 0.0, np.zeros((2, 1)))
    assert found.decisive.tolist() == [block]


@pytest.mark.parametrize(("rows", "count"), [(60, 20), (48, 16), (12, 5)])
def test_intervals_have_three_rows_and_there_are_five(rows: int, count: int) -> None:
    assert len(intervals([Block(rows=slice(0, rows), joint=0)])) == count


def test_a_contraction_is_an_upper_estimate() -> None:
    # Steps in ratios of 0.5: what is left is 1.5 times the geometric series.
    found = contraction_of([np.array([4.0]), np.array([2.0]), np.array([1.0])])
    assert found.remaining_largest == pytest.approx(1.5)
    # Ratios that rise from 0.5 to 0.7 to 0.9: expected is a rise to 1.1, and taken 0.95.
    found = contraction_of([np.array([1.0]), np.array([0.5]), np.array([0.35]), np.array([0.315])])
    assert found.remaining_largest == pytest.approx(1.5 * 0.95 / 0.05 * 0.315)


def test_a_contraction_looks_at_eight_steps() -> None:
    path = Path()
    for k in range(12):
        path.add(np.array([0.5**k]), full=True)
    assert len(path.steps) == 8


def test_a_secant_step_is_not_shorter_than_three_tenths() -> None:
    damped = object.__new__(SecantSteps)
    damped._before, damped._length = np.array([1.0]), 1.0
    for ahead, length in ((-9.0, 0.3), (-1.5, 0.4), (0.5, 1.0)):
        assert damped._secant(np.array([ahead]), np.eye(1)) == pytest.approx(length)


def secant(cost: Callable[[Array], float]) -> SecantSteps:
    """Steps of one parameter, of one standard deviation each, at whose end the simulation has a cost."""
    return SecantSteps(
        stub(
            job=stub(estimated=lambda step: step),
            changes_in_sigma=lambda solved: np.ones(1),
            method=stub(sigma_fraction=0.1),
            windows=[stub(tau=np.ones(1))],
            choose_steps=lambda x: None,
            shares=lambda lengths: float(lengths[0]),
            simulate=lambda x, *more: stub(x=x, errors=np.array([cost(x)])),
            reporter=None,
        )
    )


def step_of(steps: SecantSteps, x: float, target: float, iteration: int, error: float = 1.0) -> Any:
    """Take the step from a place to its solution, both of one parameter; the error is that at the place."""
    run = stub(errors=np.array([error]), scale=None)
    along = Iterate(np.array([x]), run, iteration)
    fit = stub(covariance=np.eye(1), weights=np.ones(1))
    system = stub(joints=[slice(0, 1)])
    return steps.step(Solved(along, system, fit, np.array([target]), np.ones(1)))


def test_the_third_step_of_a_two_cycle_is_halved() -> None:
    """Each full step lands where the one before began: the secant step goes to the middle, from the third on."""
    steps = secant(lambda x: 1.0)
    cycle = [(0.0, 1.0), (1.0, 0.0), (0.0, 1.0)]
    assert [step_of(steps, x, target, k).length for k, (x, target) in enumerate(cycle)] == [1.0, 1.0, 0.5]


@pytest.mark.parametrize(("rise", "length"), [(1.015, 1.0), (1.025, 0.5)])
def test_a_secant_step_may_raise_the_cost_by_two_percent(rise: float, length: float) -> None:
    """The cost is 1 at the iterate and after half of the step, and `rise` after all of it."""
    step = step_of(secant(lambda x: rise if x[0] == 1.0 else 1.0), 0.0, 1.0, 0)
    assert step.length == length
    assert step.after.x == pytest.approx([length])


@pytest.mark.parametrize(("strength", "weak"), [(0.48, False), (0.52, True)])
def test_a_weak_instrument(strength: float, weak: bool) -> None:
    found = stub(strength=np.array([strength]), test=None, durbin_watson=np.array([np.nan]))
    assert any("a weak instrument" in text for text in _sentences(found, ("ZZ1",))) == weak


@pytest.mark.parametrize(
    ("own", "std", "common", "joints"),
    [
        # In three standard deviations of zero there is no delay.
        ((0.58, 0.58), 0.28, 0.0, (0.0, 0.0)),
        ((0.62, 0.62), 0.28, 0.62, (0.62, 0.62)),
        # A joint is apart beyond a tenth of a sample, however sure it is.
        ((1.0, 1.0, 1.095), 1e-3, None, 1),
        ((1.0, 1.0, 1.105), 1e-3, 1.0, 2),
    ],
)
def test_delays_that_joints_share(own: Any, std: float, common: float | None, joints: Any) -> None:
    found, each = _shared(np.array(own), std**2 * np.eye(len(own)))
    if isinstance(joints, int):
        assert len(set(each)) == joints
    else:
        assert each == pytest.approx(joints)
    if common is not None:
        assert found[0] == pytest.approx(common)


@pytest.mark.parametrize(("distance", "kinds"), [(2.9, 1), (3.1, 2)])
def test_a_joint_of_another_delay(distance: float, kinds: int) -> None:
    own = np.array([10.0, 10.0, 10.0 + distance * np.sqrt(1.5)])
    assert len(set(_shared(own, np.eye(3))[1])) == kinds


@pytest.mark.parametrize(("p_value", "raised"), [(0.0095, True), (0.0105, False)])
def test_a_missing_friction_law_is_an_alarm(p_value: float, raised: bool) -> None:
    found = FrictionAlarm(
        p_value=np.array([p_value]), law="", tested=(), shift=np.zeros(0), visible={"stribeck": np.zeros(1)}
    )
    assert found.raised == raised


def flipped(scores: Array) -> float:
    """Probability of the largest score of one joint's columns, (n_blocks, k)."""
    return 0.75 * float(flips._flipped(scores, np.zeros(scores.shape[1], dtype=bool)).min())


def test_scores_are_flipped_4000_times_and_memory_has_a_quarter_of_the_false_alarms() -> None:
    assert flipped(np.ones((20, 1))) == pytest.approx(1.0 / 4000.0)
    rho, column = np.ones(40), np.ones((40, 1))
    blocks = [[np.arange(2 * k, 2 * k + 2) for k in range(20)]]
    for memory, share in ((False, 0.75), (True, 0.25)):
        (probability,), (units,) = joint_test(column, rho, blocks, np.array([memory]))
        assert probability == pytest.approx(1.0 / 4000.0 / share)
        # Six deviations of the score, of 20 blocks with the score 2, over the square of the column.
        assert units == pytest.approx(6.0 * np.sqrt(20.0 * 2.0**2) / 40.0)


def test_scores_of_thousands_of_blocks_are_summed_to_five_hundred() -> None:
    """The random signs of a long log would take gigabytes."""
    rng = np.random.default_rng(0)
    probabilities = [
        flipped(rng.normal(size=(blocks, 3))) for blocks in (499, 500, 501, 20_001) for _ in range(5)
    ]
    assert min(probabilities) > 0.01
    assert max(probabilities) > 0.5
    assert flipped(rng.normal(size=(20_001, 3)) + 0.05) == pytest.approx(1.0 / 4000.0)


@pytest.mark.parametrize(
    ("robot", "step", "tested"),
    [
        ("planar2", 0.003 / 21.0, True),
        ("planar2", 0.003 / 19.0, False),
        ("emps", 0.0003 / 21.0, True),
        ("emps", 0.0003 / 19.0, False),
    ],
)
def test_memory_is_tested_with_twenty_steps_of_the_encoder(robot: str, step: float, tested: bool) -> None:
    """The steps count within the smallest width, 3 mrad; a slide has a tenth of it."""
    arm = didim.load_robot(robot)
    n = arm.n_dof
    motion = np.sin(np.arange(100.0)[:, None] * 0.1) * np.ones(n)
    part = stub(q=motion, dq=motion, ddq=motion, place="here")
    along = Along(
        robot=arm,
        x=np.zeros(len(arm.parameter_names)),
        parts=[part],
        signal=SignalProcessing(edge_rows=0),
        load=[motion],
        encoder_step=np.full(n, step),
    )
    found = laws_to_test(along)
    assert any(item.family == "dahl" for item in found) == tested


def test_terms_are_judged_on_ten_blocks_with_gaps_of_five_rows() -> None:
    """The products of a column of ones count rows."""
    system = stub(
        w=np.ones((100, 1)), y=np.ones(100), joints=[slice(0, 100)], counts=np.array([100]), names=("Off1",)
    )
    screen = stub(pool=[], n=1, sigma=np.ones(1))
    Screen._multiply(screen, system)
    assert [int(held[0][0, 0] * 100.0 + 0.5) for held in screen.held] == [10] * 10
    assert [int(kept[0, 0] * 100.0 + 0.5) for kept in screen.kept] == [85, *[80] * 8, 85]


def beside(**facts: float) -> MotionComparison:
    known = {"position": 0.0, "slope": 1.0, "sigma": 0.0, "error": 1.0, "torque": 1.0}
    return MotionComparison(**{key: np.array([facts.get(key, value)]) for key, value in known.items()})


@pytest.mark.parametrize(
    ("missed", "grade"), [(0.0048, None), (0.0052, "doubtful"), (0.095, "doubtful"), (0.105, "wrong")]
)
def test_a_simulated_motion(missed: float, grade: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("didim.evidence.loop.simulated.declared_loop", lambda experiment: True)
    found = motion_findings(cast(Any, None), beside(position=missed))
    assert [item.grade for item in found] == ([] if grade is None else [grade])


@pytest.mark.parametrize(
    ("off", "sigma", "told"), [(0.0048, 0.0, 0), (0.0052, 0.0, 1), (0.058, 0.01, 0), (0.062, 0.01, 1)]
)
def test_a_slope_of_the_torques(off: float, sigma: float, told: int) -> None:
    assert len(slope_findings(beside(slope=1.0 + off, sigma=sigma))) == told


@pytest.mark.parametrize(
    ("error", "torque", "told"), [(1.45, 1.0, 0), (1.55, 1.0, 1), (2.0, 340.0, 0), (2.0, 330.0, 1)]
)
def test_idim_ls_explains_a_log_better(error: float, torque: float, told: int) -> None:
    assert len(worse_findings(beside(error=error, torque=torque), np.ones(1))) == told


def test_the_deviation_of_a_slope_is_over_twenty_intervals() -> None:
    x = np.random.default_rng(0).standard_normal((400, 1))
    y = x + 0.1 * np.random.default_rng(1).standard_normal((400, 1))
    slope, sigma = _slope(x, y)
    a, b = x[:, 0] - x.mean(), y[:, 0] - y.mean()
    scores = (a * (b - slope[0] * a)).reshape(20, 20).sum(axis=1)
    assert sigma[0] == pytest.approx(np.sqrt(20 / 19 * np.sum(scores**2)) / np.sum(a**2))


@pytest.mark.parametrize(("error", "told"), [(0.97, 0), (1.03, 1)])
def test_a_simulated_robot_that_does_not_follow(error: float, told: int) -> None:
    assert len(following_findings(error)) == told


@pytest.mark.parametrize(("sigma", "told"), [(0.29, 0), (0.31, 1)])
def test_a_gain_that_a_log_does_not_check(sigma: float, told: int, monkeypatch: pytest.MonkeyPatch) -> None:
    checked = (np.array([sigma, 0.01]), np.array([0.1, 0.9]))
    monkeypatch.setattr("didim.evidence.gain_check.gain_information", lambda rows: checked)
    assert len(unchecked(stub(n=2))) == told


@pytest.mark.parametrize(("condition", "status"), [(0.9e10, Status.SOLVED), (1.1e10, Status.ILL_CONDITIONED)])
def test_a_condition_number_that_is_too_large(condition: float, status: Status) -> None:
    fit = stub(stopped=False, converged=True, condition_number=condition)
    assert builder.solved_status(fit) is status


@pytest.mark.parametrize(("mass", "grade"), [(2.9, "note"), (3.1, "doubtful")])
def test_a_load_that_another_log_does_not_carry(mass: float, grade: str) -> None:
    assert builder.load_finding(Load(mass, 1.0, explained=0.5), "is heavier").grade == grade


def test_settings_of_least_squares_have_bounds() -> None:
    assert LeastSquaresSettings(blocks=1000, reweightings=1000).blocks == 1000
    assert LeastSquaresSettings().blocks == 20
    for wrong in ({"blocks": 1001}, {"reweightings": 1001}):
        with pytest.raises(FitError, match="1000"):
            LeastSquaresSettings(**wrong)  # type: ignore[arg-type]


def test_settings_of_a_design_have_bounds() -> None:
    assert ExcitationSettings(harmonics=200, smoothing=100.0).harmonics == 200
    assert ExcitationSettings(harmonics=4).harmonics == 4
    for wrong in ({"harmonics": 201}, {"harmonics": 3}, {"smoothing": 101.0}):
        with pytest.raises(ExcitationError):
            ExcitationSettings(**wrong)


def test_defaults_of_a_design_are_a_hundredth_of_the_torque_and_a_quarter_of_a_second() -> None:
    arm = didim.load_robot("planar2")
    task = Task(arm, ExcitationSettings(torque=(50.0, 20.0), margin=1.0))
    assert task.sigma.tolist() == pytest.approx([0.5, 0.2])
    limits = motion_limits(arm, ExcitationSettings(velocity=(2.0, 3.0), margin=1.0))
    assert limits.acceleration.tolist() == pytest.approx([8.0, 12.0])


@pytest.mark.parametrize(
    ("correlation", "std", "words"),
    [
        # Weak from 10 %; alone, beside others together, or with another from a correlation of 0.9 on.
        (0.0, 9.8, ""),
        (0.0, 10.2, "small beside the noise"),
        (0.88, 10.2, "small beside the noise"),
        (0.952, 10.2, "hardly separates it from"),
        (0.94, 10.2, "small beside the noise"),
    ],
)
def test_a_weak_parameter(correlation: float, std: float, words: str) -> None:
    """Its deviation grows by ``1 / sqrt(1 - r^2)`` beside the other one: 2.93 for 0.94, 3.27 for 0.952."""
    covariance = np.array([[1.0, correlation], [correlation, 1.0]])
    design = stub(
        relative_std_percent=np.array([std, 1.0]),
        std=np.ones(2),
        information=np.linalg.inv(covariance),
        names=("ZZ1", "MX1"),
    )
    found = " ".join(Excitation.weak(design))
    assert words in found
    assert bool(found) == bool(words)


@pytest.mark.parametrize(
    ("correlation", "words"), [(0.89, "other parameters together"), (0.91, "hardly separates it")]
)
def test_parameters_that_are_told_apart_by_a_correlation_of_nine_tenths(
    correlation: float, words: str
) -> None:
    """Three: the first is correlated with both others."""
    r = correlation
    s = np.sqrt(0.97 - r**2)
    covariance = np.array([[1.0, r, s], [r, 1.0, 0.0], [s, 0.0, 1.0]])
    design = stub(
        relative_std_percent=np.array([50.0, 1.0, 1.0]),
        std=np.ones(3),
        information=np.linalg.inv(covariance),
        names=("ZZ1", "MX1", "MY1"),
    )
    assert words in " ".join(Excitation.weak(design))
