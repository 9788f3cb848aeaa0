"""Trees: models against Pinocchio, base parameters against the numerical rank, and the way from file to estimate."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import didim
from didim.cli.main import main
from didim.log.recording import Recording
from didim.loop.outcome import SimulationStatus
from didim.model.kinematics import frames
from didim.robot.payload import Payload, payload_columns
from didim.robot.placement import as_row, carriers, placed
from didim.robot.rigid_body import pose, turn
from didim.robot.robot_text import robot_text
from didim.studies.loads.payload import identify_payload
from didim.studies.loads.residual import residual_torques
from didim.terms.rows import LinearSystem, stacked
from robots import random_motion, relative
from simulated import closed_loop_log, experiment, log
from urdfs import (
    legs,
    made,
    nasty_tree,
    pinocchio_model,
    pinocchio_torques,
    random_tree,
    with_rotors,
)

TREES = 3 * 39
"""Random trees that are compared with Pinocchio."""


@pytest.mark.parametrize("seed", range(TREES))
def test_random_trees_have_the_models_of_pinocchio(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    text = random_tree(rng, 2 + seed % 39)
    gravity = rng.normal(size=3) * 5.0
    robot = made(tmp_path, text, gravity=gravity.tolist())
    n = robot.n_dof
    assert n == 2 + seed % 39
    model = pinocchio_model(text, robot.joint_names)
    model.gravity.linear = gravity
    x, places = with_rotors(rng, robot, model, robot.joint_names)
    data = model.createData()
    motion = random_motion(rng, 3, n)
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    W = didim.regressor(robot, motion.q, motion.dq, motion.ddq)
    M = didim.inertia_matrix(robot, motion.q, x)
    ddq = didim.direct_dynamics(robot, motion.q, motion.dq, tau, x)
    for k in range(3):
        q, dq, acceleration = np.zeros(n), np.zeros(n), np.zeros(n)
        q[places], dq[places], acceleration[places] = motion.q[k], motion.dq[k], motion.ddq[k]
        expected = pin.rnea(model, data, q, dq, acceleration)[places]
        inertia = pin.crba(model, data, q)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        found = pin.aba(model, data, q, dq, pin.rnea(model, data, q, dq, acceleration))[places]
        assert relative(tau[k] - expected, expected) < 1e-9
        assert relative(W[k] @ x - expected, expected) < 1e-9
        assert relative(M[k] - inertia[np.ix_(places, places)], inertia) < 1e-9
        assert relative(ddq[k] - found, found) < 1e-9


# Trees 42 and 386 have coefficients of 6e-8; at 386 two symbols that cancel lie as near.
@pytest.mark.parametrize("seed", [*range(40), 42, 386])
def test_base_parameters_are_as_many_as_the_numerical_rank_says(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    robot = made(tmp_path, random_tree(rng, 2 + seed % 13), gravity=(rng.normal(size=3) * 5.0).tolist())
    base = robot.base_parameters
    n, p = robot.n_dof, len(robot.parameter_names)
    motion = random_motion(rng, 2 * p // n + 20, n)
    W = didim.regressor(robot, motion.q, motion.dq, motion.ddq).reshape(-1, p)
    norms = np.linalg.norm(W, axis=0)
    # Columns of rounding alone are zero, and must not be scaled to the size of the others.
    seen = norms > 1e-12 * norms.max()
    values = np.linalg.svd(W[:, seen] / norms[seen], compute_uv=False)
    assert len(base.names) == int((values > 1e-9 * values[0]).sum())
    x = rng.normal(size=p)
    assert relative(W[:, base.indices] @ base.project(x) - W @ x, W @ x) < 1e-9


def test_legs_regroup_as_legs_by_themselves(tmp_path: Path) -> None:
    four, one = made(tmp_path, legs(4, 3)), made(tmp_path, legs(1, 3))
    assert four.geometry.parents == (None, 0, 1, None, 3, 4, None, 6, 7, None, 9, 10)
    assert one.geometry.parents == (None, 0, 1)
    assert len(four.base_parameters.names) == 4 * len(one.base_parameters.names)


def test_no_torque_of_a_branch_depends_on_another(tmp_path: Path) -> None:
    robot = made(tmp_path, legs(4, 3))
    rng = np.random.default_rng(0)
    motion = random_motion(rng, 4, 12)
    W = didim.regressor(robot, motion.q, motion.dq, motion.ddq)
    for row in range(12):
        for joint in range(12):
            if row not in carriers(robot.geometry.parents, joint):
                assert not W[:, row, 14 * joint : 14 * joint + 14].any()
    M = didim.inertia_matrix(robot, motion.q, robot.parameter_set("urdf"))
    assert not M[:, :3, 3:].any()
    assert np.abs(M[:, :3, :3]).min() > 0.0


@pytest.mark.parametrize("seed", range(40))
def test_descriptions_as_people_write_them_have_the_models_of_pinocchio(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    nasty, clean = nasty_tree(rng, 2 + seed % 50)
    robot = made(tmp_path, nasty)
    motion = random_motion(rng, 5, robot.n_dof)
    model = pinocchio_model(clean, robot.joint_names)
    expected = pinocchio_torques(model, robot.joint_names, motion.q, motion.dq, motion.ddq)
    x = robot.parameter_set("urdf")
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    assert relative(tau - expected, expected) < 1e-9
    # The other tree of the file is there, and left out.
    assert ("loose leaf" in nasty) == any("no joint holds loose" in note for note in robot.notes)


def test_frames_of_trees_are_those_of_pinocchio(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    text = random_tree(rng, 9)
    robot = made(tmp_path, text)
    model = pinocchio_model(text, robot.joint_names)
    data = model.createData()
    q = random_motion(rng, 1, 9).q
    values = np.zeros(9)
    ids = [model.getJointId(name) for name in robot.joint_names]
    values[[model.joints[index].idx_q for index in ids]] = q[0]
    pin.framesForwardKinematics(model, data, values)
    found = frames(robot, q)[0]
    assert robot.correspondence is not None
    for joint, link in enumerate(robot.correspondence.links):
        expected = data.oMf[model.getFrameId(link.link)].homogeneous
        ours = robot.correspondence.base_matrix @ found[joint + 1] @ link.matrix
        np.testing.assert_allclose(ours, expected, atol=1e-12)


def test_a_tree_comes_back_from_its_robot_file(tmp_path: Path) -> None:
    robot = made(tmp_path, random_tree(np.random.default_rng(7), 11))
    path = tmp_path / "tree.toml"
    path.write_text(robot_text(robot))
    again = didim.load_robot(path)
    assert again.geometry == robot.geometry
    assert again.joint_names == robot.joint_names
    assert again.correspondence == robot.correspondence
    np.testing.assert_array_equal(again.parameter_set("urdf"), robot.parameter_set("urdf"))


@pytest.mark.parametrize("seed", range(30))
def test_any_placement_is_a_row(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    angle = [0.0, 1e-13, 1e-9, 1e-5, 0.3, np.pi, np.pi - 1e-9, 2.0][seed % 8]
    first = turn(np.array([0.0, 0.0, 1.0]), rng.uniform(-3.0, 3.0))
    axis[2] *= seed % 3
    rotation = first @ turn(axis / np.linalg.norm(axis), angle)
    placement = pose(rotation, rng.normal(size=3))
    mount, alpha, theta = as_row(placement, None)
    np.testing.assert_allclose(placed(mount, (alpha, 0.0, theta, 0.0)), placement, atol=3e-12)


ROWS = """
schema = 1
[[joint]]
kind = "revolute"
[[joint]]
kind = "revolute"
alpha_deg = -90
d_m = 0.3
[[joint]]
kind = "revolute"
antecedent = 1
gamma_deg = 90
b_m = 0.2
alpha_deg = 90
d_m = 0.4
"""
"""Two arms of one link each on a turntable: rows of Khalil and Kleinfinger with gamma and b."""


def test_rows_of_trees_group_by_the_rules_of_gautier_and_khalil(tmp_path: Path) -> None:
    path = tmp_path / "rows.toml"
    path.write_text(ROWS)
    robot = didim.load_robot(path)
    assert robot.geometry.parents == (None, 0, 0)
    # Masses and first moments along the axes of both arms act as an inertia of the turntable.
    assert robot.base_parameters.groupings[0] == (
        "ZZ1R = ZZ1 + Ia1 + YY2 + d2^2 M2 + YY3 + d3^2 M3"
    )  # fmt: skip
    assert "ZZ2R = ZZ2 + Ia2" in robot.base_parameters.groupings
    assert "XX2R = XX2 - YY2" in robot.base_parameters.groupings


DISTAL = """
schema = 1
convention = "dh"
[[joint]]
kind = "revolute"
a_m = 0.1
d_m = 0.2
antecedent = 0
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("antecedent = 1", "antecedent = 3", "antecedent must be a joint before this one, 0 for the base, got 3"),
        (
            "antecedent = 1",
            "antecedent = 1\n[[joint]]\nkind = 'revolute'\nantecedent = 2",
            "joint 4 stands on joint 2, whose branch has ended before: number the joints branch by branch",
        ),
        (ROWS, DISTAL, "antecedent is for modified rows, and this table is a standard one (convention = 'dh')"),
    ],
)  # fmt: skip
def test_wrong_trees_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "rows.toml"
    path.write_text(ROWS.replace(old, new))
    with pytest.raises(didim.errors.RobotError) as error:
        didim.load_robot(path)
    assert message in str(error.value)
    assert len(str(error.value)) <= 200


