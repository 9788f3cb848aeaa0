"""Physics as evidence, weighted by significance: an inertia below zero by 0.2 sigma is a footnote, friction by 16 sigma is not.

No sign alone makes a result wrong: the cause that turns it does (`didim.evidence.causes`), and without one it is a reason to doubt.

Tested in ``tests/test_verdict.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..model.physics import NOISE_SIGMAS, Flag
from ..result.finding import Finding, Grade


def physical_findings(flags: Sequence[Flag]) -> list[Finding]:
    """Return a finding for each flag, as grave as it is significant."""
    findings = []
    for flag in flags:
        known = np.isfinite(flag.sigmas)
        grade: Grade = "note" if known and flag.sigmas < NOISE_SIGMAS else "doubtful"
        friction = any(name.startswith("F") for name in flag.parameters)
        advice = (
            "Look at the sign of that torque, and at the friction terms"
            if friction
            else "Write physical = true under [least_squares] (--physical) for parameters that a simulation can use"
        )
        findings.append(
            Finding(
                code="not-physical",
                grade=grade,
                parameters=flag.parameters,
                effect=flag.sigmas if known else None,
                facts={"text": flag.sentence, "advice": "" if grade == "note" else advice},
            )
        )
    return findings
