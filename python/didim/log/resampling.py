"""Resampling of uneven time stamps by local cubic interpolation, with an exactly known effect on the noise.

A new sample is the value of the cubic through the four nearest samples, which is a weighted mean of them. White noise of
variance one gets the sum of the squared weights as variance: 1 at a time stamp and 0.64 half way between two even ones. Tested
in ``tests/test_resampling.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import RecordingError
from .data_format import Windows
from .sampling import MINIMUM_SAMPLES, RATE_TOLERANCE

LONGEST_GAP_STEPS = 3.5
"""Longest time step, in median steps, that interpolation may bridge: from 4 on, three or more samples are missing."""
STENCIL = 4
"""Number of samples that a resampled value is interpolated from."""
SLOWEST, FASTEST = 0.9, 10.0
"""Rates that may be asked for, in rates of the time stamps. A lower one would fold noise and motion over; filters come first."""
LONGEST_STRETCH = 100.0
"""Largest ratio of the time between the first and the last stamp to that of as many samples without a gap."""


@dataclass(frozen=True, eq=False)
class Resampling:
    """Even samples as weighted means of uneven ones.

    Attributes
    ----------
    t : (n,) array
        Even time stamps (s), from the first of the log.
    rate_hz : float
        Their rate.
    indices : (n, 4) array
        Four samples of the log for each new sample.
    weights : (n, 4) array
        Their weights.
    windows : tuple of (int, int)
        Half-open slices of even samples that lie between gaps.
    noise_variance : float
        Variance of white noise after resampling, over that before it: the mean of all windows.
    repeated : int
        Number of samples dropped because they repeat the preceding time stamp.
    kept : (m,) array
        Samples of the log that are used.
    """

    t: Array
    rate_hz: float
    indices: np.ndarray
    weights: Array
    windows: Windows
    noise_variance: float
    repeated: int
    kept: np.ndarray

    def apply(self, values: Array) -> Array:
        """Resample signals, (n_samples, m)."""
        values = values[self.kept]
        # Columns of the stencil in sequence: the same order of additions on every processor.
        with np.errstate(over="ignore", invalid="ignore"):  # reported by Recording
            total = self.weights[:, 0, None] * values[self.indices[:, 0]]
            for k in range(1, STENCIL):
                total += self.weights[:, k, None] * values[self.indices[:, k]]
        return np.asarray(total)

    def sentence(self, steps: str) -> str:
        """Describe the resampling and its effect on the noise."""
        windows = f", in {counted(len(self.windows), 'window')} between gaps" if len(self.windows) > 1 else ""
        repeated = f"; {counted(self.repeated, 'repeated time stamp')} left out" if self.repeated else ""
        return (
            f"time steps of {steps} were resampled at {self.rate_hz:.6g} Hz by local cubics{windows}{repeated}; "
            f"white noise keeps {self.noise_variance:.2f} of its variance"
        )


def step_range(t: Array) -> str:
    """Return the shortest and the longest time step outside gaps as text."""
    steps = np.diff(t)
    steps = steps[steps > 0.0]
    steps = steps[steps <= LONGEST_GAP_STEPS * np.median(steps)]
    return f"{1e3 * steps.min():.4g} to {1e3 * steps.max():.4g} ms"


def resampling(t: Array, rate_hz: float | None, file: str) -> Resampling:
    """Plan the resampling of a log.

    Parameters
    ----------
    t
        (n_samples,) time stamps in s.
    rate_hz
        Even rate; that of the median time step by default.
    file
        File of the time stamps, for messages.

    Raises
    ------
    RecordingError
        When time runs backwards, the rate is far from that of the time stamps, or no stretch between gaps is long enough.
    """
    distinct = np.flatnonzero(np.r_[True, np.diff(t) != 0.0])
    stamps = t[distinct]
    steps = np.diff(stamps)
    if len(stamps) < STENCIL:
        raise RecordingError(
            f"{file}: resampling needs {counted(STENCIL, 'time stamp')}, and there are {len(stamps)}"
        )
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0))
        before, after = int(distinct[row]), int(distinct[row + 1])
        raise RecordingError(
            f"{file}: time does not grow from row {before + 1} ({t[before]:.9g} s) to row {after + 1}"
        )
    period = float(np.median(steps))
    rate = whole_rate(1.0 / period) if rate_hz is None else rate_hz
    if not SLOWEST <= rate * period <= FASTEST:
        raise RecordingError(
            f"{file}: rate_hz = {rate:.6g} is not a rate to resample at, as the time stamps have {1.0 / period:.6g} Hz; "
            "leave rate_hz out, and lower the rate with decimation under [signal]"
        )
    if (stamps[-1] - stamps[0]) * rate > LONGEST_STRETCH * len(stamps):
        row = int(distinct[int(np.argmax(steps)) + 1])
        raise RecordingError(
            f"{file}: {len(stamps)} time stamps at {rate:.6g} Hz end {stamps[-1] - stamps[0]:.3g} s after the first: "
            f"is that of row {row + 1} ({t[row]:.9g} s) wrong? After a pause, give windows"
        )
    count = int(np.floor((stamps[-1] - stamps[0]) * rate * (1.0 + 1e-12) + 1e-6)) + 1
    even = np.asarray(stamps[0] + np.arange(count) / rate)
    edges = [0, *(np.flatnonzero(steps > LONGEST_GAP_STEPS * period) + 1).tolist(), len(stamps)]
    right = np.clip(np.searchsorted(stamps, even, side="right"), 1, len(stamps) - 1)
    indices = np.clip(right[:, None] + np.arange(-2, 2), 0, len(stamps) - 1)
    weights = np.zeros((len(even), STENCIL))
    # In gaps, which are outside all windows, a straight line avoids large values.
    share = (even - stamps[right - 1]) / (stamps[right] - stamps[right - 1])
    weights[:, 1], weights[:, 2] = 1.0 - share, share
    windows = []
    for first, last in pairwise(edges):
        start = int(np.searchsorted(even, stamps[first] - 1e-6 * period))
        stop = int(np.searchsorted(even, stamps[last - 1] + 1e-6 * period, side="right"))
        if last - first < STENCIL or stop - start < MINIMUM_SAMPLES:
            continue
        windows.append((start, stop))
        begin = np.clip(right[start:stop] - 2, first, last - STENCIL)
        indices[start:stop] = begin[:, None] + np.arange(STENCIL)
        weights[start:stop] = _cubic(stamps, indices[start:stop], even[start:stop])
    if not windows:
        raise RecordingError(f"{file}: no stretch without a gap has {counted(STENCIL, 'sample')}")
    longest = max(stop - start for start, stop in windows)
    windows = [(start, stop) for start, stop in windows if stop - start >= 0.1 * longest]
    used = np.concatenate([np.sum(weights[start:stop] ** 2, axis=1) for start, stop in windows])
    return Resampling(
        t=even,
        rate_hz=rate,
        indices=indices,
        weights=weights,
        windows=tuple(windows),
        noise_variance=float(np.mean(used)),
        repeated=len(t) - len(distinct),
        kept=distinct,
    )


def whole_rate(rate: float) -> float:
    """Round a rate within a thousandth of a whole number of Hz: time stamps are rounded."""
    near = float(round(rate))
    return near if near > 0.0 and abs(rate - near) < RATE_TOLERANCE * rate else rate


def _cubic(stamps: Array, indices: np.ndarray, even: Array) -> Array:
    """Return Lagrange's weights of four samples."""
    places = stamps[indices]
    weights = np.ones((len(even), STENCIL))
    for j in range(STENCIL):
        for k in range(STENCIL):
            if k != j:
                weights[:, j] *= (even - places[:, k]) / (places[:, j] - places[:, k])
    return weights