def test_a_tree_is_identified_by_torques_and_by_simulation(tmp_path: Path) -> None:
    robot = made(tmp_path, legs(3, 3))
    x = robot.parameter_set("urdf").copy()
    for j in range(robot.n_dof):
        x[[robot.parameter_names.index(f"{key}{j + 1}") for key in ("Ia", "Fv", "Fc")]] = 0.3, 0.5, 0.2
    truth = robot.base_parameters.project(x)
    fit = didim.identify(experiment(robot, log(robot, x, n_samples=2000)), didim.IDIMLS())
    np.testing.assert_allclose(fit.beta, truth, atol=1e-9)
    n = robot.n_dof
    controller = didim.Controller.pd([900.0] * n, [60.0] * n)
    reference = didim.Reference.sampled(_swing(n), rate_hz=200)
    simulation = didim.simulate(robot, x, reference, controller, step=1e-3)
    assert simulation.status is SimulationStatus.COMPLETED
    # The simulation follows the inverse model: its own torques give its own accelerations.
    again = didim.inverse_dynamics(robot, simulation.q, simulation.dq, simulation.ddq, x)
    assert relative(again - simulation.tau, simulation.tau) < 1e-6


def _swing(n: int) -> np.ndarray:
    t = np.arange(600) / 200
    return np.asarray(0.3 * np.sin(2.0 * np.pi * (0.3 + 0.1 * np.arange(n)) * t[:, None]) * (t[:, None] > 0))


