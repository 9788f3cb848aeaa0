"""Clearance of a motion: distances between capsules, from the floor and from the walls of a box, with their gradients.

A capsule is a segment with a radius. The distance of two capsules follows in closed form from the nearest points of their
segments, and its derivative from the velocities of these points. Tested in ``tests/test_clearance.py``, against the geometry of
Pinocchio too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array
from ..model.kinematics import frames
from ..robot.collision import Capsule, checked_pairs
from ..robot.robot import Robot
from ..robot.transmission import driven_part

TINY = 1e-12
"""Squared length (m^2) below which a segment is a point, or two points are one."""


@dataclass(frozen=True, kw_only=True)
class Workspace:
    """Bounds of the robot's workspace, in frame 0.

    Tested in ``tests/test_clearance.py``.

    Attributes
    ----------
    lowest, highest : tuple of float or None
        Corners of the box for all links (m); infinite without a wall.
    floor : float or None
        Smallest height of links 1 to n (m).
    clearance : float
        Smallest distance of links from each other, from the floor and from the walls (m).
    """

    lowest: tuple[float, float, float] | None = None
    highest: tuple[float, float, float] | None = None
    floor: float | None = None
    clearance: float = 0.0


class Clearance:
    """Distances of a robot's links from each other and from the bounds of the workspace.

    Parameters
    ----------
    robot : Robot
        Robot with its frames.
    capsules : sequence of Capsule
        Links as capsules. Without any, the walls bound the origins of the frames.
    workspace : Workspace
        Walls, floor and clearance.
    """

    def __init__(self, robot: Robot, capsules: Sequence[Capsule], workspace: Workspace) -> None:
        self.robot, self.workspace = robot, workspace
        self.pairs = checked_pairs(capsules, robot.geometry.parents)
        if not capsules:
            capsules = [
                Capsule(link=link + 1, start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 0.0), radius=0.0)
                for link in range(robot.n_joints)
            ]
        self.links = np.array([capsule.link for capsule in capsules])
        self.ends = np.array([(capsule.start, capsule.end) for capsule in capsules])
        self.radii = np.array([capsule.radius for capsule in capsules])
        lowest = np.full(3, -np.inf) if workspace.lowest is None else np.array(workspace.lowest)
        highest = np.full(3, np.inf) if workspace.highest is None else np.array(workspace.highest)
        if workspace.floor is not None:
            lowest[2] = max(lowest[2], workspace.floor)
        self.moving = np.flatnonzero(self.links > 0)
        # One wall each: axis, side, place.
        self.walls = [
            (axis, side, bound)
            for side, corner in ((1.0, lowest), (-1.0, highest))
            for axis, bound in enumerate(corner)
            if np.isfinite(bound)
        ]

    @property
    def empty(self) -> bool:
        """Whether nothing is checked."""
        return not self.walls and not len(self.pairs)

    def _points(self, poses: Array) -> Array:
        """Return the ends of all capsules in frame 0, ``(n_samples, n_capsules, 2, 3)``."""
        frame = poses[:, self.links]
        turned = np.einsum("scij,cej->scei", frame[..., :3, :3], self.ends)
        return np.asarray(turned + frame[:, :, None, :3, 3])

    def distances(self, q: Array) -> Array:
        """Return distances less the clearance (m), ``(n_samples, n_distances)``: pairs of capsules first, then walls."""
        points = self._points(frames(self.robot, q))
        return self._parts(points)[0]

    def _parts(self, points: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        i, j = self.pairs.T
        p, r = points[:, i], points[:, j]
        s, t = _nearest(p[..., 0, :], p[..., 1, :], r[..., 0, :], r[..., 1, :])
        between = _along(p, s) - _along(r, t)
        length = np.linalg.norm(between, axis=-1)
        columns = [length - (self.radii[i] + self.radii[j])]
        for axis, side, bound in self.walls:
            gap = (side * (points[:, self.moving][..., axis] - bound)).min(axis=2)
            columns.append(gap - self.radii[self.moving])
        distances = np.concatenate(columns, axis=1) - self.workspace.clearance
        direction = between / np.maximum(length, np.sqrt(TINY))[..., None]
        return distances, (s, t, direction)

    def penalty(self, q: Array, scale: float, extra: float = 0.0) -> tuple[float, Array]:
        """Return the sum of squared shortfalls in units of `scale` (m), and its gradient with respect to q, ``(n_samples, n_dof)``.

        `extra` is added to the clearance (m).
        """
        poses = frames(self.robot, q)
        points = self._points(poses)
        distances, (s, t, direction) = self._parts(points)
        short = np.maximum(extra - distances, 0.0) / scale
        value, gradient = float((short**2).sum()), np.zeros_like(q)
        if value == 0.0:
            return value, gradient
        samples = np.flatnonzero(short.any(axis=1))
        points, short, poses = points[samples], short[samples], poses[samples]
        s, t, direction = s[samples], t[samples], direction[samples]
        # Force and moment about the origin of frame 0 on each link.
        geometry = self.robot.geometry
        force, moment = np.zeros((2, len(samples), self.robot.n_joints + 1, 3))

        def add(capsules: NDArray[np.intp], at: Array, pull: Array) -> None:
            for column, capsule in enumerate(capsules):
                link = self.links[capsule]
                force[:, link] += pull[:, column]
                moment[:, link] += np.cross(at[:, column], pull[:, column])

        n_pairs = len(self.pairs)
        slope = -2.0 / scale * short
        i, j = self.pairs.T
        pull = slope[:, :n_pairs, None] * direction
        add(i, _along(points[:, i], s), pull)
        add(j, _along(points[:, j], t), -pull)
        for wall, (axis, side, _) in enumerate(self.walls):
            nearer = (side * points[:, self.moving][..., axis]).argmin(axis=2)
            at = np.take_along_axis(points[:, self.moving], nearer[..., None, None], axis=2)[:, :, 0]
            pull = np.zeros_like(at)
            first = n_pairs + wall * len(self.moving)
            pull[..., axis] = side * slope[:, first : first + len(self.moving)]
            add(self.moving, at, pull)
        slopes = np.zeros((len(samples), self.robot.n_joints))
        for joint in reversed(geometry.outwards):
            parent = geometry.parents[joint]
            if parent is not None:
                force[:, parent + 1] += force[:, joint + 1]
                moment[:, parent + 1] += moment[:, joint + 1]
            frame = poses[:, joint + 1]
            z, origin = frame[:, :3, 2], frame[:, :3, 3]
            pull = force[:, joint + 1]
            if geometry.kinds[joint] == "revolute":
                pull = moment[:, joint + 1] - np.cross(origin, pull)
            slopes[:, joint] = (z * pull).sum(axis=1)
        gradient[samples] = driven_part(geometry.followers, slopes)
        return value, gradient

    def describe(self, column: int) -> str:
        """Describe a column of `distances`."""
        n_pairs = len(self.pairs)
        if column < n_pairs:
            i, j = (int(self.links[k]) for k in self.pairs[column])
            return f"links {i} and {j}"
        wall, capsule = divmod(column - n_pairs, len(self.moving))
        axis, side, bound = self.walls[wall]
        name = "floor" if axis == 2 and side > 0.0 else f"wall at {'xyz'[axis]} = {bound:g} m"
        return f"link {int(self.links[self.moving[capsule]])} and the {name}"


def _along(ends: Array, share: Array) -> Array:
    """Points of segments ``(..., 2, 3)`` at shares of their length."""
    return np.asarray(ends[..., 0, :] + share[..., None] * (ends[..., 1, :] - ends[..., 0, :]))


def _nearest(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
    """Return the positions of the nearest points on ``a b`` and ``c d``, as shares of their lengths; arrays ``(..., 3)``."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (u * u).sum(-1), (v * v).sum(-1), (u * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    safe_u, safe_v = np.maximum(uu, TINY), np.maximum(vv, TINY)
    determinant = uu * vv - uv * uv
    parallel = determinant <= TINY * safe_u * safe_v
    s = np.where(parallel, 0.0, (uv * vw - vv * uw) / np.where(parallel, 1.0, determinant))
    s = np.where(uu > TINY, np.clip(s, 0.0, 1.0), 0.0)
    t = np.where(vv > TINY, (uv * s + vw) / safe_v, 0.0)
    clipped = np.clip(t, 0.0, 1.0)
    # If t is outside its segment, s follows from the nearer end.
    s = np.where((t != clipped) | (vv <= TINY), np.clip((uv * clipped - uw) / safe_u, 0.0, 1.0), s)
    return np.where(uu > TINY, s, 0.0), clipped
