"""Frames of a robot in a pose: the geometric model of modified Denavit-Hartenberg rows (Khalil and Kleinfinger).

Frame j follows the frame before, in a tree that of its antecedent, by ``Rot(x, alpha) Trans(x, d) Rot(z, theta) Trans(z, r)``. The
position of the joint adds to theta (revolute) or to r (prismatic). The core has its own recursion for the dynamics; this one is
for pictures. ``test_plot.py`` compares with the frames of Pinocchio. The pose of the last frame at q = 0 and the longest reach
reveal a wrong robot file at once (``test_reach.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array
from ..errors import ShapeError
from ..robot.robot import Robot
from ..robot.transmission import joint_motion
from .dynamics import per_joint

REACH_POSES = 500
"""Number of random poses from which the search for the longest reach starts."""
JOINT_PASSES = 4
"""Number of passes over the joints, each joint set to the best of `ANGLES` positions."""
SLIDE_M = 1.0
"""Half the travel (m) of a prismatic joint without limits."""


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


ANGLES = 73
"""Number of positions tried per joint: every five degrees of a full turn."""


def flange_at_zero(robot: Robot) -> Array:
    """Return the last frame at q = 0 in frame 0, a homogeneous matrix (4, 4), lengths in m."""
    return np.asarray(frames(robot, np.zeros((1, robot.n_dof)))[0, -1])


def reach(robot: Robot) -> float:
    """Return the largest distance of the origin of the last frame from that of frame 1 (m), within the limits of the robot file.

    Revolute joints without limits turn freely; prismatic ones without limits move by 1 m either way.
    """
    ranges = np.array([_range(robot, joint) for joint in range(robot.n_dof)])
    rng = np.random.default_rng(0)
    q = rng.uniform(ranges[:, 0], ranges[:, 1], (REACH_POSES, robot.n_dof))
    best = q[int(np.argmax(_distances(robot, q)))]
    for _ in range(JOINT_PASSES):
        for joint in range(robot.n_dof):
            tried = np.tile(best, (ANGLES, 1))
            tried[:, joint] = np.linspace(ranges[joint, 0], ranges[joint, 1], ANGLES)
            tried = np.vstack([best, tried])
            best = tried[int(np.argmax(_distances(robot, tried)))]
    return float(_distances(robot, best[None])[0])


def pose_lines(robot: Robot) -> list[str]:
    """Return lines on the pose of the last frame at q = 0, and on the reach; none for a tree, which has several last frames."""
    if not robot.geometry.in_line:
        return []
    pose = flange_at_zero(robot)
    x, y, z = (_number(value) for value in pose[:3, 3])
    axes = "; ".join(
        f"{name} along [{', '.join(_number(value) for value in pose[:3, k])}]" for k, name in enumerate("xyz")
    )
    return [
        f"Frame {robot.n_dof} at q = 0, in frame 0: origin [{x}, {y}, {z}] m, {axes}",
        f"Reach, from the origin of frame 1 to that of frame {robot.n_dof}: {reach(robot):.4g} m",
    ]


def _range(robot: Robot, joint: int) -> tuple[float, float]:
    limits = robot.limits[joint].position
    if limits is not None:
        return limits
    half = np.pi if robot.geometry.kinds[joint] == "revolute" else SLIDE_M
    return -half, half


def _distances(robot: Robot, q: Array) -> Array:
    poses = frames(robot, q)
    return np.asarray(np.linalg.norm(poses[:, -1, :3, 3] - poses[:, 1, :3, 3], axis=1))


def _number(value: float) -> str:
    return f"{0.0 if abs(value) < 5e-10 else value:.4g}"