def test_every_method_gives_the_parameters_of_a_tree_back(tmp_path: Path) -> None:
    robot = made(tmp_path, legs(2, 2)).with_friction(smoothing_rad_s=0.02, coulomb="tanh")
    x = robot.parameter_set("urdf").copy()
    for j in range(robot.n_dof):
        x[[robot.parameter_names.index(f"{key}{j + 1}") for key in ("Ia", "Fv", "Fc")]] = 0.3, 0.5, 0.2
    recorded = closed_loop_log(robot, x, torque_noise=1e-3)
    truth = robot.base_parameters.project(x)
    scale = np.abs(truth).max()
    for method, tolerance in (
        (didim.IDIMLS(), 2e-2),
        (didim.DIDIM(physical=False), 2e-3),
        (didim.CLOE(optimizer="levenberg-marquardt", start=1.1 * truth), 2e-2),
    ):
        fit = didim.identify(recorded, method)
        assert fit.converged, (method, fit.status)
        assert np.abs(fit.beta - truth).max() < tolerance * scale, method


@pytest.mark.slow
def test_a_load_on_a_limb_is_found_with_and_without_a_table(tmp_path: Path) -> None:
    robot = made(tmp_path, legs(2, 3)).with_friction(smoothing_rad_s=0.02, coulomb="tanh")
    x = robot.parameter_set("urdf").copy()
    for j in range(robot.n_dof):
        x[[robot.parameter_names.index(f"{key}{j + 1}") for key in ("Ia", "Fv", "Fc")]] = 0.3, 0.5, 0.2
    foot = Payload(name="foot", link="leg1_2")
    load = payload_columns(robot, foot) @ np.array([0.01, 0.0, 0.0, 0.01, 0.0, 0.01, 0.02, 0.01, -0.06, 0.8])
    free, loaded = (closed_loop_log(robot, values, torque_noise=1e-2) for values in (x, x + load))
    fit = didim.identify(free, didim.IDIMLS())
    alone = identify_payload(fit, loaded, link="leg1_2")
    assert alone.frame == "link leg1_2"
    assert alone.mass_kg == pytest.approx(0.8, abs=max(0.02, 4.0 * alone.std[9]))
    (window,) = residual_torques(fit, loaded).windows
    assert window.payload_change is not None
    assert window.payload_change.link == "leg1_2_joint"
    (first,), (second,) = (log.recordings for log in (free, loaded))
    records = (replace(first, name="free"), replace(second, name="loaded"))
    both = replace(free, recordings=records)
    # Nobody declares the load: the fit of both logs blames the foot of its limb.
    undeclared = didim.identify(both, didim.IDIMLS())
    (finding,) = (reason for reason in undeclared.evidence if reason.code == "payload")
    assert finding.recordings == ("loaded",)
    assert "joint 6 (leg1_2_joint)" in finding.facts["text"]
    declared = replace(
        both, recordings=(records[0], replace(records[1], payload="foot")), payloads={"foot": foot}
    )
    for method in (didim.IDIMLS(), didim.DIDIM(physical=False), didim.CLOE(start="idim-ls")):
        fit = didim.identify(declared, method)
        assert fit.converged, method
        assert fit.further is not None
        number = [name for block in fit.further.blocks for name in block.full_names].index("foot.M")
        assert "payload 'foot', on link leg1_2" in str(fit)
        assert abs(fit.further.values[number] - 0.8) < max(0.02, 4.0 * fit.further.std[number]), method


