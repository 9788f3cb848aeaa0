"""``didim init`` on several files: recordings, or the signals of one; other names of joints, German numbers, cut lines; drafts."""

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
from didim.errors import ExperimentError, RecordingError
from didim.experiment.draft import initialise
from didim.experiment.draft_columns import joints_by_name, name_without_signal, read_column

pytestmark = pytest.mark.usefixtures("without_laws")
Array = NDArray[np.float64]
RATE = 500.0
T = np.arange(3000) / RATE
Q = np.column_stack([np.sin(3.0 * T), np.cos(2.0 * T)])
DQ = np.column_stack([3.0 * np.cos(3.0 * T), -2.0 * np.sin(2.0 * T)])
TAU = np.column_stack([20.0 * np.cos(3.0 * T), 5.0 * np.sin(5.0 * T)])
JOINTS = ["Joint_1", "Joint_2"]


def write(path: Path, names: list[str] | None, *columns: Array, delimiter: str = ",") -> Path:
    header = [] if names is None else [delimiter.join(names)]
    rows = [delimiter.join(f"{value:.12g}" for value in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([*header, *rows]) + "\n", encoding="utf-8")
    return path


def check_log(path: Path, name: str) -> None:
    (recording,) = load_experiment(path).recordings
    assert recording.name == name
    np.testing.assert_allclose(recording.q, Q, atol=1e-10)
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, TAU, atol=1e-9)


