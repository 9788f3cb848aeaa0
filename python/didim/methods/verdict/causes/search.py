"""All hypotheses on a log that contradicts its model, and the one that explains it. Tested in ``tests/test_verdict_faults.py``.

On a measured log friction and delays that the model lacks leave errors of their own, which hide a wrong robot file; so hypotheses
on robot file and torques are fitted with columns for these errors beside every model. Only where a delay or a friction law explains
nearly everything by itself are they compared with it as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from ....errors import DidimError
from ....result.verdict import Reason
from ....signal.segments import Segment
from ...job import Job
from .geometry import conventions, gravities, lengths, twists
from .hypothesis import TIED, Explanation, Hypothesis, best
from .lasting import delays, frictions, lasting_columns
from .rows import Rows
from .torque_scale import torque_scales, unchecked

DECISIVE = 0.5
"""Share of the declared model's score up to which a delay or a friction law explains a log by itself: on simulated logs right ones
leave at most 0.4."""
CLEAR = 0.88
"""Share that friction or a delay must not exceed to be named."""
CLEAR_BESIDE = 0.9
"""Share that any other hypothesis must not exceed beside friction and delays: on the real logs of the TX40 and the UR10e as they
are the best one leaves 0.936 and 0.937, and a doubled gain 0.76 to 0.89."""


@dataclass(frozen=True)
class Findings:
    """What the hypotheses say of a log.

    Attributes
    ----------
    cause : Explanation or None
        The hypothesis that explains it; None where none does clearly.
    note : Reason or None
        Gains that the log does not check.
    """

    cause: Explanation | None = None
    note: Reason | None = None

    def reasons(self) -> list[Reason]:
        """Return the reasons, the gravest first."""
        named = [] if self.cause is None else [self.cause.reason()]
        return named if self.note is None else [*named, self.note]


def explained(job: Job, parts: Sequence[Segment]) -> Findings:
    """Return the hypothesis that explains a log best.

    Parameters
    ----------
    job : Job
        Robot and filters of the log.
    parts : sequence of Segment
        Its filtered windows.
    """
    rows = rows_of(job, parts)
    if rows is None:
        return Findings()
    lasting = [*delays(rows, parts[0].rate_hz), *frictions(rows)]
    if best(lasting, rows.score, DECISIVE) is not None:
        return Findings(best([*lasting, *of_the_file(rows)], rows.score, CLEAR))
    wide = rows.widened(lasting_columns(rows))
    cause = best(list(of_the_file(wide)), wide.score, CLEAR_BESIDE, TIED)
    if cause is not None:
        return Findings(cause)
    # The information on the gains is that of a model that is right but for its friction.
    return Findings(best(lasting, rows.score, CLEAR), unchecked(rows))


def rows_of(job: Job, parts: Sequence[Segment]) -> Rows | None:
    """Return the rows that hypotheses are tried on; None where the log does not identify its parameters."""
    # Load friction is not linear in the parameters, and no hypothesis turns on it.
    linear = [term for term in job.robot.friction.terms if term.law != "load"]
    if len(linear) != len(job.robot.friction.terms):
        job = replace(job, robot=job.robot.with_terms(linear))
    try:
        return Rows(job, parts)
    except DidimError:
        return None


def of_the_file(rows: Rows) -> Iterator[Hypothesis]:
    """Hypotheses on the torques and on the robot file, with their scores."""
    yield from torque_scales(rows)
    yield from gravities(rows)
    yield from conventions(rows)
    yield from twists(rows)
    yield from lengths(rows)
