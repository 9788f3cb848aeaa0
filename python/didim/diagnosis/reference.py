"""A recorded reference that is not one: constant, the measured position or a copy of it, or another quantity.

With the error ``e = q_ref - q`` of each joint: a controlled robot has errors in the band of its motion, since torques need them. A
smoothed copy of the position has none there, only the noise that it lost. A late copy has ``e = -T dq``.
Tested in ``tests/test_check_causes.py``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .._tools.arrays import Array
from .._tools.words import joints_text
from ..experiment.experiment import Experiment
from ..log.recording import Recording
from ..result.finding import Finding, worded

SAME = 1e-9
"""Largest ratio of error to motion at which two columns are equal but for rounding."""
LATE = 0.9
"""Share of the squared error that the velocity must explain for a delayed copy."""
FEWEST = 200
"""Smallest number of samples of a window for this check."""

_ADVICE = "Log the reference that the controller gets, or leave [recording.reference] out: DIDIM and CLOE need a real one"
CONSTANT = 1e-3
"""Largest ratio of the reference's motion to that of its joint at which the reference is constant."""
UNRELATED = 0.5
"""Correlation of reference and position below which they do not belong to the same joint."""
POWER = 0.999
"""Share of the motion's power within its band."""
QUIET = 0.3
"""Ratio of the error's power density within the motion's band to that above it, below which the reference is a smoothed copy:
white encoder noise alone has 1, and a controlled robot more."""


def check_reference(experiment: Experiment) -> list[Finding]:
    """Return what is wrong with the recorded references."""
    return [finding for recording in experiment.recordings for finding in _recording(recording)]


def _recording(recording: Recording) -> Iterator[Finding]:
    if recording.q_ref is None:
        return
    start, stop = max(recording.windows, key=lambda window: window[1] - window[0])
    if stop - start < FEWEST:
        return
    q, ref = recording.measured_positions()[start:stop], recording.q_ref[start:stop]
    motion = np.std(q, axis=0)
    joints = np.flatnonzero(motion > 0.0)
    verdicts = {int(j): _joint(q[:, j], ref[:, j], recording.rate_hz) for j in joints}
    for what in ("same", "constant", "smoothed", "late", "unrelated"):
        shifts = {joint: value for joint, (kind, value) in verdicts.items() if kind == what}
        if not shifts:
            continue
        value = float(np.median(list(shifts.values())))
        yield worded(
            kind="reference",
            sentence=f"the reference of {joints_text(shifts)} in recording '{recording.name}' "
            + _TEXT[what].format(value),
            advice=_ADVICE,
            recording=recording.name,
            joints=tuple(joint + 1 for joint in shifts),
            value=value,
        )


_TEXT = {
    "same": "is the measured position itself",
    "constant": "does not move, and the joint does",
    "smoothed": "is a smoothed copy of the measured position: it has no error in the band of the motion, which the torques of a "
    "controller need",
    "late": "is the measured position {:.2g} ms later: a robot follows its reference, not the other way round",
    "unrelated": "does not go with its position (correlation {:.2g}): it is another quantity, or of another joint",
}


def _joint(q: Array, ref: Array, rate_hz: float) -> tuple[str, float]:
    """Return what a reference is instead of one, with a number; "reference" for a real one."""
    q, ref = q - q.mean(), ref - ref.mean()
    size = float(np.linalg.norm(q))
    error = ref - q
    if np.linalg.norm(error) <= SAME * size:
        return "same", 0.0
    if np.linalg.norm(ref) <= CONSTANT * size:
        return "constant", 0.0
    correlation = float(q @ ref) / (size * float(np.linalg.norm(ref)))
    if correlation < UNRELATED:
        return "unrelated", correlation
    dq = np.gradient(q) * rate_hz
    late = -float(dq @ error) / float(dq @ dq)
    if late > 0.5 / rate_hz and np.sum((error + late * dq) ** 2) < (1.0 - LATE) * np.sum(error**2):
        return "late", 1e3 * late
    if _quiet(q, error):
        return "smoothed", 0.0
    return "reference", 0.0


def _quiet(q: Array, error: Array) -> bool:
    """Whether the error has less power per Hz in the band of the motion than above it."""
    window = np.hanning(len(q))
    motion, power = (np.abs(np.fft.rfft(window * (values - values.mean()))) ** 2 for values in (q, error))
    edge = int(np.searchsorted(np.cumsum(motion) / motion.sum(), POWER)) + 1
    if edge < 4 or 2 * edge > len(motion):
        return False
    return float(power[1:edge].mean()) < QUIET * float(power[edge:].mean())
