"""Rows of a modified Denavit-Hartenberg table from axes in space: the common normals of Khalil and Kleinfinger.

Frame j has its z axis along joint axis j and its x axis along the common normal of axes j and j+1. Frame 0 is frame 1 at position
zero, and the last frame continues the x axis before it. Trees and nearly parallel axes do not use common normals.
Tested in ``tests/test_urdf.py`` against Pinocchio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..._tools.arrays import Array
from ..placement import Mount, as_row, frame_along
from ..right_angles import PARALLEL, without_rounding
from ..rigid_body import inverse, mdh_pose, pose

LENGTH_ROUNDING = 1e-10
"""Length (m) below which a distance is zero: the rounded numbers of a file separate axes that meet."""


class Row(NamedTuple):
    """One row of the table: rad and m."""

    alpha: float
    d: float
    theta: float
    r: float


@dataclass(frozen=True, eq=False)
class MdhTable:
    """A modified Denavit-Hartenberg table, and the poses of its frames relative to the original ones.

    Attributes
    ----------
    rows : tuple of Row
        One per joint; the first is zero.
    frame_0 : (4, 4) array
        Frame 0 in the base.
    link_poses : tuple of (4, 4) array
        Pose of each moving link in its frame j, for every position of the joints.
    mounts : tuple of Mount
        Mounts of a tree's joints; empty for a chain along common normals.
    """

    rows: tuple[Row, ...]
    frame_0: Array
    link_poses: tuple[Array, ...]
    mounts: tuple[Mount, ...] = ()


def common_normals(origins: Sequence[Array], axes: Sequence[Array]) -> MdhTable:
    """Return the table of a chain.

    Parameters
    ----------
    origins, axes
        As in `Chain`; consecutive axes are parallel (within 1e-9 rad) or clearly not.
    """
    links = []
    link = np.eye(4)
    for origin in origins:
        link = link @ origin
        links.append(link)
    points = [link[:3, 3] for link in links]
    directions = [link[:3, :3] @ axis for link, axis in zip(links, axes, strict=True)]
    frames = _frames(points, directions, links[0][:3, 0])
    rows = [Row(0.0, 0.0, 0.0, 0.0)]
    rows += [_row(before, after) for before, after in pairwise(frames)]
    # The frames of the rounded rows, so that the table and the poses of the links agree to the last digit.
    link_poses = []
    frame = frames[0]
    for row, link in zip(rows, links, strict=True):
        frame = frame @ mdh_pose(*row)
        link_poses.append(inverse(frame) @ link)
    return MdhTable(tuple(rows), frames[0], tuple(link_poses))


def as_they_are(origins: Sequence[Array], axes: Sequence[Array], parents: Sequence[int | None]) -> MdhTable:
    """Return the rows that copy placements without common normals; each frame is that of its moving link, with z along the axis."""
    frames = [frame_along(axis) for axis in axes]
    mounts, rows = [], []
    for frame, origin, parent in zip(frames, origins, parents, strict=True):
        before = np.eye(4) if parent is None else frames[parent]
        mount, alpha, theta = as_row(inverse(before) @ origin @ frame, parent)
        mounts.append(mount)
        rows.append(Row(alpha, 0.0, theta, 0.0))
    return MdhTable(tuple(rows), np.eye(4), tuple(inverse(frame) for frame in frames), tuple(mounts))


def _frames(points: Sequence[Array], z: Sequence[Array], x_hint: Array) -> list[Array]:
    """Poses of the frames at position zero; `x_hint` is x of the first frame where no normal defines it."""
    n = len(points)
    frames = []
    foot = points[0]  # intersection of the previous normal with this axis
    x = _across(z[0], x_hint)
    for j in range(n - 1):
        normal = np.cross(z[j], z[j + 1])
        sine = float(np.linalg.norm(normal))
        if sine > PARALLEL:
            normal = normal / sine
            a, _, b = np.linalg.solve(np.column_stack([z[j], normal, -z[j + 1]]), points[j + 1] - points[j])
            origin, next_foot = points[j] + a * z[j], points[j + 1] + b * z[j + 1]
        else:
            # Any common normal is valid: the one through the previous foot makes r zero.
            origin = foot
            apart = points[j + 1] - origin
            apart = apart - (apart @ z[j]) * z[j]
            length = float(np.linalg.norm(apart))
            next_foot = origin + apart
            normal = apart / length if length > LENGTH_ROUNDING else _across(z[j], x)
        # Of the two directions of a normal, the one with an angle of 0 instead of pi.
        if j and normal @ x < 0.0 and np.linalg.norm(np.cross(normal, x)) < PARALLEL:
            normal = -normal
        x = normal
        frames.append(_frame(x, z[j], origin))
        foot = next_foot
    frames.append(_frame(_across(z[-1], x), z[-1], foot))
    return frames


def _across(z: Array, x: Array) -> Array:
    """Return the unit component of `x` perpendicular to `z`; any perpendicular direction if `x` is along `z`."""
    for candidate in (x, np.roll(np.eye(3)[int(np.argmax(np.abs(z)))], 1)):
        across = candidate - (candidate @ z) * z
        length = float(np.linalg.norm(across))
        if length > 1e-3:
            break
    return np.asarray(across / length)


def _frame(x: Array, z: Array, origin: Array) -> Array:
    return pose(np.column_stack([x, np.cross(z, x), z]), origin)


def _row(before: Array, after: Array) -> Row:
    x, z = before[:3, 0], after[:3, 2]
    x_after, z_before = after[:3, 0], before[:3, 2]
    shift = after[:3, 3] - before[:3, 3]
    return Row(
        alpha=_angle(math.atan2(float(np.cross(z_before, z) @ x), float(z_before @ z))),
        d=_length(float(shift @ x)),
        theta=_angle(math.atan2(float(np.cross(x, x_after) @ z), float(x @ x_after))),
        r=_length(float(shift @ z)),
    )


def _angle(angle: float) -> float:
    exact = without_rounding(angle)
    return math.pi if exact == -math.pi else exact


def _length(length: float) -> float:
    return length if abs(length) > LENGTH_ROUNDING else 0.0