def test_a_tree_may_be_taken_in_part(tmp_path: Path) -> None:
    path = tmp_path / "legs.urdf"
    path.write_text(legs(4, 3))
    whole = didim.load_robot(path)
    assert whole.n_dof == 12
    leg = didim.load_robot(path, tip="leg2_2")
    assert leg.joint_names == ("leg2_0_joint", "leg2_1_joint", "leg2_2_joint")
    locked = didim.load_robot(path, lock={"leg0_0_joint": 0.3, "leg1_2_joint": -0.1})
    assert locked.n_dof == 10
    assert locked.geometry.parents[:3] == (None, 0, None)


@pytest.mark.slow
def test_tiago_without_its_wheels(shared: Path) -> None:
    path = shared / "data" / "tiago" / "tiago_48_hey5.urdf"
    assert didim.load_robot(path).n_dof == 58
    text = path.read_text()
    names = re.findall(
        r'<joint name="((?:wheel|suspension|caster|hand_\w+_virtual)_\w+)" type="(?!fixed)', text
    )
    robot = didim.load_robot(path, lock=dict.fromkeys(names, 0.0))
    assert len(names) > 18
    assert robot.n_dof == 58 - len(names)
    assert {"torso_lift_joint", "head_2_joint", "arm_7_joint", "hand_thumb_flex_2_joint"} < set(
        robot.joint_names
    )
    motion = random_motion(np.random.default_rng(0), 5, robot.n_dof)
    model = pinocchio_model(text, robot.joint_names)
    expected = pinocchio_torques(model, robot.joint_names, motion.q, motion.dq, motion.ddq)
    x = robot.parameter_set("urdf").copy()
    x[[name.startswith("F") for name in robot.parameter_names]] = 0.0
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    assert relative(tau - expected, expected) < 1e-9


def test_a_tree_is_described_with_what_its_joints_stand_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf, toml = tmp_path / "legs.urdf", tmp_path / "legs.toml"
    urdf.write_text(legs(2, 3))
    assert main(["robot", str(urdf), "-o", str(toml)]) == 0
    assert "legs: 6 joints in the tree on trunk, " in capsys.readouterr().out
    assert main(["robot", str(toml)]) == 0
    out = capsys.readouterr().out
    assert "antecedent" in out
    on = [line.split()[7] for line in out.splitlines() if "revolute" in line]
    assert on == ["base", "1", "2", "base", "4", "5"]


