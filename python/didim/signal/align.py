"""Alignment of motion with torques that were recorded late, or held by a digital controller. Tested in ``tests/test_delay.py``.

A digital controller holds each output for its sample time T. The motion responds to this staircase, which lags the logged
output by half a step: the model torque from differentiated positions is the mean of the steps before and after a sample. The
logged torque is therefore early by T/2 relative to measured motion, or by half a sample if the log is faster than the
controller. Simulated motion needs no such shift, because its accelerations result from the torque that starts at the sample.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from .._tools.arrays import Array
from .._tools.settings import real_number
from .._tools.words import counted
from ..errors import FitError

Shift = float | Sequence[float]
"""Shift of the torques towards earlier samples, in samples: of all joints, or of each."""

CUBIC = (-1, 0, 1, 2)
"""Offsets of the samples that cubic interpolation uses: one before, two after."""


@dataclass(frozen=True, kw_only=True)
class DelaySettings:
    """Compensation of a torque delay.

    Parameters
    ----------
    compensate_samples : float, sequence of float, "hold" or "estimate"
        Delay in samples of the recording, of all joints or of each, by which the torque is moved back (fractions are
        interpolated; positive: the torque was recorded late). "hold", the default, compensates for the hold of the experiment's
        digital controller along measured motion, if there is one. "estimate" adds an estimated delay.

    Raises
    ------
    FitError
        For a value that is none of these.
    """

    compensate_samples: float | Sequence[float] | Literal["hold", "estimate"] = "hold"

    def __post_init__(self) -> None:
        value = self.compensate_samples
        if isinstance(value, str) and value in ("hold", "estimate"):
            return
        values: Any = value if isinstance(value, Sequence | np.ndarray) else (value,)
        numbers = tuple(map(real_number, values))
        if not numbers or not all(map(math.isfinite, numbers)):
            raise FitError(
                f"compensate_samples must be a number, one per joint, 'hold' or 'estimate', got {value!r}"
            )
        if values is value:
            object.__setattr__(self, "compensate_samples", numbers)


def hold_samples(sample_time_s: float, rate_hz: float) -> float:
    """Return the lead of a held torque relative to measured motion, in samples of the log.

    Parameters
    ----------
    sample_time_s : float
        Sample time of the digital controller (s); zero for a continuous one.
    rate_hz : float
        Rate of the log.

    Returns
    -------
    float
        Half the sample time, or half a sample if the log is faster than the controller.

    Notes
    -----
    ``test_hold.py`` fits logs slower and faster than the controller.
    """
    return 0.5 * min(sample_time_s * rate_hz, 1.0)


def align(motion: Sequence[Array], tau: Array, delay_samples: Shift) -> tuple[tuple[Array, ...], Array]:
    """Move the torque back by its delay, and drop the samples that then lack a torque.

    Parameters
    ----------
    motion : sequence of ndarray, shape (n_samples, ...)
        Position, velocity, acceleration.
    tau : ndarray, shape (n_samples, n_dof)
        Torque as recorded.
    delay_samples : float or sequence of float
        Positive when the torque was recorded late; one for all joints, or one for each. Fractions are interpolated by a
        cubic through four samples.

    Returns
    -------
    motion : tuple of ndarray
        Shortened.
    tau : ndarray
        ``tau[k]`` belongs to ``motion[k]``.

    Raises
    ------
    FitError
        When the record is not longer than the delay, or the number of delays is not that of the joints.

    Notes
    -----
    ``test_delay.py`` moves a cubic exactly, joints by different delays too.
    """
    delays = tuple(delay_samples) if isinstance(delay_samples, Sequence) else (delay_samples,) * tau.shape[1]
    if len(delays) != tau.shape[1]:
        raise FitError(f"compensate_samples has {counted(len(delays), 'number')} for {tau.shape[1]} joints")
    if not any(delays):
        return tuple(motion), tau
    moves = [_move(delay) for delay in delays]
    n_samples = tau.shape[0]
    # Motion samples k for which every tau[k + whole + offset] exists.
    first = max(0, *(-(whole + offsets[0]) for whole, offsets, _ in moves))
    last = min(n_samples, *(n_samples - (whole + offsets[-1]) for whole, offsets, _ in moves))
    if last <= first:
        raise FitError(
            f"a record of {counted(n_samples, 'sample')} is too short to compensate a delay of "
            f"{max(delays, key=abs):g} samples"
        )
    moved = np.zeros((last - first, *tau.shape[1:]))
    common = len(set(delays)) == 1
    for joint, (whole, offsets, weights) in enumerate(moves[:1] if common else moves):
        columns = slice(None) if common else joint
        for offset, weight in zip(offsets, weights, strict=True):
            moved[:, columns] += weight * tau[first + whole + offset : last + whole + offset, columns]
    return tuple(values[first:last] for values in motion), moved


def _move(delay: float) -> tuple[int, tuple[int, ...], tuple[float, ...]]:
    """Return the whole samples of a delay, and offsets and weights for the interpolation of its fraction."""
    whole = math.floor(delay)
    fraction = delay - whole
    return (whole, CUBIC, _lagrange(fraction)) if fraction else (whole, (0,), (1.0,))


def _lagrange(fraction: float) -> tuple[float, ...]:
    """Return the weights of the samples at -1, 0, 1, 2 for the value at ``fraction``."""
    return tuple(
        math.prod((fraction - other) / (node - other) for other in CUBIC if other != node) for node in CUBIC
    )
