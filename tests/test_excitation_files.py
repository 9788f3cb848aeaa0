"""Designs as files: excite.toml, the command, its reports, and every export read back."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import didim
from didim.cli.main import main
from didim.errors import ExcitationError
from didim.excitation.design import Excitation
from didim.excitation.excite import excite
from didim.excitation.export import save
from didim.excitation.settings_file import read_excitation
from didim.experiment.specs import ReferenceSpec

SMALL = """
schema = 1
[excitation]
duration_s = 4
harmonics = 5
starts = 1
iterations = 10
rate_hz = 100
log_rate_hz = 500
parameters = "reference"
torque_noise_n_m = [0.4, 0.2]
home_deg = [-30, 20]
[limits]
position_deg = [[-90, 90], [-100, 100]]
max_acceleration_rad_s2 = 20
max_jerk_rad_s3 = [400, 500]
[workspace]
lowest_m = [-1, -0.9, -1]
highest_m = [1, 1, 1]
[[collision]]
link = 2
from_m = [0, 0, 0]
to_m = [0.4, 0, 0]
radius_m = 0.03
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("excite")
    (folder / "excite.toml").write_text(SMALL)
    return folder


@pytest.fixture(scope="module")
def design(folder: Path) -> Excitation:
    return excite("planar2", folder / "excite.toml")


def test_the_file_says_what_is_asked_for(folder: Path) -> None:
    robot = didim.load_robot("planar2")
    settings = read_excitation(folder / "excite.toml", robot)
    assert settings.position is not None
    np.testing.assert_allclose(settings.position, np.radians([[-90, 90], [-100, 100]]))
    assert settings.acceleration == [20.0, 20.0]
    assert settings.jerk == [400.0, 500.0]
    assert settings.home is not None
    np.testing.assert_allclose(settings.home, np.radians([-30, 20]))
    assert (settings.harmonics, settings.rate_hz, settings.torque_noise) == (5, 100.0, [0.4, 0.2])
    assert settings.workspace.lowest == (-1.0, -0.9, -1.0)
    assert [capsule.radius for capsule in settings.capsules] == [0.03]


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (("harmonics", "harmonic"), r"excite\.toml: \[excitation\] unknown key 'harmonic'; did you mean 'harmonics'"),
        (("iterations = 10", "iterations = 0"), r"excite\.toml: \[excitation\] iterations must be at least 1, got 0"),
        (("[[-90, 90], [-100, 100]]", "[[-90, 90]]"), r"\[limits\] position_deg must be a matrix of 2 rows"),
        (("link = 2", "link = 4"), r"\[collision\] link must be at most 2"),
    ],
)  # fmt: skip
def test_wrong_files_are_named(tmp_path: Path, wrong: tuple[str, str], sentence: str) -> None:
    path = tmp_path / "excite.toml"
    path.write_text(SMALL.replace(*wrong))
    with pytest.raises(ExcitationError, match=sentence):
        read_excitation(path, didim.load_robot("planar2"))


def test_the_table_is_the_motion(design: Excitation, tmp_path: Path) -> None:
    path = tmp_path / "motion.csv"
    save(design, path)
    header = path.read_text().splitlines()[0]
    assert header == "t,q1,q2,dq1,dq2,ddq1,ddq2"
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    t, q, dq, ddq = design.sampled()
    np.testing.assert_array_equal(table, np.column_stack([t, q, dq, ddq]))
    np.testing.assert_allclose(np.diff(t), 0.01, rtol=1e-9)
    np.testing.assert_allclose(q[0], np.radians([-30, 20]))


def test_the_reference_is_read_by_experiments(design: Excitation, tmp_path: Path) -> None:
    save(design, tmp_path / "motion.toml")
    path = tmp_path / "experiment.toml"
    path.write_text('schema = 1\nrobot = "planar2"\n' + (tmp_path / "motion.toml").read_text())
    experiment = didim.load_experiment(path)
    assert isinstance(experiment.reference, ReferenceSpec)
    reference = experiment.reference.build(None, None, experiment.signal)
    times = np.linspace(0.0, 4.0, 101)
    for got, want in zip(reference.at(times), design.reference.at(times), strict=True):
        np.testing.assert_array_equal(got, want)


def test_points_are_read_by_experiments_too(tmp_path: Path) -> None:
    settings = didim.excitation.ExcitationSettings(
        kind="point-to-point", points=4, starts=1, acceleration=20.0, torque_noise=0.3, parameters="reference"
    )
    found = excite("planar2", settings)
    save(found, tmp_path / "motion.toml")
    path = tmp_path / "experiment.toml"
    path.write_text('schema = 1\nrobot = "planar2"\n' + (tmp_path / "motion.toml").read_text())
    spec = didim.load_experiment(path).reference
    assert isinstance(spec, ReferenceSpec)
    reference = spec.build(None, None, didim.SignalProcessing(cutoff_hz=None))
    times = np.linspace(0.0, found.reference.duration, 101)
    np.testing.assert_array_equal(reference.at(times)[0], found.reference.at(times)[0])


