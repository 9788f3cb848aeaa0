"""Logs made of the inverse dynamic model, for tests of what is done with logs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from didim import _core
from didim.experiment.experiment import Experiment
from didim.experiment.specs import Measurement, SimulationSettings
from didim.log.recording import Recording, Role
from didim.loop.controller import Controller
from didim.loop.reference import Reference
from didim.robot.robot import Robot
from didim.signal.filters import differentiate
from didim.signal.processing import SignalProcessing
from didim.studies.simulated_log import simulated_log

Array = NDArray[np.float64]

RATE_HZ = 500.0
SIGNAL = SignalProcessing(cutoff_hz=40.0, trim_start=25, trim_end=25, decimation=(5,))


def motion(n_dof: int, n_samples: int, seed: int = 0, late_samples: float = 0.0) -> Array:
    """Return joint positions (n_samples, n_dof) of a few sines each, ``late_samples`` samples late."""
    rng = np.random.default_rng(seed)
    t = (np.arange(n_samples) - late_samples) / RATE_HZ
    frequency = 2.0 * np.pi * np.array([0.31, 0.57, 0.83, 1.27, 1.91])
    amplitude = rng.uniform(0.2, 0.6, (5, n_dof))
    phase = rng.uniform(0.0, 2.0 * np.pi, (5, n_dof))
    return np.asarray((amplitude * np.sin(t[:, None, None] * frequency[:, None] + phase)).sum(axis=1))


def log(
    robot: Robot,
    x: Array,
    *,
    n_samples: int = 3000,
    seed: int = 0,
    noise: float = 0.0,
    name: str = "log",
    role: Role = "fit",
    signal: SignalProcessing = SIGNAL,
) -> Recording:
    """Recording with the model's torques at the motion that the signal processing will find, plus noise."""
    q = motion(robot.n_dof, n_samples, seed)
    tau = np.asarray(_core.inverse_dynamics(robot.core, *differentiate(q, RATE_HZ, signal), x))
    tau = tau + noise * np.random.default_rng(seed + 1000).standard_normal(tau.shape)
    return Recording.from_arrays(q, tau, rate_hz=RATE_HZ, name=name, role=role)


def closed_loop_log(
    robot: Robot,
    x: Array,
    seed: int = 1,
    torque_noise: float = 0.0,
    period_s: float = 4.0,
    duration_s: float = 4.0,
) -> Experiment:
    """Simulated log of a robot of any shape in closed loop: random Fourier series, tuned gains, friction as tanh."""
    n = robot.n_dof
    reference = Reference.random_fourier(
        harmonics=8, period_s=period_s, duration_s=duration_s,
        max_position=[1.0] * n, max_velocity=[4.0] * n, max_acceleration=[40.0] * n, seed=seed,
    )  # fmt: skip
    planned = Experiment(
        name="planned",
        robot=robot,
        recordings=(),
        reference=reference,
        controller=Controller.tuned([8.0] * n, [0.7] * n, [0.5] * n),
        signal=SignalProcessing(cutoff_hz=50.0, trim_start=25, trim_end=25, decimation=(10,)),
        simulation=SimulationSettings(
            rate_hz=500.0, smoothing=(0.02,) * n, step_s=1e-3, fine_step_s=5e-4, start="reference"
        ),
        measurement=Measurement(
            torque_noise=(torque_noise,) * n, position_noise=(1e-2 * torque_noise,) * n, seed=seed
        )
        if torque_noise
        else None,
    )
    return simulated_log(planned, x, noise=torque_noise > 0.0, refinement=1)


def experiment(robot: Robot, *recordings: Recording, signal: SignalProcessing = SIGNAL) -> Experiment:
    """Experiment without a file."""
    return Experiment(name="simulated", robot=robot, recordings=recordings, signal=signal)
