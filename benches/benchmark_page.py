"""Tables of docs/choose.md, from the figures of the study in docs/benchmark.csv.

    didim study examples/study_tx40.toml -o study_tx40.jsonl --quiet --format csv > docs/benchmark.csv
    python benches/benchmark_page.py docs/benchmark.csv

prints them in markdown. The median torque error on another motion and the coverage of the 95 % intervals are those of the study.
Tested in ``tests/test_benchmark_page.py``.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from pathlib import Path

Row = dict[str, str]


def read(path: Path) -> list[Row]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def table(rows: list[Row], cell: Callable[[Row], str], what: str) -> str:
    """One line for each scenario, one column for each method."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    lines = [f"| {what} | " + " | ".join(methods) + " |", "|---" + "|---:" * len(methods) + "|"]
    for scenario in dict.fromkeys(row["scenario"] for row in rows):
        cells = {row["method"]: cell(row) for row in rows if row["scenario"] == scenario}
        lines.append("| " + " | ".join([scenario, *(cells.get(method, "") for method in methods)]) + " |")
    return "\n".join(lines)


def number(text: str, factor: float = 1.0, digits: int = 2) -> str:
    if not text:
        return "-"
    value = factor * float(text)
    if value >= 100.0:
        return f"{value:.0f}" if value < 1000.0 else "> 1000"
    return f"{value:.{digits}g}"


def torque_error(row: Row) -> str:
    found = number(row["torque_error"], 100.0)
    low, high = (number(row[f"torque_error_{end}"], 100.0) for end in ("low", "high"))
    return found if low == "-" or found == "> 1000" else f"{found} [{low}, {high}]"


def coverage(row: Row) -> str:
    """Coverage, with half of its interval."""
    if not row["coverage"]:
        return "-"
    if not row["coverage_low"]:
        return f"{100.0 * float(row['coverage']):.0f}"
    half = 50.0 * (float(row["coverage_high"]) - float(row["coverage_low"]))
    return f"{100.0 * float(row['coverage']):.0f} ± {half:.0f}"


def tables(rows: list[Row]) -> list[str]:
    """The tables of the page, in order."""
    return [table(rows, torque_error, "torque error, %"), table(rows, coverage, "coverage, %")]


if __name__ == "__main__":
    print("\n\n".join(tables(read(Path(sys.argv[1])))))
