"""Joints that follow others: models against Pinocchio with ``G^T`` by hand, files in and out, every method on a gripper."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import didim
from didim.errors import RobotError
from didim.export.drives import drives_of
from didim.export.mjcf import to_mjcf
from didim.export.mjcf_edit import edit_mjcf
from didim.export.sdf import to_sdf
from didim.export.urdf import to_urdf
from didim.export.write import FORMATS, export
from didim.model.kinematics import frames
from didim.robot.robot import MOST_JOINTS, Robot
from didim.robot.robot_text import robot_text
from didim.robot.transmission import driven_part, joint_motion
from didim.view.shapes import skeleton
from robots import random_motion, relative
from simulated import closed_loop_log, experiment, log
from urdfs import inertial_text, joint_text, limit_text, made, pinocchio_model, random_tree, with_rotors

pytestmark = pytest.mark.usefixtures("without_verdict")

ROBOTS = 60
"""Random trees with joints that follow others, compared with Pinocchio."""


def coupled(rng: np.random.Generator, joints: int, most: int = 40, even: bool = False) -> str:
    """A random tree, some of whose joints follow others, leaders before and behind them; with `even` factors none is near zero."""
    text = random_tree(rng, joints)
    names = [f"joint_{j}" for j in range(joints)]
    count = min(int(rng.integers(1, max(2, joints // 2))), joints - 1, most)
    chosen = [str(name) for name in rng.choice(names, count, replace=False)]
    leaders = [name for name in names if name not in chosen]
    for k, name in enumerate(chosen):
        # Some follow a joint that follows another one itself.
        leader = chosen[k - 1] if k and rng.random() < 0.2 else str(rng.choice(leaders))
        factor = float(rng.choice([-1.0, 1.0]) * (rng.choice([1.0, 2.0]) if even else rng.uniform(0.2, 2.0)))
        offset = float(rng.normal())
        start = text.index(f'<joint name="{name}"')
        end = text.index("</joint>", start)
        mimic = f'<mimic joint="{leader}" multiplier="{factor!r}" offset="{offset!r}"/>'
        text = text[:end] + mimic + text[end:]
    return text


def without_mimic(text: str) -> str:
    """The same with joints that all move by themselves."""
    return re.sub(r"<mimic [^>]*/>", "", text)


def by_hand(robot: Robot, text: str) -> np.ndarray:
    """``G``, (n_joints, n_dof), from the text of the file alone, with rows in the order of ``robot.all_joint_names``."""
    ties = {}
    for joint in ET.fromstring(text).iter("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            ties[joint.attrib["name"]] = (mimic.attrib["joint"], float(mimic.attrib["multiplier"]))
    g = np.zeros((robot.n_joints, robot.n_dof))
    for row, name in enumerate(robot.all_joint_names):
        factor = 1.0
        while name in ties:
            name, times = ties[name]
            factor *= times
        g[row, robot.joint_names.index(name)] = factor
    return g


@pytest.mark.parametrize("seed", range(ROBOTS))
def test_models_are_those_of_pinocchio_seen_by_the_driven_joints(tmp_path: Path, seed: int) -> None:
    check_models(tmp_path, seed, 2 + seed % 24)


@pytest.mark.parametrize("joints", [58, 91, MOST_JOINTS])
def test_models_of_the_largest_robots_are_those_of_pinocchio(tmp_path: Path, joints: int) -> None:
    """Humanoids with hands whose fingers follow."""
    check_models(tmp_path, joints, joints)


def check_models(tmp_path: Path, seed: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    text = coupled(rng, joints)
    gravity = rng.normal(size=3) * 5.0
    robot = made(tmp_path, text, gravity=gravity.tolist())
    n, driven = robot.n_joints, robot.n_dof
    assert n == joints
    assert driven == n - text.count("<mimic")
    g = by_hand(robot, text)
    model = pinocchio_model(without_mimic(text), robot.all_joint_names)
    model.gravity.linear = gravity
    x, places = with_rotors(rng, robot, model, robot.all_joint_names)
    data = model.createData()
    motion = random_motion(rng, 3, driven)
    followers = robot.geometry.followers
    q = joint_motion(followers, motion.q, position=True)
    dq, ddq = joint_motion(followers, motion.dq), joint_motion(followers, motion.ddq)
    np.testing.assert_allclose(dq, motion.dq @ g.T, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(driven_part(followers, dq), dq @ g, rtol=1e-12, atol=1e-12)
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    W = didim.regressor(robot, motion.q, motion.dq, motion.ddq)
    M = didim.inertia_matrix(robot, motion.q, x)
    back = didim.direct_dynamics(robot, motion.q, motion.dq, tau, x)
    for k in range(3):
        state = [np.zeros(n) for _ in range(3)]
        for values, row in zip(state, (q[k], dq[k], ddq[k]), strict=True):
            values[places] = row
        expected = pin.rnea(model, data, *state)[places] @ g
        inertia = pin.crba(model, data, state[0])
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        inertia = g.T @ inertia[np.ix_(places, places)] @ g
        assert relative(tau[k] - expected, expected) < 1e-9
        assert relative(W[k] @ x - expected, expected) < 1e-9
        assert relative(M[k] - inertia, inertia) < 1e-9
        assert relative(back[k] - motion.ddq[k], motion.ddq[k]) < 1e-8


@pytest.mark.parametrize("seed", range(20))
def test_base_parameters_are_as_many_as_the_numerical_rank_says(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(500 + seed)
    # Few driven joints or small factors leave columns that only rounding tells apart, for any method.
    robot = made(
        tmp_path, coupled(rng, 4 + seed % 6, 2, even=True), gravity=(rng.normal(size=3) * 5.0).tolist()
    )
    base = robot.base_parameters
    n, p = robot.n_dof, len(robot.parameter_names)
    motion = random_motion(rng, 2 * p // n + 20, n)
    W = didim.regressor(robot, motion.q, motion.dq, motion.ddq).reshape(-1, p)
    norms = np.linalg.norm(W, axis=0)
    # Columns that are rounding alone, such as those of a link that its follower keeps from turning, are zero.
    W = W * (norms > 1e-9 * norms.max())
    values = np.linalg.svd(W / np.where(norms > 0.0, norms, 1.0), compute_uv=False)
    assert len(base.names) == int((values > 1e-9 * values[0]).sum())
    x = rng.normal(size=p)
    assert relative(W[:, base.indices] @ base.project(x) - W @ x, W @ x) < 1e-9
    # Friction of a joint that follows is that of its leader.
    assert not {f"Fc{j + 1}" for j in range(n, robot.n_joints)} & set(base.names)


def test_frames_follow_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    text = coupled(rng, 9)
    robot = made(tmp_path, text)
    model = pinocchio_model(without_mimic(text), robot.all_joint_names)
    data = model.createData()
    q = random_motion(rng, 1, robot.n_dof).q
    values = np.zeros(9)
    ids = [model.getJointId(name) for name in robot.all_joint_names]
    all_q = joint_motion(robot.geometry.followers, q, position=True)[0]
    values[[model.joints[index].idx_q for index in ids]] = all_q
    pin.framesForwardKinematics(model, data, values)
    assert robot.correspondence is not None
    for joint, link in enumerate(robot.correspondence.links):
        expected = data.oMf[model.getFrameId(link.link)].homogeneous
        ours = robot.correspondence.base_matrix @ frames(robot, q)[0, joint + 1] @ link.matrix
        np.testing.assert_allclose(ours, expected, atol=1e-12)


def test_a_robot_comes_back_from_its_file_and_goes_back_into_its_urdf(tmp_path: Path) -> None:
    text = coupled(np.random.default_rng(11), 8)
    robot = made(tmp_path, text)
    path = tmp_path / "tree.toml"
    path.write_text(robot_text(robot))
    again = didim.load_robot(path)
    assert again.geometry == robot.geometry
    assert again.all_joint_names == robot.all_joint_names
    assert again.correspondence == robot.correspondence
    x = 1.5 * robot.parameter_set("urdf")
    np.testing.assert_array_equal(again.parameter_set("urdf") * 1.5, x)
    written = to_urdf(again, x, tmp_path / "tree.urdf").decode()
    assert written.count("<mimic") == text.count("<mimic")
    back = made(tmp_path, written)
    np.testing.assert_allclose(back.parameter_set("urdf"), x, rtol=1e-12, atol=1e-12)


def gripper(seed: int = 0) -> str:
    """A wrist of two joints and a hand: one motor closes two fingers and bends the tip of the first."""
    rng = np.random.default_rng(seed)
    parts = [f'<link name="{name}">{inertial_text(rng)}</link>' for name in ("stand", "wrist", "palm")]
    parts += [f'<link name="{name}">{inertial_text(rng)}</link>' for name in ("finger", "tip", "thumb")]
    tip = '<mimic joint="close" multiplier="0.6" offset="0.2"/>'
    thumb = '<mimic joint="close" multiplier="-1"/>'
    parts += [
        joint_text("turn", "revolute", "stand", "wrist", axis=(0, 0, 1), inside=limit_text(rng)),
        joint_text("bend", "revolute", "wrist", "palm", xyz=(0, 0, 0.2), axis=(0, 1, 0), inside=limit_text(rng)),
        joint_text("curl", "revolute", "finger", "tip", xyz=(0, 0, 0.1), axis=(1, 0, 0), inside=limit_text(rng) + tip),
        joint_text("oppose", "revolute", "palm", "thumb", xyz=(0, -0.05, 0.1), axis=(1, 0, 0), inside=limit_text(rng) + thumb),
        joint_text("close", "revolute", "palm", "finger", xyz=(0, 0.05, 0.1), axis=(1, 0, 0), inside=limit_text(rng)),
    ]  # fmt: skip
    return f'<robot name="gripper">{"".join(parts)}</robot>'


@pytest.mark.slow
def test_every_method_gives_the_parameters_of_a_gripper_back(tmp_path: Path) -> None:
    robot = made(tmp_path, gripper()).with_friction(smoothing_rad_s=0.02, coulomb="tanh")
    assert robot.joint_names == ("turn", "bend", "close")
    assert set(robot.all_joint_names[3:]) == {"curl", "oppose"}
    x = robot.parameter_set("urdf").copy()
    for j in range(robot.n_joints):
        drive = (0.3, 0.5, 0.2) if j < robot.n_dof else (0.0, 0.05, 0.02)
        x[[robot.parameter_names.index(f"{key}{j + 1}") for key in ("Ia", "Fv", "Fc")]] = drive
    recorded = closed_loop_log(robot, x, torque_noise=1e-3)
    assert recorded.recordings[0].q.shape[1] == 3
    truth = robot.base_parameters.project(x)
    scale = np.abs(truth).max()
    for method, tolerance in (
        (didim.IDIMLS(), 2e-2),
        (didim.IDIMLS(physical=True), 2e-2),
        (didim.DIDIM(physical=False), 2e-3),
        (didim.DIDIM(physical=True), 2e-3),
        (didim.CLOE(optimizer="levenberg-marquardt", start=1.1 * truth), 2e-2),
    ):
        fit = didim.identify(recorded, method)
        assert fit.converged, (method, fit.status)
        assert np.abs(fit.beta - truth).max() < tolerance * scale, method


@pytest.mark.parametrize("seed", range(6))
def test_simulations_agree_with_the_inverse_model(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = made(tmp_path, coupled(rng, 5))
    n = robot.n_dof
    robot = robot.with_smoothing([0.05] * n)
    x = robot.parameter_set("urdf").copy()
    for j in range(robot.n_joints):
        x[[robot.parameter_names.index(f"{key}{j + 1}") for key in ("Ia", "Fv", "Fc")]] = 0.5, 0.5, 0.1
    swing = 0.2 * np.sin(2.0 * np.pi * (0.3 + 0.1 * np.arange(n)) * np.arange(200)[:, None] / 200)
    for integrator in ("rk4", "imex"):
        simulation = didim.simulate(
            robot,
            x,
            didim.Reference.sampled(swing, rate_hz=200),
            didim.Controller.pd([900.0] * n, [60.0] * n),
            step=1e-3,
            integrator=integrator,
        )
        assert simulation.status.name == "COMPLETED"
        again = didim.inverse_dynamics(robot, simulation.q, simulation.dq, simulation.ddq, x)
        assert relative(again - simulation.tau, simulation.tau) < 1e-6


COUPLED = """
schema = 1
[[joint]]
kind = "revolute"
[[joint]]
kind = "revolute"
antecedent = 3
alpha_deg = 90
[[joint]]
kind = "prismatic"
antecedent = 1
d_m = 0.3
[[coupling]]
joint = 3
follows = [1, 2]
factors = [0.1, -0.2]
offset_m = 0.05
"""
"""A slide that follows two motors, and carries the second: a differential, written by hand."""


def test_a_joint_may_follow_several_and_carry_one_of_them(tmp_path: Path) -> None:
    path = tmp_path / "slide.toml"
    path.write_text(COUPLED)
    robot = didim.load_robot(path)
    assert (robot.n_dof, robot.n_joints) == (2, 3)
    assert robot.geometry.outwards == (0, 2, 1)
    rng = np.random.default_rng(0)
    x = rng.normal(size=len(robot.parameter_names))
    motion = random_motion(rng, 4, 2)
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    free = tmp_path / "free.toml"
    # The same joints in the order of the branch, each by itself.
    rows = COUPLED.split("[[joint]]")
    order = [
        rows[0],
        rows[1],
        rows[3].split("[[coupling]]")[0],
        rows[2].replace("antecedent = 3", "antecedent = 2"),
    ]
    free.write_text("[[joint]]".join(order))
    whole = didim.load_robot(free)
    g = np.array([[1.0, 0.0], [0.1, -0.2], [0.0, 1.0]])
    blocks = [np.arange(14) + 14 * joint for joint in (0, 2, 1)]
    expected = didim.inverse_dynamics(
        whole,
        motion.q @ g.T + [0.0, 0.05, 0.0],
        motion.dq @ g.T,
        motion.ddq @ g.T,
        x[np.concatenate(blocks)],
    )
    np.testing.assert_allclose(tau, expected @ g, rtol=1e-10, atol=1e-10)
    again = tmp_path / "again.toml"
    again.write_text(robot_text(robot))
    assert didim.load_robot(again).geometry == robot.geometry


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("joint = 3", "joint = 2", "joints that follow others are the last ones of the file, each once: joint 3, got 2"),
        ("follows = [1, 2]", "follows = [1, 3]", "follows has driven joints, 1 to 2, got 3"),
        ("factors = [0.1, -0.2]", "factors = [0.1]", "factors must hold 2 numbers"),
        ("factors = [0.1, -0.2]", "factors = [0.1, 0]", "factors one number other than 0 for each"),
        ("offset_m", "offset_rad", "offset_rad"),
        ("antecedent = 1", "antecedent = 2", "no joint on the base carries it"),
    ],
)  # fmt: skip
def test_wrong_couplings_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "slide.toml"
    path.write_text(COUPLED.replace(old, new))
    with pytest.raises(RobotError) as error:
        didim.load_robot(path)
    assert message in str(error.value)
    assert len(str(error.value)) <= 200


def test_a_robot_file_with_coupled_joints_is_drawn_and_exported(tmp_path: Path) -> None:
    path = tmp_path / "slide.toml"
    path.write_text(COUPLED.replace("[1, 2]", "[1]").replace("[0.1, -0.2]", "[0.1]"))
    robot = didim.load_robot(path)
    drawn = skeleton(robot)
    assert {(shape.link, shape.kind) for shape in drawn if shape.kind != "cylinder"} == {
        (1, "sphere"),
        (2, "sphere"),
        (3, "box"),
    }
    x = robot.parameters_by_name({f"{key}{j}": 1.0 for key in ("XX", "YY", "ZZ", "M") for j in (1, 2, 3)})
    for form in FORMATS:
        if form != "urdf":
            content, report = export(robot, x, form)
            assert b"joint3" in content
            assert [change.mass for change in report.links] == [1.0, 1.0, 1.0]


def test_mujoco_ties_the_joints_of_the_exported_file(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    robot = made(tmp_path, gripper())
    x = robot.parameter_set("urdf").copy()
    text = to_mjcf(robot, x)
    model = mujoco.MjModel.from_xml_string(text)
    assert model.neq == 2
    assert model.nu == 3
    path = tmp_path / "back.xml"
    path.write_text(text)
    back = didim.load_robot(path, tip="", snap=0.0)
    assert back.joint_names == robot.joint_names
    motion = random_motion(np.random.default_rng(0), 5, 3)
    tau = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    again = didim.inverse_dynamics(back, motion.q, motion.dq, motion.ddq, back.parameter_set("mjcf"))
    np.testing.assert_allclose(again, tau, rtol=1e-9, atol=1e-9)
    assert '<mimic joint="close">' in to_sdf(robot, x)


def test_drives_go_into_an_mjcf_whose_coupled_joint_has_a_spring(tmp_path: Path) -> None:
    path, written = tmp_path / "gripper.xml", tmp_path / "written.xml"
    plain = made(tmp_path, gripper())
    text = to_mjcf(plain, plain.parameter_set("urdf"))
    text = text.replace('name="curl"', 'name="curl" stiffness="2" springref="0.1" armature="0.01"')
    path.write_text(text.replace('name="close" type', 'name="close" stiffness="3" armature="0.02" type'))
    robot = didim.load_robot(path, tip="", snap=0.0)
    x = robot.parameter_set("mjcf").copy()
    assert x[robot.parameter_names.index("Ks3")] == pytest.approx(3.0 + 0.6**2 * 2.0)
    x[[name in ("Ia1", "Ia2", "Ia3", "Fv4", "Fc4") for name in robot.parameter_names]] = 0.3
    recorded = experiment(robot, log(robot, x, n_samples=1500))
    drives = drives_of(didim.identify(recorded, didim.IDIMLS(physical=True)), "fit.json")
    assert [drive.joint for drive in drives.joints] == ["turn", "bend", "close"]
    assert [drive.joint for drive in drives.followers] == ["curl", "oppose"]
    written.write_bytes(edit_mjcf(drives, path)[0])
    found = didim.load_robot(written, tip="", snap=0.0)
    beta, expected = (
        one.base_parameters.project(values)
        for one, values in ((robot, x), (found, found.parameter_set("mjcf")))
    )
    drive = [
        index for index, name in enumerate(robot.base_parameters.names) if name[:2] in ("Ks", "Fv", "Fc")
    ]
    assert len(drive) == 7
    np.testing.assert_allclose(expected[drive], beta[drive], rtol=1e-4, atol=1e-4)


def test_followers_of_what_stands_still_are_held(tmp_path: Path) -> None:
    path = tmp_path / "gripper.urdf"
    path.write_text(gripper())
    robot = didim.load_robot(path, tip="", lock={"close": 0.5})
    assert robot.n_joints == 2
    assert robot.correspondence is not None
    assert dict(robot.correspondence.lock) == {"close": 0.5, "curl": 0.5, "oppose": -0.5}
    whole = didim.load_robot(path, tip="")
    assert "joints that follow others, with their leaders: curl (close), oppose (close)" in whole.notes
