"""``didim init`` reads columns by name or number, asks what it cannot read, and writes files that load at once."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim import load_experiment
from didim.cli.main import main
from didim.errors import ExperimentError
from didim.experiment.draft import initialise
from didim.experiment.draft_columns import read_column
from urdfs import GRIPPER_ARM

Array = NDArray[np.float64]
T = np.arange(2000) / 500.0
Q = np.column_stack([np.sin(3.0 * T), np.cos(2.0 * T)])
DQ = np.column_stack([3.0 * np.cos(3.0 * T), -2.0 * np.sin(2.0 * T)])
TAU = np.column_stack([20.0 * np.cos(3.0 * T), 5.0 * np.sin(5.0 * T)])


def write(path: Path, names: list[str] | None, *columns: Array, delimiter: str = ",") -> Path:
    header = "" if names is None else delimiter.join(names)
    values = np.column_stack(columns)
    np.savetxt(path, values, fmt="%.9g", delimiter=delimiter, header=header, comments="")
    if names is None:
        path.write_text(path.read_text(encoding="utf-8").lstrip("\n"), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "what", "number", "unit", "motor"),
    [
        ("t", "time", None, None, False),
        ("time_ms", "time", None, "ms", False),
        ("timestamp", "time", None, None, False),
        ("q1", "position", 1, None, False),
        ("q_ref3", "reference", 3, None, False),
        ("pos_2_deg", "position", 2, "deg", False),
        ("joint_position[4] (rad)", "position", 4, "rad", False),
        ("JointAngle5", "position", 5, None, False),
        ("motor_2_torque_Nm", "torque", 2, "N.m", True),
        ("tau6", "torque", 6, None, False),
        ("iq3", "current", 3, None, False),
        ("motor1_current_A", "current", 1, "A", True),
        ("dq1", "velocity", 1, None, False),
        ("ddq2", "acceleration", 2, None, False),
        ("vel_1_deg", "velocity", 1, "deg", False),
        ("temperature_1", "other", 1, None, False),
        ("tau_ref1", "other", 1, None, False),
    ],
)
def test_names_of_columns(name: str, what: str, number: int | None, unit: str | None, motor: bool) -> None:
    found = read_column(name)
    assert (found.what, found.number, found.unit, found.motor) == (what, number, unit, motor)


def test_a_log_with_names_loads_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = ["time", "tau2", "tau1", "q2", "q1", "temperature"]
    log = write(tmp_path / "run.csv", names, T, TAU[:, ::-1], Q[:, ::-1], 20.0 + 0.0 * T)
    assert main(["init", "planar2", str(log)]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    assert "- time stamps 'time' in s: 500 Hz, 2000 samples" in told.out
    path = tmp_path / "run.toml"
    (recording,) = load_experiment(path).recordings
    assert recording.rate_hz == 500.0
    # By the numbers in the names, not in the order of the file.
    assert np.allclose(recording.q, Q, atol=1e-8)
    assert recording.tau is not None
    assert np.allclose(recording.tau, TAU, atol=1e-7)
    text = path.read_text(encoding="utf-8")
    assert "# Columns that are not used: temperature" in text
    assert 'unit = "rad" # confirm' in text
    # It loads and is solved; torques that no arm has are called so.
    assert main(["identify", str(path), "--strict"]) == 1
    assert "Verdict: " in capsys.readouterr().out


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write(tmp_path / "run.csv", ["t", "q1", "q2", "tau1", "tau2"], T, Q, TAU)
    path = tmp_path / "run.toml"
    path.write_text("mine", encoding="utf-8")
    assert main(["init", "planar2", str(log)]) == 2
    assert "the file is there already; --force overwrites it" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == "mine"
    assert main(["init", "planar2", str(log), "--force"]) == 0
    assert load_experiment(path).robot.name == "planar2"


def test_another_place_and_a_robot_file(tmp_path: Path) -> None:
    source = Path(str(didim.load_robot("planar2").path))
    robot = tmp_path / "robots" / "mine.toml"
    (tmp_path / "logs").mkdir()
    (tmp_path / "experiments").mkdir()
    robot.parent.mkdir()
    robot.write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
    log = write(tmp_path / "logs" / "run.csv", ["t", "q1", "q2", "tau1", "tau2"], T, Q, TAU)
    path = tmp_path / "experiments" / "mine.toml"
    assert main(["init", str(robot), str(log), "-o", str(path)]) == 0
    experiment = load_experiment(path)
    assert experiment.robot.path.resolve() == robot.resolve()
    assert len(experiment.recordings[0].q) == 2000


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
@pytest.mark.parametrize("timed", [True, False])
def test_columns_without_names(tmp_path: Path, delimiter: str, timed: bool) -> None:
    log = write(tmp_path / "run.txt", None, *([T] if timed else []), Q, DQ, TAU, delimiter=delimiter)
    path, draft = initialise("planar2", log, rate_hz=None if timed else 500.0)
    assert not draft.questions
    (recording,) = load_experiment(path).recordings
    assert recording.rate_hz == 500.0
    assert np.allclose(recording.q, Q, atol=1e-8)
    assert recording.tau is not None
    assert np.allclose(recording.tau, TAU, atol=1e-7)


def test_units_are_guessed_from_names_and_values(tmp_path: Path) -> None:
    log = write(tmp_path / "a.csv", ["t_ms", "q1", "q2", "tau1", "tau2"], 1e3 * T, np.degrees(Q), TAU)
    path, draft = initialise("planar2", log)
    assert not draft.questions
    assert np.allclose(load_experiment(path).recordings[0].q, Q, atol=1e-7)
    log = write(tmp_path / "b.csv", ["stamp", "pos1_deg", "pos2_deg", "tau1", "tau2"], 1e6 * T, 0.1 * Q, TAU)
    path, _ = initialise("planar2", log)
    (recording,) = load_experiment(path).recordings
    assert recording.rate_hz == 500.0
    assert np.allclose(recording.q, np.radians(0.1 * Q), atol=1e-8)


def test_motors_of_a_robot_with_gears(tmp_path: Path) -> None:
    robot = didim.load_robot("tx40")
    assert robot.reduction is not None
    q = np.tile(Q, 3) @ robot.reduction.T
    names = [f"motor{k}_{what}" for what in ("position", "torque") for k in range(1, 7)]
    log = write(tmp_path / "run.csv", names, q, np.tile(TAU, 3))
    path, draft = initialise("tx40", log, rate_hz=500.0)
    assert not draft.questions
    (recording,) = load_experiment(path).recordings
    assert np.allclose(recording.q, np.tile(Q, 3), atol=1e-6)


@pytest.mark.parametrize(
    ("names", "question", "line"),
    [
        (["q1", "q2", "tau1", "tau2"], "at what rate was the log recorded", "# rate_hz ="),
        (["t", "q1", "q2", "x1", "x2"], "which columns hold the torques of the 2 joints", "# [recording.torque]"),
        (["t", "x1", "x2", "tau1", "tau2"], "which columns hold the positions", "# [recording.position]"),
        (["t", "q1", "q2", "iq1", "iq2"], "how many N.m are one A", "# gain ="),
        (["t", "q1_counts", "q2_counts", "tau1", "tau2"], "counts make one turn", "# counts_per_rev ="),
        (["t", "motor1_pos", "motor2_pos", "tau1", "tau2"], "fill in [transmission]", "# reduction ="),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], names: list[str], question: str, line: str
) -> None:
    columns = [Q, TAU] if names[0] != "t" else [T, Q, TAU]
    log = write(tmp_path / "run.csv", names, *columns)
    assert main(["init", "planar2", str(log)]) == 1
    assert question in capsys.readouterr().err
    text = (tmp_path / "run.toml").read_text(encoding="utf-8")
    assert any(part.startswith(line) for part in text.splitlines())
    # It is TOML nevertheless, and does not pretend to be complete.
    assert tomllib.loads(text)["robot"] == "planar2"
    with pytest.raises(ExperimentError, match=r"run.toml: not finished, open is: .*Then delete open$"):
        load_experiment(tmp_path / "run.toml")
    if "torques" in question:  # a log of positions is an experiment, for CLOE
        closed = "\n".join(part for part in text.splitlines() if not part.startswith("open = "))
        (tmp_path / "run.toml").write_text(closed, encoding="utf-8")
        assert load_experiment(tmp_path / "run.toml").recordings[0].tau is None
    else:
        with pytest.raises(didim.DidimError):
            load_experiment(tmp_path / "run.toml")


def test_gaps_are_told_at_once(tmp_path: Path) -> None:
    kept = np.r_[0:300, 310:2000]
    log = write(tmp_path / "run.csv", ["t", "q1", "q2", "tau1", "tau2"], T[kept], Q[kept], TAU[kept])
    path, draft = initialise("planar2", log)
    assert not draft.questions
    assert any("10 samples are missing after row 300" in sentence for sentence in draft.read)
    (recording,) = load_experiment(path).recordings
    assert recording.windows == ((0, 300), (310, 2000))


def test_wrong_input(tmp_path: Path) -> None:
    log = write(tmp_path / "run.csv", ["t", "q1", "q2", "tau1", "tau2"], T, Q, TAU)
    with pytest.raises(didim.errors.RobotError, match="no packaged robot 'planar3'"):
        initialise("planar3", log)
    with pytest.raises(didim.errors.RecordingError, match="no such data file"):
        initialise("planar2", tmp_path / "none.csv")
    (tmp_path / "run.xlsx").write_bytes(b"PK")
    with pytest.raises(didim.errors.RecordingError, match=r"the format '.xlsx' is unknown; known are .csv"):
        initialise("planar2", tmp_path / "run.xlsx")
    with pytest.raises(ExperimentError, match="positive number of Hz"):
        initialise("planar2", log, rate_hz=-1.0)
    with pytest.raises(didim.errors.RecordingError, match="does not grow"):
        initialise(
            "planar2", write(tmp_path / "still.csv", ["t", "q1", "q2", "tau1", "tau2"], 0.0 * T, Q, TAU)
        )


def test_a_slide_is_read_in_millimetres_and_its_drive_has_a_gain(tmp_path: Path) -> None:
    """A span of 20 is not in metres; the gain of the EMPS is in its robot file."""
    log = write(tmp_path / "run.csv", ["t", "q1", "voltage1"], T, 200.0 * Q[:, 0], TAU[:, 0])
    path, draft = initialise("emps", log)
    assert not draft.questions
    text = path.read_text(encoding="utf-8")
    assert 'unit = "mm" # confirm' in text
    assert "# gain: that of the robot file" in text
    (recording,) = load_experiment(path).recordings
    gains = didim.load_robot("emps").gains
    assert gains is not None
    assert recording.tau is not None
    np.testing.assert_allclose(recording.q[:, 0], 0.2 * Q[:, 0], atol=1e-9)
    np.testing.assert_allclose(recording.tau[:, 0], gains[0] * TAU[:, 0], atol=1e-6)


def test_a_folder_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "run.csv").mkdir()
    with pytest.raises(didim.errors.RecordingError, match=r"run\.csv: cannot be read \(Is a directory\)"):
        initialise("planar2", tmp_path / "run.csv")


@pytest.mark.parametrize(
    ("name", "what", "joint"),
    [
        ("elbow_joint_position", "position", 3),
        ("position_elbow_joint [rad]", "position", 3),
        ("/joint_states/wrist_3_joint/effort", "torque", 6),
        ("wrist_1_joint_vel", "velocity", 4),
        ("elbow_pos", "position", 3),
        ("elbow_joint", "position", 3),
        ("ref_elbow_joint", "reference", 3),
        ("Shoulder_Pan_Joint_current_A", "current", 1),
        ("time", "time", None),
        ("below_joint_pos", "position", None),
    ],
)
def test_names_of_columns_with_names_of_joints(name: str, what: str, joint: int | None) -> None:
    joints = [
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ]
    found = read_column(name, joints)
    assert (found.what, found.number) == (what, joint)


def test_joint_10_is_not_joint_1() -> None:
    joints = [f"joint_{k + 1}" for k in range(12)]
    assert read_column("joint_10 effort", joints).number == 10
    assert read_column("effort joint_1", joints).number == 1


def test_a_urdf_and_columns_in_another_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "arm.urdf").write_text(GRIPPER_ARM)
    q, tau = np.column_stack([Q, Q[:, 0] ** 2]), np.column_stack([TAU, TAU[:, 0] ** 2])
    names = [
        "time",
        "wrist_effort",
        "shoulder_position",
        "elbow_effort",
        "wrist_position",
        "shoulder_effort",
        "elbow_position",
    ]
    log = write(tmp_path / "log.csv", names, T, tau[:, 2], q[:, 0], tau[:, 1], q[:, 2], tau[:, 0], q[:, 1])
    assert main(["init", str(tmp_path / "arm.urdf"), str(log)]) == 0
    assert "didim: note: the chain ends at link hand; locked at 0: finger_joint" in capsys.readouterr().err
    text = (tmp_path / "log.toml").read_text()
    assert 'robot = "arm.urdf" # 3 joints: shoulder, elbow, wrist' in text
    recording = load_experiment(tmp_path / "log.toml").recordings[0]
    np.testing.assert_allclose(recording.q, q, rtol=1e-8, atol=1e-9)
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, tau, rtol=1e-8, atol=1e-9)


def test_control_characters_of_a_header_are_escaped(tmp_path: Path) -> None:
    names = ["q1", "q2", "tau1", "effort\x7f2", "no\x01te\x7f"]
    write(tmp_path / "log.csv", names, Q, TAU, T)
    path, _ = initialise("planar2", [tmp_path / "log.csv"], tmp_path / "out.toml", rate_hz=500.0)
    text = path.read_text(encoding="utf-8")
    tomllib.loads(text)
    assert "effort\\u007f2" in text
    assert not {"\x7f", "\x01"} & set(text)
