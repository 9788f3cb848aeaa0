"""Spectrum and bandwidth of a motion. Tested in ``tests/test_check.py`` and ``tests/test_init_filters.py``."""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array
from ..log.recording import Recording

ABOVE_NOISE = 10.0
"""Smallest ratio of the power spectrum to that of the position noise at which a frequency counts as motion."""
PIECES = 16
"""Number of half overlapping pieces of a window whose spectra `contiguous_band` averages: the noise of 16 hardly ever exceeds
`ABOVE_NOISE`, that of a single piece does at one frequency in a thousand."""
BAND = 0.99
"""Share of the velocity's power that lies within its band."""
SHORTEST_PIECE = 64
"""Smallest number of samples of a piece: shorter ones have too few frequencies to separate motion from noise."""
LONGEST_PIECE = 16384
"""Largest number of samples of a piece whose spectrum is computed."""


def welch(x: Array, rate_hz: float, size: int, trend: int | None = None) -> tuple[Array, Array]:
    """Return the mean spectrum of half overlapping pieces under Hann's window (Welch 1967).

    Parameters
    ----------
    x : ndarray, shape (n_samples, ...)
        Signals.
    rate_hz : float
        Sampling rate.
    size : int
        Number of samples of a piece.
    trend : int, optional
        Degree of the polynomial that is taken from each piece, 0 or 1.

    Returns
    -------
    f : ndarray, shape (n_frequencies,)
        Frequencies (Hz).
    power : ndarray, shape (n_frequencies, ...)
        One-sided spectral density, in the unit of `x`, squared, per Hz; compared with ``scipy.signal.welch`` in
        ``test_signals.py``.
    """
    pieces = np.lib.stride_tricks.sliding_window_view(x, size, axis=0)[:: size - size // 2]
    if trend is not None:
        powers = np.vander(np.linspace(-1.0, 1.0, size), trend + 1)
        pieces = pieces - pieces @ np.linalg.pinv(powers).T @ powers.T
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(size) / size)
    power = np.mean(np.square(np.abs(np.fft.rfft(pieces * window))), axis=0) / (rate_hz * np.sum(window**2))
    # Each frequency stands for its negative one too; zero has none, nor has the last one of an even number of samples.
    power[..., 1 : (size + 1) // 2] *= 2.0
    f: Array = np.arange(size // 2 + 1) * rate_hz / size
    return f, np.moveaxis(power, -1, 0)


def motion_band(recording: Recording) -> float:
    """Return the largest bandwidth of the joints' velocities (99 % of the power), in Hz, or 0."""
    spectra = (spectrum(recording, joint) for joint in range(recording.q.shape[1]))
    return max(_end(f, motion * x**2) for f, x, motion in spectra)


def _end(f: Array, power: Array) -> float:
    """Return the frequency below which `BAND` of the power lies; 0 without any."""
    total = np.cumsum(power)
    return float(f[np.searchsorted(total, BAND * total[-1])]) if total.size and total[-1] > 0.0 else 0.0


def contiguous_band(recording: Recording) -> float:
    """Return the bandwidth (Hz) with 99 % of the velocity's power, within one contiguous stretch of frequencies above the noise.

    Jitter of time stamps, rounding and encoder noise are white in the positions. The power of their velocity grows with the
    square of the frequency and exceeds that of a slow motion at 1 kHz. A separate test at each frequency cannot distinguish the
    two: of 1 000 frequencies some exceed any fixed level by chance, far above the motion, where each has the largest weight.
    (Such tests, on the coherence of velocity and torque and on the spectrum of a jittered reference, gave 402 Hz instead of 0.4
    Hz.) Motion is therefore one stretch of frequencies, from its largest velocity up to the noise; higher frequencies are
    ignored.

    Parameters
    ----------
    recording : Recording
        Positions; the longest window is used.

    Returns
    -------
    float
        Largest bandwidth of all joints; 0 for a window that is too short. Tested in ``tests/test_init_filters.py``.
    """
    start, stop = max(recording.windows, key=lambda window: window[1] - window[0])
    size = 2 * (stop - start) // (PIECES + 1)
    if size < SHORTEST_PIECE:
        return 0.0
    band = 0.0
    for joint in range(recording.q.shape[1]):
        steps = np.diff(recording.q[start:stop, joint])
        if not np.ptp(steps) > 0.0:
            continue
        f, power = welch(steps, recording.rate_hz, size, trend=1)
        gain = (2.0 * np.sin(np.pi * f / recording.rate_hz)) ** 2
        gain[0] = gain[1]
        noise = gain * float(np.median((power / gain)[3 * len(f) // 4 :]))
        largest = int(np.argmax(power))
        sunk = np.flatnonzero(power[largest:] <= ABOVE_NOISE * noise[largest:])
        end = largest + int(sunk[0]) if sunk.size else len(f)
        band = max(band, _end(f, np.maximum(power - noise, 0.0)[:end]))
    return band


def spectrum(recording: Recording, joint: int) -> tuple[Array, Array, Array]:
    """Return frequencies in Hz and in rad per sample, and the power of a joint's position, less the noise."""
    rate = recording.rate_hz
    size = min([LONGEST_PIECE, *(stop - start for start, stop in recording.windows)])
    if size < 32:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    powers, lengths = [], []
    for start, stop in recording.windows:
        # Spectrum of the differences, because a drift of the position would leak into its whole spectrum.
        steps = np.diff(recording.q[start:stop, joint])
        f, power = welch(steps, rate, size - 1)
        powers.append(power * len(steps))
        lengths.append(len(steps))
    f = f[1:]
    x = 2.0 * np.pi * f / rate
    position = np.sum(powers, axis=0)[1:] / sum(lengths) / (2.0 * np.sin(x / 2.0)) ** 2
    noise = float(np.median(position[3 * len(position) // 4 :]))
    return f, x, np.where(position > ABOVE_NOISE * noise, position - noise, 0.0)
