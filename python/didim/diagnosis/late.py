"""Torques of some joints that were recorded late, or early. Tested in ``tests/test_check.py``."""

from __future__ import annotations

import numpy as np

from .._tools.words import joints_text
from ..errors import DidimError
from ..evidence.thresholds import SMALLEST_SAMPLES
from ..methods.job import Job
from ..result.finding import Finding, said

SMALLEST_GAIN = 0.05
"""Share of the residual that compensation must remove."""


def check_delay(job: Job) -> list[Finding]:
    """Compare the delays that fit each joint best with those that are compensated."""
    try:
        estimate = job.estimate_delay()
    except DidimError:  # no delay fits best, or the recordings are too short or of several rates
        return []
    late = np.array(estimate.joints) - np.asarray(job.declared_delay.samples)
    worst = float(late[np.argmax(np.abs(late))])
    if abs(worst) < SMALLEST_SAMPLES or estimate.gain < SMALLEST_GAIN:
        return []
    alike = np.flatnonzero(np.abs(late - worst) < SMALLEST_SAMPLES)
    joints = () if len(alike) == len(late) else tuple(int(joint) + 1 for joint in alike)
    ms = 1e3 * abs(worst) / job.experiment.recordings[0].rate_hz
    values = ", ".join(f"{value:.2f}" for value in estimate.joints)
    return [
        said(
            kind="delay",
            joints=joints,
            sentence=f"the torque{f' of {joints_text(alike)}' if joints else ''} is {abs(worst):.2f} samples ({ms:.3g} ms) "
            f"{'behind' if worst > 0.0 else 'ahead of'} the motion: without that {100.0 * estimate.gain:.2g} % less is left "
            "of the torques",
            advice=f'Write compensate_samples = [{values}] or "estimate" under [delay]',
            value=worst,
        )
    ]
