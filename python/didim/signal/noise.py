"""Noise of a log: its size, and its correlation after decimation. Tested in ``tests/test_signals.py``."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from .._tools.arrays import Array, quotient
from ..errors import SignalError
from .filters import DECIMATION_BAND, DECIMATION_RIPPLE_DB
from .processing import SignalProcessing

_CIRCLE = 2048
"""Number of points of a spectrum at the last rate; a correlation has half as many lags."""


CHANGE_ROUNDING = 1e-9
"""Smallest change between values of a signal, as a share of their size or range, that is more than rounding."""
WIDEST_GAP = 50.0
"""Widest gap, in steps, compared with multiples of the step: in wider ones the step's own error dominates."""
LARGEST_DECIMATION = 10_000
"""Upper bound of the product of the decimation factors: the spectrum of decimated noise has 2048 times as many points."""
FEWEST_GAPS = 20
"""Smallest number of gaps between a signal's levels from which its step is estimated."""
ON_GRID = 0.95
"""Smallest share of gaps that must be multiples of the step: by chance it is a fifth."""
MOST_CHANGES = 0.9
"""Largest share of samples that differ from their predecessor in a quantised signal."""


def white_noise(values: Array) -> Array:
    """Estimate the white noise of a log from its fifth differences, which hardly contain motion.

    Samples at which a quantised signal rests are ignored. The estimate is at least the standard deviation of rounding to the
    signal's smallest step: a joint at rest on one encoder count is not known exactly.

    Parameters
    ----------
    values : ndarray, shape (n_samples, n_dof)
        Positions or torques; more than five samples.

    Returns
    -------
    ndarray, shape (n_dof,)
        Standard deviations, in the unit of the values; never zero.

    Notes
    -----
    ``test_cloe.py`` checks it on the noise of a simulated log, ``test_noise.py`` on joints at rest.
    """
    values = np.asfortranarray(values)  # numpy reduces contiguous columns several times as fast
    differences = np.abs(np.diff(values, 5, axis=0))
    # 252 is the sum of the squared binomials.
    spread = np.array([_median_moving(column) for column in differences.T]) / 0.6745 / math.sqrt(252.0)
    ranges = np.ptp(values, axis=0)
    floor = np.maximum(smallest_step(values, ranges) / math.sqrt(12.0), 1e-9 * np.maximum(ranges, 1e-3))
    return np.asarray(np.maximum(spread, floor))


def stamp_noise(q: Array, rate_hz: float) -> float:
    """Estimate the white noise of a log's time stamps: the part of the position noise that grows with the speed.

    A stamp that is late by ``dt`` shifts all positions by speed times ``dt``. Rounded stamps, or those of a busy computer, add
    noise to the velocities and accelerations of fast joints.

    Parameters
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Positions of a window, evenly sampled as far as its stamps say; more than five samples.
    rate_hz : float
        Sampling rate.

    Returns
    -------
    float
        Standard deviation (s); zero if the noise does not grow with the speed.

    Notes
    -----
    Fifth differences d: ``d^2 / 252 = a_j + s^2 dq_j^2`` by least squares, the mean square of each joint as its unit.
    ``test_noise.py`` checks it on
    stamps that were rounded.
    """
    squares = np.diff(q, 5, axis=0) ** 2 / 252.0
    speeds = (0.2 * rate_hz * (q[5:] - q[:-5])) ** 2
    size = squares.mean(axis=0)
    weight = quotient(np.ones_like(size), size)
    rest = (speeds - speeds.mean(axis=0)) * weight
    scale = float(np.sum(rest**2))
    share = float(np.sum(rest * squares * weight)) / scale if scale > 0.0 else 0.0
    return math.sqrt(max(0.0, share))


def _median_moving(differences: Array) -> float:
    """Return the median of the nonzero differences: reversals, where friction jumps, hardly affect it."""
    moving = differences[differences > 0.0]
    return float(np.median(moving)) if moving.size else 0.0


def encoder_step(q: Array) -> Array:
    """Estimate the step of each joint's encoder: the spacing of the grid on which all recorded positions lie.

    Parameters
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Recorded positions, not filtered (rad or m).

    Returns
    -------
    ndarray, shape (n_dof,)
        Step in the unit of the positions; zero if the values do not lie on a grid, as with coupled motors or noisy simulations.

    Notes
    -----
    ``test_noise.py`` estimates the steps of slow and fast quantised motions, and zero for positions that are not quantised.
    """
    return np.array([_grid(column) for column in q.T])


def coarsest_steps(logs: Iterable[Array]) -> Array | None:
    """Return the coarsest `encoder_step` of each joint over recorded positions, (n_dof,); None without any."""
    steps = [encoder_step(q) for q in logs]
    return np.max(steps, axis=0) if steps else None


def encoder_noise(q: Array) -> Array:
    """Estimate the noise of each joint's encoder: the `white_noise`, and at least the rounding to its `encoder_step`.

    Parameters
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Recorded positions, not filtered (rad or m); more than five samples.

    Returns
    -------
    ndarray, shape (n_dof,)
        Standard deviations in the unit of the positions.

    Notes
    -----
    ``test_noise.py`` checks it on quantised motions without noise.
    """
    return np.asarray(np.maximum(white_noise(q), encoder_step(q) / math.sqrt(12.0)))


