"""Spikes of measured torques, which decimation would smear over its rows. Tested in ``tests/test_spikes.py``."""

from __future__ import annotations

import numpy as np

from ..log.recording import Recording
from ..signal.spikes import CERTAIN, hampel
from .finding import Finding

FEWEST = 3
"""Spikes of a joint that are reported; a single sample changes no estimate."""


def check_spikes(recording: Recording) -> list[Finding]:
    """Report joints whose torques have single samples far from those around them."""
    if recording.tau is None:
        return []
    counts: dict[int, int] = {}
    first = recording.tau.shape[0]
    for start, stop in recording.windows:
        tau = recording.tau[start:stop]
        cleaned, spikes = hampel(tau, threshold=CERTAIN)
        # A step of friction is not a spike: the samples beside it lie on either side, not both far away.
        distance = np.abs(tau - cleaned)
        beside = np.abs(np.diff(tau, axis=0, prepend=tau[:1]))
        after = np.abs(np.diff(tau, axis=0, append=tau[-1:]))
        spikes = spikes & (np.maximum(beside, after) > 0.5 * distance)
        for joint in range(tau.shape[1]):
            where = np.flatnonzero(spikes[:, joint])
            if where.size:
                counts[joint + 1] = counts.get(joint + 1, 0) + where.size
                first = min(first, start + int(where[0]))
    counts = {joint: count for joint, count in counts.items() if count >= FEWEST}
    if not counts:
        return []
    shown = ", ".join(f"{count} in joint {joint}" for joint, count in counts.items())
    return [
        Finding(
            kind="spikes",
            sentence=f"recording '{recording.name}' has spikes in its torques, single samples more than "
            f"{CERTAIN:g} robust standard deviations from those around them: {shown}",
            advice='Write spikes = "hampel" under [signal], which replaces them before the decimation smears them',
            recording=recording.name,
            joints=tuple(counts),
            sample=first,
            value=float(sum(counts.values())),
        )
    ]
