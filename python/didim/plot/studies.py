"""Pictures of a study: error over noise, calibration, accuracy over time. Tested in ``tests/test_study_figures.py``."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .._tools.arrays import Array
from ..errors import PlotError
from ..monte_carlo.figures import Estimate, Figures
from ..monte_carlo.results import StudyResults
from .style import CYCLE, FAINT, MARKERS, Axes, Figure, new_figure, per_row, plain_ticks, styled

MOST_TEXT = 70
"""Largest number of characters of a name in a picture."""
MOST_PANELS = 12
"""Largest number of panels of a figure."""
MOST_IN_ROW = 3
"""Largest number of panels side by side."""
LINE_CHARACTERS = 38
"""Largest number of characters of a line of a name beside a panel: it leaves half of a phone to the panel."""


def _styles(study: StudyResults) -> dict[str, tuple[str, str]]:
    """Colour and marker of each method: more methods than colours take other markers with them."""
    return {
        name: (CYCLE[k % len(CYCLE)], MARKERS[(k + k // len(CYCLE)) % len(MARKERS)])
        for k, name in enumerate(study.methods)
    }


def _require(study: StudyResults) -> None:
    if not study.figures:
        raise PlotError("the study has no rows to draw")


def _size(value: object) -> float | None:
    """Return a key's value as a number: the mean of a list."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return float(value)
    if (
        isinstance(value, list)
        and value
        and all(isinstance(v, int | float) and not isinstance(v, bool) for v in value)
    ):
        return float(np.mean(value))
    return None


def varied_key(study: StudyResults) -> str | None:
    """Return the key with the most numeric values over the scenarios, a noise first; None where nothing varies."""
    values: dict[str, set[float]] = {}
    for row in study.rows.truths.values():
        for key, value in row["keys"].items():
            size = _size(value)
            if size is not None:
                values.setdefault(key, set()).add(size)
    varied = [key for key, sizes in values.items() if len(sizes) > 1]
    return max(varied, key=lambda key: ("noise" in key, len(values[key]), key), default=None)


@styled
def errors(study: StudyResults, key: str | None = None) -> Figure:
    """Draw the torque error on the other motion over a key of the scenarios, such as a noise.

    Parameters
    ----------
    study : StudyResults
        From `didim.study`.
    key : str, optional
        Such as "measurement.position_noise_rad"; by default that with the most values.

    Returns
    -------
    Figure
        Medians over the runs with their 95 % intervals, one panel for each setting of the other keys.

    Raises
    ------
    PlotError
        Without rows, or when the key has one value only.
    """
    _require(study)
    key = key or varied_key(study)
    truths = study.rows.truths
    if key is None or len({_size(row["keys"].get(key)) for row in truths.values()} - {None}) < 2:
        raise PlotError(
            f"{key or 'no key'} has several values in the scenarios: there is nothing to draw over"
        )
    panels: dict[str, list[str]] = {}
    for name in study.scenarios:
        keys = dict(truths[name]["keys"]) if name in truths else {}
        if _size(keys.pop(key, None)) is not None:
            panels.setdefault(json.dumps(keys, sort_keys=True), []).append(name)
    groups = [names for names in panels.values() if len(names) > 1][:MOST_PANELS]
    return _panels(
        study,
        [(_common(names), names) for names in groups],
        lambda figures: float(_size(truths[figures.scenario]["keys"][key]) or 0.0),
        key,
    )


def _common(names: Sequence[str]) -> str:
    """Return the common parts of the names of scenarios, which are separated by commas."""
    parts = [name.split(", ") for name in names]
    return _short(", ".join(part for part in parts[0] if all(part in other for other in parts)))


def _panels(
    study: StudyResults,
    groups: Sequence[tuple[str, Sequence[str]]],
    abscissa: Callable[[Figures], float],
    label: str,
) -> Figure:
    rows, columns = per_row(len(groups), MOST_IN_ROW)
    figure = new_figure(0.7 + 2.7 * rows)
    axes = np.atleast_1d(figure.subplots(rows, columns, sharey=True, squeeze=False)).ravel()
    styles = _styles(study)
    for ax, (title, names) in zip(axes, groups, strict=False):
        for method, (color, marker) in styles.items():
            shown = sorted(
                (f for f in study.figures if f.method == method and f.scenario in names), key=abscissa
            )
            shown = [row for row in shown if np.isfinite(row.torque_error.value)]
            y, bars = _with_bars([row.torque_error for row in shown])
            style: dict[str, Any] = {"color": color, "marker": marker, "markersize": 4.5, "elinewidth": 0.8}
            ax.errorbar([abscissa(row) for row in shown], y, yerr=bars, capsize=2.0, label=method, **style)
        positive = all(abscissa(f) > 0.0 for f in study.figures if f.scenario in names)
        ax.set_xscale("log" if positive else "linear")
        ax.set_yscale("log")
        ax.set_title(title)
        ax.set_xlabel(label)
    for ax in axes[: len(groups)]:
        for axis in (ax.xaxis, ax.yaxis):
            if axis.get_scale() == "log":
                plain_ticks(axis)
    for ax in axes[len(groups) :]:
        ax.set_visible(False)
    for ax in axes[::columns]:
        ax.set_ylabel("torque error (%)")
    _legend(figure, axes[0], styles)
    return figure


