"""Recordings that are too slow for their motion.

Velocities and accelerations are central differences of the positions. At the frequency f and the rate F each of them keeps
``sin(x) / x`` of a sine, x = 2 pi f / F, so that an acceleration comes out too small by ``1 - (sin(x) / x)^2``, about
``x^2 / 3``. Averaged over the spectrum of the acceleration this is the share that the recording loses, and with it every
inertia. Tested in ``tests/test_check.py``.
"""

from __future__ import annotations

import numpy as np

from ..experiment.experiment import Experiment
from ..log.recording import Recording
from ..result.finding import Finding, worded
from ..signal.spectrum import spectrum

LARGEST_LOSS = 0.02
"""Largest share of the acceleration that a filter may remove: inertias of a good log are known to 1 or 2 %."""

BAND = 0.999
"""Share of the velocity's power below the upper end of the motion's band."""


def check_bandwidth(experiment: Experiment) -> list[Finding]:
    """Tell recordings whose rate is too low for the motion, or for the filters."""
    findings = []
    for recording in experiment.recordings:
        cutoff = experiment.signal.cutoff_hz
        rate = recording.rate_hz
        losses = [_loss(recording, joint, cutoff) for joint in range(recording.q.shape[1])]
        worst = int(np.argmax(losses))
        if losses[worst] > LARGEST_LOSS:
            # The loss goes with the square of the period; the rate is the next of 1, 2, 5, 10, ...
            rate_hz = rate * np.sqrt(losses[worst] / (0.1 * LARGEST_LOSS))
            decade = 10.0 ** np.floor(np.log10(rate_hz))
            wanted = float(next(step * decade for step in (1.0, 2.0, 5.0, 10.0) if step * decade >= rate_hz))
            joints: tuple[int, ...] = (worst + 1,)
            reason = f"motion: central differences lose {100.0 * losses[worst]:.2g} % of the acceleration of joint {worst + 1}"
            advice = f"Record at {wanted:.6g} Hz or more, or move less fast"
        elif cutoff is not None and cutoff >= rate / 2.0:
            joints = ()
            reason = f"filter: its cut-off of {cutoff:g} Hz is not below half the rate"
            advice = "Record faster, or lower cutoff_hz under [signal]"
        else:
            continue
        findings.append(
            worded(
                kind="too-slow",
                sentence=f"recording '{recording.name}': {rate:.6g} Hz is too slow for the {reason}",
                advice=advice,
                recording=recording.name,
                joints=joints,
                value=rate,
            )
        )
    return findings


def _loss(recording: Recording, joint: int, cutoff_hz: float | None) -> float:
    """Share of the acceleration of a joint that central differences lose."""
    f, x, motion = spectrum(recording, joint)
    if cutoff_hz is not None:
        motion = np.where(f <= cutoff_hz, motion, 0.0)
    # Single bins of noise far above the motion would decide, since the acceleration weighs them with x^4.
    speed = np.cumsum(motion * x**2)
    if speed.size and speed[-1] > 0.0:
        motion = np.where(speed <= BAND * speed[-1], motion, 0.0)
    weight = motion * x**4
    if not weight.sum() > 0.0:
        return 0.0
    return float(np.sum(weight * (1.0 - np.sinc(x / np.pi) ** 2)) / weight.sum())
