"""``didim init`` for logs of commanded and measured positions: an experiment file for a fit of drives with known links."""

from __future__ import annotations

import shutil
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from didim.cli.main import main
from quadrupeds import robot_text
from test_lerobot import EPISODES, dataset, frames

N = 900
ARM = """<mujoco><worldbody><body><joint name="shoulder_pan" range="-110 110"/>
<inertial pos="0.1 0 0" mass="0.3" diaginertia="0.001 0.001 0.001"/><body pos="0.1 0 0"><joint name="gripper" range="-10 100"/>
<inertial pos="0.05 0 0" mass="0.1" diaginertia="0.0001 0.0001 0.0001"/></body></body></worldbody>
<actuator><position joint="shoulder_pan" kp="17.8" kv="0.5" forcerange="-3 3"/>
<position joint="gripper" kp="17.8" kv="0.5"/></actuator>
</mujoco>"""


def quadruped(folder: Path, **more: Any) -> Path:
    (folder / "go2.xml").write_text(robot_text())
    rng = np.random.default_rng(0)
    t = np.arange(N) / 200.0
    r = 0.3 * np.sin(np.outer(t, [3.0, 4.0, 5.0, 6.0]))
    np.savez(
        folder / "run.npz", time=t, dof_pos=r + 0.01 * rng.standard_normal(r.shape), des_dof_pos=r, **more
    )
    return folder


def init(folder: Path, *options: str, code: int = 0) -> dict[str, Any]:
    arguments = [
        "init",
        str(folder / "go2.xml"),
        str(folder / "run.npz"),
        *options,
        "-o",
        str(folder / "go2.toml"),
    ]
    assert main(arguments) == code
    return tomllib.loads((folder / "go2.toml").read_text(encoding="utf-8"))


def test_commands_and_positions_make_a_fit_of_the_drives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = init(quadruped(tmp_path), "--kp", "20", "--kv", "1.5")
    assert content["parameters"] == {"links": "fixed"}
    assert content["reference"] == {"kind": "recorded", "between_samples": "held"}
    assert content["controller"] == {"kind": "pd", "kp": 20, "kv": 1.5, "reference_velocity": 0.0}
    assert content["unknown"] == {"delay_s": {"max": 0.025, "shared": True}}
    assert "signal" not in content
    (recording,) = content["recording"]
    assert recording["position"]["variable"] == "dof_pos"
    assert recording["reference"]["variable"] == "des_dof_pos"
    assert "torque" not in recording
    told = capsys.readouterr()
    assert "2 limbs, each a problem of its own: FL (2 joints), FR (2 joints)" in told.out
    assert "open" not in told.err
    experiment = didim.load_experiment(tmp_path / "go2.toml")
    assert experiment.recordings[0].q_ref is not None
    # Limits are those of the motors.
    np.testing.assert_array_equal(experiment.controller.build(None).saturation, 23.7)  # type: ignore[union-attr, arg-type]


def test_a_gain_for_each_joint(tmp_path: Path) -> None:
    content = init(quadruped(tmp_path), "--kp", "20", "25", "20", "25", "--kv", "0.5")
    assert content["controller"]["kp"] == [20, 25, 20, 25]


def test_without_gains_a_question_offers_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = init(quadruped(tmp_path), code=1)
    assert any("give --kp and --kv of servos (fit on positions)" in question for question in content["open"])
    capsys.readouterr()
    # The answer replaces the draft.
    assert "open" not in init(tmp_path, "--kp", "20", "--kv", "1.5")


def test_torques_are_not_given_up_for_gains(tmp_path: Path) -> None:
    content = init(
        quadruped(tmp_path, tau=np.random.default_rng(1).standard_normal((N, 4))), "--kp", "20", "--kv", "1.5"
    )
    assert "torque" in content["recording"][0]
    assert "parameters" not in content


@pytest.mark.parametrize("gains", [("20", "30"), ("-1",)])
def test_wrong_gains_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], gains: tuple[str, ...]
) -> None:
    quadruped(tmp_path)
    command = ["init", str(tmp_path / "go2.xml"), str(tmp_path / "run.npz"), "--kv", "1", "--kp", *gains]
    assert main(command) == 2
    assert "--kp takes one number or 4, one for each joint, none negative" in capsys.readouterr().err


