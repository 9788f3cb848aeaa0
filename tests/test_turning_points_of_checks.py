"""Each check of a log turns where its documentation says: a little below the number one way, a little above the other.

The numbers stand here as they are documented, so that a threshold which is doubled or halved is noticed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.diagnosis.bandwidth import check_bandwidth
from didim.diagnosis.channels import Channel, _clipped, _coarse, _jumps, _stuck
from didim.diagnosis.check import FEWEST_SPIKES, _causes
from didim.diagnosis.limits import check_limits
from didim.diagnosis.reference import _joint, _quiet, _recording
from didim.diagnosis.sampled import time_findings
from didim.evidence.hypotheses.hypothesis import best_factor
from didim.evidence.lasting import joint_delay_findings
from didim.evidence.residual import spike_findings
from didim.evidence.standstill import check_standstill
from didim.log.sampling import TimeFault
from plain import stub

Array = NDArray[np.float64]


@pytest.mark.parametrize(("least", "told"), [(0.975, True), (0.985, False)])
def test_a_factor_that_leaves_two_per_cent_less_is_refined(least: float, told: bool) -> None:
    def squares(factor: float) -> Array:
        return np.array([least + (1.0 - least) * (np.log(factor) / np.log(0.9) - 1.0) ** 2])

    found, at_end = best_factor(squares)
    assert found == pytest.approx(0.9 if told else 1.0, abs=0.01)
    assert not at_end


@pytest.mark.parametrize("best", [0.1, 10.0])
def test_a_factor_beyond_the_list_is_an_end_of_it(best: float) -> None:
    found, at_end = best_factor(lambda factor: np.array([1.0 + np.log(factor / best) ** 2]))
    assert at_end
    assert found == (0.3 if best < 1.0 else 3.3)


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


@pytest.mark.parametrize(("share", "same"), [(0.6e-9, True), (1.6e-9, False)])
def test_a_reference_that_is_the_position(share: float, same: bool) -> None:
    q = wave()
    assert (_joint(q, q + share * beside(q), 100.0)[0] == "same") == same


@pytest.mark.parametrize(("share", "kind"), [(0.9e-3, "constant"), (1.1e-3, "unrelated")])
def test_a_reference_that_does_not_move(share: float, kind: str) -> None:
    q = wave()
    assert _joint(q, share * beside(q), 100.0)[0] == kind


@pytest.mark.parametrize(("correlation", "unrelated"), [(0.48, True), (0.52, False)])
def test_a_reference_of_another_joint(correlation: float, unrelated: bool) -> None:
    q = wave()
    ref = correlation * q + np.sqrt(1.0 - correlation**2) * beside(q)
    assert (_joint(q, ref, 100.0)[0] == "unrelated") == unrelated


@pytest.mark.parametrize(("explained", "late"), [(0.89, False), (0.91, True)])
def test_a_late_copy(explained: float, late: bool) -> None:
    q = wave()
    dq = np.gradient(q) * 100.0
    rest = beside(dq)
    size = 0.05 * np.linalg.norm(dq) * np.sqrt((1.0 - explained) / explained) / np.linalg.norm(rest)
    assert (_joint(q, q - 0.05 * dq + size * rest, 100.0)[0] == "late") == late


@pytest.mark.parametrize(("power", "quiet"), [(0.27, True), (0.33, False)])
def test_a_smoothed_copy(power: float, quiet: bool) -> None:
    rng = np.random.default_rng(0)
    n = 80_000

    def band(low: float, high: float) -> Array:
        bins = np.fft.rfft(rng.standard_normal(n))
        edges = np.arange(len(bins)) / len(bins)
        return np.asarray(np.fft.irfft(np.where((edges >= low) & (edges < high), bins, 0.0), n))

    assert _quiet(band(0.0, 0.3), np.sqrt(power) * band(0.0, 0.3) + band(0.3, 1.0)) == quiet


@pytest.mark.parametrize(("share", "quiet"), [(0.7e-3, True), (1.5e-3, False)])
def test_the_band_of_a_motion_has_all_but_a_thousandth_of_its_power(share: float, quiet: bool) -> None:
    k = np.arange(20_000)
    q = np.sin(2.0 * np.pi * 0.01 * k) + np.sqrt(share) * np.sin(2.0 * np.pi * 0.4 * k)
    error = np.diff(np.random.default_rng(0).standard_normal(len(k) + 1))
    assert _quiet(q, error) == quiet


@pytest.mark.parametrize(("samples", "told"), [(199, 0), (200, 1)])
def test_a_reference_needs_a_window_of_200_samples(samples: int, told: int) -> None:
    q = wave(samples)[:, None]
    log = stub(q_ref=q, windows=[(0, samples)], rate_hz=100.0, name="log", measured_positions=lambda: q)
    assert len(list(_recording(log))) == told


def channel(values: Array, what: Any = "position") -> Channel:
    return Channel(what, 1, "joint", stub(name="log", rate_hz=100.0), None, None, values)


@pytest.mark.parametrize(("samples", "told"), [(7, 0), (8, 1)])
def test_an_encoder_is_stuck_for_eight_samples(samples: int, told: int) -> None:
    values = wave()
    values[1000 : 1000 + samples] = values[1000]
    assert len(_stuck(channel(values))) == told


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


@pytest.mark.parametrize(("top", "next_to_it", "told"), [(7, 1, 0), (8, 1, 1), (29, 10, 0), (31, 10, 1)])
def test_a_torque_is_clipped(top: int, next_to_it: int, told: int) -> None:
    values = np.concatenate([np.linspace(-1.0, 0.5, 200), np.full(next_to_it, 0.9), np.full(top, 1.0)])
    assert len(_clipped(channel(values, "torque"))) == told


@pytest.mark.parametrize(("levels", "told"), [(99, 1), (100, 0)])
def test_a_channel_of_few_values(levels: int, told: int) -> None:
    assert len(_coarse(channel(np.arange(1000.0) % levels))) == told


def standing(slow: float, length: int, count: int) -> list[Any]:
    """Return a window of 1000 samples at 100 Hz with stretches of so many samples at a share of the top speed."""
    dq = np.ones((1000, 1))
    for k in range(count):
        dq[100 * k : 100 * k + length] = slow
    return [stub(q=np.zeros((1000, 1)), dq=dq, rate_hz=100.0)]


@pytest.mark.parametrize(
    ("slow", "length", "count", "told"),
    [
        (0.0045, 60, 1, 1),
        (0.0055, 60, 1, 0),
        (0.0, 9, 8, 0),
        (0.0, 11, 8, 1),
        (0.0, 48, 1, 0),
        (0.0, 52, 1, 1),
    ],
)
def test_standstill(slow: float, length: int, count: int, told: int) -> None:
    robot = didim.load_robot("emps")
    assert len(check_standstill(robot, standing(slow, length, count))) == told


@pytest.mark.parametrize(("loss", "told"), [(0.019, 0), (0.021, 1)])
def test_a_recording_that_is_too_slow(loss: float, told: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("didim.diagnosis.bandwidth._loss", lambda recording, joint, cutoff: loss)
    log = stub(q=np.zeros((10, 1)), rate_hz=100.0, name="log")
    found = check_bandwidth(stub(recordings=[log], signal=stub(cutoff_hz=None)))
    assert len(found) == told
    if told:  # a tenth of the loss, rounded up: 100 Hz times the root of 0.021 / 0.002
        assert "Record at 500 Hz" in found[0].advice


@pytest.mark.parametrize(
    ("samples", "gain", "told"), [(0.19, 0.5, 0), (0.21, 0.5, 1), (2.0, 0.048, 0), (2.0, 0.052, 1)]
)
def test_late_torques(samples: float, gain: float, told: int) -> None:
    estimate = stub(joints=[samples, samples], gain=gain, differs=False)
    assert len(joint_delay_findings(estimate, np.zeros(2), 100.0)) == told


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


@pytest.mark.parametrize(("count", "told"), [(2, 0), (3, 1)])
def test_three_spikes_are_told(count: int, told: int) -> None:
    tau = np.random.default_rng(0).standard_normal((2000, 1))
    tau[200 + 300 * np.arange(count)] += 100.0
    found = spike_findings([stub(tau=tau)], stub(spikes=None), FEWEST_SPIKES)
    assert len(found) == told
