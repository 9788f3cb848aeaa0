"""All hypotheses on a log that contradicts its model, and the one that explains it. Tested in ``tests/test_verdict_faults.py``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from ...errors import DidimError
from ...result.verdict import Reason
from ...signal.segments import Segment
from ..job import Job
from .geometry import conventions, gravities, lengths, twists
from .hypothesis import Hypothesis, best
from .lasting import delays, frictions
from .rows import Rows
from .torque_scale import torque_scales


def explained(job: Job, parts: Sequence[Segment]) -> list[Reason]:
    """Return the hypothesis that explains a log best, as a reason; nothing where none does clearly; see `explanation`."""
    found = explanation(job, parts)
    return [] if found is None else [found[0].reason(found[1])]


def explanation(job: Job, parts: Sequence[Segment]) -> tuple[Hypothesis, float] | None:
    """Return the hypothesis that explains a log best, and the score of the model as declared; None where none does clearly.

    Parameters
    ----------
    job : Job
        Robot and filters of the log.
    parts : sequence of Segment
        Its filtered windows.
    """
    # Load friction is not linear in the parameters, and no hypothesis turns on it.
    linear = [term for term in job.robot.friction.terms if term.law != "load"]
    if len(linear) != len(job.robot.friction.terms):
        job = replace(job, robot=job.robot.with_terms(linear))
    try:
        rows = Rows(job, parts)
    except DidimError:
        return None
    found = best(list(hypotheses(rows, parts[0].rate_hz)), rows.score)
    return None if found is None else (found, rows.score)


def hypotheses(rows: Rows, rate_hz: float) -> Iterator[Hypothesis]:
    """All hypotheses with their scores."""
    yield from torque_scales(rows)
    yield from gravities(rows)
    yield from conventions(rows)
    yield from twists(rows)
    yield from delays(rows, rate_hz)
    yield from frictions(rows)
    yield from lengths(rows)
