"""Frames of a robot in a pose: the geometric model of modified Denavit-Hartenberg rows (Khalil and Kleinfinger).

Frame j follows the frame before, in a tree that of its antecedent, by ``Rot(x, alpha) Trans(x, d) Rot(z, theta) Trans(z, r)``. The
position of the joint adds to theta (revolute) or to r (prismatic). The core has its own recursion for the dynamics; this one is
for pictures. ``test_plot.py`` compares with the frames of Pinocchio.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array
from ..errors import ShapeError
from ..robot.robot import Robot
from ..robot.transmission import joint_motion
from .dynamics import per_joint


def frames(robot: Robot, q: ArrayLike) -> Array:
    """Frames 0 to n of a robot, in frame 0.

    Parameters
    ----------
    robot : Robot
        Robot with its rows.
    q : (n_samples, n_dof) array
        Positions (rad or m), joint side.

    Returns
    -------
    (n_samples, n_joints + 1, 4, 4) array
        Homogeneous matrices: axes in the first three columns, origin (m) in the fourth. Frame 0 is the identity.

    Raises
    ------
    ShapeError
        For positions of another shape, or that are not finite.
    """
    positions = per_joint(robot, "q", q)
    if not np.isfinite(positions).all():
        sample, joint = np.argwhere(~np.isfinite(positions))[0]
        raise ShapeError(f"q of joint {joint + 1} is {positions[sample, joint]} at sample {sample}")
    geometry = robot.geometry
    parents = geometry.parents
    all_positions = joint_motion(geometry.followers, positions, position=True)
    transforms = np.empty((len(positions), robot.n_joints + 1, 4, 4))
    transforms[:, 0] = np.eye(4)
    for joint in geometry.outwards:
        kind, moved = geometry.kinds[joint], all_positions[:, joint]
        turn = geometry.theta[joint] + (moved if kind == "revolute" else np.zeros_like(moved))
        slide = geometry.r[joint] + (moved if kind == "prismatic" else np.zeros_like(moved))
        row = _row(geometry.alpha[joint], geometry.d[joint], turn, slide)
        parent = parents[joint]
        before = transforms[:, 0 if parent is None else parent + 1]
        if geometry.mounts:
            before = np.matmul(before, geometry.mounts[joint].matrix)
        transforms[:, joint + 1] = np.matmul(before, row)
    return transforms


def _row(alpha: float, d: float, theta: Array, r: Array) -> Array:
    """Return the matrices of one row, (n_samples, 4, 4); theta and r are (n_samples,)."""
    ca, sa = np.cos(alpha), np.sin(alpha)
    ct, st = np.cos(theta), np.sin(theta)
    zero, one = np.zeros_like(ct), np.ones_like(ct)
    rows = [
        [ct, -st, zero, d * one],
        [ca * st, ca * ct, -sa * one, -r * sa],
        [sa * st, sa * ct, ca * one, r * ca],
        [zero, zero, zero, one],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
