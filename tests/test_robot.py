"""Robot files: what they say, and one sentence for what is wrong in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import didim
from didim.robot.robot_file import PACKAGED
from robots import random_motion, relative

ARM = """
schema = 1
name = "arm"
[[joint]]
kind = "revolute"
[[joint]]
kind = "revolute"
alpha_deg = 90
d_m = 0.3
[parameters.good]
Fv1 = 2.0
ZZ1R = 1.0
"""


def load(tmp_path: Path, text: str) -> didim.Robot:
    path = tmp_path / "arm.toml"
    path.write_text(text)
    return didim.load_robot(path)


@pytest.mark.parametrize("name", sorted(path.stem for path in PACKAGED.glob("*.toml")))
def test_packaged_robots_load_with_their_sets(name: str) -> None:
    robot = didim.load_robot(name)
    assert robot.name == name
    assert len(robot.limits) == robot.n_dof
    for values in robot.sets.values():
        assert values.shape == (len(robot.parameter_names),)
        assert not values.flags.writeable


def test_the_corrected_table_is_positive_definite_and_the_printed_one_is_not() -> None:
    robot = didim.load_robot("tx40")
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (2000, 6))
    rest = np.zeros_like(q)

    def share_indefinite(name: str) -> float:
        x = robot.parameter_set(name)
        still = didim.inverse_dynamics(robot, q, rest, rest, x)
        columns = []
        for j in range(6):
            unit = rest.copy()
            unit[:, j] = 1.0
            columns.append(didim.inverse_dynamics(robot, q, rest, unit, x) - still)
        M = np.stack(columns, axis=2)
        return float(np.mean(np.linalg.eigvalsh(M)[:, 0] <= 0.0))

    assert share_indefinite("didim") == 0.0
    assert share_indefinite("cloe") == 0.0
    assert 0.75 < share_indefinite("didim_printed") < 0.87


def test_the_arm_of_the_tx40_hangs_on_joint_2() -> None:
    robot = didim.load_robot("tx40")
    q = np.array([[0.0, np.pi / 2, -np.pi / 2, 0.0, 0.0, 0.0]])
    x = np.zeros(86)
    x[robot.parameter_names.index("MX2")] = 2.2
    tau = didim.inverse_dynamics(robot, q, np.zeros((1, 6)), np.zeros((1, 6)), x)
    np.testing.assert_allclose(tau[0], [0.0, -2.2 * 9.81, 0.0, 0.0, 0.0, 0.0], atol=1e-12)


def test_a_standard_dh_table_is_converted(tmp_path: Path) -> None:
    # Distal rows belong to the joint before: alpha and d move one row down.
    distal = """
schema = 1
convention = "dh"
gravity_m_s2 = [0, -9.81, 0]
[[joint]]
kind = "revolute"
alpha_deg = 90
a_m = 0.3
d_m = 0.1
[[joint]]
kind = "revolute"
a_m = 0.2
d_m = 0
theta_deg = 10
"""
    modified = """