@pytest.mark.slow
def test_the_page_on_trees_is_run(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (project / "docs" / "mechanisms.md").read_text(encoding="utf-8")
    robot, planned, *_ = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    block, *_ = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    (tmp_path / "dual.toml").write_text(robot)
    (tmp_path / "dual_log.toml").write_text(planned)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(block, names)
    out = capsys.readouterr().out
    limbs = ("waist", "left_shoulder to left_elbow", "right_shoulder to right_elbow")
    places = [out.index(f"\n{title}:\n") for title in limbs]
    assert places == sorted(places)
    log, truth = names["log"], names["robot"].set_base("truth")
    cloe = didim.CLOE(optimizer="levenberg-marquardt", start=names["fit"].beta)
    for method in (didim.IDIMLS(), didim.DIDIM(), cloe):
        fit = didim.identify(log, method)
        assert fit.converged, method
        assert np.abs(fit.beta - truth).max() < 3e-2 * np.abs(truth).max(), method


LEG = """<body name="{leg}_hip" pos="{x} {y} 0"><joint name="{leg}_hip_joint" axis="1 0 0"/>
<inertial pos="0 0.02 0.01" mass="0.7" diaginertia="0.001 0.002 0.001"/>
<body name="{leg}_thigh" pos="0 0.08 0"><joint name="{leg}_thigh_joint" axis="0 1 0"/>
<inertial pos="0.01 0.02 -0.03" mass="1.1" diaginertia="0.006 0.006 0.001"/>
<body name="{leg}_calf" pos="0 0 -0.2"><joint name="{leg}_calf_joint" axis="0 1 0"/>
<inertial pos="0.006 0.001 -0.12" mass="0.3" diaginertia="0.0015 0.0015 0.0001"/>
<body name="{leg}_foot" pos="0 0 -0.2"/></body></body></body>"""


@pytest.mark.slow
@pytest.mark.usefixtures("without_laws")
def test_the_commands_of_legs_in_the_air(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a twin of the page's robot: twelve joints, trunk held, and a leg alone with the errors that it has in the whole."""
    page = (project / "docs" / "mechanisms.md").read_text(encoding="utf-8")
    section = page.partition("## Legs in the air")[2].partition("\n## ")[0]
    commands = [
        line.partition("#")[0].split() for line in re.findall(r"^    didim (.*)$", section, re.MULTILINE)
    ]
    (option, tip) = re.findall(r"`(--tip) (\w+)`", section)[0]
    names = [f"{end}{side}" for end in "FR" for side in "LR"]
    bodies = "".join(
        LEG.format(leg=name, x=0.2 - 0.4 * (name[0] == "R"), y=0.05 - 0.1 * (name[1] == "R"))
        for name in names
    )
    monkeypatch.chdir(tmp_path)
    Path("go2.xml").write_text(
        '<mujoco model="go2"><default><joint armature="0.01" damping="0.6" frictionloss="0.2"/></default><worldbody>'
        f'<body name="trunk"><freejoint/><inertial pos="0 0 0" mass="6" diaginertia="0.1 0.1 0.1"/>{bodies}</body>'
        "</worldbody></mujoco>"
    )
    robot = didim.load_robot("go2.xml")
    made_log = log(robot, robot.parameter_set("mjcf"), n_samples=3000, noise=0.02)
    assert made_log.tau is not None
    header = ["time", *(f"{signal}_{joint}" for signal in ("q", "tau") for joint in robot.joint_names)]
    time = np.arange(len(made_log.q)) / made_log.rate_hz
    table = np.column_stack([time, made_log.q, made_log.tau])
    np.savetxt("log.csv", table, delimiter=",", header=",".join(header), comments="", fmt="%.9g")
    assert [words[0] for words in commands] == ["init", "check", "identify"]
    codes = [main(words) for words in [*commands[:2], [*commands[2], "--json", "whole.json"]]]
    assert codes[0] == 0
    assert "floating" in capsys.readouterr().err
    whole = didim.Identification.load("whole.json")
    assert whole.joint_names == robot.joint_names
    truth = dict(zip(robot.base_parameters.names, robot.set_base("mjcf"), strict=True))
    errors = (whole.beta - [truth[name] for name in whole.names]) / whole.std
    assert np.abs(errors).max() < 5.0
    assert main([*commands[0][:-1], "leg.toml", option, tip]) == 0
    main(["identify", "leg.toml", "--json", "leg.json"])
    leg = didim.Identification.load("leg.json")
    assert leg.joint_names == robot.joint_names[:3]
    assert 4 * len(leg.names) == len(whole.names)
    np.testing.assert_allclose(leg.relative_error, whole.relative_error[:3], rtol=0.05)


def test_legs_in_the_air_are_solved_one_by_one(tmp_path: Path) -> None:
    four = made(tmp_path, legs(4, 3))
    x = four.parameter_set("urdf")
    whole = experiment(four, log(four, x, n_samples=2000, noise=0.1))
    fit = didim.identify(whole, didim.IDIMLS())
    system = LinearSystem(
        w=np.asarray(np.kron(np.eye(4), np.ones((6, 2))), dtype=np.float64),
        y=np.zeros(24),
        blocks=stacked(12, [2]),
        names=tuple("abcdefgh"),
    )
    assert [columns.tolist() for _, columns in system.parts] == [[0, 1], [2, 3], [4, 5], [6, 7]]
    parameters = len(fit.beta) // 4
    for leg in range(4):
        own, block = slice(3 * leg, 3 * leg + 3), slice(parameters * leg, parameters * (leg + 1))
        assert not np.delete(fit.covariance, np.arange(block.start, block.stop), axis=1)[block].any()
        # A robot that is this leg alone, with rows of its own, explains its torques as well.
        alone = didim.load_robot(tmp_path / "tree.urdf", tip=f"leg{leg}_2")
        measured = whole.recordings[0]
        assert measured.tau is not None
        part = Recording.from_arrays(measured.q[:, own], measured.tau[:, own], rate_hz=measured.rate_hz)
        by_itself = didim.identify(experiment(alone, part), didim.IDIMLS())
        assert len(by_itself.beta) == parameters
        np.testing.assert_allclose(by_itself.relative_error, fit.relative_error[own], rtol=1e-7)


@pytest.mark.slow
def test_tiago_by_its_three_files(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shared / "data" / "tiago"
    files = [str(folder / f"tiago_{name}.csv") for name in ("effort", "position", "velocity")]
    monkeypatch.chdir(tmp_path)
    assert main(["init", str(folder / "tiago_48_hey5.urdf"), *files, "-o", "tiago.toml"]) == 0
    assert "the robot with 8 joints whose chain was chosen" in capsys.readouterr().out
    assert main(["check", "tiago.toml"]) in (0, 1)
    out = capsys.readouterr().out
    assert "torque-sign" not in out  # the plain fit gets worse with every turned sign
    assert "spikes" in out
    main(["identify", "tiago.toml", "--json", "tiago.json"])
    fit = didim.Identification.load("tiago.json")
    assert fit.joint_names == ("torso_lift_joint", *(f"arm_{j}_joint" for j in range(1, 8)))
    assert fit.overall_relative_error < 0.6
    low, high = fit.confidence_interval(0.95)
    assert len(fit.beta) == 73
    assert np.isfinite(low).all()
    assert (low < fit.beta).all()
    assert (fit.beta < high).all()
    # Efforts of the wrist that are zero for most of the log explain nothing: the verdict says so.
    assert str(fit.verdict.state) != "sound"
    # They are currents: with the published constants of the motors friction brakes, and gravity is that of the URDF.
    text, count = re.subn(
        r'unit = \["N", .*',
        'unit = "A"\ngain = [1, 13.6, 13.6, -8.7, -8.7, -20.6, -20.6, -20.6]',
        Path("tiago.toml").read_text(),
    )
    assert count == 1
    Path("tiago.toml").write_text(text)
    log = didim.load_experiment("tiago.toml")
    with_gains = didim.identify(log, didim.IDIMLS())
    assert with_gains.overall_relative_error < 0.45 * fit.overall_relative_error
    arm = [name for name in fit.names if re.fullmatch("F[vc][2-5]", name)]
    assert len(arm) == 8
    assert all(with_gains.beta[with_gains.names.index(name)] > 0.0 for name in arm)
    place = with_gains.names.index("MY5R")
    low, high = with_gains.confidence_interval(0.95)
    assert (
        low[place] < log.robot.set_base("urdf")[log.robot.base_parameters.names.index("MY5R")] < high[place]
    )
    assert str(with_gains.verdict.state) == "doubtful"
