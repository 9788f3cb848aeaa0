"""Intervals of fits to positions alone, and what they are judged by: pushes, stops, siblings, effects on the own limb."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import didim.methods.positions.estimate as estimate
import didim.methods.positions.intervals as of_blocks
from didim.errors import FitError
from didim.methods.positions.intervals import intervals, model_errors
from didim.methods.positions.knowledge import _excess
from didim.methods.positions.search import Search
from didim.methods.positions.stops import Stop, _pulled, pushed_stretches, refuse_little
from didim.result.uncertainty import student_factor
from plain import stub

Array = NDArray[np.float64]


@pytest.mark.parametrize(("noise", "pushed"), [(5.2, False), (4.8, True)])
def test_a_push_has_twice_the_noise_of_the_encoder(noise: float, pushed: bool) -> None:
    """Blocks of half a second, here of one sample."""
    errors = np.ones(40)
    errors[20] = 10.0
    (found,) = pushed_stretches([errors], [np.ones(40)], [noise], [2.0], 0.7)
    assert found == ([(19, 22)] if pushed else [])


@pytest.mark.parametrize(("share", "held"), [(0.24, True), (0.26, False)])
def test_a_joint_follows_by_a_quarter_of_its_pull(share: float, held: bool) -> None:
    q = share * np.arange(11.0) / 10.0
    assert _pulled(q, np.ones(11), 10, 0.5).tolist() == [held] * 11


@pytest.mark.parametrize(("used", "refused"), [(19, True), (21, False)])
def test_a_fifth_of_a_log_must_be_free(used: int, refused: bool) -> None:
    robot = stub(joint_label=lambda joint: "joint 1")
    experiment = cast(Any, stub(name="arm", robot=robot, recordings=[stub(rate_hz=50.0)]))
    stops, limb = [Stop(0, 0, used, 100, None)], cast(Any, stub(joints=(0,)))
    with pytest.raises(FitError, match="is held by") if refused else nullcontext():
        refuse_little(experiment, stops, limb, used, 100)


def search_of(monkeypatch: pytest.MonkeyPatch, there: Array, **facts: object) -> Search:
    """Return a search of one unknown whose normal matrix is one, and whose gradient is the sum of its errors."""

    def normal(now: Search, errors: list[Array] | None = None) -> tuple[Array, Array]:
        return np.eye(1), np.array([sum(float(e.sum()) for e in errors or now.errors)])

    monkeypatch.setattr(Search, "normal", normal)
    monkeypatch.setattr(of_blocks, "at_bound", lambda now: np.zeros(1, dtype=bool))
    return Search(stub(columns=[stub(sigma=np.inf)], **facts), np.zeros(1), [there], [], 0.0, 0.0)


def test_intervals_are_the_wider_ones_of_both_cuts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the second cut here, with the quantile of Student's distribution of its four blocks."""
    monkeypatch.setattr(of_blocks, "_cuts", lambda problem: ([[np.arange(8)], [np.arange(4)]], "stretches"))
    monkeypatch.setattr(of_blocks, "_normal_of_blocks", lambda now, cut, number: (number,))
    monkeypatch.setattr(
        of_blocks, "_jackknife", lambda now, number: np.full((1, 1), {8: 1.0, 4: 9.0}[number])
    )
    monkeypatch.setattr(of_blocks, "_drift", lambda *given: np.zeros((2, 1)))
    monkeypatch.setattr(of_blocks, "_between_logs", lambda now: np.zeros(1))
    found = intervals(search_of(monkeypatch, np.ones(9)))
    assert found.half[0] == pytest.approx(3.0 * student_factor(0.95, 3))
    assert found.std[0] == pytest.approx(found.half[0] / student_factor(0.95, 7))


def test_a_change_along_a_log_has_the_variance_of_both_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimate of a block is its gradient here, as is that of a part the mean of those of its blocks."""
    monkeypatch.setattr(of_blocks, "bounded_step", lambda now, a, g: g / a[0, 0])
    before, after = np.array([1.0, 3.0, 2.0, 0.0, 1.0, 5.0]), np.array([9.0, 8.0, 9.0, 9.0, 7.0, 6.0])
    estimates = np.concatenate([before, after])
    change, ratio = of_blocks._drift(
        search_of(monkeypatch, np.ones(9)), np.ones((12, 1, 1)), estimates[:, None]
    )
    variance = (before.var(ddof=1) + after.var(ddof=1)) / 6.0
    assert change[0] == pytest.approx(after.mean() - before.mean())
    assert ratio[0] == pytest.approx(change[0] / np.sqrt(variance))


@pytest.mark.parametrize(("effect", "held"), [(0.8e-4, True), (1.2e-4, False)])
def test_an_effect_is_that_on_the_rows_of_its_own_limbs(effect: float, held: bool) -> None:
    """The other three of four limbs, which the unknown does not move, have three quarters of the rows."""
    column = cast(Any, stub(of_drive=True, kind="kp", start=2.0, joints=(1,)))
    problem = stub(rollouts=[stub(rate_hz=100.0)], limbs=[stub(joints=(k,)) for k in range(4)])
    excess = _excess(problem, column, 10.0, 100 * (10.0 * effect) ** 2, 400, 1e-9, False)
    assert (excess > 1.0) is held


@pytest.mark.parametrize(
    ("value", "std", "told"), [(2.0, 1.0 / 2.9, 0), (2.0, 1.0 / 3.1, 1), (1.38, 0.0, 0), (1.42, 0.0, 1)]
)
def test_a_joint_unlike_its_siblings(
    value: float, std: float, told: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By three standard deviations, and by four tenths of theirs."""
    limbs = [{"joints": [k + 1], "roles": ["knee"]} for k in range(3)]
    monkeypatch.setattr(estimate, "_limbs", lambda problem: limbs)
    rows = [
        {"joints": [k + 1], "kind": "Fv", "by": "log", "unit": "", "value": own, "std": error}
        for k, (own, error) in enumerate([(1.0, 9.0), (1.0, 9.0), (value, std)])
    ]
    problem = stub(robot=stub(joint_label=lambda joint: f"joint {joint + 1}"))
    assert len(estimate._unlike(problem, rows)) == told


@pytest.mark.parametrize(
    ("over", "count", "named"), [(1.04, 10000, []), (1.06, 10000, [1]), (1.14, 200, []), (1.16, 200, [1])]
)
def test_errors_of_the_model_exceed_the_noise_by_a_twentieth(
    over: float, count: int, named: list[int]
) -> None:
    """Or by three deviations of a root mean square, 0.15 with 200 samples."""
    found = model_errors(np.array([over, 1.0]), np.zeros(2), count)
    assert [joint for item in found for joint in item.joints] == named
    assert all(item.grade == "doubtful" for item in found)
