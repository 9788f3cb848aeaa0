"""Included robots: their axes are those of independent descriptions, and the lists name them all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import didim
from didim.cli.main import main
from didim.methods.table import METHODS
from didim.robot.rigid_body import mdh_pose
from didim.robot.robot_file import PACKAGED

Array = NDArray[np.float64]

HALF_TURN_X, HALF_TURN_Z = np.diag([1.0, -1.0, -1.0, 1.0]), np.diag([-1.0, -1.0, 1.0, 1.0])

# Packaged name, description, frame 0 in the base that stands upright, the same for the description, largest difference (m).
ROBOTS = [
    ("ur5e", "urdf/ur5e.urdf", np.eye(4), HALF_TURN_Z, 1e-9),
    ("ur10e", "ur10e/ur10e.urdf", np.eye(4), HALF_TURN_Z, 2e-3),  # that file has rounded lengths of a UR10
    ("panda", "urdf/panda.urdf", np.eye(4), np.eye(4), 1e-9),
    ("fr3", "urdf/panda.urdf", np.eye(4), np.eye(4), 1e-9),
    ("iiwa14", "urdf/iiwa14.urdf", np.eye(4), np.eye(4), 1e-9),
    ("gen3", "urdf/gen3.urdf", HALF_TURN_X, np.eye(4), 1e-3),  # the maker's table leaves out 0.35 mm
    ("kr16", "urdf/kr16.urdf", HALF_TURN_X, np.eye(4), 1e-9),
]


def axes(robot: didim.Robot, base: Array, q: Array) -> Array:
    """Lines of all joint axes in the base: directions, and moments about the origin, (n, 6)."""
    geometry, frame, found = robot.geometry, base, []
    for alpha, d, theta, r, position in zip(
        geometry.alpha, geometry.d, geometry.theta, geometry.r, q, strict=True
    ):
        frame = frame @ mdh_pose(alpha, d, theta + position, r)
        found.append([*frame[:3, 2], *np.cross(frame[:3, 3], frame[:3, 2])])
    return np.array(found)


@pytest.mark.parametrize(("name", "file", "base", "other_base", "largest"), ROBOTS, ids=lambda v: str(v)[:8])
def test_axes_are_those_of_an_independent_description(
    shared: Path, name: str, file: str, base: Array, other_base: Array, largest: float
) -> None:
    """Wherever the joints are: directions and signs, zeros, lengths; and gravity, and base parameters."""
    robot = didim.load_robot(name)
    other = didim.load_robot(shared / "data" / file, snap=2e-3)
    assert other.correspondence is not None
    for q in np.random.default_rng(0).uniform(-3.0, 3.0, (20, robot.n_dof)):
        ours = axes(robot, base, q)
        theirs = axes(other, other_base @ other.correspondence.base_matrix, q)
        np.testing.assert_allclose(ours[:, :3], theirs[:, :3], atol=1e-6)
        assert np.abs(ours - theirs).max() < largest + 1e-9
    down = base[:3, :3] @ np.array(robot.geometry.gravity)
    np.testing.assert_allclose(down, [0.0, 0.0, -9.81], atol=1e-12)
    assert len(robot.base_parameters.names) == len(other.base_parameters.names)


# Joint by joint: translation x, y, z (m) and roll, pitch, yaw (rad) of Universal_Robots_ROS2_Description, default_kinematics.yaml.
RIGHT, HALF = np.pi / 2.0, np.pi
UR_CHAINS = {
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
}


def ur_chain(d1: float, a2: float, a3: float, d4: float, d5: float, d6: float) -> Array:
    """Rows (x, y, z, roll, pitch, yaw) of the six joints."""
    return np.array(
        [
            [0, 0, d1, 0, 0, 0],
            [0, 0, 0, RIGHT, 0, 0],
            [a2, 0, 0, 0, 0, 0],
            [a3, 0, d4, 0, 0, 0],
            [0, -d5, 0, RIGHT, 0, 0],
            [0, d6, 0, RIGHT, HALF, HALF],
        ]
    )


@pytest.mark.parametrize("name", UR_CHAINS)
def test_axes_are_those_of_the_makers_own_description(name: str) -> None:
    robot = didim.load_robot(name)
    for q in np.random.default_rng(1).uniform(-3.0, 3.0, (5, 6)):
        frame, theirs = np.eye(4), []
        for (x, y, z, *angles), position in zip(ur_chain(*UR_CHAINS[name]), q, strict=True):
            step = np.eye(4)
            step[:3, 3] = x, y, z
            step[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec([0.0, 0.0, position]).as_matrix()
            frame = frame @ step @ turn
            theirs.append([*frame[:3, 2], *np.cross(frame[:3, 3], frame[:3, 2])])
        np.testing.assert_allclose(axes(robot, np.eye(4), q), theirs, atol=1e-9)


# Speeds (deg/s, but for fr3 rad/s) and torques (N.m) of the makers' joint_limits.yaml, which each robot file names.
MAKERS: dict[str, tuple[list[float], list[float]]] = {
    "ur3e": ([180.0] * 3 + [360.0] * 3, [56.0, 56.0, 28.0, 12.0, 12.0, 12.0]),
    "ur5e": ([180.0] * 6, [150.0] * 3 + [28.0] * 3),
    "ur10": ([120.0] * 2 + [180.0] * 4, [330.0, 330.0, 150.0, 56.0, 56.0, 56.0]),
    "ur10e": ([120.0] * 2 + [180.0] * 4, [330.0, 330.0, 150.0, 56.0, 56.0, 56.0]),
    "ur16e": ([120.0] * 2 + [180.0] * 4, [330.0, 330.0, 150.0, 56.0, 56.0, 56.0]),
    "fr3": (np.rad2deg([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26]).tolist(), [87.0] * 4 + [12.0] * 3),
}


@pytest.mark.parametrize("name", MAKERS)
def test_limits_are_those_of_the_maker(name: str) -> None:
    speeds, torques = MAKERS[name]
    limits = didim.load_robot(name).limits
    assert [item.velocity for item in limits] == pytest.approx(np.deg2rad(speeds).tolist(), rel=1e-6)
    assert [item.effort for item in limits] == torques


def test_positions_of_the_fr3_are_those_of_the_maker() -> None:
    upper = [2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159]
    lower = [-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159]
    assert [item.position for item in didim.load_robot("fr3").limits] == list(zip(lower, upper, strict=True))


@pytest.mark.parametrize("name", ["panda", "iiwa14", "kr16", "ur5e", "gen3"])
def test_limits_are_those_of_the_description(shared: Path, name: str) -> None:
    """Those of the data sheets; a URDF may be stricter about positions (an elbow of half a turn, for planners)."""
    robot, other = didim.load_robot(name), didim.load_robot(shared / "data" / "urdf" / f"{name}.urdf")
    for mine, theirs in zip(robot.limits, other.limits, strict=True):
        assert (mine.position is None) == (theirs.position is None)
        if mine.position is not None and theirs.position is not None:
            assert mine.position[0] <= theirs.position[0] + 1e-5
            assert mine.position[1] >= theirs.position[1] - 1e-5
        assert mine.velocity == pytest.approx(theirs.velocity, rel=1e-4)
        if mine.effort is not None:
            assert mine.effort == theirs.effort


def test_every_packaged_robot_names_its_source() -> None:
    for path in PACKAGED.glob("ur*.toml"):
        head = path.read_text(encoding="utf-8").split("schema")[0]
        assert "Lengths: Universal Robots" in head
        assert f"config/{path.stem}/joint_limits.yaml" in head
    for name in ("panda", "fr3", "iiwa14", "gen3", "kr16"):
        assert "Lengths and limits: " in (PACKAGED / f"{name}.toml").read_text(encoding="utf-8")


def test_the_lists(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    for path in PACKAGED.glob("*.toml"):
        robot = didim.load_robot(path.stem)
        assert rows[path.stem].split()[1:3] == [str(robot.n_dof), str(len(robot.base_parameters.names))]
    assert main(["methods"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    for name in METHODS:
        assert len(rows[name]) > 40
