"""Parameters in the user's URDF: three engines read them back, and every other byte is as it was."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.errors import FitError
from didim.robot.robot import Robot
from engines import mujoco_torques
from robots import random_motion, random_parameters
from urdfs import GRIPPER_ARM, pinocchio_model, pinocchio_torques, random_urdf

Array = NDArray[np.float64]
FILES = [
    "urdf/gen3",
    "urdf/iiwa14",
    "urdf/kr16",
    "urdf/panda",
    "urdf/ur5e",
    "urdf/ur5e_undeclared_prefix",
    "ur10e/ur10e",
]


def only(robot: Robot, x: Array, *starts: str) -> Array:
    """Standard parameters with those zero whose names start with none of these and are not inertial."""
    kept = re.compile("|".join([r"(XX|XY|XZ|YY|YZ|ZZ|MX|MY|MZ|M)\d", *starts]))
    return np.where([kept.match(name) is not None for name in robot.parameter_names], x, 0.0)


def without_offsets(robot: Robot, seed: int) -> Array:
    x = random_parameters(np.random.default_rng(seed), robot)
    return only(robot, x, "Ia", "Fv", "Fc")


def arm_parameters(robot: Robot, seed: int) -> Array:
    """Parameters of the arm with the gripper, whose hand stays a body without its fingers."""
    x = without_offsets(robot, seed)
    hand = slice(robot.parameter_names.index("XX3"), robot.parameter_names.index("M3") + 1)
    x[hand] += robot.parameter_set("urdf")[hand]
    return x


def declared(text: str) -> str:
    """The text without prefixes that nobody declared, at which Pinocchio's parser stops."""
    return re.sub(r"\b(drake|controller|sensor|interface):", r"\1_", text)


def check_engines(robot: Robot, x: Array, text: str, tolerance: float, gravity: Array) -> None:
    motion = random_motion(np.random.default_rng(2), 20, robot.n_dof)
    state = motion.q, motion.dq, motion.ddq
    rigid = didim.inverse_dynamics(robot, *state, only(robot, x))
    model = pinocchio_model(declared(text), robot.joint_names)
    model.gravity.linear = gravity
    expected = pinocchio_torques(model, robot.joint_names, *state)
    assert np.abs(rigid - expected).max() < tolerance * np.abs(expected).max()
    damped = didim.inverse_dynamics(robot, *state, only(robot, x, "Fv"))
    by_mujoco = mujoco_torques(text, robot.joint_names, *state, gravity=gravity)
    assert np.abs(damped - by_mujoco).max() < tolerance * np.abs(by_mujoco).max()


@pytest.mark.parametrize("file", FILES)
def test_real_descriptions(shared: Path, tmp_path: Path, file: str) -> None:
    path = shared / "data" / f"{file}.urdf"
    robot = didim.load_robot(path, snap=0.0)  # as it is written, for the other engines
    x = without_offsets(robot, 1)
    content = didim.export.to_urdf(robot, x, path)
    out = tmp_path / path.name
    out.write_bytes(content)
    check_engines(robot, x, content.decode(), 1e-9, np.array([0.0, 0.0, -9.81]))
    again = didim.load_robot(out, snap=0.0)
    motion = random_motion(np.random.default_rng(3), 20, robot.n_dof)
    first = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, only(robot, x, "Fv", "Fc"))
    second = didim.inverse_dynamics(again, motion.q, motion.dq, motion.ddq, again.parameter_set("urdf"))
    assert np.abs(first - second).max() < 1e-12 * np.abs(first).max()
    yourdfpy = pytest.importorskip("yourdfpy", reason="needs yourdfpy, the group 'test'")
    read = yourdfpy.URDF.load(str(out), load_meshes=False, build_scene_graph=False)
    masses = {name: link.inertial.mass for name, link in read.link_map.items() if link.inertial is not None}
    values = dict(zip(robot.parameter_names, x, strict=True))
    assert robot.correspondence is not None
    for j, place in enumerate(robot.correspondence.links):
        assert masses[place.link] == values[f"M{j + 1}"]


def untouched(text: str) -> str:
    """A URDF without what an export may change."""
    changed = r"\s*<inertial\b.*?</inertial\s*>|\s*<!-- inertial: part of link .*?-->|\s*<!-- didim: .*?-->|\s*<dynamics\b[^>]*>"
    text = re.sub(changed, "", text, flags=re.DOTALL)
    return re.sub(r'<link name="([^"]*)"\s*(/>|>\s*</link>)', r'<link name="\1"/>', text)


@pytest.mark.parametrize("file", FILES)
def test_all_other_bytes_are_as_they_were(shared: Path, file: str) -> None:
    path = shared / "data" / f"{file}.urdf"
    robot = didim.load_robot(path)
    content = didim.export.to_urdf(robot, without_offsets(robot, 1), path)
    assert untouched(content.decode()) == untouched(path.read_text())
    assert content != path.read_bytes()