def test_a_file_for_each_signal_with_the_same_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Positions and torques in two files without time stamps, whose columns are called Joint_1 in both."""
    logs = [
        str(write(tmp_path / f"run_{kind}.csv", JOINTS, values))
        for kind, values in (("position", Q), ("torque", TAU))
    ]
    assert main(["init", "planar2", *logs, "--rate", "500", "-o", str(tmp_path / "x.toml")]) == 0
    told = capsys.readouterr().out
    assert (
        "- 2 files are signals of one recording: run_position.csv (position), run_torque.csv (torque)" in told
    )
    check_log(tmp_path / "x.toml", "run")
    assert main(["check", str(tmp_path / "x.toml")]) in (0, 1)
    assert main(["identify", str(tmp_path / "x.toml"), "--quiet"]) in (0, 1)


def test_three_files_with_time_stamps_of_their_own(tmp_path: Path) -> None:
    logs = [
        write(tmp_path / f"arm_{kind}.csv", ["t", *(f"- {joint}_{kind}" for joint in JOINTS)], T, values)
        for kind, values in (("position", Q), ("velocity", DQ), ("effort", TAU))
    ]
    path, draft = initialise("planar2", logs, tmp_path / "x.toml")
    assert not draft.questions
    check_log(path, "arm")
    text = path.read_text(encoding="utf-8")
    assert '# file = "arm_velocity.csv"' in text  # offered
    assert "not used" not in text


def test_text_files_without_names(tmp_path: Path) -> None:
    """A file per signal, blanks between the numbers, and the time stamps in a file too."""
    logs = [
        write(tmp_path / name, None, values, delimiter=" ")
        for name, values in (("t.txt", T), ("q.txt", Q), ("qd.txt", DQ), ("tau.txt", TAU))
    ]
    path, draft = initialise("planar2", logs, tmp_path / "x.toml")
    assert not draft.questions
    check_log(path, "t")


def test_a_file_for_each_joint(tmp_path: Path) -> None:
    logs = [
        write(tmp_path / f"{stem}{joint + 1}.txt", None, values[:, joint])
        for stem, values in (("q", Q), ("tau", TAU))
        for joint in range(2)
    ]
    path, draft = initialise("planar2", logs, tmp_path / "x.toml", rate_hz=RATE)
    assert not draft.questions
    check_log(path, load_experiment(path).recordings[0].name)


def test_files_that_no_name_tells_apart(tmp_path: Path) -> None:
    """The smoother one has the positions."""
    rng = np.random.default_rng(0)
    noisy = TAU + 0.5 * rng.standard_normal(TAU.shape)
    logs = [write(tmp_path / "b.csv", JOINTS, noisy), write(tmp_path / "a.csv", JOINTS, Q)]
    path, draft = initialise("planar2", logs, tmp_path / "x.toml", rate_hz=RATE)
    assert not draft.questions
    np.testing.assert_allclose(load_experiment(path).recordings[0].q, Q, atol=1e-10)


def test_two_runs_of_two_signals(tmp_path: Path) -> None:
    logs = [
        write(tmp_path / f"{run}_{kind}.csv", JOINTS, factor * values)
        for run, factor in (("monday", 1.0), ("tuesday", 0.5))
        for kind, values in (("pos", Q), ("tau", TAU))
    ]
    path, draft = initialise("planar2", logs, tmp_path / "x.toml", rate_hz=RATE)
    assert [recording.name for recording in load_experiment(path).recordings] == ["monday", "tuesday"]
    assert "4 files make 2 recordings" in draft.read


def test_whole_logs_stay_recordings(tmp_path: Path) -> None:
    names = ["t", "q1", "q2", "tau1", "tau2"]
    logs = [write(tmp_path / name, names, T, Q, TAU) for name in ("position.csv", "torque.csv")]
    path, draft = initialise("planar2", logs, tmp_path / "x.toml")
    assert [recording.name for recording in load_experiment(path).recordings] == ["position", "torque"]
    assert "2 files make 2 recordings" in draft.read


def test_files_of_one_log_need_equal_rows(tmp_path: Path) -> None:
    position = write(tmp_path / "run_position.csv", ["t", *JOINTS], T, Q)
    torque = write(tmp_path / "run_torque.csv", ["t", *JOINTS], T[:-1], TAU[:-1])
    with pytest.raises(
        ExperimentError,
        match=r"run_torque.csv has 2999 rows and run_position.csv has 3000: .* need equal rows",
    ):
        initialise("planar2", [position, torque], tmp_path / "x.toml")
    write(torque, ["t", *JOINTS], T + 0.1 * (T > 1.0), TAU)
    with pytest.raises(ExperimentError, match=r"have other time stamps from row 502 on: .* to one clock$"):
        initialise("planar2", [position, torque], tmp_path / "x.toml")


def test_columns_of_one_of_several_files(tmp_path: Path) -> None:
    """``FILE:COLUMNS`` says what neither names nor values do."""
    rng = np.random.default_rng(0)
    a = write(tmp_path / "a.csv", None, Q + 0.3 * rng.standard_normal(Q.shape))
    b = write(tmp_path / "b.csv", None, TAU)
    path, draft = initialise(
        "planar2",
        [a, b],
        tmp_path / "x.toml",
        rate_hz=RATE,
        columns={"position": "a.csv:1-2", "torque": "b:1-2"},
    )
    assert not draft.questions
    recording = load_experiment(path).recordings[0]
    np.testing.assert_allclose(recording.tau, TAU, atol=1e-9)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("position=alpha1,alpha3", "log.csv: --columns position=alpha1,alpha3: there is no column 'alpha3'; did you mean 'alpha"),
        ("positon=1-2", "'positon' is not a kind of signal"),
    ],
)  # fmt: skip
def test_numbers_of_columns_that_have_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    names = ["t", "alpha1", "alpha2", "beta1", "beta2"]
    log = str(write(tmp_path / "log.csv", names, T, Q, TAU))
    assert main(["init", "planar2", log, "--columns", text]) == 2
    assert message in capsys.readouterr().err
    options = ["--columns", "position=2-3", "--columns", "torque=4,beta2"]
    assert main(["init", "planar2", log, *options]) == 0
    check_log(tmp_path / "log.toml", "log")


def test_times_are_time() -> None:
    assert [read_column(name).what for name in ("times", "timestamps", "times_ms")] == ["time"] * 3


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("delimiter", [";", "\t", " "])
def test_decimal_commas(tmp_path: Path, named: bool, delimiter: str) -> None:
    names = ["t", "q1", "q2", "tau1", "tau2"]
    rng = np.random.default_rng(0)
    tau = np.round(TAU + 0.5 * rng.standard_normal(TAU.shape), 6)
    log = write(tmp_path / "log.csv", names if named else None, T, Q, DQ, tau, delimiter=delimiter)
    if named:
        write(log, [*names[:3], "dq1", "dq2", *names[3:]], T, Q, DQ, tau, delimiter=delimiter)
    log.write_text(log.read_text(encoding="utf-8").replace(".", ","), encoding="utf-8")
    path, draft = initialise("planar2", log)
    assert not draft.questions
    assert tomllib.loads(path.read_text(encoding="utf-8"))["recording"][0]["position"]["decimal"] == ","
    recording = load_experiment(path).recordings[0]
    np.testing.assert_allclose(recording.q, Q, atol=1e-10)
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, tau, atol=1e-10)


def test_a_point_among_decimal_commas(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("t;q1;q2\n" + "0,1;0,2;0,3\n" * 60 + "0.1;0,2;0,3\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"log\.csv: line 62 has a point, and decimal = ',' says"):
        initialise("planar2", log)


@pytest.mark.parametrize(
    ("row", "text", "message"),
    [
        (2999, "5.998,0.1,0.", "log.csv: row 3000 (line 3001) has 3 columns where the first line has 5; it is the last one"),
        (1500, "3.0,0.1", "log.csv: row 1501 (line 1502) has 2 columns where the first line has 5"),
        (1500, "3.0,0.1,0.2,1.5e15.9,2", "log.csv: row 1501 (line 1502), column 'tau1', is '1.5e15.9', not a number"),
        (1500, "3.0,0.1,0.2,1.5e154,2", "log.csv: row 1501 (line 1502), column 'tau1', is 1.5e+154, and 98 % of the values"),
        (1500, "3.0,0.10.2e7,0.2,1.5,2", "log.csv: row 1501 (line 1502), column 'q1', is '0.10.2e7', not a number"),
        (1500, "3.0,0.1,3.1e12,1.5,2", "is a line cut?"),
    ],
)  # fmt: skip
def test_cut_rows_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], row: int, text: str, message: str
) -> None:
    log = write(tmp_path / "log.csv", ["t", "q1", "q2", "tau1", "tau2"], T, Q, TAU)
    lines = log.read_text(encoding="utf-8").splitlines()
    lines[row + 1] = text
    log.write_text("\n".join(lines), encoding="utf-8")
    assert main(["init", "planar2", str(log)]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "log.toml").exists()


def test_matrices_that_lie_and_fields_of_structures(tmp_path: Path) -> None:
    """As a public log of a KUKA has them: a structure, samples in columns, several positions to choose from."""
    rec = {"time_s": T[None, :], "act_pos_mot_rad": Q.T, "act_pos_se_rad": Q.T + 0.01, "act_torque_nm": TAU.T}
    scipy.io.savemat(tmp_path / "log.mat", {"rec": rec, "para": {"u": np.ones((2, 1))}})
    _, draft = initialise("planar2", tmp_path / "log.mat")
    (question,) = draft.questions
    assert question.endswith("choose one with --columns position=...")
    path, draft = initialise(
        "planar2",
        tmp_path / "log.mat",
        columns={"position": "rec.act_pos_mot_rad"},
        sides={"position": "joint"},
    )
    assert not draft.questions
    check_log(path, "log")


@pytest.mark.parametrize(
    ("found", "robot", "names"),
    [
        (["b", "a"], ["a", "b"], ["a", "b"]),
        (["fer_joint2", "fer_joint1"], ["panda_joint1", "panda_joint2"], ["fer_joint1", "fer_joint2"]),
        (["ur_elbow", "ur_wrist", "finger"], ["elbow", "wrist"], ["ur_elbow", "ur_wrist"]),
        (["A2", "A1"], [], ["A1", "A2"]),
        (["A2", "A1"], ["shoulder", "elbow"], ["A1", "A2"]),
        (["left_elbow", "left_wrist", "right_elbow", "right_wrist"], ["elbow", "wrist"], []),
        (["base", "tip"], ["shoulder", "elbow"], []),
        (["A1", "A3"], [], []),
        (["A1", "A2", "A3"], [], []),
    ],
)
def test_joints_of_other_names(found: list[str], robot: list[str], names: list[str]) -> None:
    chosen, note = joints_by_name(found, robot, 2)
    assert chosen == names
    assert bool(note) == (bool(names) and names != robot)


@pytest.mark.slow
def test_bags_with_other_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rosbags", reason="needs the extra 'ros'")
    from bags import write_bag

    robot = didim.load_robot("panda")
    t = np.arange(3000) / RATE
    phases = np.arange(7)
    q = np.sin(t[:, None] * (2.0 + 0.3 * phases) + phases)
    tau = 20.0 * np.cos(t[:, None] * (3.0 + 0.2 * phases))
    write_bag(tmp_path / "bag", tuple(f"fer_joint{k}" for k in range(1, 8)), t, q, tau)
    bag = str(tmp_path / "bag")
    assert main(["init", "panda", bag, "--topic", "/joint_states", "-o", str(tmp_path / "x.toml")]) == 0
    assert (
        "joints fer_joint1 to fer_joint7 of the log are panda_joint1 to panda_joint7"
        in capsys.readouterr().out
    )
    np.testing.assert_array_equal(load_experiment(tmp_path / "x.toml").recordings[0].q, q)
    write_bag(tmp_path / "bag2", tuple("abcdefg"), t, q, tau)
    bag, out = str(tmp_path / "bag2"), str(tmp_path / "y.toml")
    assert main(["init", "panda", bag, "--topic", "/joint_states", "-o", out]) == 1
    said = capsys.readouterr().err
    assert "are the 7 joints of the robot? Name them in order" in said
    assert set("abcdefg") < set(said.split("joints ")[1].split(" are")[0].split(", "))
    assert said.count("which of the log's joints") == 1
    order = ["--columns", "position=b,a,c,d,e,f,g"]
    assert main(["init", "panda", bag, "--topic", "/joint_states", "-o", out, *order]) == 0
    recording = load_experiment(Path(out)).recordings[0]
    np.testing.assert_array_equal(recording.q, q[:, [1, 0, 2, 3, 4, 5, 6]])
    np.testing.assert_array_equal(recording.tau, tau[:, [1, 0, 2, 3, 4, 5, 6]])
    assert robot.joint_names[0] == "panda_joint1"


def test_words_of_files() -> None:
    assert name_without_signal("motor_position") == name_without_signal("MotorTorque") == ("motor",)
    assert name_without_signal("q") == name_without_signal("tau") == ()


def test_the_chain_of_a_tree_by_the_names_of_the_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two arms on one torso: the log names one, and init writes its robot beside the experiment."""
    (tmp_path / "twins.urdf").write_text(twin_arms(), encoding="utf-8")
    q = np.sin(T[:, None] * np.array([2.0, 2.3, 2.6]))
    joints = ["left_1", "left_2", "left_3"]
    names = ["t", *(f"{joint}_pos" for joint in joints), *(f"{joint}_effort" for joint in joints)]
    log = str(write(tmp_path / "log.csv", names, T, q, np.cos(q)))
    robot = str(tmp_path / "twins.urdf")
    assert main(["init", robot, log]) == 0
    assert "log_robot.toml: written" in capsys.readouterr().out
    experiment = load_experiment(tmp_path / "log.toml")
    assert experiment.robot.joint_names == ("left_1", "left_2", "left_3")
    other = write(tmp_path / "bare.csv", None, T, q, np.gradient(q, T, axis=0), np.cos(3.0 * q))
    assert main(["init", robot, str(other)]) == 1
    assert "the positions of the 6 joints" in capsys.readouterr().err
    assert main(["init", robot, str(other), "--tip", "right_link_3", "--columns", "torque=8-10"]) == 0
    assert load_experiment(tmp_path / "bare.toml").robot.joint_names[0] == "right_1"


