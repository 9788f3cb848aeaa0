"""The momentum observer: external torques without accelerations, as available to a controller.

    p = M(q) dq,    dp/dt = tau + tau_ext + dM/dt dq - N(q, dq)
    r = K / (s + K) tau_ext                              from p, tau and N alone

N contains gravity, Coriolis and friction; ``M + N`` are the inverse model, and ``dM/dt dq`` is the derivative of p along the
motion at constant speed. The observer is causal. An error dt of a time stamp shifts all positions by speed times dt; its effect
on the observer is the momentum times the observer's response to dt. Source: De Luca and Mattone (2003). Tested in
``tests/test_residual.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array
from ...model.dynamics import inverse_dynamics
from ...robot.robot import Robot

BANDWIDTH_HZ = 8.0
"""Bandwidth (Hz) of the observer: it follows a step to 63 % in 20 ms."""
CUTOFF_HZ = 100.0
"""Cut-off (Hz) of the causal filter of the velocities; at most a fifth of the sampling rate."""
STEP_S = 1e-4
"""Time (s) of the finite difference of the momentum at constant speed."""


@dataclass(frozen=True, eq=False)
class Observed:
    """Signals of a momentum observer.

    Attributes
    ----------
    torque : (n_samples, n_dof) array
        External torques (N.m or N).
    momentum : (n_samples, n_dof) array
        Generalised momentum ``M(q) dq`` (kg.m^2/s or kg.m/s).
    """

    torque: Array
    momentum: Array


def observe(
    robot: Robot, x: Array, q: Array, tau: Array, rate_hz: float, *, bandwidth_hz: float = BANDWIDTH_HZ
) -> Observed:
    """Return the external torques estimated by a momentum observer.

    Parameters
    ----------
    robot : Robot
        The robot.
    x : (n_parameters,) array
        Its standard parameters, including its payload.
    q, tau : (n_samples, n_dof) arrays
        Positions (rad or m) and torques of the motors (N.m or N), joint side.
    rate_hz : float
        Sampling rate.
    bandwidth_hz : float
        Bandwidth of the observer.
    """
    # The same filter on all, so that torques and motion stay side by side.
    q, tau = _filtered(q, rate_hz), _filtered(tau, rate_hz)
    # Between two samples, where the difference of the positions is the velocity.
    dq = _before(np.diff(q, axis=0) * rate_hz)
    q, tau = (_before(0.5 * (values[1:] + values[:-1])) for values in (q, tau))
    still = np.zeros_like(q)

    def momentum(p: Array) -> Array:
        # Without speed there is no friction; gravity and offsets cancel.
        return inverse_dynamics(robot, p, still, dq, x) - inverse_dynamics(robot, p, still, still, x)

    p = momentum(q)
    turning = (momentum(q + STEP_S * dq) - momentum(q - STEP_S * dq)) / (2.0 * STEP_S)
    known = tau + turning - inverse_dynamics(robot, q, dq, still, x)
    # r' = K (dp/dt - known - r), by backward differences, each beside the difference of p.
    known = _before(0.5 * (known[1:] + known[:-1]))
    driving = _before(np.diff(p, axis=0) * rate_hz) - known
    return Observed(low_pass(driving, rate_hz, bandwidth_hz), p)


def low_pass(values: Array, rate_hz: float, bandwidth_hz: float) -> Array:
    """Return torques filtered as by the observer, (n_samples, n): ``K / (s + K)`` by backward differences."""
    from scipy.signal import lfilter  # half a second

    share = 1.0 / (1.0 + 2.0 * np.pi * bandwidth_hz / rate_hz)
    return np.asarray(lfilter([1.0 - share], [1.0, -share], values, axis=0, zi=share * values[:1])[0])


def stamp_gain(rate_hz: float, bandwidth_hz: float) -> float:
    """Return the standard deviation of the observer's torque per unit of momentum for white noise of the time stamps (1/s^2).

    It is the gain from position noise to the twice differentiated and filtered positions, by the impulse response.
    """
    length = 16 + round(8.0 * rate_hz / min(bandwidth_hz, _cutoff(rate_hz)))
    impulse = np.zeros((length, 1))
    impulse[4] = 1.0
    speed = _before(np.diff(_filtered(impulse, rate_hz), axis=0) * rate_hz)
    response = low_pass(_before(np.diff(speed, axis=0) * rate_hz), rate_hz, bandwidth_hz)
    return float(np.sqrt(np.sum(response**2)))


def _cutoff(rate_hz: float) -> float:
    """Cut-off of the filter of positions and torques: `CUTOFF_HZ`, and at most a fifth of the rate."""
    return min(CUTOFF_HZ, 0.2 * rate_hz)


def _filtered(values: Array, rate_hz: float) -> Array:
    """Filter signals, (n_samples, n), causally, as if they had rested at their first values before."""
    from scipy.signal import butter, lfilter, lfilter_zi  # half a second

    b, a = butter(2, _cutoff(rate_hz) / (0.5 * rate_hz))
    return np.asarray(lfilter(b, a, values, axis=0, zi=lfilter_zi(b, a)[:, None] * values[:1])[0])


def _before(values: Array) -> Array:
    """Return the preceding values: shifted by one sample, the first one repeated."""
    return np.vstack([values[:1], values])
