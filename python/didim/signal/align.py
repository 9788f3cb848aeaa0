"""Alignment of motion and torque when one was recorded late. Tested in ``tests/test_delay.py``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import FitError

# Neighbours of a sample that cubic interpolation takes: one before, two after.
CUBIC = (-1, 0, 1, 2)


@dataclass(frozen=True, kw_only=True)
class DelaySettings:
    """What to do about a delay of the torque.

    Parameters
    ----------
    compensate_samples : float or "estimate"
        Move the torque back by so many samples of its recording (a fraction is interpolated; positive: the
        torque was recorded late), or by what the estimate finds.

    Raises
    ------
    FitError
        For a value that is neither.
    """

    compensate_samples: float | Literal["estimate"] = 0.0

    def __post_init__(self) -> None:
        value = self.compensate_samples
        if value == "estimate":
            return
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise FitError(f"compensate_samples must be a number or 'estimate', got {value!r}")


def align(motion: Sequence[Array], tau: Array, delay_samples: float) -> tuple[tuple[Array, ...], Array]:
    """Move the torque back by its delay, and leave out the samples for which none is left.

    Parameters
    ----------
    motion : sequence of ndarray, shape (n_samples, n_dof)
        Position, velocity, acceleration.
    tau : ndarray, shape (n_samples, n_dof)
        Torque as recorded.
    delay_samples : float
        Positive when the torque was recorded late. Fractions are interpolated by a cubic through four
        samples.

    Returns
    -------
    motion : tuple of ndarray
        Shortened.
    tau : ndarray
        ``tau[k]`` belongs to ``motion[k]``.

    Raises
    ------
    FitError
        When the record is not longer than the delay.

    Notes
    -----
    ``test_delay.py`` moves a cubic exactly.
    """
    if delay_samples == 0.0:
        return tuple(motion), tau
    whole = math.floor(delay_samples)
    fraction = delay_samples - whole
    offsets = CUBIC if fraction else (0,)
    weights = _lagrange(fraction) if fraction else (1.0,)
    n_samples = tau.shape[0]
    # Motion samples k for which every tau[k + whole + offset] exists.
    first = max(0, -(whole + offsets[0]))
    last = min(n_samples, n_samples - (whole + offsets[-1]))
    if last <= first:
        raise FitError(
            f"a record of {counted(n_samples, 'sample')} is too short to compensate a delay of "
            f"{delay_samples:g} samples"
        )
    moved = np.zeros((last - first, *tau.shape[1:]))
    for offset, weight in zip(offsets, weights, strict=True):
        moved += weight * tau[first + whole + offset : last + whole + offset]
    return tuple(values[first:last] for values in motion), moved


def _lagrange(fraction: float) -> tuple[float, ...]:
    """Weights of the samples at -1, 0, 1, 2 for the value at ``fraction``."""
    return tuple(
        math.prod((fraction - other) / (node - other) for other in CUBIC if other != node) for node in CUBIC
    )
