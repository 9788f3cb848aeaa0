"""Standard (distal) Denavit-Hartenberg tables, as makers print them, and the transformation to the frames of the model.

Frame j of such a table is reached by ``Rot(z, theta_j) Trans(z, d_j) Trans(x, a_j) Rot(x, alpha_j)``, and lies at the end of
link j. Frame j of the model has its z axis along joint axis j. The two share their motion, so one is constant in the other:
``Trans(x, a_j) Rot(x, alpha_j)``. Tested in ``tests/test_standard_dh.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import Table
from .rigid_body import INERTIAL, angle_of, mdh_pose, moved


@dataclass(frozen=True, kw_only=True)
class StandardTable:
    """Columns of a standard table that differ from the rows of the model.

    Attributes
    ----------
    a : tuple of float
        Lengths along x (m), one per joint.
    alpha : tuple of float
        Angles about x (rad).
    """

    a: tuple[float, ...]
    alpha: tuple[float, ...]

    @property
    def poses(self) -> tuple[Array, ...]:
        """Frame j of the table in frame j of the model, (4, 4), for every position of the joints."""
        return tuple(mdh_pose(alpha, a, 0.0, 0.0) for a, alpha in zip(self.a, self.alpha, strict=True))

    @property
    def rows(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Columns alpha and d of the modified table: those of the preceding row."""
        return (0.0, *self.alpha[:-1]), (0.0, *self.a[:-1])


def read_lengths(joint: Table) -> tuple[float, float]:
    """Return a and d of a row (m), both mandatory in a standard table: the keys of the other convention are refused.

    Raises
    ------
    DidimError
        Error of the table's class, when one is missing, or `r_m` of the modified convention is there.
    """
    angles = {name: f"{name}_deg or {name}_rad" for name in ("alpha", "theta")}
    for key, meant in {"a": "a_m", "d": "d_m", **angles}.items():
        if key in joint.content_unread:
            joint.fail(f"unknown key {key!r}; units are part of the keys: {meant}")
    if joint.has("r_m"):
        joint.fail(
            "r_m belongs to convention 'mdh'; with convention = 'dh' the lengths are the maker's: a_m along x and d_m along z"
        )
    if not joint.has("a_m"):
        joint.fail(
            "key 'a_m' is missing: with convention = 'dh' a_m is the length along x and d_m the one along z, 0 if none"
        )
    return joint.number("a_m"), joint.number("d_m")


def in_other_frames(names: Sequence[str], x: Array, poses: Sequence[Array]) -> Array:
    """Return standard parameters with the ten of each link expressed in another frame.

    Parameters
    ----------
    names
        Names of the standard parameters.
    x
        (n_parameters,) their values.
    poses
        (4, 4) pose per link of its present frame in the other one.
    """
    x_out = np.array(x, dtype=np.float64)
    for j, pose in enumerate(poses):
        first = names.index(f"{INERTIAL[0]}{j + 1}")
        ten = slice(first, first + len(INERTIAL))
        x_out[ten] = moved(x_out[ten], pose)
    return x_out


def correspondence_lines(poses: Sequence[Array], joints: Sequence[str]) -> list[str]:
    """Return one line per joint: the pose of its own frame in frame j of the model (mm, degrees)."""
    width = max([len("joint"), *(len(name) for name in joints)])
    lines = [f"   {'joint':{width}}  {'x mm':>9}  {'y mm':>9}  {'z mm':>9}  {'turn deg':>8}  about"]
    for j, (pose, name) in enumerate(zip(poses, joints, strict=True)):
        axis, angle = _axis(pose[:3, :3])
        x, y, z = (f"{1e3 * value + 0.0:9.5g}" for value in pose[:3, 3])
        lines.append(f"{j + 1:2} {name:{width}}  {x}  {y}  {z}  {angle:8.4g}  {axis}")
    return lines


def _axis(rotation: Array) -> tuple[str, float]:
    """Return the axis and the angle (degrees) of a rotation in words."""
    angle = math.degrees(angle_of(rotation))
    if angle < 1e-7:
        return "-", 0.0
    vector = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    if np.linalg.norm(vector) < 1e-7:  # half a turn: the axis is the column that the rotation preserves
        symmetric = 0.5 * (rotation + np.eye(3))
        vector = symmetric[:, int(np.argmax(np.diag(symmetric)))]
    unit = vector / np.linalg.norm(vector)
    for name, direction in zip("xyz", np.eye(3), strict=True):
        along = float(unit @ direction)
        if abs(along) > 1.0 - 1e-9:
            return name, angle if along > 0.0 else -angle
    return "(" + ", ".join(f"{value + 0.0:.4g}" for value in unit) + ")", angle
