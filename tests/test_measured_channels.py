"""Measured velocities and external torques: where they are in a recording, every method takes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import didim
from arm import arm_log
from didim.experiment.experiment import Experiment
from didim.experiment.loop import closed_loop
from didim.log.recording import Recording
from didim.loop.controller import Controller
from didim.loop.reference import Reference
from didim.signal.window import motion_of
from simulated import RATE_HZ, experiment, log, motion

pytestmark = pytest.mark.usefixtures("without_verdict")

ROBOT = didim.load_robot("planar2").with_friction(coulomb="tanh", smoothing_rad_s=0.05)
X = ROBOT.parameter_set("reference")


def test_external_torques_are_part_of_what_the_model_explains() -> None:
    """IDIM-LS finds the robot again where the push is known, and does not where it is taken for the robot's own."""
    plain = log(ROBOT, X)
    assert plain.tau is not None
    push = 5.0 * np.sin(motion(2, len(plain.q), seed=9))
    pushed = replace(plain, tau=plain.tau - push)
    truth = ROBOT.base_parameters.project(X)
    known = didim.identify(experiment(ROBOT, replace(pushed, external=push)), didim.IDIMLS())
    unknown = didim.identify(experiment(ROBOT, pushed), didim.IDIMLS())
    scale = np.abs(truth).max()
    assert np.abs(known.beta - truth).max() < 1e-6 * scale
    assert np.abs(unknown.beta - truth).max() > 0.05 * scale


@pytest.mark.slow
def test_the_simulated_loop_is_pushed_too() -> None:
    """DIDIM on a simulated log with a known push; without it the closed loop moves otherwise."""
    reference = Reference.fourier(
        0.3 * np.array([[1.0, 0.5], [0.4, 1.0]]), np.zeros((2, 2)), period_s=4.0, duration_s=8.0
    )
    controller = Controller.pd(kp=[300.0, 100.0], kv=[30.0, 10.0])
    t = np.arange(4001) / RATE_HZ
    push = np.column_stack([6.0 * np.sin(2.0 * t), 3.0 * np.cos(3.0 * t)])
    run = didim.simulate(ROBOT, X, reference, controller, rate_hz=RATE_HZ, external=(RATE_HZ, push))
    recording = Recording.from_arrays(run.q, run.tau, rate_hz=RATE_HZ)
    signal = didim.SignalProcessing(cutoff_hz=40.0, trim_start=25, trim_end=25, decimation=(5,))
    made = {
        "robot": ROBOT,
        "signal": signal,
        "reference": reference,
        "controller": controller,
    }
    known = Experiment(name="known", recordings=(replace(recording, external=push[: len(run.q)]),), **made)  # type: ignore[arg-type]
    unknown = Experiment(name="unknown", recordings=(recording,), **made)  # type: ignore[arg-type]
    truth = ROBOT.base_parameters.project(X)
    fit = didim.identify(known, didim.DIDIM(start="reference"))
    assert fit.status.converged
    assert np.abs(fit.beta - truth).max() < 0.01 * np.abs(truth).max()
    assert fit.overall_relative_error < 0.002
    assert didim.identify(unknown, didim.DIDIM(start="reference")).overall_relative_error > 0.1


def test_measured_velocities_take_the_place_of_differences() -> None:
    """A coarse encoder beside a good tachometer: the viscous friction is nearer to the truth."""
    plain = log(ROBOT, X, n_samples=4000)
    q = np.round(plain.q / 2e-3) * 2e-3
    exact = np.gradient(plain.q, 1.0 / RATE_HZ, axis=0)
    noise = np.random.default_rng(0).standard_normal(exact.shape)
    coarse = replace(plain, q=q)
    better = replace(coarse, dq=exact + 1e-4 * noise)
    truth = ROBOT.base_parameters.project(X)
    errors = [
        np.linalg.norm(didim.identify(experiment(ROBOT, item), didim.IDIMLS()).beta - truth)
        for item in (coarse, better)
    ]
    assert errors[1] < 0.3 * errors[0]


def test_channels_of_another_shape_are_refused() -> None:
    plain = log(ROBOT, X, n_samples=200)
    with pytest.raises(didim.errors.RecordingError, match="dq and q differ in shape"):
        replace(plain, dq=plain.q[:-1])
    with pytest.raises(didim.errors.RecordingError, match="external and q differ in shape"):
        replace(plain, external=plain.q[:, :1])


def test_a_simulation_starts_with_the_measured_velocity() -> None:
    """A window that begins in motion: differences of the positions and the measured velocity are told apart by a constant."""
    log = arm_log(1)
    log = replace(log, simulation=replace(log.simulation, start="measured"))
    (recording,) = log.recordings
    window = (100, len(recording.q))
    q, dq, _ = motion_of(recording, window, log.signal)
    shifted = replace(recording, dq=np.gradient(recording.q, 1.0 / recording.rate_hz, axis=0) + 0.25)
    differences = closed_loop(log, recording, window).start
    measured = closed_loop(log, shifted, window).start
    assert differences is not None
    assert measured is not None
    np.testing.assert_allclose(differences, (q[0], dq[0]))
    np.testing.assert_allclose(measured[0], q[0])
    np.testing.assert_allclose(np.subtract(measured[1], dq[0]), 0.25, atol=0.02)
