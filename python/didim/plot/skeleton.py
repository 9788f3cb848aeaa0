"""Picture of a robot's skeleton in a pose, in which a wrong row of the robot file is visible."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array, real_array
from ..errors import PlotError
from ..model.kinematics import frames
from ..robot.robot import Robot
from .style import FAINT, MODEL, RESIDUAL, Figure, new_figure, styled

AXIS_SHARE = 0.13
"""Length of a drawn joint axis, as a share of the picture."""
MOST_PATH_POINTS = 400
"""Largest number of points of a drawn path."""


@styled
def robot(robot: Robot, q: ArrayLike | None = None, *, motion: ArrayLike | None = None) -> Figure:
    """Draw the joints and links of a robot in a pose.

    Parameters
    ----------
    robot : Robot
        Robot; links are drawn as lines, joint axes as short ones.
    q : (n_dof,) array, optional
        Pose (rad or m). By default the pose of the motion with the longest horizontal reach of the last frame; zero without a
        motion.
    motion : (n_samples, n_dof) array, optional
        Positions; the path of the last frame's origin is drawn.

    Returns
    -------
    Figure
        In m, frame 0.

    Raises
    ------
    ShapeError
        For positions of the wrong shape.
    PlotError
        Without matplotlib.
    """
    tip_path = None
    if motion is not None:
        path = real_array("motion", motion, PlotError)
        path = path[:: max(1, len(path) // MOST_PATH_POINTS)]
        tip_path = frames(robot, path)[:, -1, :3, 3]
        if q is None:
            q = path[int(np.argmax(np.linalg.norm(tip_path - _along(robot, tip_path), axis=1)))]
    if q is None:
        q = np.zeros(robot.n_dof)
    pose = np.asarray(q, dtype=np.float64)
    if pose.shape != (robot.n_dof,):
        raise PlotError(f"q must have shape ({robot.n_dof},) for robot {robot.name!r}, got {pose.shape}")
    points, axes_z = skeleton(robot, pose)
    return _draw(robot, points, axes_z, frames(robot, pose[None])[0, 1:, :3, 3], tip_path)


def _along(robot: Robot, points: Array) -> Array:
    """Return the part of vectors that lies along gravity; none without gravity."""
    gravity = np.array(robot.geometry.gravity)
    size = np.linalg.norm(gravity)
    if size == 0.0:
        return np.zeros_like(points)
    down = gravity / size
    return np.asarray(np.outer(points @ down, down))


def skeleton(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Return the corners of the links and the joints' axes, (n_dof, 3).

    The corners of a chain, (2 n_dof + 1, 3), go along x by d and then along z by r. Those of a tree, (3 n_dof, 3), go from the
    frame of the antecedent and have a row of NaN behind each link, which breaks the line that is drawn.
    """
    poses = frames(robot, q[None])[0]
    if not robot.geometry.in_line:
        gap = np.full(3, np.nan)
        lines = [
            (poses[0 if parent is None else parent + 1, :3, 3], poses[joint + 1, :3, 3], gap)
            for joint, parent in enumerate(robot.geometry.parents)
        ]
        return np.array(lines).reshape(-1, 3), poses[1:, :3, 2]
    corners = [poses[0, :3, 3]]
    for joint in range(robot.n_dof):
        before = poses[joint]
        corners.append(before[:3, 3] + robot.geometry.d[joint] * before[:3, 0])
        corners.append(poses[joint + 1, :3, 3])
    return np.array(corners), poses[1:, :3, 2]


def _draw(robot: Robot, points: Array, axes_z: Array, origins: Array, tip_path: Array | None) -> Figure:
    from mpl_toolkits.mplot3d import Axes3D

    everything = points if tip_path is None else np.concatenate([points, tip_path])
    low, high = np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)
    size = max(float((high - low).max()), 0.1)
    figure = new_figure(5.2, 5.6)
    axes: Any = figure.add_subplot(projection="3d")
    assert isinstance(axes, Axes3D)
    if tip_path is not None:
        axes.plot(*tip_path.T, color=RESIDUAL, linewidth=0.7, alpha=0.7, label="path of the last frame")
    axes.plot(*points.T, color="#3a424d", linewidth=5.0, solid_capstyle="round", solid_joinstyle="round")
    axes.plot(*points[:1].T, marker="s", markersize=11, color="#3a424d", linestyle="none", label="base")
    length = AXIS_SHARE * size
    for joint, (origin, z) in enumerate(zip(origins, axes_z, strict=True)):
        ends = np.stack([origin - length * z, origin + length * z])
        prismatic = robot.joint_kinds[joint] == "prismatic"
        first = robot.joint_kinds.index(robot.joint_kinds[joint]) == joint
        axes.plot(
            *ends.T,
            color=MODEL,
            linewidth=2.0,
            linestyle=":" if prismatic else "-",
            label=f"axis of a {robot.joint_kinds[joint]} joint" if first else None,
        )
        # At its own end of the axis, a label stays readable where several joints share an origin.
        axes.text(
            *(origin + 1.25 * length * z),
            str(joint + 1),
            color=MODEL,
            fontsize=10,
            fontweight="bold",
            ha="center",
            va="center",
        )
    axes.plot(
        *origins.T, marker="o", markersize=5, color="white", markeredgecolor="#3a424d", linestyle="none"
    )
    middle = (low + high) / 2.0
    half = size / 2.0 + length
    for set_limits, centre in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, strict=True):
        set_limits(centre - half, centre + half)
    axes.set_box_aspect((1, 1, 1))
    # From the side of the arm, so that no link hides behind another.
    reach = origins[-1] - points[0]
    axes.view_init(elev=24.0, azim=float(np.degrees(np.arctan2(reach[1], reach[0]))) - 65.0)
    axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color("#fafbfc")
        axis._axinfo["grid"].update(color=FAINT, linewidth=0.5)
    axes.locator_params(nbins=5)
    axes.legend(loc="upper left", fontsize=8.0)
    return figure