def twin_arms() -> str:
    parts = ['<robot name="twins"><link name="base"/>']
    for arm, y in (("left", 0.3), ("right", -0.3)):
        parent = "base"
        for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0"), start=1):
            link = f"{arm}_link_{k}"
            parts.append(
                f'<link name="{link}"/><joint name="{arm}_{k}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{link}"/><origin xyz="0 {y if k == 1 else 0} 0.4"/><axis xyz="{axis}"/>'
                '<limit lower="-3" upper="3" velocity="2" effort="50"/></joint>'
            )
            parent = link
    return "".join([*parts, "</robot>"])


def test_a_draft_with_questions_is_refused_and_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(write(tmp_path / "log.csv", ["t", "q1", "q2", "iq1", "iq2"], T, Q, TAU))
    path = tmp_path / "log.toml"
    assert main(["init", "planar2", log]) == 1
    asked = capsys.readouterr()
    assert "how many N.m are one A (--gain" in asked.err
    assert "- cut-off" in asked.out  # filters need no gains
    assert "cutoff_hz" in tomllib.loads(path.read_text(encoding="utf-8"))["signal"]
    for command in ("identify", "check"):
        assert main([command, str(path)]) == 2
        assert "log.toml: not finished, open is: how many N.m are one A" in capsys.readouterr().err
    assert main(["init", "planar2", log, "--gain", "2"]) == 0  # without --force
    assert main(["identify", str(path), "--quiet"]) in (0, 1)
    capsys.readouterr()
    assert main(["init", "planar2", log, "--gain", "2"]) == 2  # a finished file is the user's
    assert "log.toml: the file is there already; --force overwrites it" in capsys.readouterr().err


