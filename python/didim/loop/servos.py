"""Position servos that follow a held reference: ``tau = sat(kp (r(t - delay) - q) - kv dq)``, a lag of first order before it.

Gains, limits, delays, lags, biases, initial states and the softness of friction differ between the candidates of one batch. The
reference enters each step of the simulation as its mean over the step (``rust/src/closed_loop/servo.rs``), and its jumps end steps.
Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import didim._core as _core

from .._tools.arrays import Array
from .._tools.threads import core_threads
from ..errors import CoreErrorsAs, SimulationError
from ..robot.robot import Robot
from .closed_loop import ClosedLoop
from .controller import Controller
from .outcome import outcomes_of
from .reference import Reference

NO_LIMIT = 1e30
"""Limit (N.m, N) of a servo without one: the core takes finite numbers only."""
SETTLED = 40.0
"""Duration of a lag's transient, in time constants: exp(-40) is below the rounding of a double."""


@dataclass(frozen=True, eq=False)
class Held:
    """A reference with a zero-order hold.

    Attributes
    ----------
    values : (n_samples, n_dof) array
        Positions (rad or m), the first at and before time 0.
    rate_hz : float
        Samples per second.
    """

    values: Array
    rate_hz: float

    def jumps(self, delay_s: float) -> list[float]:
        """Return the times (s) at which a joint's reference jumps, delay included."""
        changed = np.flatnonzero(np.any(np.diff(self.values, axis=0) != 0.0, axis=1)) + 1
        return [float(k) / self.rate_hz + delay_s for k in changed]

    def means(
        self, edges: Array, delay_s: Array, lag_s: Array, acceleration: Array | float = np.inf
    ) -> Array:
        """Return means between edges (s), (n_edges - 1, n_dof), after the delay and lag of each joint, (n_dof,).

        Joints whose set-point has a finite largest `acceleration` (rad/s^2 or m/s^2), (n_dof,), have no lag.
        """
        out = np.empty((len(edges) - 1, self.values.shape[1]))
        limits = np.broadcast_to(acceleration, out.shape[1])
        for joint, (delay, lag, most) in enumerate(zip(delay_s, lag_s, limits, strict=True)):
            if np.isfinite(most):
                area = _core.set_point_areas(self.values[:, joint], self.rate_hz, most, edges - delay)
            else:
                area = self._area(joint, edges - delay, float(lag))
            out[:, joint] = np.diff(area) / np.diff(edges)
        return out

    def _area(self, joint: int, t: Array, lag: float) -> Array:
        """Return the integral of a joint's lagged reference from time 0 to times, (n_times,)."""
        r, period = self.values[:, joint], 1.0 / self.rate_hz
        at = np.clip(np.floor(t * self.rate_hz).astype(np.int64), 0, len(r) - 1)
        since = t - at * period
        if lag <= 0.0:
            below = np.concatenate([[0.0], np.cumsum(r)[:-1]]) * period
            return np.asarray(below[at] + r[at] * since)
        # Within a sample the lagged reference is r + (f - r) exp(-s / lag), f its value at the sample.
        keep = np.exp(-period / lag)
        f = np.empty_like(r)
        f[0] = r[0]
        for k in range(1, len(r)):
            f[k] = r[k - 1] + (f[k - 1] - r[k - 1]) * keep
        inside = lag * (1.0 - keep) * (f - r)
        below = np.concatenate([[0.0], np.cumsum(r * period + inside)[:-1]])
        grown = 1.0 - np.exp(-np.clip(since, 0.0, SETTLED * lag) / lag)
        return np.asarray(below[at] + r[at] * since + lag * grown * (f - r)[at])


@dataclass(frozen=True, eq=False)
class Servos:
    """Parameters of the candidates' servos, (n_candidates, n_dof) each, joint side, SI units.

    Attributes
    ----------
    kp, kv, saturation : array
        Gains, and limit of the torque; infinite without one.
    delay_s, lag_s : array
        Delay and lag of the reference (s).
    bias_rad : array
        Encoder reading less joint position.
    q, dq : array
        Encoder readings at time 0, and velocities.
    softness : array or float
        Slope k (kg.m^2 or kg) of friction ``-k (ddq + b dq)`` between -Fc and Fc, in the place of the robot's smooth sign.
    rate : array or float
        Rate b (1/s) of that friction.
    lead_s : float
        Inertia that a servo adds while it saturates, over kv (s): minus half a step for a simulator that takes kv implicitly.
    begin_s : (n_candidates,) array or float
        Time of the reference (s) at which a candidate begins.
    acceleration : array or float
        Largest acceleration (rad/s^2 or m/s^2) of the set-point that follows the reference; infinite without one.
    """

    kp: Array
    kv: Array
    saturation: Array
    delay_s: Array
    lag_s: Array
    bias_rad: Array
    q: Array
    dq: Array
    softness: Array | float = 0.0
    rate: Array | float = 0.0
    lead_s: float = 0.0
    begin_s: Array | float = 0.0
    acceleration: Array | float = np.inf


