"""Right angles that a file has rounded: pi as 3.1416, or 1.570796327.

A twist of 1.5708 rad instead of pi/2 adds a base parameter that no log identifies, and axes that are almost parallel have their
common normal metres or kilometres away. Such angles are therefore snapped to the right angle. Lengths are never changed. Tested
in ``tests/test_urdf_snap.py``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array
from ..placement import in_line
from ..right_angles import NEARLY_PARALLEL, PARALLEL, SUSPICIOUS, nearest_right_angle
from ..rigid_body import pose, turn

CUBE = np.array(
    [
        rotation
        for order in itertools.permutations(np.eye(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
        if np.linalg.det(rotation := np.array(signs)[:, None] * order) > 0.0
    ]
)
"""All rotations by right angles, which exchange the axes of a frame, (24, 3, 3)."""


@dataclass(frozen=True)
class NearlyRight:
    """Two consecutive axes at nearly a right angle.

    Attributes
    ----------
    joint : int
        The second of the two, from 0; the first axis is that of gravity for a joint on the base.
    angle : float
        Distance from the right angle (rad).
    parallel : bool
        Whether the axes are nearly parallel, not nearly perpendicular.
    """

    joint: int
    angle: float
    parallel: bool


@dataclass(frozen=True, eq=False)
class Snapped:
    """A chain with its right angles snapped.

    Attributes
    ----------
    origins : tuple of (4, 4) array
        As in `Chain`.
    axes : tuple of (3,) array
        As in `Chain`.
    largest : float
        Largest angle that was snapped (rad), zero for none.
    joints : tuple of int
        Joints of which an angle was snapped, from 0.
    left : tuple of NearlyRight
        Nearly right angles that were not snapped.
    """

    origins: tuple[Array, ...]
    axes: tuple[Array, ...]
    largest: float
    joints: tuple[int, ...]
    left: tuple[NearlyRight, ...]


def snap_chain(
    origins: Sequence[Array],
    axes: Sequence[Array],
    vertical: Array,
    tolerance: float,
    parents: Sequence[int | None] | None = None,
) -> Snapped:
    """Snap the angles of a chain or a tree that are within a tolerance of right angles.

    First, each rotation between moving links and each axis is snapped to those of a cube. Then the angle between consecutive
    axes is snapped, which detects a rounded right angle next to a general one.

    Parameters
    ----------
    origins, axes
        As in `Chain`.
    vertical : (3,) array
        Direction of gravity in the base; zero for none. The first axes are compared with it.
    tolerance : float
        Largest angle that is snapped (rad); rounding errors (1e-9) always are.
    parents : sequence of int or None, optional
        As in `Chain`; by default those of a chain.
    """
    tolerance = max(tolerance, PARALLEL)
    parents = in_line(len(origins)) if parents is None else parents
    found_origins: list[Array] = []
    found_axes: list[Array] = []
    angles = np.zeros(len(origins))
    left = []
    # Frames of the moving links and their axes at position zero, in the base.
    frames: list[Array] = []
    directions: list[Array] = []
    for joint, (origin, axis) in enumerate(zip(origins, axes, strict=True)):
        rotation, by_rotation = _to_cube(origin[:3, :3], tolerance)
        axis, by_axis = _to_unit(axis, tolerance)
        parent = parents[joint]
        previous, before = (np.eye(3), vertical) if parent is None else (frames[parent], directions[parent])
        frame = previous @ rotation
        now = frame @ axis
        excess, parallel, about = _from_right_angle(before, now)
        turned = 0.0
        if 0.0 < abs(excess) <= tolerance:
            turned = abs(excess)
            frame = turn(about, -excess) @ frame
            rotation = previous.T @ frame
            now = frame @ axis
        elif tolerance < abs(excess) <= (NEARLY_PARALLEL if parallel and parent is not None else SUSPICIOUS):
            left.append(NearlyRight(joint, abs(excess), parallel))
        angles[joint] = max(by_rotation, by_axis, turned)
        found_origins.append(pose(rotation, origin[:3, 3]))
        found_axes.append(axis)
        frames.append(frame)
        directions.append(now)
    angles[angles <= PARALLEL] = 0.0
    return Snapped(
        origins=tuple(found_origins),
        axes=tuple(found_axes),
        largest=float(angles.max(initial=0.0)),
        joints=tuple(int(joint) for joint in np.flatnonzero(angles)),
        left=tuple(left),
    )


def _to_cube(rotation: Array, tolerance: float) -> tuple[Array, float]:
    """Nearest rotation of the cube and its distance (rad), or the rotation itself and zero where it is farther."""
    nearest = CUBE[int(np.argmax(np.einsum("kij,ij->k", CUBE, rotation)))]
    angle = float(np.linalg.norm(rotation - nearest)) / math.sqrt(2.0)
    return (nearest, angle) if angle <= tolerance else (rotation, 0.0)


def _to_unit(axis: Array, tolerance: float) -> tuple[Array, float]:
    nearest = np.zeros(3)
    largest = int(np.argmax(np.abs(axis)))
    nearest[largest] = math.copysign(1.0, axis[largest])
    angle = float(np.linalg.norm(axis - nearest))
    return (nearest, angle) if angle <= tolerance else (axis, 0.0)


def _from_right_angle(first: Array, second: Array) -> tuple[float, bool, Array]:
    """Angle of two directions less the nearest right angle (rad), whether that is 0 or pi, and the unit axis to turn about."""
    if not np.any(first):
        return 0.0, False, np.zeros(3)
    normal = np.cross(first, second)
    sine, cosine = float(np.linalg.norm(normal)), float(first @ second)
    angle = math.atan2(sine, cosine)
    right = nearest_right_angle(angle)
    parallel = right != 0.5 * math.pi
    return angle - right, parallel, normal / sine if sine > 0.0 else normal
