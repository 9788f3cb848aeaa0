"""Pictures of a log's motion against the robot's limits, and of the spectra of the residual torques."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._tools.arrays import Array
from ..errors import PlotError
from ..experiment.experiment import Experiment
from ..result.identification import Identification
from ..signal.spectrum import welch
from ..signal.window import motion_of
from ..studies.prediction import Prediction, predict
from .logs import start_of
from .style import (
    FAINT,
    MEASURED,
    MODEL,
    RESIDUAL,
    Axes,
    Figure,
    legend_above,
    line,
    new_figure,
    panel_pairs,
    per_row,
    plain_numbers,
    styled,
    units,
)

PANELS_PER_ROW = 3
"""Number of panels side by side."""
FEWEST_SPECTRUM_ROWS = 32
"""Smallest number of rows of a window whose spectrum is drawn."""
LOWEST_SHARE = 1e-4
"""Lower end of the axis, as a share of the largest amplitude: below it lie the stop bands of the decimation."""


@styled
def motion(experiment: Experiment) -> Figure:
    """Draw position and speed of each joint against its limits.

    Parameters
    ----------
    experiment : Experiment
        The log; its filters differentiate the positions.

    Returns
    -------
    Figure
        Per joint the position above and the speed below, over time from the first used sample, recordings one after the other.
        Dotted lines are the limits of the robot file, if any; the title gives the shares of the limits that the motion uses.

    Raises
    ------
    PlotError
        For an experiment without positions, or without matplotlib.
    """
    recordings = [recording for recording in experiment.recordings if recording.has_positions]
    if not recordings:
        raise PlotError(f"experiment '{experiment.name}' has no positions to draw")
    pieces: list[tuple[Array, Array, Array]] = []
    last = 0.0
    for recording in recordings:
        offset = last - start_of(recording)
        for start, stop in recording.windows:
            q, dq, _ = motion_of(recording, (start, stop), experiment.signal)
            t = recording.t[start:stop] + offset
            used = slice(experiment.signal.trim_start, len(t) - experiment.signal.trim_end)
            pieces.append((t[used], q[used], dq[used]))
            last = float(t[-1])
    robot = experiment.robot
    rows, _ = per_row(robot.n_dof, PANELS_PER_ROW)
    figure = new_figure(0.4 + 2.8 * rows, gap_in=0.05)
    for joint, upper, lower in panel_pairs(figure, robot.n_dof, PANELS_PER_ROW, (1.0, 1.0)):
        limits = robot.limits[joint]
        unit = units(robot.joint_kinds[joint])[0]
        line(upper, [(t, q[:, joint]) for t, q, _ in pieces], color=MODEL)
        line(lower, [(t, dq[:, joint]) for t, _, dq in pieces], color=MODEL, linewidth=0.8)
        speed = max(float(np.abs(dq[:, joint]).max()) for _, _, dq in pieces)
        low = min(float(q[:, joint].min()) for _, q, _ in pieces)
        high = max(float(q[:, joint].max()) for _, q, _ in pieces)
        shares = []
        if limits.position is not None:
            _limits(upper, limits.position)
            shares.append(_share("range", high - low, limits.position[1] - limits.position[0]))
        if limits.velocity is not None:
            _limits(lower, (-limits.velocity, limits.velocity))
            shares.append(_share("speed", speed, limits.velocity))
        upper.set_title(
            ", ".join(shares) or "no limits known", loc="right", fontweight="normal", fontsize=8.0
        )
        upper.set_ylabel(unit)
        lower.set_ylabel(f"{unit}/s")
        for axes in (upper, lower):
            axes.locator_params(axis="y", nbins=4)
    return figure


def _limits(axes: Axes, bounds: tuple[float, float]) -> None:
    for bound in bounds:
        axes.axhline(bound, color=RESIDUAL, linewidth=0.9, linestyle=":")


def _share(what: str, used: float, most: float) -> str:
    return f"{what} {100.0 * used / most:.0f} %"


@styled
def spectra(
    fit: Identification, experiment: Experiment, *, predictions: Sequence[Prediction] | None = None
) -> Figure:
    """Draw the spectra of the measured torque and of the residual, joint by joint.

    Parameters
    ----------
    fit, experiment, predictions
        As for `torques`.

    Returns
    -------
    Figure
        Amplitude spectral densities over frequency, both logarithmic, on the rows of the fit. The thin line is the level of
        white noise with the size of the residual: peaks above it indicate missing terms of the model.

    Raises
    ------
    PlotError
        For windows of fewer than 32 rows, or without matplotlib.
    DidimError
        As for `torques`.
    """
    from matplotlib.ticker import LogLocator

    predicted = list(predict(fit, experiment) if predictions is None else predictions)
    kinds = experiment.robot.joint_kinds
    windows = [window for window in predicted if len(window.t) >= FEWEST_SPECTRUM_ROWS]
    if not windows:
        raise PlotError(f"the windows of '{experiment.name}' are too short for spectra")
    f, measured = spectrum(windows, "measured")
    _, residual = spectrum(windows, "residual")
    rows, columns = per_row(len(kinds), PANELS_PER_ROW)
    figure = new_figure(0.4 + 2.2 * rows, gap_in=0.05)
    for joint, kind in enumerate(kinds):
        axes = figure.add_subplot(rows, columns, joint + 1)
        unit = units(kind)[1]
        axes.loglog(f, measured[:, joint], color=MEASURED, linewidth=1.8, label="measured torque")
        axes.loglog(f, residual[:, joint], color=RESIDUAL, linewidth=1.0, label="residual")
        # White noise of the same power over the same band.
        level = float(np.sqrt(np.mean(residual[:, joint] ** 2)))
        axes.axhline(level, color=FAINT, linewidth=1.2, label="white noise of its size", zorder=0.5)
        axes.set_title(f"joint {joint + 1}")
        axes.set_ylabel(f"{unit}/√Hz")
        top = float(measured[1:, joint].max())
        axes.set_ylim(top * LOWEST_SHARE, top * 2.0)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(numticks=6))
            plain_numbers(axis)
        axes.margins(x=0.01)
        if joint >= len(kinds) - columns:
            axes.set_xlabel("frequency (Hz)")
    legend_above(figure, axes)
    return figure


def spectrum(predictions: Sequence[Prediction], key: str) -> tuple[Array, Array]:
    """Return frequencies (Hz) and amplitude spectral densities (unit of torque / sqrt(Hz)) of a signal of predictions.

    Parameters
    ----------
    predictions : sequence of Prediction
        Windows of one rate with at least `FEWEST_SPECTRUM_ROWS` rows.
    key : str
        "measured", "predicted" or "residual".

    Returns
    -------
    f : (n_frequencies,) array
        Frequencies, without zero.
    density : (n_frequencies, n_dof) array
        Root of the mean power of all windows, weighted by their rows.
    """
    shortest = min(len(window.t) for window in predictions)
    # Largest number of rows of a piece: the drawn spectrum is the mean over such pieces.
    # Smallest number of pieces of the shortest window: the spectrum of a single piece is full of spikes.
    size = min(512, max(FEWEST_SPECTRUM_ROWS, shortest // 4))
    total, weight = np.zeros(()), 0
    for window in predictions:
        rate = 1.0 / float(np.median(np.diff(window.t)))
        f, power = welch(getattr(window, key), rate, size, trend=0)
        total = total + len(window.t) * power
        weight += len(window.t)
    return f[1:], np.sqrt(np.asarray(total) / weight)[1:]
