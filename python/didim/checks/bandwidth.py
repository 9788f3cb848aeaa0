"""Recordings that are too slow for their motion.

Velocities and accelerations are central differences of the positions. At the frequency f and the rate F each of them keeps
``sin(x) / x`` of a sine, x = 2 pi f / F, so that an acceleration comes out too small by ``1 - (sin(x) / x)^2``, about
``x^2 / 3``. Averaged over the spectrum of the acceleration this is the share that the recording loses, and with it every
inertia. Tested in ``tests/test_check.py``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .finding import Finding

if TYPE_CHECKING:
    from ..experiment import Experiment
    from ..recording import Recording

Array = NDArray[np.float64]

LARGEST_LOSS = 0.02
"""Share of the acceleration that may be lost: inertias of a good log are known to 1 or 2 %."""
ABOVE_NOISE = 10.0
"""Times the noise of the positions that a part of the spectrum must have to count as motion."""
LONGEST_PIECE = 16384
"""Samples of a piece whose spectrum is taken."""


def check_bandwidth(experiment: Experiment) -> list[Finding]:
    """Tell recordings whose rate is too low for the motion, or for the filters."""
    found = []
    for recording in experiment.recordings:
        cutoff = experiment.signal.cutoff_hz
        rate = recording.rate_hz
        losses = [_loss(recording, joint, cutoff) for joint in range(recording.q.shape[1])]
        worst = int(np.argmax(losses))
        if losses[worst] > LARGEST_LOSS:
            # The loss goes with the square of the period.
            wanted = _round_up(rate * np.sqrt(losses[worst] / (0.1 * LARGEST_LOSS)))
            found.append(
                _too_slow(
                    recording,
                    f"{rate:.6g} Hz is too slow for the motion: central differences lose "
                    f"{100.0 * losses[worst]:.2g} % of the acceleration of joint {worst + 1}",
                    f"Record at {wanted:.6g} Hz or more, or move less fast",
                    (worst + 1,),
                )
            )
        elif cutoff is not None and cutoff >= rate / 2.0:
            found.append(
                _too_slow(
                    recording,
                    f"{rate:.6g} Hz is too slow for the filter: its cut-off of {cutoff:g} Hz is not below half the rate",
                    "Record faster, or lower cutoff_hz under [signal]",
                    (),
                )
            )
    return found


def _too_slow(recording: Recording, sentence: str, advice: str, joints: tuple[int, ...]) -> Finding:
    return Finding(
        kind="too-slow",
        sentence=f"recording '{recording.name}': {sentence}",
        advice=advice,
        recording=recording.name,
        joints=joints,
        value=recording.rate_hz,
    )


def _round_up(rate_hz: float) -> float:
    """Next of 1, 2, 5, 10, ..."""
    decade = 10.0 ** np.floor(np.log10(rate_hz))
    return float(next(step * decade for step in (1.0, 2.0, 5.0, 10.0) if step * decade >= rate_hz))


def motion_band(recording: Recording) -> float:
    """Frequency below which 99 % of the power of the velocity is, of the joint that is highest there; in Hz, or 0."""
    found = 0.0
    for joint in range(recording.q.shape[1]):
        f, x, motion = _spectrum(recording, joint)
        total = np.cumsum(motion * x**2)
        if total.size and total[-1] > 0.0:
            found = max(found, float(f[np.searchsorted(total, 0.99 * total[-1])]))
    return found


def _loss(recording: Recording, joint: int, cutoff_hz: float | None) -> float:
    """Share of the acceleration of a joint that central differences lose."""
    f, x, motion = _spectrum(recording, joint)
    if cutoff_hz is not None:
        motion = np.where(f <= cutoff_hz, motion, 0.0)
    weight = motion * x**4
    if not weight.sum() > 0.0:
        return 0.0
    return float(np.sum(weight * (1.0 - np.sinc(x / np.pi) ** 2)) / weight.sum())


def _spectrum(recording: Recording, joint: int) -> tuple[Array, Array, Array]:
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
