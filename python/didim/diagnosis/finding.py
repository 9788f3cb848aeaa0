"""Findings of a check on a log, as a table, a text or JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

from .._tools.notebook import page
from .._tools.saved import save_json
from .._tools.words import columned
from ..result.finding import Finding

SCHEMA = 1
"""Version of the JSON of `Findings.save`."""


@dataclass(frozen=True)
class Findings(Sequence[Finding]):
    """Findings of an experiment, gravest first; empty for a clean log.

    Tested in ``tests/test_check.py``.

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

    def __str__(self) -> str:
        if not self.items:
            return "\n".join([f"{self.experiment}: nothing found.", *self._tail()])
        head = f"{self.experiment}: {len(self)} finding{'' if len(self) == 1 else 's'}"
        lines = [head, *(f"- {finding.code}: {finding}" for finding in self.items)]
        joints = sorted({joint for finding in self.items for joint in finding.joints})
        if self.joint_names and joints:
            lines.append(f"joints: {', '.join(f'{joint} {self.joint_names[joint - 1]}' for joint in joints)}")
        return "\n".join([*lines, *self._tail()])

    def _tail(self) -> list[str]:
        noted = [f"Note: {note}." for note in self.notes]
        if not self.closed_loop:
            return noted
        rows = columned(self.closed_loop, left=0)
        return [*noted, "", "the controller as the log shows it, in units of the declared gains:", *rows]

    def _repr_html_(self) -> str:
        if not self.items:
            return page(str(self))
        title, *tail = (line for line in str(self).split("\n") if not line.startswith("- "))
        rows = [(finding.kind, finding.sentence, finding.advice) for finding in self.items]
        return page(title, [("kind", "finding", "what to do"), *rows], "\n".join(tail))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``didim check --json`` writes."""
        return {
            "schema": SCHEMA,
            "experiment": self.experiment,
            "findings": [_item(finding) for finding in self.items],
            "closed_loop": [dict(zip(self.closed_loop[0], row, strict=True)) for row in self.closed_loop[1:]],
            "notes": list(self.notes),
        }

    def save(self, path: str | Path) -> None:
        """Write the JSON of `to_dict`, whole or not at all."""
        save_json(path, self.to_dict(), self.sources)


def _item(finding: Finding) -> dict[str, Any]:
    """Return a finding with where it was seen, by the names of schema 1."""
    seen = {
        key: getattr(finding, key) for key in ("kind", "recording", "file", "column", "sample", "last_sample")
    }
    return {**finding.to_dict(), **seen}
