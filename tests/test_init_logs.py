"""``didim init`` on logs as makers write them, in every container, without names, several at once; and the raw log of a UR10e."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from numpy.typing import NDArray

import didim
from didim import load_experiment
from didim.cli.main import main
from didim.errors import ExperimentError
from didim.experiment.draft import initialise
from didim.experiment.draft_columns import read_column
from didim.experiment.draft_layout import layout
from didim.log.csv_file import CsvFile

pytestmark = pytest.mark.usefixtures("without_laws")
Array = NDArray[np.float64]
RATE = 500.0
T = np.arange(4000) / RATE
PHASES = np.arange(6)
Q = np.sin(T[:, None] * (2.0 + 0.3 * PHASES) + PHASES)
DQ = (2.0 + 0.3 * PHASES) * np.cos(T[:, None] * (2.0 + 0.3 * PHASES) + PHASES)
TAU = 20.0 * np.cos(T[:, None] * (3.0 + 0.2 * PHASES) + 2.0 * PHASES)


def named(stem: str, n: int = 6, first: int = 0) -> list[str]:
    return [f"{stem}{k}" for k in range(first, first + n)]


def write(path: Path, names: list[str] | None, *columns: Any) -> Path:
    header = "" if names is None else ",".join(names)
    np.savetxt(path, np.column_stack(columns), fmt="%.12g", delimiter=",", header=header, comments="")
    if names is None:
        path.write_text(path.read_text().lstrip("\n"))
    return path


@pytest.mark.parametrize(
    ("name", "what", "unit"),
    [
        ("timestamp", "time", None),
        ("actual_q_0", "position", "rad"),
        ("target_q_3", "reference", "rad"),
        ("actual_qd_1", "velocity", None),
        ("target_qdd_1", "other", None),
        ("actual_current_5", "current", "A"),
        ("target_current_5", "other", None),
        ("target_moment_2", "other", None),
        ("actual_current_as_torque_2", "torque", "N.m"),
        ("actual_TCP_pose_0", "other", None),
        ("joint_temperatures_2", "other", None),
        ("joint_temperature_2", "other", None),
        ("joint_current_2", "current", None),
        ("i_joint_2", "current", None),
        ("q_d[3]", "reference", "rad"),
        ("q[3]", "position", None),
        ("tau_J_6", "torque", "N.m"),
        ("tau_J_d_6", "other", None),
        ("tau_ext_hat_filtered_1", "other", None),
        ("theta_1", "other", None),
        ("AIPos.A2", "position", "deg"),
        ("ASPos.A2", "reference", "deg"),
        ("MACur.A2", "current", "A"),
        ("RIst.X", "other", None),
        ("IPOC", "time", "ms"),
        ("__time", "time", "s"),
        ("/joint_states/header/stamp", "time", "s"),
        ("/joint_states/header/stamp/sec", "other", None),
        ("/joint_states/header/stamp/nanosec", "other", None),
        ("/joint_states/position[2]", "position", None),
        ("/joint_states/effort[2]", "torque", None),
        ("/arm_controller/state/desired/positions[1]", "reference", None),
        ("/arm_controller/state/desired/velocities[1]", "other", None),
    ],
)
def test_names_of_makers(name: str, what: str, unit: str | None) -> None:
    found = read_column(name)
    assert (found.what, found.unit) == (what, unit)


def test_an_rtde_log_of_a_ur(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Currents are currents, the controller's own moments are left alone, targets are the reference; a gain is asked for."""
    names = [
        "timestamp",
        *named("target_q_"),
        *named("actual_q_"),
        *named("actual_qd_"),
        *named("actual_current_"),
    ]
    names += [*named("target_current_"), *named("target_moment_"), *named("actual_TCP_pose_")]
    columns = (1e5 + T, Q, Q + 1e-4, DQ, 0.1 * TAU, TAU, TAU, Q)
    log = write(tmp_path / "run.csv", names, *columns)
    assert main(["init", "ur5e", str(log)]) == 1
    told = capsys.readouterr()
    assert "how many N.m are one A (--gain" in told.err
    assert main(["init", "ur5e", str(log), "--force", "--gain", "13", "13", "13", "9", "9", "9"]) == 0
    (recording,) = load_experiment(tmp_path / "run.toml").recordings
    assert recording.rate_hz == RATE
    np.testing.assert_allclose(recording.q, Q + 1e-4, atol=1e-9)
    assert recording.q_ref is not None
    np.testing.assert_allclose(recording.q_ref, Q, atol=1e-9)
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, 0.1 * TAU * [13, 13, 13, 9, 9, 9], atol=1e-6)
    assert recording.dq is None  # offered as commented lines
    text = (tmp_path / "run.toml").read_text()
    assert "# [recording.velocity]" in text
    assert "target_moment_0" in text.split("# Columns that are not used: ")[1]


