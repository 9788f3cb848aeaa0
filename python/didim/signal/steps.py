r"""Motion between the steps of encoders.

A rounded position says that the joint is within half a step of it, and the motion between two readings is smooth:

    q' = low pass of q, where it is within half a step of q;  q -+ half a step elsewhere

The low pass is the lowest of three that stays as near the readings as the highest of them does, which shows their noise: that
of rounding is step / sqrt(12). Motion that rounding is no noise of stays as it is. Tested in ``tests/test_position_errors.py``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array
from ..errors import SignalError
from .filters import low_pass
from .processing import SignalProcessing

DIVISORS = (8.0, 4.0, 2.0)
"""Divisors of the cut-off for the low passes."""
LARGEST_DISTANCE = 1.1
"""Largest distance of smoothed positions from the readings, over their noise: further off, motion is lost."""
LARGEST_NOISE = 2.0
"""Largest noise of the readings over that of rounding: beyond it they do not show within which step a joint is."""
FEWEST_STEPS = 60.0
"""Smallest range of a motion in steps: within few of them rounding is no noise, because readings repeat for long."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Positions without the steps of the encoders.

    Attributes
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Low pass of each joint, rad or m.
    follows : ndarray of bool, shape (n_dof,)
        Joints whose motion it follows; the others have the lowest one.
    noise : ndarray, shape (n_dof,)
        Noise of the positions before their rounding (rad or m).
    """

    q: Array
    follows: NDArray[np.bool_]
    noise: Array


def smoothed(q: Array, rate_hz: float, signal: SignalProcessing, step: Array) -> Smoothed:
    """Return recorded positions (n_samples, n_dof) without their steps, (n_dof,), zero where none is seen.

    Raises
    ------
    SignalError
        As `zero_phase_butterworth`.
    """
    cutoff = 0.5 * rate_hz if signal.cutoff_hz is None else signal.cutoff_hz
    passes = [
        low_pass(q, rate_hz, replace(signal, cutoff_hz=cutoff / divisor, form="sections"))
        for divisor in DIVISORS
    ]
    distances = [np.sqrt(np.mean((smooth - q) ** 2, axis=0)) for smooth in passes]
    # The highest low pass takes its share of white noise with it.
    rounding = step / math.sqrt(12.0)
    noise = np.maximum(rounding, distances[-1] / math.sqrt(1.0 - 2.0 * cutoff / DIVISORS[-1] / rate_hz))
    sound = (step > 0.0) & (noise <= LARGEST_NOISE * rounding) & (np.ptp(q, axis=0) >= FEWEST_STEPS * step)
    smooth, follows = passes[0].copy(), np.zeros_like(sound)
    for candidate, distance in zip(passes, distances, strict=True):
        chosen = sound & ~follows & (distance <= LARGEST_DISTANCE * noise)
        smooth[:, chosen] = candidate[:, chosen]
        follows |= chosen
    return Smoothed(smooth, follows, np.sqrt(noise**2 - rounding**2))


def between_steps(q: Array, rate_hz: float, signal: SignalProcessing, step: Array) -> Array:
    """Return positions within half a step of the recorded ones, of a motion as smooth as these allow.

    Parameters
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Recorded positions, joint side, rad or m.
    rate_hz : float
        Sampling rate.
    signal : SignalProcessing
        Filter of the log. Without a cut-off, and with ends of first order, positions stay as they are.
    step : ndarray, shape (n_dof,)
        Step of each encoder (rad or m), zero where it is not seen.

    Returns
    -------
    ndarray, shape (n_samples, n_dof)
        Joint side, rad or m.

    Notes
    -----
    ``test_position_errors.py`` compares with the motion before its rounding, also where a low pass would lose it.
    """
    if signal.cutoff_hz is None or signal.ends == "first-order" or not step.any():
        return q
    try:
        smooth = smoothed(q, rate_hz, signal, step)
    except SignalError:  # the record is too short for so low a filter, or rounding spoils it
        return q
    return np.where(smooth.follows, np.clip(smooth.q, q - 0.5 * step, q + 0.5 * step), q)
