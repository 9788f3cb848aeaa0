"""Base parameters (7): the names of Table II, groupings, and torques that do not change."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import didim
import simulated
from didim.robot.friction import STANDARD_NAMES, FrictionTerm
from didim.robot.robot import Geometry, Robot
from didim.signal.filters import differentiate
from robots import make_robot, random_motion, random_parameters, relative, robots, slow_motion

# Joint by joint, in our order: that of (3), with the friction of coupled motors last.
TABLE_2 = " ".join(
    [
        "ZZ1R Fv1 Fc1 Off1 XX2R XY2 XZ2R YZ2 ZZ2R MX2R MY2 Fv2 Fc2 Off2 XX3R XY3 XZ3 YZ3 ZZ3R MX3 MY3R Ia3",
        "Fv3 Fc3 Off3 XX4R XY4 XZ4 YZ4 ZZ4R MX4 MY4R Ia4 Fv4 Fc4 Off4 XX5R XY5 XZ5 YZ5 ZZ5R MX5 MY5R Ia5 Fv5",
        "Fc5 Off5 XX6R XY6 XZ6 YZ6 ZZ6 MX6 MY6 Ia6 Fv6 Fc6 Off6 Fvm6 Fcm6",
    ]
).split()


def test_the_tx40_has_the_60_of_table_2() -> None:
    robot = didim.load_robot("tx40")
    assert len(robot.parameter_names) == 86
    assert len(TABLE_2) == 60
    assert list(robot.base_parameters.names) == TABLE_2


def test_the_names_are_those_of_the_reference_table(shared: Path) -> None:
    with (shared / "reference" / "table2.csv").open() as file:
        names = [row["name"] for row in csv.DictReader(file)]
    assert len(set(names)) == 60
    # Joint by joint as printed; Table II alone puts Off6 behind the friction of the coupled motors.
    assert names[-3:] == ["Fvm6", "Fcm6", "Off6"]
    assert list(didim.load_robot("tx40").base_parameters.names) == [*names[:-3], "Off6", "Fvm6", "Fcm6"]


def test_standard_parameters_know_their_kind_joint_and_side() -> None:
    asymmetric = didim.load_robot("tx40").with_friction(model="asymmetric")
    own = FrictionTerm.from_function("My2", 5, lambda speed: speed, fastest=1.0)
    robot = asymmetric.with_terms([own])
    assert tuple(parameter.name for parameter in robot.standard_parameters) == robot.parameter_names
    assert {("XX", 0, ""), ("Fc", 2, "+"), ("Fv", 5, "-"), ("Fcm", 5, ""), ("My2", 5, "")} <= set(
        robot.standard_parameters
    )
    kinds = {parameter.kind for parameter in robot.standard_parameters}
    # Asymmetric friction has the offset in its sides.
    assert kinds == {*STANDARD_NAMES, "Fvm", "Fcm", "My2"} - {"Off"}


def test_groupings_of_the_tx40_are_sums_of_symbols() -> None:
    base = didim.load_robot("tx40").base_parameters
    groupings = dict(zip(base.names, base.groupings, strict=True))
    assert groupings["ZZ2R"] == "ZZ2R = ZZ2 + Ia2 + d3^2 M3 + d3^2 M4 + d3^2 M5 + d3^2 M6"
    assert groupings["MY3R"] == "MY3R = MY3 - MZ4 - r4 M4 - r4 M5 - r4 M6"
    assert groupings["XX6R"] == "XX6R = XX6 - YY6"
    assert "2 r3 MZ3" in groupings["ZZ1R"]
    assert not any("." in text for text in base.groupings)


def test_random_base_values_lifted_leave_the_torques_unchanged() -> None:
    robot = didim.load_robot("tx40")
    base = robot.base_parameters
    rng = np.random.default_rng(0)
    motion = random_motion(rng, 50, 6)
    x = random_parameters(rng, robot)
    beta = base.project(x)
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    lifted = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, base.lift(beta))
    assert relative(lifted - tau, tau) < 1e-10
    random_beta = rng.uniform(-1, 1, 60)
    np.testing.assert_allclose(base.project(base.lift(random_beta)), random_beta, rtol=1e-14)


@settings(max_examples=60)
@given(robot=robots(largest=7, terms=True), seed=st.integers(0, 2**32 - 1))
def test_regrouping_leaves_the_torques_of_any_robot_unchanged(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    base = robot.base_parameters
    motion = slow_motion(rng, 20, robot)
    x = random_parameters(rng, robot)
    # Both have the load of the first: that of the second is the same up to rounding, and its sign near zero is not.
    W = didim.regressor(robot, motion.q, motion.dq, motion.ddq, x=x)
    tau = W @ x
    assert relative(W @ base.lift(base.project(x)) - tau, tau) < 1e-8


def rank(robot: Robot) -> int:
    """Return the rank of the regressor by singular values, over states that no base parameter was found on."""
    rng = np.random.default_rng(7)
    motion = slow_motion(rng, 400, robot)
    W = didim.regressor(robot, motion.q, motion.dq, motion.ddq, x=random_parameters(rng, robot))
    flat = W.reshape(-1, W.shape[2])
    norms = np.linalg.norm(flat, axis=0)
    scaled = flat[:, norms > 1e-9] / norms[norms > 1e-9]
    return int(np.linalg.matrix_rank(scaled, tol=1e-7))


@settings(max_examples=40)
@given(robot=robots(largest=6, terms=True))
def test_the_count_is_the_rank_of_random_states(robot: Robot) -> None:
    assert len(robot.base_parameters.names) == rank(robot)


SLIDES = ("P", "RRPR", "PRPRRRR")
"""A lift, an arm with a slide, and one on a rail: their slides are along gravity in every second draw with right angles."""


@settings(max_examples=40)
@given(robot=robots(terms=True, shapes=SLIDES))
def test_slides_have_the_rank_of_their_friction(robot: Robot) -> None:
    assert len(robot.base_parameters.names) == rank(robot)


@pytest.mark.slow
@settings(max_examples=200)
@given(robot=robots(terms=True, shapes=SLIDES))
def test_two_hundred_slides_have_the_rank_of_their_friction(robot: Robot) -> None:
    assert len(robot.base_parameters.names) == rank(robot)


def test_what_no_motion_shows_is_named() -> None:
    assert didim.load_robot("emps").base_parameters.unidentifiable == (
        *("XX1", "XY1", "XZ1", "YY1", "YZ1", "ZZ1", "MX1", "MY1", "MZ1"),
    )
    assert "M2" in didim.load_robot("tx40").base_parameters.unidentifiable


def test_wrong_lengths_are_told() -> None:
    base = didim.load_robot("emps").base_parameters
    with pytest.raises(didim.errors.ShapeError, match=r"beta must have shape \(4,\), got \(3,\)"):
        base.lift(np.zeros(3))
    with pytest.raises(didim.errors.ShapeError, match=r"x must have shape \(14,\), got \(4,\)"):
        base.project(np.zeros(4))


def test_twelve_bent_joints_are_no_trouble() -> None:
    """Without a right angle there are thousands of products of symbols; the search must not try them all."""
    n = 12
    rng = np.random.default_rng(3)
    geometry = Geometry(
        kinds=("revolute",) * n,
        alpha=tuple(rng.uniform(0.3, 1.2, n).tolist()),
        d=tuple(rng.uniform(0.1, 0.9, n).tolist()),
        theta=(0.0,) * n,
        r=tuple(rng.uniform(0.1, 0.9, n).tolist()),
        gravity=(0.0, 0.0, -9.81),
        coupling=tuple(tuple(row) for row in np.eye(n).tolist()),
    )
    base = make_robot(geometry).base_parameters
    groupings = dict(zip(base.names, base.groupings, strict=True))
    assert groupings["MX11R"] == "MX11R = MX11 + d12 M12"
    assert groupings["ZZ11R"].endswith("2 r12 sin(alpha12)^2 MZ12 + (d12^2 + r12^2 sin(alpha12)^2) M12")


def up_and_down() -> np.ndarray:
    """Moves of a lift of 12 s with rests between them, sampled as `simulated` has it (m)."""
    t = np.arange(6000) / simulated.RATE_HZ
    q = np.zeros(len(t))
    for start, seconds, height in (
        (0.5, 1.0, 0.4), (2.0, 0.6, -0.3), (3.2, 0.9, 0.5), (4.8, 0.5, -0.4),
        (6.0, 1.2, 0.6), (7.8, 0.7, -0.5), (9.2, 0.8, 0.3), (10.6, 0.8, -0.4),
    ):  # fmt: skip
        u = np.clip((t - start) / seconds, 0.0, 1.0)
        q += height * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return q[:, None]


@pytest.mark.parametrize("zone", [0.001, 0.01])
def test_a_lift_whose_friction_differs_by_direction(zone: float) -> None:
    """Its weight and the two Coulomb frictions are three parameters, for in the dead zone the weight is alone."""
    geometry = Geometry(
        kinds=("prismatic",),
        alpha=(0.0,),
        d=(0.0,),
        theta=(0.0,),
        r=(0.0,),
        gravity=(0.0, 0.0, -9.81),
        coupling=((1.0,),),
    )
    robot = make_robot(geometry, model="asymmetric", dead_zone=(zone,))
    truth = {"M1": 12.0, "Ia1": 8.0, "Fv1+": 60.0, "Fc1+": 25.0, "Fv1-": 40.0, "Fc1-": 15.0}
    assert robot.base_parameters.names == tuple(truth)
    q = up_and_down()
    x = robot.base_parameters.lift(list(truth.values()))
    tau = didim.inverse_dynamics(robot, *differentiate(q, simulated.RATE_HZ, simulated.SIGNAL), x)
    tau += 0.02 * np.sqrt(np.mean(tau**2)) * np.random.default_rng(0).standard_normal(tau.shape)
    log = simulated.experiment(robot, didim.Recording.from_arrays(q, tau, rate_hz=simulated.RATE_HZ))
    fit = didim.identify(log)
    assert fit.overall_relative_error <= 0.009
    assert fit.verdict.sound
    assert not fit.evidence
    assert (np.abs(fit.beta - list(truth.values())) < 4.0 * fit.std).all()