def test_currents_are_never_positions(tmp_path: Path) -> None:
    """A log of currents alone has neither positions nor torques in N.m."""
    log = write(tmp_path / "run.csv", ["t", *named("joint_current_")], T, Q)
    _, draft = initialise("ur5e", log, gains=[10.0])
    assert "which columns hold the positions" in draft.questions[0]


def test_logs_of_franka_and_kuka(tmp_path: Path) -> None:
    seven = np.column_stack([Q, Q[:, 0]])
    names = [
        "time",
        *named("q[", 7),
        *named("q_d[", 7),
        *named("dq[", 7),
        *named("tau_J[", 7),
        *named("tau_J_d[", 7),
    ]
    names = [f"{name}]" if "[" in name else name for name in names]
    log = write(tmp_path / "franka.csv", names, T, seven, seven, seven, 10 * seven, seven)
    path, draft = initialise("panda", log)
    assert not draft.questions
    (recording,) = load_experiment(path).recordings
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, 10 * seven, atol=1e-8)
    names = [
        "IPOC",
        *named("AIPos.A", first=1),
        *named("ASPos.A", first=1),
        *named("MACur.A", first=1),
        "RIst.X",
    ]
    log = write(tmp_path / "rsi.csv", names, 4.0 * np.arange(4000), np.degrees(Q), np.degrees(Q), TAU, T)
    path, draft = initialise("kr16", log, gains=[5.0])
    assert not draft.questions
    (recording,) = load_experiment(path).recordings
    assert recording.rate_hz == 250.0
    np.testing.assert_allclose(recording.q, Q, atol=1e-9)


def test_the_header_of_plotjuggler(tmp_path: Path) -> None:
    """Joints by name, sorted as a driver sorts them; the stamp of the header is the time."""
    robot = didim.load_robot("ur5e")
    order = sorted(robot.joint_names)
    names = ["__time", "/joint_states/header/stamp"]
    columns: list[Any] = [T + 0.001 * np.sin(700.0 * T), T]
    for joint in order:
        k = robot.joint_names.index(joint)
        names += [
            f"/joint_states/{joint}/position",
            f"/joint_states/{joint}/velocity",
            f"/joint_states/{joint}/effort",
        ]
        columns += [Q[:, k], DQ[:, k], TAU[:, k]]
    path, draft = initialise("ur5e", write(tmp_path / "run.csv", names, *columns))
    assert not draft.questions
    (recording,) = load_experiment(path).recordings
    np.testing.assert_allclose(recording.q, Q, atol=1e-9)
    assert recording.notes == ()


def test_columns_without_names_by_their_values() -> None:
    t, q = T[:, None], Q

    def kinds(values: Array) -> list[str]:
        return [item.what for item in layout(values, 6)]

    found = kinds(np.hstack([t, q, DQ, TAU]))
    assert found == ["time"] + ["position"] * 6 + ["velocity"] * 6 + ["torque"] * 6
    found = kinds(np.hstack([t, TAU + 0.3 * np.sign(DQ), q]))
    assert found == ["time"] + ["torque"] * 6 + ["position"] * 6
    ddq = -((2.0 + 0.3 * PHASES) ** 2) * Q
    found = kinds(np.hstack([DQ, ddq, q, TAU]))
    assert found[::6] == ["velocity", "acceleration", "position", "torque"]
    found = kinds(np.hstack([t, q, DQ, TAU, TAU, TAU]))
    assert found == ["time"] + ["position"] * 6 + ["velocity"] * 6 + ["other"] * 18
    assert set(kinds(np.hstack([t, q, TAU[:, :3]]))) == {"time", "other"}
    # Hundreds of blocks are no signals of one robot, and are not compared in pairs.
    assert set(kinds(np.hstack([t, *[q, DQ] * 21]))) == {"time", "other"}


