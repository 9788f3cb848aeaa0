"""Picture of friction curves: torque over speed, joint by joint."""

from __future__ import annotations

import numpy as np

from ..experiment.experiment import Experiment
from ..result.identification import Identification
from ..studies.friction_curve import friction_curves
from .style import MEASURED, MODEL, Figure, new_figure, per_row, styled, units

PANELS_PER_ROW = 3
"""Number of panels side by side."""
PANEL_IN = 2.5
"""Height of a panel (inches)."""
MOST_MARKS = 120
"""Largest number of rows of the log in a panel."""


@styled
def friction(fit: Identification, experiment: Experiment) -> Figure:
    """Draw the friction of each joint over its speed, with the rows of the log.

    Parameters
    ----------
    fit : Identification
        Any result.
    experiment : Experiment
        The log.

    Returns
    -------
    Figure
        A panel per joint: rows of the log (measured torque less all other terms of the model), the curve of the model at the
        median load, and with load friction a band from light to heavy loads.

    Raises
    ------
    DidimError
        As for `didim.studies.friction_curve.friction_curves`; a `PlotError` without matplotlib.
    """
    curves = friction_curves(fit, experiment)
    robot = experiment.robot
    rows, columns = per_row(len(curves), PANELS_PER_ROW)
    figure = new_figure(PANEL_IN * rows + 0.3)
    for joint, curve in enumerate(curves):
        axes = figure.add_subplot(rows, columns, joint + 1)
        marks = slice(None, None, -(-len(curve.measured) // MOST_MARKS))
        axes.plot(
            curve.measured_speed[marks],
            curve.measured[marks],
            ".",
            color=MEASURED,
            markersize=4.0,
            markeredgewidth=0.0,
            label="log",
        )
        if not np.array_equal(curve.low, curve.high):
            axes.fill_between(
                curve.speed,
                curve.low,
                curve.high,
                color=MODEL,
                alpha=0.2,
                linewidth=0.0,
                label="light to heavy load",
            )
        axes.plot(curve.speed, curve.torque, color=MODEL, label="friction")
        position, torque = units(robot.joint_kinds[joint])
        axes.set_title(robot.joint_label(joint))
        axes.set_xlabel(f"speed ({position}/s)")
        axes.set_ylabel(f"{'force' if robot.joint_kinds[joint] == 'prismatic' else 'torque'} ({torque})")
        if joint == 0:
            axes.legend(loc="best")
    return figure
