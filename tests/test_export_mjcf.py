"""MJCF against didim's inverse dynamics, by MuJoCo: bodies, rotors, damping and coupled wrists."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.errors import FitError
from didim.robot.robot import Robot
from engines import mujoco_model, mujoco_torques
from robots import random_motion, random_parameters
from test_export_sdf import ELBOW
from test_export_urdf import only
from urdfs import random_urdf

Array = np.ndarray


def difference(robot: Robot, x: Array) -> float:
    """Largest difference of ``mj_inverse``, without Coulomb friction (a constraint to MuJoCo), over the largest torque."""
    motion = random_motion(np.random.default_rng(0), 100, robot.n_dof)
    state = motion.q, motion.dq, motion.ddq
    names = robot.joint_names or tuple(f"joint{j + 1}" for j in range(robot.n_dof))
    expected = didim.inverse_dynamics(robot, *state, only(robot, x, "Ia", "Fv"))
    tau = mujoco_torques(didim.export.to_mjcf(robot, x), names, *state)
    return float(np.abs(tau - expected).max() / np.abs(expected).max())


def wrist_parameters(robot: Robot, seed: int) -> Array:
    """Bodies and drives of a robot with coupled motors: each joint has what its motors put on it, and more."""
    rng = np.random.default_rng(seed)
    x = random_parameters(rng, robot)
    at = robot.parameter_names.index
    coupling = np.array(robot.geometry.coupling)
    coupled = [m for m in range(robot.n_dof) if np.count_nonzero(coupling[m]) > 1]
    for m in coupled:
        x[at(f"Fvm{m + 1}")] *= 0.3 * x[at(f"Fv{m + 1}")]
        x[at(f"Fcm{m + 1}")] *= 0.3 * x[at(f"Fc{m + 1}")]
    for m in coupled:
        row = coupling[m] / coupling[m, m]
        for i in np.flatnonzero(row):
            if i != m:
                x[at(f"Ia{i + 1}")] += row[i] ** 2 * x[at(f"Ia{m + 1}")]
                x[at(f"Fv{i + 1}")] += row[i] ** 2 * x[at(f"Fvm{m + 1}")]
    return x


@pytest.mark.parametrize("seed", range(3))
def test_the_tx40_with_its_wrist(seed: int) -> None:
    robot = didim.load_robot("tx40")
    x = wrist_parameters(robot, seed)
    assert difference(robot, x) < 1e-12
    model = mujoco_model(didim.export.to_mjcf(robot, x))
    values = dict(zip(robot.parameter_names, x.tolist(), strict=True))
    assert model.ntendon == 1
    np.testing.assert_allclose(model.tendon_frictionloss, [values["Fcm6"]])
    np.testing.assert_allclose(model.tendon_armature, [values["Ia6"]])
    loss = [values[f"Fc{j}"] for j in range(1, 6)] + [values["Fc6"] - values["Fcm6"]]
    np.testing.assert_allclose(model.dof_frictionloss, loss)
    np.testing.assert_allclose(model.dof_armature[5], 0.0)


def test_the_physical_tx40_of_the_package() -> None:
    robot = didim.load_robot("tx40")
    assert difference(robot, robot.parameter_set("didim_physical")) < 1e-12


@pytest.mark.parametrize("row", [[0.0, 0.5, -0.7, 1.0, 0.0, 0.0], [0.3, 0.0, 0.0, 2.0, 0.0, 0.0]])
def test_any_coupling(row: list[float]) -> None:
    robot = didim.load_robot("tx40")
    coupling = [list(line) for line in robot.geometry.coupling]
    coupling[3] = row
    robot = replace(robot, geometry=replace(robot.geometry, coupling=tuple(tuple(line) for line in coupling)))
    assert difference(robot, wrist_parameters(robot, 1)) < 1e-12


@pytest.mark.parametrize("name", ["planar2", "emps"])
def test_packaged_robots(name: str) -> None:
    robot = didim.load_robot(name)
    assert difference(robot, random_parameters(np.random.default_rng(0), robot)) < 1e-12


@pytest.mark.parametrize("seed", range(10))
def test_robots_from_urdfs(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = tmp_path / "chain.urdf"
    path.write_text(random_urdf(rng, int(rng.integers(1, 8)))[0])
    robot = didim.load_robot(path)
    assert difference(robot, random_parameters(rng, robot)) < 1e-12


def test_limits_and_names_are_those_of_the_urdf(tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(ELBOW, encoding="utf-8")
    robot = didim.load_robot(tmp_path / "two.urdf")
    model = mujoco_model(didim.export.to_mjcf(robot, random_parameters(np.random.default_rng(0), robot)))
    np.testing.assert_allclose(model.actuator_ctrlrange, [[-330.0, 330.0], [-150.0, 150.0]])
    np.testing.assert_allclose(model.jnt_range, [[-3.0, 3.0], [-2.0, 1.0]], atol=1e-9)
    assert [model.body(k + 1).name for k in range(2)] == ["upper", "fore"]


def test_limits_and_motors(shared: Path) -> None:
    robot = didim.load_robot(shared / "data" / "ur10e" / "ur10e.urdf")
    model = mujoco_model(didim.export.to_mjcf(robot, random_parameters(np.random.default_rng(0), robot)))
    np.testing.assert_allclose(model.actuator_ctrlrange[3], [-54.0, 54.0])
    np.testing.assert_allclose(model.jnt_range[2], [-np.pi, np.pi], atol=1e-9)
    assert [model.body(k + 1).name for k in range(6)][5] == "wrist_3_link"


@pytest.mark.parametrize(
    ("name", "share", "message"),
    [
        ("Ia5", 0.5, "rotor inertia of joint 'joint5' without its coupled motors is -"),
        ("Fv5", 0.0, "viscous friction of joint 'joint5' without its coupled motors is -"),
        ("Fc6", 0.0, "Coulomb friction of joint 'joint6' without its coupled motors is -"),
    ],
)
def test_shares_of_a_coupled_motor_must_not_be_negative(name: str, share: float, message: str) -> None:
    robot = didim.load_robot("tx40")
    x = wrist_parameters(robot, 0)
    at = robot.parameter_names.index
    x[at(name)] = share * x[at("Ia6")]
    with pytest.raises(FitError, match=message):
        didim.export.to_mjcf(robot, x)