@pytest.mark.parametrize("seed", range(15))
def test_random_chains(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = tmp_path / "chain.urdf"
    path.write_text(random_urdf(rng, int(rng.integers(1, 8)))[0])
    robot = didim.load_robot(path)
    x = without_offsets(robot, seed)
    text = didim.export.to_urdf(robot, x, path).decode()
    check_engines(robot, x, text, 1e-11, np.array([0.0, 0.0, -9.81]))


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(GRIPPER_ARM)
    return path


def test_what_changes_in_a_file(arm: Path) -> None:
    robot = didim.load_robot(arm)
    x = arm_parameters(robot, 4)
    lines = didim.export.to_urdf(robot, x, arm).decode().splitlines()
    before = GRIPPER_ARM.splitlines()
    values = dict(zip(robot.parameter_names, x.tolist(), strict=True))
    added = [line for line in lines if line not in before]
    assert f'    <dynamics damping="{values["Fv1"]!r}" friction="{values["Fc1"]!r}"/>' in added
    note = (
        f"    <!-- didim: rotor inertia {values['Ia2']!r} kg.m^2 (armature), which URDF has no place for -->"
    )
    assert note in added
    assert f'      <mass value="{values["M2"]!r}"/>' in added
    assert "    <!-- inertial: part of link hand -->" in added
    gone = [line for line in before if line not in lines]
    assert not [line for line in gone if not re.search("inertia|mass|origin|dynamics", line)]
    # The fingers hang on locked joints and keep their inertia; the hand has the difference.
    hand = lines[lines.index('  <link name="hand">') :]
    mass = float(re.search('value="(.*?)"', next(line for line in hand if "<mass" in line)).group(1))  # type: ignore[union-attr]
    assert mass == pytest.approx(values["M3"] - 0.2, rel=1e-12)


def test_the_same_parameters_change_next_to_nothing(arm: Path) -> None:
    robot = didim.load_robot(arm)
    again = arm.with_name("again.urdf")
    again.write_bytes(didim.export.to_urdf(robot, robot.parameter_set("urdf"), arm, keep_lumped=True))
    robot_again = didim.load_robot(again)
    np.testing.assert_allclose(
        robot_again.parameter_set("urdf"), robot.parameter_set("urdf"), rtol=1e-12, atol=1e-14
    )
    assert again.read_text().count("<inertial>") == GRIPPER_ARM.count("<inertial>")
    assert '<dynamics damping="1.5" friction="0.75"/>' in again.read_text()


def test_a_second_export_replaces_the_notes(arm: Path) -> None:
    robot = didim.load_robot(arm)
    first = arm.with_name("first.urdf")
    first.write_bytes(didim.export.to_urdf(robot, arm_parameters(robot, 1), arm))
    robot = didim.load_robot(first)
    x = arm_parameters(robot, 2)
    second = didim.export.to_urdf(robot, x, first).decode()
    assert second.count("rotor inertia") == 3
    assert f"rotor inertia {dict(zip(robot.parameter_names, x.tolist(), strict=True))['Ia1']!r} kg" in second
    assert untouched(second) == untouched(GRIPPER_ARM)


EMPTY = """<robot name='bare'>\r
\t<link name='a'/>\r
\t<link name='b' />\r
\t<link name="c"></link>\r
\t<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>\
<dynamics D = '3' friction='0.1' ></dynamics></joint>\r
\t<joint name="k" type="prismatic">\r
\t\t<parent link="b"/>\r
\t\t<child link="c"/>\r
\t</joint>\r
</robot>\r
"""


def test_a_file_without_inertias(tmp_path: Path) -> None:
    path = tmp_path / "bare.urdf"
    path.write_bytes(EMPTY.encode())
    robot = didim.load_robot(path)
    x = without_offsets(robot, 5)
    content = didim.export.to_urdf(robot, x, path)
    text = content.decode()
    assert text.count("\r\n") == text.count("\n")
    assert re.search(r"<link name='b' >\r\n\t  <inertial>\r\n\t    <origin xyz", text)
    assert "<link name='a'/>" in text
    values = dict(zip(robot.parameter_names, x.tolist(), strict=True))
    assert (
        f'<dynamics damping="{values["Fv1"]!r}" D = \'3\' friction="{values["Fc1"]!r}" ></dynamics>' in text
    )
    assert f"rotor inertia {values['Ia2']!r} kg (armature)" in text
    path.write_bytes(content)
    again = didim.load_robot(path)
    np.testing.assert_allclose(
        again.parameter_set("urdf"), only(robot, x, "Fv", "Fc"), rtol=1e-12, atol=1e-14
    )


def test_attributes_that_end_alike(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(GRIPPER_ARM.replace("<dynamics damping", '<dynamics mu_damping="7" damping'))
    robot = didim.load_robot(path)
    text = didim.export.to_urdf(robot, arm_parameters(robot, 6), path).decode()
    assert 'mu_damping="7" damping="' in text


def test_another_file_is_refused(arm: Path) -> None:
    robot = didim.load_robot(arm)
    x = arm_parameters(robot, 1)
    arm.write_text(GRIPPER_ARM + "\n")
    with pytest.raises(
        FitError, match=r"arm\.urdf is not the file that robot 'little_arm' was read from .* read it again"
    ):
        didim.export.to_urdf(robot, x, arm)
    with pytest.raises(
        FitError, match=r"robot 'tx40' was not read from a URDF: .*didim robot arm\.urdf -o arm\.toml"
    ):
        didim.export.to_urdf(didim.load_robot("tx40"), np.zeros(86), arm)


def spoilt(robot: Robot, **changes: float) -> Array:
    x = arm_parameters(robot, 1)
    for name, value in changes.items():
        x[robot.parameter_names.index(name)] = value
    return x


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"M2": 0.0}, r"link 'forearm' is not a body: its mass is 0 kg \(base parameters alone give no masses\)"),
        ({"M2": -1.0}, "link 'forearm' is not a body: its mass is -1 kg"),
        ({"XX1": 50.0}, "link 'upper_arm' is not a body: its moments of inertia break the triangle inequality"),
        ({"ZZ1": -5.0}, "link 'upper_arm' is not a body: its smallest moment of inertia about the centre of mass is -"),
        ({"Fv3": -0.1}, r"viscous friction of joint 'wrist' is negative \(-0.1\)"),
        ({"Fc3": -0.1}, "Coulomb friction of joint 'wrist' is negative"),
        ({"Ia3": -0.1}, "rotor inertia of joint 'wrist' is negative"),
    ],
)  # fmt: skip
def test_what_is_no_robot_is_refused(arm: Path, changes: dict[str, float], message: str) -> None:
    robot = didim.load_robot(arm)
    for write in (lambda x: didim.export.to_urdf(robot, x, arm), lambda x: didim.export.to_mjcf(robot, x)):
        with pytest.raises(FitError, match=f"{message}.*export physically consistent parameters"):
            write(spoilt(robot, **changes))