@pytest.mark.parametrize(("kp", "kv"), [("17.8", 0.5), ("100", 0.0), ("5", 0.0)])
def test_a_kv_of_the_file_that_goes_with_another_kp_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kp: str, kv: float
) -> None:
    dataset(tmp_path / "so101", "v3.0")
    (tmp_path / "arm.xml").write_text(ARM)
    files = [str(tmp_path / name) for name in ("arm.xml", "so101")]
    assert main(["init", *files, "--kp", kp, "-o", str(tmp_path / "arm.toml")]) == 0
    told = "kv of the robot file goes with its kp; where yours differs kv is 0" in capsys.readouterr().out
    assert told == (kv == 0.0)
    law = didim.load_experiment(tmp_path / "arm.toml").controller.build(None)  # type: ignore[union-attr, arg-type]
    np.testing.assert_array_equal(law.laws[:, :2], [[float(kp), kv]] * 2)


def test_a_lerobot_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset(tmp_path / "so101", "v3.0")
    (tmp_path / "arm.xml").write_text(ARM)
    path = tmp_path / "arm.toml"
    assert main(["init", str(tmp_path / "arm.xml"), str(tmp_path / "so101"), "-o", str(path)]) == 0
    capsys.readouterr()
    experiment = didim.load_experiment(path)
    (recording,) = experiment.recordings
    edges = np.cumsum([0, *EPISODES]).tolist()
    assert recording.windows == tuple(pairwise(edges))
    assert recording.rate_hz == 30.0
    values = frames()["action"].astype(float)
    assert recording.q_ref is not None
    np.testing.assert_allclose(recording.q_ref[:, 0], np.radians(values[:, 0]))
    np.testing.assert_allclose(recording.q_ref[:, 1], np.radians(-10.0 + 1.1 * values[:, 1]))
    law = experiment.controller.build(None)  # type: ignore[union-attr, arg-type]
    np.testing.assert_array_equal(law.laws[:, :2], [[17.8, 0.5]] * 2)
    np.testing.assert_array_equal(law.saturation, [3.0, np.inf])


def test_a_lerobot_dataset_of_a_small_motion_is_in_degrees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = frames()
    for key in ("action", "observation.state"):
        small[key] = small[key] * 0.05
    dataset(tmp_path / "so101", "v3.0", columns=small)
    (tmp_path / "arm.xml").write_text(ARM)
    path = tmp_path / "arm.toml"
    assert main(["init", str(tmp_path / "arm.xml"), str(tmp_path / "so101"), "-o", str(path)]) == 0
    (recording,) = didim.load_experiment(path).recordings
    assert recording.q_ref is not None
    np.testing.assert_allclose(recording.q_ref[:, 0], np.radians(small["action"][:, 0].astype(float)))


