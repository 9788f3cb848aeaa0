"""Results as Markdown, LaTeX and CSV, for pages, papers and spreadsheets.

Markdown and LaTeX have the digits of the printed table, CSV has all of them. Tested in ``tests/test_formats.py``.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .errors import FitError
from .methods.table import title_of
from .monte_carlo.results import StudyResults
from .monte_carlo.text import NOTES, cells
from .result.identification import Identification
from .result.table import LARGEST_PERCENT
from .robot.parameters import BaseParameters
from .studies.comparison import Comparison, off_explained, sentences

FORMATS = ("text", "markdown", "latex", "csv")
"""Formats of a result; ``print`` shows "text"."""

Result = Identification | Comparison | BaseParameters | StudyResults


@dataclass(frozen=True)
class Grid:
    """Cells of a table; `align` has a letter per column, ``l`` for text and ``r`` for numbers.

    `groups` are headings over several columns each, from the first column on; `units` is true if the second column has units.
    """

    head: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    align: str
    groups: tuple[tuple[str, int], ...] = ()
    units: bool = True


def render(result: Result, form: str = "text") -> str:
    r"""Write a result as a table.

    Parameters
    ----------
    result : Identification, Comparison, BaseParameters or StudyResults
        A comparison has the form of Table II.
    form : {"text", "markdown", "latex", "csv"}
        ``text`` is ``str(result)``; ``markdown`` has pipe tables; ``latex`` is one ``tabular`` of the package booktabs, with
        remarks as comments; ``csv`` has a heading and all digits of every number.

    Returns
    -------
    str
        Lines without a final line feed. Values are in SI units, joint side. Standard deviations that a method does not give
        (a simplex has none) are ``-``, and empty in CSV.

    Raises
    ------
    FitError
        For an unknown format.
    """
    if form not in FORMATS:
        raise FitError(f"there is no format {form!r}; there are: {', '.join(FORMATS)}")
    if form == "text":
        return str(result)
    if isinstance(result, Identification):
        return _identification(result, form)
    if isinstance(result, Comparison):
        return _comparison(result, form)
    if isinstance(result, StudyResults):
        return _study(result, form)
    rows = list(zip(result.names, result.units, result.groupings, strict=True))
    if form == "csv":
        return _csv([("name", "unit", "grouping"), *rows])
    grid = Grid(("parameter", "unit", "grouping"), rows, "lll")
    return _markdown(grid) if form == "markdown" else _latex(grid)


def _identification(fit: Identification, form: str) -> str:
    if form == "csv":
        known = fit.std.any()
        keys = ("std", "relative_std_percent", "low", "high", "std_white")
        rows: list[Sequence[str]] = [("name", "unit", "value", *keys, "role")]
        for row in fit.value_rows():
            silent = row["role"] == "estimated" and not known
            sigmas = ("" if silent else _exact(row[key]) for key in keys)
            rows.append((row["name"], row["unit"], _exact(row["value"]), *sigmas, row["role"]))
        return _csv(rows)
    head, *body = fit.parameter_rows()
    columns = (*head[:-1], "remark")
    further = [] if fit.further is None else fit.further.tables(fit.interval_factor())
    errors_head, *errors = fit.error_rows()
    title = f"{fit.name}: robot {fit.robot} by {fit.method}"
    notes = [*map(str, fit.verdict.reasons), fit.conclusion, fit.verdict.sentence]
    if form == "latex":
        lines = [" ".join(row) for row in (errors_head, *errors)]
        # One tabular: parameters of single logs are prefixed by their owner.
        names = [] if fit.further is None else fit.further.names
        rest = [row for _, (_, *block) in further for row in block]
        body += [(name, *row[1:]) for name, row in zip(names, rest, strict=True)]
        titles = [line for above, _ in further for line in above]
        return _latex(Grid(columns, body, "llrrrrrrl"), [title, *titles, *lines, *notes])
    tables = [_markdown(Grid(columns, body, "llrrrrrrl"))]
    for above, (_, *block) in further:
        tables += [*map(_escaped, above), _markdown(Grid(columns, block, "llrrrrrrl"))]
    tables.append(_markdown(Grid(errors_head, errors, "l" + "r" * (len(errors_head) - 1))))
    return _pages(title, tables, notes)


def _estimates(comparison: Comparison) -> Iterable[tuple[str, str, float, Sequence[Sequence[float]]]]:
    """Give name, unit and truth of each base parameter, and of each method estimate, sigma, sigma % and deviation.

    Those of a method without standard deviations are NaN.
    """
    base, columns = comparison.experiment.robot.base_parameters, []
    for method, fit in comparison.fits.items():
        sigmas = np.stack([fit.std, fit.relative_std_percent, comparison.deviations(method)])
        columns.append(np.stack([fit.beta, *(sigmas if fit.std.any() else np.nan * sigmas)], axis=1).tolist())
    return zip(base.names, base.units, comparison.truth.tolist(), zip(*columns, strict=True), strict=True)


def _comparison(comparison: Comparison, form: str) -> str:
    fits = comparison.fits
    if form == "csv":
        keys = ("value", "std", "relative_std_percent", "deviation")
        head = ("name", "unit", "truth", *(f"{method}_{key}" for method in fits for key in keys))
        rows = (
            [name, unit, _exact(truth), *(_exact(value) for estimate in estimates for value in estimate)]
            for name, unit, truth, estimates in _estimates(comparison)
        )
        return _csv([head, *rows])
    body = []
    for name, unit, truth, estimates in _estimates(comparison):
        cells = [name, unit, f"{truth:.4g}"]
        for value, _, percent, off in estimates:
            cells += [f"{value:.4g}", _percent(percent), "-" if math.isnan(off) else f"{off:.1f}"]
        body.append(cells)
    align = "llr" + "rrr" * len(fits)
    titles = [title_of(method) for method in fits]
    notes = [off_explained(comparison), *sentences(comparison), *comparison.notes, *comparison.remarks]
    if form == "latex":
        grid = Grid(
            ("", "", "truth", *("estimate", "sigma %", "off") * len(fits)),
            body,
            align,
            (("", 3), *((title, 3) for title in titles)),
        )
        return _latex(grid, [comparison.experiment.name, *notes])
    # Pipe tables have one line of headings.
    columns = [f"{title}: {what}" for title in titles for what in ("estimate", "sigma %", "off")]
    grid = Grid(("parameter", "unit", "truth", *columns), body, align)
    return _pages(comparison.experiment.name, [_markdown(grid)], notes)


def _study(study: StudyResults, form: str) -> str:
    if form == "csv":
        columns = study.columns()
        values = zip(*columns.values(), strict=True)
        exact = [[_exact(cell) if isinstance(cell, float) else str(cell) for cell in row] for row in values]
        return _csv([tuple(columns), *exact])
    rows = [(item.scenario, *cells(item, study.head)) for item in study.figures]
    grid = Grid(("scenario", *study.head), rows, "ll" + "r" * (len(study.head) - 1), units=False)
    notes = [*NOTES, *([study.missing()] if study.missing() else [])]
    if form == "latex":
        return _latex(grid, [study.name, *notes])
    return _pages(study.name, [_markdown(grid)], notes)


def _pages(title: str, tables: Sequence[str], notes: Iterable[str]) -> str:
    """Return tables of Markdown between a title and notes."""
    return "\n\n".join([_escaped(title), *tables, *map(_escaped, notes)])


def _percent(percent: float) -> str:
    if not math.isfinite(percent):
        return "-"
    return f">{LARGEST_PERCENT}" if percent > LARGEST_PERCENT else f"{percent:.3g}"


def _exact(value: float | None) -> str:
    """Return the shortest text that reads back as the same number; empty for a missing one."""
    return repr(float(value)) if value is not None and math.isfinite(value) else ""


def _csv(rows: Sequence[Sequence[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().removesuffix("\n")


def _escaped(text: str) -> str:
    """Return a text escaped for Markdown."""
    return re.sub(r"([\\`*_|])", r"\\\1", text).replace("<", "&lt;").replace(">", "&gt;")


def _markdown(grid: Grid) -> str:
    rule = "|".join({"l": "---", "r": "---:"}[letter] for letter in grid.align)
    lines = [grid.head, *grid.rows]
    cells = ["| " + " | ".join(map(_escaped, line)) + " |" for line in lines]
    return "\n".join([cells[0], f"|{rule}|", *cells[1:]])


LATEX_CHARACTERS = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
}
NUMBER = re.compile(r"[<>]?-?\d+(\.\d+)?(e[+-]?\d+)?")


def latex_text(text: str) -> str:
    r"""Return a text for LaTeX: special characters escaped, and ``m^2`` as a power."""
    pieces = re.split(r"\^(\d+)", text)
    shown = ["".join(LATEX_CHARACTERS.get(character, character) for character in part) for part in pieces]
    return "".join(f"$^{{{part}}}$" if k % 2 else part for k, part in enumerate(shown))


def _latex_number(cell: str) -> str:
    """Return a number in math mode, for a proper minus sign; other cells are text."""
    if not NUMBER.fullmatch(cell):
        return "--" if cell == "-" else latex_text(cell)
    digits, _, power = cell.partition("e")
    return f"${digits}\\cdot10^{{{int(power)}}}$" if power else f"${digits}$"


def _latex_heading(text: str) -> str:
    return (
        r"$\sigma$" + latex_text(text.removeprefix("sigma")) if text.startswith("sigma") else latex_text(text)
    )


def _latex(grid: Grid, comments: Sequence[str] = ()) -> str:
    lines = [f"% {' '.join(text.split())}" for text in (*comments, r"needs \usepackage{booktabs}")]
    lines += [rf"\begin{{tabular}}{{{grid.align}}}", r"\toprule"]
    if grid.groups:
        first, rules, cells = 1, [], []
        for title, width in grid.groups:
            cells.append(rf"\multicolumn{{{width}}}{{c}}{{{latex_text(title)}}}")
            if title:
                rules.append(rf"\cmidrule(lr){{{first}-{first + width - 1}}}")
            first += width
        lines += [" & ".join(cells) + r" \\", " ".join(rules)]
    lines += [" & ".join(map(_latex_heading, grid.head)) + r" \\", r"\midrule"]
    for row in grid.rows:
        name, unit, *others = row
        shown = [
            _latex_number(cell) if letter == "r" else latex_text(cell)
            for cell, letter in zip(others, grid.align[2:], strict=True)
        ]
        # Thin spaces in place of the points of a unit, as in ``kg.m^2``.
        second = r"\,".join(map(latex_text, unit.split("."))) if grid.units else latex_text(unit)
        lines.append(" & ".join([latex_text(name), second, *shown]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])
