"""What counts as dependent, as rounding or as too little turns where its documentation says.

The numbers stand here as they are documented, so that a bound which is doubled or halved is noticed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
import didim.regression.consistent.nearest as nearest
from arm import arm_log
from didim.evidence.hypotheses.geometry import lengths, with_geometry
from didim.evidence.hypotheses.hypothesis import Hypothesis
from didim.evidence.hypotheses.torques import gains
from didim.evidence.products import Part, Products
from didim.evidence.rows import samples_wanted
from didim.excitation.problem import BETWEEN, Problem
from didim.excitation.series import SeriesBasis
from didim.methods.cloe.consistent import ConsistentSteps
from didim.methods.cloe.levenberg_marquardt import identifies
from didim.methods.cloe.output_error import OutputError
from didim.methods.cloe.simplex import SimplexSearch
from didim.methods.didim.problem import EVERYTHING
from didim.methods.didim.slack import share_moved
from didim.methods.uncertainty import spread_of_factors
from didim.model.limbs import Directions
from didim.regression.classical.robust import reweighted
from didim.regression.consistent.prior import Prior
from didim.regression.consistent.problem import ConstrainedProblem
from didim.regression.covariance import Factors
from didim.regression.friction.alarm import Along, _freed, friction_alarm
from didim.regression.friction.velocity import settled
from didim.regression.least_squares import solve
from didim.regression.settings import LeastSquaresSettings
from didim.robot.friction import FrictionTerm
from didim.signal.processing import SignalProcessing
from didim.terms.rows import Block, LinearSystem
from didim.terms.share import independent
from didim.terms.unknown import Unknown, Unknowns
from plain import stub
from test_friction_terms import log, parameters, planar

Array = NDArray[np.float64]


@pytest.mark.parametrize(("left", "kept"), [(0.8e-8, False), (1.2e-8, True)])
def test_a_column_that_the_model_has_already(left: float, kept: bool) -> None:
    q = np.array([[1.0], [0.0]])
    assert bool(_freed(q, np.array([[1.0], [left]])).any()) == kept


@pytest.mark.parametrize(("ratio", "identified"), [(0.7e-14, False), (1.4e-14, True)])
def test_a_normal_matrix_that_is_singular(ratio: float, identified: bool) -> None:
    off = 1.0 - 2.0 * ratio
    assert identifies(np.array([[1.0, off], [off, 1.0]])) is identified


@pytest.mark.parametrize(("apart", "known"), [(0.8e-7, False), (1.2e-7, True)])
def test_directions_that_a_log_does_not_tell_apart(apart: float, known: bool) -> None:
    w = np.array([[1.0, 1.0], [0.0, apart]])
    fit = stub(weights=np.ones(2), residual=np.array([1.0, 1.0]), solution=np.zeros(1))
    problem = stub(torques_after=lambda x, changes: [np.zeros(2)], parts=[EVERYTHING])
    found = share_moved(problem, stub(system=stub(w=w), fit=fit, along=stub(x=None)), np.zeros(2))
    assert (found is not None) == known


def test_products_take_three_solutions_for_their_weights_and_stop_at_rounding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solved: list[int] = []
    plain = Part._solved

    def counted(self: Part, gram: Array, right: Array) -> Array:
        solved.append(1)
        return plain(self, gram, right)

    monkeypatch.setattr(Part, "_solved", counted)
    products = Products.of(np.ones((1, 40, 1)), np.ones((1, 40)))
    # The torque is the column itself: what is left is the least share of its square.
    assert products.seen()[0] == pytest.approx(1e-14 * 40.0, rel=1e-3, abs=0.0)
    assert len(solved) == 3
    assert products.predicted(np.ones(1))[0] == pytest.approx(1e-14 * 40.0, rel=1e-3, abs=0.0)
    # Two columns that are one share what they explain, the sum of both less the ridge.
    gram, right = np.full((2, 2), 1.0), np.ones(2)
    part = Part(products.g, products.h[0], products.y, np.ones(1))
    assert plain(part, gram, right).sum() == pytest.approx(1.0 - 1e-11, abs=2e-12)


@pytest.mark.parametrize(("log_gain", "told"), [(0.045, 0), (0.055, 1)])
def test_a_gain_of_five_per_cent(log_gain: float, told: int) -> None:
    """What is left is least at the gain, with errors of the model beside it."""

    class Seen:
        def seen(self, order: object, factors: Array) -> Array:
            return np.array(
                [np.exp(100.0 * ((np.log(factors[0]) - log_gain) ** 2 + np.log(factors[1]) ** 2))]
            )

    assert len(list(gains(stub(n=2, products=Seen())))) == told


def lengths_of(metres: float, ratio: Callable[[float], float]) -> list[Hypothesis]:
    """Return the hypotheses on the second length of a planar arm; `ratio` of its factor is what is left."""
    arm = with_geometry(didim.load_robot("planar2"), d=(0.0, metres))

    def ratios(item: Hypothesis) -> Array:
        assert item.robot is not None
        return np.array([ratio(item.robot.geometry.d[1] / metres)])

    return list(lengths(stub(robot=arm, rough_ratios=ratios)))


@pytest.mark.parametrize(("metres", "count"), [(4.8e-3, 0), (5.2e-3, 1)])
def test_a_length_that_a_log_shows(metres: float, count: int) -> None:
    """Five millimetres; it is tried turned."""
    assert len(lengths_of(metres, lambda factor: 1.0)) == count


@pytest.mark.parametrize(("left", "count"), [(0.985, 1), (0.975, 2)])
def test_a_length_is_refined_where_a_factor_helps(left: float, count: int) -> None:
    assert len(lengths_of(0.5, lambda factor: 1.0 if factor == 1.0 else left)) == count


def test_a_length_at_the_end_of_its_search_is_3_3_times_the_declared_one() -> None:
    *_, found = lengths_of(0.5, lambda factor: 1.0 + 0.2 * ((np.log(abs(factor)) - 1.5) ** 2 - 1.5**2))
    assert found.at_end
    assert found.value == pytest.approx(0.5 * 3.3)


def test_hypotheses_are_tried_on_6000_samples_or_300_rows() -> None:
    assert samples_wanted(SignalProcessing(decimation=(5,), edge_rows=0), []) == 6000
    assert samples_wanted(SignalProcessing(decimation=(5, 8), edge_rows=0), []) == 300 * 40


def test_a_series_has_twenty_samples_a_period_of_its_highest_harmonic() -> None:
    assert SeriesBasis(period_s=1.0, harmonics=4).samples == 80


@pytest.mark.parametrize(("use", "full"), [(0.97, 0.97), (0.98, 1.0)])
def test_a_limit_that_counts_as_met(use: float, full: float) -> None:
    problem = cast(Any, object.__new__(Problem))
    problem._use = lambda series, factor: np.array([use if factor == 1 else 0.99])
    series = stub(basis=None, scaled=np.ones((1, 1)), offset=None)
    assert Problem.exact(problem, series).scaled[0, 0] == pytest.approx(full / 0.99 * (1.0 - BETWEEN))
    assert pytest.approx(1.0 - np.cos(np.pi / 400.0)) == BETWEEN


def steps_among_robots(rows: list[Array]) -> ConsistentSteps:
    problem: Any = stub(
        scale=np.array([2.0]),
        begun_at=lambda start: problem,
        start=None,
        job=stub(estimated=lambda x: x),
    )

    def solve(root: Array, right: Array) -> Any:
        rows.append(root)
        return stub(x=np.zeros(1))

    constrained = stub(solve=solve)
    return ConsistentSteps(problem, cast(Any, constrained), np.zeros(1), stub(n_rows=101))


def test_a_random_robot_is_held_near_its_point_and_corrections_are_hardly_damped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows: list[Array] = []
    steps = steps_among_robots(rows)
    steps.begun_near(np.zeros(1))
    assert rows.pop().tolist() == [[50.0]]
    jacobian = cast(Any, np.ones((1, 101)))
    advance = steps.correction(jacobian, 100.0)
    dampings: list[Array] = []

    def robots(point: Array, errors: Array, jacobian: Array, damping: Array, cost: float) -> list[Array]:
        dampings.append(damping)
        return [point]

    monkeypatch.setattr(steps, "_robots", robots)
    advance(np.zeros(1), np.full(101, 0.1))
    assert dampings[0].tolist() == pytest.approx([1e-8 * 1e-4])


@pytest.mark.parametrize(
    ("promised", "fall", "met"),
    [(0.9e-4, 1.0, True), (1.1e-4, 1.0, False), (1.0, 0.9e-4, True), (1.0, 1.1e-4, False)],
)
def test_an_optimum_among_robots(promised: float, fall: float, met: bool) -> None:
    assert ConsistentSteps.met(cast(Any, None), promised, fall, accepted=True) is met


def test_derivatives_of_an_output_error_change_torques_by_a_ten_thousandth() -> None:
    asked: list[Array] = []

    class Errors:
        scale = np.array([2.0, 5.0])
        directions = Directions(np.arange(2), np.ones((2, 1), dtype=bool))

        def errors(self, points: Array) -> tuple[Array, Array]:
            asked.append(points)
            return np.zeros((2, 3)), np.ones(2, dtype=bool)

    OutputError.derivatives(cast(Any, Errors()), np.zeros(2), np.zeros(3))
    np.testing.assert_allclose(asked[0], np.diag([2e-4, 5e-4]))


def test_candidates_are_held_64_at_a_time() -> None:
    sizes: list[int] = []

    def some(points: Array) -> tuple[Array, Array]:
        sizes.append(len(points))
        return np.zeros((len(points), 1)), np.ones(len(points), dtype=bool)

    OutputError.errors(stub(_errors=some, n_simulations=0), np.zeros((130, 1)))
    assert sizes == [64, 64, 2]


class Held:
    """A problem whose draws have a deviation of one, and whose curvature and other priors are given."""

    def __init__(self, curvature: float, moved: float) -> None:
        self._curvature, self._moved, self._solved = curvature, moved, 0
        self.drawn: list[int] = []

    def __call__(self, model: object, prior: Any, gamma: float, bounds: object) -> Held:
        self.gamma = gamma
        return self

    def solve(self, root: Array, right: Array) -> Any:
        self._solved += 1
        # The first is the solution, then those of the priors of half and of twice the size.
        return stub(x=np.array([(0.0, -self._moved, self._moved)[self._solved - 1]]), half_distance=0.0)

    def solve_many(self, root: Array, rights: Array) -> list[Any]:
        self.drawn.append(len(rights))
        values = np.where(np.arange(len(rights)) % 2 == 0, 1.0, -1.0)
        values *= np.sqrt((len(rights) - 1) / len(rights))
        return [stub(x=np.array([value])) for value in values]

    def covariance(self, root: Array, x: Array) -> Array:
        return np.array([[self._curvature**2]])


@pytest.mark.parametrize(
    ("curvature", "moved", "identified"),
    [(1.19, 0.0, True), (1.21, 0.0, False), (1.0, 0.29, True), (1.0, 0.31, False)],
)
def test_a_parameter_from_the_prior(
    curvature: float, moved: float, identified: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = Held(curvature, moved)
    monkeypatch.setattr(nearest, "ConstrainedProblem", held)
    prior = Prior("given", (), np.ones(1))
    monkeypatch.setattr(nearest, "prior_of", lambda robot, choice: prior)
    robot = stub(base_parameters=stub(matrix=np.ones((1, 1))))
    model = stub(own=robot, unknowns=stub(estimated=[0]))
    found = nearest.nearest_robot(model, np.zeros(1), np.eye(1), nearest.Nearness())
    assert found.identified.tolist() == [identified]
    assert held.drawn == [200]
    assert held.gamma == 0.01


@pytest.mark.parametrize(("off", "count"), [(0.8e-8, 1), (1.2e-8, 2)])
def test_a_robust_estimate_that_rests(off: float, count: int) -> None:
    found = reweighted(np.ones((6, 1)), np.ones(6), [slice(0, 6)], np.array([1.0 + off]))
    assert found.converged
    assert found.iterations == count


def test_the_load_of_friction_is_settled_in_twelve_passes() -> None:
    robot = planar(FrictionTerm(law="load", joint=1))
    job = didim.IDIMLS().job(log(robot, parameters(robot)))
    size = iter(range(1, 100))

    def solved(system: LinearSystem) -> tuple[Array, Array]:
        return np.full(system.w.shape[1], float(next(size))), np.ones(len(system.y))

    assert settled(job.model, job.parts("fit"), job.signal, solved).passes == 12


@pytest.mark.parametrize(("variant", "share"), [("literal", 1.0), ("adaptive", 0.25)])
def test_a_simplex_of_a_ten_thousandth_has_collapsed(
    monkeypatch: pytest.MonkeyPatch, variant: str, share: float
) -> None:
    heard: dict[str, float] = {}

    def minimised(values: object, simplex: object, **limits: float) -> None:
        heard.update(limits)
        raise KeyboardInterrupt

    monkeypatch.setattr("didim.methods.cloe.simplex.minimise", minimised)
    search = stub(
        problem=stub(checkpoint=None), method=stub(variant=variant), literal=variant == "literal", initial=0.25,
        simplex=None, most_iterations=1, most_evaluations=1, stopped=True, history=[], unit=None, _report=None,
        _continued=lambda: stub(evaluations=0, iterations=0),
    )  # fmt: skip
    with pytest.raises(AttributeError):  # the record of the search, which is none
        SimplexSearch.run(search)
    assert heard["x_tolerance"] == 1e-4
    assert heard["f_tolerance"] == 1e-4 * share


@pytest.mark.parametrize(("blocks", "tested"), [(7, False), (8, True)])
def test_a_missing_law_is_looked_for_in_eight_blocks(
    monkeypatch: pytest.MonkeyPatch, blocks: int, tested: bool
) -> None:
    robot = planar()
    job = didim.IDIMLS().job(log(robot, parameters(robot), noise=0.1))
    parts = job.parts("fit")
    system = job.system(parts)
    module = "didim.regression.friction.alarm."
    monkeypatch.setattr(module + "_between_reversals", lambda *facts: [np.arange(3)] * blocks)
    monkeypatch.setattr(
        module + "joint_test", lambda columns, *facts: (0.25 * np.ones(columns.shape[1]), 0.0)
    )
    found = friction_alarm(
        system,
        solve(system, job.settings),
        Along(
            robot=robot,
            x=parameters(robot),
            parts=parts,
            signal=job.signal,
            load=[part.tau for part in parts],
        ),
    )
    assert found.p_value.tolist() == [0.5 if tested else 1.0] * 2


def test_rates_are_those_at_sixty_positions(monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[int] = []

    def counted(experiment: didim.Experiment, x: Array, q: Array) -> didim.Experiment:
        counts.append(len(q))
        return experiment

    monkeypatch.setattr("didim.methods.didim.consistent.with_gains", counted)
    didim.identify(arm_log(1), didim.DIDIM(max_iterations=1))
    assert 60 <= counts[0] <= 62


@pytest.mark.parametrize(("left", "kept"), [(0.8e-9, [0]), (1.2e-9, [0, 1])])
def test_a_further_column_that_depends_on_the_others(left: float, kept: list[int]) -> None:
    assert independent([np.array([1.0, 0.0]), np.array([1.0, left])]) == kept


def test_conditions_without_a_weight_have_the_least_one() -> None:
    one = np.ones((1, 1))
    condition = stub(weight=0.0, basis=one[None], indices=[0], constant=0.0 * one, at=lambda x: one)
    curvature = ConstrainedProblem.marginal(stub(conditions=(condition,)), np.ones(1))
    assert curvature.tolist() == [[3e-8]]


@pytest.mark.parametrize(("rows", "rough"), [(32, True), (36, False)])
def test_three_rows_a_parameter_without_a_block(rows: int, rough: bool) -> None:
    w = np.random.default_rng(0).standard_normal((rows, 11))
    found = spread_of_factors(
        Factors.of(w[:, :10], w[:, 10]), np.eye(10), "white", [Block(rows=slice(0, rows), joint=0)], LeastSquaresSettings(),
        Unknowns(tuple(Unknown(name=str(k), unit="") for k in range(10))), [f"p{number}" for number in range(10)],
    )  # fmt: skip
    assert any("the standard deviations are rough" in remark for remark in found.remarks) is rough