def test_an_edited_draft_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = str(write(tmp_path / "log.csv", ["t", "q1", "q2", "iq1", "iq2"], T, Q, TAU))
    path = tmp_path / "log.toml"
    assert main(["init", "planar2", log]) == 1
    edited = path.read_text(encoding="utf-8").replace("# gain = 1.0 #", "gain = 3.0 #")
    path.write_text(edited, encoding="utf-8")
    capsys.readouterr()
    assert main(["init", "planar2", log, "--gain", "2"]) == 2
    assert "there already, a draft that was edited since didim init wrote it" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == edited
    path.write_text("\n".join(line for line in edited.splitlines() if not line.startswith("open =")))
    assert load_experiment(path).recordings[0].tau is not None


def test_gains_to_be_estimated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = str(write(tmp_path / "log.csv", ["t", "q1", "q2", "iq1", "iq2"], T, Q, TAU))
    assert main(["init", "planar2", log, "--gain", "estimate"]) == 0
    content = tomllib.loads((tmp_path / "log.toml").read_text(encoding="utf-8"))
    assert content["recording"][0]["torque"]["gain"] == "estimate"
    assert "cutoff_hz" in content["signal"]
    for words, message in (
        (["estimat"], "--gain takes numbers or 'estimate', got 'estimat'; did you mean 'estimate'?"),
        (["1", "estimate"], "--gain takes numbers or 'estimate', got 'estimate'"),
    ):
        assert main(["init", "planar2", log, "--force", "--gain", *words]) == 2
        assert message in capsys.readouterr().err
    for words, message in (
        (["torque=moto"], "got 'moto'; did you mean 'motor'?"),
        (["torq=motor"], "got 'torq'; did you mean 'torque'?"),
        (["torque"], "--side takes TABLE=SIDE, such as --side torque=motor, got 'torque'"),
    ):
        assert main(["init", "planar2", log, "--force", "--side", *words]) == 2
        assert message in capsys.readouterr().err


