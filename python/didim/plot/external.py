"""Picture of external torques along a log."""

from __future__ import annotations

import numpy as np

from ..studies.loads.residual import Residual
from .style import FAINT, MODEL, RESIDUAL, Figure, line, new_figure, styled

PANEL_IN = 1.5
"""Height of a joint's panel (inches)."""


@styled
def external(residual: Residual) -> Figure:
    """Draw the external torques of each joint over time, with intervals, the observer and the detections.

    Parameters
    ----------
    residual : Residual
        From `didim.studies.loads.residual.residual_torques`.

    Returns
    -------
    Figure
        A row per joint: the torque along the filtered motion with its 95 % interval, the observer, its limits (dashed), and the
        detections as shading. Windows follow each other in time.

    Raises
    ------
    PlotError
        Without matplotlib.
    """
    n = residual.windows[0].torque.shape[1]
    figure = new_figure(PANEL_IN * n + 0.4)
    panels = figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
    starts = np.cumsum([0.0, *(window.observer_t[-1] - window.observer_t[0] for window in residual.windows)])
    for joint, axes in enumerate(panels):
        for index, (window, start) in enumerate(zip(residual.windows, starts[:-1], strict=True)):
            shift = start - window.observer_t[0]
            low, high = window.interval()
            axes.fill_between(window.t + shift, low[:, joint], high[:, joint], color=FAINT, linewidth=0.0)
            line(
                axes,
                [(window.t + shift, window.torque[:, joint])],
                color=MODEL,
                label="along the motion" if not index else None,
            )
            line(
                axes,
                [(window.observer_t + shift, window.observed[:, joint])],
                color=RESIDUAL,
                linewidth=0.8,
                label="observer" if not index else None,
            )
            for sign in (-1.0, 1.0):
                limit = sign * window.limits[:, joint]
                line(
                    axes, [(window.observer_t + shift, limit)], color=RESIDUAL, linewidth=0.6, linestyle="--"
                )
            for contact in window.contacts:
                shade = 0.35 if joint + 1 in contact.joints else 0.12
                axes.axvspan(
                    contact.start_s + shift,
                    contact.stop_s + shift,
                    color=RESIDUAL,
                    alpha=shade,
                    linewidth=0.0,
                )
            if window.payload_change is not None:
                axes.axvline(window.payload_change.start_s + shift, color="black", linewidth=1.0)
        name = f" ({residual.joint_names[joint]})" if residual.joint_names else ""
        axes.set_title(f"joint {joint + 1}{name}")
        axes.set_ylabel("N.m or N")
    panels[0].legend(loc="upper right", ncols=2)
    panels[-1].set_xlabel("time (s)")
    return figure
