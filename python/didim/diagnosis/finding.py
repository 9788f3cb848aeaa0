"""What a check says: findings, each one sentence and what to do about it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args, overload

from .._tools.files import write_atomically
from .._tools.notebook import page

SCHEMA = 1
"""Version of the JSON of `Findings.save`."""

Kind = Literal[
    "gap",
    "uneven-time",
    "rate",
    "too-slow",
    "stuck",
    "jump",
    "constant-torque",
    "clipped",
    "quantised",
    "spikes",
    "limits",
    "range",
    "unit",
    "side",
    "torque-sign",
    "position-sign",
    "joint-sign",
    "swapped-torques",
    "swapped-positions",
    "swapped-joints",
    "gear-ratio",
    "drive-gain",
    "position-scale",
    "delay",
    "excitation",
    "standstill",
    "no-torque",
    "signal",
    "gravity",
    "dh-convention",
    "a-and-d",
    "twist-sign",
    "link-length",
    "controller",
    "controller-gain",
    "controller-delay",
    "reference-late",
    "saturation",
    "feed-forward",
    "reference",
    "payload",
]
"""What a finding is about; docs/check.md has a row for each."""

KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that looks wrong in a log.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    sentence : str
        What was seen, and where.
    advice : str
        What to do about it.
    recording, file, column : str or None
        Recording, data file, and column of the file (its name or number).
    joints : tuple of int
        Joints concerned, from 1; empty for all or none.
    sample, last_sample : int or None
        First and last sample concerned, from 0.
    parameters : tuple of str
        Base parameters that the log does not identify.
    value : float or None
        The number that goes with it: the delay in samples, the rate in Hz, the factor of a scale.
    """

    kind: Kind
    sentence: str
    advice: str
    recording: str | None = None
    file: str | None = None
    column: str | None = None
    joints: tuple[int, ...] = ()
    sample: int | None = None
    last_sample: int | None = None
    parameters: tuple[str, ...] = ()
    value: float | None = None

    def __str__(self) -> str:
        return f"{self.kind}: {self.sentence}. {self.advice}."

    def to_dict(self) -> dict[str, Any]:
        """Return all fields, as JSON knows them."""
        return {
            **vars(self),
            "joints": list(self.joints),
            "parameters": list(self.parameters),
        }


@dataclass(frozen=True)
class Findings(Sequence[Finding]):
    """Findings of an experiment, gravest first; empty for a log with nothing to say about.

    Attributes
    ----------
    experiment : str
        Name of the experiment.
    items : tuple of Finding
        The findings.
    joint_names : tuple of str
        Names of the robot's joints; empty where its file has none.
    closed_loop : tuple of tuple of str
        Heading and rows of a table: gains that the log shows over the declared ones, by joint; empty without a controller.
    notes : tuple of str
        What the log cannot show; nothing is wrong with it for that.
    sources : tuple of str
        SHA-256 of the files of the experiment, which `save` does not write over.
    """

    experiment: str
    items: tuple[Finding, ...] = ()
    joint_names: tuple[str, ...] = ()
    closed_loop: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()

    @overload
    def __getitem__(self, index: int) -> Finding: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Finding, ...]: ...
    def __getitem__(self, index: int | slice) -> Finding | tuple[Finding, ...]:
        return self.items[index]

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Finding]:
        return iter(self.items)

    def __str__(self) -> str:
        if not self.items:
            return "\n".join([f"{self.experiment}: nothing found.", *self._tail()])
        head = f"{self.experiment}: {len(self)} finding{'' if len(self) == 1 else 's'}"
        lines = [head, *(f"- {item}" for item in self.items)]
        joints = sorted({joint for item in self.items for joint in item.joints})
        if self.joint_names and joints:
            lines.append(f"joints: {', '.join(f'{joint} {self.joint_names[joint - 1]}' for joint in joints)}")
        return "\n".join([*lines, *self._tail()])

    def _tail(self) -> list[str]:
        noted = [f"To know: {note}." for note in self.notes]
        if not self.closed_loop:
            return noted
        widths = [max(map(len, column)) for column in zip(*self.closed_loop, strict=True)]
        rows = [
            "  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True))
            for row in self.closed_loop
        ]
        return [*noted, "", "the controller as the log shows it, in units of the declared gains:", *rows]

    def _repr_html_(self) -> str:
        if not self.items:
            return page(str(self))
        title, *tail = (line for line in str(self).split("\n") if not line.startswith("- "))
        rows = [(item.kind, item.sentence, item.advice) for item in self.items]
        return page(title, [("kind", "finding", "what to do"), *rows], "\n".join(tail))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``didim check --json`` writes."""
        return {
            "schema": SCHEMA,
            "experiment": self.experiment,
            "findings": [item.to_dict() for item in self.items],
            "closed_loop": [dict(zip(self.closed_loop[0], row, strict=True)) for row in self.closed_loop[1:]],
            "notes": list(self.notes),
        }

    def save(self, path: str | Path) -> None:
        """Write the JSON of `to_dict`, whole or not at all."""
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False)
        write_atomically(Path(path), text + "\n", self.sources)