def _grid(values: Array) -> float:
    # A motion has long runs of rising and falling values, which a stable sort merges.
    levels = np.sort(values, kind="stable")
    scale = max(float(np.ptp(levels)), np.abs(levels).max(initial=0.0))
    gaps = np.diff(levels)
    # Values that are equal, or differ by rounding, are one level.
    gaps = gaps[gaps > CHANGE_ROUNDING * scale]
    if gaps.size < FEWEST_GAPS:
        return 0.0
    smallest = float(np.min(gaps))
    step = float(np.median(gaps[gaps < 1.5 * smallest]))
    for widest in (0.1 * WIDEST_GAP, WIDEST_GAP):
        small = gaps[gaps < widest * step]
        step = float(np.sum(small) / np.sum(np.round(small / step)))
    # Without a grid the gaps are spread evenly, and few are near a multiple of the smallest.
    # Largest distance of a gap from a multiple of the step, in steps, that rounding of printed digits explains.
    on_grid = np.abs(small / step - np.round(small / step)) < 0.1
    return step if small.size >= 0.5 * gaps.size and np.mean(on_grid) > ON_GRID else 0.0


def smallest_step(values: Array, ranges: Array) -> Array:
    """Smallest change from one sample to the next of quantised signals, (n_dof,); zero for signals that are not quantised.

    A signal counts as quantised if at least a tenth of its samples repeat the one before. Changes below 1e-9 of the
    range are rounding.
    """
    steps = np.abs(np.diff(values, axis=0))
    smallest = np.zeros(values.shape[1])
    for joint, (column, size) in enumerate(zip(steps.T, ranges, strict=True)):
        changes = column[column > CHANGE_ROUNDING * size]
        if changes.size and changes.size <= MOST_CHANGES * column.size:
            smallest[joint] = changes.min()
    return smallest


@lru_cache(maxsize=64)  # `check` builds hundreds of linear systems, each of which needs it
def noise_correlation(signal: SignalProcessing) -> Array | None:
    """Autocorrelation of white noise after the decimation, at the lags of the kept samples.

    Parameters
    ----------
    signal : SignalProcessing
        Decimation.

    Returns
    -------
    ndarray, shape (n_lags,), or None
        From lag 0, where it is 1, read-only; None without decimation, which leaves white noise white.

    Raises
    ------
    SignalError
        When all factors together are beyond 10 000.

    Notes
    -----
    The filters act forward and backward, so that the power of the noise is shaped by the fourth power of their
    gain, and each decimation folds what lies beyond the new band. ``test_signals.py`` compares with filtered noise.
    """
    if not signal.decimation:
        return None
    total = _total(signal.decimation)
    power = np.ones(1)
    for factor in reversed(signal.decimation):
        # Spectra at the rate before this stage, on the circle; the later stages act on its folds alike.
        power = np.tile(power, factor) if power.size > 1 else np.ones(_CIRCLE * factor)
        gain = _squared_gain(factor, power.size)
        power *= gain * gain
    folded = power.reshape(total, -1).sum(axis=0)
    correlation = np.fft.ifft(folded).real[: folded.size // 2]
    correlation /= correlation[0]
    correlation.flags.writeable = False
    return np.asarray(correlation)


@lru_cache(maxsize=64)  # the spectra are long
def row_noise(signal: SignalProcessing, rate_hz: float) -> tuple[float, float]:
    """Return the standard deviations of the rows' ``tau`` and ``dq`` for white noise of size one in the log.

    Parameters
    ----------
    signal : SignalProcessing
        Filter of the positions and decimation.
    rate_hz : float
        Rate of the log.

    Returns
    -------
    tau, dq : float
        Factors (1, 1/s): positions are filtered, differentiated and decimated, torques only decimated.

    Raises
    ------
    SignalError
        When all factors of the decimation together are beyond 10 000.

    Notes
    -----
    The power of filtered white noise is the mean of the squared gain over the circle.
    """
    size = _CIRCLE * _total(signal.decimation)
    power = np.ones(size)
    before = 1
    for factor in signal.decimation:
        # The response of a later stage is periodic in its own rate.
        power *= np.tile(_squared_gain(factor, size // before) ** 2, before)
        before *= factor
    angle = 2.0 * np.pi * np.arange(size) / size
    motion = power.copy()
    if signal.cutoff_hz is not None:
        half = np.minimum(angle, 2.0 * np.pi - angle) / 2.0
        with np.errstate(over="ignore"):  # towards half the rate, where the gain vanishes
            warped = np.tan(half) / math.tan(np.pi * signal.cutoff_hz / rate_hz)
            # Forward and backward: the squared gain of one pass is the gain of both.
            motion /= (1.0 + warped ** (2 * signal.order)) ** 2
    slope = (np.sin(angle) * rate_hz) ** 2
    return math.sqrt(power.mean()), math.sqrt((motion * slope).mean())


def _total(factors: tuple[int, ...]) -> int:
    total = math.prod(factors)
    if total > LARGEST_DECIMATION:
        raise SignalError(f"a decimation by {total} in all is too large, {LARGEST_DECIMATION} is possible")
    return total


def _squared_gain(factor: int, size: int) -> Array:
    """Squared gain of the filter before a decimation at ``size`` points of the circle, from DC on."""
    # Chebyshev I: 1 / (1 + e^2 T_8(x)^2), where x is the frequency over the cut-off as the bilinear transform warps both.
    x = np.arange(size // 2 + 1) * (np.pi / size)
    np.tan(x, out=x)  # in place, because the circle is long
    x /= math.tan(0.5 * np.pi * DECIMATION_BAND / factor)
    with np.errstate(over="ignore"):  # towards half the rate, where the gain vanishes
        for _ in range(3):  # T_8(x) = T_2(T_2(T_2(x))), T_2(x) = 2 x^2 - 1
            x *= x
            x *= 2.0
            x -= 1.0
        x *= x
    x *= 10.0 ** (0.1 * DECIMATION_RIPPLE_DB) - 1.0
    gain = 1.0 / (1.0 + x)
    # The other half of the circle mirrors this one.
    return np.concatenate([gain, gain[-2 if size % 2 == 0 else -1 : 0 : -1]])
