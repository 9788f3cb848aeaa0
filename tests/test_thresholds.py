"""Judgements of the evidence, the checks and the regression turn where their documentation says: a little below the number one way,
a little above the other. The numbers stand here as they are documented.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
import didim.diagnosis.excitation as excitation
import didim.evidence.lasting as lasting
import didim.evidence.uses as uses
import didim.methods.builder as builder
import didim.regression.friction.alarm as flips
from didim.diagnosis.bandwidth import check_bandwidth
from didim.diagnosis.channels import Channel, _clipped, _coarse, _jumps, _stuck
from didim.diagnosis.check import FEWEST_SPIKES, _causes, time_findings
from didim.diagnosis.limits import check_limits
from didim.diagnosis.reference import _joint, _quiet, _recording
from didim.evidence.causes import Search, Tried, confirmed, torn, tried
from didim.evidence.gain_check import gain_information, unchecked
from didim.evidence.hypotheses.geometry import gravities, with_geometry
from didim.evidence.hypotheses.hypothesis import Hypothesis, best_factor
from didim.evidence.lasting import joint_delay_findings
from didim.evidence.loop.law import Recovered, _gains, loop_findings
from didim.evidence.loop.law_rows import LawRows
from didim.evidence.loop.simulated import (
    MotionComparison,
    _slope,
    motion_findings,
    slope_findings,
    worse_findings,
)
from didim.evidence.products import Judged, Products
from didim.evidence.residual import Residual, held_out_findings, size_findings, spike_findings
from didim.evidence.rows import Columns
from didim.evidence.screen import Screen as Screening
from didim.evidence.standstill import check_standstill
from didim.evidence.torques import constant_torque_findings
from didim.evidence.uses import Motions, Spread, _gravity, _uncertain
from didim.evidence.whiteness import Whiteness, whiteness, whiteness_findings
from didim.excitation.design import Excitation
from didim.log.sampling import TimeFault
from didim.model.dynamics import friction_places
from didim.regression.consistent.diagnosis import diagnosis
from didim.regression.covariance import autocorrelated
from didim.regression.delay import _shared
from didim.regression.friction.alarm import joint_test
from didim.regression.friction.screen import Screen, Worth
from didim.regression.logs.body import nearest_bodies
from didim.regression.logs.drift import differences
from didim.regression.logs.load import Load, _load
from didim.result.iteration import Status
from didim.robot.friction import FrictionTerm, Law
from didim.robot.rigid_body import INERTIAL
from didim.signal.processing import SignalProcessing
from didim.terms.rows import Block, LinearSystem
from plain import stub
from test_friction_terms import motion

Array = NDArray[np.float64]

TURN = Hypothesis(code="torque-sign", joints=(1,))

GAIN = Hypothesis(code="gain", joints=(2,))

EXCHANGE = Hypothesis(code="swapped-torques", joints=(1, 2), order=(1, 0))


def residual(shares: list[float], sizes: list[float]) -> Residual:
    """Return errors of these shares of the torques of these sizes, without white noise."""
    one = np.array([[1.0, -1.0] * 10])
    size = np.array(sizes)[:, None]
    return Residual(np.array(shares)[:, None] * size * one, size * one, np.zeros(len(sizes)), ())


def spiked(share_of_samples: float, height: float, n: int = 8000) -> list[Any]:
    """Return a window of a sine of rms 1 with spikes of a height on a share of its samples, at equal distances."""
    tau = np.sqrt(2.0) * np.sin(np.arange(n) * 2.0 * np.pi / 1000.0)[:, None]
    count = round(share_of_samples * n)
    tau[(np.arange(count) * (n // count) + 5)] += height
    return [stub(tau=tau)]


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


@pytest.mark.parametrize(("least", "told"), [(0.975, True), (0.985, False)])
def test_a_factor_that_leaves_two_per_cent_less_is_refined(least: float, told: bool) -> None:
    def squares(factor: float) -> Array:
        return np.array([least + (1.0 - least) * (np.log(factor) / np.log(0.9) - 1.0) ** 2])

    found, at_end = best_factor(squares)
    assert found == pytest.approx(0.9 if told else 1.0, abs=0.01)
    assert not at_end


def test_three_wrong_declarations_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many a log has: each is looked for with those before it corrected."""
    cause = stub(certain=True, tried=[stub(hypothesis=None)])
    monkeypatch.setattr("didim.diagnosis.check.Search", lambda rows: stub(cause=lambda: cause))
    monkeypatch.setattr("didim.diagnosis.check.cause_findings", lambda rows, cause: [rows.number])

    def rows(number: int) -> Any:
        return stub(number=number, known=None, under=lambda hypothesis: rows(number + 1))

    hints: list[Any] = []
    numbers: list[Any] = list(_causes(rows(0), hints))
    assert numbers == [0, 1, 2]
    assert hints == []


