"""Findings: records of evidence for or against a result or a log. Their sentences are written last, in ``sentences.py``.

No code reads a sentence. Tested in ``tests/test_verdict.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, get_args

from .._tools.pickling import Pickled
from .._tools.saved import plain, restored
from .sentences import advice_of, sentence_of

Grade = Literal["wrong", "doubtful", "note"]
"""Severity of a finding; notes alone leave a result sound."""
GRADES: tuple[Grade, ...] = get_args(Grade)


@dataclass(frozen=True, kw_only=True)
class Remedy:
    """An edit of a file that resolves a finding.

    Attributes
    ----------
    file : {"experiment", "robot"}
        Which file.
    table, key : str
        Table and key, such as ``[signal]`` and ``spikes``.
    action : {"set", "turn", "exchange", "divide", "add"}
        Kind of the edit.
    value : float, str, list or None
        Value to be set, or divisor.
    joints : tuple of int
        Entries concerned, by joints, or tables of ``[[joint]]``, from 1; empty for all.
    """

    file: Literal["experiment", "robot"]
    table: str
    key: str
    action: Literal["set", "turn", "exchange", "divide", "add"]
    value: float | str | list[float] | None = None
    joints: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Finding(Pickled):
    """One piece of evidence for a verdict.

    Tested in ``tests/test_verdict.py``.

    Attributes
    ----------
    code : str
        Kind of the finding; docs/verdict.md has a row for each.
    grade : {"wrong", "doubtful", "note"}
        Severity, by its effect.
    joints : tuple of int
        Joints concerned, from 1; empty for all or none.
    parameters : tuple of str
        Base parameters concerned; empty for all or none.
    recordings : tuple of str
        Recordings concerned; empty for all.
    value, deviation : float or None
        Its number, in the unit of the sentence, and the standard deviation.
    effect : float or None
        Effect on the result: D of a cause (``didim.evidence.products``), a shift of parameters in sigma, or a share.
    remedy : Remedy or None
        Edit that resolves it.
    facts : mapping
        Further content of the sentence: numbers, texts and lists (JSON data).
    """

    code: str
    grade: Grade
    joints: tuple[int, ...] = ()
    parameters: tuple[str, ...] = ()
    recordings: tuple[str, ...] = ()
    value: float | None = None
    deviation: float | None = None
    effect: float | None = None
    remedy: Remedy | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "facts", MappingProxyType(dict(self.facts)))

    @property
    def sentence(self) -> str:
        """Sentence with observation, location and size; without a full stop."""
        return sentence_of(self)

    @property
    def advice(self) -> str:
        """Advice; empty if no action is needed."""
        return advice_of(self)

    @property
    def kind(self) -> str:
        """Name of `code` in 0.2.0."""
        return self.code

    @property
    def recording(self) -> str | None:
        """The recording concerned; None for all or several."""
        return self.recordings[0] if len(self.recordings) == 1 else None

    @property
    def file(self) -> str | None:
        """The data file concerned, if any."""
        return self.facts.get("file")

    @property
    def column(self) -> str | None:
        """Name or number of the column of that file."""
        return self.facts.get("column")

    @property
    def sample(self) -> int | None:
        """First sample concerned, from 0."""
        return self.facts.get("sample")

    @property
    def last_sample(self) -> int | None:
        """Last sample concerned."""
        return self.facts.get("last_sample")

    def __str__(self) -> str:
        advice = self.advice
        return f"{self.sentence}. {advice}." if advice else self.sentence

    def to_dict(self) -> dict[str, Any]:
        """Return all fields and the sentence as JSON data.

        `severity` is the name of `grade` in 0.2.0.
        """
        return {**plain(self), "severity": self.grade, "sentence": self.sentence, "advice": self.advice}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Finding:
        """Restore a finding from `to_dict` of this version or of 0.2.0.

        Raises
        ------
        KeyError, TypeError, ValueError
            For anything else.
        """
        facts = {"text": str(data["sentence"]), "advice": str(data["advice"])}
        data = {"grade": data.get("severity"), "facts": facts, **data}
        if data["grade"] not in GRADES:
            raise ValueError(f"there is no grade {data['grade']!r}")
        made: Finding = restored(cls, {key: data[key] for key in cls.__dataclass_fields__ if key in data})
        return made


def worded(
    *,
    kind: str,
    sentence: str,
    advice: str,
    grade: Grade = "doubtful",
    recording: str | None = None,
    joints: tuple[int, ...] = (),
    parameters: tuple[str, ...] = (),
    value: float | None = None,
    **facts: Any,
) -> Finding:
    """Return a finding with its own sentence, and its location: file, column, samples."""
    recordings = () if recording is None else (recording,)
    return Finding(
        code=kind,
        grade=grade,
        joints=joints,
        parameters=parameters,
        recordings=recordings,
        value=value,
        facts={"text": sentence, "advice": advice, **facts},
    )
