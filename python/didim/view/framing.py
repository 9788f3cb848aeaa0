"""Places of floor and camera that keep all of a robot, in all poses of its motions, in the picture.

Tested in ``tests/test_view.py``.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from .._tools.arrays import Array
from ..model.kinematics import frames
from ..robot.robot import Robot
from .playback import Playback
from .shapes import Shape

VIEWED_FROM = (0.9, -1.1, 0.7)
"""Direction from the robot to the camera along the axes of the floor: from the front and above, so no level axis points at it."""
MARGIN = 1.25
"""Distance of the camera over the smallest one from which all points are in the picture."""
MOST_POSES = 60
"""Largest number of poses of a motion that the picture must hold: enough for a path without gaps wider than a link."""


def floor_axes(gravity: Array) -> Array:
    """Return the axes of the floor as columns, (3, 3): two level ones, and up, which is z without gravity."""
    size = float(np.linalg.norm(gravity))
    up = np.array([0.0, 0.0, 1.0]) if size == 0.0 else -gravity / size
    # The level axis nearest to x, or to y for a robot whose x axis is upright.
    along = np.eye(3)[0 if abs(up[0]) < 0.9 else 1]
    x = along - (along @ up) * up
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up], axis=1)


def poses_of(robot: Robot, playbacks: Sequence[Playback]) -> Array:
    """Return poses of all motions, (n_poses, n_dof), at most `MOST_POSES` of each; position zero without a motion."""
    thinned = [
        playback.q[np.linspace(0, len(playback.q) - 1, MOST_POSES).round().astype(int)]
        for playback in playbacks
    ]
    return np.concatenate(thinned or [np.zeros((1, robot.n_dof))])


def box_of(shape: Shape) -> Array:
    """Return the corners of a box around a shape in the frame of its link, (8, 3) (m); a mesh needs its vertices."""
    if shape.kind == "cylinder":
        half = np.array([shape.size[0], shape.size[0], 0.5 * shape.size[1]])
    elif shape.kind == "box":
        half = 0.5 * np.array(shape.size)
    else:
        half = np.broadcast_to(np.array(shape.size), 3)
    return box_around(np.stack([-half, half]), shape.pose)


def box_around(points: Array, pose: Array) -> Array:
    """Return the corners, (8, 3), of the box around points (k, 3), moved by a pose (4, 4) (m)."""
    corners = np.array(list(itertools.product(*np.stack([points.min(axis=0), points.max(axis=0)], axis=1))))
    moved: Array = corners @ pose[:3, :3].T + pose[:3, 3]
    return moved


def points_in(robot: Robot, q: Array, boxes: Sequence[tuple[int, Array]]) -> Array:
    """Return the origins of all frames and the corners of the links' boxes in all poses, (k, 3), in frame 0 (m)."""
    at = frames(robot, q)
    parts = [at[:, :, :3, 3].reshape(-1, 3)]
    for link, corners in boxes:
        matrix = at[:, link]
        parts.append((corners @ matrix[:, :3, :3].swapaxes(1, 2) + matrix[:, None, :3, 3]).reshape(-1, 3))
    return np.concatenate(parts)


def camera(
    points: Array, axes: Array, angle: float, aspect: float, share: float = 1.0
) -> tuple[Array, Array]:
    """Return the position of a camera that sees all points, and the point that it looks at, both (3,).

    Parameters
    ----------
    points : (k, 3) array
        Points (m), which are not all in one place.
    axes : (3, 3) array
        Axes of the floor, as columns.
    angle : float
        Vertical angle of view (rad).
    aspect : float
        Width of the picture over its height.
    share : float
        Upper share of the picture in which the points are; the rest may be covered.
    """
    away = axes @ np.array(VIEWED_FROM)
    away /= np.linalg.norm(away)
    right = np.cross(axes[:, 2], away)
    right /= np.linalg.norm(right)
    seen = np.stack([right, np.cross(away, right), away], axis=1)
    placed = points @ seen
    middle = 0.5 * (placed.min(axis=0) + placed.max(axis=0))
    x, y, depth = (placed - middle).T
    slope = float(np.tan(0.5 * angle))
    sides = np.abs(x) / aspect / slope + depth
    above, below = (y / slope + depth) / share, (-y / slope - (1.0 - 2.0 * share) * depth) / share
    distance = float(np.max([sides, above, below]))
    look_at: Array = seen @ (middle - (0.0, (1.0 - share) * slope * MARGIN * distance, 0.0))
    return look_at + MARGIN * distance * away, look_at
