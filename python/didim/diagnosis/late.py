"""Torques that were recorded late, or early. Tested in ``tests/test_check.py``."""

from __future__ import annotations

import numpy as np

from .._tools.words import joints_text
from ..errors import DidimError
from ..methods.job import Delay, Job
from .finding import Finding

SMALLEST_SAMPLES = 0.2
"""Smallest delay that is reported, in samples, where it is also significant."""
SMALLEST_GAIN = 0.05
"""Share of the residual that the compensation must take away."""
HOLD = (0.3, 0.7)
"""Delays, in samples ahead of the motion, that the hold of a digital controller of the log's rate explains."""


def check_delay(job: Job, declared: Delay) -> list[Finding]:
    """Compare the delays that fit best with those that are compensated."""
    if job.delay_setting == "estimate":
        return []
    try:
        estimate = job.estimate_delay()
    except DidimError:  # no delay fits best, or the recordings are too short or of several rates
        return []
    late = np.array(estimate.joints) - np.asarray(declared.samples)
    worst = float(late[np.argmax(np.abs(late))])
    if abs(worst) < SMALLEST_SAMPLES or estimate.gain < SMALLEST_GAIN:
        return []
    rate = job.experiment.recordings[0].rate_hz
    alike = np.flatnonzero(np.abs(late - worst) < SMALLEST_SAMPLES)
    joints = () if len(alike) == len(late) else tuple(int(joint) + 1 for joint in alike)
    which = f" of {joints_text(alike)}" if joints else ""
    compensated = declared.samples if isinstance(declared.samples, float) else 0.0
    held = not joints and not declared.hold_s and -HOLD[1] < worst < -HOLD[0]
    values = [f"{value:.2f}" for value in estimate.joints]
    number = f"[{', '.join(values)}]" if estimate.differs else values[0]
    return [
        Finding(
            kind="delay",
            joints=joints,
            sentence=f"the torque{which} is {abs(worst):.2f} samples ({1e3 * abs(worst) / rate:.3g} ms) "
            f"{'behind' if worst > 0.0 else 'ahead of'} the motion"
            + (f", beyond the {compensated:g} that are compensated" if compensated else "")
            + f": without that {100.0 * estimate.gain:.2g} % less is left of the torques"
            + ("; a digital controller that holds its output leaves half a sample" if held else ""),
            advice=("Write sample_time_s under [controller], or " if held else "Write ")
            + f'compensate_samples = {number} or "estimate" under [delay]',
            value=worst + compensated,
        )
    ]
