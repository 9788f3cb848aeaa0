"""Inertia of the solids of an MJCF: balls, capsules, cylinders, ellipsoids and boxes. Tested in ``tests/test_mjcf.py``."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..._tools.arrays import Array
from ...errors import RobotError
from ..rigid_body import pose, turn
from .description import Inertial

DENSITY = 1000.0
"""Density (kg/m^3) of a geom with neither mass nor density, as in MuJoCo."""

SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
"""Number of sizes of each solid; ``fromto`` replaces the length."""

NO_SOLID = ("plane", "hfield", "sdf")
"""Types of geoms without mass."""


def solid_inertial(given: Mapping[str, str], frame: Array, where: str) -> Inertial:
    """Return the inertia of a geom.

    Parameters
    ----------
    given : mapping of str to str
        Attributes, with those of its class.
    frame : (4, 4) array
        Pose of the geom in the body (m).
    where : str
        Prefix of each message.

    Raises
    ------
    RobotError
        For an unknown type, or a size with too few numbers.
    """
    kind = given.get("type", "sphere")
    if kind in NO_SOLID:
        return Inertial(0.0, frame, np.zeros((3, 3)))
    if kind not in SIZES:
        raise RobotError(f"{where} a geom of type {kind!r} has no inertia that is known")
    try:
        size = [float(word) for word in given.get("size", "").split()]
        ends = [float(word) for word in given.get("fromto", "").split()]
    except ValueError:
        size, ends = [], []
    if len(ends) == 6:
        start, end = np.array(ends[:3]), np.array(ends[3:])
        half = 0.5 * float(np.linalg.norm(end - start))
        radii = size[:1] if kind in ("capsule", "cylinder") else size[:1] * 2
        size = [*radii, half]
        frame = pose(along(direction_of(end - start)), 0.5 * (start + end))
    if len(size) < SIZES[kind] or not all(length > 0.0 for length in size[: SIZES[kind]]):
        raise RobotError(f"{where} the size of a {kind} must be {SIZES[kind]} positive numbers")
    volume, unit = _unit_inertia(kind, size)
    mass = float(given["mass"]) if "mass" in given else volume * float(given.get("density", DENSITY))
    return Inertial(mass=mass, frame=frame, inertia=mass * np.diag(unit))


def _unit_inertia(kind: str, size: list[float]) -> tuple[float, Array]:
    """Volume (m^3) and principal moments per mass (m^2)."""
    if kind == "box":
        a, b, c = (length * length for length in size[:3])
        return 8.0 * math.prod(size[:3]), np.array([b + c, a + c, a + b]) / 3.0
    if kind in ("sphere", "ellipsoid"):
        x, y, z = size[:1] * 3 if kind == "sphere" else size[:3]
        return 4.0 / 3.0 * math.pi * x * y * z, np.array([y * y + z * z, x * x + z * z, x * x + y * y]) / 5.0
    r, h = size[:2]
    cylinder = 2.0 * math.pi * r * r * h
    across, along = r * r / 4.0 + h * h / 3.0, r * r / 2.0
    if kind == "cylinder":
        return cylinder, np.array([across, across, along])
    # Two hemispheres at the ends, with centres of mass 3/8 r beyond them.
    ball = 4.0 / 3.0 * math.pi * r**3
    of_ball = 2.0 / 5.0 * r * r
    whole = cylinder + ball
    total_across = cylinder * across + ball * (of_ball + h * h + 0.75 * r * h)
    return whole, np.array([total_across, total_across, cylinder * along + ball * of_ball]) / whole


def direction_of(vector: Array) -> Array:
    """Return the direction of a vector: that of z for one without length."""
    length = float(np.linalg.norm(vector))
    return np.asarray(vector / length) if length > 0.0 else np.array([0.0, 0.0, 1.0])


def along(z: Array) -> Array:
    """Return a rotation (3, 3) that maps z to a unit vector."""
    across = np.array([-z[1], z[0], 0.0])
    size = float(np.linalg.norm(across))
    axis = across / size if size > 0.0 else np.array([1.0, 0.0, 0.0])
    return turn(axis, math.atan2(size, float(z[2])))
