"""Experiment files: the examples say what their recipes say, and every wrong key is one sentence."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.errors import DidimError, ExperimentError, FitError
from didim.experiment.experiment import Experiment
from didim.experiment.experiment_file import load_experiment
from didim.experiment.specs import ControllerSpec, Measurement, ReferenceSpec, SimulationSettings
from didim.log.recording import Recording
from didim.regression.settings import LeastSquaresSettings
from didim.robot.robot_file import load_robot
from didim.signal.processing import SignalProcessing
from didim.signal.window import DelaySettings

N = 60
LOG = """\
schema = 1
robot = "planar2"
[[recording]]
rate_hz = 100
[recording.position]
file = "q.csv"
unit = "rad"
side = "joint"
[recording.torque]
file = "u.csv"
unit = "N.m"
side = "joint"
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """An experiment file with its data beside it."""
    t = np.arange(N) / 100.0
    q = np.column_stack([np.sin(t), np.cos(t)])
    np.savetxt(tmp_path / "q.csv", q, delimiter=",", header="q1,q2")
    np.savetxt(tmp_path / "u.csv", 2.0 * q, delimiter=",")
    path = tmp_path / "log.toml"
    path.write_text(LOG, encoding="utf-8")
    return path


def message(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DidimError) as caught:
        load_experiment(path)
    return str(caught.value)


def test_a_short_file_takes_the_defaults(log: Path) -> None:
    experiment = load_experiment(log)
    assert experiment.name == "log"
    assert experiment.path == log
    assert experiment.robot.name == "planar2"
    assert experiment.signal == SignalProcessing(cutoff_hz=None)
    assert experiment.least_squares == LeastSquaresSettings()
    assert experiment.delay == DelaySettings()
    assert (experiment.fixed, experiment.dropped) == ({}, ())
    assert experiment.reference is None
    assert experiment.controller is None
    (recording,) = experiment.recordings
    assert recording.name == "recording 1"
    assert recording.q.shape == (N, 2)
    for role, file in (("experiment", "log.toml"), ("data", "q.csv"), ("data", "u.csv")):
        digest = hashlib.sha256((log.parent / file).read_bytes()).hexdigest()
        assert experiment.digests[f"{role} {file}"] == digest
    assert experiment.digests["robot planar2.toml"] == experiment.robot.digest


def test_every_table_is_read(log: Path) -> None:
    text = (
        LOG.replace('robot = "planar2"', 'robot = "planar2"\nname = "an arm"')
        + """
[[recording]]
name = "second"
role = "held-out"
rate_hz = 100
windows_s = [[0.1, 0.5]]
position = { file = "q.csv", unit = "deg", side = "joint" }
[friction]
coulomb = "tanh"
smoothing_rad_s = 0.01
[signal]
cutoff_hz = 20
order = 2
padding = "matlab"
trim_start = 3
trim_end = 4
decimation = [2, 3]
decimation_convention = "matlab"
[least_squares]
weights = "none"
reweightings = 2
variance = "r-1"
uncertainty = "white"
[delay]
compensate_samples = "estimate"
[parameters]
fixed = { Fv1 = 0.5 }
dropped = ["Off2"]
[reference]
kind = "recorded"
[controller]
kind = "pd"
kp = 10
kv = 1
[simulation]
smoothing_rad_s = 0.01
step_s = 0.002
[measurement]
torque_noise_n_m = 0.1
seed = 3
"""
    )
    log.write_text(text, encoding="utf-8")
    experiment = load_experiment(str(log))
    assert experiment.name == "an arm"
    assert [recording.name for recording in experiment.recordings] == ["recording 1", "second"]
    assert experiment.recordings[1].windows == ((10, 50),)
    assert experiment.recordings[1].role == "held-out"
    assert experiment.recordings[1].tau is None
    assert experiment.signal == SignalProcessing(
        cutoff_hz=20.0,
        order=2,
        padding="matlab",
        trim_start=3,
        trim_end=4,
        decimation=(2, 3),
        decimation_convention="matlab",
    )
    assert experiment.least_squares == LeastSquaresSettings(
        weights="none", reweightings=2, variance="r-1", uncertainty="white"
    )
    assert experiment.delay.compensate_samples == "estimate"
    assert experiment.fixed == {"Fv1": 0.5}
    assert experiment.dropped == ("Off2",)
    assert isinstance(experiment.reference, ReferenceSpec)
    assert experiment.reference.kind == "recorded"
    assert isinstance(experiment.controller, ControllerSpec)
    assert experiment.controller.settings == {"kind": "pd", "kp": 10, "kv": 1}
    assert experiment.simulation == SimulationSettings(smoothing=(0.01, 0.01), step_s=0.002)
    assert experiment.measurement == Measurement(torque_noise=(0.1, 0.1), seed=3)


