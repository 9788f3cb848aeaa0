"""Picture of commanded, measured and simulated positions for an estimate of CLOE with known links."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._tools.arrays import Array
from ..experiment.experiment import Experiment
from ..methods.positions.replay import Replay, replayed, rms_error
from ..result.identification import Identification
from .style import (
    FAINT,
    MEASURED,
    MODEL,
    RESIDUAL,
    Figure,
    legend_above,
    line,
    new_figure,
    panel_pairs,
    per_row,
    styled,
    units,
)

PANEL_IN = 2.6
"""Height of the panels of a joint (inches)."""
SHARES = (2.0, 1.0)
"""Heights of positions and their errors."""
MOST_PANELS_PER_ROW = 3
"""Largest number of panels side by side."""


@styled
def positions(fit: Identification, experiment: Experiment, replays: Sequence[Replay] | None = None) -> Figure:
    """Draw commanded, measured and simulated positions of each joint.

    Parameters
    ----------
    fit : Identification
        Result of CLOE with known links.
    experiment : Experiment
        Its log, or another one with the same unknowns.
    replays : sequence of Replay, optional
        Rollouts, if already simulated.

    Returns
    -------
    Figure
        Positions of each joint with their errors below, rollouts one after the other; the title has the rms error (mrad or mm).

    Raises
    ------
    PlotError
        Without matplotlib.
    """
    replays_drawn = replayed(fit, experiment) if replays is None else replays
    n = experiment.robot.n_dof
    rows, _ = per_row(n, MOST_PANELS_PER_ROW)
    figure = new_figure(PANEL_IN * rows + 0.5, gap_in=0.05)
    starts = np.cumsum([0.0, *(replay.t[-1] for replay in replays_drawn)])

    def pieces(joint: int, values: str) -> list[tuple[Array, Array]]:
        return [
            (replay.t + start, getattr(replay, values)[:, joint])
            for replay, start in zip(replays_drawn, starts[:-1], strict=True)
        ]

    for joint, upper, lower in panel_pairs(figure, n, MOST_PANELS_PER_ROW, SHARES):
        for values, color in (("commanded", FAINT), ("measured", MEASURED), ("simulated", MODEL)):
            line(upper, pieces(joint, values), color=color, label=values, linewidth=0.9)
        errors = [
            (t, 1e3 * (simulated - measured))
            for (t, simulated), (_, measured) in zip(
                pieces(joint, "simulated"), pieces(joint, "measured"), strict=True
            )
        ]
        line(lower, errors, color=RESIDUAL, label="error", linewidth=0.8)
        unit = units(experiment.robot.joint_kinds[joint])[0]
        upper.set_title(
            f"{experiment.robot.joint_label(joint)}: {1e3 * rms_error(replays_drawn, joint):.2f} m{unit}"
        )
        upper.set_ylabel(unit)
        lower.set_ylabel(f"error (m{unit})")
        if joint == 0:
            legend_above(figure, upper)
    return figure