class ServoLoop:
    """A robot whose servos follow a held reference: simulates the encoder readings of candidates.

    Parameters
    ----------
    robot : Robot
        The robot.
    reference : Held
        Held reference, with the rate of the records.
    motion : (n_samples, n_dof) array
        Measured positions; steps are fine where their velocity is near zero.
    step_s, fine_step_s : float
        Steps of the integration.
    integrator : {"rk4", "imex"}
        Method of the integration.
    """

    def __init__(
        self,
        robot: Robot,
        reference: Held,
        motion: Array,
        *,
        step_s: float,
        fine_step_s: float,
        integrator: str = "rk4",
    ) -> None:
        self.robot, self.held, n = robot, reference, robot.n_dof
        rate = reference.rate_hz
        self._follow = Reference.sampled(reference.values, rate_hz=rate)
        self._motion = Reference.sampled(motion, rate_hz=rate)
        self._plain = Controller.pd([1.0] * n, [0.0] * n)
        self._options = {
            "rate_hz": rate,
            "duration_s": (len(motion) - 1) / rate,
            "step": step_s,
            "fine_step": fine_step_s,
            "integrator": integrator,
        }
        self._loops: dict[tuple[float, ...], ClosedLoop] = {}

    def ahead(self, count: int) -> ServoLoop:
        """Return the same loop over `count` samples from any time of the reference on, with fine steps throughout."""
        other, still = copy(self), np.zeros((count + 1, self.robot.n_dof))
        other._motion = Reference.sampled(still, rate_hz=self.held.rate_hz)
        other._options = {**self._options, "duration_s": count / self.held.rate_hz}
        other._loops = {}
        return other

    def loop(self, *delays_s: float) -> ClosedLoop:
        """Return the closed loop with steps that end at the jumps of the delayed references."""
        if delays_s not in self._loops:
            jumps = sorted({time for delay_s in delays_s for time in self.held.jumps(delay_s)})
            follow = replace(self._follow, core=self._follow.core.with_breaks(jumps))
            loop = ClosedLoop.of(self.robot, follow, self._plain, **self._options)  # type: ignore[arg-type]
            self._loops = {delays_s: loop.along(self._motion)}
        return self._loops[delays_s]

    def run(
        self, x: Array, servos: Servos, threads: int | None = None, *, every_jump: bool = False
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return encoder readings, (n_candidates, n_records, n_dof), and which runs completed.

        Parameters
        ----------
        x : (n_candidates, n_parameters) array
            Standard parameters.
        servos : Servos
            Parameters of the servos.
        threads : int, optional
            All cores by default.
        every_jump : bool
            Whether the steps of servos that may saturate end at the jumps of most joints of every candidate, not of the first
            alone: during saturation a jump within a step has another impulse than its mean.
        """
        saturates = every_jump and np.isfinite(servos.saturation).any()
        delays_s = np.median(servos.delay_s if saturates else servos.delay_s[:1], axis=1)
        loop = self.loop(*np.unique(delays_s).tolist())
        edges = loop.schedule.edges
        begin = np.broadcast_to(np.reshape(servos.begin_s, (-1, 1)), (len(x), 1))
        most = np.broadcast_to(servos.acceleration, servos.delay_s.shape)
        kinds, number = np.unique(
            np.concatenate([servos.delay_s, servos.lag_s, most, begin], axis=1), axis=0, return_inverse=True
        )
        n = self.robot.n_dof
        targets = np.concatenate(
            [self.held.means(edges + row[-1], row[:n], row[n : 2 * n], row[2 * n : 3 * n]) for row in kinds]
        )
        b = servos.bias_rad
        rows = [
            servos.kp,
            servos.kv,
            np.minimum(servos.saturation, NO_LIMIT),
            b,
            servos.q - b,
            servos.dq,
            *(np.broadcast_to(each, b.shape) for each in (servos.softness, servos.rate, servos.lead_s)),
            number.reshape(-1, 1),
        ]
        with CoreErrorsAs(SimulationError):
            q, endings = _core.simulate_servos(
                loop.core,
                np.ascontiguousarray(x),
                np.concatenate(rows, axis=1),
                targets,
                core_threads(threads),
            )
        completed = np.array([outcome.completed for outcome in outcomes_of(endings)])
        q += b[:, None, :]
        q[~completed] = np.nan
        return q, completed