def test_arrays_and_settings_of_matlab(tmp_path: Path) -> None:
    scipy.io.savemat(
        tmp_path / "run.mat", {"t": T, "q": Q, "dq": DQ, "tau": TAU, "kp": 100.0, "gains": np.eye(3)}
    )
    path, draft = initialise("ur5e", tmp_path / "run.mat")
    assert not draft.questions
    content = tomllib.loads(path.read_text())["recording"][0]
    assert content["position"]["variable"] == "q"
    assert "columns" not in content["position"]
    (recording,) = load_experiment(path).recordings
    np.testing.assert_array_equal(recording.q, Q)
    vectors: dict[str, Any] = {f"{key}{k}": x[:, k] for key, x in (("q", Q), ("tau", TAU)) for k in range(6)}
    np.savez(tmp_path / "six.npz", t=T, **vectors)
    path, draft = initialise("ur5e", tmp_path / "six.npz")
    assert not draft.questions
    np.testing.assert_array_equal(load_experiment(path).recordings[0].tau, TAU)


def test_the_emps_from_its_own_file(shared: Path, tmp_path: Path) -> None:
    """A slide with its reference, its controller's output in volts, and settings beside the signals."""
    path, draft = initialise("emps", shared / "data" / "emps" / "DATA_EMPS.mat", tmp_path / "emps.toml")
    assert not draft.questions
    (recording,) = load_experiment(path).recordings
    assert len(recording.q) == 24841
    assert recording.q_ref is not None
    fit = didim.identify(load_experiment(path))
    assert fit.overall_relative_error < 0.06
    assert fit.beta[0] == pytest.approx(95.1, rel=0.01)


@pytest.mark.slow
def test_a_bag_by_names(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="needs the extra 'ros'")
    from bags import write_bag

    robot = didim.load_robot("ur5e")
    write_bag(tmp_path / "bag", robot.joint_names, T, Q, TAU, reference=Q)
    with pytest.raises(didim.errors.RecordingError, match="topic must say which is meant"):
        initialise("ur5e", tmp_path / "bag")
    path, draft = initialise("ur5e", tmp_path / "bag", topic="/arm_controller/state")
    assert not draft.questions
    (recording,) = load_experiment(path).recordings
    np.testing.assert_array_equal(recording.q, Q)
    np.testing.assert_array_equal(recording.q_ref, Q)
    np.testing.assert_array_equal(recording.tau, TAU)


def test_messages_of_a_gripper_are_no_samples(tmp_path: Path) -> None:
    """They are on the topic of the arm, with stamps of their own; joints are announced before the stamps are read."""
    pytest.importorskip("rosbags", reason="needs the extra 'ros'")
    from bags import write_bag

    robot = didim.load_robot("ur5e")
    write_bag(tmp_path / "bag", robot.joint_names, T, Q, TAU)
    _, draft = initialise("ur5e", tmp_path / "bag", topic="/joint_states")
    (told,) = [sentence for sentence in draft.read if sentence.startswith("time stamps")]
    assert f"{len(T)} samples" in told
    assert "uneven" not in told


def test_a_text_is_parsed_once_for_all_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parsed: list[CsvFile] = []
    load = CsvFile._load

    def counting(self: CsvFile, columns: list[int]) -> Any:
        parsed.append(self)
        return load(self, columns)

    monkeypatch.setattr(CsvFile, "_load", counting)
    log = write(tmp_path / "log.csv", ["t", *named("q"), *named("tau")], T, Q, TAU)
    initialise("ur5e", log)
    assert parsed
    assert len(parsed) == len({id(item) for item in parsed})


