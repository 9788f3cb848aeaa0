"""A hypothesis on why a log contradicts its model, with its score on stretches that it was not fitted on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...result.verdict import Reason, Severity

CLEAR = 0.88
"""Share of the declared model's score that the best hypothesis must not exceed: on the real TX40 log, whose friction is not that of
the model, wrong hypotheses on the robot file reach 0.93, and on simulated logs right ones leave at most 0.4."""
ALIKE = 0.02
"""Hypotheses within this share of the best one's gain count as equal, and the simplest of them is named."""


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """Another model or reading of a log.

    Attributes
    ----------
    code, severity, sentence, advice, joints, value
        Of the `Reason` that names it; the sentence goes on with the errors.
    score : float
        Squared error on stretches that it was not fitted on, `rows` (1).
    simplicity : int
        Of hypotheses that explain a log alike the one with the smallest number is named.
    """

    code: str
    sentence: str
    advice: str
    score: float
    simplicity: int
    severity: Severity = "wrong"
    joints: tuple[int, ...] = ()
    value: float | None = None

    def reason(self, declared: float) -> Reason:
        """Return the reason; `declared` is the score of the declared model."""
        left = 100.0 * (self.score / declared) ** 0.5
        return Reason(
            code=self.code,
            severity=self.severity,
            sentence=f"{self.sentence}: that leaves {left:.3g} % of the error on stretches of the log that were not fitted",
            advice=self.advice,
            joints=self.joints,
            value=self.value,
        )


def best(hypotheses: Sequence[Hypothesis], declared: float) -> Hypothesis | None:
    """Return the simplest of the hypotheses that explain a log best; None where none explains it clearly better."""
    if not hypotheses:
        return None
    least = min(item.score for item in hypotheses)
    if not least < CLEAR * declared:
        return None
    limit = least + ALIKE * (declared - least)
    return min(
        (item for item in hypotheses if item.score <= limit), key=lambda item: (item.simplicity, item.score)
    )
