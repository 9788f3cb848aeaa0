"""Identities between the inverse model, its regressor and the observation matrix, over random robots."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import didim
from didim import _core
from didim.errors import ShapeError
from didim.robot.robot import Robot
from robots import random_motion, random_parameters, relative, robots

seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=100)
@given(robot=robots(), seed=seeds)
def test_the_regressor_times_the_parameters_is_the_inverse_model(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = random_motion(rng, 7, robot.n_dof)
    x = random_parameters(rng, robot)
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    W = didim.regressor(robot, motion.q, motion.dq, motion.ddq)
    assert relative(W @ x - tau, tau) < 1e-12


@settings(max_examples=50)
@given(robot=robots(), seed=seeds)
def test_gravity_is_the_inverse_model_at_rest_without_friction(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = random_motion(rng, 7, robot.n_dof).q
    x = random_parameters(rng, robot)
    bodies = x.copy()
    bodies[[name.startswith(("F", "Off", "Rest")) for name in robot.parameter_names]] = 0.0
    expected = didim.inverse_dynamics(robot, q, 0.0 * q, 0.0 * q, bodies)
    np.testing.assert_array_equal(didim.gravity(robot, q, x), expected)


def test_gravity_refuses_what_is_no_position_or_no_parameter() -> None:
    robot = didim.load_robot("planar2")
    x = robot.parameter_set("reference")
    with pytest.raises(ShapeError, match=r"q must have shape \(n_samples, 2\)"):
        didim.gravity(robot, np.zeros(2), x)
    with pytest.raises(ShapeError, match=r"x must have shape \(28,\)"):
        didim.gravity(robot, np.zeros((1, 2)), x[:3])


@settings(max_examples=50, deadline=None)
@given(robot=robots(), seed=seeds)
def test_the_inertia_matrix_of_the_inverse_model_is_symmetric(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = robot.n_dof
    q = np.tile(rng.uniform(-3, 3, n), (n + 1, 1))
    x = random_parameters(rng, robot)
    accelerations = np.vstack([np.zeros(n), np.eye(n)])
    tau = didim.inverse_dynamics(robot, q, np.zeros((n + 1, n)), accelerations, x)
    M = (tau[1:] - tau[0]).T
    assert relative(M - M.T, M) < 1e-12


@settings(max_examples=50)
@given(robot=robots(coupled=False), seed=seeds)
def test_inertial_torques_have_the_power_of_the_kinetic_and_potential_energy(robot: Robot, seed: int) -> None:
    # d/dt (1/2 dq' M dq) + dq' g = dq' tau along q(t), without friction: the Coriolis terms by M and g alone.
    rng = np.random.default_rng(seed)
    n = robot.n_dof
    x = random_parameters(rng, robot)
    x[[name.startswith(("F", "Off")) for name in robot.parameter_names]] = 0.0
    q0, dq, ddq = rng.uniform(-1, 1, (3, n))
    h = 1e-4

    def kinetic(q: np.ndarray, v: np.ndarray) -> float:
        rows = np.tile(q, (2, 1))
        still = np.zeros_like(rows)
        tau = didim.inverse_dynamics(robot, rows, still, np.vstack([np.zeros(n), v]), x)
        return 0.5 * float(v @ (tau[1] - tau[0]))

    def at(t: float) -> float:
        return kinetic(q0 + dq * t + 0.5 * ddq * t * t, dq + ddq * t)

    gravity = didim.inverse_dynamics(robot, q0[None], np.zeros((1, n)), np.zeros((1, n)), x)[0]
    tau = didim.inverse_dynamics(robot, q0[None], dq[None], ddq[None], x)[0]
    rate = (8.0 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12.0 * h)
    scale = max(1.0, abs(float(dq @ tau)), abs(rate))
    assert abs(rate + float(dq @ gravity) - float(dq @ tau)) / scale < 1e-7


@settings(max_examples=60)
@given(robot=robots(), seed=seeds)
def test_direct_after_inverse_is_the_identity(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = random_motion(rng, 6, robot.n_dof)
    # Rotor inertias of 1 to 2 keep M(q) positive definite, those of coupled motors included.
    x = random_parameters(rng, robot)
    for index, name in enumerate(robot.parameter_names):
        x[index] += name.startswith("Ia")
    coupling = np.array(robot.geometry.coupling)
    coupled = np.flatnonzero(np.abs(coupling).sum(axis=1) > np.abs(np.diag(coupling)))
    for motor in coupled:
        x[[robot.parameter_names.index(f"Ia{j + 1}") for j in range(robot.n_dof) if j != motor]] += 2.0
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    ddq = didim.direct_dynamics(robot, motion.q, motion.dq, tau, x)
    assert relative(ddq - motion.ddq, motion.ddq) < 1e-9


@settings(max_examples=60)
@given(robot=robots(), seed=seeds)
def test_the_inertia_matrix_has_the_columns_of_the_inverse_model(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = robot.n_dof
    q = rng.uniform(-3, 3, (1, n))
    x = random_parameters(rng, robot)
    accelerations = np.vstack([np.zeros(n), np.eye(n)])
    rest = np.zeros((n + 1, n))
    tau = didim.inverse_dynamics(robot, np.repeat(q, n + 1, axis=0), rest, accelerations, x)
    M = didim.inertia_matrix(robot, q, x)[0]
    assert relative(M - (tau[1:] - tau[0]).T, M) < 1e-12


def test_the_largest_safe_step_ends_where_the_margin_does() -> None:
    robot = didim.load_robot("tx40")
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, 6))
    inside, outside = robot.sets["didim"], robot.sets["didim_printed"]
    step = _core.largest_safe_step(robot.core, q, inside, outside, 0.05)
    assert 0.0 < step < 1.0
    M0 = didim.inertia_matrix(robot, q, inside)
    M1 = didim.inertia_matrix(robot, q, inside + step * (outside - inside))
    smallest = min(np.linalg.eigvals(np.linalg.solve(a, b)).real.min() for a, b in zip(M0, M1, strict=True))
    assert smallest == pytest.approx(0.05, abs=1e-9)
    assert _core.largest_safe_step(robot.core, q, inside, robot.sets["cloe"], 0.05) == 1.0
    assert _core.largest_safe_step(robot.core, q, outside, inside, 0.05) == 0.0
    found = _core.smallest_eigenvalue(robot.core, q, inside)
    assert found is not None
    eigenvalues = np.linalg.eigvalsh(M0)[:, 0]
    assert found[0] == int(np.argmin(eigenvalues))
    assert found[1] == pytest.approx(eigenvalues.min(), rel=1e-9)


def test_an_indefinite_inertia_matrix_is_told() -> None:
    robot = didim.load_robot("planar2")
    x = robot.sets["reference"].copy()
    x[robot.parameter_names.index("Ia2")] = -10.0
    rest = np.zeros((3, 2))
    with pytest.raises(didim.errors.IndefiniteError, match=r"not positive definite at sample 1: .* joint 2"):
        didim.direct_dynamics(robot, rest, rest, rest, x)


@settings(max_examples=30)
@given(robot=robots(largest=6), seed=seeds, threads=st.sampled_from([1, 2, 5]))
def test_observation_without_filters_is_the_regressor_joint_by_joint(
    robot: Robot, seed: int, threads: int
) -> None:
    rng = np.random.default_rng(seed)
    motion = random_motion(rng, 11, robot.n_dof)
    columns = list(rng.permutation(len(robot.parameter_names))[:9])
    W = _core.observation(robot.core, motion.q, motion.dq, motion.ddq, columns, [], threads)
    full = didim.regressor(robot, motion.q, motion.dq, motion.ddq)
    expected = full.transpose(1, 0, 2).reshape(-1, full.shape[2])[:, columns]
    np.testing.assert_array_equal(W, expected)


def test_the_bits_do_not_depend_on_the_number_of_threads() -> None:
    robot = didim.load_robot("tx40")
    motion = random_motion(np.random.default_rng(1), 400, 6)
    from didim.signal.filters import decimation_stages
    from didim.signal.processing import SignalProcessing

    stages = decimation_stages(400, SignalProcessing(decimation=(5,)))
    columns = list(robot.base_parameters.indices)
    one, two, seven = (
        _core.observation(robot.core, motion.q, motion.dq, motion.ddq, columns, stages, threads)
        for threads in (1, 2, 7)
    )
    assert one.tobytes() == two.tobytes() == seven.tobytes()


def test_coupled_wrist_is_equation_23_and_24() -> None:
    robot = didim.load_robot("tx40")
    names = {name: index for index, name in enumerate(robot.parameter_names)}
    motion = random_motion(np.random.default_rng(2), 50, 6)
    W = didim.regressor(robot, motion.q, motion.dq, motion.ddq)
    dq5, dq6 = motion.dq[:, 4], motion.dq[:, 5]
    np.testing.assert_allclose(W[:, 4, names["Ia6"]], motion.ddq[:, 5], rtol=1e-14)
    np.testing.assert_allclose(W[:, 5, names["Ia6"]], motion.ddq[:, 4] + motion.ddq[:, 5], rtol=1e-14)
    np.testing.assert_allclose(W[:, 4, names["Fvm6"]], dq6, rtol=1e-12)
    np.testing.assert_allclose(W[:, 5, names["Fvm6"]], dq5, rtol=1e-12)
    shaft = np.sign(dq5 + dq6)
    np.testing.assert_array_equal(W[:, 4, names["Fcm6"]], shaft)
    np.testing.assert_array_equal(W[:, 5, names["Fcm6"]], shaft - np.sign(dq6))
    # The printed form differs on joint 5 only.
    printed = didim.regressor(robot.with_friction(coupling="printed"), motion.q, motion.dq, motion.ddq)
    np.testing.assert_array_equal(printed[:, 4, names["Fcm6"]], np.sign(dq6))
    np.testing.assert_array_equal(printed[:, 5], W[:, 5])


@pytest.mark.parametrize("order", ["C", "F", "strided"])
def test_memory_order_makes_no_difference(order: str) -> None:
    robot = didim.load_robot("planar2")
    motion = random_motion(np.random.default_rng(3), 9, 2)
    x = random_parameters(np.random.default_rng(4), robot)
    expected = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    laid = np.asarray(motion.q, order="F" if order == "F" else "C")
    q = np.repeat(motion.q, 2, axis=0)[::2] if order == "strided" else laid
    np.testing.assert_array_equal(didim.inverse_dynamics(robot, q, motion.dq, motion.ddq, x), expected)


@pytest.mark.parametrize("samples", [0, 1, 3, 4, 5])
def test_any_number_of_samples(samples: int) -> None:
    robot = didim.load_robot("planar2")
    motion = random_motion(np.random.default_rng(5), 8, 2)
    whole = didim.regressor(robot, motion.q, motion.dq, motion.ddq)
    part = didim.regressor(robot, motion.q[:samples], motion.dq[:samples], motion.ddq[:samples])
    np.testing.assert_array_equal(part, whole[:samples])


def test_wrong_arrays_are_told() -> None:
    robot = didim.load_robot("tx40")
    rest = np.zeros((10, 6))
    x = np.zeros(86)
    with pytest.raises(didim.errors.ShapeError, match=r"q must have shape .* got \(6, 10\); transpose it\?"):
        didim.inverse_dynamics(robot, rest.T, rest, rest, x)
    with pytest.raises(
        didim.errors.ShapeError, match=r"dq must have the shape of q, \(10, 6\), got \(9, 6\)"
    ):
        didim.regressor(robot, rest, rest[:9], rest)
    with pytest.raises(didim.errors.ShapeError, match=r"lift them"):
        didim.inverse_dynamics(robot, rest, rest, rest, np.zeros(60))
    bad = rest.copy()
    bad[3, 2] = np.nan
    with pytest.raises(didim.errors.ShapeError, match="ddq is NaN at sample 4, column 3"):
        didim.regressor(robot, rest, rest, bad)
    x[4] = np.inf
    with pytest.raises(didim.errors.ShapeError, match="inf for parameter YZ1"):
        didim.inverse_dynamics(robot, rest, rest, rest, x)
    with pytest.raises(didim.errors.ShapeError, match="array of real numbers"):
        didim.regressor(robot, [["a"] * 6], rest, rest)
