"""Pictures of estimates: their uncertainty, their correlation, and the convergence of a method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array
from ..errors import PlotError
from ..experiment.experiment import Experiment
from ..result.identification import Identification
from ..result.table import WELL_IDENTIFIED_PERCENT
from ..studies.prediction import Prediction, explained, predict
from .style import (
    CYCLE,
    FAINT,
    GOOD,
    MARKERS,
    RESIDUAL,
    WIDTH_IN,
    Axes,
    Figure,
    legend_above,
    new_figure,
    plain_numbers,
    plain_ticks,
    shade_rows,
    styled,
)

LOWEST_PERCENT, HIGHEST_PERCENT = 0.01, 1000.0
POINT_SPREAD = 0.5
"""Share of a row over which the points of several methods are spread."""
MOST_SIGMAS = 8.0
"""Largest deviation (sigma) on the axis; larger ones are drawn at its edge."""
ROWS_PER_COLUMN = 20
"""Largest number of parameters in one column of the figure."""
ROW_IN = 0.19
"""Height of a parameter's row (inches)."""
LINEAR_PERCENT = 1.0
"""Share of the torque (%) up to which the axis of standardised parameters is linear."""


def estimate_correlation(fit: Identification) -> tuple[tuple[str, ...], Array]:
    """Return the parameters that have a standard deviation, and the correlation matrix of their estimates."""
    known = np.flatnonzero(fit.std > 0.0)
    std = fit.std[known]
    matrix = fit.covariance[np.ix_(known, known)] / np.outer(std, std)
    return tuple(fit.names[index] for index in known), matrix


@styled
def correlation(fit: Identification) -> Figure:
    """Draw the correlation of the estimates, (10) scaled to ones on its diagonal.

    Parameters
    ----------
    fit : Identification
        Result with a covariance.

    Returns
    -------
    Figure
        A map with the names of the base parameters: a large correlation means that the log hardly separates two parameters.

    Raises
    ------
    PlotError
        For a result without covariance, or without matplotlib.
    """
    names, matrix = estimate_correlation(fit)
    if not names:
        raise PlotError(f"the result by {fit.method} has no covariance, and so no correlations")
    n = len(names)
    side = float(np.clip(1.6 + 0.145 * n, 3.4, WIDTH_IN - 1.0))
    figure = new_figure(side, side + 0.9)
    axes = figure.add_subplot()
    image = axes.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0, interpolation="nearest")
    size = float(np.clip(520.0 * (side - 1.2) / 9.0 / n, 5.0, 9.0))
    axes.set_xticks(np.arange(n), names, rotation=90, fontsize=size)
    axes.set_yticks(np.arange(n), names, fontsize=size)
    axes.tick_params(length=0)
    axes.grid(visible=False)
    bar = figure.colorbar(image, ax=axes, shrink=0.6, pad=0.02)
    bar.set_label("correlation of the estimates")
    if n <= 8:
        for row in range(n):
            for column in range(n):
                value = matrix[row, column]
                axes.text(
                    column,
                    row,
                    f"{round(value, 2) + 0.0:.2f}",
                    ha="center",
                    va="center",
                    color="white" if abs(value) > 0.6 else "black",
                )
    return figure


@styled
def convergence(fits: Identification | Mapping[str, Identification]) -> Figure:
    """Draw the history of a method, or of several, over its iterations.

    Parameters
    ----------
    fits : Identification, or mapping of str to Identification
        Results, by the names of the legend.

    Returns
    -------
    Figure
        Relative error (of the torques; for CLOE the ratio of its cost to that of its start), and the length of the step
        relative to the parameters, both in % and logarithmic.

    Raises
    ------
    PlotError
        When no result has a history, or without matplotlib.
    """
    several = fits if isinstance(fits, Mapping) else {fits.method: fits}
    if not any(fit.history for fit in several.values()):
        raise PlotError("there is no history to draw")
    figure = new_figure(3.1)
    axes = figure.subplots(1, 2)
    for (name, fit), color, marker in zip(several.items(), CYCLE, MARKERS, strict=False):
        number = [iteration.iteration for iteration in fit.history]
        for ax, key in zip(axes, ("relative_error", "step"), strict=True):
            values = np.array([100.0 * getattr(iteration, key) for iteration in fit.history])
            # A logarithmic axis has no zero.
            values[~(values > 0.0)] = np.nan
            many = len(number) > 30
            ax.semilogy(
                number, values, color=color, marker=None if many else marker, markersize=5.0, label=name
            )
    for ax, title in zip(axes, ("relative error (%)", "step (% of the parameters)"), strict=True):
        ax.set_title(title)
        ax.set_xlabel("iteration")
        ax.xaxis.get_major_locator().set_params(integer=True)
        ax.margins(x=0.08)
        plain_ticks(ax.yaxis)
    if len(several) > 1:
        axes[0].legend()
    return figure


