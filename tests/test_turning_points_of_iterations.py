"""Iterations end, and say so, where their documentation says.

The numbers stand here as they are documented, so that a threshold which is doubled or halved is noticed.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import didim.methods.cloe.finer_steps as finer_steps
from didim.errors import ExcitationError, FitError
from didim.evidence.loop.law import Recovered, loop_findings
from didim.excitation.points import PointDesign, _sampled
from didim.excitation.problem import Problem
from didim.excitation.ramps import ramp
from didim.excitation.search import starts
from didim.excitation.search.descent import Descent
from didim.loop.reference import Reference
from didim.methods.cloe.levenberg_marquardt import SafeSteps, weigh_by_noise
from didim.regression.delay import estimate_delay
from didim.signal.processing import SignalProcessing
from plain import stub

Array = NDArray[np.float64]


def _system() -> Any:
    from didim.terms.rows import Block, LinearSystem

    return LinearSystem(
        w=np.ones((1, 1)), y=np.zeros(1), names=("a",), blocks=(Block(rows=slice(0, 1), joint=0),)
    )


@pytest.mark.parametrize(("samples", "refused"), [(20, True), (21, False)])
def test_delays_need_samples_beside_their_reach(samples: int, refused: bool) -> None:
    """Four times the reach, of two samples at least, and three more."""
    part = stub(rate_hz=100.0, q=np.zeros((samples, 1)))

    with pytest.raises(FitError if refused else AttributeError):
        estimate_delay([part], SignalProcessing(), cast(Any, None), cast(Any, None), reach_s=0.01)


@pytest.mark.parametrize(("cosine", "met"), [(0.029, True), (0.031, False)])
def test_the_gradient_counts_as_zero(cosine: float, met: bool) -> None:
    assert SafeSteps.met(cast(Any, None), cosine, 0.0, accepted=True) is met


@pytest.mark.parametrize(("samples", "refused"), [(5, True), (6, False)])
def test_noise_needs_more_than_five_samples(samples: int, refused: bool) -> None:
    window = stub(measured=np.zeros((samples, 1)))
    problem = stub(windows=[window], method=None, job=stub(experiment=stub(name="log")))
    with pytest.raises(FitError if refused else AttributeError):
        weigh_by_noise(cast(Any, problem))


class Finer:
    """A problem with divided steps whose errors halve at each correction."""

    def __init__(self) -> None:
        self.parts: list[int] = []
        self.calls = 0

    def divided(self, parts: int) -> Finer:
        self.parts.append(parts)
        return self

    def errors(self, points: Array) -> tuple[list[Array], list[bool]]:
        self.calls += 1
        return [np.full(101, 0.9**self.calls)], [True]


@pytest.mark.parametrize(("step", "calls"), [(0.0095, 1), (0.0105, 2)])
def test_a_correction_that_is_short_ends_the_corrections(step: float, calls: int) -> None:
    """Two are few: the second is long enough, where the first is, since errors shrink; the third is not made."""
    finer = Finer()
    ways = [step, 0.0]

    def advance(point: Array, errors: Array) -> Array:
        # Of a hundred rows with errors of 0.9: standard deviations of 0.9 times the root of 101/100.
        return point + ways.pop(0) * float(np.sqrt(errors @ errors / 100.0))

    finer_steps.corrected(cast(Any, finer), np.zeros(1), np.eye(1), advance, lambda point: point)
    assert finer.parts == [2]
    assert finer.calls == calls


def test_five_corrections_are_made_at_most() -> None:
    finer = Finer()
    finer_steps.corrected(cast(Any, finer), np.zeros(1), np.eye(1), lambda x, errors: x + 1.0, lambda x: x)
    assert finer.calls == 1 + 5


@pytest.mark.parametrize(
    ("relative", "white", "code"),
    [(0.028, 0.0, None), (0.032, 0.0, "doubtful"), (0.29, 0.0, "doubtful"), (0.31, 0.0, "wrong")],
)
def test_a_declared_law_that_the_log_contradicts(
    relative: float, white: float, code: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert _law(monkeypatch, relative, 1.0) == code


@pytest.mark.parametrize(("left", "named"), [(0.48, True), (0.52, False)])
def test_another_law_leaves_less_than_half(left: float, named: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (_law(monkeypatch, 0.2, left) == "controller-delay") == named


def _law(patch: pytest.MonkeyPatch, relative: float, left: float) -> str | None:
    import didim.evidence.loop.law as law

    error = np.ones((10, 1))
    rows = stub(noise=np.zeros(1), law=lambda: None, error=lambda torque: error)
    patch.setattr(law, "_followed", lambda *given: np.ones(1))  # signals of the loop explain it
    found = Recovered(("kp",), np.ones((1, 1)), np.ones((1, 1)), np.array([relative]), cast(Any, rows))
    other = law.Law("controller-delay", np.sqrt(left) * error)
    patch.setattr(law, "_laws", lambda *given: iter([other]))
    (item, *_) = [*loop_findings(cast(Any, None), None, found), None]
    if item is None:
        return None
    return item.grade if item.code == "controller" else item.code


def test_a_descent_remembers_sixty_pairs_and_shortens_a_step_fifteen_times() -> None:
    calls: list[float] = []

    def uphill(x: Array) -> tuple[float, Array]:
        calls.append(float(x[0]))
        return (0.0 if len(calls) == 1 else 1.0), np.ones(1)

    one = Descent(uphill, np.zeros(1))
    one.run(1)
    assert len(calls) == 1 + 15
    assert one._pairs.maxlen == 60


@pytest.mark.parametrize(("gain", "converged"), [(0.8e-9, True), (1.2e-9, False)])
def test_a_descent_has_converged(gain: float, converged: bool) -> None:
    one = Descent(lambda x: (0.0, np.ones(1)), np.zeros(1))
    one._accept(np.ones(1), -gain, np.zeros(1))
    assert one.converged is converged


@pytest.mark.parametrize(("share", "accepted"), [(0.8e-4, False), (1.2e-4, True)])
def test_a_step_must_reach_a_ten_thousandth_of_what_the_slope_promises(share: float, accepted: bool) -> None:
    values = iter([0.0, -share])
    one = Descent(lambda x: (next(values, 1.0), np.ones(1)), np.zeros(1))
    one.run(1)
    assert bool(one.x[0]) is accepted


def test_a_start_is_a_chain_of_descents_of_given_lengths(monkeypatch: pytest.MonkeyPatch) -> None:
    lengths: list[int] = []
    kicks: list[float] = []

    class Ended:
        def __init__(self, objective: object, x: Array) -> None:
            self.x, self.value = x, 0.0

        def run(self, evaluations: int) -> None:
            lengths.append(evaluations)

    monkeypatch.setattr(starts, "Descent", Ended)

    def perturbed(x: Array, kick: float, rng: object) -> Array:
        kicks.append(kick)
        return x

    series = stub(power=0, perturbed=perturbed, build=lambda v: (None, None))
    problem = stub(
        series=series, thinning=1, x=np.ones(1), clearance=stub(empty=True), tighten=lambda motion: True
    )
    search = starts.Search(cast(Any, problem), 1000, 0, cast(Any, None), None)
    search.run([np.zeros(1)])
    # Two trials' worth (one motion), the first descent, hops of 40 for three times the iterations, the last, and eight repairs.
    assert lengths == [80, 240, *[40] * 75, 80, 300, *[60] * 8]
    assert kicks == [0.12] * 75


@pytest.mark.parametrize(("excess", "share"), [(0.1, 1.0 - 1.3 * 0.1), (0.9, 0.5)])
def test_limits_are_tightened_by_more_than_the_excess(excess: float, share: float) -> None:
    problem = cast(Any, object.__new__(Problem))
    problem.torque_share, problem.extra_clearance = np.ones(1), 0.0
    problem.exact = lambda series: series
    problem.excess = lambda series: (np.array([excess]), 0.01)
    assert Problem.tighten(problem, cast(Any, None))
    assert problem.torque_share[0] == pytest.approx(share)
    assert problem.extra_clearance == pytest.approx(1.3 * 0.01)


def test_points_are_tried_25_at_a_time_in_three_passes() -> None:
    design = cast(Any, object.__new__(PointDesign))
    drawn: list[int] = []

    def draw(rng: object, count: int) -> Array:
        drawn.append(count)
        return np.zeros((0, 1))

    design.first, design._draw = None, draw
    design.move = lambda a, b: None
    design.value = lambda moves: 0.0
    PointDesign._exchange(design, np.zeros((4, 1)), np.random.default_rng(0))
    assert drawn == [25] * 4 * 3


def test_points_are_looked_at_100_times_a_second_and_verified_2000_times(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[float, float]] = []
    design = cast(Any, object.__new__(PointDesign))
    motion = Reference.point_to_point(
        np.array([[0.0], [1.0]]), max_velocity=[1.0], max_acceleration=[1.0], dwell_s=0.1
    )
    design.reference = lambda points: motion

    def keeps(q: Array, dq: Array, ddq: Array, share: float = 1.0) -> bool:
        asked.append((len(q) / motion.duration, share))
        return True

    design.keeps = keeps
    design.rate = 500.0
    design.problem = stub(information=stub(own=lambda *given: None))
    PointDesign.move(design, np.zeros(1), np.ones(1))
    PointDesign.verified(design, np.zeros(1), np.ones(1))
    rates, shares = zip(*asked, strict=True)
    assert rates == pytest.approx((100.0, 2000.0), rel=0.01)
    assert shares == (1.0, 0.999)
    assert len(_sampled(motion, 100.0)[0]) == round(100.0 * motion.duration)


def test_a_ramp_is_drawn_out_by_a_quarter_twenty_times() -> None:
    """Until its torques keep their limits, on 400 samples."""
    lengths: list[int] = []
    limits = stub(velocity=np.ones(1), acceleration=np.ones(1), jerk=np.full(1, 60.0), torque=np.ones(1))

    def torques(q: Array, dq: Array, ddq: Array) -> Array:
        lengths.append(len(q))
        return np.full((len(q), 1), 2.0 if len(lengths) < 3 else 0.5)

    free = stub(empty=True)
    whole = ramp(np.zeros(1), np.ones(1), cast(Any, limits), cast(Any, free), lambda *_: None)
    found = ramp(np.zeros(1), np.ones(1), cast(Any, limits), cast(Any, free), torques)
    assert whole is not None
    assert found is not None
    assert found.duration == pytest.approx(1.25**2 * whole.duration)
    assert lengths == [400] * 3
    tried: list[int] = []

    def heavy(q: Array, dq: Array, ddq: Array) -> Array:
        tried.append(1)
        return np.full((len(q), 1), 2.0)

    with pytest.raises(ExcitationError, match="at any speed"):
        ramp(np.zeros(1), np.ones(1), cast(Any, limits), cast(Any, free), heavy)
    assert len(tried) == 20