schema = 1
gravity_m_s2 = [0, -9.81, 0]
[[joint]]
kind = "revolute"
r_m = 0.1
[[joint]]
kind = "revolute"
alpha_rad = 1.5707963267948966
d_m = 0.3
theta_deg = 10
"""
    a, b = load(tmp_path, distal), load(tmp_path, modified)
    assert a.geometry == b.geometry
    motion = random_motion(np.random.default_rng(0), 5, 2)
    x = np.random.default_rng(1).uniform(-1, 1, 28)
    tau = didim.inverse_dynamics(a, motion.q, motion.dq, motion.ddq, x)
    assert relative(didim.inverse_dynamics(b, motion.q, motion.dq, motion.ddq, x) - tau, tau) == 0.0


def test_sets_may_mix_base_and_standard_names(tmp_path: Path) -> None:
    robot = load(tmp_path, ARM)
    assert robot.set_base("good")[robot.base_parameters.names.index("ZZ1R")] == 1.0
    assert robot.sets["good"][robot.parameter_names.index("Fv1")] == 2.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("schema = 1", "schema = 2"), "schema must be 1"),
        (('name = "arm"', "nam = 3"), "unknown key 'nam'; did you mean 'name'"),
        (("d_m = 0.3", "d_mm = 300"), "unknown key 'd_mm'; did you mean 'd_m'"),
        (('kind = "revolute"', 'kind = "ball"'), "must be one of 'revolute', 'prismatic', got 'ball'"),
        (("alpha_deg = 90", "alpha_deg = 90\nalpha_rad = 1"), "give alpha_rad or alpha_deg, not both"),
        (("alpha_deg = 90", "alpha_deg = nan"), "alpha_deg must be a finite number, got nan"),
        (("d_m = 0.3", "limits = { velocity_m_s = 1 }"), "unknown key 'velocity_m_s'"),
        (("d_m = 0.3", "limits = { position_rad = [1, -1] }"), "lowest position must be below the highest"),
        (("Fv1 = 2.0", "Fw1 = 2.0"), "unknown parameter 'Fw1'; did you mean"),
        (("Fv1 = 2.0", "ZZ1 = 2.0"), "has both 'ZZ1' and 'ZZ1R'"),
        (("[parameters.good]", "[transmission]\ncoupling = [[1, 1], [1, 1]]\n[parameters.good]"), "singular"),
        (("[parameters.good]", "[transmission]\ncoupling = [[0, 1], [1, 0]]\n[parameters.good]"), "motor 1"),
        (("[parameters.good]", "[transmission]\ncoupling = [[1, 0]]\n[parameters.good]"), "2 rows"),
        (
            ("[parameters.good]", "[transmission]\nreduction = [[1, 1], [2, 2]]\n[parameters.good]"),
            "[transmission] reduction is singular: the row of motor 2 is a combination of the rows before it",
        ),
        (("d_m = 0.3", "d_m = 1e200"), "d_m must be at most 1e+09 in size, got 1e+200"),
        (("schema = 1", "schema = 1\ngravity_m_s2 = [0, 0, 1e308]"), "lengths or gravity allow no base parameters"),
        (("[parameters.good]", '[friction]\ncoulomb = "tanh"\n[parameters.good]'), "smoothing_rad_s above 0"),
        (  # such a smooth sign is no column of its own
            ("[parameters.good]", "[friction]\nsmoothing_rad_s = 1e9\n[parameters.good]"),
            "smoothing_rad_s must be at most 100.0, got 1000000000.0",
        ),
        (
            ("[parameters.good]", "[friction]\ndead_zone_rad_s = -1\n[parameters.good]"),
            "dead_zone_rad_s must be at least 0.0, got -1.0",
        ),
    ],
)  # fmt: skip
def test_wrong_files_say_what_is_wrong(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    with pytest.raises(didim.errors.RobotError) as caught:
        load(tmp_path, ARM.replace(*change, 1))
    assert message in str(caught.value)
    assert "arm.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_robot_without_joints_is_told(tmp_path: Path) -> None:
    with pytest.raises(didim.errors.RobotError, match="at least one"):
        load(tmp_path, "schema = 1\n")
    with pytest.raises(didim.errors.RobotError, match="at most 128 joints, got 129"):
        load(tmp_path, "schema = 1\n" + '[[joint]]\nkind = "revolute"\n' * 129)


def test_unknown_names_are_told() -> None:
    with pytest.raises(didim.errors.RobotError, match="no packaged robot 'tx4'; did you mean 'tx40'"):
        didim.load_robot("tx4")
    with pytest.raises(
        didim.errors.RobotError, match=r"^friction of robot 'tx40': unknown key 'zeal'; known here"
    ):
        didim.load_robot("tx40").with_friction(zeal="red")
    with pytest.raises(didim.errors.RobotError, match="no such file"):
        didim.load_robot("nowhere/robot.toml")
    with pytest.raises(didim.errors.RobotError, match="no parameter set 'didm'; did you mean 'didim'"):
        didim.load_robot("tx40").parameter_set("didm")


def test_friction_options_can_be_replaced() -> None:
    emps = didim.load_robot("emps").with_friction(model="asymmetric")
    assert emps.parameter_names[-4:] == ("Fv1+", "Fc1+", "Fv1-", "Fc1-")
    tx40 = didim.load_robot("tx40").with_friction(dead_zone_rad_s=[0.1, 0, 0, 0, 0, 0.2], coulomb="sign")
    assert tx40.friction.dead_zone == (0.1, 0.0, 0.0, 0.0, 0.0, 0.2)
    with pytest.raises(didim.errors.RobotError, match="did you mean 'dead_zone_rad_s'"):
        tx40.with_friction(dead_zone_rads=1.0)
