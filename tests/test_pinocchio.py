"""Inverse and direct dynamics, M(q) and regressor against Pinocchio, on the TX40 and on random chains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from hypothesis import given, settings
from hypothesis import strategies as st

import didim
from didim.robot.robot import Robot
from robots import random_motion, random_parameters, relative, robots
from twins import PINOCCHIO_ORDER, pinocchio_model


def check(robot: Robot, rng: np.random.Generator) -> None:
    x = random_parameters(rng, robot, drive=False)
    motion = random_motion(rng, 5, robot.n_dof)
    model = pinocchio_model(robot, x)
    data = model.createData()
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    W = didim.regressor(robot, motion.q, motion.dq, motion.ddq)
    per_joint = (W.shape[2] - 2 * (robot.parameter_names[-1].startswith("Fcm"))) // robot.n_dof
    columns = [j * per_joint + k for j in range(robot.n_dof) for k in PINOCCHIO_ORDER]
    for k in range(5):
        state = motion.q[k], motion.dq[k], motion.ddq[k]
        expected = pin.rnea(model, data, *state)
        assert relative(tau[k] - expected, expected) < 1e-9
        reference = pin.computeJointTorqueRegressor(model, data, *state)
        assert relative(W[k][:, columns] - reference, reference) < 1e-9


@settings(max_examples=100)
@given(robot=robots(coupled=False), seed=st.integers(0, 2**32 - 1))
def test_random_chains(robot: Robot, seed: int) -> None:
    check(robot, np.random.default_rng(seed))


@settings(max_examples=5)
@given(robot=robots(smallest=11, largest=13, coupled=False), seed=st.integers(0, 2**32 - 1))
def test_chains_of_more_than_ten_joints(robot: Robot, seed: int) -> None:
    """Whose names have two digits."""
    check(robot, np.random.default_rng(seed))


def test_the_kinematics_of_the_tx40() -> None:
    robot = didim.load_robot("tx40")
    for seed in range(20):
        check(robot, np.random.default_rng(seed))


def check_direct(robot: Robot, rng: np.random.Generator) -> None:
    x = random_parameters(rng, robot, drive=False)
    rotors = [robot.parameter_names.index(f"Ia{j + 1}") for j in range(robot.n_dof)]
    x[rotors] = rng.uniform(0.1, 1.0, robot.n_dof)
    motion = random_motion(rng, 5, robot.n_dof)
    tau = rng.uniform(-5.0, 5.0, motion.q.shape)
    model = pinocchio_model(robot, x)
    model.armature = x[rotors]
    data = model.createData()
    ddq = didim.direct_dynamics(robot, motion.q, motion.dq, tau, x)
    M = didim.inertia_matrix(robot, motion.q, x)
    for k in range(5):
        expected = pin.aba(model, data, motion.q[k], motion.dq[k], tau[k])
        assert relative(ddq[k] - expected, expected) < 1e-9
        upper = np.triu(pin.crba(model, data, motion.q[k]))
        matrix = upper + np.triu(upper, 1).T
        assert relative(M[k] - matrix, matrix) < 1e-9


@settings(max_examples=100)
@given(robot=robots(coupled=False), seed=st.integers(0, 2**32 - 1))
def test_direct_model_of_random_chains(robot: Robot, seed: int) -> None:
    check_direct(robot, np.random.default_rng(seed))


def test_direct_model_with_the_kinematics_of_the_tx40() -> None:
    """Coupling off: Pinocchio's armature is one rotor per joint."""
    robot = didim.load_robot("tx40")
    identity = tuple(tuple(row) for row in np.eye(6).tolist())
    uncoupled = replace(robot, geometry=replace(robot.geometry, coupling=identity))
    for seed in range(20):
        check_direct(uncoupled, np.random.default_rng(seed))


def test_a_coupled_wrist_adds_the_rotor_block() -> None:
    robot = didim.load_robot("tx40")
    rng = np.random.default_rng(0)
    x = random_parameters(rng, robot, drive=False)
    rotors = [robot.parameter_names.index(f"Ia{j + 1}") for j in range(6)]
    x[rotors] = rng.uniform(0.1, 1.0, 6)
    motion = random_motion(rng, 5, 6)
    M = didim.inertia_matrix(robot, motion.q, x)
    model = pinocchio_model(robot, x)
    data = model.createData()
    block = np.diag(x[rotors])
    block[4, 5] = block[5, 4] = x[rotors[5]]
    for k in range(5):
        upper = np.triu(pin.crba(model, data, motion.q[k]))
        matrix = upper + np.triu(upper, 1).T + block
        assert relative(M[k] - matrix, matrix) < 1e-9


def test_rotor_inertia_is_armature() -> None:
    robot = didim.load_robot("planar2")
    rng = np.random.default_rng(0)
    x = random_parameters(rng, robot, drive=False)
    motion = random_motion(rng, 5, 2)
    model = pinocchio_model(robot, x)
    model.armature = np.array([0.3, 0.7])
    x[[robot.parameter_names.index(name) for name in ("Ia1", "Ia2")]] = model.armature
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    data = model.createData()
    for k in range(5):
        expected = pin.rnea(model, data, motion.q[k], motion.dq[k], motion.ddq[k])
        assert relative(tau[k] - expected, expected) < 1e-9
