"""Noise of joints at rest, and derivatives at the ends of a record: what the edges of a log must not decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim import CLOE, IDIMLS, Experiment, Recording, SignalProcessing, identify
from didim.experiment.specs import SimulationSettings
from didim.loop.controller import Controller
from didim.loop.reference import Reference
from didim.signal.filters import central_differences
from didim.signal.noise import encoder_noise, encoder_step, stamp_noise, white_noise
from didim.signal.processing import Form

pytestmark = pytest.mark.usefixtures("without_verdict")

Array = NDArray[np.float64]

COUNT = 2.0 * np.pi / 2**17
"""Step of an encoder (rad)."""
COARSE = 2.0 * np.pi / 2**13
"""Step of the encoder of a joint that is held stiffly (rad): it shows nothing of what the other joint does to it."""


def test_a_joint_at_rest_has_the_noise_of_its_encoder() -> None:
    t = np.arange(4000) / 1000.0
    moving = 0.5 * np.sin(2.0 * np.pi * t)
    resting = np.where(t < 3.6, 0.3, 0.3 + 0.2 * (1.0 - np.cos(2.0 * np.pi * (t - 3.6) / 0.4)))
    noise = white_noise(np.round(np.column_stack([moving, resting]) / COUNT) * COUNT)
    # The rounding of an encoder is uniform over one count.
    np.testing.assert_allclose(noise, COUNT / np.sqrt(12.0), rtol=0.35)
    still = np.zeros((100, 1))
    assert white_noise(still)[0] > 0.0


def test_encoder_noise_includes_rounding_that_fifth_differences_do_not_show() -> None:
    t = np.arange(500) / 100.0
    steady = 4.0 * COARSE * np.arange(500.0)
    q = np.column_stack([np.round(np.sin(np.pi * t) / COARSE) * COARSE, steady])
    assert white_noise(q)[1] < 1e-3 * COARSE
    np.testing.assert_allclose(
        encoder_noise(q), [COARSE / np.sqrt(12.0), 4.0 * COARSE / np.sqrt(12.0)], rtol=0.35
    )


def test_noise_of_time_stamps_grows_with_the_speed_and_that_of_encoders_does_not() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(8000) / 1000.0

    def positions(t: Array) -> Array:
        return np.column_stack([0.8 * np.sin(2.0 * np.pi * 0.4 * t), 0.5 * np.cos(2.0 * np.pi * 0.7 * t)])

    encoder = 1e-5 * rng.standard_normal((t.size, 2))
    for size in (1e-4, 3e-4):
        taken = t + size * rng.standard_normal(t.size)
        assert stamp_noise(positions(taken) + encoder, 1000.0) == pytest.approx(size, rel=0.1)
    # What is left is the error of a share of noise, a tenth of that of the encoder at full speed.
    assert stamp_noise(positions(t) + encoder, 1000.0) < 0.3 * 1e-5 / 2.0
    assert stamp_noise(positions(t), 1000.0) < 1e-9
    assert stamp_noise(np.zeros((100, 2)), 1000.0) == 0.0


def test_noise_that_is_not_quantised_is_as_before() -> None:
    rng = np.random.default_rng(0)
    smooth = np.sin(np.arange(5000) / 200.0)[:, None] + 1e-4 * rng.standard_normal((5000, 2)) * [1.0, 10.0]
    np.testing.assert_allclose(white_noise(smooth), [1e-4, 1e-3], rtol=0.05)


@pytest.fixture(scope="module")
def one_joint_at_a_time() -> tuple[Experiment, Array]:
    """A planar arm whose second joint rests on one count of its encoder in nine tenths of the log."""
    robot = didim.load_robot("planar2")
    rate, t = 500.0, np.arange(0.0, 10.0, 0.002)
    first = 0.8 * np.sin(2.0 * np.pi * 0.5 * t) + 0.3 * np.sin(2.0 * np.pi * 1.7 * t)
    inside = np.clip((t - 9.0) / 1.0, 0.0, 1.0)
    second = 0.6 * np.sin(2.0 * np.pi * 2.0 * inside) * np.sin(np.pi * inside) ** 2
    reference = Reference.sampled(np.column_stack([first, second]), rate_hz=rate)
    experiment = Experiment(
        name="one at a time",
        robot=robot,
        recordings=(),
        reference=reference,
        controller=Controller.tuned([10.0, 30.0], [0.7] * 2, [1.0, 0.2]),
        signal=SignalProcessing(cutoff_hz=60.0, trim_start=50, trim_end=50, decimation=(10,)),
        simulation=SimulationSettings(rate_hz=rate, smoothing=(0.05, 0.05), step_s=1e-3, fine_step_s=5e-4),
    )
    log = didim.simulated_log(experiment, robot.parameter_set("reference"), noise=False, refinement=2)
    (recording,) = log.recordings
    assert recording.tau is not None
    steps = np.array([COUNT, COARSE])
    q = np.round(recording.q / steps) * steps
    noise = np.random.default_rng(1).standard_normal(recording.tau.shape) * [0.2, 0.1]
    recordings = (replace(recording, q=q, tau=recording.tau + noise),)
    return replace(log, recordings=recordings), robot.set_base("reference")


@pytest.mark.slow
def test_cloe_weights_a_resting_joint_by_its_encoder(one_joint_at_a_time: tuple[Experiment, Array]) -> None:
    log, truth = one_joint_at_a_time
    q = log.recordings[0].q
    assert np.mean(np.diff(q[:, 1]) == 0.0) > 0.85
    np.testing.assert_allclose(white_noise(q)[1], COARSE / np.sqrt(12.0), rtol=0.35)
    fit = identify(log, CLOE(start="idim-ls"))
    assert fit.converged
    assert np.max(np.abs(fit.beta - truth) / fit.std) < 3.0
    # Most of its fifth differences are zero: by their median, as in version 0.1.0, it would decide the fit alone.
    median = np.median(np.abs(np.diff(q, 5, axis=0)), axis=0) / 0.6745 / np.sqrt(252.0)
    assert median[1] == 0.0
    wrong = identify(log, CLOE(start="idim-ls", noise=[median[0], 1e-9 * np.ptp(q[:, 1])]))
    assert np.max(np.abs(wrong.beta - truth) / fit.std) > 1000.0


# Derivatives at the ends.


def test_differences_are_exact_for_parabolas_up_to_the_ends() -> None:
    t = np.arange(9)[:, None] * 0.1
    q = 1.0 - 2.0 * t + 3.0 * t**2
    dq = central_differences(q, 0.1)
    np.testing.assert_allclose(dq, -2.0 + 6.0 * t, atol=1e-12)
    # Twice: one-sided differences of first order gave a half and three quarters of the acceleration.
    np.testing.assert_allclose(central_differences(dq, 0.1), 6.0, atol=1e-9)


@pytest.mark.parametrize("cutoff_hz", [None, 200.0, 100.0])
@pytest.mark.parametrize("form", ["sections", "transfer-function"])
def test_windows_without_trimming_spoil_nothing(cutoff_hz: float | None, form: Form) -> None:
    """A log without noise, in eight windows that begin and end in motion, with a filter and without one."""
    robot = didim.load_robot("planar2").with_smoothing((0.2, 0.2))
    reference = Reference.random_fourier(
        harmonics=6,
        period_s=8.0,
        max_position=[1.5, 1.5],
        max_velocity=[4.0, 5.0],
        max_acceleration=[30.0, 40.0],
        seed=2,
    )
    t = np.arange(8000) / 1000.0
    motion = reference.at(t)
    tau = didim.inverse_dynamics(robot, *motion, robot.parameter_set("reference"))
    recording = Recording.from_arrays(motion[0], tau, rate_hz=1000.0)
    windows = tuple((1000 * k, 1000 * (k + 1)) for k in range(8))
    experiment = Experiment(
        name="ends",
        robot=robot,
        recordings=(replace(recording, windows=windows),),
        signal=SignalProcessing(cutoff_hz=cutoff_hz, form=form),
    )
    truth = robot.set_base("reference")
    scale = np.where(truth != 0.0, np.abs(truth), 1.0)
    fit = identify(experiment, IDIMLS())
    assert np.max(np.abs(fit.beta - truth) / scale) < 0.005
    assert fit.overall_relative_error < 1e-3
    # A plain odd extension, and differences of first order, have wrong accelerations there.
    first = replace(experiment, signal=replace(experiment.signal, ends="first-order"))
    worst = np.max(np.abs(identify(first, IDIMLS()).beta - truth) / scale)
    assert worst > 10.0 * np.max(np.abs(fit.beta - truth) / scale)
    # The same rows in validation.
    assert didim.validate(fit, experiment).recordings[0].direct_overall == pytest.approx(
        fit.overall_relative_error
    )


@pytest.mark.parametrize("counts", [256, 4096, 65536])
@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_the_step_of_an_encoder_is_read_off_its_positions(counts: int, rate_hz: float) -> None:
    t = np.arange(int(10 * rate_hz)) / rate_hz
    q = np.stack([1.2 * np.sin(2.1 * t) + 0.4 * np.sin(7.3 * t), 0.8 * np.sin(3.3 * t + 1.0)], axis=1)
    step = 2.0 * np.pi / counts
    counted = np.round(q / step + 0.3) * step
    np.testing.assert_allclose(encoder_step(counted), step, rtol=1e-9)
    printed = np.deg2rad(np.round(np.rad2deg(counted), 4))
    np.testing.assert_allclose(encoder_step(printed), step, rtol=1e-3)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(q.shape)
    assert not encoder_step(q).any()
    assert not encoder_step(q + noise).any()
    assert not encoder_step(np.zeros((100, 2))).any()
