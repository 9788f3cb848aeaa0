"""Pictures of designed motions: positions, velocities and torques against their limits, and the swept poses."""

from __future__ import annotations

import numpy as np

from ..excitation.design import Excitation
from ..model.dynamics import inverse_dynamics
from ..model.kinematics import frames
from .style import FAINT, MODEL, RESIDUAL, Figure, legend_above, line, new_figure, per_row, styled, units

MOST_POSES = 60
"""Largest number of poses in the picture of the swept space."""
PER_ROW = 3
"""Number of joints side by side."""


@styled
def motion(design: Excitation) -> Figure:
    """Draw each joint's positions with their limits, and velocities and torques as shares of theirs.

    Parameters
    ----------
    design : Excitation
        From `excite`.

    Returns
    -------
    Figure
        One panel per joint: position within its range, velocity and, with parameters, torque as shares of their limits.

    Raises
    ------
    PlotError
        Without matplotlib.
    """
    t, q, dq, ddq = design.sampled()
    n = design.robot.n_dof
    rows, columns = per_row(n, PER_ROW)
    figure = new_figure(2.1 * rows)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    limits = design.limits.whole
    middle, half = (limits.highest + limits.lowest) / 2.0, (limits.highest - limits.lowest) / 2.0
    shares = {"position": (q - middle) / half, "velocity": dq / limits.velocity}
    if design.x is not None and np.isfinite(limits.torque).all():
        shares["torque"] = inverse_dynamics(design.robot, q, dq, ddq, design.x) / limits.torque
    colors = {"position": MODEL, "velocity": FAINT, "torque": RESIDUAL}
    for joint, axes in enumerate(grid.flat):
        if joint >= n:
            axes.set_axis_off()
            continue
        for kind, values in shares.items():
            line(axes, [(t, values[:, joint])], color=colors[kind], label=kind, linewidth=0.9)
        # Limits reduced by the margin.
        for bound in (-design.limits.margin, design.limits.margin):
            axes.axhline(bound, color="black", linewidth=0.6, linestyle=":")
        unit = units(design.robot.joint_kinds[joint])[0]
        low, high = limits.lowest[joint], limits.highest[joint]
        axes.set_title(f"joint {joint + 1}, {low:.3g} to {high:.3g} {unit}")
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")
    for row in grid:
        row[0].set_ylabel("share of limit")
    legend_above(figure, grid.flat[0])
    return figure


@styled
def swept(design: Excitation) -> Figure:
    """Draw the poses of a motion: links as lines, in side and top view.

    Parameters
    ----------
    design : Excitation
        From `excite`.

    Returns
    -------
    Figure
        In m, frame 0.

    Raises
    ------
    PlotError
        Without matplotlib.
    """
    _, q, _, _ = design.sampled(50.0)
    poses = q[:: max(1, len(q) // MOST_POSES)]
    points = frames(design.robot, poses)[:, :, :3, 3]
    swept_path = frames(design.robot, q)[:, -1, :3, 3]
    figure = new_figure(3.4)
    for axes, (across, up) in zip(figure.subplots(1, 2), ((0, 2), (0, 1)), strict=True):
        for pose in points:
            axes.plot(pose[:, across], pose[:, up], color=FAINT, linewidth=0.6)
        axes.plot(swept_path[:, across], swept_path[:, up], color=MODEL, linewidth=0.9)
        axes.set_xlabel(f"{'xyz'[across]} (m)")
        axes.set_ylabel(f"{'xyz'[up]} (m)")
        axes.set_aspect("equal", adjustable="datalim")
    return figure