def test_several_logs_in_one_call(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = ["t", *named("q"), *named("tau")]
    logs = [str(write(tmp_path / f"{name}.csv", names, T, Q, TAU)) for name in ("a", "b", "c")]
    assert main(["init", "ur5e", *logs, "-o", str(tmp_path / "all.toml")]) == 0
    experiment = load_experiment(tmp_path / "all.toml")
    assert (experiment.name, [item.name for item in experiment.recordings]) == ("all", ["a", "b", "c"])
    assert capsys.readouterr().out.count("position q0") == 1


def test_one_value_a_line_and_wrong_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = np.column_stack([T, Q, DQ, TAU])
    np.savetxt(tmp_path / "run.txt", values.reshape(-1), fmt="%.17g")
    log = str(tmp_path / "run.txt")
    for options, message in (
        ([], "run.txt: the file has one value a line; --values-per-sample N says how many make a sample"),
        (["--values-per-sample", "19", "--columns", "torque"], "--columns takes KIND=COLUMNS"),
        (["--values-per-sample", "19", "--columns", "power=2-7"], "'power' is not a kind of signal"),
        (["--values-per-sample", "19", "--columns", "torque=14-20"], "there is no column '14-20'"),
        (["--values-per-sample", "19", "--gain", "1", "2"], "--gain takes one number or 6"),
        (["--values-per-sample", "18"], "not a whole number of samples"),
    ):
        assert main(["init", "ur5e", log, *options]) == 2
        assert message in capsys.readouterr().err
    assert main(["init", "ur5e", log, "--values-per-sample", "19"]) == 0
    np.testing.assert_array_equal(load_experiment(tmp_path / "run.toml").recordings[0].tau, TAU)


def test_the_rest_before_and_after_a_motion_is_left_out(tmp_path: Path) -> None:
    """So is the way to the start before a rest; steps between rests are tested in the next."""
    q = np.concatenate(
        [np.tile(Q[:1] + 0.1, (500, 1)), np.linspace(Q[0] + 0.1, Q[0], 150), np.tile(Q[:1], (400, 1)), Q]
    )
    q = np.concatenate([q, np.tile(Q[-1:], (600, 1))])
    t = np.arange(len(q)) / RATE
    log = write(tmp_path / "run.csv", ["t", *named("q"), *named("tau")], t, q, np.cos(q))
    path, draft = initialise("ur5e", log)
    ((start, stop),) = load_experiment(path).recordings[0].windows
    assert abs(start - 1050) <= 100
    assert abs(stop - 5050) <= 100
    assert any("the samples before and after are left out" in sentence for sentence in draft.read)


def test_a_file_is_not_overwritten_for_several_logs(tmp_path: Path) -> None:
    log = write(tmp_path / "a.csv", ["t", *named("q"), *named("tau")], T, Q, TAU)
    initialise("ur5e", [log])
    with pytest.raises(ExperimentError, match="--force overwrites it"):
        initialise("ur5e", [log, log])


def test_values_per_sample_has_bounds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "stream.txt"
    log.write_text("\n".join(["0.1"] * 100) + "\n", encoding="utf-8")
    assert main(["init", "planar2", str(log), "--values-per-sample", "0"]) == 2
    assert "--values-per-sample must be a whole number from 1 to 10000, got 0" in capsys.readouterr().err


def test_steps_after_waves_count_as_motion(tmp_path: Path) -> None:
    """Twenty seconds of waves, and twenty of steps every two: all of it, and half a second of rest before and after goes."""
    rate, wave = 50.0, 20.0
    t = np.arange(round(46 * rate)) / rate
    levels = np.random.default_rng(0).uniform(-0.5, 0.5, (10, 2))
    steps = levels[np.clip(((t - 22.0) // 2).astype(int), 0, 9)]
    command = np.where((t < 2.0)[:, None], 0.0, 0.4 * np.sin((t - 2.0)[:, None] * np.array([2.0, 3.0])))
    command = np.where((t < 2.0 + wave)[:, None], command, steps)
    q = command.copy()
    for k in range(1, len(q)):
        q[k] = q[k - 1] + 0.3 * (command[k] - q[k - 1])
    names = ["t", "q1", "q2", "cmd1", "cmd2"]
    log = write(tmp_path / "run.csv", names, t, q, command)
    path, _ = initialise("planar2", log, servo={"kp": [20.0], "kv": [1.5]})
    ((start, stop),) = load_experiment(path).recordings[0].windows
    moved = np.flatnonzero(np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-3)
    assert abs(start - moved[0]) <= 10
    assert abs(stop - moved[-1]) <= 15
    assert moved[-1] > 40.0 * rate  # the last step is not the end of the waves


@pytest.mark.parametrize(("late", "bridged"), [(1.1e-2, True), (4e-2, True), (8e-2, False)])
def test_a_late_stamp_is_no_uneven_log(tmp_path: Path, late: float, bridged: bool) -> None:
    """One step of 20.29 in place of 20.06 ms: the log is read as it is. Beyond a twentieth of a step it is resampled."""
    step = 20.06e-3
    t = step * np.arange(400)
    t[200:] += late * step
    q = np.column_stack([np.sin(3.0 * t), np.cos(2.0 * t)])
    log = write(tmp_path / "run.csv", ["t", "q1", "q2", "tau1", "tau2"], t, q, np.cos(q))
    path, _ = initialise("planar2", log)
    assert ("resample = true" in path.read_text(encoding="utf-8")) != bridged
    (recording,) = load_experiment(path).recordings
    assert len(recording.q) in (400, 401)
    # Many of them are uneven sampling.
    t = step * np.arange(400) + np.repeat(np.arange(40), 10) * 1.1e-2 * step
    path, _ = initialise(
        "planar2", write(log, ["t", "q1", "q2", "tau1", "tau2"], t, q, np.cos(q)), force=True
    )
    assert "resample = true" in path.read_text(encoding="utf-8")


def arm_log(folder: Path, *, position: float = 1.0, torque: float = 1.0) -> Path:
    """A log of the planar arm with gravity along y, positions and torques times factors."""
    rng = np.random.default_rng(4)
    robot = didim.load_robot("planar2")
    t = np.arange(6000) / 500.0
    phases = rng.uniform(0.0, 6.0, (5, 2))
    waves = [np.sin(2 * np.pi * 0.25 * (k + 1) * t[:, None] + phases[k]) / (k + 1) for k in range(5)]
    q = np.sum(waves, axis=0) * np.array([1.2, 1.5])
    dq = np.gradient(q, t, axis=0)
    tau = didim.inverse_dynamics(robot, q, dq, np.gradient(dq, t, axis=0), robot.parameter_set("reference"))
    tau = tau + 0.02 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    names = ["t", "q1", "q2", "tau1", "tau2"]
    return write(folder / "run.csv", names, t, position * q, torque * tau)


def printed_error(sentences: list[str]) -> str:
    (sentence,) = [each for each in sentences if each.startswith("relative error of the fit (idim-ls): ")]
    return sentence.removeprefix("relative error of the fit (idim-ls): ").split(" %")[0]


@pytest.mark.parametrize("ratio", [None, 30.0, 100.0, 160.0])
def test_motors_are_tried_before_degrees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], ratio: float | None
) -> None:
    """Positions too large for radians: degrees where they are, else gears of the ratio that the torques show."""
    factor = np.degrees(1.0) if ratio is None else ratio
    log = arm_log(tmp_path, position=factor, torque=1.0 / factor if ratio else 1.0)
    assert main(["init", "planar2", str(log)]) == 0
    told = capsys.readouterr().out
    content = tomllib.loads((tmp_path / "run.toml").read_text(encoding="utf-8"))
    position = content["recording"][0]["position"]
    if ratio is None:
        assert (position["unit"], position["side"]) == ("deg", "joint")
        assert "transmission" not in content
    else:
        assert (position["unit"], position["side"]) == ("rad", "motor")
        assert content["recording"][0]["torque"]["side"] == "motor"
        found = np.diag(content["transmission"]["reduction"])
        np.testing.assert_allclose(found, ratio, rtol=0.02)
        assert "positions are those of motors behind gears of about" in told
        assert "in degrees the relative error is" in told
    assert "not usual" not in told


def test_gears_of_the_robot_file_are_tried_before_degrees(tmp_path: Path) -> None:
    arm_log(tmp_path, position=80.0, torque=1.0 / 80.0)
    assert main(["robot", "planar2", "-o", str(tmp_path / "geared.toml")]) == 0
    with (tmp_path / "geared.toml").open("a", encoding="utf-8") as file:
        file.write("\n[transmission]\nreduction = [[80.0, 0.0], [0.0, 80.0]]\n")
    path, draft = initialise(str(tmp_path / "geared.toml"), tmp_path / "run.csv")
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    assert content["recording"][0]["position"]["side"] == "motor"
    assert "transmission" not in content
    assert any(each.startswith("positions are those of the motors") for each in draft.read)


def test_init_prints_the_error_of_identify(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same number in the same words, by the same definition."""
    _, draft = initialise("planar2", arm_log(tmp_path))
    printed = printed_error(draft.read)
    assert main(["identify", str(tmp_path / "run.toml")]) in (0, 1)
    table = capsys.readouterr().out
    (line,) = [line for line in table.splitlines() if line.startswith("fit ")]
    assert line.split()[-1] == printed


def test_an_error_that_is_not_usual_is_not_printed_as_if_it_were(tmp_path: Path) -> None:
    log = arm_log(tmp_path)
    t, *columns = np.loadtxt(log, delimiter=",", skiprows=1).T
    names = ["t", "q1", "q2", "tau1", "tau2"]
    noise = np.random.default_rng(0).standard_normal((len(t), 2))
    write(log, names, t, *columns[:2], noise)
    _, draft = initialise("planar2", log)
    assert float(printed_error(draft.read)) > 90.0
    assert any("which is not usual" in each and "`didim check run.toml`" in each for each in draft.read)
