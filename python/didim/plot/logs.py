"""Pictures of a log and its model: torques, residuals, and simulated runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from .._tools.arrays import Array, quotient
from ..errors import PlotError
from ..experiment.experiment import Experiment
from ..log.recording import Recording
from ..loop.simulation import Simulation
from ..result.identification import Identification
from ..studies.prediction import Prediction, autocorrelation, predict, relative_errors
from .style import (
    FAINT,
    MEASURED,
    MODEL,
    RESIDUAL,
    Figure,
    line,
    new_figure,
    panel_pairs,
    per_row,
    percent,
    styled,
    units,
)

Pieces = list[tuple[Array, Array, Array]]
"""Instants (n,), measured and modelled values (n, n_dof) of each window."""

PANELS_PER_ROW = 2
"""Number of panels side by side."""
SMALLEST_CORRELATION_AXIS = 0.3
"""Smallest extent of an autocorrelation's axis to either side: white noise of a few hundred rows fills a third of it."""
MOST_BAND_POINTS = 300
"""Largest number of points of a prediction band: it varies slowly."""
SMALL_PANELS_PER_ROW = 3
"""Number of small panels side by side."""
MOST_LAGS = 40
"""Largest lag of an autocorrelation (rows)."""
CONFIDENCE = 1.96
"""Half width of a normal distribution's 95 % interval, in standard deviations."""


@styled
def torques(
    fit: Identification, experiment: Experiment, *, predictions: Sequence[Prediction] | None = None
) -> Figure:
    """Draw measured and predicted torques, and their difference, joint by joint.

    Parameters
    ----------
    fit : Identification
        Any result.
    experiment : Experiment
        The log.
    predictions : sequence of Prediction, optional
        From `didim.studies.prediction.predict`; by default those of the recordings of the fit, on the rows of the fit.

    Returns
    -------
    Figure
        A panel per joint with its relative error; recordings follow each other in time. The band around the difference is the
        95 % prediction interval, if the result has standard deviations.

    Raises
    ------
    DidimError
        As for `didim.studies.prediction.predict`; a `PlotError` without matplotlib.
    """
    windows = list(predict(fit, experiment) if predictions is None else predictions)
    kinds = experiment.robot.joint_kinds
    words = {"measured": "predicted", "simulated": "simulated"}[windows[0].motion]
    # Windows follow each other in time, recording by recording, from 0.
    starts = {window.name: start_of(window) for window in experiment.recordings}
    pieces: Pieces = []
    offset, last, name = -starts.get(windows[0].recording, 0.0), 0.0, ""
    for window in windows:
        if name and window.recording != name:
            offset = last - float(window.t[0])
        name = window.recording
        t = window.t + offset
        last = float(t[-1])
        pieces.append((t, window.measured, window.predicted))
    bands = [
        (t, 0.5 * (high - low))
        for (t, _, _), window in zip(pieces, windows, strict=True)
        if window.std is not None
        for low, high in [window.interval()]
    ]
    return _compared(
        pieces,
        labels=("measured", words),
        names=["force" if kind == "prismatic" else "torque" for kind in kinds],
        units=[units(kind)[1] for kind in kinds],
        notes=[percent(error) for error in relative_errors(windows)],
        several=len({window.recording for window in windows}) > 1,
        bands=bands,
    )


@styled
def overlay(
    simulation: Simulation,
    recording: Recording,
    *,
    experiment: Experiment,
    quantity: Literal["q", "tau"] = "q",
    start: int = 0,
) -> Figure:
    """Draw a simulated run over the log, and the difference, joint by joint.

    Parameters
    ----------
    simulation : Simulation
        One candidate, at the rate of the recording.
    recording : Recording
        The log.
    experiment : Experiment
        Experiment with the kinds of the joints.
    quantity : {"q", "tau"}
        Positions or torques, raw.
    start : int
        Sample of the recording at which the simulation begins.

    Returns
    -------
    Figure
        A panel per joint with its relative error (norm of the difference over norm of the measurement).

    Raises
    ------
    PlotError
        For several candidates, a recording that is too short or has no torques, or without matplotlib.
    """
    model = np.asarray(getattr(simulation, quantity))
    whole = getattr(recording, quantity)
    if model.ndim != 2:
        raise PlotError("overlay draws a simulation of one candidate")
    if whole is None:
        raise PlotError(f"recording '{recording.name}' has no torques to draw")
    measured = whole[start : start + len(model)]
    if measured.shape != model.shape:
        raise PlotError(
            f"recording '{recording.name}' has {len(measured)} samples from sample {start} on and "
            f"{measured.shape[1]} joints, and the simulation {len(model)} and {model.shape[1]}"
        )
    kinds = experiment.robot.joint_kinds
    column = 0 if quantity == "q" else 1
    size = np.linalg.norm(measured, axis=0)
    error = np.linalg.norm(measured - model, axis=0)
    shares = quotient(error, size, np.nan)
    return _compared(
        [(recording.t[start : start + len(model)] - recording.t[start], measured, model)],
        labels=("measured", "simulated"),
        names=["position" if column == 0 else "force" if kind == "prismatic" else "torque" for kind in kinds],
        units=[units(kind)[column] for kind in kinds],
        notes=[percent(share) for share in shares],
        several=False,
    )


def start_of(recording: Recording) -> float:
    """Return the time stamp of the first used sample, the origin of time in pictures."""
    return float(recording.t[recording.windows[0][0]])


