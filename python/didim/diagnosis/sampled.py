"""Time stamps of a log against each other and against the declared rate. Tested in ``tests/test_check.py``."""

from __future__ import annotations

from collections.abc import Sequence

from ..log.sampling import TimeFault
from ..result.finding import Finding, worded

MOST_GAPS = 5
"""Largest number of gaps that are reported one by one."""

ADVICE = {
    "order": "Sort or correct the time stamps",
    "gap": "Find the lost samples, or write resample = true under [recording.time], which takes the stretches between gaps",
    "uneven": "Write resample = true under [recording.time], or give rate_hz in place of that table if only the stamps jitter",
    "rate": "Correct rate_hz, or leave it out",
}


def time_findings(faults: Sequence[tuple[str, TimeFault]]) -> list[Finding]:
    """Turn faults of time stamps into findings."""
    findings = []
    kinds = {"order": "uneven-time", "gap": "gap", "uneven": "uneven-time", "rate": "rate"}
    for recording in dict.fromkeys(name for name, _ in faults):
        for kind in ADVICE:
            alike = [fault for name, fault in faults if name == recording and fault.kind == kind]
            shown = alike[: MOST_GAPS if kind == "gap" else 1]
            for fault in shown:
                left = len(alike) - len(shown)
                more = f"; there are {left} more" if left and fault is shown[-1] else ""
                findings.append(
                    worded(
                        kind=kinds[kind],
                        sentence=fault.sentence + more,
                        advice=ADVICE[kind],
                        recording=recording,
                        file=fault.file,
                        sample=fault.sample,
                        value=fault.rate_hz if kind == "rate" else None,
                    )
                )
    return findings
