"""Rows of a study, and their figures of merit. Tested in ``tests/test_study_figures.py``."""

from __future__ import annotations

import io
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

from .._tools.files import write_atomically
from .._tools.notebook import Printed
from .._tools.plugins import optional
from .._tools.words import counted, series
from ..errors import StudyError
from .figures import Estimate, Figures, figures_of
from .rows import Row, Rows, read_rows
from .spec import StudySpec
from .text import HEAD, columns_named, study_lines


@dataclass(frozen=True, eq=False, repr=False)
class StudyResults(Printed):
    """Results of a study.

    Tested in ``tests/test_study_figures.py``.

    Attributes
    ----------
    name : str
        Name of the study.
    rows : Rows
        Every row once.
    scenarios, methods : tuple of str
        Names in the order of the study; if only rows are known, sorted by name, with numbers by size.
    head : tuple of str
        Headings of the columns that text, markdown, LaTeX and the report show; CSV and Parquet have all figures.
    """

    name: str
    rows: Rows
    scenarios: tuple[str, ...]
    methods: tuple[str, ...]
    head: tuple[str, ...] = HEAD

    @classmethod
    def of(cls, spec: StudySpec, rows: Rows) -> StudyResults:
        """Return the rows of a study."""
        scenarios = tuple(scenario.name for scenario in spec.scenarios)
        return cls(spec.name, rows, scenarios, tuple(scenario.label for scenario in spec.methods))

    @classmethod
    def read(cls, *paths: str | Path, appended: bool = False) -> StudyResults:
        """Read the rows of a study, of one file or several.

        Parameters
        ----------
        paths : str or Path
            Files of rows.
        appended : bool
            Whether they are outputs of this run.

        Raises
        ------
        StudyError
            For a file that does not hold rows.
        """
        rows = read_rows(*(Path(path) for path in paths), appended=appended)
        fits = rows.fits.values()
        names = [*rows.truths, *(row["scenario"] for row in fits)]
        methods = sorted({row["method"] for row in fits})
        return cls(
            Path(paths[0]).stem, rows, tuple(dict.fromkeys(sorted(names, key=_natural))), tuple(methods)
        )

    def with_columns(self, *names: str) -> StudyResults:
        """Return the results with these columns in their tables, such as "rms".

        Raises
        ------
        StudyError
            For a name of no column.
        """
        return replace(self, head=columns_named(names))

    def of_pair(self, scenario: str, method: str) -> list[Row]:
        """Return the rows of a method on a scenario, by seed."""
        return self._pairs.get((scenario, method), [])

    @cached_property
    def figures(self) -> tuple[Figures, ...]:
        """Return the figures of merit of every method on every scenario with rows."""
        times = self.rows.times
        figures = []
        for scenario in self.scenarios:
            truth = self.rows.truths.get(scenario)
            for method in self.methods:
                rows = self.of_pair(scenario, method)
                if truth is None or not rows:
                    continue
                seconds = [times[row["id"]]["seconds"] for row in rows if row["id"] in times]
                values = truth.get("truth", [])
                figures.append(figures_of(scenario, method, rows, values, seconds))
        return tuple(figures)

    def columns(self) -> dict[str, list[str | int | float]]:
        """Return the figures as columns, an estimate as value, lower and upper end."""
        columns: dict[str, list[str | int | float]] = defaultdict(list)
        for figures in self.figures:
            for key in (field.name for field in fields(figures)):
                value = getattr(figures, key)
                if isinstance(value, Estimate):
                    for end in ("value", "low", "high"):
                        columns[key if end == "value" else f"{key}_{end}"].append(getattr(value, end))
                else:
                    columns[key].append(value)
        return dict(columns)

    def write_parquet(self, path: str | Path) -> None:
        """Write the figures as a Parquet file.

        Raises
        ------
        StudyError
            Without pyarrow.
        """
        needed = "Parquet files need pyarrow: pip install pyarrow"
        arrow, parquet = (optional(name, StudyError, needed) for name in ("pyarrow", "pyarrow.parquet"))
        content = io.BytesIO()
        parquet.write_table(arrow.table(self.columns()), content)
        write_atomically(Path(path), content.getvalue())

    def missing(self) -> str:
        """Return a sentence on rows of scenarios without a truth, or an empty text."""
        lost = [name for name in self.scenarios if name not in self.rows.truths]
        if not lost:
            return ""
        reasons = [self.rows.untrue[name]["sentence"] for name in lost if name in self.rows.untrue]
        why = f" ({reasons[0]})" if reasons else ""
        runs = sum(row["scenario"] in lost for row in self.rows.fits.values())
        left = f"; {counted(runs, 'run')} not in this table" if runs else ""
        return f"{counted(len(lost), 'scenario')} without the row of the truth: {series(lost, 60)}{why}{left}"

    def __str__(self) -> str:
        return "\n".join(study_lines(self.name, self.figures, self.missing(), self.head))

    @cached_property
    def _pairs(self) -> Mapping[tuple[str, str], list[Row]]:
        pairs: dict[tuple[str, str], list[Row]] = defaultdict(list)
        for row in sorted(self.rows.fits.values(), key=lambda row: int(row["seed"])):
            pairs[row["scenario"], row["method"]].append(row)
        return pairs


def _natural(name: str) -> list[str | float]:
    """Return the key for sorting names with numbers by size: ``cutoff_hz = 60`` comes before ``cutoff_hz = 200``."""
    parts = re.split(r"(\d+(?:\.\d*)?(?:e[-+]?\d+)?)", name)
    return [float(part) if k % 2 else part for k, part in enumerate(parts)]
