"""What the verdict's evidence says of a log before it is fitted: the robot file, and the closed loop.

Tested in ``tests/test_check_causes.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from .._tools.arrays import Array
from ..experiment.experiment import Experiment
from ..methods.job import Job
from ..methods.verdict.causes.search import explained, rows_of
from ..methods.verdict.causes.torque_scale import unchecked
from ..methods.verdict.loop import Recovered, loop_reasons
from ..methods.verdict.whiteness import NEGLIGIBLE, whiteness
from ..regression.fit import Fit
from ..regression.linear_system import LinearSystem
from ..regression.logs.load import load_between, load_beyond
from ..result.verdict import Reason
from ..signal.segments import Segment
from .finding import Finding, Kind

ROBOT_FILE = frozenset(
    {"gravity", "dh-convention", "a-and-d", "twist-sign", "link-length", "position-sign", "joint-sign"}
    | {"torque-sign", "drive-gain"}
)
"""Codes of hypotheses that are findings; friction is a matter of the model, and delays have a check of their own."""


def contradicts(system: LinearSystem, fit: Fit) -> bool:
    """Whether the residual of a fit lasts, and is not negligible."""
    share = system.norms(fit.residual) / np.maximum(system.norms(system.measured), np.finfo(float).tiny)
    coloured = whiteness(fit.residual, system.blocks, len(system.joints)).coloured
    return any(bool(c) and bool(large) for c, large in zip(coloured, share > NEGLIGIBLE, strict=True))


def check_causes(job: Job, parts: Sequence[Segment]) -> tuple[Finding, float] | None:
    """Return what explains a log that contradicts its model, and the share of the error that it leaves."""
    found = explained(job, parts).cause
    if found is None or found.cause.code not in ROBOT_FILE:
        return None
    return _finding(found.reason()), found.left


def unchecked_gains(job: Job, parts: Sequence[Segment]) -> list[str]:
    """Return a note on the drive gains that a log cannot check, if there are any."""
    rows = rows_of(job, parts) if job.parameters.simple else None
    note = None if rows is None else unchecked(rows)
    return [] if note is None else [note.sentence]


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
    """Return what contradicts the declared controller or reference; `x` as for `loop_reasons`, `shown` from `recovered`."""
    return [] if shown is None else [_finding(reason) for reason in loop_reasons(experiment, x, shown)]


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


def _finding(reason: Reason) -> Finding:
    return Finding(
        kind=cast(Kind, reason.code),
        sentence=reason.sentence,
        advice=reason.advice,
        joints=reason.joints,
        value=reason.value,
    )
