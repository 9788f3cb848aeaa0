"""A verdict on a result: sound, doubtful or wrong, with the reasons. Tested in ``tests/test_verdict.py``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from .._tools.notebook import page
from .._tools.saved import plain
from .._tools.words import counted
from .finding import GRADES, Finding
from .iteration import Status
from .sentences import percent


class State(StrEnum):
    """State of a verdict; the value is printed."""

    SOUND = "sound"
    DOUBTFUL = "doubtful"
    WRONG = "wrong"


Reason = Finding
"""Finding as a reason of a verdict."""


@dataclass(frozen=True)
class Use:
    """Suitability of a result for one use.

    Attributes
    ----------
    name : {"simulation", "gravity compensation", "control", "payload"}
        The use.
    error : float or None
        Expected error: a share of the torques (0.04 = 4 %), or for a payload a mass (kg), twice its standard deviation; None if
        the result is unsuitable.
    fit_for : bool
        Whether the result is suitable.
    why : str
        Basis of the error, or the reason against the use.
    """

    name: str
    error: float | None
    fit_for: bool
    why: str

    def __str__(self) -> str:
        if self.error is None:
            return f"{self.name}: no, {self.why}"
        size = f"{self.error:.2g} kg" if self.name == "payload" else f"{percent(self.error)} % of the torques"
        return f"{self.name}: {size}, {self.why}"


@dataclass(frozen=True)
class Verdict:
    """Verdict on a result, from its findings.

    Tested in ``tests/test_verdict.py``.

    Attributes
    ----------
    reasons : tuple of Finding
        Gravest first; notes last.
    uses : tuple of Use
        Suitability for each use, with the expected error; empty if unknown.
    """

    reasons: tuple[Finding, ...] = ()
    uses: tuple[Use, ...] = ()

    @classmethod
    def of(cls, reasons: Iterable[Finding], uses: Iterable[Use] = ()) -> Verdict:
        """Return the verdict, its reasons by severity and without repeated sentences."""
        strongest: dict[str, Finding] = {}
        for reason in sorted(reasons, key=lambda reason: GRADES.index(reason.grade)):
            strongest.setdefault(reason.sentence, reason)
        return cls(tuple(strongest.values()), tuple(uses))

    @property
    def state(self) -> State:
        """Sound, doubtful or wrong, by the gravest reason."""
        grades = {reason.grade for reason in self.reasons}
        if "wrong" in grades:
            return State.WRONG
        return State.DOUBTFUL if "doubtful" in grades else State.SOUND

    @property
    def sound(self) -> bool:
        """Whether there is no reason against the result."""
        return self.state is State.SOUND

    @property
    def grave(self) -> tuple[Finding, ...]:
        """Reasons why the result is not sound, gravest first."""
        return tuple(reason for reason in self.reasons if reason.grade != "note")

    @property
    def notes(self) -> tuple[Finding, ...]:
        """Notes, which do not affect the state."""
        return tuple(reason for reason in self.reasons if reason.grade == "note")

    def _repr_html_(self) -> str:
        rows = [(reason.grade, reason.sentence, reason.advice) for reason in self.reasons]
        return page(self.sentence, [("", "reason", "advice"), *rows] if rows else "")

    @property
    def sentence(self) -> str:
        """The verdict in one line."""
        if self.sound:
            return "Verdict: sound: nothing speaks against the model, the log or the closed loop."
        return f"Verdict: {self.state.value}, for {counted(len(self.grave), 'reason')}: {self.grave[0].sentence}."

    def lines(self) -> list[str]:
        """Return the reasons as lines under headings; empty without any."""
        lines = []
        for grade, title in (("wrong", "Wrong:"), ("doubtful", "Doubtful:"), ("note", "Notes:")):
            texts = [str(reason) for reason in self.reasons if reason.grade == grade]
            if texts:
                lines += ["", title, *(f"  {text}" for text in texts)]
        if self.uses:
            lines += ["", "Good for, with the error to expect:", *(f"  {use}" for use in self.uses)]
        return lines

    def __str__(self) -> str:
        return "\n".join([*self.lines(), "", self.sentence]).lstrip("\n")

    def to_dict(self) -> dict[str, Any]:
        """Return state, sentence and reasons as JSON data."""
        return {
            "state": self.state.value,
            "sentence": self.sentence,
            "reasons": [reason.to_dict() for reason in self.reasons],
            "uses": plain(self.uses),
        }


DERIVED = frozenset({"not-converged", "interrupted", "remark"})
"""Codes of findings that repeat other fields of a result."""


def derived(status: Status, warnings: Iterable[str], remarks: Iterable[str]) -> list[Finding]:
    """Return the findings that follow from a status, from flags on physics, and from remarks."""
    reasons = []
    if not status.converged:
        asked = status in (Status.INTERRUPTED, Status.STOPPED)
        reasons.append(
            Finding(
                code="interrupted" if asked else "not-converged",
                grade="doubtful" if asked else "wrong",
                facts={"text": f"{status.value[:1].lower()}{status.value[1:].rstrip('.')}"},
            )
        )
    reasons += [Finding(code="not-physical", grade="doubtful", facts={"text": text}) for text in warnings]
    return [*reasons, *(Finding(code="remark", grade="note", facts={"text": text}) for text in remarks)]
