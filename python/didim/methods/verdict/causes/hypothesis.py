"""A hypothesis on why a log contradicts its model, with its score on stretches that it was not fitted on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ....result.verdict import Reason, Severity

ALIKE = 0.02
"""Hypotheses within this share of the best one's gain count as equal, and the simplest of them is named."""
TIED = 1.06
"""So do hypotheses whose score is up to this factor of the best one's: on real logs gravity upside down and a turned twist, or a
torque and its position with the other sign, are as near as that."""
UNTOLD = 1.1
"""Other causes up to this factor are named beside the first, since the log does not tell them apart: on the real TX40 log a doubled
gain of joint 6 and a halved one of joint 5 differ by 1.01, and distinct causes by 1.16 or more."""

MOST_ALIKE = 2
"""Other causes that are named at most."""


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


@dataclass(frozen=True)
class Explanation:
    """The hypothesis that explains a log.

    Attributes
    ----------
    cause : Hypothesis
        The one that is named.
    declared : float
        Score of the declared model.
    alike : tuple of Hypothesis
        Others that explain the log as well.
    """

    cause: Hypothesis
    declared: float
    alike: tuple[Hypothesis, ...] = ()

    @property
    def left(self) -> float:
        """Share of the error that the hypothesis leaves."""
        return float((self.cause.score / self.declared) ** 0.5)

    def reason(self) -> Reason:
        """Return the reason that names it."""
        cause = self.cause
        others = "".join(f", or {item.sentence}" for item in self.alike)
        what = "the first" if self.alike else "that"
        return Reason(
            code=cause.code,
            severity=cause.severity,
            sentence=f"{cause.sentence}{others}{' (this log hardly tells which)' if others else ''}: {what} leaves "
            f"{100.0 * self.left:.3g} % of the error on stretches of the log that were not fitted",
            advice=cause.advice,
            joints=cause.joints,
            value=cause.value,
        )


def best(
    hypotheses: Sequence[Hypothesis], declared: float, clear: float, tied: float = 1.0
) -> Explanation | None:
    """Return the simplest of the hypotheses that explain a log best.

    None where none leaves less than a share `clear` of the declared model's score. Scores up to a factor `tied` of the best one
    count as equal.
    """
    if not hypotheses:
        return None
    least = min(item.score for item in hypotheses)
    if not least < clear * declared:
        return None
    limit = max(least + ALIKE * (declared - least), tied * least)
    cause = min(
        (item for item in hypotheses if item.score <= limit), key=lambda item: (item.simplicity, item.score)
    )
    alike: dict[tuple[str, tuple[int, ...]], Hypothesis] = {}
    for item in sorted(hypotheses, key=lambda item: item.score):
        # What the model lacks does not exclude something else that it lacks: only wrong files and logs are alternatives.
        if item.score < min(UNTOLD * least, clear * declared) and item.severity == cause.severity == "wrong":
            alike.setdefault((item.code, item.joints), item)
    alike.pop((cause.code, cause.joints), None)
    return Explanation(cause, declared, tuple(alike.values())[:MOST_ALIKE])
