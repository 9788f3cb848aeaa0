"""Torques that were recorded late, or early. Tested in ``tests/test_check.py``."""

from __future__ import annotations

from ..errors import DidimError
from ..methods.job import Job
from .finding import Finding

SMALLEST_SAMPLES = 1.0
"""A delay below one sample is what filters and the hold of a drive leave."""
SMALLEST_GAIN = 0.05
"""Share of the residual that the compensation must take away."""


def check_delay(job: Job, compensated: float) -> list[Finding]:
    """Compare the delay that fits best with the one that is compensated."""
    if job.delay_setting == "estimate":
        return []
    try:
        estimate = job.estimate_delay()
    except DidimError:  # no delay fits best, or the recordings are too short or of several rates
        return []
    norms = dict(zip(estimate.shifts, estimate.residual_norms, strict=True))
    declared = norms[min(norms, key=lambda shift: abs(shift - compensated))]
    gain = 1.0 - min(norms.values()) / declared if declared > 0.0 else 0.0
    if abs(estimate.samples - compensated) < SMALLEST_SAMPLES or gain < SMALLEST_GAIN:
        return []
    late = estimate.samples - compensated
    rate = job.experiment.recordings[0].rate_hz
    return [
        Finding(
            kind="delay",
            sentence=f"the torque is {abs(late):.2f} samples ({1e3 * abs(late) / rate:.3g} ms) "
            f"{'behind' if late > 0.0 else 'ahead of'} the motion"
            + (f", beyond the {compensated:g} that are compensated" if compensated else "")
            + f": without that {100.0 * gain:.2g} % less is left of the torques",
            advice=f'Write compensate_samples = {estimate.samples:.2f} or "estimate" under [delay]',
            value=estimate.samples,
        )
    ]
