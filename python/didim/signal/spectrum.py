"""Spectrum of a motion: the band that it fills. Tested in ``tests/test_check.py``."""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array
from ..log.recording import Recording

ABOVE_NOISE = 10.0
"""Times the noise of the positions that a part of the spectrum must have to count as motion."""
LONGEST_PIECE = 16384
"""Samples of a piece whose spectrum is taken."""


def motion_band(recording: Recording) -> float:
    """Frequency below which 99 % of the power of the velocity is, of the joint that is highest there; in Hz, or 0."""
    found = 0.0
    for joint in range(recording.q.shape[1]):
        f, x, motion = spectrum(recording, joint)
        total = np.cumsum(motion * x**2)
        if total.size and total[-1] > 0.0:
            found = max(found, float(f[np.searchsorted(total, 0.99 * total[-1])]))
    return found


def spectrum(recording: Recording, joint: int) -> tuple[Array, Array, Array]:
    """Return frequencies in Hz and in rad per sample, and the power of the position of a joint there, noise left out."""
    from scipy.signal import welch

    rate = recording.rate_hz
    size = min([LONGEST_PIECE, *(stop - start for start, stop in recording.windows)])
    if size < 32:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    powers, lengths = [], []
    for start, stop in recording.windows:
        # Of the differences, because a drift of the position would leak into all of its spectrum.
        steps = np.diff(recording.q[start:stop, joint])
        f, power = welch(steps, fs=rate, nperseg=size - 1, detrend=False)
        powers.append(power * len(steps))
        lengths.append(len(steps))
    f = f[1:]
    x = 2.0 * np.pi * f / rate
    position = np.sum(powers, axis=0)[1:] / sum(lengths) / (2.0 * np.sin(x / 2.0)) ** 2
    noise = float(np.median(position[3 * len(position) // 4 :]))
    return f, x, np.where(position > ABOVE_NOISE * noise, position - noise, 0.0)
