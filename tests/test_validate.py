"""`validate`: errors of a result on another log, predicted along the measured motion and simulated in closed loop."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from arm import arm_file, arm_log
from didim import DIDIM, Experiment, Identification, identify, validate
from didim.cli.main import main
from didim.errors import FitError
from didim.experiment.specs import SimulationSettings
from several import arm_logs


@pytest.fixture(scope="module")
def log() -> Experiment:
    return arm_log(1)


@pytest.fixture(scope="module")
def other() -> Experiment:
    return arm_log(2)


@pytest.fixture(scope="module")
def fit(log: Experiment) -> Identification:
    return identify(log, DIDIM())


def test_the_truth_has_no_errors(fit: Identification, other: Experiment) -> None:
    found = validate(fit, other)
    (item,) = found.recordings
    assert item.name == "log 2"
    # The filtered motion is not quite that of the arm.
    assert item.direct is not None
    assert np.all(item.direct < 0.01)
    assert item.direct_overall < 0.01
    assert item.outcome is not None
    assert item.outcome.completed
    assert found.completed
    assert set(item.simulated) == {"position", "velocity", "acceleration", "torque"}
    # The same loop with the same parameters.
    assert np.all(item.simulated["position"] < 1e-6)
    assert np.all(item.simulated["torque"] < 1e-5)


def test_a_wrong_result_has_errors(fit: Identification, other: Experiment) -> None:
    heavy = replace(fit, beta=1.2 * fit.beta, parameters=1.2 * fit.parameters)
    (item,) = validate(heavy, other).recordings
    assert item.direct is not None
    np.testing.assert_allclose(item.direct, 0.2, atol=0.01)
    assert item.direct_overall == pytest.approx(0.2, abs=0.01)
    assert np.all(item.simulated["torque"] > 0.1)
    assert np.all(item.simulated["position"] > 1e-3)


def test_direct_errors_are_those_of_a_recording_held_out(log: Experiment, other: Experiment) -> None:
    held_out = replace(other.recordings[0], role="held-out")
    both = identify(replace(log, recordings=(*log.recordings, held_out)))
    (item,) = validate(both, other).recordings
    assert item.direct is not None
    np.testing.assert_allclose(item.direct, both.held_out[0].relative_error)
    assert item.direct_overall == pytest.approx(both.held_out[0].overall_relative_error)


def test_every_recording_whatever_its_role(fit: Identification, log: Experiment, other: Experiment) -> None:
    recordings = (replace(log.recordings[0], role="held-out"), other.recordings[0])
    found = validate(fit, replace(other, recordings=recordings))
    assert [item.name for item in found.recordings] == ["log 1", "log 2"]
    text = str(found)
    assert text.startswith("arm, by didim, on arm; relative errors in %\n")
    assert text.count("torque, predicted") == 2
    assert text.count("position, simulated") == 2


def test_each_recording_is_validated_with_its_own_payload() -> None:
    """That which the fit found in one of its logs."""
    both = replace(arm_logs([False, True, False]), controller=None)
    found = validate(identify(both), both)
    assert [item.direct_overall < 0.01 for item in found.recordings] == [True] * 3


def test_without_controller_or_torques(fit: Identification, other: Experiment) -> None:
    without = validate(fit, replace(other, controller=None))
    (item,) = without.recordings
    assert item.outcome is None
    assert item.simulated == {}
    assert item.direct is not None
    assert without.completed
    assert "not simulated: the experiment has no [controller] and [reference]" in str(without)

    (recording,) = other.recordings
    silent = validate(fit, replace(other, recordings=(replace(recording, tau=None),)))
    (item,) = silent.recordings
    assert item.direct is None
    assert np.isnan(item.direct_overall)
    assert set(item.simulated) == {"position", "velocity", "acceleration"}
    assert "torque" not in str(silent)
    data = silent.to_dict()
    assert data["recordings"][0]["direct"] is None  # type: ignore[index]
    json.dumps(data, allow_nan=False)


def test_an_early_end_is_told(fit: Identification, other: Experiment) -> None:
    light = replace(fit, beta=1e-4 * fit.beta, parameters=1e-4 * fit.parameters)
    found = validate(light, other)
    (item,) = found.recordings
    assert not found.completed
    assert item.simulated == {}
    assert item.outcome is not None
    assert "the simulation diverged at " in str(found)
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["recordings"][0]["outcome"].startswith(
        "diverged"
    )


def test_a_joint_at_rest_has_no_relative_error(fit: Identification, other: Experiment) -> None:
    (recording,) = other.recordings
    assert recording.q_ref is not None
    still = replace(recording, q=np.zeros_like(recording.q), q_ref=np.zeros_like(recording.q_ref))
    found = validate(fit, replace(other, recordings=(still,)))
    (item,) = found.recordings
    assert np.isnan(item.simulated["velocity"]).all()
    plain = found.to_dict()["recordings"][0]  # type: ignore[index]
    assert plain["simulated"]["velocity"] == [None, None]


def test_what_cannot_be_validated(fit: Identification, other: Experiment) -> None:
    tx40 = didim.load_robot("tx40")
    with pytest.raises(
        FitError, match="the result is for robot 'planar2' with 28 parameters, the experiment for 'tx40'"
    ):
        validate(fit, replace(other, robot=tx40, recordings=(), simulation=SimulationSettings()))
    with pytest.raises(FitError, match="experiment 'arm' has no recording to validate on"):
        validate(fit, replace(other, recordings=()))


def test_emps(project: Path, shared: Path) -> None:
    """The estimate of DIDIM predicts as well as that of IDIM-LS, whose aim this is: 4.09 % beside the published 4.0834 %."""
    experiment = didim.load_experiment(project / "examples" / "emps.toml", data=shared / "data" / "emps")
    (item,) = validate(identify(experiment, DIDIM()), experiment).recordings
    assert item.direct is not None
    assert 0.040834 < item.direct[0] < 0.0410
    assert item.simulated["torque"][0] == pytest.approx(0.0427, abs=1e-4)
    assert item.simulated["position"][0] < 1.1e-5


# The command.


@pytest.fixture
def files(tmp_path: Path, fit: Identification, other: Experiment) -> Path:
    """A result, and an experiment whose data are elsewhere."""
    (tmp_path / "data").mkdir()
    arm_file(other, tmp_path / "data", tmp_path / "another day.toml")
    fit.save(tmp_path / "fit.json")
    return tmp_path


def run(files: Path, *options: str) -> int:
    command = ["validate", str(files / "fit.json"), str(files / "another day.toml")]
    return main([*command, "--data", str(files / "data"), *options])


def test_command(
    files: Path, fit: Identification, other: Experiment, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(files, "--json", str(files / "errors.json")) == 0
    out, err = capsys.readouterr()
    assert err == ""
    found = validate(fit, other)
    assert out.startswith("arm, by didim, on another day; relative errors in %\n\nrecording 'another day'\n")
    assert len(out.splitlines()) == len(str(found).splitlines())
    data = json.loads((files / "errors.json").read_text(encoding="utf-8"))
    assert (data["robot"], data["method"], data["fit"], data["experiment"]) == (
        "planar2",
        "didim",
        "arm",
        "another day",
    )
    (item,) = data["recordings"]
    # The file leaves the friction of the robot as it is, sign(dq): that is what torques are predicted with.
    assert 0.005 < min(item["direct"]) < max(item["direct"]) < 0.02
    assert max(item["simulated"]["position"]) < 1e-6
    assert item["outcome"] == "completed"


def test_command_whose_simulation_ends_early_is_exit_1(
    files: Path, fit: Identification, capsys: pytest.CaptureFixture[str]
) -> None:
    replace(fit, beta=1e-4 * fit.beta, parameters=1e-4 * fit.parameters).save(files / "fit.json")
    assert run(files) == 1
    assert "the simulation diverged at " in capsys.readouterr().out


def test_wrong_commands_are_one_line_and_exit_2(
    files: Path, log: Experiment, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused() -> str:
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        return err

    experiment = files / "another day.toml"
    experiment.write_text(experiment.read_text(encoding="utf-8").replace('kind = "pd"', 'kind = "dp"'))
    assert run(files) == 2
    assert "[controller]" in refused()
    (files / "fit.json").write_text("{}", encoding="utf-8")
    assert run(files) == 2
    assert "not the result of an identification" in refused()
    (files / "fit.json").unlink()
    assert run(files) == 2
    assert "fit.json" in refused()


def test_friction_is_that_of_the_result(fit: Identification, other: Experiment) -> None:
    """The file's model does not fit the parameters of the result, and is not asked; a result that says nothing of it is refused."""
    asymmetric = replace(other, robot=other.robot.with_friction(model="asymmetric"))
    found = validate(fit, asymmetric)
    (note,) = (reason for reason in found.verdict.notes if reason.code == "as-fitted")
    assert "model = symmetric (file: asymmetric)" in note.sentence
    silent = replace(fit, settings={key: value for key, value in fit.settings.items() if key != "robot"})
    with pytest.raises(FitError) as raised:
        validate(silent, asymmetric)
    assert str(raised.value) == (
        "the parameters differ: only the result has Fv1, Fc1, Off1, Fv2, Fc2, Off2 and only the experiment has "
        "Fv1+, Fc1+, Fv1-, Fc1-, Fv2+, Fc2+ and 2 more; write the same [friction] for both"
    )
