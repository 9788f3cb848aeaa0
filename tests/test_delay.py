"""Delay of the torque: moved back exactly for a cubic, and found from the residuals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import simulated
from didim import _core
from didim.diagnosis.check import check
from didim.errors import FitError
from didim.experiment.experiment import Experiment
from didim.log.recording import Recording
from didim.methods.didim.didim import DIDIM
from didim.methods.identify import identify
from didim.methods.idim_ls import IDIMLS
from didim.regression.delay import _Search
from didim.result.identification import Identification
from didim.robot.robot import Robot
from didim.robot.robot_file import load_robot
from didim.signal.processing import SignalProcessing
from didim.signal.window import DelaySettings, align
from didim.studies.prediction import predict
from didim.studies.simulated_log import packaged_experiment, simulated_log

pytestmark = pytest.mark.usefixtures("without_verdict")

# Trimmed far enough that neither edges of the filter nor the interpolation matter.
SIGNAL = replace(simulated.SIGNAL, trim_start=200, trim_end=200)


@pytest.mark.parametrize("delay", [0.0, 1.0, 3.0, -2.0, 0.25, 2.75, -0.5, -3.125])
def test_a_cubic_is_moved_exactly(delay: float) -> None:
    k = np.arange(40.0)
    motion = np.column_stack([k, 2.0 * k])

    def torque(
        at: np.ndarray[tuple[int], np.dtype[np.float64]],
    ) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        return np.column_stack([0.01 * at**3 - at, at**2 + 7.0])

    (moved_motion,), tau = align([motion], torque(k - delay), delay)
    assert moved_motion.shape == tau.shape
    assert len(tau) >= 40 - abs(delay) - 3
    np.testing.assert_allclose(tau, torque(moved_motion[:, 0]), rtol=1e-12, atol=1e-10)


def test_each_joint_is_moved_by_its_own_delay() -> None:
    k = np.arange(40.0)
    late = (0.0, 2.75, -3.5)
    torque = np.column_stack([(k - delay) ** 3 for delay in late])
    (moved_motion,), tau = align([k], torque, late)
    for joint in range(3):
        np.testing.assert_allclose(tau[:, joint], moved_motion**3, rtol=1e-12, atol=1e-9)


def test_no_delay_changes_nothing() -> None:
    tau = np.ones((5, 1))
    motion, same = align([tau], tau, 0.0)
    assert same is tau
    assert motion[0] is tau


@pytest.mark.parametrize("delay", [5.0, -5.0, 3.5])
def test_a_record_shorter_than_the_delay(delay: float) -> None:
    tau = np.ones((4, 1))
    with pytest.raises(FitError, match=r"a record of 4 samples is too short to compensate a delay of"):
        align([tau], tau, delay)


def late_log(robot: Robot, late: float, *, seed: int = 0, noise: float = 0.0, name: str = "log") -> Recording:
    """Recording whose torques are those of the motion ``late`` samples before."""
    x = np.array(robot.sets["reference"])
    # Without dry friction: its jumps, sampled late, are not the same jumps.
    x[[k for k, parameter in enumerate(robot.parameter_names) if parameter.startswith("Fc")]] = 0.0
    step = 1e-3
    q, before, after = (simulated.motion(2, 4000, seed, late + shift) for shift in (0.0, step, -step))
    dq = (after - before) / (2.0 * step) * simulated.RATE_HZ
    ddq = (after - 2.0 * q + before) / step**2 * simulated.RATE_HZ**2
    tau = np.asarray(_core.inverse_dynamics(robot.core, q, dq, ddq, x))
    tau = tau + noise * np.random.default_rng(seed).standard_normal(tau.shape)
    return Recording.from_arrays(simulated.motion(2, 4000, seed), tau, rate_hz=simulated.RATE_HZ, name=name)


@pytest.mark.parametrize("late", [0.0, 4.0, 1.3, -2.6])
@pytest.mark.parametrize("decimation", [(), (5,)])
def test_the_delay_is_found_and_compensated(late: float, decimation: tuple[int, ...]) -> None:
    robot = load_robot("planar2")
    signal = replace(SIGNAL, decimation=decimation)
    exp = simulated.experiment(robot, late_log(robot, late, noise=0.02), signal=signal)
    fit = identify(exp, IDIMLS(compensate_samples="estimate"))
    assert fit.delay["estimated_samples"] == pytest.approx(late, abs=0.05)
    assert fit.delay["estimated_seconds"] == pytest.approx(late / simulated.RATE_HZ, abs=1e-4)
    assert fit.delay["compensated_samples"] == fit.delay["estimated_samples"]
    left = identify(exp)
    assert left.delay == {"compensated_samples": 0.0}
    if late:
        assert fit.overall_relative_error < 0.7 * left.overall_relative_error
    known = identify(exp, IDIMLS(compensate_samples=late))
    assert known.overall_relative_error == pytest.approx(fit.overall_relative_error, rel=0.05)


def test_the_delay_of_several_recordings_with_a_fixed_parameter() -> None:
    robot = load_robot("planar2")
    logs = [late_log(robot, 2.0, seed=seed, name=f"run {seed}") for seed in (1, 2)]
    exp = replace(
        simulated.experiment(robot, *logs, signal=SIGNAL),
        fixed={"Fv1": 1.2},
        dropped=("Fc1", "Fc2"),
        delay=DelaySettings(compensate_samples="estimate"),
    )
    fit = identify(exp)
    assert fit.delay["estimated_samples"] == pytest.approx(2.0, abs=0.05)
    assert "torque recorded +2.0" in str(fit)
    assert "torque moved back by" in str(fit)


@pytest.mark.parametrize("late", [9.7, -9.6])
def test_a_delay_just_inside_the_reach_is_found(late: float) -> None:
    robot = load_robot("planar2")
    exp = simulated.experiment(robot, late_log(robot, late, noise=0.02), signal=SIGNAL)
    fit = identify(exp, IDIMLS(compensate_samples="estimate"))
    assert fit.delay["estimated_samples"] == pytest.approx(late, abs=0.05)


def test_a_delay_beyond_the_margin_counts_as_the_largest(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step of the search may lead there from a delay at the end of the reach."""
    searches: list[_Search] = []
    best = _Search.best

    def watched(search: _Search, reach: int) -> int:
        searches.append(search)
        return best(search, reach)

    monkeypatch.setattr(_Search, "best", watched)
    exp = simulated.experiment(load_robot("planar2"), late_log(load_robot("planar2"), 1.0), signal=SIGNAL)
    identify(exp, IDIMLS(compensate_samples="estimate"))
    search = searches[0]
    for sign in (-1.0, 1.0):
        beyond = search._torques(np.array([sign * (search.margin + 1.0), 0.0]))
        np.testing.assert_array_equal(beyond, search._torques(np.array([sign * (search.margin - 2.0), 0.0])))


