"""The text of a study's figures. Tested in ``tests/test_study_figures.py``."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .._tools.words import columned, counted, known_names
from ..errors import StudyError
from .figures import Estimate, Figures

HEAD = (
    "method", "runs", "failed", "open", "bias", "rms", "coverage %", "torque error %", "95 % below",
    "parameters %", "of mean %", "simulations", "seconds",
)  # fmt: skip
"""Headings of the table, see docs/studies.md."""
NOTES = (
    "bias, rms: errors in reported standard deviations; rms is 1 and coverage 95 % when these are right",
    "torque error: on another motion, median run; parameters: |beta - truth| / |truth|, median run, and that of the mean estimate",
    "[low, high]: 95 % interval over the runs; open: runs that did not converge, whose estimates count; failed runs have none",
)


def columns_named(names: Sequence[str]) -> tuple[str, ...]:
    """Return the headings of the columns with these names, the method first; the part `%` of a heading may be left out.

    Raises
    ------
    StudyError
        For a name of no column.
    """
    known = {heading.removesuffix(" %"): heading for heading in HEAD}
    for name in names:
        if name.removesuffix(" %") not in known:
            raise StudyError(f"there is no column '{name}': {known_names(name, list(known), 'column')}")
    return tuple(dict.fromkeys([HEAD[0], *(known[name.removesuffix(" %")] for name in names)]))


def study_lines(name: str, figures: Sequence[Figures], missing: str, head: Sequence[str] = HEAD) -> list[str]:
    """Lines of the whole text: one table for each scenario, with the columns of `head`."""
    runs, failed = (sum(getattr(row, key) for row in figures) for key in ("runs", "failed"))
    lines = [f"{name}: {counted(runs, 'run')}, {failed} failed", ""]
    for scenario in dict.fromkeys(row.scenario for row in figures):
        rows = [head, *(cells(row, head) for row in figures if row.scenario == scenario)]
        lines += [scenario, *(f"  {line}" for line in columned(rows)), ""]
    return [*lines, *([missing] if missing else []), *NOTES]


def cells(figures: Figures, head: Sequence[str] = HEAD) -> tuple[str, ...]:
    """Cells of one row, in the columns of `head`."""
    row = (
        figures.method,
        str(figures.runs),
        str(figures.failed),
        str(figures.not_converged),
        estimate(figures.bias),
        estimate(figures.rms),
        estimate(figures.coverage, 100.0, 1),
        estimate(figures.torque_error, 100.0),
        number(100.0 * figures.torque_error_q95),
        estimate(figures.parameter_error, 100.0),
        number(100.0 * figures.mean_error),
        number(figures.simulations),
        number(figures.seconds),
    )
    shown = dict(zip(HEAD, row, strict=True))
    return tuple(shown[heading] for heading in head)


def estimate(result: Estimate, factor: float = 1.0, decimals: int | None = None) -> str:
    """Return a figure with its interval."""

    def shown(value: float) -> str:
        value *= factor
        return number(value) if decimals is None or not math.isfinite(value) else f"{value:.{decimals}f}"

    if math.isnan(result.low):
        return shown(result.value)
    return f"{shown(result.value)} [{shown(result.low)}, {shown(result.high)}]"


def number(value: float) -> str:
    """Return a number with three digits."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.3g}" if abs(value) < 1e4 else f"{value:.0e}"
