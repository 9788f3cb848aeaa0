"""Logs of arms whose friction has a law that the fitted model may lack, for tests and benches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

import didim
from didim.log.recording import Recording
from didim.loop.reference import Reference
from didim.model.memory import state
from didim.result.identification import Identification
from didim.robot.robot import Robot
from didim.signal.processing import SignalProcessing
from simulated import experiment
from verdict_arms import INDEPENDENT

Array = NDArray[np.float64]
Law = Callable[[Array, Array, Array, Array], Array]
"""Friction beside Coulomb's (N.m) at positions, velocities, torques of links and Coulomb friction of the joints."""

SMOOTHING = 0.02
NOISE = np.array([0.1, 0.11])
"""Standard deviation of the noise over the Coulomb friction of its joint: of the first one, of all others."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot, its standard parameters, and the limits of its motion."""

    robot: Robot
    x: Array
    motion: dict[str, Any]

    @property
    def fc(self) -> Array:
        """Coulomb friction of the joints (N.m)."""
        names = self.robot.parameter_names
        return np.array([self.x[names.index(f"Fc{joint + 1}")] for joint in range(self.robot.n_dof)])


@cache
def subject(arm: str = "planar2") -> Subject:
    """Return the packaged planar2 or tx40, or an arm of the verdict's benches."""
    if arm in INDEPENDENT:
        built = INDEPENDENT[arm]
        plain, reach = built.load(), built.reach
        x, speed, acceleration = built.truth(plain), built.speed, built.acceleration
        more = {"offset": built.offset}
    else:
        plain, more = didim.load_robot(arm), {}
        x = plain.parameter_set({"planar2": "reference", "tx40": "didim_physical"}[arm])
        n = plain.n_dof
        reach, speed, acceleration = ((1.5,) * n, (4.0, *(5.0,) * (n - 1)), (30.0, *(40.0,) * (n - 1)))
    limits = {"max_position": reach, "max_velocity": speed, "max_acceleration": acceleration, **more}
    return Subject(plain.with_smoothing([SMOOTHING] * plain.n_dof), x, limits)


def robot(arm: str = "planar2") -> Robot:
    return subject(arm).robot


def sign(dq: Array) -> Array:
    return np.asarray(np.tanh(dq / SMOOTHING))


def coulomb(q: Array, dq: Array, rigid: Array, fc: Array) -> Array:
    return np.zeros_like(dq)


def stribeck(share: float, velocity: float = 0.15) -> Law:
    return lambda q, dq, rigid, fc: np.asarray(share * fc * sign(dq) * np.exp(-((dq / velocity) ** 2)))


def atan(share: float, velocity: float = 0.3) -> Law:
    return lambda q, dq, rigid, fc: np.asarray(share * fc * np.arctan(dq / velocity))


def load(share: float) -> Law:
    return lambda q, dq, rigid, fc: np.asarray(share * np.abs(rigid) * sign(dq))


def dahl(width: float) -> Law:
    return lambda q, dq, rigid, fc: np.asarray(fc * (state(q, width) - sign(dq)))


def lugre(width: float, share: float = 0.3, velocity: float = 0.15) -> Law:
    """Memory and Stribeck friction together, from sample to sample."""

    def law(q: Array, dq: Array, rigid: Array, fc: Array) -> Array:
        height = 1.0 + share * np.exp(-((dq / velocity) ** 2))
        z = np.zeros_like(q)
        for k, change in enumerate(np.diff(q, axis=0)):
            kept = np.exp(-np.abs(change) / (width * height[k]))
            z[k + 1] = height[k] * np.sign(change) * (1.0 - kept) + kept * z[k]
        return np.asarray(fc * (z - sign(dq)))

    return law


def fitted(law: Law, seed: int, **settings: object) -> Identification:
    """Identify a log of the robot with Coulomb friction."""
    return didim.identify(logged(robot(), law, seed, **settings), didim.IDIMLS())  # type: ignore[arg-type]


def logged(
    fitted_robot: Robot,
    law: Law,
    seed: int,
    *,
    draw: int = 0,
    noise: str = "white",
    rate_hz: float = 500.0,
    counts: int = 0,
    of: str = "planar2",
) -> didim.Experiment:
    """Return a log of 10 s whose friction has a law beside Coulomb's, made at eight times the rate."""
    fine, arm, x = 8, subject(of).robot, subject(of).x
    reference = Reference.random_fourier(harmonics=15, period_s=10.0, seed=seed, **subject(of).motion)
    q, dq, ddq = reference.at(np.arange(int(10.0 * rate_hz) * fine) / (rate_hz * fine))
    names = arm.parameter_names
    frictionless = np.array([0.0 if name[:2] in ("Fv", "Fc", "Of") else 1.0 for name in names]) * x
    rigid = didim.inverse_dynamics(arm, q, dq, ddq, frictionless)
    fc = subject(of).fc
    tau = didim.inverse_dynamics(arm, q, dq, ddq, x) + law(q, dq, rigid, fc)
    q, tau = q[::fine], tau[::fine]
    sigma = NOISE[np.minimum(np.arange(arm.n_dof), 1)] * fc
    rng = np.random.default_rng([seed, draw, 77])
    errors = rng.standard_normal((tau.shape[0] + 2000, arm.n_dof))
    if noise == "correlated":
        errors = lfilter([np.sqrt(1.0 - 0.95**2)], [1.0, -0.95], errors, axis=0)
    if counts:
        step = 2.0 * np.pi / counts
        q = np.round(q / step + 0.3) * step
    recording = Recording.from_arrays(q, tau + sigma * errors[2000:], rate_hz=rate_hz, name="log")
    signal = SignalProcessing(
        cutoff_hz=min(50.0, 0.4 * rate_hz),
        trim_start=25,
        trim_end=25,
        decimation=(max(2, round(rate_hz / 50)),),
    )
    return experiment(fitted_robot, recording, signal=signal)


def truth(arm: str = "planar2") -> Array:
    """Return the true base parameters of the robot."""
    return np.asarray(robot(arm).base_parameters.project(subject(arm).x))
