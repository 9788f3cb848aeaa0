"""SDF read by an independent reader into Pinocchio."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.robot.robot import Robot
from engines import sdf_torques
from robots import random_motion, random_parameters
from test_export_urdf import only
from urdfs import random_urdf


def difference(robot: Robot, x: np.ndarray, gravity: tuple[float, ...]) -> float:
    motion = random_motion(np.random.default_rng(0), 30, robot.n_dof)
    state = motion.q, motion.dq, motion.ddq
    expected = didim.inverse_dynamics(robot, *state, only(robot, x))
    tau = sdf_torques(didim.export.to_sdf(robot, x), gravity, *state)
    return float(np.abs(tau - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("seed", range(10))
def test_robots_from_urdfs(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = tmp_path / "chain.urdf"
    path.write_text(random_urdf(rng, int(rng.integers(1, 8)), right_angles=bool(seed % 2))[0])
    robot = didim.load_robot(path)
    assert difference(robot, random_parameters(rng, robot), (0.0, 0.0, -9.81)) < 1e-12


def test_packaged_robots() -> None:
    for name in ("tx40", "planar2"):
        robot = didim.load_robot(name)
        x = random_parameters(np.random.default_rng(0), robot)
        assert difference(robot, x, robot.geometry.gravity) < 1e-12


ELBOW = """<robot name="two"><link name="base"/><link name="upper"/><link name="fore"/>
<joint name="to_base" type="fixed"><parent link="world"/><child link="base"/></joint><link name="world"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="2" effort="330"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="1" velocity="3" effort="150"/></joint></robot>"""
"""A world, a base and two links without inertia."""


def test_names_limits_and_friction_are_those_of_the_urdf(tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(ELBOW, encoding="utf-8")
    robot = didim.load_robot(tmp_path / "two.urdf")
    x = random_parameters(np.random.default_rng(0), robot)
    values = dict(zip(robot.parameter_names, x.tolist(), strict=True))
    model = ET.fromstring(didim.export.to_sdf(robot, x)).find("model")
    assert model is not None
    assert model.get("name") == "two"
    joints = {joint.get("name"): joint for joint in model.findall("joint")}
    elbow = joints["elbow"]
    assert (elbow.findtext("parent"), elbow.findtext("child")) == ("upper", "fore")
    found = [
        float(elbow.findtext(f"axis/{key}") or "nan") for key in ("dynamics/damping", "dynamics/friction")
    ]
    assert found == [values["Fv2"], values["Fc2"]]
    limits = [float(elbow.findtext(f"axis/limit/{key}") or "nan") for key in ("lower", "upper", "effort")]
    assert limits == [-2.0, 1.0, 150.0]


def test_what_it_says(shared: Path) -> None:
    robot = didim.load_robot(shared / "data" / "urdf" / "ur5e.urdf")
    x = random_parameters(np.random.default_rng(0), robot)
    values = dict(zip(robot.parameter_names, x.tolist(), strict=True))
    model = ET.fromstring(didim.export.to_sdf(robot, x)).find("model")
    assert model is not None
    assert model.get("name") == "ur5e_robot"
    joints = {joint.get("name"): joint for joint in model.findall("joint")}
    assert joints["world_to_base"].findtext("child") == "base_link"
    elbow = joints["elbow_joint"]
    assert (elbow.findtext("parent"), elbow.findtext("child")) == ("upper_arm_link", "forearm_link")
    assert float(elbow.findtext("axis/dynamics/damping") or "nan") == values["Fv3"]
    assert float(elbow.findtext("axis/dynamics/friction") or "nan") == values["Fc3"]
    assert float(elbow.findtext("axis/limit/effort") or "nan") == 150.0
