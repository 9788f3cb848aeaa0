"""Rounded right angles: snapped, warned about or refused, and never a base parameter without a word."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import RobotWarning
from didim.robot.robot_text import robot_text
from didim.robot.urdf.snap import CUBE, snap_chain
from robots import random_motion
from urdfs import random_urdf

DOWN = np.array([0.0, 0.0, -1.0])


def test_the_cube_has_its_rotations() -> None:
    assert CUBE.shape == (24, 3, 3)
    np.testing.assert_array_equal(CUBE @ np.swapaxes(CUBE, 1, 2), np.broadcast_to(np.eye(3), CUBE.shape))
    assert len({tuple(rotation.ravel()) for rotation in CUBE}) == 24


UR = [(0.0, 0, 0, 0.16), (math.pi / 2, 0, 0, 0), (0.0, -0.6, 0, 0), (0.0, -0.57, 0, 0.17), (math.pi / 2, 0, 0, 0.12),
      (-math.pi / 2, 0, 0, 0.1)]  # fmt: skip
"""An arm like a UR: axes 2, 3 and 4 are parallel."""


def ur_urdf(angle_text: str = repr(math.pi / 2), turn: float = 0.0, seed: int = 0) -> str:
    """Describe it, right angles written as a text, each origin turned by an angle about a random axis."""
    rng = np.random.default_rng(seed)
    parts = ['<link name="base"/>']
    for j, (alpha, d, _, r) in enumerate(UR):
        body = '<inertial><mass value="2"/><inertia ixx="0.01" iyy="0.02" izz="0.015"/></inertial>'
        parts.append(f'<link name="l{j}">{body}</link>')
        roll = {0.0: "0", math.pi / 2: angle_text, -math.pi / 2: f"-{angle_text}"}[alpha]
        tilt = rng.uniform(-1.0, 1.0, 2) * turn
        rpy = f"{float(roll) + tilt[0]!r} {float(tilt[1])!r} 0" if turn else f"{roll} 0 0"
        xyz = f"{d} {-r * math.sin(alpha)!r} {r * math.cos(alpha)!r}"
        parent = f"l{j - 1}" if j else "base"
        parts.append(
            f'<joint name="j{j}" type="revolute"><parent link="{parent}"/><child link="l{j}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/></joint>'
        )
    return f'<robot name="ur">{"".join(parts)}</robot>'.replace("np.float64(", "").replace(") ", " ")


def load(tmp_path: Path, text: str, **options: float) -> didim.Robot:
    path = tmp_path / "ur.urdf"
    path.write_text(text)
    return didim.load_robot(path, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "digits", ["1.5708", "1.570796", "1.570796327", "1.57079632679", "1.5707963267948966"]
)
def test_rounded_digits_add_no_base_parameter(tmp_path: Path, digits: str) -> None:
    robot = load(tmp_path, ur_urdf(digits))
    assert len(robot.base_parameters.names) == 58
    away = abs(float(digits) - math.pi / 2)
    assert len(robot.notes) == (away > 1e-9)
    if robot.notes:
        assert re.match(
            r"right angles of j1, j4, j5 were rounded and are snapped, by \d\.\de-0\d rad", robot.notes[0]
        )
        largest = float(re.search(r"torques change by (\S+) of", robot.notes[0]).group(1))  # type: ignore[union-attr]
        assert largest < 30.0 * away


def test_few_digits_are_warned_about(tmp_path: Path) -> None:
    with pytest.warns(
        RobotWarning, match=r"axes of j1, j4, j5 are up to 8\.0e-04 rad from right angles, .*--snap 0\.002"
    ):
        robot = load(tmp_path, ur_urdf("1.57"))
    assert len(robot.base_parameters.names) > 58
    assert len(load(tmp_path, ur_urdf("1.57"), snap=2e-3).base_parameters.names) == 58


@pytest.mark.parametrize(("turn", "cure"), [(1e-3, 0.002), (8e-3, 0.02)])
def test_calibrated_axes_are_warned_about_or_snapped(tmp_path: Path, turn: float, cure: float) -> None:
    text = ur_urdf(turn=turn)
    with pytest.warns(RobotWarning) as warned:
        exact = load(tmp_path, text)
    assert re.fullmatch(
        rf"ur\.urdf: the axes of j\d and j\d are \d\.\de-0\d rad from parallel, adding weak base parameters; write --snap {cure:g}",
        str(warned[0].message),
    )
    # Their placements are taken as they are: no length is larger than in the file.
    assert max(abs(length) for mount in exact.geometry.mounts for length in mount.shift) < 1.0
    assert len(exact.base_parameters.names) > 58
    robot = load(tmp_path, text, snap=cure)
    assert len(robot.base_parameters.names) == 58
    assert max(map(abs, (*robot.geometry.d, *robot.geometry.r))) < 1.0


def test_a_slightly_calibrated_file_is_snapped(tmp_path: Path) -> None:
    assert len(load(tmp_path, ur_urdf(turn=2e-5)).base_parameters.names) == 58


def test_a_rounded_twist_beside_another_angle() -> None:
    """No rotation of a cube, and the axes are at a right angle all the same."""
    from didim.robot.rigid_body import pose, rotation_of

    origins = [pose(np.eye(3)), pose(rotation_of((0.0, 0.0, 0.7)) @ rotation_of((1.5708, 0.0, 0.3)))]
    axes = [np.array([0.0, 0.0, 1.0])] * 2
    snapped = snap_chain(origins, axes, DOWN, 1e-4)
    assert snapped.joints == (1,)
    assert abs(snapped.origins[1][2, 2]) < 1e-15
    assert snapped.largest == pytest.approx(3.67e-6, rel=1e-3)
    assert not snap_chain(origins, axes, DOWN, 0.0).joints


def test_snapping_leaves_other_angles_alone(tmp_path: Path) -> None:
    for seed in range(5):
        path = tmp_path / "chain.urdf"
        path.write_text(random_urdf(np.random.default_rng(seed), 6)[0])
        plain, snapped = didim.load_robot(path, snap=0.0), didim.load_robot(path)
        motion = random_motion(np.random.default_rng(seed), 10, 6)
        a, b = (
            didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, robot.parameter_set("urdf"))
            for robot in (plain, snapped)
        )
        assert np.abs(a - b).max() < 1e-9 * np.abs(a).max()


TOML = """
schema = 1
name = "ur"
gravity_m_s2 = [0, 0, -9.81]
"""


def toml(angle: str, prismatic: bool = False) -> str:
    text = TOML
    for j, (alpha, d, _, r) in enumerate(UR):
        twist = {0.0: "0", math.pi / 2: angle, -math.pi / 2: f"-{angle}"}[alpha]
        kind = "prismatic" if prismatic and j == 2 else "revolute"
        text += f'[[joint]]\nkind = "{kind}"\nalpha_rad = {twist}\nd_m = {d}\nr_m = {r}\n'
    return text


@pytest.mark.parametrize("digits", ["1.5708", "1.570796327", "1.5707963267948966"])
def test_robot_files_are_snapped_too(tmp_path: Path, digits: str) -> None:
    path = tmp_path / "ur.toml"
    path.write_text(toml(digits))
    robot = didim.load_robot(path)
    assert len(robot.base_parameters.names) == 58
    expected = "ur.toml: rounded right angles were snapped, by 3.7e-06 rad at most"
    assert robot.notes == ((expected,) if digits == "1.5708" else ()) or digits == "1.570796327"
    assert bool(robot.notes) == (len(digits) < 15)


def test_a_robot_file_with_few_digits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "ur.toml"
    path.write_text(toml("1.57"))
    with pytest.warns(RobotWarning, match=r"ur\.toml: angles are up to 8\.0e-04 rad from right angles"):
        didim.load_robot(path)
    assert len(didim.load_robot(path, snap=2e-3).base_parameters.names) == 58
    assert main(["base", str(path)]) == 0
    assert capsys.readouterr().err.startswith("didim: warning: ur.toml: angles are up to")
    (tmp_path / "ur.urdf").write_text(ur_urdf("1.57"))
    for command in ("robot", "base"):
        assert main([command, str(tmp_path / "ur.urdf")]) == 0
        assert capsys.readouterr().err.startswith("didim: warning: ur.urdf: the axes of j1, j4, j5 are up to")
    assert main(["robot", str(tmp_path / "ur.urdf"), "--snap", "2e-3"]) == 0
    assert "warning" not in capsys.readouterr().err


def test_the_zero_of_a_revolute_joint_is_not_snapped(tmp_path: Path) -> None:
    """Its offset has no say in the base parameters; that of a prismatic joint has."""
    path = tmp_path / "arm.toml"
    for kind, expected in (("revolute", 1.5708), ("prismatic", math.pi / 2)):
        path.write_text(f'schema = 1\n[[joint]]\nkind = "{kind}"\ntheta_rad = 1.5708\n')
        assert didim.load_robot(path).geometry.theta == (expected,)


def test_right_angles_of_every_kind() -> None:
    from didim.robot.right_angles import RightAngles

    for quarter, off in itertools.product(range(-4, 5), (0.0, 3e-5, -3e-5)):
        angles = RightAngles(1e-4)
        assert angles.snapped(quarter * math.pi / 2 + off) == quarter * math.pi / 2
        assert angles.largest == pytest.approx(abs(off), abs=1e-12)
        assert not angles.suspicious


def test_angles_that_were_kept_are_kept_by_the_robot_file(tmp_path: Path) -> None:
    """What `--snap 0` left as it was, reading its robot file does not change; `snap` overrules the file."""
    (tmp_path / "ur.urdf").write_text(ur_urdf("1.57079"))
    arguments = ["robot", str(tmp_path / "ur.urdf"), "--snap", "0", "-o", str(tmp_path / "kept.toml")]
    assert main(arguments) == 0
    robot, read = load(tmp_path, ur_urdf("1.57079"), snap=0.0), didim.load_robot(tmp_path / "kept.toml")
    assert read.geometry == robot.geometry
    assert read.base_parameters.names == robot.base_parameters.names
    assert len(read.base_parameters.names) > 58
    assert read.notes == ()
    assert len(didim.load_robot(tmp_path / "kept.toml", snap=1e-4).base_parameters.names) == 58
    assert "snap_rad = 0.0" in (tmp_path / "kept.toml").read_text()


@pytest.mark.parametrize("kind", ["mdh", "dh"])
def test_the_text_of_a_robot_file_with_kept_angles_reads_back(tmp_path: Path, kind: str) -> None:
    row = "d_m = 0.1" if kind == "mdh" else "a_m = 0.1\nd_m = 0.0"
    text = f'schema = 1\nconvention = "{kind}"\nsnap_rad = 0\n[[joint]]\nkind = "revolute"\nalpha_rad = 1.5708\n{row}\n'
    (tmp_path / "arm.toml").write_text(text)
    robot = didim.load_robot(tmp_path / "arm.toml")
    (tmp_path / "again.toml").write_text(robot_text(robot))
    again = didim.load_robot(tmp_path / "again.toml")
    assert again.geometry == robot.geometry
    alpha = robot.geometry.alpha[0] if robot.standard is None else robot.standard.alpha[0]
    assert alpha == 1.5708
