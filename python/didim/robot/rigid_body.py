"""Poses of frames, and the inertia of a rigid body as one symmetric matrix.

The pseudo-inertia of a body, seen from a frame, is the 4 x 4 matrix of its second, first and zeroth moments of mass,

    J = [[S, h], [h', m]],    S = integral of r r' dm,    h = m c,    I = tr(S) 1 - S.

A change of frame is a congruence, ``J' = T J T'`` with the homogeneous matrix ``T``, and the pseudo-inertias of bodies that
move together add up. A body with volume has a positive definite ``J``. Tested in ``tests/test_rigid_body.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .._tools.arrays import Array

INERTIAL = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
"""Names of the ten inertial parameters of a link, in the order of the standard parameters."""


EXACT = 1e-12
"""Bound of cosines and sines that count as zero, that is as right angles, as in the core."""
BODY_TOLERANCE = 1e-12
"""Largest negative eigenvalue of the central second moments that rounding explains, as a share of their trace."""


def pose(rotation: Array, position: Array | Sequence[float] = (0.0, 0.0, 0.0)) -> Array:
    """Return the homogeneous matrix of a rotation (3, 3) and a position (3,), m."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return matrix


def inverse(matrix: Array) -> Array:
    """Return the inverse of a homogeneous matrix, exact up to rounding."""
    rotation = matrix[:3, :3].T
    return pose(rotation, -rotation @ matrix[:3, 3])


def skew(vector: Array | Sequence[float]) -> Array:
    """Return the matrix of a cross product: ``skew(a) b = a x b``."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def turn(axis: Array, angle: float) -> Array:
    """Return the rotation by an angle (rad) about a unit axis (Rodrigues)."""
    cross = skew(axis)
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)


def angle_of(rotation: Array) -> float:
    """Return the angle (rad) of a rotation, 0 to pi; the inverse of `turn`."""
    return math.acos(max(-1.0, min(1.0, 0.5 * (float(np.trace(rotation)) - 1.0))))


def rotation_of(roll_pitch_yaw: Sequence[float]) -> Array:
    """Return the rotation of fixed-axis roll, pitch and yaw (rad): ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    (cr, cp, cy), (sr, sp, sy) = (
        [function(angle) for angle in roll_pitch_yaw] for function in (math.cos, math.sin)
    )
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def roll_pitch_yaw(rotation: Array) -> tuple[float, float, float]:
    """Return fixed-axis roll, pitch and yaw (rad) of a rotation; the inverse of `rotation_of`."""
    level = math.hypot(rotation[0, 0], rotation[1, 0])
    pitch = math.atan2(-rotation[2, 0], level)
    if level < 1e-9:  # gimbal lock: only yaw minus or plus roll is defined
        return 0.0, pitch, math.atan2(-rotation[0, 1], rotation[1, 1])
    return (math.atan2(rotation[2, 1], rotation[2, 2]), pitch, math.atan2(rotation[1, 0], rotation[0, 0]))


def quaternion(rotation: Array) -> Array:
    """Return the unit quaternion ``(w, x, y, z)``, ``w >= 0``, of a rotation.

    The largest of the four components is computed from the diagonal and divides the others, so no digits cancel.
    """
    r = rotation
    squares = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) @ np.diag(r) + 1.0
    lines = np.array(
        [
            [squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], squares[1], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], squares[2], r[2, 1] + r[1, 2]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], squares[3]],
        ]
    )
    line = lines[int(np.argmax(squares))]
    axis = line / np.linalg.norm(line)
    return np.asarray(-axis if axis[0] < 0.0 else axis)


def _cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine, exact for multiples of a right angle."""
    cosine, sine = math.cos(angle), math.sin(angle)
    if abs(cosine) < EXACT:
        return 0.0, math.copysign(1.0, sine)
    if abs(sine) < EXACT:
        return math.copysign(1.0, cosine), 0.0
    return cosine, sine


def mdh_pose(alpha: float, d: float, theta: float, r: float) -> Array:
    """Return the pose of frame j in frame j-1: ``Rot(x, alpha) Trans(x, d) Rot(z, theta) Trans(z, r)`` (rad, m)."""
    (ca, sa), (ct, st) = _cos_sin(alpha), _cos_sin(theta)
    rotation = np.array([[ct, -st, 0.0], [ca * st, ca * ct, -sa], [sa * st, sa * ct, ca]])
    return pose(rotation, (d, -r * sa, r * ca))


def pseudo_inertia(ten: Array) -> Array:
    """Return the pseudo-inertia (4, 4) of ten inertial parameters ``XX XY XZ YY YZ ZZ MX MY MZ M`` of one frame."""
    xx, xy, xz, yy, yz, zz, *moments, mass = ten
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    matrix = np.empty((4, 4))
    matrix[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    matrix[:3, 3] = matrix[3, :3] = moments
    matrix[3, 3] = mass
    return matrix


def ten_parameters(pseudo: Array) -> Array:
    """Return the ten inertial parameters (10,) of a pseudo-inertia; the inverse of `pseudo_inertia`."""
    second = pseudo[:3, :3]
    inertia = np.trace(second) * np.eye(3) - second
    return np.array([*inertia[np.triu_indices(3)], *pseudo[:3, 3], pseudo[3, 3]])


def moved(ten: Array, frame: Array) -> Array:
    """Return ten inertial parameters in another frame, where `frame`, (4, 4), is the pose of their present frame."""
    return ten_parameters(frame @ pseudo_inertia(ten) @ frame.T)


def body_pseudo_inertia(mass: float, inertia: Array, frame: Array) -> Array:
    """Return the pseudo-inertia of a body from its inertia about its centre of mass.

    Parameters
    ----------
    mass : float
        Mass (kg).
    inertia : (3, 3) array
        Inertia about the centre of mass (kg.m^2), in a frame at the centre.
    frame : (4, 4) array
        Pose of that frame in the frame of the result.
    """
    central = np.zeros((4, 4))
    central[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    central[3, 3] = mass
    return np.asarray(frame @ central @ frame.T)


def central(pseudo: Array) -> tuple[float, Array, Array]:
    """Return mass (kg), centre (3,) (m) and inertia about the centre (3, 3) (kg.m^2); the mass must not be zero."""
    mass = float(pseudo[3, 3])
    centre = pseudo[:3, 3] / mass
    second = pseudo[:3, :3] - mass * np.outer(centre, centre)
    second = 0.5 * (second + second.T)
    return mass, centre, np.trace(second) * np.eye(3) - second


def why_no_body(pseudo: Array) -> str | None:
    """Return why no body has a pseudo-inertia, as the end of a sentence, or None if one has.

    Its mass must be positive, and the second moments about its centre must not be negative in any direction (the triangle
    inequalities of the principal moments of inertia).
    """
    mass = float(pseudo[3, 3])
    if not mass > 0.0:
        return f"its mass is {mass:.4g} kg"
    _, _, inertia = central(pseudo)
    moments = np.linalg.eigvalsh(inertia)
    if not moments[0] > 0.0:
        return f"its smallest moment of inertia about the centre of mass is {moments[0]:.4g} kg.m^2"
    excess = moments[2] - moments[0] - moments[1]
    if excess > BODY_TOLERANCE * moments.sum():
        return (
            "its moments of inertia break the triangle inequality "
            f"({moments[2]:.4g} > {moments[0]:.4g} + {moments[1]:.4g} kg.m^2)"
        )
    return None
