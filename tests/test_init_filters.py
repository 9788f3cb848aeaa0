"""The filters that ``didim init`` proposes: the band of the motion in spite of jitter and steps, and the best cut-off of three."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.experiment.draft_filters import choose_filters
from didim.log.recording import Recording
from didim.log.resampling import resampling
from didim.loop.controller import Controller
from didim.loop.reference import Reference
from didim.signal.spectrum import contiguous_band
from simulated import experiment

pytestmark = pytest.mark.usefixtures("without_verdict")

Array = NDArray[np.float64]
ROBOT = didim.load_robot("planar2").with_friction(coulomb="tanh", smoothing_rad_s=0.01)
X = ROBOT.parameter_set("reference")
TRUTH = ROBOT.base_parameters.project(X)
RATE = 1000.0


@pytest.fixture(scope="module")
def clean() -> Recording:
    """Twenty seconds of a closed loop; the highest harmonic of the reference has 0.9 Hz."""
    rng = np.random.default_rng(2)
    sine, cosine = rng.uniform(-0.12, 0.12, (2, 9, 2))
    reference = Reference.fourier(sine, cosine, period_s=10.0, duration_s=20.0)
    run = didim.simulate(ROBOT, X, reference, Controller.pd(kp=[900.0, 300.0], kv=[60.0, 20.0]), rate_hz=RATE)
    tau = run.tau + 0.05 * rng.standard_normal(run.tau.shape)
    q_ref = reference.at(run.t)[0]
    return Recording.from_arrays(run.q, tau, rate_hz=RATE, q_ref=q_ref)


@pytest.fixture(scope="module")
def slow() -> Recording:
    """Twenty-one seconds with harmonics up to 0.4 Hz."""
    rng = np.random.default_rng(2)
    sine, cosine = rng.uniform(-0.25, 0.25, (2, 4, 2))
    reference = Reference.fourier(sine, cosine, period_s=10.0, duration_s=21.0)
    run = didim.simulate(ROBOT, X, reference, Controller.pd(kp=[900.0, 300.0], kv=[60.0, 20.0]), rate_hz=RATE)
    return Recording.from_arrays(run.q, run.tau, rate_hz=RATE)


def degraded(recording: Recording, what: str) -> Recording:
    rng = np.random.default_rng(7)
    q = recording.q
    if what == "jitter":  # positions taken up to 2 ms away from their stamps
        t = np.arange(len(q)) / RATE + 2e-3 * rng.uniform(-1.0, 1.0, len(q))
        q = np.column_stack([np.interp(t, np.arange(len(q)) / RATE, column) for column in q.T])
    elif what == "steps":
        q = np.round(q / 2e-3) * 2e-3
    elif what == "noise":
        q = q + 3e-4 * rng.standard_normal(q.shape)
    return replace(recording, q=q)


@pytest.mark.parametrize("what", ["clean", "jitter", "steps", "noise"])
def test_the_band_is_that_of_the_motion(clean: Recording, what: str) -> None:
    """0.9 Hz by the reference; by the positions a little more, and not 100 Hz."""
    log = degraded(clean, what)
    reason = choose_filters(ROBOT, [log], comparable=True).reason
    assert reason.startswith("the reference moves below")
    assert 0.5 < float(reason.split("below ")[1].split(" Hz")[0]) < 1.2
    assert contiguous_band(log) == pytest.approx(1.275, abs=0.001)  # whatever was done to the log
    other = choose_filters(ROBOT, [replace(log, q_ref=None)], comparable=True)
    assert other.reason.startswith("the motion stands out of the noise below")
    assert len(other.errors) == 3


@pytest.mark.usefixtures("without_alarm")
@pytest.mark.parametrize("what", ["clean", "jitter", "steps", "noise"])
def test_the_filters_work(clean: Recording, what: str) -> None:
    """The fit with them is as good as with the best of a row of cut-offs, within a fifth."""
    log = replace(degraded(clean, what), q_ref=None)
    filters = choose_filters(ROBOT, [log], comparable=True)

    def error(signal: didim.SignalProcessing) -> float:
        fit = didim.identify(experiment(ROBOT, log, signal=signal), didim.IDIMLS())
        q, dq, ddq = clean.q[500:-500:20], *derivatives(clean)
        predicted = didim.inverse_dynamics(ROBOT, q, dq, ddq, ROBOT.base_parameters.lift(fit.beta))
        expected = didim.inverse_dynamics(ROBOT, q, dq, ddq, X)
        return float(np.linalg.norm(predicted - expected) / np.linalg.norm(expected))

    chosen = error(filters.signal)
    others = didim.SignalProcessing(trim_start=200, trim_end=200, decimation=(10,))
    row = [error(replace(others, cutoff_hz=cutoff)) for cutoff in (5.0, 10.0, 20.0, 40.0, 80.0, 160.0)]
    assert chosen < max(1.2 * min(row), 0.01), (filters, chosen, row)


@pytest.mark.parametrize(
    ("rounding", "noise"), [(0.0, 0.0), (1e-3, 0.0), (3e-3, 0.0), (0.0, 3e-4), (0.0, 1e-3)]
)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_jittered_stamps_do_not_widen_the_band(
    slow: Recording, rounding: float, noise: float, seed: int
) -> None:
    """20 000 samples in 21 s with jitter of a tenth of the step, made even; and the same as a logged reference."""
    rng = np.random.default_rng(seed)
    t = np.r_[0.0, np.cumsum(1.05e-3 * (1.0 + 0.1 * rng.uniform(-1.0, 1.0, 19_999)))]
    t = t[t < slow.t[-1]]
    assert slow.tau is not None
    signals = [
        np.column_stack([np.interp(t, slow.t, column) for column in values.T])
        for values in (slow.q, slow.tau)
    ]
    q = signals[0] + noise * rng.standard_normal(signals[0].shape)
    q = np.round(q / rounding) * rounding if rounding else q
    tau = signals[1] + 0.3 * rng.standard_normal(q.shape)
    plan = resampling(t + 1.05e-4 * rng.uniform(-1.0, 1.0, len(t)), None, "log.csv")
    log = Recording.from_arrays(plan.apply(q), plan.apply(tau), rate_hz=plan.rate_hz)
    assert contiguous_band(log) == pytest.approx(0.81, abs=0.01)
    for recording, begin in ((log, "the motion stands"), (replace(log, q_ref=log.q), "the reference moves")):
        filters = choose_filters(ROBOT, [recording], comparable=False)
        assert filters.reason.startswith(begin)
        assert float(filters.reason.split("below ")[1].split(" Hz")[0]) < 0.82
        assert (filters.signal.cutoff_hz or 0.0) < 20.0
        assert filters.signal.decimation  # down to rows of a few times the band


def test_vibration_far_above_the_motion_is_not_motion(slow: Recording) -> None:
    """A line at 29 Hz with 4 % of the velocity's power, as a real wrist has it: noise parts it from the motion."""
    t = np.arange(len(slow.q)) / RATE
    line = 0.2 * np.std(np.gradient(slow.q, 1.0 / RATE, axis=0), axis=0) * np.sqrt(2.0) / (2 * np.pi * 29.0)
    q = slow.q + line * np.sin(2 * np.pi * 29.0 * t)[:, None]
    q = q + 1e-5 * np.random.default_rng(0).standard_normal(q.shape)
    assert contiguous_band(replace(slow, q=q)) == pytest.approx(contiguous_band(slow), rel=0.1)


def derivatives(recording: Recording) -> tuple[Array, Array]:
    dq = np.gradient(recording.q, 1.0 / RATE, axis=0)
    ddq = np.gradient(dq, 1.0 / RATE, axis=0)
    return dq[500:-500:20], ddq[500:-500:20]


def test_the_reason_says_what_was_compared(clean: Recording) -> None:
    filters = choose_filters(ROBOT, [clean], comparable=True)
    assert "held-out torque error, rms over joints, " in filters.reason
    assert filters.signal.cutoff_hz in [cutoff for cutoff, _ in filters.errors]
    without = choose_filters(ROBOT, [replace(clean, tau=None)], comparable=False)
    assert without.reason.endswith("cut-offs were not compared")
    short = Recording.from_arrays(clean.q[:100], clean.tau[:100], rate_hz=RATE)  # type: ignore[index]
    assert choose_filters(ROBOT, [short], comparable=True).errors == ()