UR10 = """schema = 1
name = "ur10"
convention = "dh"
"""
JOINT_ROWS = (
    (0.0, 90, 0.1273),
    (-0.612, 0, 0.0),
    (-0.5723, 0, 0.0),
    (0.0, 90, 0.163941),
    (0.0, -90, 0.1157),
    (0.0, 0, 0.0922),
)
UR_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


def ur10(folder: Path) -> str:
    """The standard table of its maker."""
    rows = [
        f'[[joint]]\nname = "{name}"\nkind = "revolute"\na_m = {a}\nalpha_deg = {alpha}\nd_m = {d}\n'
        for name, (a, alpha, d) in zip(UR_JOINTS, JOINT_ROWS, strict=True)
    ]
    (folder / "ur10.toml").write_text(UR10 + "\n".join(rows), encoding="utf-8")
    return str(folder / "ur10.toml")


REAL: dict[str, tuple[str, list[str], list[str], float]] = {
    "tx40": ("tx40", ["tx40/motor_position.csv", "tx40/motor_torque.csv"], ["--rate", "5000"], 0.058),
    "emps": ("emps", ["emps/DATA_EMPS.mat"], [], 0.04),
    "ur10": ("", ["unisa/ur10_exciting.db3", "unisa/ur10_validation.db3"], [], 0.07),
    "panda": ("panda", ["unisa/panda_exciting.db3"], [], 0.035),
}
"""Robot, files, options, and the relative error that is not exceeded."""


