r"""Spikes in measured torques: detected and replaced before the decimation, which would smear them over its rows.

Hampel's filter: a sample that is further from the median of its window than ``threshold`` robust standard deviations is a
spike, and the median takes its place. The robust standard deviation is ``1.4826`` times the median absolute deviation from
that median. Source: Hampel (1974); Davies and Gather (1993). After the decimation robust weights cannot detect a spike, because
it is part of several rows (measured in docs/idim_ls.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array
from .processing import SignalProcessing

WINDOW = 11
"""Number of samples of the sliding window: short beside the motion, long enough for a median of noise."""
TAIL = 5.0
"""Ratio of a sample's bend to the bend that 95 % of the samples stay below, from which the sample may be a spike."""
CERTAIN = 10.0
"""Distance from the median, in robust standard deviations, beyond which a sample is a spike in any log: normal noise does not
reach it."""
NORMAL_MAD = 1.4826
"""Ratio of standard deviation to median absolute deviation of normal noise."""
AT_ONCE = 16384
"""Number of samples whose windows are sorted at once, which bounds the memory."""
SPIKE_THRESHOLD = 4.0
"""Distance from the median, in robust standard deviations, beyond which a sample is a spike."""


def hampel(values: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Replace spikes by the median of their neighbourhood.

    Parameters
    ----------
    values : ndarray, shape (n_samples, m)
        Signals, one per column, in any unit.

    Returns
    -------
    cleaned : ndarray, shape (n_samples, m)
        The signals without spikes.
    spikes : ndarray of bool, shape (n_samples, m)
        Samples that were replaced.

    Notes
    -----
    The robust standard deviation of a window is at least that of the typical window of its column. Otherwise every change of a
    signal with coarse steps, whose windows are mostly constant, would be a spike. ``test_spikes.py`` plants spikes in noise.
    """
    cleaned = np.array(values, dtype=np.float64)
    spikes = np.zeros(cleaned.shape, dtype=bool)
    if len(cleaned) <= WINDOW:
        return cleaned, spikes
    for column in range(cleaned.shape[1]):
        middle, deviation = _medians(cleaned[:, column])
        scale = NORMAL_MAD * np.maximum(deviation, np.median(deviation))
        distance = np.abs(cleaned[:, column] - middle)
        # Rounding of constant signals is not a spike.
        floor = 1e-12 * np.abs(middle)
        spikes[:, column] = distance > SPIKE_THRESHOLD * scale + np.maximum(
            floor, _resolution(cleaned[:, column])
        )
        cleaned[spikes[:, column], column] = middle[spikes[:, column]]
    return cleaned, spikes


def without_spikes(tau: Array, signal: SignalProcessing) -> Array:
    """Return measured torques, (n_samples, n_dof), without spikes if the settings ask for it."""
    return hampel(tau)[0] if signal.spikes == "hampel" else tau


def _medians(signal: Array) -> tuple[Array, Array]:
    """Median, and median absolute deviation from it, of the window around each sample."""
    half = WINDOW // 2
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(signal, half, mode="reflect"), WINDOW)
    middle, deviation = np.empty(signal.size), np.empty(signal.size)
    for start in range(0, signal.size, AT_ONCE):
        part = slice(start, start + AT_ONCE)
        # Sorting rows of eleven takes a third of the time of NumPy's median.
        middle[part] = np.sort(windows[part], axis=1)[:, half]
        deviation[part] = np.sort(np.abs(windows[part] - middle[part, None]), axis=1)[:, half]
    return middle, deviation


def _resolution(signal: Array) -> float:
    """Return the smallest step of a coarsely quantised signal, whose windows are mostly constant; 0 for others."""
    steps = np.abs(np.diff(signal))
    moving = np.count_nonzero(steps > 0.0)
    # If half of the samples repeat the preceding one, the other steps are the resolution of the recording. Rarer steps do not
    # matter: the median of a window is then the level of its sample.
    coarse = 0.05 * steps.size < moving < 0.5 * steps.size
    return float(np.min(steps[steps > 0.0])) if coarse else 0.0


def alone(tau: Array) -> NDArray[np.bool_]:
    """Return a mask of isolated samples of torques, (n_samples, n_dof), far from both neighbours.

    An error s of one sample changes the bend of the signal by s there and by -s/2 on either side. A friction step does not: its
    neighbours lie on both sides of it.
    """
    lone = np.zeros(tau.shape, dtype=bool)
    if len(tau) < WINDOW:
        return lone
    for joint, values in enumerate(np.ascontiguousarray(tau.T)):
        bends = np.zeros(values.shape)
        bends[1:-1] = values[1:-1] - 0.5 * (values[:-2] + values[2:])
        size = np.abs(bends)
        median, tail = np.quantile(size, (0.5, 0.95)).tolist()
        # Most bends of a signal with coarse steps are zero.
        scale = max(NORMAL_MAD * median, _resolution(values))
        # Heavy tails of the noise are not isolated errors.
        limit = max(CERTAIN * scale, TAIL * tail)
        places = 2 + np.flatnonzero(size[2:-2] > limit + 1e-12 * np.abs(values).max())
        before, inner, after = (bends[places + step] for step in (-1, 0, 1))
        opposite = (before * inner < 0.0) & (after * inner < 0.0)
        beside = np.minimum(np.abs(before), np.abs(after)) > 0.25 * np.abs(inner)
        lone[places[opposite & beside], joint] = True
    return lone


def without_lone(tau: Array) -> Array:
    """Return torques, (n_samples, n_dof), with isolated samples replaced, for diagnoses that they would spoil."""
    lone = alone(tau)
    if not lone.any():
        return tau
    cleaned = tau.copy()
    cleaned[1:-1][lone[1:-1]] = (0.5 * (tau[:-2] + tau[2:]))[lone[1:-1]]
    return cleaned
