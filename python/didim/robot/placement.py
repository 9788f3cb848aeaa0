"""Placements of the joints of a tree: antecedents, and the parameters of a modified row that chains do not need.

Khalil and Kleinfinger (1986): frame j follows the frame of its antecedent a(j) by ``Trans(shift) Rot(z, gamma) Trans(z, b)`` and
then as in a chain, ``Rot(x, alpha) Trans(x, d) Rot(z, theta) Trans(z, r)``. Any pose is such a row with ``b = d = r = 0``: the
angles are Euler's (z, x, z), and the shift is the translation. Tested in ``tests/test_trees.py``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from .right_angles import without_rounding
from .rigid_body import mdh_pose, pose


@dataclass(frozen=True, kw_only=True)
class Mount:
    """Antecedent of a joint, and the parameters of its row that chains do not need.

    Attributes
    ----------
    parent : int or None
        The antecedent, from 0; None for the base.
    gamma : float
        Angle about z of the antecedent (rad).
    b : float
        Distance along z of the antecedent (m).
    shift : tuple of float
        Displacement in the frame of the antecedent (m), for a placement copied from the description.
    """

    parent: int | None
    gamma: float = 0.0
    b: float = 0.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def matrix(self) -> Array:
        """Pose (4, 4), in the frame of the antecedent, in front of ``Rot(x, alpha)``."""
        turned = mdh_pose(0.0, 0.0, self.gamma, self.b)
        turned[:3, 3] += self.shift
        return turned


def in_line(n_dof: int) -> tuple[int | None, ...]:
    """Return the parents of joints in a line."""
    return tuple(j - 1 if j else None for j in range(n_dof))


def limbs(parents: Sequence[int | None]) -> tuple[tuple[int, ...], ...]:
    """Return the joints of each limb, such as a torso, an arm, a leg: they stand on each other, and no other branch among them."""
    children = [sum(other == joint for other in parents) for joint in range(len(parents))]
    limbs_so_far: list[list[int]] = []
    for joint, parent in enumerate(parents):
        if parent is not None and children[parent] == 1 and limbs_so_far and limbs_so_far[-1][-1] == parent:
            limbs_so_far[-1].append(joint)
        else:
            limbs_so_far.append([joint])
    return tuple(tuple(limb) for limb in limbs_so_far)


def joined(count: int, pairs: Iterable[Sequence[int]]) -> list[tuple[int, ...]]:
    """Return the groups of the numbers below `count` that pairs of them join, in the order of their first ones."""
    group = list(range(count))
    for a, b in pairs:
        low, high = sorted((group[a], group[b]))
        group = [low if number == high else number for number in group]
    return [tuple(k for k, number in enumerate(group) if number == first) for first in dict.fromkeys(group)]


def chain(n_dof: int) -> tuple[Mount, ...]:
    """Return the mounts of joints in a line."""
    return tuple(Mount(parent=parent) for parent in in_line(n_dof))


def carriers(parents: Sequence[int | None], joint: int) -> list[int]:
    """Return the joints that carry a link, from the base on, its own joint last (from 0)."""
    path = []
    at: int | None = joint
    while at is not None:
        path.append(at)
        at = parents[at]
    return path[::-1]


def as_row(placement: Array, parent: int | None) -> tuple[Mount, float, float]:
    """Return mount, alpha and theta (rad) of a placement (4, 4) copied from the description."""
    rotation, (x, y, z) = placement[:3, :3], placement[:3, 3]
    sine = math.hypot(rotation[0, 2], rotation[1, 2])
    # For parallel axes only the sum or the difference of gamma and theta is defined.
    # Largest sine of the angle between two z axes that count as parallel: rounding.
    gamma = without_rounding(math.atan2(rotation[0, 2], -rotation[1, 2])) if sine > 1e-12 else 0.0
    alpha = without_rounding(math.atan2(sine, rotation[2, 2]))
    # For nearly parallel axes gamma is inaccurate; theta compensates for its error.
    rest = (mdh_pose(0.0, 0.0, gamma, 0.0) @ mdh_pose(alpha, 0.0, 0.0, 0.0))[:3, :3].T @ rotation
    theta = without_rounding(math.atan2(rest[1, 0], rest[0, 0]))
    shift = (float(x) + 0.0, float(y) + 0.0, float(z) + 0.0)
    return Mount(parent=parent, gamma=gamma, shift=shift), alpha, theta


def placed(mount: Mount, row: Sequence[float]) -> Array:
    """Return the pose (4, 4) of a frame in that of its antecedent; the row is alpha, d, theta, r (rad, m)."""
    alpha, d, theta, r = row
    return np.asarray(mount.matrix @ mdh_pose(alpha, d, theta, r))


def frame_along(axis: Array) -> Array:
    """Return a frame (4, 4) with z along a unit axis: the identity for z, else the smallest rotation."""
    x, y, z = axis
    if z < -0.5:  # first by pi about x, away from the singularity
        half = np.diag([1.0, -1.0, -1.0])
        return pose(half @ frame_along(half @ axis)[:3, :3])
    factor = 1.0 / (1.0 + z)
    return pose(
        np.array(
            [
                [1.0 - x * x * factor, -x * y * factor, x],
                [-x * y * factor, 1.0 - y * y * factor, y],
                [-x, -y, z],
            ]
        )
    )
