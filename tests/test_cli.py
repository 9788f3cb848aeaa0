"""The command line: results on stdout, progress on stderr, exit codes, one-line errors."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import didim
import simulated
from didim.cli.main import main
from didim.experiment.experiment_file import load_experiment
from didim.regression.solver import SOLVERS
from didim.result.identification import Identification
from didim.result.iteration import Status
from didim.robot.robot_file import load_robot
from scripts import one_line

EXPERIMENT = """\
schema = 1
robot = "planar2"
name = "arm"
[[recording]]
rate_hz = 500
[recording.position]
file = "log.npz"
variable = "q"
unit = "rad"
side = "joint"
[recording.torque]
file = "log.npz"
variable = "tau"
unit = "N.m"
side = "joint"
[signal]
cutoff_hz = 40
trim_start = 25
trim_end = 25
decimation = [5]
"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """Experiment file in one folder, its data in another."""
    robot = load_robot("planar2")
    log = simulated.log(robot, np.asarray(robot.sets["reference"]), noise=0.1)
    assert log.tau is not None
    (tmp_path / "data").mkdir()
    np.savez(tmp_path / "data" / "log.npz", q=log.q, tau=log.tau)
    path = tmp_path / "arm.toml"
    path.write_text(EXPERIMENT, encoding="utf-8")
    return path


def identify_arm(arm: Path, *options: str) -> int:
    return main(["identify", str(arm), "--data", str(arm.parent / "data"), *options])


def test_identify_prints_the_table_and_writes_the_json(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert identify_arm(arm, "--method", "idim-ls", "--json", str(tmp_path / "arm.json")) == 0
    out, err = capsys.readouterr()
    assert err == ""
    fit = Identification.load(tmp_path / "arm.json")
    assert out == f"{fit}\n"
    data = json.loads((tmp_path / "arm.json").read_text(encoding="utf-8"))
    assert data["schema"] == 1
    assert set(data["digests"]) == {"experiment arm.toml", "robot planar2.toml", "data log.npz"}
    assert data["settings"]["signal"]["cutoff_hz"] == 40.0


def test_the_json_says_what_the_robot_and_the_log_were_taken_for(arm: Path, tmp_path: Path) -> None:
    """Everything that decides the numbers: friction, gravity, coupling, reduction, drive gains, counts."""
    text = EXPERIMENT.replace("[signal]", "[friction]\ndead_zone_rad_s = 0.02\n[signal]")
    text = text.replace('unit = "N.m"\nside = "joint"', 'unit = "A"\ngain = [2.0, -0.5]\nside = "motor"')
    text = text.replace('unit = "rad"', 'unit = "count"\ncounts_per_rev = 4')
    arm.write_text(text + "[transmission]\nreduction = [[2, 0], [1, 3]]\n", encoding="utf-8")
    # Read so, the log is doubtful, not certainly wrong: what is recorded matters here, not the verdict.
    assert identify_arm(arm, "--quiet", "--json", str(tmp_path / "arm.json")) == 0
    settings = json.loads((tmp_path / "arm.json").read_text(encoding="utf-8"))["settings"]
    assert settings["robot"]["name"] == "planar2"
    assert settings["robot"]["friction"] == {
        "model": "symmetric",
        "coulomb": "sign",
        "coupling": "shaft",
        "smoothing": [0.0, 0.0],
        "dead_zone": [0.02, 0.02],
        "terms": [],
        "auto": False,
    }
    assert settings["robot"]["geometry"]["gravity"] == [0.0, -9.81, 0.0]
    assert settings["robot"]["geometry"]["coupling"] == [[1.0, 0.0], [0.0, 1.0]]
    assert settings["robot"]["geometry"]["d"] == [0.0, 0.5]
    (recording,) = settings["recordings"]
    assert recording["reduction"] == [[2.0, 0.0], [1.0, 3.0]]
    assert recording["position"] == {
        "file": "log.npz",
        "variable": "q",
        "unit": "count",
        "counts_per_rev": 4,
        "side": "joint",
        "factors_to_si": [2.0 * np.pi / 4] * 2,
    }
    assert recording["torque"]["factors_to_si"] == [2.0, -0.5]
    assert recording["torque"]["side"] == "motor"
    assert set(settings["versions"]) == {"didim", "numpy", "scipy"}


def test_quiet_and_verbose(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert identify_arm(arm, "--quiet") == 0
    assert capsys.readouterr() == ("", "")
    assert identify_arm(arm, "--verbose") == 0
    out, err = capsys.readouterr()
    assert out.startswith("arm: ")
    assert "iteration 1: relative error" in err


def test_standard_deviations_and_solver_are_chosen_on_the_command_line(arm: Path, tmp_path: Path) -> None:
    path = tmp_path / "arm.json"
    experiment = load_experiment(arm, data=arm.parent / "data")
    for kind in ("jackknife", "decimated", "white"):
        assert identify_arm(arm, "--quiet", "--uncertainty", kind, "--json", str(path)) == 0
        found = Identification.load(path)
        assert found.uncertainty is not None
        assert found.uncertainty.kind == kind
        assert found.std == pytest.approx(didim.identify(experiment, uncertainty=kind).std)
    assert identify_arm(arm, "--quiet", "--solver", "huber", "--json", str(path)) == 0
    robust, plain = Identification.load(path), didim.identify(experiment)
    assert robust.settings["solver"]["name"] == "huber"
    assert robust.beta == pytest.approx(didim.identify(experiment, didim.IDIMLS(solver="huber")).beta)
    assert np.abs(robust.beta - plain.beta).max() > 1e-6


def test_help_lists_every_solver(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["identify", "--help"])
    text = "".join(capsys.readouterr().out.split())  # lines are broken at hyphens
    assert [name for name in SOLVERS if name not in text] == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--solver", "hubert"), "there is no solver 'hubert'; did you mean 'huber'? (there are: least-squares,"),
        (("--method", "cloe", "--solver", "huber"), "--solver is not for method 'cloe'"),
        (("--method", "idim-iv", "--solver", "huber"), "IDIM-IV solves the linear system with its instruments"),
    ],
)  # fmt: skip
def test_choices_that_a_method_does_not_have(
    arm: Path, options: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert identify_arm(arm, *options) == 2
    assert message in one_line(capsys)


def test_not_converged_is_exit_1(
    arm: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # By its name in sys.modules: `didim.identify` is the function.
    module = importlib.import_module("didim.methods.identify")
    identify = module.identify
    monkeypatch.setattr(
        module,
        "identify",
        lambda experiment, method, verbose: identify(experiment, method, callback=lambda iteration: True),
    )
    assert identify_arm(arm) == 1
    assert Status.STOPPED.value in capsys.readouterr().out


def test_interrupted_is_exit_130(
    arm: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("didim.methods.identify"), "identify", interrupted)
    assert identify_arm(arm) == 130
    assert one_line(capsys) == "didim: interrupted"


def test_base_lists_names_and_groupings(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["base", "planar2"]) == 0
    out, err = capsys.readouterr()
    base = load_robot("planar2").base_parameters
    lines = out.splitlines()
    assert err == ""
    assert lines[0] == f"planar2: {len(base.names)} base parameters of 28 standard parameters"
    for line, name, grouping in zip(lines[2:], base.names, base.groupings, strict=False):
        assert line.split()[0] == name
        assert grouping in line
    # Two lines on the pose at q = 0 and the reach end the output (tests/test_reach.py).
    assert lines[-4].startswith("Without effect on the torques: ")
    assert "YY1" in lines[-4]
    assert lines[-1].startswith("Reach, ")


def test_base_takes_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(load_robot("planar2").path.read_bytes())
    assert main(["base", str(path)]) == 0
    assert "ZZ1R" in capsys.readouterr().out


def test_an_unknown_method(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert identify_arm(arm, "--method", "magic") == 2
    assert (
        one_line(capsys)
        == "didim: there is no method 'magic' (there are: idim-ls, idim-iv, didim, cloe; or your own as module:name)"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "didim: the following arguments are required: COMMAND; see `didim --help`"),
        (["identify"], "didim: the following arguments are required: EXPERIMENT.toml; see `didim identify"),
        (["base", "tx40", "--loud"], "didim: there is no option --loud; see `didim base --help`"),
        (["identify", "a.toml", "--quiet", "--verbose"], "not allowed with argument"),
    ],
)
def test_wrong_arguments(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert message in one_line(capsys)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("cutoff_hz", "cutof_hz"), "did you mean 'cutoff_hz'?"),
        (("cutoff_hz = 40", "cutoff_hz = 400"), "half the sampling rate"),
        (("log.npz", "nothing.npz"), "nothing.npz"),
        (('variable = "tau"', 'variable = "torque"'), "torque"),
        (("planar2", "planar9"), "planar9"),
        (("schema = 1", "schema = 1 2"), "arm.toml"),
        (("cutoff_hz = 40", "cutoff_hz = 1e-9"), "rounding spoils a filter of order 4 at 1e-09 Hz"),
        (("cutoff_hz = 40", "cutoff_hz = 40\norder = 1000"), "[signal] order must be at most 10, got 1000"),
        (
            ("cutoff_hz = 40", 'cutoff_hz = 5\norder = 10\nform = "transfer-function"'),
            "recording 'recording 1': rounding spoils a filter of order 10 at 5 Hz, sampled at 500 Hz",
        ),
        (("decimation = [5]", "decimation = [1000000000]"), "decimation by 1000000000 needs more than"),
        (("rate_hz = 500", "rate_hz = 1e300"), "sampled at 1e+300 Hz"),
        (("rate_hz = 500", "rate_hz = 1e-310"), "t is inf at sample 1"),
        (("[signal]", "[parameters.fixed]\nFv1 = 1e308\n[signal]"), "the torques of the fixed parameters are too"),
        (("[signal]", "[parameters.fixed]\nFv1 = 1e160\n[signal]"), "torques of joint 1 are too large to be sq"),
        (('unit = "N.m"', 'unit = "A"\ngain = 1e200'), "the torques of joint 1 are too large to be squared"),
        (('unit = "N.m"', 'unit = "A"\ngain = 1e308'), "recording 1: tau of joint 1 is -inf at sample 0"),
        (('unit = "N.m"', 'unit = "A"\ngain = 1e-200'), "the torques of joint 1 are too small to be squared"),
        (('unit = "rad"', 'unit = "count"\ncounts_per_rev = 1e-150'), "a position is at most 1e+09 rad or m; check its unit"),
        (("cutoff_hz = 40", "cutoff_hz = 1" + 400 * "0"), "[signal] cutoff_hz must be a finite number, got 1000"),
        (("decimation = [5]", "decimation = 1" + 400 * "0"), "decimation must be an integer of at most 922"),
        (("cutoff_hz = 40", "cutoff_hz = 1" + 5000 * "0"), "arm.toml: not valid TOML, Exceeds the limit"),
        (("cutoff_hz = 40", "cutoff_hz = " + 9000 * "["), "arm.toml: not valid TOML, "),
        (("log.npz", "data\\u0000.npz"), "is not a file name"),
        (("planar2", "planar2\\u0000.toml"), "is not a file name"),
    ],
)  # fmt: skip
def test_wrong_input_is_one_line_and_exit_2(
    arm: Path, change: tuple[str, str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arm.write_text(EXPERIMENT.replace(*change), encoding="utf-8")
    assert identify_arm(arm) == 2
    assert message in one_line(capsys)


def test_missing_files(arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identify", str(tmp_path / "none.toml")]) == 2
    assert "none.toml" in one_line(capsys)
    assert main(["base", str(tmp_path / "none.toml")]) == 2
    assert "none.toml" in one_line(capsys)
    # The data are beside the experiment file unless --data says otherwise.
    assert main(["identify", str(arm)]) == 2
    assert "log.npz" in one_line(capsys)
    assert identify_arm(arm, "--json", str(tmp_path / "nowhere" / "fit.json")) == 2
    assert "there is no folder" in one_line(capsys)


def test_a_failure_leaves_the_old_json(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    result = tmp_path / "fit.json"
    result.write_text("old", encoding="utf-8")

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device", str(result))

    monkeypatch.setattr(Path, "replace", full)
    assert identify_arm(arm, "--json", str(result), "--quiet") == 1
    out, err = capsys.readouterr()
    assert "No space left on device; it could not be written elsewhere either\n" in err
    assert "ZZ1R" in out  # printed, since it is nowhere else
    assert result.read_text(encoding="utf-8") == "old"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["arm.toml", "data", "fit.json"]


@pytest.mark.slow
def test_json_to_a_pipe(arm: Path) -> None:
    command = [sys.executable, "-m", "didim", "identify", str(arm), "--data", str(arm.parent / "data")]
    done = subprocess.run([*command, "--quiet", "--json", "/dev/stdout"], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["robot"] == "planar2"


def test_a_reader_that_stops_early_is_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "didim", "base", "tx40"], stdout=write, stderr=subprocess.PIPE, check=False
    )
    os.close(write)
    assert done.returncode == 0
    assert done.stderr == b""


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out.startswith("didim ")


def test_a_wrong_value_of_any_length_is_told_briefly(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm.write_text(EXPERIMENT.replace("cutoff_hz = 40", f"cutoff_hz = '{5000 * 'y'}'"), encoding="utf-8")
    assert identify_arm(arm) == 2
    line = one_line(capsys)
    assert line.startswith("didim: arm.toml: [signal] cutoff_hz must be a finite number, got 'yyy")
    assert len(line) < 1000


@pytest.mark.parametrize(("gain", "size"), [("1e-310", "small"), ("1e155", "large")])
def test_check_tells_torques_beyond_floating_point(
    arm: Path, capsys: pytest.CaptureFixture[str], gain: str, size: str
) -> None:
    arm.write_text(EXPERIMENT.replace('"N.m"', f'"A"\ngain = {gain}'), encoding="utf-8")
    assert main(["check", str(arm), "--data", str(arm.parent / "data")]) == 2
    assert f"the torques of joint 1 are too {size} to be squared" in one_line(capsys)


def test_check_of_positions_without_motion_warns_of_nothing(
    arm: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cut-off next to zero leaves a line: an infinite condition number, and no warning of NumPy."""
    arm.write_text(EXPERIMENT.replace("cutoff_hz = 40", "cutoff_hz = 0.004"), encoding="utf-8")
    assert main(["check", str(arm), "--data", str(arm.parent / "data")]) == 1
    assert capsys.readouterr().err == ""


@pytest.mark.filterwarnings("always::RuntimeWarning")
def test_warnings_of_numpy_wait_for_the_end(
    arm: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Beside a result they are printed after it; a refusal, which names the number, is printed alone."""
    arguments = ["check", str(arm), "--data", str(arm.parent / "data")]
    checked = importlib.import_module("didim.diagnosis.check")
    run = checked.check

    def overflowing(*positional: object, **named: object) -> object:
        np.array([1e300]) * np.array([1e300])
        return run(*positional, **named)

    monkeypatch.setattr(checked, "check", overflowing)
    main(arguments)
    assert "warning: overflow encountered in multiply" in capsys.readouterr().err
    arm.write_text(EXPERIMENT.replace('"N.m"', '"A"\ngain = 1e155'), encoding="utf-8")
    assert main(arguments) == 2
    assert "the torques of joint 1 are too large to be squared" in one_line(capsys)