@pytest.fixture(scope="module")
def sound() -> Experiment:
    """The packaged experiment with the filter that rounds its reversals."""
    experiment = packaged_experiment("tx40")
    log = simulated_log(experiment, experiment.robot.parameter_set("didim"))
    return replace(log, signal=replace(log.signal, cutoff_hz=60.0))


def shifted(log: Experiment, samples: int, joints: slice) -> Experiment:
    """The log with the torques of some joints recorded late."""
    (recording,) = log.recordings
    assert recording.tau is not None
    tau = recording.tau.copy()
    tau[samples:, joints] = recording.tau[:-samples, joints]
    return replace(log, recordings=(replace(recording, tau=tau),))


@pytest.mark.slow
def test_a_sound_log_has_no_delay_whatever_its_filter(sound: Experiment) -> None:
    fit = identify(sound, IDIMLS(compensate_samples="estimate"))
    assert fit.delay["estimated_samples"] == 0.0
    assert fit.delay["estimated_joints"] == [0.0] * 6
    assert fit.delay["estimated_std_samples"] < 0.05
    assert fit.delay["estimated_cutoff_hz"] > 60.0
    assert "no delay of the torque is significant: 0 +- 0.0" in str(fit)
    # The estimates are those without the wish, and DIDIM's too.
    np.testing.assert_array_equal(fit.beta, identify(sound, IDIMLS()).beta)
    wish = identify(sound, DIDIM(compensate_samples="estimate"))
    np.testing.assert_array_equal(wish.beta, identify(sound, DIDIM()).beta)


