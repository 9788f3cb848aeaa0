"""The momentum observer: torques from outside without accelerations, as a controller would see them.

    p = M(q) dq,    dp/dt = tau + tau_ext + dM/dt dq - N(q, dq)
    r = K / (s + K) tau_ext                              from p, tau and N alone

N is gravity, Coriolis and friction; ``M + N`` are the inverse model, and ``dM/dt dq`` is the derivative of p along the motion at
fixed speed. Every sample uses only those before it. Source: De Luca and Mattone (2003). Tested in ``tests/test_residual.py``.
"""

from __future__ import annotations

import numpy as np

from ..._tools.arrays import Array
from ...model.dynamics import inverse_dynamics
from ...robot.robot import Robot

BANDWIDTH_HZ = 8.0
"""Bandwidth of the observer: a step is followed to 63 % in 20 ms."""
CUTOFF_HZ = 100.0
"""Cut-off of the causal filter that velocities come from; at most a fifth of the rate."""
STEP_S = 1e-4
"""Time along which the derivative of the momentum at fixed speed is taken."""


def observe(
    robot: Robot,
    x: Array,
    q: Array,
    tau: Array,
    rate_hz: float,
    *,
    bandwidth_hz: float = BANDWIDTH_HZ,
    cutoff_hz: float | None = None,
) -> Array:
    """Return the torques from outside that a momentum observer sees, (n_samples, n_dof).

    Parameters
    ----------
    robot : Robot
        The robot.
    x : (n_parameters,) array
        Its standard parameters, with the payload that it has.
    q, tau : (n_samples, n_dof) arrays
        Positions (rad or m) and torques of the motors (N.m or N), joint side.
    rate_hz : float
        Sampling rate.
    bandwidth_hz : float
        Bandwidth of the observer.
    cutoff_hz : float, optional
        Cut-off of the filter of the positions; 100 Hz, and at most a fifth of the rate.
    """
    from scipy.signal import butter, lfilter, lfilter_zi  # half a second

    cutoff = min(CUTOFF_HZ, 0.2 * rate_hz) if cutoff_hz is None else cutoff_hz
    b, a = butter(2, cutoff / (0.5 * rate_hz))
    start = lfilter_zi(b, a)[:, None]

    def filtered(values: Array) -> Array:
        return np.asarray(lfilter(b, a, values, axis=0, zi=start * values[:1])[0])

    # The same filter on all, so that torques and motion stay side by side.
    q, tau = filtered(q), filtered(tau)
    # Between two samples, where the difference of the positions is the velocity.
    dq = _before(np.diff(q, axis=0) * rate_hz)
    q, tau = (_before(0.5 * (values[1:] + values[:-1])) for values in (q, tau))
    still = np.zeros_like(q)

    def momentum(place: Array) -> Array:
        # Without speed there is no friction; gravity and offsets cancel.
        return inverse_dynamics(robot, place, still, dq, x) - inverse_dynamics(robot, place, still, still, x)

    p = momentum(q)
    turning = (momentum(q + STEP_S * dq) - momentum(q - STEP_S * dq)) / (2.0 * STEP_S)
    known = tau + turning - inverse_dynamics(robot, q, dq, still, x)
    # r' = K (dp/dt - known - r), by backward differences, each beside the difference of p.
    known = _before(0.5 * (known[1:] + known[:-1]))
    share = 1.0 / (1.0 + 2.0 * np.pi * bandwidth_hz / rate_hz)
    driving = _before(np.diff(p, axis=0) * rate_hz) - known
    return np.asarray(lfilter([1.0 - share], [1.0, -share], driving, axis=0, zi=share * driving[:1])[0])


def _before(values: Array) -> Array:
    """Return the values with the first of them repeated, as many as there are samples."""
    return np.vstack([values[:1], values])
