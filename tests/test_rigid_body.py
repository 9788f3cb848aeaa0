"""Poses and pseudo-inertias against point masses and Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from didim.robot.rigid_body import (
    body_pseudo_inertia,
    central,
    inverse,
    mdh_pose,
    pose,
    pseudo_inertia,
    quaternion,
    roll_pitch_yaw,
    rotation_of,
    ten_parameters,
    turn,
    why_no_body,
)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def test_rotations_are_pinocchios(rng: np.random.Generator) -> None:
    for angles in rng.uniform(-3.1, 3.1, (50, 3)):
        expected = pin.rpy.rpyToMatrix(angles)
        np.testing.assert_allclose(rotation_of(tuple(angles)), expected, atol=1e-14)
        np.testing.assert_allclose(rotation_of(roll_pitch_yaw(expected)), expected, atol=1e-14)
        w, x, y, z = quaternion(expected)
        np.testing.assert_allclose(pin.Quaternion(w, x, y, z).matrix(), expected, atol=1e-14)
        axis = angles / np.linalg.norm(angles)
        np.testing.assert_allclose(turn(axis, 0.7), pin.exp3(0.7 * axis), atol=1e-14)


@pytest.mark.parametrize("angles", [(0.3, np.pi / 2, 0.2), (-0.4, -np.pi / 2, 1.0), (np.pi, 0.0, np.pi)])
def test_angles_of_special_rotations(angles: tuple[float, float, float]) -> None:
    rotation = rotation_of(angles)
    np.testing.assert_allclose(rotation_of(roll_pitch_yaw(rotation)), rotation, atol=1e-9)
    w, x, y, z = quaternion(rotation)
    assert w >= 0.0
    np.testing.assert_allclose(pin.Quaternion(w, x, y, z).matrix(), rotation, atol=1e-14)


def test_the_step_of_a_table(rng: np.random.Generator) -> None:
    alpha, d, theta, r = rng.uniform(-2.0, 2.0, 4)
    x, z = np.eye(3)[0], np.eye(3)[2]
    expected = (
        pose(turn(x, alpha)) @ pose(np.eye(3), (d, 0, 0)) @ pose(turn(z, theta)) @ pose(np.eye(3), (0, 0, r))
    )
    np.testing.assert_allclose(mdh_pose(alpha, d, theta, r), expected, atol=1e-15)
    np.testing.assert_allclose(inverse(expected) @ expected, np.eye(4), atol=1e-15)
    right = mdh_pose(np.pi / 2, 0.0, -np.pi / 2, 0.0)
    assert set(np.abs(right).ravel()) == {0.0, 1.0}


def test_a_pseudo_inertia_is_that_of_its_points(rng: np.random.Generator) -> None:
    mass, places = rng.uniform(0.1, 1.0, 6), rng.uniform(-0.5, 0.5, (6, 3))
    points = np.column_stack([places, np.ones(6)])
    expected = np.einsum("k,ki,kj->ij", mass, points, points)
    ten = ten_parameters(expected)
    np.testing.assert_allclose(pseudo_inertia(ten), expected, atol=1e-15)
    # Moments of inertia as a textbook has them.
    x, y, z = places.T
    np.testing.assert_allclose(ten[0], mass @ (y**2 + z**2))
    np.testing.assert_allclose(ten[1], -mass @ (x * y))
    total, centre, inertia = central(expected)
    np.testing.assert_allclose(total, mass.sum())
    np.testing.assert_allclose(centre, mass @ places / mass.sum())
    frame = pose(np.eye(3), centre)
    np.testing.assert_allclose(body_pseudo_inertia(total, inertia, frame), expected, atol=1e-15)
    # A change of frame moves the points.
    change = pose(rotation_of((0.3, -0.2, 1.1)), (0.1, 0.2, -0.4))
    moved = points @ change.T
    np.testing.assert_allclose(
        change @ expected @ change.T, np.einsum("k,ki,kj->ij", mass, moved, moved), atol=1e-14
    )
    assert why_no_body(expected) is None


def test_what_is_not_a_body() -> None:
    def body(mass: float, *moments: float) -> np.ndarray:
        return body_pseudo_inertia(mass, np.diag(moments), pose(np.eye(3), (0.3, 0.1, 0.2)))

    assert why_no_body(body(1.0, 0.1, 0.1, 0.1)) is None
    assert why_no_body(body(1.0, 0.1, 0.2, 0.3)) is None  # a flat plate
    assert "mass is -1 kg" in (why_no_body(body(-1.0, 0.1, 0.1, 0.1)) or "")
    assert "mass is 0 kg" in (why_no_body(np.zeros((4, 4))) or "")
    assert "triangle inequality (0.31 > 0.1 + 0.2" in (why_no_body(body(1.0, 0.1, 0.2, 0.31)) or "")
    assert "smallest moment of inertia" in (why_no_body(body(1.0, -0.1, 0.2, 0.2)) or "")
