"""Logs whose controller reads noisy positions: the torque then contains the encoder noise.

The law is linear: a controller that reads ``q + n`` gives the torque of one that reads ``q``, less ``kp n + kv dn/dt``, with the
backward difference of the noise. That torque is fed forward, with linear interpolation between the controller's samples, and
the closed loop is simulated with steps of one sample. Tested in ``tests/test_study.py``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .._tools.arrays import Array
from ..errors import StudyError
from ..experiment.experiment import Experiment
from ..experiment.loop import closed_loop
from ..log.recording import Recording


def measured_in_loop(experiment: Experiment, x: Array, seed: int, rate_hz: float) -> Experiment:
    """Simulate a log whose controller reads the noisy encoders.

    Parameters
    ----------
    experiment : Experiment
        Without a recording; its ``[measurement]`` has the noise.
    x : (n_parameters,) array
        Standard parameters: the truth.
    seed : int
        Seed of the noise.
    rate_hz : float
        Samples of the controller per second, a multiple of the rate of the log.

    Returns
    -------
    Experiment
        Experiment with one recording, joint side.

    Raises
    ------
    StudyError
        For a controller that is not a plain PD, encoders with a resolution, or a rate that is not a multiple.
    ExperimentError
        When the run does not reach its end.
    """
    loop = closed_loop(experiment)
    controller, measurement = loop.controller, experiment.measurement
    if measurement is None or not measurement.position_noise:
        raise StudyError("noise_in_loop_hz needs position_noise in [measurement]")
    plain = controller.digital is None and controller.feedforward is None and not controller.laws[:, 2].any()
    if not plain or np.isfinite(controller.saturation).any() or measurement.encoder_resolution:
        raise StudyError(
            "noise_in_loop_hz is for a continuous PD without saturation and feed-forward, and encoders without a resolution: for "
            "others the noise in the loop is not a torque of its own"
        )
    per_record = round(rate_hz / loop.rate_hz)
    if per_record < 1 or abs(per_record * loop.rate_hz - rate_hz) > 1e-9 * rate_hz:
        raise StudyError(
            f"noise_in_loop_hz must be a multiple of the {loop.rate_hz:g} Hz of the log, got {rate_hz:g}"
        )
    rng = np.random.default_rng(seed)
    shape = ((loop.n_records - 1) * per_record + 1, experiment.robot.n_dof)
    noise = rng.standard_normal(shape) * np.asarray(measurement.position_noise)
    speed = np.diff(noise, axis=0, prepend=noise[:1]) * rate_hz
    torque = -(controller.laws[:, 0] * noise + controller.laws[:, 1] * speed) * controller.gain
    driven = replace(loop, controller=controller.with_feedforward(torque, rate_hz=rate_hz)).even(
        1.0 / rate_hz
    )
    arrays, outcomes = driven.run(x[None])
    if not outcomes[0].completed:
        raise StudyError(f"{experiment.name}: the log cannot be simulated: the run {outcomes[0]}")
    q, tau = arrays[0][0] + noise[::per_record], arrays[3][0]
    if measurement.torque_noise:
        tau = tau + rng.standard_normal(tau.shape) * np.asarray(measurement.torque_noise)
    recording = Recording.from_arrays(q, tau, rate_hz=loop.rate_hz, name="simulated log")
    robot = experiment.simulated_robot
    return replace(experiment, robot=robot, recordings=(recording,))
