"""Descriptions of references, controllers, simulations and measurements in an experiment file.

Tested in ``tests/test_closed_loop.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._tools.arrays import Array
from .._tools.settings import one_of
from ..errors import ExperimentError
from ..log.recording import Recording
from ..loop.closed_loop import DIVERGENCE
from ..loop.controller import Controller
from ..loop.memory import ControllerMemory
from ..loop.reference import Reference
from ..robot.robot import Robot
from ..signal.filters import differentiate
from ..signal.processing import SignalProcessing


@dataclass(frozen=True)
class ReferenceSpec:
    """Description of a reference in a file.

    Attributes
    ----------
    kind : str
        "recorded", "measured", "fourier" or "point-to-point".
    made : Reference or None
        The motion, if it does not depend on a recording.
    settings : Mapping
        The table, for the record of a result.
    """

    kind: str
    made: Reference | None
    settings: Mapping[str, Any]

    def build(
        self, recording: Recording | None, window: tuple[int, int] | None, signal: SignalProcessing
    ) -> Reference:
        """Return the motion for a window of a recording, with time 0 at its first sample.

        Raises
        ------
        ExperimentError
            When the recording is missing, or has no reference.
        """
        if self.made is not None:
            return self.made
        if recording is None:
            raise ExperimentError(
                f"the reference is {self.kind!r}, the motion of a recording, and this simulation is made without one"
            )
        start, stop = window or (0, len(recording.q))
        if self.kind == "recorded":
            if recording.q_ref is None:
                raise ExperimentError(
                    f"recording {recording.name!r} has no reference positions: add [recording.reference], or say "
                    "kind = 'measured' to follow the filtered measured positions"
                )
            return Reference.sampled(recording.q_ref[start:stop], rate_hz=recording.rate_hz)
        q, _, _ = differentiate(recording.measured_positions()[start:stop], recording.rate_hz, signal)
        return Reference.sampled(q, rate_hz=recording.rate_hz)


@dataclass(frozen=True)
class ControllerSpec:
    """Description of a controller in a file; gains may need the inertia along the reference.

    Attributes
    ----------
    build : callable
        Function that makes the controller for a reference.
    settings : Mapping
        The table, for the record of a result.
    sample_time_s : float
        Time between two outputs (s); zero for a continuous controller.
    """

    build: Callable[[Reference], Controller]
    settings: Mapping[str, Any]
    sample_time_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class SimulationSettings:
    """Settings of the simulation of the closed loop.

    Attributes
    ----------
    step_s : float or None
        Largest step (s).
    fine_step_s : tuple of float or None
        Largest step where the velocity of a joint is near zero (s), one for all joints or one per joint. These times are those
        of the measured motion, raw or filtered, if it reveals them, otherwise those of the reference.
    rate_hz : float or None
        Records per second of a run without a recording, which has its own; 1000 by default.
    duration_s : float or None
        Length of a run without a recording; that of the reference by default.
    smoothing : tuple of float or None
        Velocity of ``tanh`` friction per joint (rad/s or m/s) in simulations and regressors along them; by default the friction
        of the robot.
    divergence : float
        Tracking error (rad or m) that ends a run.
    start : {"measured", "reference"} or None
        State at time 0: the filtered measured one, or that of the reference. By default measured if the reference comes from a
        recording, which may begin in motion, and otherwise that of the reference.
    controller_start : {"log", "balance", "zero"} or None
        Integrators and delayed outputs at time 0: those that reproduce the measured torques, those of static balance with the
        simulated parameters, or zero. By default "log" if the recording has torques, otherwise "balance".
    controller_state : ControllerMemory or None
        The exact state at the beginning of the recording or of the run, which replaces `controller_start`.
    integrator : {"rk4", "imex"}
        Classical Runge-Kutta, or the method with implicit friction.
    """

    step_s: float | None = None
    fine_step_s: float | Sequence[float] | None = None
    rate_hz: float | None = None
    duration_s: float | None = None
    smoothing: tuple[float, ...] | None = None
    divergence: float = DIVERGENCE
    start: str | None = None
    controller_start: str | None = None
    controller_state: ControllerMemory | None = None
    integrator: str = "rk4"

    def __post_init__(self) -> None:
        if self.start is not None:
            one_of("start", self.start, ("measured", "reference"), ExperimentError)
        if self.controller_start is not None:
            one_of("controller_start", self.controller_start, ("log", "balance", "zero"), ExperimentError)
            if self.controller_state is not None:
                raise ExperimentError("give controller_start or controller_state, not both")

    def robot(self, robot: Robot) -> Robot:
        """Return the robot of the simulation: with smooth friction, if the settings say so."""
        return robot if self.smoothing is None else robot.with_smoothing(self.smoothing)


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Noise and quantisation of simulated measurements, joint side.

    Attributes
    ----------
    encoder_resolution, position_noise, torque_noise : tuple of float
        Step of the encoders (rad or m), standard deviation of position noise, and of torque noise (N.m or N), per joint.
    seed : int
        Seed of NumPy's default generator.
    """

    encoder_resolution: tuple[float, ...] = ()
    position_noise: tuple[float, ...] = ()
    torque_noise: tuple[float, ...] = ()
    seed: int = 0

    def measure(self, q: Array, tau: Array) -> tuple[Array, Array]:
        """Return positions and torques with noise and quantisation; `q` and `tau` are (n_samples, n_dof)."""
        for name in ("encoder_resolution", "position_noise", "torque_noise"):
            values = getattr(self, name)
            if len(values) not in (0, q.shape[1]):
                raise ExperimentError(f"{name} needs {q.shape[1]} numbers, one per joint, got {len(values)}")
        rng = np.random.default_rng(self.seed)
        # Both are always drawn, because one setting must not change the noise of the other.
        noise_q, noise_tau = rng.standard_normal((2, *q.shape))
        if self.position_noise:
            q = q + noise_q * np.asarray(self.position_noise)
        if self.encoder_resolution:
            step = np.asarray(self.encoder_resolution)
            exact = step == 0.0
            q = np.where(exact, q, np.round(q / np.where(exact, 1.0, step)) * step)
        if self.torque_noise:
            tau = tau + noise_tau * np.asarray(self.torque_noise)
        return q, tau
