"""Each judgement of the evidence turns where its documentation says: a little below the number one way, a little above the other.

The numbers stand here as they are documented, so that a threshold which is doubled or halved is noticed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import didim.evidence.lasting as lasting
from didim.evidence.causes import Search, Tried, confirmed, torn, tried
from didim.evidence.hypotheses.hypothesis import Hypothesis
from didim.evidence.products import Judged
from didim.evidence.residual import Residual, held_out_findings, size_findings, spike_findings
from didim.evidence.rows import Columns
from didim.evidence.uses import Motions, Spread, _gravity, _uncertain
from didim.evidence.whiteness import Whiteness, whiteness, whiteness_findings
from didim.signal.processing import SignalProcessing
from didim.terms.rows import Block
from plain import stub

Array = NDArray[np.float64]
TURN = Hypothesis(code="torque-sign", joints=(1,))
GAIN = Hypothesis(code="gain", joints=(2,))
EXCHANGE = Hypothesis(code="swapped-torques", joints=(1, 2), order=(1, 0))


def residual(shares: list[float], sizes: list[float]) -> Residual:
    """Return errors of these shares of the torques of these sizes, without white noise."""
    one = np.array([[1.0, -1.0] * 10])
    size = np.array(sizes)[:, None]
    return Residual(np.array(shares)[:, None] * size * one, size * one, np.zeros(len(sizes)), ())


@pytest.mark.parametrize(
    ("share", "grade"), [(0.048, None), (0.052, "doubtful"), (0.48, "doubtful"), (0.52, "wrong")]
)
def test_the_size_of_a_residual(share: float, grade: str | None) -> None:
    found = size_findings(residual([share], [3.0]))
    assert [item.grade for item in found] == ([] if grade is None else [grade])


def test_the_size_is_that_of_torques_that_nothing_was_fitted_to() -> None:
    """A factor on blocks left out makes a result doubtful, but never wrong."""
    for growth, grades in ((1.2, []), (1.3, ["doubtful"]), (20.0, ["doubtful"])):
        assert [item.grade for item in size_findings(residual([0.04], [3.0]), growth)] == grades


def test_torques_that_are_predicted_no_better_than_by_zero() -> None:
    """They may be white noise, which no other size counts."""
    noise = replace(residual([0.9], [3.0]), noise=np.array([2.7]))
    assert size_findings(noise) == []
    for growth, grades in ((1.08, ["doubtful"]), (1.12, ["wrong"])):
        assert [item.grade for item in size_findings(noise, growth)] == grades


def test_a_joint_is_named_from_a_tenth_of_its_torque() -> None:
    for share, joints in ((0.095, ()), (0.105, (2,))):
        (found,) = size_findings(residual([0.06, share], [10.0, 0.5]))
        assert found.joints == joints


@pytest.mark.parametrize(
    ("ratio", "share", "told"),
    [(1.4, 0.1, False), (1.6, 0.1, True), (2.0, 0.0028, False), (2.0, 0.0032, True)],
)
def test_a_recording_that_was_held_out(ratio: float, share: float, told: bool) -> None:
    item = stub(name="other", error_rms=[2.0 * ratio], relative_error=[share])
    found = held_out_findings(stub(uncertainty=stub(joint_std=[2.0]), held_out=[item]))
    assert len(found) == told


def spiked(share_of_samples: float, height: float, n: int = 8000) -> list[Any]:
    """Return a window of a sine of rms 1 with spikes of a height on a share of its samples, at equal distances."""
    tau = np.sqrt(2.0) * np.sin(np.arange(n) * 2.0 * np.pi / 1000.0)[:, None]
    count = round(share_of_samples * n)
    tau[(np.arange(count) * (n // count) + 5)] += height
    return [stub(tau=tau)]


@pytest.mark.parametrize(
    ("share_of_samples", "height", "told"),
    [
        (0.8e-3, 5.0, False),
        (1.2e-3, 5.0, True),
        # More than one in sixty are the noise of that torque.
        (0.016, 5.0, True),
        (0.018, 5.0, False),
        # Error over the standard deviation: height times the root of the share.
        (2e-3, 0.009 / np.sqrt(2e-3), False),
        (2e-3, 0.011 / np.sqrt(2e-3), True),
    ],
)
def test_spikes(share_of_samples: float, height: float, told: bool) -> None:
    signal = SignalProcessing(cutoff_hz=10.0)
    assert len(spike_findings(spiked(share_of_samples, height), signal)) == told


def test_whiteness_is_judged_by_growth_and_significance() -> None:
    growth, sigmas = np.array([1.15, 1.25, 1.25]), np.array([9.0, 4.3, 4.7])
    assert Whiteness(growth, sigmas).coloured.tolist() == [False, False, True]
    coloured = Whiteness(np.array([1.5]), np.array([9.0]))
    for share, grade in ((0.0028, "note"), (0.0032, "doubtful")):
        (found,) = whiteness_findings(coloured, np.array([share]), None, np.zeros(1))
        assert found.grade == grade


def test_whiteness_sums_twenty_lags_and_says_nothing_on_fewer_than_three() -> None:
    error = np.sin(np.arange(400) * 0.05)
    blocks = [Block(joint=0, window=0, recording=0, rows=slice(0, 400))]
    rho = [float(error[: 400 - lag] @ error[lag:]) / float(error @ error) for lag in range(20)]
    growth = np.sqrt(1.0 + 2.0 * sum((1.0 - lag / 20) * rho[lag] for lag in range(1, 20)))
    assert whiteness(error, blocks, 1).growth[0] == pytest.approx(growth)
    for rows, judged in ((29, False), (30, True)):
        few = [Block(joint=0, window=0, recording=0, rows=slice(0, rows))]
        assert (whiteness(error[:rows], few, 1).growth[0] > 1.0) == judged


def test_uses() -> None:
    fit = stub(roles=["estimated"] * 2, relative_std_percent=np.array([19.0, 21.0]), names=("ZZ1", "MX1"))
    assert _uncertain(fit, Spread(1.0, 0.049, 0.0)) == []
    (found,) = _uncertain(fit, Spread(1.0, 0.051, 0.0))
    assert found.parameters == ("MX1",)
    assert not _gravity(Spread(1.0, 0.1, 0.9e-6), 0.0, "").fit_for
    assert _gravity(Spread(1.0, 0.1, 1.1e-6), 0.0, "").fit_for
    motion = np.zeros((50, 2))
    assert Motions.like([stub(q=motion, dq=motion, ddq=motion)]).q.shape == (300, 2)


def trial(
    hypothesis: Hypothesis,
    d: float,
    consistent: float = np.nan,
    *,
    blocks: int = 10,
    friction: bool = False,
    growth: float = 1.0,
) -> Tried:
    return Tried(hypothesis, d, blocks, consistent, friction, growth=growth)


@pytest.mark.parametrize(
    ("found", "named"),
    [
        ([trial(GAIN, -2.0, -0.65)], None),
        ([trial(GAIN, -2.0, -0.75)], False),
        ([trial(GAIN, -2.0, -1.35)], False),
        ([trial(GAIN, -2.0, -1.45)], True),
        ([trial(GAIN, -0.33, -2.0)], None),
        ([trial(GAIN, -0.37, -2.0)], True),
        ([trial(GAIN, -2.0, -2.0, blocks=7)], None),
        ([trial(GAIN, -2.0, -2.0, blocks=8)], True),
        # A turned sign needs no blocks where the consistent fit is very sure, or where friction says so.
        ([trial(TURN, 0.0, -4.8)], None),
        ([trial(TURN, 0.0, -5.2)], True),
        ([trial(TURN, 0.0, 0.33, friction=True)], True),
        ([trial(TURN, 0.0, 0.37, friction=True)], None),
        # A log that does not predict its own blocks is certain of nothing.
        ([trial(GAIN, -2.0, -2.0, growth=2.1)], True),
        ([trial(GAIN, -2.0, -2.0, growth=2.3)], False),
    ],
)
def test_a_cause_is_named(found: list[Tried], named: bool | None) -> None:
    """None: not at all; False: as a hint."""
    cause = Search._named(cast(Search, None), found)
    assert (None if cause is None else cause.certain) == named


def test_causes_that_explain_a_log_alike_are_named_together() -> None:
    for second, count in ((-1.35, 2), (-1.25, 1)):
        cause = Search._named(cast(Search, None), [trial(GAIN, -2.0, -2.0), trial(TURN, -2.0, second)])
        assert cause is not None
        assert len(cause.tried) == count
    assert confirmed(trial(GAIN, -0.36))


def test_errors_of_a_robot_count_from_a_twentieth_of_the_torque() -> None:
    size, plain = np.array([1.0]), np.array([1e-4])
    assert torn(np.array([2.4e-3]), plain, size) == 0.0
    assert torn(np.array([5e-3]), plain, size) == pytest.approx(np.log(2.0))
    assert torn(np.array([4e-2]), np.array([1e-2]), size) == pytest.approx(np.log(4.0))


@pytest.mark.parametrize(
    ("before", "after", "refused"),
    [(1.0, 2.0, ""), (1.0, 2.2, "no-robot"), (10.0, 4.9, ""), (10.0, 5.1, "no-robot")],
)
def test_a_cause_leaves_a_robot(before: float, after: float, refused: str) -> None:
    """One channel of a tenth of its torque: sums of log(held / plain) before and after a gain is corrected."""
    plain = np.array([0.01])
    rows = stub(
        n=1,
        robot=None,
        y=np.ones((1, 4)),
        declared_seen=plain,
        products=stub(y=np.ones((1, 1))),
        consistent=lambda robot, w, y: np.full((1, 4), np.sqrt(0.01 * np.exp(after) / 4.0)),
    )
    search = Search(rows)
    search._torn, search._held = [], plain * np.exp(before)
    search._columns[GAIN] = Columns(np.zeros((1, 4, 1)), (), stub(seen=lambda order, factors: plain))
    assert search._decided(trial(GAIN, -2.0)).refused == refused


def test_an_exchange_makes_both_channels_better() -> None:
    rows = stub(names=(), declared=judged([0.0]))
    rows.declared = Judged(np.ones((2, 10)), np.zeros(1), np.ones(1))
    for second, refused in ((0.9, ""), (1.1, "one-channel")):
        unseen = np.stack([np.full(10, 0.1), np.full(10, second)])
        products = stub(
            judged=lambda order, factors, unseen=unseen: Judged(unseen, np.zeros(1), np.ones(1)),
            seen=lambda order, factors: np.ones(2),
        )
        assert tried(rows, EXCHANGE, products, ()).refused == refused


def judged(beta: list[float], unseen: float = 1.0) -> Judged:
    return Judged(np.full((1, 10), unseen), np.array(beta), np.ones(len(beta)))


@pytest.mark.parametrize(
    ("before", "after", "unseen", "friction", "refused"),
    [
        (-4.8, 5.2, 1.0, False, ""),
        (-5.2, 4.8, 1.0, False, ""),
        (-5.2, 5.2, 1.0, True, ""),
        (-5.2, 5.2, np.exp(0.33), True, ""),
        (-5.2, 5.2, np.exp(0.37), False, ""),
        (1.0, -2.9, 1.0, False, ""),
        (1.0, -3.1, 1.0, False, "friction"),
    ],
)
def test_friction_of_a_turned_sign(
    before: float, after: float, unseen: float, friction: bool, refused: str
) -> None:
    names = ("Fv1", "Fc1")
    rows = stub(names=names, declared=judged([before, before]))
    products = stub(
        judged=lambda order, factors: judged([after, after], unseen), seen=lambda order, factors: np.ones(1)
    )
    found = tried(rows, TURN, products, names)
    assert (found.friction, found.refused) == (friction, refused)


class Rows:
    """A log of one joint: what further columns bring is given."""

    def __init__(self, d: float, better: int, shift: float, extra: float = 0.0, torque: float = 1.0) -> None:
        self.y, self.declared_seen = np.full((1, 10), torque), np.ones(1)
        self.n, self.names, self.beta = 1, ("ZZ1",), np.zeros(1)
        self.robot = stub(friction=stub(coulomb="sign"))
        self.parts = [stub(rate_hz=100.0)]
        self.declared = judged([0.0])
        after = np.ones(10)
        after[:better] = 1e-3
        after[better:] = 10.0
        after[-1] += 10.0 * np.exp(d) - after.sum()
        assert after[-1] > 0.0
        self._judged = Judged(after[None], np.array([shift, extra]), np.ones(2))

    def with_columns(self, columns: Array) -> Any:
        return stub(judged=lambda: self._judged)


def late(monkeypatch: pytest.MonkeyPatch, rows: Rows) -> str:
    monkeypatch.setattr(lasting, "_slopes", lambda rows: np.zeros((1, 10)))
    found = lasting.delay_findings(cast(Any, rows), np.ones(1), obeyed=False)
    return found[0].grade if found else ""


@pytest.mark.parametrize(
    ("d", "better", "shift", "samples", "grade"),
    [
        (-0.09, 9, 1.0, 1.0, ""),
        (-0.11, 9, 1.0, 1.0, "doubtful"),
        (-0.11, 9, 1.0, 0.19, ""),
        (-0.11, 9, 1.0, 0.21, "doubtful"),
        (-0.11, 9, 0.48, 1.0, ""),
        (-0.11, 9, 0.52, 1.0, "doubtful"),
        (-1.45, 9, 1.9, 1.0, "doubtful"),
        (-1.45, 9, 2.1, 1.0, "wrong"),
        (-1.35, 9, 2.1, 1.0, "doubtful"),
    ],
)
def test_delays(
    monkeypatch: pytest.MonkeyPatch, d: float, better: int, shift: float, samples: float, grade: str
) -> None:
    assert late(monkeypatch, Rows(d, better, shift, -samples)) == grade


@pytest.mark.parametrize(("torque", "grade"), [(6.2, "wrong"), (6.5, "doubtful")])
def test_a_delay_of_a_small_error_is_not_wrong(
    monkeypatch: pytest.MonkeyPatch, torque: float, grade: str
) -> None:
    """The error is 1, and 5 % of the norm of ten torques of 6.3."""
    assert late(monkeypatch, Rows(-1.45, 9, 2.1, -1.0, torque=torque)) == grade


@pytest.mark.parametrize(("shift", "grade"), [(2.9, "note"), (3.1, "doubtful")])
def test_missing_friction(monkeypatch: pytest.MonkeyPatch, shift: float, grade: str) -> None:
    monkeypatch.setattr(lasting, "laws", lambda rows: [("stribeck", np.zeros((1, 10, 1)))])
    (found,) = lasting.friction_findings(cast(Any, Rows(-0.5, 9, shift)), None, chosen=False)
    assert found.grade == grade


@pytest.mark.parametrize(("d", "told"), [(-0.09, 0), (-0.11, 1)])
def test_friction_that_explains_something(monkeypatch: pytest.MonkeyPatch, d: float, told: int) -> None:
    monkeypatch.setattr(lasting, "laws", lambda rows: [("stribeck", np.zeros((1, 10, 1)))])
    assert len(lasting.friction_findings(cast(Any, Rows(d, 9, 9.0)), None, chosen=False)) == told


@pytest.mark.parametrize(("torque", "told"), [(160.0, 1), (163.0, 0)])
def test_friction_of_a_share_of_the_torque(monkeypatch: pytest.MonkeyPatch, torque: float, told: int) -> None:
    """Blocks left out lose 1.04 of 10 squared: 0.2 % of ten torques of 161."""
    monkeypatch.setattr(lasting, "laws", lambda rows: [("stribeck", np.zeros((1, 10, 1)))])
    rows = Rows(-0.11, 9, 9.0, torque=torque)
    assert len(lasting.friction_findings(cast(Any, rows), None, chosen=False)) == told
