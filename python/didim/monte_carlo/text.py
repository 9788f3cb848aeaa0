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
    runs, failed = (sum(getattr(item, key) for item in figures) for key in ("runs", "failed"))
    lines = [f"{name}: {counted(runs, 'run')}, {failed} failed", ""]
    for scenario in dict.fromkeys(item.scenario for item in figures):
        rows = [head, *(cells(item, head) for item in figures if item.scenario == scenario)]
        lines += [scenario, *(f"  {line}" for line in columned(rows)), ""]
    return [*lines, *([missing] if missing else []), *NOTES]


def cells(item: Figures, head: Sequence[str] = HEAD) -> tuple[str, ...]:
    """Cells of one row, in the columns of `head`."""
    row = (
        item.method,
        str(item.runs),
        str(item.failed),
        str(item.not_converged),
        estimate(item.bias),
        estimate(item.rms),
        estimate(item.coverage, 100.0, 1),
        estimate(item.torque_error, 100.0),
        number(100.0 * item.torque_error_q95),
        estimate(item.parameter_error, 100.0),
        number(100.0 * item.mean_error),
        number(item.simulations),
        number(item.seconds),
    )
    shown = dict(zip(HEAD, row, strict=True))
    return tuple(shown[heading] for heading in head)


def estimate(found: Estimate, factor: float = 1.0, decimals: int | None = None) -> str:
    """Return a figure with its interval."""

    def shown(value: float) -> str:
        value *= factor
        return number(value) if decimals is None or not math.isfinite(value) else f"{value:.{decimals}f}"

    if math.isnan(found.low):
        return shown(found.value)
    return f"{shown(found.value)} [{shown(found.low)}, {shown(found.high)}]"


def number(value: float) -> str:
    """Return a number with three digits."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.3g}" if abs(value) < 1e4 else f"{value:.0e}"
