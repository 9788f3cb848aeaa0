"""What the verdict's evidence says of a log before it is fitted: the robot file, and the closed loop.

Tested in ``tests/test_check_causes.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from .._tools.arrays import Array
from ..errors import DidimError
from ..evidence.causes import Search
from ..evidence.gain_check import unchecked
from ..evidence.loop.law import Recovered, loop_findings
from ..evidence.naming import cause_findings
from ..evidence.rows import LogRows
from ..evidence.whiteness import NEGLIGIBLE, whiteness
from ..experiment.experiment import Experiment
from ..methods.job import Job
from ..regression.fit import Fit
from ..regression.linear_system import LinearSystem
from ..regression.logs.load import load_between, load_beyond
from ..result.finding import Finding as Evidence
from ..signal.segments import Segment
from .finding import Finding, Kind


def contradicts(system: LinearSystem, fit: Fit) -> bool:
    """Whether the residual of a fit lasts, and is not negligible."""
    share = system.norms(fit.residual) / np.maximum(system.norms(system.measured), np.finfo(float).tiny)
    coloured = whiteness(fit.residual, system.blocks, len(system.joints)).coloured
    return any(bool(c) and bool(large) for c, large in zip(coloured, share > NEGLIGIBLE, strict=True))


def rows_of(job: Job, parts: Sequence[Segment]) -> LogRows | None:
    """Return the rows that hypotheses are tried on; None where the log has too few."""
    try:
        return LogRows(job.robot, job.signal, parts)
    except DidimError:
        return None


def check_causes(rows: LogRows) -> tuple[Finding, float] | None:
    """Return what explains a log that contradicts its model, and the share of the error that it leaves."""
    found = cause_findings(rows, Search(rows).cause())
    if not found or found[0].grade != "wrong":
        return None
    return finding_of(found[0]), float(found[0].facts["left"])


def unchecked_gains(rows: LogRows) -> list[str]:
    """Return a note on the drive gains that a log cannot check, if there are any."""
    return [item.sentence for item in unchecked(rows)]


def check_payload(
    job: Job, parts: Sequence[Segment], solved: tuple[LinearSystem, Fit] | None, beta: Array | None
) -> list[Finding]:
    """Return loads that recordings do not share, or that known parameters, (b,), do not have."""
    if not job.parameters.simple:
        return []
    named = job.experiment.recordings
    advice = 'Declare it: [payload.NAME] and payload = "NAME" under [[recording]]'
    if beta is not None:
        load = load_beyond(job.system(parts), beta, job.robot)
        sentence = f"beside the known parameters the robot {load}"
        return (
            []
            if load is None
            else [Finding(kind="payload", sentence=sentence, advice=advice, value=load.mass_or_none)]
        )
    if solved is None:
        return []
    return [
        Finding(
            kind="payload",
            sentence=f"beside the first recording '{named[number].name}' {load}",
            advice=advice,
            recording=named[number].name,
            value=load.mass_or_none,
        )
        for number, load in load_between(*solved, job.robot)
    ]


def check_loop(experiment: Experiment, x: Array | None, shown: Recovered | None) -> list[Finding]:
    """Return what contradicts the declared controller or reference; `x` as for `loop_findings`, `shown` from `recovered`."""
    return [] if shown is None else [finding_of(item) for item in loop_findings(experiment, x, shown)]


def loop_table(shown: Recovered | None) -> tuple[tuple[str, ...], ...]:
    """Return heading and rows of the gains that a log shows over the declared ones; empty without a controller."""
    if shown is None:
        return ()
    names, factors, _ = shown.keys()
    head = ("joint", *names, "left %")
    rows = [
        (
            str(joint + 1),
            *(f"{value:.3f}" for value in factors[:, joint]),
            f"{100.0 * shown.relative[joint]:.2g}",
        )
        for joint in range(factors.shape[1])
    ]
    return (head, *rows)


def finding_of(item: Evidence) -> Finding:
    """Return a finding of the evidence as one of a check."""
    return Finding(
        kind=cast(Kind, item.code),
        sentence=item.sentence,
        advice=item.advice,
        joints=item.joints,
        value=item.value,
    )