@styled
def parameters(
    fits: Identification | Mapping[str, Identification],
    *,
    truth: ArrayLike | None = None,
    experiment: Experiment | None = None,
    predictions: Sequence[Prediction] | None = None,
) -> Figure:
    """Draw the base parameters with their 95 % intervals.

    Parameters
    ----------
    fits : Identification, or mapping of str to Identification
        Results of the same base parameters, by the names of the legend.
    truth : (b,) array, optional
        True base parameters.
    experiment : Experiment, optional
        The log of a single result, whose parameters are then standardised by the torque that they explain.
    predictions : sequence of Prediction, optional
        Predictions as for `torques`, if already computed.

    Returns
    -------
    Figure
        With a truth: the error of each estimate in its standard deviations, 95 % of which should be within the band. Several
        results without truth: differences from the first, in its standard deviations, with intervals. A single result with its
        log: each parameter with its 95 % interval, in % of the torque of the joint where it explains most (root mean squares,
        which put masses and friction on one axis). A single result without log: half the interval in % of the estimate.

    Raises
    ------
    PlotError
        For results of different parameters, a truth of another length, when no result has a covariance, or without
        matplotlib.
    """
    several = dict(fits) if isinstance(fits, Mapping) else {fits.method: fits}
    first = next(iter(several.values()))
    if any(fit.names != first.names for fit in several.values()):
        raise PlotError("results of different base parameters cannot stand in one picture")
    if truth is not None and np.shape(truth) != (len(first.names),):
        raise PlotError(f"truth must have shape ({len(first.names)},), got {np.shape(truth)}")
    certain = {name: fit for name, fit in several.items() if fit.std.any()}
    if not certain:
        raise PlotError("no result has a covariance, and so no intervals")
    if truth is None and len(several) == 1:
        if experiment is None:
            return _intervals(first)
        return _standardised(first, list(predict(first, experiment) if predictions is None else predictions))
    return _deviations(certain, None if truth is None else np.asarray(truth, dtype=np.float64))