def test_the_data_folder_is_where_the_data_are_looked_up(log: Path, tmp_path: Path) -> None:
    other = tmp_path / "elsewhere"
    other.mkdir()
    (log.parent / "q.csv").rename(other / "q.csv")
    (log.parent / "u.csv").rename(other / "u.csv")
    assert load_experiment(log, data=other).recordings[0].q.shape == (N, 2)
    with pytest.raises(DidimError, match=r"q\.csv: no such data file$"):
        load_experiment(log)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("schema = 1", "schema = 2", "log.toml: schema 2 is unknown; this version reads schema 1"),
        ("schema = 1\n", "", "log.toml: key 'schema' is missing"),
        ("schema = 1", 'schema = 1\nrobots = "a"', "log.toml: unknown key 'robots'; did you mean 'robot'?"),
        (
            "[[recording]]",
            "[signal]\ncutof_hz = 1\n[[recording]]",
            "log.toml: [signal] unknown key 'cutof_hz'; did you mean 'cutoff_hz'?",
        ),
        ("[[recording]]", "[signal]\ncutoff_hz = 0\n[[recording]]", "log.toml: [signal] cutoff_hz must be above 0.0, got 0.0"),
        (
            "[[recording]]",
            "[signal]\ndecimation = [2.5]\n[[recording]]",
            "log.toml: [signal] decimation must be a list of integers, got [2.5]",
        ),
        (
            "[[recording]]",
            '[least_squares]\nweights = "joint"\n[[recording]]',
            "log.toml: [least_squares] weights must be one of 'none', 'per-joint', got 'joint'; "
            "did you mean 'per-joint'?",
        ),
        (
            "[[recording]]",
            '[delay]\ncompensate_samples = "guess"\n[[recording]]',
            "log.toml: [delay] compensate_samples must be a number, one per joint, 'hold' or 'estimate', got 'guess'",
        ),
        (
            "[[recording]]",
            "[transmission]\nreduction = [[1, 1], [1, 1]]\n[[recording]]",
            "log.toml: [transmission] reduction is singular: the row of motor 2 is a combination of the rows "
            "before it",
        ),
        (
            "[[recording]]",
            '[friction]\ncolomb = "tanh"\n[[recording]]',
            "log.toml: [friction] unknown key 'colomb'; did you mean 'coulomb'?",
        ),
        (
            "[[recording]]",
            '[friction]\ncoulomb = "tanh"\n[[recording]]',
            "log.toml: [friction] coulomb = 'tanh' needs smoothing_rad_s above 0 for joint 1",
        ),
        (
            "[[recording]]",
            '[parameters]\ndropped = "Off1"\n[[recording]]',
            "log.toml: [parameters] dropped must be a list of texts, got 'Off1'",
        ),
        (
            "[[recording]]",
            "[parameters]\nfixed = { Fv1 = true }\n[[recording]]",
            "log.toml: [parameters.fixed] Fv1 must be a finite number, got True",
        ),
        ('unit = "rad"', 'unit = "radian"', None),
    ],
)  # fmt: skip
def test_wrong_keys(log: Path, old: str, new: str, expected: str | None) -> None:
    said = message(log, LOG.replace(old, new))
    if expected is None:
        expected = "log.toml: [recording.position] unit 'radian' is unknown here; known are "
        assert said.startswith(expected)
    else:
        assert said == expected


def test_a_robot_beside_the_file_that_is_missing(log: Path) -> None:
    assert "none.toml" in message(log, LOG.replace('"planar2"', '"none.toml"'))


def test_a_robot_file_whose_name_does_not_end_in_toml(log: Path) -> None:
    robot = load_robot("planar2").path.read_bytes()
    (log.parent / "mine").write_bytes(robot)
    said = message(log, LOG.replace('"planar2"', '"mine"'))
    assert (
        said
        == f"{log.parent / 'mine'}: the name of a robot file must end in .toml, or .urdf for a URDF; rename it"
    )
    (log.parent / "mine").rename(log.parent / "mine.toml")
    said = message(log, LOG.replace('"planar2"', '"mine"'))
    assert said == "no packaged robot 'mine'; did you mean the file 'mine.toml'?"
    # A packaged robot is not hidden by a file of its name.
    (log.parent / "planar2").write_bytes(b"")
    (log.parent / "planar2.toml").write_bytes(b"")
    log.write_text(LOG, encoding="utf-8")
    assert load_experiment(log).robot.path.parent != log.parent


def test_digests_of_files_of_one_name_stay_apart(log: Path, tmp_path: Path) -> None:
    (tmp_path / "lab").mkdir()
    robot = tmp_path / "lab" / "log.toml"
    robot.write_bytes(load_robot("planar2").path.read_bytes())
    log.write_text(LOG.replace('"planar2"', '"lab/log.toml"'), encoding="utf-8")
    digests = load_experiment(log).digests
    assert set(digests) == {"experiment log.toml", "robot log.toml", "data q.csv", "data u.csv"}
    for key, path in (("experiment log.toml", log), ("robot log.toml", robot)):
        assert digests[key] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_recordings_are_needed_and_have_different_names(log: Path) -> None:
    expected = "log.toml: there is neither a [[recording]] to read nor a [reference] to simulate"
    assert message(log, 'schema = 1\nrobot = "planar2"\n') == expected
    again = LOG[LOG.index("[[") :].replace("[[recording]]", '[[recording]]\nname = "recording 1"')
    expected = "log.toml: [recording 2] name 'recording 1' is already used by an earlier recording"
    assert message(log, LOG + again) == expected