def test_lists_in_cells_and_commands_in_a_file_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Stamps in us of which one is late, positions as lists, and the magnitudes of currents under the name of torques."""
    t = 20000.0 * np.arange(300.0)
    t[100] += 600.0
    r = 0.4 * np.sin(np.outer(t * 1e-6, [3.0, 4.0]))
    q = np.roll(r, 1, axis=0)
    rows = ["type,timestamp,positions,torques"], ["type,timestamp,positions"]
    for stamp, own, command in zip(t, q.tolist(), r.tolist(), strict=True):
        rows[0].append(f'STATE,{stamp},"{own}","{[abs(value) for value in own]}"')
        rows[1].append(f'CONTROL,{stamp},"{command}"')
    for name, lines in zip(("state_motor", "control"), rows, strict=True):
        (tmp_path / f"{name}.csv").write_text("\n".join(lines))
    (tmp_path / "arm.xml").write_text(ARM)
    files = [str(tmp_path / name) for name in ("arm.xml", "state_motor.csv", "control.csv")]
    assert main(["init", *files, "-o", str(tmp_path / "arm.toml")]) == 0
    assert "the torques have no sign" in capsys.readouterr().out
    (recording,) = didim.load_experiment(tmp_path / "arm.toml").recordings
    assert recording.q_ref is not None
    np.testing.assert_allclose(recording.q_ref, r)
    np.testing.assert_allclose(recording.measured_positions(), q)
    assert recording.rate_hz == pytest.approx(50.0, rel=1e-3)
    for number, name in enumerate(("shoulder_pan", "gripper")):  # the columns of a locked joint are left out
        lock = ["--lock", f"{name}=0", "--force", "-o", str(tmp_path / "arm.toml")]
        assert main(["init", *files, *lock]) == 0
        assert (
            f"positions_{number + 1}, torques_{number + 1}: of locked joints, left out"
            in capsys.readouterr().out
        )
        (one,) = didim.load_experiment(tmp_path / "arm.toml").recordings
        np.testing.assert_allclose(one.measured_positions(), q[:, [1 - number]])
    pairs = []
    for motion in ("slow", "fast"):  # files of several logs, a folder each, are pairs
        (tmp_path / motion).mkdir()
        pairs += [str(shutil.copy(path, tmp_path / motion)) for path in files[1:]]
    assert main(["init", files[0], *pairs, "-o", str(tmp_path / "both.toml")]) == 0
    both = didim.load_experiment(tmp_path / "both.toml").recordings
    assert [one.name for one in both] == ["slow", "fast"]
    for one in both:
        np.testing.assert_allclose(one.measured_positions(), q)
    (tmp_path / "control.csv").write_text("\n".join([*rows[1][:-1], 'CONTROL,0.0,"[0.1]"']))
    assert main(["init", *files, "-o", str(tmp_path / "other.toml")]) == 2
    assert (
        "control.csv: row 300 (line 301) has 3 columns where the first line has 4" in capsys.readouterr().err
    )


def test_locks_that_a_robot_of_too_many_joints_needs(tmp_path: Path) -> None:
    """The columns of its other joints are found by name; the file itself, whose joints are too many, is not asked for an order."""
    body = '<link name="l{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'
    joint = (
        '<joint name="j{0}" type="revolute"><parent link="l{1}"/><child link="l{0}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
    )
    links = "".join((body + joint).format(k, k - 1) for k in range(1, 98))
    (tmp_path / "long.urdf").write_text(f'<robot name="long"><link name="l0"/>{links}</robot>')
    t = np.arange(600) / 100.0
    table = np.column_stack([t, np.sin(3.0 * t), -9.0 * np.sin(3.0 * t)])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,q_j1,tau_j1", comments="")
    locks = [part for k in range(2, 98) for part in ("--lock", f"j{k}=0")]
    assert main(["init", str(tmp_path / "long.urdf"), str(tmp_path / "log.csv"), *locks]) == 0
    assert didim.load_experiment(tmp_path / "log.toml").robot.n_dof == 1


def test_goal_and_present_positions_of_bus_servos(tmp_path: Path) -> None:
    """Names as Dynamixel and Feetech servos have them, and rollouts of a pendulum by number."""
    (tmp_path / "servo.xml").write_text(
        """<mujoco><worldbody><body><joint name="servo" axis="0 1 0"/>
        <inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody>
        <actuator><position joint="servo" kp="17" kv="0.5"/></actuator></mujoco>"""
    )
    t = np.arange(200) / 100.0
    rows = [
        f"{episode},{value:.3f},{np.sin(3 * value):.5f},{np.sin(3 * value - 0.1):.5f}"
        for episode in range(5)
        for value in t
    ]
    (tmp_path / "log.csv").write_text(
        "\n".join(["episode,timestamp,goal_position,present_position", *rows]) + "\n"
    )
    arguments = [
        "init",
        str(tmp_path / "servo.xml"),
        str(tmp_path / "log.csv"),
        "-o",
        str(tmp_path / "log.toml"),
    ]
    assert main(arguments) == 0
    (recording,) = tomllib.loads((tmp_path / "log.toml").read_text(encoding="utf-8"))["recording"]
    assert recording["rollouts"] == "episode"
    assert recording["position"]["columns"] == ["present_position"]
    assert recording["reference"]["columns"] == ["goal_position"]
