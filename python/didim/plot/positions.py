"""Picture of commanded, measured and simulated positions for an estimate of CLOE with known links."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..experiment.experiment import Experiment
from ..methods.positions.replay import Replay, replayed, rms_error
from ..result.identification import Identification
from .style import FAINT, MEASURED, MODEL, Figure, line, new_figure, per_row, styled

PANEL_IN = 1.9
"""Height of a panel (inches)."""
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
        A panel per joint, rollouts one after the other; the title has the rms error (mrad or mm).

    Raises
    ------
    PlotError
        Without matplotlib.
    """
    replays_drawn = replayed(fit, experiment) if replays is None else replays
    n = experiment.robot.n_dof
    rows, columns = per_row(n, MOST_PANELS_PER_ROW)
    figure = new_figure(PANEL_IN * rows + 0.3)
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    starts = np.cumsum([0.0, *(replay.t[-1] for replay in replays_drawn)])
    for joint, axes in enumerate(panels[:n]):
        for values, color, label in (
            ("commanded", FAINT, "commanded"),
            ("measured", MEASURED, "measured"),
            ("simulated", MODEL, "simulated"),
        ):
            pieces = [
                (replay.t + start, getattr(replay, values)[:, joint])
                for replay, start in zip(replays_drawn, starts[:-1], strict=True)
            ]
            line(axes, pieces, color=color, label=label, linewidth=0.9)
        axes.set_title(f"{experiment.robot.joint_label(joint)}: {1e3 * rms_error(replays_drawn, joint):.2f}")
    for axes in panels[n:]:
        axes.set_visible(False)
    panels[0].legend(loc="upper right", ncols=3)
    panels[n - 1].set_xlabel("time (s)")
    return figure
