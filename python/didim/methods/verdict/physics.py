"""Physics as evidence, weighted by significance: an inertia below zero by 0.2 sigma is a footnote, friction by 16 sigma is not.

Tested in ``tests/test_verdict.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...model.physics import NOISE_SIGMAS, Flag
from ...result.verdict import Reason

WRONG_SIGMAS = 10.0
"""Standard deviations beyond which it makes a result wrong: no error of the model that sigma includes explains it."""


def physical_reasons(flags: Sequence[Flag]) -> list[Reason]:
    """Return a reason for each flag, as grave as it is significant."""
    found = []
    for flag in flags:
        known = np.isfinite(flag.sigmas)
        if not known:
            severity = "doubtful"
        elif flag.sigmas < NOISE_SIGMAS:
            severity = "note"
        else:
            severity = "doubtful" if flag.sigmas < WRONG_SIGMAS else "wrong"
        friction = any(name.startswith("F") for name in flag.parameters)
        advice = (
            "Look at the sign of that torque, and at the friction terms"
            if friction
            else "Take physical = true (--physical) for parameters that a simulation can use"
        )
        found.append(
            Reason(
                code="not-physical",
                severity=severity,  # type: ignore[arg-type]
                sentence=flag.sentence,
                advice="" if severity == "note" else advice,
                parameters=flag.parameters,
                value=flag.sigmas if known else None,
            )
        )
    return found
