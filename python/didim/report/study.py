"""The report of a study: figures of merit for each scenario and method, and pictures of them."""

from __future__ import annotations

from collections import Counter

from .._tools.words import counted, series
from ..errors import PlotError
from ..monte_carlo.results import StudyResults
from ..monte_carlo.text import NOTES, cells
from ..plot.studies import cost, coverage, errors
from .page import Html, Level, page, paragraph, picture, section, table, verdict

MOST_SENTENCES = 12
"""Largest number of failure messages in a report."""


def study_page(study: StudyResults) -> str:
    """Return the report of a study as HTML."""
    figures = study.figures
    runs, failed, still = (
        sum(getattr(row, key) for row in figures) for key in ("runs", "failed", "not_converged")
    )
    level: Level = "caution" if failed or study.missing() else "good"
    tiles = [
        (str(runs), "runs"),
        (str(len(study.scenarios)), "scenarios"),
        (str(len(study.methods)), "methods"),
        (str(failed), "failed"),
        (str(still), "not converged"),
    ]
    sentence = (
        f"{counted(runs, 'run')} on simulated logs whose parameters are known; {failed} of them failed."
    )
    notes = [*study.rows.remarks, *([study.missing()] if study.missing() else [])]
    pictures = []
    for title, draw, text in (
        ("Error over the scenarios", errors, "Median torque error on another motion, with 95 % intervals"),
        ("Calibration", coverage, "Share of the parameters within their 95 % intervals"),
        ("Accuracy over time", cost, "Median torque error on another motion over the time of a run"),
    ):
        try:
            pictures.append(section(title, picture(draw(study), text)))
        except PlotError as reason:  # nothing varies, or no times
            pictures.append(section(title, paragraph(f"Not drawn: {reason}.")))
    sections = [verdict(level, "Study", sentence, tiles, notes), *pictures, _tables(study)]
    if failed:
        # Sentences of failed runs, the commonest first.
        count = Counter(
            (row["method"], row["sentence"]) for row in study.rows.fits.values() if "beta" not in row
        )
        rows = [
            [method, str(number), sentence]
            for (method, sentence), number in count.most_common(MOST_SENTENCES)
        ]
        classes = {(k, 2): "wide" for k in range(len(rows))}
        sections.append(
            section(
                "Failed runs", table(["method", "runs", "what happened"], rows, numbers=[1], classes=classes)
            )
        )
    methods = series(study.methods, 80)
    return page(
        f"Monte Carlo study: {study.name}",
        f"{methods} on {counted(len(study.scenarios), 'scenario')}",
        sections,
    )


def _tables(study: StudyResults) -> Html:
    content = []
    for scenario in dict.fromkeys(figures.scenario for figures in study.figures):
        # A line of a cell may end before an interval, not within it.
        rows = [
            [name, *(cell.replace(", ", ",\N{NO-BREAK SPACE}") for cell in numbers)]
            for name, *numbers in (
                cells(figures, study.head) for figures in study.figures if figures.scenario == scenario
            )
        ]
        right = range(1, len(study.head))
        content += [paragraph(scenario), table(study.head, rows, numbers=right, cards=True)]
    return section("Figures of merit", *content, *(paragraph(text) for text in NOTES))
