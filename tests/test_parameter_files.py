"""Files of parameters: every bit comes back, a robot file takes them, `simulate` and `start` too, and others are one sentence."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from didim import DIDIM, Identification
from didim.cli.main import main
from didim.errors import FitError, RobotError
from didim.methods.start import standard_start
from didim.robot.parameter_file import load_parameters
from didim.studies.run import simulate_experiment
from didim.studies.simulated_log import simulated_log
from scripts import one_line
from test_cli import arm as arm_fixture
from test_cli import identify_arm
from test_compare import ARM

arm = arm_fixture
PLANAR2 = Path(didim.__file__).parent / "packaged" / "robots" / "planar2.toml"


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> didim.Experiment:
    path = tmp_path_factory.mktemp("parameters") / "arm.toml"
    path.write_text(ARM, encoding="utf-8")
    return didim.load_experiment(path)


@pytest.fixture(scope="module")
def fit(experiment: didim.Experiment) -> Identification:
    return didim.identify(simulated_log(experiment, experiment.robot.parameter_set("reference")))


@pytest.mark.parametrize("suffix", [".toml", ".npz", ".json"])
def test_every_bit_comes_back(
    fit: Identification, experiment: didim.Experiment, tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"arm{suffix}"
    (fit.save if suffix == ".json" else fit.save_parameters)(path)
    robot = experiment.robot
    np.testing.assert_array_equal(load_parameters(robot, path), fit.parameters)
    np.testing.assert_array_equal(standard_start(robot, str(path)), fit.parameters)
    by_file = simulate_experiment(experiment, str(path))
    (tmp_path / "fit.json").unlink(missing_ok=True)
    fit.save(tmp_path / "fit.json")
    by_fit = simulate_experiment(experiment, str(tmp_path / "fit.json"))
    for one, other in zip(by_file.arrays, by_fit.arrays, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_toml_is_a_set_of_a_robot_file(fit: Identification, tmp_path: Path) -> None:
    path = tmp_path / "night.toml"
    fit.save_parameters(path)
    text = path.read_text(encoding="utf-8")
    robot_file = tmp_path / "robot.toml"
    robot_file.write_text(PLANAR2.read_text(encoding="utf-8") + "\n" + text, encoding="utf-8")
    robot = didim.load_robot(robot_file)
    np.testing.assert_array_equal(robot.set_base("night"), fit.beta)
    np.testing.assert_array_equal(robot.sets["night"], fit.parameters)
    # Standard deviations stand beside the values.
    for name, std in zip(fit.names, fit.std, strict=True):
        (line,) = [line for line in text.splitlines() if line.startswith(f"{name} = ")]
        (written,) = re.findall(r"standard deviation (\S+) \(", line)
        assert float(written) == pytest.approx(std, rel=6e-3)


def test_a_consistent_result_keeps_all_its_standard_parameters(
    experiment: didim.Experiment, tmp_path: Path
) -> None:
    log = simulated_log(experiment, experiment.robot.parameter_set("reference"))
    fit = didim.identify(log, didim.IDIMLS(physical=True))
    fit.save_parameters(tmp_path / "whole.toml")
    assert np.count_nonzero(fit.parameters) > len(fit.names)
    np.testing.assert_array_equal(load_parameters(experiment.robot, tmp_path / "whole.toml"), fit.parameters)
    text = (tmp_path / "whole.toml").read_text(encoding="utf-8")
    assert all(
        f"# {name} = {float(value)!r} # " in text for name, value in zip(fit.names, fit.beta, strict=True)
    )


def test_the_arrays_of_the_npz(fit: Identification, tmp_path: Path) -> None:
    fit.save_parameters(tmp_path / "fit.npz")
    with np.load(tmp_path / "fit.npz", allow_pickle=False) as arrays:
        found = {key: arrays[key] for key in arrays}
    for key in ("beta", "std", "covariance", "parameters"):
        np.testing.assert_array_equal(found.pop(key), getattr(fit, key))
    for key in ("names", "units", "roles", "parameter_names"):
        assert tuple(found.pop(key)) == getattr(fit, key)
    assert not found


def test_names_that_toml_must_quote(fit: Identification, tmp_path: Path) -> None:
    robot = didim.load_robot("emps").with_friction(model="asymmetric")
    names = robot.base_parameters.names
    assert "Fv1+" in names
    beta = np.array([95.0, 203.5, 1e-30, -2.5e17, 0.1 + 0.2])
    other = replace(
        fit,
        name="two\nlines \x07",
        names=names,
        units=robot.base_parameters.units,
        roles=("estimated",) * 3 + ("fixed", "dropped"),
        beta=beta,
        covariance=np.zeros((5, 5)),
        parameter_names=robot.parameter_names,
        parameters=robot.base_parameters.lift(beta),
    )
    path = tmp_path / 'a "b" c.toml'
    other.save_parameters(path)
    text = path.read_text(encoding="utf-8")
    assert list(tomllib.loads(text)["parameters"]) == ['a "b" c']
    assert text.count("standard deviation unknown") == 3
    assert text.count("# N.s/m, fixed") == 1
    np.testing.assert_array_equal(load_parameters(robot, path), other.parameters)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[parameters]", "p.toml: one set [parameters.NAME] is needed, got none"),
        ("[parameters.a]\n[parameters.b]", "p.toml: one set [parameters.NAME] is needed, got 'a', 'b'"),
        ("schema = 1", "p.toml: key 'parameters' is missing"),
        ("robot = 1\n[parameters.a]", "p.toml: unknown key 'robot'"),
        ("[parameters]\na = 1", "a must be a table, got 1"),
        ("[parameters.a]\nFv1 = '2'", "p.toml: [parameters.a] Fv1 must be a finite number, got '2'"),
        ("[parameters.a]\nFw1 = 2", "p.toml: [parameters.a] unknown parameter 'Fw1'; did you mean 'Fv1'?"),
        ("[parameters.a]\nZZ1 = 2\nZZ1R = 3", "p.toml: [parameters.a] has both 'ZZ1' and 'ZZ1R'"),
    ],
)
def test_wrong_sets(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises((FitError, RobotError), match=re.escape(message)):
        load_parameters(didim.load_robot("planar2"), path)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"x": np.ones(2)}, "not a file of parameters, parameter_names is not"),
        ({"parameter_names": np.array(["Fv1"])}, "not a file of parameters, parameters is not"),
        ({"parameter_names": np.array(["Fv1"]), "parameters": np.ones(2)}, "parameters must be 1 finite numbers"),
        ({"parameter_names": np.array(["M1"]), "parameters": np.array(["a"])}, "not an npz file of parameters"),
        ({"parameter_names": np.array(["Fw1"]), "parameters": np.ones(1)}, "it has parameter 'Fw1', which robot"),
        ({"parameter_names": np.array(["Fv1"]), "parameters": np.ones(1)}, "it has 1 parameter, which robot"),
        ({"parameter_names": np.array([None]), "parameters": np.ones(1)}, "not an npz file of parameters"),
    ],
)  # fmt: skip
def test_wrong_arrays(tmp_path: Path, arrays: dict[str, Any], message: str) -> None:
    path = tmp_path / "p.npz"
    np.savez(path, **arrays)
    with pytest.raises(FitError, match=re.escape(message)):
        load_parameters(didim.load_robot("planar2"), path)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut off", b"text"])
def test_damaged_arrays(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "p.npz"
    path.write_bytes(content)
    with pytest.raises(FitError, match="not an npz file of parameters"):
        load_parameters(didim.load_robot("planar2"), path)


@pytest.mark.parametrize("suffix", [".toml", ".npz"])
def test_command(arm: Path, tmp_path: Path, suffix: str) -> None:
    saved, result = tmp_path / f"found{suffix}", tmp_path / "fit.json"
    assert identify_arm(arm, "--quiet", "--save-parameters", str(saved), "--json", str(result)) == 0
    fit = Identification.load(result)
    np.testing.assert_array_equal(load_parameters(didim.load_robot("planar2"), saved), fit.parameters)
    closed = tmp_path / "closed.toml"
    closed.write_text(ARM, encoding="utf-8")
    runs = []
    for parameters in (saved, result):
        run = tmp_path / "run.csv"
        assert main(["simulate", str(closed), "--parameters", str(parameters), "-o", str(run)]) == 0
        runs.append(run.read_bytes())
    assert runs[0] == runs[1]


def test_another_ending_is_told_before_the_work(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The data are not there: the ending is told first.
    assert main(["identify", str(arm), "--save-parameters", str(tmp_path / "p.yaml")]) == 2
    assert one_line(capsys) == "didim: a file of parameters ends in .toml or .npz, and 'p.yaml' does not"


def test_a_start_from_a_file(experiment: didim.Experiment, fit: Identification, tmp_path: Path) -> None:
    log = simulated_log(experiment, experiment.robot.parameter_set("reference"))
    fit.save_parameters(tmp_path / "p.toml")
    by_file = didim.identify(log, DIDIM(start=str(tmp_path / "p.toml")))
    by_fit = didim.identify(log, DIDIM(start=fit))
    assert by_file.converged
    np.testing.assert_array_equal(by_file.beta, by_fit.beta)
    with pytest.raises(FitError, match=r"none\.npz: no such file"):
        standard_start(experiment.robot, str(tmp_path / "none.npz"))
