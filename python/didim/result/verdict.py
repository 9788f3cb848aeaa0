"""A verdict on a result: sound, doubtful or wrong, with the reasons. Tested in ``tests/test_verdict.py``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, Literal, get_args

from .._tools.notebook import page
from .._tools.words import counted
from .status import Status

Severity = Literal["wrong", "doubtful", "note"]
"""How grave a reason is; a note alone leaves a result sound."""
SEVERITIES: tuple[Severity, ...] = get_args(Severity)


class State(Enum):
    """What a verdict says; the value is the word that is printed."""

    SOUND = "sound"
    DOUBTFUL = "doubtful"
    WRONG = "wrong"


@dataclass(frozen=True, kw_only=True)
class Reason:
    """One thing that a verdict rests on.

    Attributes
    ----------
    code : str
        What it is about; docs/verdict.md has a row for each.
    severity : {"wrong", "doubtful", "note"}
        How grave it is.
    sentence : str
        What was seen, where, and how large it is; without a full stop.
    advice : str
        What to do about it; empty where nothing is to be done.
    joints : tuple of int
        Joints concerned, from 1; empty for all or none.
    parameters : tuple of str
        Base parameters concerned; empty for all or none.
    value : float or None
        The number that goes with it, in the unit that the sentence names.
    """

    code: str
    severity: Severity
    sentence: str
    advice: str = ""
    joints: tuple[int, ...] = ()
    parameters: tuple[str, ...] = ()
    value: float | None = None

    def __str__(self) -> str:
        return f"{self.sentence}. {self.advice}." if self.advice else self.sentence

    def to_dict(self) -> dict[str, Any]:
        """Return all fields, as JSON knows them."""
        return {**vars(self), "joints": list(self.joints), "parameters": list(self.parameters)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Reason:
        """Restore what `to_dict` returned.

        Raises
        ------
        KeyError, TypeError, ValueError
            For anything else.
        """
        if data["severity"] not in SEVERITIES:
            raise ValueError(f"there is no severity {data['severity']!r}")
        value = data["value"]
        return cls(
            code=str(data["code"]),
            severity=data["severity"],
            sentence=str(data["sentence"]),
            advice=str(data["advice"]),
            joints=tuple(int(joint) for joint in data["joints"]),
            parameters=tuple(str(name) for name in data["parameters"]),
            value=None if value is None else float(value),
        )


@dataclass(frozen=True)
class Verdict:
    """What the evidence says of a result.

    Attributes
    ----------
    reasons : tuple of Reason
        Gravest first; notes last.
    """

    reasons: tuple[Reason, ...] = ()

    @classmethod
    def of(cls, reasons: Iterable[Reason]) -> Verdict:
        """Return the verdict with its reasons in order of severity; of equal sentences the first is kept."""
        kept: dict[str, Reason] = {}
        for reason in sorted(reasons, key=lambda reason: SEVERITIES.index(reason.severity)):
            kept.setdefault(reason.sentence, reason)
        return cls(tuple(kept.values()))

    @property
    def state(self) -> State:
        """Sound, doubtful or wrong: that of the gravest reason."""
        severities = {reason.severity for reason in self.reasons}
        if "wrong" in severities:
            return State.WRONG
        return State.DOUBTFUL if "doubtful" in severities else State.SOUND

    @property
    def sound(self) -> bool:
        """Whether nothing speaks against the result."""
        return self.state is State.SOUND

    @property
    def grave(self) -> tuple[Reason, ...]:
        """Reasons why the result is not sound, gravest first."""
        return tuple(reason for reason in self.reasons if reason.severity != "note")

    @property
    def notes(self) -> tuple[Reason, ...]:
        """What else a reader should know."""
        return tuple(reason for reason in self.reasons if reason.severity == "note")

    def _repr_html_(self) -> str:
        rows = [(reason.severity, reason.sentence, reason.advice) for reason in self.reasons]
        return page(self.sentence, [("", "reason", "advice"), *rows] if rows else "")

    @property
    def sentence(self) -> str:
        """The verdict in one line."""
        if self.sound:
            return "Verdict: sound: nothing speaks against the model, the log or the closed loop."
        return f"Verdict: {self.state.value}, for {counted(len(self.grave), 'reason')}: {self.grave[0].sentence}."

    def lines(self) -> list[str]:
        """Return the reasons as lines under headings; empty without any."""
        found = []
        for severity, title in (
            ("wrong", "Wrong:"),
            ("doubtful", "Doubtful:"),
            ("note", "To know:"),
        ):
            texts = [str(reason) for reason in self.reasons if reason.severity == severity]
            if texts:
                found += ["", title, *(f"  {text}" for text in texts)]
        return found

    def __str__(self) -> str:
        return "\n".join([*self.lines(), "", self.sentence]).lstrip("\n")

    def to_dict(self) -> dict[str, Any]:
        """Return state, sentence and reasons, as JSON knows them."""
        return {
            "state": self.state.value,
            "sentence": self.sentence,
            "reasons": [reason.to_dict() for reason in self.reasons],
        }


SIGNIFICANT = "(noise can explain it)"
"""What a sentence on physics says of a parameter whose sign is not significant."""
DERIVED = frozenset({"not-converged", "interrupted", "remark"})
"""Codes of reasons that follow from other fields of a result."""


def derived(status: Status, warnings: Iterable[str], remarks: Iterable[str]) -> list[Reason]:
    """Return the reasons that follow from a status, from sentences on physics, and from remarks."""
    found = []
    if not status.converged:
        asked = status in (Status.INTERRUPTED, Status.STOPPED)
        what, _, advice = status.value.partition(": ")
        about, _, advice = advice.partition("; ")
        found.append(
            Reason(
                code="interrupted" if asked else "not-converged",
                severity="doubtful" if asked else "wrong",
                sentence=f"{what[:1].lower()}{what[1:]}: {about.rstrip('.')}",
                advice=f"{advice[:1].upper()}{advice[1:].rstrip('.')}",
            )
        )
    found += [
        Reason(
            code="not-physical",
            severity="note" if SIGNIFICANT in text else "doubtful",
            sentence=text,
        )
        for text in warnings
    ]
    return [*found, *(Reason(code="remark", severity="note", sentence=text) for text in remarks)]
