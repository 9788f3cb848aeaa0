"""Robots from URDFs against Pinocchio: real descriptions, random chains, and the way back through a robot file."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import RobotError
from didim.robot.robot import Robot
from didim.robot.robot_text import robot_text
from didim.robot.urdf.description import read_description
from didim.robot.urdf.reading import read_urdf
from didim.robot.urdf.summation import made_up_bodies, random_states, torques_by_summation
from robots import random_motion
from urdfs import GRIPPER_ARM, inertial_text, pinocchio_model, pinocchio_torques, random_urdf

BASE_PARAMETERS = {
    "gen3": 69,
    "iiwa14": 69,
    "kr16": 58,
    "panda": 69,
    "ur5e": 58,
    "ur5e_undeclared_prefix": 58,
}
"""Base parameters of the real descriptions: those of their structure, whatever digits the files have."""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(GRIPPER_ARM)
    return path


def difference(robot: Robot, text: str, seed: int = 0) -> float:
    """Largest difference to Pinocchio, over the largest torque of the joint."""
    n = robot.n_dof
    motion = random_motion(np.random.default_rng(seed), 20, n)
    model = pinocchio_model(text, robot.joint_names)
    expected = pinocchio_torques(model, robot.joint_names, motion.q, motion.dq, motion.ddq)
    x = robot.parameter_set("urdf").copy()
    x[[name.startswith("F") for name in robot.parameter_names]] = 0.0  # rnea has no friction
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    largest = np.maximum(np.abs(expected).max(axis=0), 1e-6 * np.abs(expected).max())
    return float((np.abs(tau - expected).max(axis=0) / largest).max())


@pytest.mark.parametrize("seed", range(40))
def test_random_chains(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    text, names = random_urdf(rng, int(rng.integers(1, 9)))
    path = tmp_path / "chain.urdf"
    path.write_text(text)
    reading = read_urdf(path, snap=0.0)
    assert reading.robot.joint_names == tuple(names)
    assert difference(reading.robot, text, seed) < 1e-9
    assert reading.exact < 1e-9


@pytest.mark.parametrize("name", BASE_PARAMETERS)
def test_real_descriptions(shared: Path, tmp_path: Path, name: str) -> None:
    path = shared / "data" / "urdf" / f"{name}.urdf"
    exact = read_urdf(path, snap=0.0)
    assert exact.exact < 1e-12
    text = re.sub(r"\b(drake|controller|sensor|interface):", r"\1_", path.read_text())
    if exact.made_up:
        assert name == "panda"
        assert "urdf" not in exact.robot.sets
        assert "no moving link has an inertia" in exact.robot.notes[0]
        rng = np.random.default_rng(0)
        text = re.sub(r'<link name="\w+">', lambda link: link.group() + inertial_text(rng), text)
        copy = tmp_path / "with_inertias.urdf"
        copy.write_text(text)
        exact = read_urdf(copy, snap=0.0)
    assert difference(exact.robot, text) < 1e-9
    snapped = didim.load_robot(path)
    assert len(snapped.base_parameters.names) == BASE_PARAMETERS[name]
    # Only one of the files has digits that add some.
    assert len(exact.robot.base_parameters.names) == BASE_PARAMETERS[name] + 3 * (name == "gen3")


def test_the_ur10e_of_the_recordings(shared: Path) -> None:
    path = shared / "data" / "ur10e" / "ur10e.urdf"
    robot = didim.load_robot(path)
    assert len(robot.base_parameters.names) == 58
    assert difference(robot, path.read_text()) < 1e-9
    assert robot.joint_names[2] == "elbow_joint"
    assert robot.limits[3].effort == 54.0


def test_what_a_robot_has_of_its_description(arm: Path) -> None:
    robot = didim.load_robot(arm)
    assert robot.name == "little_arm"
    assert robot.joint_names == ("shoulder", "elbow", "wrist")
    assert robot.joint_label(1) == "joint 2 (elbow)"
    assert robot.limits[0] == type(robot.limits[0])(position=(-2.0, 2.5), velocity=3.0, effort=80.0)
    assert robot.limits[2].position is None
    values = dict(zip(robot.parameter_names, robot.parameter_set("urdf"), strict=True))
    assert (values["Fv1"], values["Fc1"], values["Fv2"]) == (1.5, 0.75, 0.0)
    assert values["M3"] == pytest.approx(0.8 + 0.3 + 0.1 + 0.1)
    assert robot.digest == hashlib.sha256(arm.read_bytes()).hexdigest()
    places = robot.correspondence
    assert places is not None
    assert places.sha256 == robot.digest
    assert places.links[2].lumped == ("camera",)
    assert places.links[2].locked == ("finger", "other_finger")
    assert "locked at 0: finger_joint, other_finger_joint" in robot.notes[0]


def test_gravity_follows_the_base(arm: Path) -> None:
    upright, wall = (didim.load_robot(arm, gravity=g) for g in (None, (9.81, 0.0, 0.0)))
    np.testing.assert_allclose(upright.geometry.gravity, (0.0, 9.81, 0.0))
    np.testing.assert_allclose(np.abs(wall.geometry.gravity), (9.81, 0.0, 0.0))
    turned = GRIPPER_ARM.replace('xyz="0 0 0.5" rpy="0 0 0"', 'xyz="0 0 0.5" rpy="0 1.5707963267948966 0"')
    arm.write_text(turned)
    np.testing.assert_allclose(didim.load_robot(arm, base="base").geometry.gravity, (9.81, 0.0, 0.0))
    with pytest.raises(RobotError, match="gravity must be three finite numbers"):
        didim.load_robot(arm, gravity=(0.0, 1.0))


def test_the_self_test_sees_a_wrong_frame(arm: Path) -> None:
    """Direct summation, moved by a millimetre, differs by what a millimetre does."""
    reading = read_urdf(arm)
    states = random_states(3)
    links = made_up_bodies(3)
    origins = [np.eye(4) for _ in range(3)]
    axes = [np.array([0.0, 1.0, 0.0])] * 3
    gravity = np.array([0.0, 0.0, -9.81])
    right = torques_by_summation(["revolute"] * 3, origins, axes, links, gravity, states)
    origins[1][0, 3] = 1e-3
    wrong = torques_by_summation(["revolute"] * 3, origins, axes, links, gravity, states)
    assert np.abs(right - wrong).max() > 1e-3
    assert reading.exact < 1e-12
    assert 1e-7 < reading.as_written < 1e-4  # 1.5708 for a right angle


def test_the_summation_is_pinocchios() -> None:
    """The proof itself against another engine, with the numbers of the file."""
    from didim.robot.urdf.chain import choose_chain

    text, names = random_urdf(np.random.default_rng(5), 6)
    description = read_description(text.encode(), "chain.urdf")
    chain = choose_chain(description)
    states = random_states(6)
    tau = torques_by_summation(
        [joint.kind for joint in chain.joints],
        chain.origins,
        chain.axes,
        chain.groups,
        np.array([0.0, 0.0, -9.81]),
        states,
    )
    expected = pinocchio_torques(pinocchio_model(text, names), names, states.q, states.dq, states.ddq)
    assert np.abs(tau - expected).max() < 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize("seed", range(6))
def test_a_robot_file_is_the_same_robot(tmp_path: Path, seed: int) -> None:
    urdf, toml = tmp_path / "arm.urdf", tmp_path / "arm.toml"
    rng = np.random.default_rng(seed)
    urdf.write_text(random_urdf(rng, 5)[0] if seed else GRIPPER_ARM)
    robot = didim.load_robot(urdf)
    toml.write_text(robot_text(robot))
    again = didim.load_robot(toml)
    assert again.geometry == robot.geometry
    assert again.limits == robot.limits
    assert again.friction == robot.friction
    assert again.joint_names == robot.joint_names
    assert again.correspondence == robot.correspondence
    assert (again.parameter_set("urdf") == robot.parameter_set("urdf")).all()
    assert not again.notes
    assert (
        robot_text(again)
        == "\n".join(
            line for line in robot_text(robot).splitlines() if not line.startswith("# ") or "export" in line
        )
        + "\n"
    )


@pytest.mark.parametrize("name", ["tx40", "emps", "planar2"])
def test_packaged_robots_as_text(tmp_path: Path, name: str) -> None:
    robot = didim.load_robot(name)
    path = tmp_path / "robot.toml"
    path.write_text(robot_text(robot.with_friction(coulomb="tanh", smoothing_rad_s=0.01, smoothing_m_s=0.02)))
    again = didim.load_robot(path)
    assert again.geometry.coupling == robot.geometry.coupling
    np.testing.assert_allclose(again.geometry.alpha, robot.geometry.alpha)
    assert again.friction.smoothing in ((0.01,) * robot.n_dof, (0.02,))
    if robot.reduction is not None:
        np.testing.assert_array_equal(again.reduction, robot.reduction)
    for key, values in robot.sets.items():
        np.testing.assert_array_equal(again.sets[key], values)


def test_further_friction_as_text(tmp_path: Path) -> None:
    robot = didim.load_robot("tx40").with_friction(
        stribeck=[1, 3], stribeck_velocity_rad_s=0.05, atan=True, load=[6], terms="auto"
    )
    path = tmp_path / "robot.toml"
    path.write_text(robot_text(robot))
    assert didim.load_robot(path).friction == robot.friction


def test_links_without_inertia(arm: Path) -> None:
    text = GRIPPER_ARM
    start = text.index("<inertial>", text.index('<link name="forearm">'))
    end = text.index("</inertial>", start) + len("</inertial>")
    arm.write_text(text[:start] + text[end:])
    robot = didim.load_robot(arm)
    assert "moving links without a positive mass: forearm" in robot.notes
    values = dict(zip(robot.parameter_names, robot.parameter_set("urdf"), strict=True))
    assert values["M2"] == 0.0
    assert values["M3"] > 1.0
    arm.write_text(re.sub(r'<mass value="[^"]*"', '<mass value="-1"', text))
    note = "no moving link has an inertia, so there is no parameter set 'urdf'"
    assert any(note in text for text in didim.load_robot(arm).notes)


def test_a_link_of_the_file_that_is_not_a_body(arm: Path) -> None:
    arm.write_text(GRIPPER_ARM.replace('izz="0.01"', 'izz="0.2"'))
    note = next(note for note in didim.load_robot(arm).notes if "not a body" in note)
    assert note.startswith(
        "link upper_arm of the file is not a body: its moments of inertia break the triangle inequality"
    )


def test_the_command(arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    toml = tmp_path / "arm.toml"
    assert main(["robot", str(arm), "-o", str(toml)]) == 0
    out, err = capsys.readouterr()
    assert "little_arm: 3 joints from world to hand, 23 base parameters" in out
    assert "hand + camera + finger + other_finger" in out
    assert (
        "Self-test, 50 random states, the inertias of the file: torques differ from direct summation" in out
    )
    assert [line[:12] for line in err.splitlines()] == ["didim: note:"] * 2
    assert main(["base", str(toml)]) == 0
    assert capsys.readouterr().out.startswith("little_arm: 23 base parameters")
    assert main(["base", str(arm)]) == 0
    assert "didim: note: " in capsys.readouterr().err
    assert main(["robot", str(arm), "-o", str(toml)]) == 2
    assert "the file is there already; --force overwrites it" in capsys.readouterr().err
    options = [
        "--lock",
        "wrist=0.3",
        "--gravity",
        "0",
        "0",
        "9.81",
        "--base",
        "base",
        "--tip",
        "hand",
        "--snap",
        "0",
    ]
    assert main(["robot", str(arm), "-o", str(toml), "--force", *options]) == 0
    robot = didim.load_robot(toml)
    assert robot.joint_names == ("shoulder", "elbow")
    assert robot.correspondence is not None
    assert dict(robot.correspondence.lock)["wrist"] == 0.3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--lock", "wrist"], "--lock takes JOINT=VALUE"),
        (["--lock", "wrist=far"], "--lock takes JOINT=VALUE"),
        (["--snap", "0.5"], "snap must be an angle between 0 and 0.02 rad, got 0.5"),
        (["-o", "arm.txt"], "the name of a robot file ends in .toml"),
        (["--tip", "nose"], "there is no link 'nose' (tip)"),
    ],
)
def test_wrong_options(
    arm: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["robot", str(arm), *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.splitlines()) == 1


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"no\.urdf: no such file"):
        didim.load_robot(tmp_path / "no.urdf")
    (tmp_path / "folder.urdf").mkdir()
    with pytest.raises(RobotError, match="cannot be read"):
        didim.load_robot(tmp_path / "folder.urdf")
    with pytest.raises(RobotError, match="tip is for a URDF"):
        didim.load_robot("tx40", tip="x")