def test_an_experiment_made_in_python() -> None:
    robot = load_robot("planar2")
    q = np.zeros((N, 2))
    experiment = Experiment(name="arm", robot=robot, recordings=(Recording.from_arrays(q, q, rate_hz=100.0),))
    assert experiment.path is None
    assert experiment.least_squares == LeastSquaresSettings()
    with pytest.raises(FitError, match=r"^dropped must be a list of parameter names, got 'Off1'$"):
        replace(experiment, dropped="Off1")  # type: ignore[arg-type]
    with pytest.raises(FitError, match=r"^experiment 'arm' has no recording with role 'fit'$"):
        didim.identify(Experiment(name="arm", robot=robot, recordings=()), didim.IDIMLS())
    with pytest.raises(ExperimentError) as caught:
        Experiment(name="arm", robot=robot, recordings=(Recording.from_arrays(q[:, :1], rate_hz=1.0),))
    expected = f"recording: q must have shape (n_samples, 2) for robot 'planar2', got ({N}, 1)"
    assert str(caught.value) == expected


def test_emps_example(project: Path, shared: Path) -> None:
    data = shared / "data" / "emps"
    experiment = load_experiment(project / "examples" / "emps.toml", data=data)
    (recording,) = experiment.recordings
    assert recording.q.shape == (24841, 1)
    assert recording.tau is not None
    assert recording.q_ref is not None
    assert recording.rate_hz == 1000.0
    assert experiment.signal == SignalProcessing(
        cutoff_hz=100.0,
        order=4,
        padding="matlab",
        ends="first-order",
        trim_start=49,
        decimation=(10,),
        decimation_convention="matlab",
        edge_rows=0,
    )
    assert experiment.least_squares.variance == "r-1"
    assert experiment.least_squares.uncertainty == "white"
    assert isinstance(experiment.controller, ControllerSpec)
    assert experiment.controller.settings["velocity_fir"] == [0.5, 0.5]
    # The controller of the file, on the logged positions, is the logged force (0.24 %, data/README.md).
    control = experiment.controller.settings
    step = control["sample_time_s"]
    q = recording.q[:, 0]
    qf = 0.5 * (q[1:] + q[:-1])
    velocity = np.diff(qf) / step
    error = recording.q_ref[2:, 0] - q[2:]
    force = control["gain"][0] * control["kv"][0] * (control["kp"][0] * error - velocity)
    measured = recording.tau[2:, 0]
    assert np.linalg.norm(force - measured) < 0.003 * np.linalg.norm(measured)


def test_emps_asymmetric_example(project: Path, shared: Path) -> None:
    data = shared / "data" / "emps"
    symmetric = load_experiment(project / "examples" / "emps.toml", data=data)
    asymmetric = load_experiment(project / "examples" / "emps_asymmetric.toml", data=data)
    assert asymmetric.signal == symmetric.signal
    assert asymmetric.least_squares == symmetric.least_squares
    assert len(asymmetric.robot.base_parameters.names) == 5
    assert len(symmetric.robot.base_parameters.names) == 4


def test_the_command_in_the_head_of_an_example_is_its_own(project: Path) -> None:
    files = sorted((project / "examples").glob("*.toml"))
    assert len(files) >= 4
    for file in files:
        head = file.read_text(encoding="utf-8").partition("schema = 1")[0]
        named = re.findall(r"didim (?:identify|simulate|study) (\S+)", head)
        assert named
        assert set(named) == {f"examples/{file.name}"}


@pytest.mark.parametrize("file", ["tx40_log.toml", "tx40_log_best.toml"])
def test_tx40_examples(project: Path, shared: Path, file: str) -> None:
    experiment = load_experiment(project / "examples" / file, data=shared / "data" / "tx40")
    (recording,) = experiment.recordings
    assert recording.q.shape == (45000, 6)
    assert recording.tau is not None
    start = [0.0, np.pi / 2, -np.pi / 2, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(recording.q[0], start, atol=1e-3)
    # Joint 2 carries the arm, and motor 6 adds to joint 5 with its own ratio.
    motor = np.loadtxt(shared / "data" / "tx40" / "motor_torque.csv", delimiter=",", skiprows=1, max_rows=1)
    assert recording.tau[0, 4] == pytest.approx(45 * motor[4] + 32 * motor[5])
    if file == "tx40_log.toml":
        expected = SignalProcessing(
            cutoff_hz=50.0,
            form="transfer-function",
            ends="first-order",
            trim_start=100,
            trim_end=100,
            decimation=(10, 10),
            edge_rows=0,
        )
        assert experiment.signal == expected
        assert experiment.least_squares == LeastSquaresSettings(uncertainty="decimated")