@pytest.mark.parametrize(("left", "told"), [(0.69, 1), (0.71, 0)])
def test_a_cause_beside_known_parameters_takes_three_tenths_of_the_error(
    left: float, told: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A load that known parameters do not have is none."""
    cause = stub(certain=True, tried=[stub(hypothesis=None, decisive=2.0 * 6.0 * np.log(left))])
    causes = iter([cause, None])
    monkeypatch.setattr("didim.diagnosis.check.Search", lambda rows: stub(cause=lambda: next(causes)))
    monkeypatch.setattr("didim.diagnosis.check.cause_findings", lambda rows, cause: [cause])
    rows = stub(n=6, known=np.zeros(1))
    rows.under = lambda hypothesis: rows
    assert len(_causes(rows, [])) == told


def wave(n: int = 2000) -> Array:
    return np.asarray(np.sin(np.arange(n) * 2.0 * np.pi / 500.0))


def beside(q: Array) -> Array:
    """Return a signal of the same size that has nothing of another one, nor of its rate."""
    other = np.sin(np.arange(len(q)) * 2.0 * np.pi / 50.0)
    return np.asarray(other * np.linalg.norm(q) / np.linalg.norm(other))


def other_joint(correlation: float) -> str:
    q = wave()
    return _joint(q, correlation * q + np.sqrt(1.0 - correlation**2) * beside(q), 100.0)[0]


def late_copy(explained: float) -> str:
    q = wave()
    dq = np.gradient(q) * 100.0
    rest = beside(dq)
    size = 0.05 * np.linalg.norm(dq) * np.sqrt((1.0 - explained) / explained) / np.linalg.norm(rest)
    return _joint(q, q - 0.05 * dq + size * rest, 100.0)[0]


def smoothed_copy(power: float) -> bool:
    rng = np.random.default_rng(0)
    n = 80_000

    def band(low: float, high: float) -> Array:
        bins = np.fft.rfft(rng.standard_normal(n))
        edges = np.arange(len(bins)) / len(bins)
        return np.asarray(np.fft.irfft(np.where((edges >= low) & (edges < high), bins, 0.0), n))

    return _quiet(band(0.0, 0.3), np.sqrt(power) * band(0.0, 0.3) + band(0.3, 1.0))


def quiet_band(share: float) -> bool:
    k = np.arange(20_000)
    q = np.sin(2.0 * np.pi * 0.01 * k) + np.sqrt(share) * np.sin(2.0 * np.pi * 0.4 * k)
    return _quiet(q, np.diff(np.random.default_rng(0).standard_normal(len(k) + 1)))


def window(samples: int) -> int:
    q = wave(samples)[:, None]
    log = stub(q_ref=q, windows=[(0, samples)], rate_hz=100.0, name="log", measured_positions=lambda: q)
    return len(list(_recording(log)))


def channel(values: Array, what: Any = "position") -> Channel:
    return Channel(what, 1, "joint", stub(name="log", rate_hz=100.0), None, None, values)


def stuck(samples: int) -> int:
    values = wave()
    values[1000 : 1000 + samples] = values[1000]
    return len(_stuck(channel(values)))


@pytest.mark.parametrize(("times", "told"), [(9.5, 0), (10.5, 1)])
def test_a_position_jumps_by_ten_usual_second_differences(times: float, told: int) -> None:
    # The second differences of k^2 / 2 are 1; behind a step of h one is 1 + h.
    values = 0.5 * np.arange(1000.0) ** 2
    values[500:] += times - 1.0
    assert len(_jumps(channel(values))) == told
    # A joint that drives on evenly after a rest breaks off by as much.
    stopped = 0.5 * np.arange(1000.0) ** 2
    stopped[500:508] = stopped[500]
    slope = stopped[508] - stopped[507]
    stopped[508:] += times - slope
    before = stopped[500] - stopped[499]
    stopped[:500] += before - 1.0
    assert len(_stuck(channel(stopped))) == told


def standing(slow: float, length: int, count: int) -> list[Any]:
    """Return a window of 1000 samples at 100 Hz with stretches of so many samples at a share of the top speed."""
    dq = np.ones((1000, 1))
    for k in range(count):
        dq[100 * k : 100 * k + length] = slow
    return [stub(q=np.zeros((1000, 1)), dq=dq, rate_hz=100.0)]


@pytest.mark.parametrize(("loss", "told"), [(0.019, 0), (0.021, 1)])
def test_a_recording_that_is_too_slow(loss: float, told: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("didim.diagnosis.bandwidth._loss", lambda recording, joint, cutoff: loss)
    log = stub(q=np.zeros((10, 1)), rate_hz=100.0, name="log")
    found = check_bandwidth(stub(recordings=[log], signal=stub(cutoff_hz=None)))
    assert len(found) == told
    if told:  # a tenth of the loss, rounded up: 100 Hz times the root of 0.021 / 0.002
        assert "Record at 500 Hz" in found[0].advice


@pytest.mark.parametrize(
    ("times", "told", "advice"),
    [(1.01, 0, ""), (1.03, 1, "the limits of"), (4.8, 1, "the limits of"), (5.2, 1, "reduction")],
)
def test_limits_of_the_robot(times: float, told: int, advice: str) -> None:
    limits = stub(position=None, velocity=2.0, effort=None)
    robot = stub(joint_kinds=["revolute"], limits=[limits], name="arm")
    part = stub(q=np.zeros((5, 1)), dq=np.full((5, 1), 2.0 * times), tau=np.zeros((5, 1)))
    found = check_limits(stub(robot=robot), [part])
    assert len(found) == told
    assert not told or advice in found[0].advice


def test_five_gaps_are_told_one_by_one() -> None:
    faults = [
        ("log", TimeFault(file="log.csv", kind="gap", sentence=f"log.csv: gap {k}", sample=k, rate_hz=100.0))
        for k in range(12)
    ]
    found = time_findings(faults)
    assert len(found) == 5
    assert found[-1].sentence.endswith("; there are 7 more")


def spikes(count: int) -> int:
    tau = np.random.default_rng(0).standard_normal((2000, 1))
    tau[200 + 300 * np.arange(count)] += 100.0
    return len(spike_findings([stub(tau=tau)], stub(spikes=None), FEWEST_SPIKES))


def correlated(correlation: float) -> Array:
    """Pairs of 1 and x in turn with their negatives: of white noise but for this correlation at a lag of one, (1600,)."""
    x = (1.0 - np.sqrt(1.0 - 4.0 * correlation**2)) / (2.0 * correlation)
    one = np.array([1.0, x, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    return np.tile(np.concatenate([one, -one]), 100)


@pytest.mark.parametrize(
    ("moves", "correlation", "told"), [(0.048, 0.05, 0), (0.052, 0.05, 1), (1.0, 0.095, 1), (1.0, 0.105, 0)]
)
def test_a_torque_that_is_noise_alone(moves: float, correlation: float, told: int) -> None:
    """White to four standard deviations, of ``1 / sqrt(1600)``, along a motion of five hundredths."""
    tau = 1.0 + correlated(correlation)[:, None]
    positions = np.linspace(0.0, moves, 1600)[:, None]
    recording = stub(
        name="log", tau=tau, origin={}, has_positions=True, windows=[(0, 1600)],
        measured_positions=lambda: positions,
    )  # fmt: skip
    assert len(constant_torque_findings(stub(recordings=[recording]))) == told


def rows_of_a_log(joints: int = 1) -> Any:
    part = stub(q=np.ones((9, joints)), dq=np.ones((9, joints)), ddq=np.ones((9, joints)))
    products = stub(seen=lambda: np.ones(joints), g=np.ones((joints, 1, 1, 1)), scale=np.ones(1))
    robot = stub(joint_kinds=("revolute",) * joints, base_parameters=stub(indices=(0,)))
    return stub(
        robot=robot, parts=[part], n=joints, y=np.ones((joints, 9)), products=products, names=("ZZ1",), beta=np.zeros(1)
    )  # fmt: skip


@pytest.mark.parametrize(("share", "told"), [(0.095, 0), (0.105, 1)])
def test_a_parameter_that_a_log_does_not_identify(
    share: float, told: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(excitation, "_shares", lambda *given: np.array([share]))
    assert len(excitation.check_excitation(rows_of_a_log(), 9.0)) == told


def payload(monkeypatch: pytest.MonkeyPatch, error: Array, *column: float) -> float:
    """Return the standard deviation of a mass with this torque at each joint, whose largest torques are one."""
    monkeypatch.setattr(uses, "inverse_dynamics", lambda robot, q, dq, ddq, x: q)
    n, n_rows = error.shape
    names = tuple(f"{kind}{n}" for kind in INERTIAL)
    robot = stub(parameter_names=names, n_dof=n, geometry=stub(parents=(None, *range(n - 1))))
    part = stub(q=np.tile(column, (n_rows, 1)), dq=None, ddq=None)
    signal = SignalProcessing(cutoff_hz=None, edge_rows=0)
    return uses.payload_std(robot, [part], cast(Any, stub(error=error, size=np.ones(n))), signal)


def test_masses_of_ten_stretches_give_the_deviation_of_a_payload(monkeypatch: pytest.MonkeyPatch) -> None:
    error = np.random.default_rng(0).standard_normal((2, 200))
    masses = error[1].reshape(10, 20).mean(axis=1)
    assert payload(monkeypatch, error, 0.0, 1.0) == pytest.approx(masses.std(ddof=1) / np.sqrt(10.0))


def test_gains_are_checked_over_twenty_intervals() -> None:
    """One parameter of two joints: the residual beside the gain's own column, summed over intervals of time."""
    rng = np.random.default_rng(0)
    w = rng.standard_normal((2, 400, 1))
    y = w[:, :, 0] + 0.1 * rng.standard_normal((2, 400))
    sigma, _ = gain_information(stub(w=w, y=y, products=Products.of(w, y)))
    root = np.sqrt(400.0 / Products.of(w, y).seen())[:, None]
    a, b = w[:, :, 0] * root, y * root
    model = a * (np.sum(a * b) / np.sum(a * a))
    own = np.stack([model[0], np.zeros(400)])
    beside = own - a * (np.sum(a * own) / np.sum(a * a))
    scores = np.sum(beside * (b - model), axis=0).reshape(20, 20).sum(axis=1)
    assert sigma[0] == pytest.approx(np.sqrt(20 / 19 * scores @ scores) / np.sum(beside**2))


@pytest.mark.parametrize(
    ("factor", "sigma", "told"), [(1.028, 0.0, 0), (1.032, 0.0, 1), (1.48, 0.1, 0), (1.52, 0.1, 1)]
)
def test_a_gain_that_differs(factor: float, sigma: float, told: int) -> None:
    """The limits are three per cent and five standard deviations."""
    rows = stub(
        columns=lambda: np.ones((1, 5, 1)),
        reduced=lambda signals: np.zeros((5, 1)),
        forward=[],
        error=lambda torque: torque,
        controller=stub(kind="pd"),
    )
    found = Recovered(("kp",), np.array([[factor]]), np.array([[sigma]]), np.ones(1), cast(Any, rows))
    assert len(_gains(found, [0]).facts["gains"]) == told


def test_gravity_that_a_robot_file_lacks_is_that_of_the_earth() -> None:
    robot = with_geometry(didim.load_robot("planar2"), gravity=(0.0, 0.0, 0.0))
    found = [item.facts["vector"] for item in gravities(stub(robot=robot))]
    assert [-9.81, 0.0, 0.0] in found
    assert np.linalg.norm(np.array(found), axis=1).tolist() == [9.81] * 6


@pytest.mark.parametrize(
    ("factor", "corrected"), [(3.4, True), (3.6, False), (1.0 / 3.4, True), (1.0 / 3.6, False)]
)
def test_columns_of_a_similar_motion_have_the_same_error(factor: float, corrected: bool) -> None:
    """The error is that of the decimated motion, here 1; Coulomb friction keeps its size, viscous friction does not."""
    robot = didim.load_robot("planar2")
    q, dq, ddq = (values[:50].T for values in motion())
    smooth = Screening(robot, (q, dq, ddq), np.zeros((2, 50, len(robot.parameter_names)))).smooth
    screen = Screening(robot, (q, dq, ddq), smooth + 1.0)
    position = np.diag([factor, 1.0])
    plain = Screening(robot, (position @ q, position @ dq, position @ ddq), smooth).smooth
    keeps = np.setdiff1d(friction_places(robot), robot.parameter_names.index("Fv1"))
    links = ~np.isin(screen.base, keeps)
    error = screen.of_motion(position)[:, :, links] - plain[:, :, screen.base][:, :, links]
    np.testing.assert_allclose(error, 1.0 if corrected else 0.0, atol=1e-9)


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


def compared(**facts: float) -> MotionComparison:
    known = {"position": 0.0, "slope": 1.0, "sigma": 0.0, "error": 1.0, "torque": 1.0}
    return MotionComparison(**{key: np.array([facts.get(key, value)]) for key, value in known.items()})


@pytest.mark.parametrize(
    ("missed", "grade"), [(0.0048, None), (0.0052, "doubtful"), (0.095, "doubtful"), (0.105, "wrong")]
)
def test_a_simulated_motion(missed: float, grade: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("didim.evidence.loop.simulated.declared_loop", lambda experiment: True)
    found = motion_findings(cast(Any, None), compared(position=missed))
    assert [item.grade for item in found] == ([] if grade is None else [grade])


def test_the_deviation_of_a_slope_is_over_twenty_intervals() -> None:
    x = np.random.default_rng(0).standard_normal((400, 1))
    y = x + 0.1 * np.random.default_rng(1).standard_normal((400, 1))
    slope, sigma = _slope(x, y)
    a, b = x[:, 0] - x.mean(), y[:, 0] - y.mean()
    scores = (a * (b - slope[0] * a)).reshape(20, 20).sum(axis=1)
    assert sigma[0] == pytest.approx(np.sqrt(20 / 19 * np.sum(scores**2)) / np.sum(a**2))


@pytest.mark.parametrize(("sigma", "told"), [(0.29, 0), (0.31, 1)])
def test_a_gain_that_a_log_does_not_check(sigma: float, told: int, monkeypatch: pytest.MonkeyPatch) -> None:
    checked = (np.array([sigma, 0.01]), np.array([0.1, 0.9]))
    monkeypatch.setattr("didim.evidence.gain_check.gain_information", lambda rows: checked)
    assert len(unchecked(stub(n=2))) == told


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


def masses(estimates: list[float], std: float) -> Array:
    """Masses of the bodies nearest to estimated ones of this deviation."""
    known = np.zeros(10)
    known[[0, 3, 5]] = 0.01
    mass = np.eye(10)[:, 9:]
    return nearest_bodies(np.array(estimates)[:, None], np.array([[std**2]]), known, mass)[:, 9]


def test_the_prior_of_a_body_weighs_a_hundredth_of_a_nat() -> None:
    """The minimum is where ``(m - m0) / s^2 + 0.01 (1 / 1 - 1 / m)`` is zero: the golden ratio for s = 10."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    assert masses([0.0, 2.0], 10.0) == pytest.approx([golden - 1.0, golden])


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


def supports(gain: Array, rows: float = 1000.0) -> bool:
    screen = stub(counts=np.full((10, 1), rows / 10.0))
    screen.needed = cast(Any, Screen.needed).fget(screen)
    return Screen.supported(screen, gain)


def offset_differs(share: float) -> bool:
    """Of two recordings; errors of alternating signs make the difference certain."""
    rng = np.random.default_rng(0)
    blocks = tuple(Block(rows=slice(400 * k, 400 * k + 400), joint=0, recording=k) for k in range(2))
    w = np.tile([1.0, 1.0, -1.0, -1.0], 200)[:, None]
    residual = np.tile([1.0, -1.0], 400) + 1e-3 * rng.standard_normal(800)
    residual[400:] += share
    system = LinearSystem(w=w, y=residual, names=("a",), blocks=blocks)
    (found,) = differences(system, cast(Any, stub(weights=np.ones(800), residual=residual)), "offset")
    return found.clear


def grades(shares: list[float], sizes: list[float], *growth: float, noise: float = 0.0) -> list[str]:
    return [
        str(item.grade)
        for item in size_findings(replace(residual(shares, sizes), noise=np.array([noise])), *growth)
    ]


def held_out(ratio: float, share: float) -> int:
    item = stub(name="other", error_rms=[2.0 * ratio], relative_error=[share])
    return len(held_out_findings(stub(uncertainty=stub(joint_std=[2.0]), held_out=[item])))


def no_robot(plain: float, constrained: float, unknowns: int) -> bool | None:
    """None: nothing found; True: the model explains hardly anything. Many unknowns follow the noise of 1000 rows."""
    record: dict[str, Any] = {"plain_relative_error": plain, "constrained_relative_error": constrained}
    record |= {"plain_relative_errors": [], "constrained_relative_errors": []}
    told = diagnosis(stub(record=record, residual=np.zeros(1000), solution=np.zeros(unknowns)))
    return told[0].hopeless if told else None


def named(*found: Tried) -> bool | None:
    """None: not at all; False: as a hint."""
    cause = Search._named(cast(Search, None), list(found))
    return None if cause is None else cause.certain


def told(law: Law, share: float, shift: float) -> bool:
    """A spring takes a tenth of the error; a sign that is kept has no parameter."""
    worth = Worth(nats=10.0, significance=5.0, share=share, shift=shift, supported=True)
    return Screen.told(stub(), worth, FrictionTerm(law=law, joint=0))


def declared_lag(rate_hz: float) -> float:
    rows = object.__new__(LawRows)
    rows.controller = stub(digital=didim.loop.Digital(sample_time_s=0.004, delay_samples=2))
    rows.rate_hz = rate_hz
    return round(rows.declared_lag_s, 12)


PATTERN = np.array([-1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 0.0, 0.0, 1.0, -1.0])
# fmt: off
TURNS: dict[str, tuple[Callable[..., Any], list[tuple[Any, ...]]]] = {
    "size of a residual": (
        lambda share: grades([share], [3.0]),
        [(0.048, []), (0.052, ["doubtful"]), (0.48, ["doubtful"]), (0.52, ["wrong"])]),
    "size on blocks left out, which makes a result doubtful, but never wrong": (
        lambda growth: grades([0.04], [3.0], growth), [(1.2, []), (1.3, ["doubtful"]), (20.0, ["doubtful"])]),
    "torques that are predicted no better than by zero: white noise, which no other size counts": (
        lambda *growth: grades([0.9], [3.0], *growth, noise=2.7), [([],), (1.08, ["doubtful"]), (1.12, ["wrong"])]),
    "a joint is named from a tenth of its torque": (
        lambda share: [item.joints for item in size_findings(residual([0.06, share], [10.0, 0.5]))],
        [(0.095, [()]), (0.105, [(2,)])]),
    "a recording that was held out": (held_out, [(1.4, 0.1, 0), (1.6, 0.1, 1), (2.0, 0.0028, 0), (2.0, 0.0032, 1)]),
    "spikes: more than one in sixty are noise; the error over the deviation is height times the root of the share": (
        lambda share, height: len(spike_findings(spiked(share, height), SignalProcessing(cutoff_hz=10.0))),
        [(0.8e-3, 5.0, 0), (1.2e-3, 5.0, 1), (0.016, 5.0, 1), (0.018, 5.0, 0),
         (2e-3, 0.009 / np.sqrt(2e-3), 0), (2e-3, 0.011 / np.sqrt(2e-3), 1)]),
    "a cause is named": (named, [
        (trial(GAIN, -2.0, -0.65), None), (trial(GAIN, -2.0, -0.75), False),
        (trial(GAIN, -2.0, -1.35), False), (trial(GAIN, -2.0, -1.45), True),
        (trial(GAIN, -0.33, -2.0), None), (trial(GAIN, -0.37, -2.0), True),
        (trial(GAIN, -2.0, -2.0, blocks=7), None), (trial(GAIN, -2.0, -2.0, blocks=8), True)]),
    "a turned sign needs no blocks where the consistent fit is very sure, or where friction says so": (named, [
        (trial(TURN, 0.0, -4.8), None), (trial(TURN, 0.0, -5.2), True),
        (trial(TURN, 0.0, 0.33, friction=True), True), (trial(TURN, 0.0, 0.37, friction=True), None)]),
    "a log that does not predict its own blocks is certain of nothing": (named, [
        (trial(GAIN, -2.0, -2.0, growth=2.1), True), (trial(GAIN, -2.0, -2.0, growth=2.3), False)]),
    "a factor beyond the list is an end of it": (
        lambda best: best_factor(lambda factor: np.array([1.0 + np.log(factor / best) ** 2])),
        [(0.1, (0.3, True)), (10.0, (3.3, True))]),
    "a reference that is the position": (
        lambda share: _joint(wave(), wave() + share * beside(wave()), 100.0)[0] == "same", [(0.6e-9, True), (1.6e-9, False)]),
    "a reference that does not move": (
        lambda share: _joint(wave(), share * beside(wave()), 100.0)[0], [(0.9e-3, "constant"), (1.1e-3, "unrelated")]),
    "a reference of another joint": (lambda share: other_joint(share) == "unrelated", [(0.48, True), (0.52, False)]),
    "a late copy": (lambda explained: late_copy(explained) == "late", [(0.89, False), (0.91, True)]),
    "a smoothed copy": (smoothed_copy, [(0.27, True), (0.33, False)]),
    "the band of a motion has all but a thousandth of its power": (quiet_band, [(0.7e-3, True), (1.5e-3, False)]),
    "a reference needs a window of 200 samples": (window, [(199, 0), (200, 1)]),
    "an encoder is stuck for eight samples": (stuck, [(7, 0), (8, 1)]),
    "a torque is clipped": (
        lambda top, near: len(_clipped(channel(
            np.concatenate([np.linspace(-1.0, 0.5, 200), np.full(near, 0.9), np.full(top, 1.0)]), "torque"))),
        [(7, 1, 0), (8, 1, 1), (29, 10, 0), (31, 10, 1)]),
    "a channel of few values": (lambda levels: len(_coarse(channel(np.arange(1000.0) % levels))), [(99, 1), (100, 0)]),
    "standstill": (
        lambda *stretches: len(check_standstill(didim.load_robot("emps"), standing(*stretches))),
        [(0.0045, 60, 1, 1), (0.0055, 60, 1, 0), (0.0, 9, 8, 0), (0.0, 11, 8, 1), (0.0, 48, 1, 0), (0.0, 52, 1, 1)]),
    "late torques": (
        lambda late, gain: len(joint_delay_findings(stub(joints=[late, late], gain=gain, differs=False), np.zeros(2), 100.0)),
        [(0.19, 0.5, 0), (0.21, 0.5, 1), (2.0, 0.048, 0), (2.0, 0.052, 1)]),
    "three spikes": (spikes, [(2, 0), (3, 1)]),
    "records between two outputs are late by half of their hold": (
        declared_lag, [(250.0, 0.008), (1000.0, 0.0095), (100.0, 0.008)]),
    "only parameters of no robot explain a log": (no_robot, [
        (0.10, 0.120, 1, None), (0.10, 0.130, 1, False), (0.10, 0.170, 500, None), (0.10, 0.180, 500, False),
        (0.45, 0.48, 1, None), (0.45, 0.52, 1, True), (1e-15, 1e-12, 1, None)]),
    "a joint of another delay": (
        lambda distance: len(set(_shared(np.array([10.0, 10.0, 10.0 + distance * np.sqrt(1.5)]), np.eye(3))[1])),
        [(2.9, 1), (3.1, 2)]),
    "a slope of the torques": (
        lambda off, sigma: len(slope_findings(compared(slope=1.0 + off, sigma=sigma))),
        [(0.0048, 0.0, 0), (0.0052, 0.0, 1), (0.058, 0.01, 0), (0.062, 0.01, 1)]),
    "IDIM-LS explains a log better": (
        lambda error, torque: len(worse_findings(compared(error=error, torque=torque), np.ones(1))),
        [(1.45, 1.0, 0), (1.55, 1.0, 1), (2.0, 340.0, 0), (2.0, 330.0, 1)]),
    "a condition number that is too large": (
        lambda number: builder.solved_status(stub(stopped=False, converged=True, condition_number=number)),
        [(0.9e10, Status.SOLVED), (1.1e10, Status.ILL_CONDITIONED)]),
    "a load that another log does not carry": (
        lambda mass: builder.load_finding(Load(mass, 1.0, explained=0.5), "is heavier").grade,
        [(2.9, "note"), (3.1, "doubtful")]),
    "a mass that a log shows": (
        lambda length: load_of(length).mass_or_none is not None, [(0.9875, False), (0.9925, True)]),
    "a gain of a law that is clear of noise": (
        lambda deviations: supports(10.0 * (PATTERN / PATTERN.std(ddof=1) + deviations / np.sqrt(10.0))),
        [(2.2, False), (2.32, True)]),
    "a gain of a law that is worth a parameter": (
        lambda nats, rows: supports(np.linspace(0.9, 1.1, 10) * nats / 10.0, rows),
        [(2.9, 1e3, False), (3.1, 1e3, True), (19.0, 2e4, False), (21.0, 2e4, True)]),
    "a law gains in each third of a log": (
        lambda last: supports(np.array([2.0, 2.1, 1.9, 2.0, 2.0, 2.1, 1.9, 2.0, 2.0, last])), [(-4.1, False), (-3.9, True)]),
    "a law that the log tells from links": (told, [
        ("atan", 0.5, 0.029, True), ("atan", 0.5, 0.031, False), ("hold", 0.0, 0.5, True),
        ("spring", 0.095, 0.0, False), ("spring", 0.105, 0.5, True)]),
    "an offset that differs by a twentieth of the residual": (offset_differs, [(0.048, False), (0.052, True)]),
}
# fmt: on
"""Judgements by name: a function, and rows of what it is given with what it says, a little below and above each number."""


@pytest.mark.parametrize(
    ("judge", "given", "expected"),
    [
        pytest.param(judge, row[:-1], row[-1], id=f"{name} {number}")
        for name, (judge, rows) in TURNS.items()
        for number, row in enumerate(rows)
    ],
)
def test_a_judgement_turns(judge: Callable[..., Any], given: tuple[Any, ...], expected: object) -> None:
    assert judge(*given) == expected