@pytest.mark.slow
@pytest.mark.parametrize("which", list(REAL))
def test_public_logs_get_in_by_init_alone(
    shared: Path, tmp_path: Path, which: str, request: pytest.FixtureRequest
) -> None:
    """As they were published: two files of one log, bags with other names, MATLAB.

    Without header: ``test_init_friction.py``; a tree and three files of one log: ``test_trees.py``.
    """
    if which == "tx40":  # its verdict, which takes as long as the rest: ``test_report.py``
        request.getfixturevalue("unjudged")
    if which in ("ur10", "panda"):
        pytest.importorskip("rosbags", reason="needs the extra 'ros'")
    robot, files, options, largest = REAL[which]
    data = shared / "data"
    named = robot or ur10(tmp_path)
    out: Any = tmp_path / "x.toml"
    assert main(["init", named, *(str(data / file) for file in files), *options, "-o", str(out)]) == 0
    assert main(["check", str(out)]) in (0, 1)
    fit = didim.identify(load_experiment(out), didim.IDIMLS())
    assert fit.overall_relative_error < largest


@pytest.mark.slow
@pytest.mark.usefixtures("unjudged")
def test_a_kuka_with_motor_torques_in_a_structure(
    shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two recordings of a KR300, which no packaged robot is: with the geometry of another KUKA one question stays, the gears."""
    logs = [str(shared / "data" / "kr300" / f"{run}.mat") for run in "AB"]
    out = tmp_path / "x.toml"
    columns = "position=rec.act_pos_mot_deg torque=rec.act_torque_abs_nm time=rec.time_cont reference=rec.ref_pos_deg"
    options = ["-o", str(out), *(word for text in columns.split() for word in ("--columns", text))]
    sides = [
        word for text in ("position=joint", "reference=joint", "torque=motor") for word in ("--side", text)
    ]
    assert main(["init", "kr16", *logs, *options, *sides]) == 1
    said = capsys.readouterr().err
    assert said.count("open:") == 1
    assert "the robot file has no reduction: fill in [transmission]" in said
    # Its ratios stand in the log; with them in the robot file nothing is asked.
    ratios = scipy.io.loadmat(logs[0])["para"][0, 0]["u"].ravel()
    assert main(["robot", "kr16", "-o", str(tmp_path / "kuka.toml")]) == 0
    gears = "\n".join(str(row) + "," for row in np.diag(ratios).tolist())
    with (tmp_path / "kuka.toml").open("a", encoding="utf-8") as file:
        file.write(f"\n[transmission]\nreduction = [\n{gears}\n]\n")
    assert main(["init", str(tmp_path / "kuka.toml"), *logs, *options, *sides]) == 0
    assert main(["check", str(out)]) in (0, 1)
    experiment = load_experiment(out)
    assert [len(recording.q) for recording in experiment.recordings] == [2501, 2501]
    assert didim.identify(experiment, didim.IDIMLS()).relative_error.shape == (6,)


def test_a_recorded_trajectory_is_a_log(tmp_path: Path) -> None:
    """Each point of a trajectory is a sample, where a bag has nothing else."""
    pytest.importorskip("rosbags", reason="needs the extra 'ros'")
    from bags import write_trajectory

    write_trajectory(tmp_path / "bag", ("joint_1", "joint_2"), T, Q, TAU)
    path, draft = initialise("planar2", tmp_path / "bag")
    assert not draft.questions
    recording = load_experiment(path).recordings[0]
    np.testing.assert_array_equal(recording.q, Q)
    np.testing.assert_array_equal(recording.tau, TAU)
    assert recording.rate_hz == RATE


@pytest.mark.parametrize(("suffix", "module", "reader"), [("npz", np, "load"), ("mat", scipy.io, "loadmat")])
def test_a_file_of_many_arrays_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, module: Any, reader: str
) -> None:
    """Reading the table of entries again for each array took minutes for thousands of them."""
    path, read = tmp_path / f"log.{suffix}", getattr(module, reader)
    arrays = {f"q{k}": Q[:20, 0] for k in range(50)}
    if suffix == "npz":
        np.savez(path, **arrays)  # type: ignore[arg-type]
    else:
        scipy.io.savemat(path, {**arrays, "s1": {"v": Q}, "s2": {"v": Q}, "text": "words"})
    calls = []

    def counting(*arguments: Any, **options: Any) -> Any:
        calls.append(arguments)
        return read(*arguments, **options)

    monkeypatch.setattr(module, reader, counting)
    _, draft = initialise("planar2", path, tmp_path / "out.toml")
    assert len(calls) == 1
    (question,) = [text for text in draft.questions if "the log has 50 positions" in text]
    assert len(question) < 200


def one_value_a_line(path: Path, values: Array) -> Path:
    path.write_text("\n".join(f"{value:.9g}" for value in values.ravel()) + "\n", encoding="utf-8")
    return path


def uneven(rng: np.random.Generator) -> Array:
    """Stamps of a loop without real time, as the public log of a Panda has them."""
    return np.cumsum(rng.uniform(0.9, 1.1, len(T))) / RATE


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("given", [[], ["--values-per-sample", "2"]])
def test_files_of_one_value_a_line_for_all_joints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], timed: bool, given: list[str]
) -> None:
    """The layout of a public log of a Panda: each signal of all joints in a file, line by line, and the stamps in another."""
    rng = np.random.default_rng(1)
    signals = {"positions": Q, "velocity": DQ, "torques": TAU}
    if timed:
        signals["time"] = uneven(rng)
    else:
        del signals["velocity"]
    logs = [str(one_value_a_line(tmp_path / f"traj_{name}.txt", values)) for name, values in signals.items()]
    out = tmp_path / "x.toml"
    rate = [] if timed else ["--rate", "500"]
    assert main(["init", "planar2", *logs, *rate, *given, "-o", str(out)]) == 0
    told = capsys.readouterr().out
    assert f"{len(logs)} files are signals of one recording" in told
    assert ("taken for 2 values a sample (--values-per-sample)" in told) == (not given)
    (recording,) = load_experiment(out).recordings
    assert recording.q.shape[1] == 2
    if not timed:
        check_log(out, "traj")


def test_one_value_a_line_of_unknown_width(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where no name says which signal a file holds, one question names the option."""
    logs = [
        str(one_value_a_line(tmp_path / f"{name}.txt", values)) for name, values in (("a", Q), ("b", TAU))
    ]
    assert main(["init", "planar2", *logs, "--rate", "500", "-o", str(tmp_path / "x.toml")]) == 1
    assert "(or --values-per-sample N?)" in capsys.readouterr().err
    more = ["--values-per-sample", "2", "--rate", "500", "-o", str(tmp_path / "x.toml")]
    assert main(["init", "planar2", *logs, *more]) == 0
    check_log(tmp_path / "x.toml", load_experiment(tmp_path / "x.toml").recordings[0].name)


@pytest.mark.parametrize("other", ["ddq", "base", "current_ref"])
def test_a_file_that_is_no_signal_of_the_joints_is_left_out(tmp_path: Path, other: str) -> None:
    """Five files of one log, as those of a humanoid: accelerations, or a file of another width, make no recordings."""
    rng = np.random.default_rng(2)
    more = {
        "ddq": -Q,
        "base": rng.standard_normal((len(T), 3)),
        "current_ref": rng.standard_normal((len(T), 5)),
    }
    signals = {"q": Q, "dq": DQ, "tau": TAU, "time": T, other: more[other]}
    logs = [
        write(tmp_path / f"data_{name}.txt", None, values, delimiter=" ") for name, values in signals.items()
    ]
    path, draft = initialise("planar2", logs, tmp_path / "x.toml")
    assert not draft.questions
    assert draft.read[0].startswith("5 files are signals of one recording")
    check_log(path, "data")


@pytest.mark.parametrize("name", ["ang", "state"])
def test_positions_and_torques_in_two_files(tmp_path: Path, name: str) -> None:
    """``ang.txt torque.txt``: one recording, and what no name says the values do."""
    rng = np.random.default_rng(3)
    noisy = TAU + 0.5 * rng.standard_normal(TAU.shape)
    logs = [
        write(tmp_path / f"{stem}.txt", None, values, delimiter=" ")
        for stem, values in ((name, Q), ("torque", noisy))
    ]
    path, draft = initialise("planar2", logs, tmp_path / "x.toml", rate_hz=RATE)
    assert not draft.questions
    (recording,) = load_experiment(path).recordings
    np.testing.assert_allclose(recording.q, Q, atol=1e-10)


def test_files_with_the_same_signal_stay_recordings(tmp_path: Path) -> None:
    """Two runs without torques are not one log."""
    logs = [write(tmp_path / f"{name}.csv", ["t", "q1", "q2"], T, Q) for name in ("monday", "tuesday")]
    _, draft = initialise("planar2", logs, tmp_path / "x.toml")
    assert "2 files make 2 recordings" in draft.read