def test_one_sample_is_one_sample(sound: Experiment) -> None:
    fit = identify(shifted(sound, 1, slice(None)), IDIMLS(compensate_samples="estimate"))
    assert fit.delay["estimated_samples"] == pytest.approx(1.0, abs=0.05)
    assert len(set(fit.delay["estimated_joints"])) == 1
    off = abs(fit.delay["estimated_samples"] - 1.0) / fit.delay["estimated_std_samples"]
    assert off < 3.0


def test_a_late_wrist_is_compensated_joint_by_joint(sound: Experiment, tmp_path: Path) -> None:
    late = shifted(sound, 2, slice(4, 6))
    fit = identify(late, IDIMLS(compensate_samples="estimate"))
    np.testing.assert_array_equal(fit.delay["compensated_samples"][:4], np.zeros(4))
    np.testing.assert_allclose(fit.delay["compensated_samples"][4:], 2.0, atol=0.1)
    assert "samples after the motion, joint by joint, by estimate" in str(fit)
    best = identify(sound, IDIMLS())
    assert fit.overall_relative_error < 1.01 * best.overall_relative_error
    fit.save(tmp_path / "fit.json")
    restored = Identification.load(tmp_path / "fit.json")
    assert restored.delay == fit.delay
    (prediction,) = predict(restored, late)
    error = np.linalg.norm(prediction.measured - prediction.predicted, axis=0)
    np.testing.assert_allclose(error / np.linalg.norm(prediction.measured, axis=0), fit.relative_error)
    given = identify(late, IDIMLS(compensate_samples=fit.delay["compensated_samples"]))
    np.testing.assert_array_equal(given.beta, fit.beta)


def test_as_many_delays_as_joints(sound: Experiment) -> None:
    with pytest.raises(FitError, match="compensate_samples has 2 numbers for 6 joints"):
        identify(sound, IDIMLS(compensate_samples=[0.0, 1.0]))


def test_a_delay_beyond_reach_is_told() -> None:
    robot = load_robot("planar2")
    exp = simulated.experiment(robot, late_log(robot, 60.0), signal=SIGNAL)
    with pytest.raises(FitError, match=r"no delay within 50 samples \(100 ms\) .* give compensate_samples"):
        identify(exp, IDIMLS(compensate_samples="estimate"))


def test_a_log_that_is_50_ms_late_is_searched_again_and_checked() -> None:
    robot = load_robot("planar2")
    exp = simulated.experiment(robot, late_log(robot, 25.0, noise=0.02), signal=SIGNAL)
    fit = identify(exp, IDIMLS(compensate_samples="estimate"))
    assert fit.delay["estimated_samples"] == pytest.approx(25.0, abs=0.05)
    assert "delay" in {finding.kind for finding in check(exp)}


def test_a_segment_too_short_to_look_for_delays() -> None:
    robot = load_robot("planar2")
    log = Recording.from_arrays(*(simulated.motion(2, 40),) * 2, rate_hz=simulated.RATE_HZ)
    exp = simulated.experiment(robot, log, signal=SignalProcessing(cutoff_hz=None))
    with pytest.raises(FitError, match="a segment of 40 samples is too short to look for delays of up to 10"):
        identify(exp, IDIMLS(compensate_samples="estimate"))


def test_recordings_of_different_rates() -> None:
    robot = load_robot("planar2")
    first = late_log(robot, 0.0)
    assert first.tau is not None
    second = Recording.from_arrays(first.q, first.tau, rate_hz=250.0, name="slow")
    exp = simulated.experiment(robot, first, second, signal=SIGNAL)
    with pytest.raises(FitError, match=r"needs recordings of one rate, got 250, 500 Hz"):
        identify(exp, IDIMLS(compensate_samples="estimate"))


@pytest.mark.parametrize("value", ["estimated", float("inf"), True, None, [], [0.0, "1"]])
def test_wrong_settings(value: object) -> None:
    with pytest.raises(
        FitError, match="compensate_samples must be a number, one per joint, 'hold' or 'estimate', got"
    ):
        DelaySettings(compensate_samples=value)  # type: ignore[arg-type]
