"""Errors on recordings that were kept out of a fit, as evidence. Tested in ``tests/test_verdict_simulated.py``.

Errors are compared as torques, not as shares of them: a slow motion has the noise of a fast one and smaller torques.
"""

from __future__ import annotations

import numpy as np

from ..._tools.words import joints_text
from ...result.identification import Identification
from ...result.verdict import Reason

LARGER = 1.5
"""Error on a held-out recording over that of the fit that is worth a sentence: on correct logs it is 0.9 to 1.1."""
NEGLIGIBLE = 0.003
"""Share of a joint's torque below which it is that of filter and simulation."""


def held_out_reasons(fit: Identification) -> list[Reason]:
    """Return a reason for each held-out recording whose torques a result predicts worse than those it was fitted to."""
    if fit.uncertainty is None or fit.uncertainty.joint_std is None:
        return []
    own = np.asarray(fit.uncertainty.joint_std)
    found = []
    for item in fit.held_out:
        error, share = np.array(item.error_rms), np.nan_to_num(item.relative_error)
        if error.shape != own.shape:
            continue
        ratio = error / np.maximum(own, np.finfo(float).tiny)
        joints = np.flatnonzero((ratio > LARGER) & (share > NEGLIGIBLE))
        if not len(joints):
            continue
        low, high = (f"{value:.2g}" for value in (ratio[joints].min(), ratio[joints].max()))
        between = low if low == high else f"{low} to {high}"
        found.append(
            Reason(
                code="held-out",
                severity="doubtful",
                sentence=f"on recording '{item.name}', which was kept out, the torques of {joints_text(joints)} are off by "
                f"{100.0 * float(share[joints].max()):.2g} %, {between} times as much as on the recordings of the fit",
                advice="The logs differ (load, temperature, friction), or the fit lacks motion that this one has",
                joints=tuple(int(joint) + 1 for joint in joints),
                value=float(ratio[joints].max()),
            )
        )
    return found