def _with_bars(estimates: Sequence[Estimate]) -> tuple[Array, Array | None]:
    """Return estimates in %, (n,), and the lengths of their bars to both sides, (2, n)."""
    ends = ((estimate.value, estimate.low, estimate.high) for estimate in estimates)
    value, low, high = 100.0 * np.array([*ends]).reshape(-1, 3).T
    return value, np.nan_to_num([value - low, high - value]) if len(value) else None


def _legend(figure: Figure, ax: Axes, styles: Mapping[str, tuple[str, str]]) -> None:
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(5, len(styles)))


@styled
def coverage(study: StudyResults) -> Figure:
    """Draw the coverage of each method's 95 % intervals, scenario by scenario.

    Parameters
    ----------
    study : StudyResults
        From `didim.study`.

    Returns
    -------
    Figure
        Shares with their 95 % intervals over the runs; calibrated methods are on the line.

    Raises
    ------
    PlotError
        Without rows.
    """
    _require(study)
    styles = _styles(study)
    names = [name for name in study.scenarios if any(f.scenario == name for f in study.figures)]
    labels = [textwrap.fill(_short(name), LINE_CHARACTERS) for name in names]
    figure = new_figure(0.9 + sum(max(0.34, 0.06 + 0.15 * (text.count("\n") + 1)) for text in labels))
    ax = figure.subplots()
    step = 0.7 / max(1, len(styles))
    for k, (method, (color, marker)) in enumerate(styles.items()):
        rows = [f for f in study.figures if f.method == method and np.isfinite(f.coverage.value)]
        y = np.array([names.index(row.scenario) - 0.35 + step * (k + 0.5) for row in rows])
        x, bars = _with_bars([row.coverage for row in rows])
        style: dict[str, Any] = {"color": color, "marker": marker, "markersize": 4.0, "elinewidth": 0.8}
        ax.errorbar(x, y, xerr=bars, linestyle="none", label=method, **style)
    ax.axvline(95.0, color="#3a424d", linewidth=0.9, linestyle="--")
    for k in range(1, len(names), 2):
        ax.axhspan(k - 0.5, k + 0.5, color=FAINT, alpha=0.45, linewidth=0.0, zorder=0.5)
    ax.set_yticks(range(len(names)), labels)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("parameters within\ntheir 95 % intervals (%)")
    _legend(figure, ax, styles)
    return figure


@styled
def cost(study: StudyResults) -> Figure:
    """Draw the torque error on the other motion over the time of a run, one point per scenario.

    Parameters
    ----------
    study : StudyResults
        From `didim.study`.

    Returns
    -------
    Figure
        Medians over the runs.

    Raises
    ------
    PlotError
        Without rows, or when no row has a time.
    """
    _require(study)
    rows = [f for f in study.figures if np.isfinite(f.seconds) and np.isfinite(f.torque_error.value)]
    if not rows:
        raise PlotError("no row of the study has a time")
    figure = new_figure(3.8)
    ax = figure.subplots()
    styles = _styles(study)
    for method, (color, marker) in styles.items():
        of_method = [row for row in rows if row.method == method]
        x, y = [row.seconds for row in of_method], [100.0 * row.torque_error.value for row in of_method]
        ax.loglog(x, y, linestyle="none", color=color, marker=marker, markersize=5.0, label=method)
    plain_ticks(ax.xaxis)
    plain_ticks(ax.yaxis)
    ax.set_xlabel("seconds of a run, median")
    ax.set_ylabel("torque error (%), median")
    _legend(figure, ax, styles)
    return figure


def _short(name: str) -> str:
    return name if len(name) <= MOST_TEXT else f"{name[: MOST_TEXT - 3]}..."
