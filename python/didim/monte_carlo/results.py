"""Rows of a study, and what they say. Tested in ``tests/test_study.py``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from .rows import Row, Rows, read_rows
from .spec import StudySpec


@dataclass(frozen=True, eq=False)
class StudyResults:
    """Results of a study.

    Attributes
    ----------
    name : str
        Of the study.
    rows : Rows
        Every row once.
    scenarios, methods : tuple of str
        In the order of the study.
    """

    name: str
    rows: Rows
    scenarios: tuple[str, ...]
    methods: tuple[str, ...]

    @classmethod
    def of(cls, spec: StudySpec, rows: Rows) -> StudyResults:
        """Return the rows of a study, without those of others in the same file."""
        scenarios = tuple(item.name for item in spec.scenarios)
        return cls(spec.name, rows, scenarios, tuple(item.label for item in spec.methods))

    @classmethod
    def read(cls, *paths: str | Path) -> StudyResults:
        """Read the rows of a study, of one file or several.

        Raises
        ------
        StudyError
            For a file that does not hold rows.
        """
        rows = read_rows(*(Path(path) for path in paths))
        fits = rows.fits.values()
        return cls(
            Path(paths[0]).stem, rows, _order([*rows.truths], fits, "scenario"), _order([], fits, "method")
        )

    def of_pair(self, scenario: str, method: str) -> list[Row]:
        """Rows of a method on a scenario, by seed."""
        found = [
            row for row in self.rows.fits.values() if (row["scenario"], row["method"]) == (scenario, method)
        ]
        return sorted(found, key=lambda row: int(row["seed"]))

    def __str__(self) -> str:
        return "\n".join(
            f"{scenario}: {method}: {len(self.of_pair(scenario, method))} rows"
            for scenario in self.scenarios
            for method in self.methods
        )


def _order(first: list[str], rows: Iterable[Row], key: str) -> tuple[str, ...]:
    return tuple(sorted({*first, *(str(row[key]) for row in rows)}))