def test_the_hand_must_be_a_body_without_its_fingers(arm: Path) -> None:
    robot = didim.load_robot(arm)
    x = arm_parameters(robot, 1)
    first = robot.parameter_names.index("XX3")
    x[first : first + 10] *= 0.1 / x[first + 9]  # lighter than its two fingers
    with pytest.raises(
        FitError,
        match=r"link 'hand' is not a body without finger, other_finger: its mass",
    ):
        didim.export.to_urdf(robot, x, arm)


def test_a_link_with_a_name_for_comments(tmp_path: Path) -> None:
    text = GRIPPER_ARM.replace('"hand"', '"hand--é"')
    path = tmp_path / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    robot = didim.load_robot(path)
    content = didim.export.to_urdf(robot, arm_parameters(robot, 0), path)
    assert b"<!-- inertial: part of link hand- -? -->" in content
    path.write_bytes(content)
    assert didim.load_robot(path).n_dof == 3


def test_a_link_between_joints_without_mass_stays_so(tmp_path: Path) -> None:
    body = '<inertial><mass value="{}"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial>'
    links = f'<link name="base"/><link name="cross"/><link name="arm">{body.format(2.0)}</link>'
    joints = "".join(
        f'<joint name="{name}" type="continuous"><parent link="{above}"/><child link="{below}"/><axis xyz="{axis}"/></joint>'
        for name, above, below, axis in (("pan", "base", "cross", "0 0 1"), ("tilt", "cross", "arm", "0 1 0"))
    )
    text = f'<robot name="head">{links}{joints}</robot>'
    (tmp_path / "head.urdf").write_text(text)
    robot = didim.load_robot(tmp_path / "head.urdf")
    x = 1.5 * robot.parameter_set("urdf")
    content = didim.export.to_urdf(robot, x, tmp_path / "head.urdf").decode()
    assert '<link name="cross"/>' in content
    motion = random_motion(np.random.default_rng(2), 20, 2)
    state = motion.q, motion.dq, motion.ddq
    found = pinocchio_torques(pinocchio_model(content, robot.joint_names), robot.joint_names, *state)
    np.testing.assert_allclose(found, didim.inverse_dynamics(robot, *state, x), rtol=1e-10, atol=1e-10)
    # One that is not carried by another, or has an element of its own, has to be a body.
    x[[robot.parameter_names.index(name) for name in ("XX2", "YY2", "ZZ2", "M2")]] = 0.0
    with pytest.raises(FitError, match=r"link 'arm' is not a body: its mass is 0 kg"):
        didim.export.to_urdf(robot, x, tmp_path / "head.urdf")