def _compared(
    pieces: Pieces,
    *,
    labels: tuple[str, str],
    names: Sequence[str],
    units: Sequence[str],
    notes: Sequence[str],
    several: bool,
    bands: Sequence[tuple[Array, Array]] = (),
) -> Figure:
    """Draw two lines per joint, and below them the difference on its own axis, with a band around it."""
    n = len(names)
    rows, _ = per_row(n, PANELS_PER_ROW)
    figure = new_figure(0.4 + (3.6 if n == 1 else 2.8) * rows, gap_in=0.09)
    for joint, upper, lower in panel_pairs(figure, n, PANELS_PER_ROW, (2.4, 1.0)):
        columns = [(t, measured[:, joint], model[:, joint]) for t, measured, model in pieces]
        line(
            upper,
            [(t, measured) for t, measured, _ in columns],
            color=MEASURED,
            # Wide enough to show on both sides of the model's line where the two agree.
            linewidth=4.0,
            label=labels[0],
            solid_joinstyle="round",
        )
        line(upper, [(t, model) for t, _, model in columns], color=MODEL, linewidth=0.9, label=labels[1])
        difference = [(t, measured - model) for t, measured, model in columns]
        line(lower, difference, color=RESIDUAL, linewidth=0.8, label="difference")
        lower.axhline(0.0, color="#5b6470", linewidth=0.6, zorder=0.5)
        for t, half in bands:
            thinned = slice(None, None, max(1, len(t) // MOST_BAND_POINTS))
            edge = half[thinned, joint]
            lower.fill_between(t[thinned], -edge, edge, color=FAINT, linewidth=0.0, zorder=0.4)
        upper.set_title(f"difference {notes[joint]}", loc="right", color=RESIDUAL, fontweight="normal")
        upper.set_ylabel(f"{names[joint]} ({units[joint]})")
        lower.set_ylabel(f"diff. ({units[joint]})")
        lower.locator_params(axis="y", nbins=3)
    if several:
        for axes in figure.axes:
            if axes.get_xlabel():
                axes.set_xlabel("time (s), one recording after the other")
    handles = [*upper.get_lines()[:2], lower.get_lines()[0]]
    figure.legend(handles=handles, loc="outside upper right", ncols=3)
    return figure


@styled
def residuals(
    fit: Identification, experiment: Experiment, *, predictions: Sequence[Prediction] | None = None
) -> Figure:
    """Draw autocorrelation and distribution of the residual torques, joint by joint.

    Parameters
    ----------
    fit, experiment, predictions
        As for `torques`.

    Returns
    -------
    Figure
        Per joint the autocorrelation with the 95 % band of white noise and, if decimation has correlated the rows, the
        autocorrelation of decimated white noise; and the histogram with the normal curve of the same mean and size.

    Raises
    ------
    DidimError
        As for `torques`.
    """
    windows = list(predict(fit, experiment) if predictions is None else predictions)
    kinds = experiment.robot.joint_kinds
    n = len(kinds)
    rows, columns = per_row(n, SMALL_PANELS_PER_ROW)
    n_rows = sum(len(window.t) for window in windows)
    n_lags = min(MOST_LAGS, min(len(window.t) for window in windows) - 1)
    figure = new_figure(0.4 + (3.0 if n == 1 else 4.2 * rows), gap_in=0.07)
    outer = figure.add_gridspec(rows, columns)
    band = CONFIDENCE / np.sqrt(n_rows)
    handles: list[Any] = []
    for joint in range(n):
        # A single joint has room for both side by side.
        shape = (1, 2) if n == 1 else (2, 1)
        inner = outer[divmod(joint, columns)].subgridspec(*shape)
        upper, lower = figure.add_subplot(inner[0]), figure.add_subplot(inner[1])
        parts = [window.residual[:, joint] for window in windows]
        correlation = autocorrelation(parts, n_lags)
        lags = np.arange(1, n_lags + 1)
        upper.axhspan(-band, band, color=FAINT, linewidth=0.0, label="95 % of white noise", zorder=0.5)
        upper.vlines(lags, 0.0, correlation[1:], color=MODEL, linewidth=1.6, label="autocorrelation")
        expected = windows[0].noise_correlation
        if expected is not None:
            upper.plot(
                lags,
                np.pad(expected, (0, n_lags + 1))[1 : n_lags + 1],
                color=RESIDUAL,
                linewidth=0.9,
                label="white noise, decimated",
            )
        upper.axhline(0.0, color="#5b6470", linewidth=0.6)
        # The scale adapts to the bars: those of a good fit are 0.1 high and would be invisible on an axis up to 1.
        low, high = (
            float(np.nanmin(correlation[1:], initial=0.0)),
            float(np.nanmax(correlation[1:], initial=0.0)),
        )
        upper.set(
            ylim=(min(1.2 * low, -SMALLEST_CORRELATION_AXIS), max(1.2 * high, SMALLEST_CORRELATION_AXIS))
        )
        upper.set(xlabel="lag (rows)", ylabel="autocorrelation")
        upper.set_title(f"joint {joint + 1}")
        unit = units(kinds[joint])[1]
        values = np.concatenate(parts)
        # The square root of the number of values, within visible bounds.
        bins = int(np.clip(np.sqrt(values.size), 10, 60))
        lower.hist(values, bins=bins, density=True, color=MEASURED, label="distribution")
        sigma = float(values.std())
        if sigma > 0.0:
            x = np.linspace(values.min(), values.max(), 200)
            curve = np.exp(-0.5 * ((x - values.mean()) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
            lower.plot(x, curve, color=RESIDUAL, linewidth=1.2, label="normal curve")
        lower.set_xlabel(f"residual ({unit}), std. deviation {sigma:.3g}")
        lower.set_yticks([])
        lower.grid(visible=False)
        handles = [*upper.get_legend_handles_labels()[0], *lower.get_legend_handles_labels()[0][::-1]]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles))
    return figure
