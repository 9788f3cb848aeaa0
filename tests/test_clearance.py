"""Capsules: distances against an independent geometry (coal, through Pinocchio) and brute force, gradients, pairs, files."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pytest

import didim
from didim.errors import RobotError
from didim.excitation.clearance import Clearance, Workspace
from didim.model.kinematics import frames
from didim.robot.collision import Capsule, checked_pairs
from didim.robot.placement import in_line
from didim.robot.robot import Robot
from didim.robot.robot_text import robot_text


def random_capsules(rng: np.random.Generator, n_dof: int) -> list[Capsule]:
    """Two for each link, the base too; some are spheres."""
    found = []
    for link in range(n_dof + 1):
        for k in range(2):
            start, end = rng.uniform(-0.3, 0.3, (2, 3))
            if k and link % 2:
                end = start
            found.append(
                Capsule(link=link, start=tuple(start), end=tuple(end), radius=float(rng.uniform(0.01, 0.1)))
            )
    return found


@pytest.fixture(scope="module")
def tx40() -> Robot:
    return didim.load_robot("tx40")


def by_coal(robot: Robot, q: np.ndarray, one: Capsule, other: Capsule) -> float:
    """Distance of two capsules by the collision library of Pinocchio."""
    poses = frames(robot, q[None])[0]
    shapes, places = [], []
    for capsule in (one, other):
        start, end = np.array(capsule.start), np.array(capsule.end)
        length = float(np.linalg.norm(end - start))
        z = (end - start) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        side = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
        x = side / np.linalg.norm(side)
        rotation = np.column_stack([x, np.cross(z, x), z])
        pose = poses[capsule.link]
        shapes.append(coal.Capsule(capsule.radius, length) if length > 0.0 else coal.Sphere(capsule.radius))
        places.append(
            coal.Transform3s(pose[:3, :3] @ rotation, pose[:3, :3] @ ((start + end) / 2.0) + pose[:3, 3])
        )
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return float(coal.distance(shapes[0], places[0], shapes[1], places[1], request, result))


def test_distances_are_those_of_pinocchios_geometry(tx40: Robot) -> None:
    rng = np.random.default_rng(0)
    capsules = random_capsules(rng, 6)
    clearance = Clearance(tx40, capsules, Workspace())
    q = rng.uniform(-2.0, 2.0, (20, 6))
    found = clearance.distances(q)
    assert found.shape == (20, len(clearance.pairs))
    for sample in range(len(q)):
        for column, (i, j) in enumerate(clearance.pairs):
            want = by_coal(tx40, q[sample], capsules[i], capsules[j])
            # Capsules that overlap have a depth there that counts other directions too.
            if want > 1e-3:
                assert found[sample, column] == pytest.approx(want, abs=1e-6)
            else:
                assert found[sample, column] < 2e-3


def test_parallel_and_degenerate_segments_have_the_distance_of_their_points(tx40: Robot) -> None:
    still = np.zeros((1, 6))
    cases = [
        (((0, 0, 0), (1, 0, 0)), ((0.2, 0.3, 0), (0.7, 0.3, 0)), 0.3),
        (((0, 0, 0), (1, 0, 0)), ((2, 0, 0), (3, 0, 0)), 1.0),
        (((0, 0, 0), (1, 0, 0)), ((1.5, 1, 0), (1.5, -1, 0)), 0.5),
        (((0, 0, 0), (0, 0, 0)), ((-1, 0.4, 0), (1, 0.4, 0)), 0.4),
        (((-1, 0.4, 0), (1, 0.4, 0)), ((0, 0, 0), (0, 0, 0)), 0.4),
        (((0, 0, 0), (0, 0, 0)), ((0.3, 0, 0.4), (0.3, 0, 0.4)), 0.5),
    ]
    pose = frames(tx40, still)[0, 2]
    for first, second, want in cases:
        # The second in frame 2, placed so that frame 0 sees it where the case says.
        ends = [tuple(pose[:3, :3].T @ (np.array(end, float) - pose[:3, 3])) for end in second]
        capsules = [
            Capsule(link=0, start=first[0], end=first[1], radius=0.05),
            Capsule(link=2, start=ends[0], end=ends[1], radius=0.02),
        ]
        found = Clearance(tx40, capsules, Workspace(clearance=0.01)).distances(still)
        assert found[0, 0] == pytest.approx(want - 0.08, abs=1e-9)


def test_the_gradient_of_the_penalty_is_its_difference(tx40: Robot) -> None:
    rng = np.random.default_rng(1)
    capsules = random_capsules(rng, 6)
    workspace = Workspace(lowest=(-0.3, -0.4, -0.5), highest=(0.4, 0.3, 0.3), floor=-0.2, clearance=0.05)
    for clearance in (Clearance(tx40, capsules, workspace), Clearance(tx40, (), workspace)):
        q, change = rng.uniform(-2.0, 2.0, (2, 15, 6))
        value, gradient = clearance.penalty(q, 0.1)
        assert value > 0.0
        sides = [clearance.penalty(q + sign * 1e-6 * change, 0.1)[0] for sign in (1.0, -1.0)]
        assert float((gradient * change).sum()) == pytest.approx((sides[0] - sides[1]) / 2e-6, rel=1e-5)


def test_prismatic_joints_move_capsules_too(project: Path) -> None:
    emps = didim.load_robot("emps")
    clearance = Clearance(emps, (), Workspace(lowest=(-0.01, -0.01, -0.1), highest=(0.01, 0.01, 0.1)))
    q = np.array([[0.0], [0.3]])
    value, gradient = clearance.penalty(q, 0.1)
    assert value > 0.0
    sides = [clearance.penalty(q + h, 0.1)[0] for h in (1e-6, -1e-6)]
    assert float(gradient.sum()) == pytest.approx((sides[0] - sides[1]) / 2e-6, rel=1e-5)


def test_neighbours_are_not_checked_and_walls_are_named(tx40: Robot) -> None:
    at = (0.0, 0.0, 0.0)
    capsules = [Capsule(link=link, start=at, end=at, radius=0.1) for link in (0, 1, 2, 3)]
    assert checked_pairs(capsules, in_line(4)).tolist() == [[0, 2], [0, 3], [1, 3]]
    clearance = Clearance(tx40, capsules, Workspace(floor=-1.0, highest=(2.0, 2.0, 2.0)))
    names = [clearance.describe(column) for column in range(clearance.distances(np.zeros((1, 6))).shape[1])]
    assert names[0] == "links 0 and 2"
    assert names[3] == "link 1 and the floor"
    assert names[-1] == "link 3 and the wall at z = 2 m"
    with pytest.raises(IndexError):
        clearance.describe(len(names))
    assert Clearance(tx40, (), Workspace()).empty


ARM = """
schema = 1
[[joint]]
kind = "revolute"
[[joint]]
kind = "revolute"
d_m = 0.5
[[collision]]
link = 1
from_m = [0, 0, 0]
to_m = [0.5, 0, 0]
radius_m = 0.04
[[collision]]
link = 2
from_m = [0.1, 0, 0]
to_m = [0.4, 0, 0]
radius_m = 0.03
"""


def test_a_robot_file_has_capsules_and_gives_them_back(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(ARM)
    robot = didim.load_robot(path)
    assert robot.collision[1] == Capsule(link=2, start=(0.1, 0.0, 0.0), end=(0.4, 0.0, 0.0), radius=0.03)
    path.write_text(robot_text(robot))
    assert didim.load_robot(path).collision == robot.collision


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ("link = 3", r"\[collision 2\] link must be at most 2, got 3"),
        ("radius = 1.0\nlink = 2", r"\[collision 2\] unknown key 'radius'; did you mean 'radius_m'"),
    ],
)
def test_wrong_capsules_are_named(tmp_path: Path, wrong: str, sentence: str) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(ARM.replace("link = 2", wrong))
    with pytest.raises(RobotError, match=sentence):
        didim.load_robot(path)