def test_the_trajectory_of_ros_2_is_the_motion(design: Excitation, tmp_path: Path) -> None:
    path = tmp_path / "motion.yaml"
    save(design, path)
    message = yaml.safe_load(path.read_text())
    assert message["joint_names"] == ["joint_1", "joint_2"]
    t, q, dq, ddq = design.sampled()
    for key, values in (("positions", q), ("velocities", dq), ("accelerations", ddq)):
        np.testing.assert_array_equal([point[key] for point in message["points"]], values)
    times = [
        point["time_from_start"]["sec"] + 1e-9 * point["time_from_start"]["nanosec"]
        for point in message["points"]
    ]
    np.testing.assert_allclose(times, t, atol=1e-9)
    assert all(0 <= point["time_from_start"]["nanosec"] < 10**9 for point in message["points"])


def test_the_program_for_a_ur_is_the_motion(tmp_path: Path) -> None:
    robot = didim.load_robot("tx40")
    settings = didim.excitation.ExcitationSettings(
        duration_s=2.0,
        harmonics=4,
        starts=1,
        iterations=2,
        rate_hz=125.0,
        position=[(-1.0, 1.0)] * 6,
        torque_noise=1.0,
    )
    found = excite(robot, settings)
    path = tmp_path / "motion.script"
    save(found, path)
    text = path.read_text()
    rows = [
        np.array(row.split(","), float)
        for row in re.findall(r"^  servoj\(\[([^\]]*)\], 0, 0, 0\.008,", text, re.M)
    ]
    (first,) = re.findall(r"^  movej\(\[([^\]]*)\]", text, re.M)
    np.testing.assert_array_equal([np.array(first.split(","), float), *rows], found.sampled()[1])
    lines = text.splitlines()
    assert lines[1] == "def excite_tx40():"
    assert lines[-3:] == ["  stopj(2.0)", "end", "excite_tx40()"]


def test_files_that_cannot_be_written_are_refused_before_the_work(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, words in (
        ("motion.xls", "the file of a motion ends in one of '.csv', '.toml', '.script', '.yaml'"),
        ("motion.script", "URScript is for robots with six revolute joints, and 'planar2' is not one"),
    ):
        code = main(["excite", "planar2", str(folder / "excite.toml"), "-o", str(folder / name)])
        assert code == 2
        captured = capsys.readouterr()
        assert words in captured.err
        assert captured.out == ""


def test_the_command_writes_everything(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outputs = [folder / name for name in ("motion.csv", "motion.toml", "motion.yaml")]
    arguments = [word for path in outputs for word in ("-o", str(path))]
    report = folder / "motion.html"
    code = main(
        ["excite", "planar2", str(folder / "excite.toml"), *arguments, "--report", str(report), "--quiet"]
    )
    captured = capsys.readouterr()
    assert code == 0
    assert captured.err == ""
    assert "of those of the random motion" in captured.out
    assert "use of limits %" in captured.out
    assert all(path.stat().st_size > 500 for path in outputs)
    page = report.read_text()
    assert page.count('<img class="picture"') == 2
    assert "A motion for robot planar2" in page
    assert "No limit is exceeded on a grid 20 times finer" in page


def test_wanted_names_are_an_option(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(folder / "excite.toml")
    assert main(["excite", "planar2", path, "--for", "Fv1", "Off2", "--quiet"]) == 0
    capsys.readouterr()
    assert main(["excite", "planar2", path, "--for", "Fw1", "--quiet"]) == 2
    assert "has no base parameter 'Fw1'; did you mean 'Fv1'" in capsys.readouterr().err


def test_progress_is_told_on_stderr(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("didim.cli.excite.DESIGN_PROGRESS_S", 0.0)
    assert main(["excite", "planar2", str(folder / "excite.toml")]) == 0
    assert re.search(r"^start 1: 5 motions, criterion \d+\.\d$", capsys.readouterr().err, re.M)


def test_an_output_that_cannot_be_written_is_refused_before_the_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def search(*arguments: object, **options: object) -> None:
        raise AssertionError("the search has begun")

    monkeypatch.setattr("didim.excitation.excite.excite", search)
    assert main(["excite", "planar2", "-o", str(tmp_path / "nowhere" / "motion.csv")]) == 2
    assert "nowhere" in capsys.readouterr().err