def _columns(names: Sequence[str], extra_in: float) -> tuple[Figure, list[tuple[Axes, list[int]]]]:
    """Create axes side by side, each for some of the parameters, the first on top."""
    n = len(names)
    count = min(3, -(-n // ROWS_PER_COLUMN))
    length = -(-n // count)
    figure = new_figure(extra_in + ROW_IN * length)
    axes = np.atleast_1d(figure.subplots(1, count))
    columns = []
    for column, ax in enumerate(axes):
        rows = list(range(column * length, min(n, (column + 1) * length)))
        ax.set_yticks(np.arange(len(rows)), [names[index] for index in rows], fontsize=7.5)
        ax.set_ylim(length - 0.4, -0.6)
        ax.tick_params(axis="y", length=0)
        columns.append((ax, rows))
    return figure, columns


def _standardised(fit: Identification, predictions: Sequence[Prediction]) -> Figure:
    """Draw estimates and intervals in % of the torque that a parameter explains, beyond 1 % on a logarithmic scale."""
    scale = 100.0 * explained(predictions)
    value, half = fit.beta * scale, fit.interval_factor() * fit.std * scale
    figure, columns = _columns(fit.names, 1.0)
    reach = float(np.max(np.abs(value) + half, initial=1.0)) * 1.3
    well = (fit.std > 0.0) & (fit.relative_std_percent <= WELL_IDENTIFIED_PERCENT)
    labels = {
        True: f"well identified (sigma below {WELL_IDENTIFIED_PERCENT:.0f} %)",
        False: "not well identified",
    }
    for ax, rows in columns:
        ax.axvline(0.0, color="#3a424d", linewidth=0.8)
        shade_rows(ax, len(rows))
        for good, color, face in ((True, GOOD, GOOD), (False, RESIDUAL, "white")):
            places = [row for row, k in enumerate(rows) if bool(well[k]) is good]
            if not places:
                continue
            middle, reach_of = value[rows][places], half[rows][places]
            ax.hlines(places, middle - reach_of, middle + reach_of, color=color, linewidth=1.4)
            style: dict[str, Any] = {"markersize": 4.2, "color": color, "markerfacecolor": face}
            ax.plot(middle, places, "o", label=labels[good], **style)
        ax.set_xscale("symlog", linthresh=LINEAR_PERCENT, linscale=0.6)
        ax.set_xlim(-reach, reach)
        ticks = [tick for tick in (1.0, 10.0, 100.0, 1000.0) if tick < reach]
        ax.set_xticks([-tick for tick in reversed(ticks)] + [0.0, *ticks])
        plain_numbers(ax.xaxis)
        ax.set_xlabel("torque explained (%), 95 % interval")
        ax.grid(axis="y", visible=False)
    handles: dict[str, Any] = {}
    for ax, _ in columns:
        handles |= {str(handle.get_label()): handle for handle in ax.get_legend_handles_labels()[0]}
    figure.legend(handles=list(handles.values()), loc="outside upper right", ncols=2)
    return figure


def _intervals(fit: Identification) -> Figure:
    """Draw half intervals in % on a logarithmic axis, with colours for well identified parameters (as in the paper)."""
    from matplotlib.patches import Patch

    figure, columns = _columns(fit.names, 1.0)
    factor = fit.interval_factor()
    half = factor * fit.relative_std_percent
    shown = fit.std > 0.0
    # A wide interval ends at the edge; a parameter of zero has no relative interval.
    lengths = np.clip(np.where(np.isfinite(half), half, HIGHEST_PERCENT), LOWEST_PERCENT, HIGHEST_PERCENT)
    low = 10.0 ** np.floor(np.log10(lengths[shown].min()) - 0.1)
    for ax, rows in columns:
        for row, index in enumerate(rows):
            if not shown[index]:
                ax.text(low * 1.1, row, fit.roles[index], va="center", fontsize=7.0, color="#5b6470")
                continue
            well = fit.relative_std_percent[index] <= WELL_IDENTIFIED_PERCENT
            ax.barh(
                row,
                lengths[index] - low,
                left=low,
                height=0.68,
                color=GOOD if well else RESIDUAL,
                hatch=None if well else "////",
                edgecolor="white",
                linewidth=0.0,
            )
        ax.axvline(factor * WELL_IDENTIFIED_PERCENT, color="#3a424d", linewidth=0.9, linestyle="--")
        ax.set_xscale("log")
        ax.set_xlim(low, HIGHEST_PERCENT if lengths.max() > 200.0 else 200.0)
        ax.set_xlabel("estimate ± this (%), 95 % interval")
        plain_numbers(ax.xaxis)
        ax.grid(axis="y", visible=False)
    handles = [
        Patch(facecolor=GOOD, label=f"well identified (sigma below {WELL_IDENTIFIED_PERCENT:.0f} %)"),
        Patch(
            facecolor=RESIDUAL, hatch="////", edgecolor="white", linewidth=0.0, label="not well identified"
        ),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=2)
    return figure


def _deviations(several: Mapping[str, Identification], truth: Array | None) -> Figure:
    """Draw the distances from the truth or the first result, in standard deviations."""
    first = next(iter(several.values()))
    figure, columns = _columns(first.names, 1.2)
    step = POINT_SPREAD / max(1, len(several) - 1) if len(several) > 1 else 0.0
    largest = 3.0
    band = max(fit.interval_factor() for fit in several.values())
    for number, ((name, fit), color, marker) in enumerate(zip(several.items(), CYCLE, MARKERS, strict=False)):
        sigma = fit.std if truth is not None else first.std
        scale = np.where(sigma > 0.0, sigma, np.nan)
        off = (fit.beta - (first.beta if truth is None else truth)) / scale
        half = fit.interval_factor() * fit.std / scale
        largest = max(
            largest, float(np.nanmax(np.abs(off) + (0.0 if truth is not None else half), initial=0.0))
        )
        for ax, rows in columns:
            places = np.arange(len(rows)) + (step * number - POINT_SPREAD / 2.0 if step else 0.0)
            drawn = np.clip(off[rows], -MOST_SIGMAS, MOST_SIGMAS)
            if truth is None:
                ax.hlines(places, drawn - half[rows], drawn + half[rows], color=color, linewidth=1.0)
            ax.plot(drawn, places, linestyle="none", marker=marker, markersize=3.6, color=color, label=name)
    reach = min(MOST_SIGMAS, largest) * 1.08
    for ax, rows in columns:
        if truth is not None:
            ax.axvspan(-band, band, color=FAINT, linewidth=0.0, zorder=0.5)
        shade_rows(ax, len(rows))
        ax.axvline(0.0, color="#3a424d", linewidth=0.8)
        ax.set_xlim(-reach, reach)
        ax.grid(axis="y", visible=False)
        what = "the truth" if truth is not None else f"{next(iter(several))}"
        ax.set_xlabel(
            f"estimate less {what} (standard deviations)"
            + ("\nbeyond 8: on the edge" if largest > MOST_SIGMAS else "")
        )
    legend_above(figure, columns[0][0])
    return figure
