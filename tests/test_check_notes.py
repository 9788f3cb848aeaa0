"""What ``didim check`` says of a sound log: notes on what the log cannot show, and no factor that errors of friction suggest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim import Experiment, SignalProcessing, check, load_experiment
from didim.diagnosis.finding import Findings
from didim.evidence.lasting import friction_findings
from didim.evidence.rows import LogRows
from didim.methods.measured import law_along
from didim.studies.simulated_log import measured, simulated_log


@pytest.fixture(scope="module")
def arm(project: Path) -> Experiment:
    experiment = load_experiment(project / "examples" / "planar2_simulation.toml")
    signal = SignalProcessing(cutoff_hz=50, trim_start=50, trim_end=50, decimation=(10,))
    return replace(experiment, signal=signal)


def planar_log(arm: Experiment, **values: float) -> Experiment:
    """A log of the planar arm with other parameters."""
    x = arm.robot.parameter_set("reference").copy()
    for name, value in values.items():
        x[arm.robot.parameter_names.index(name)] = value
    return measured(simulated_log(arm, x, noise=False), 1)


def test_joints_that_share_nothing_are_noted_and_are_no_finding(arm: Experiment) -> None:
    found = check(planar_log(arm, MX2=0.0, ZZ2=1e-4, Ia2=0.05))
    assert not found.items, str(found)
    (note,) = found.notes
    assert "the drive gains of joints 1 and 2 cannot be checked by this log" in note
    assert str(found).splitlines()[1] == f"Note: {note}."
    assert found.to_dict()["notes"] == [note]


def test_nothing_is_noted_where_the_log_checks_all_gains(arm: Experiment) -> None:
    found = check(planar_log(arm))
    assert (found.items, found.notes) == ((), ()), str(found)


def test_friction_that_differs_between_recordings_is_a_finding(arm: Experiment) -> None:
    fc = dict(zip(arm.robot.parameter_names, arm.robot.parameter_set("reference"), strict=True))["Fc1"]
    (first,) = planar_log(arm).recordings
    warmer, same = (planar_log(arm, Fc1=factor * fc).recordings[0] for factor in (0.8, 1.0))
    alike = replace(arm, recordings=(first, replace(same, name="again")))
    assert not [item for item in check(alike).items if item.kind == "drift"]
    found = check(replace(arm, recordings=(first, replace(warmer, name="warm"))))
    (item,) = (item for item in found.items if item.kind == "drift" and "Fc1" in item.sentence)
    assert (item.joints, item.recording) == ((1,), "warm")
    assert item.value is not None
    assert item.value == pytest.approx(-0.2 * fc, rel=0.3)


def test_check_says_by_how_much_the_friction_of_a_log_differs(arm: Experiment) -> None:
    known = dict(zip(arm.robot.parameter_names, arm.robot.parameter_set("reference"), strict=True))
    (first,) = planar_log(arm).recordings
    (other,) = planar_log(arm, **{name: 0.85 * known[name] for name in ("Fv1", "Fc1")}).recordings
    found = check(replace(arm, recordings=(first, replace(other, name="warm"))))
    (item,) = (item for item in found.items if item.kind == "drift" and item.facts["of"] == "friction")
    assert item.joints == (1,)
    (level,) = item.facts["levels"]
    assert (level["recording"], level["joint"]) == ("warm", 1)
    assert level["share"] == pytest.approx(-0.15, abs=min(0.02, 4.0 * level["std"]))
    assert f"(warm: joint 1 {-100.0 * level['share']:.2g} % lower, " in item.sentence
    assert "sigma): warmer, or loaded? Most by -" in item.sentence


def test_the_law_is_judged_with_the_friction_of_the_simulation(arm: Experiment) -> None:
    """A digital controller and friction that the simulation smooths: no law of friction is missed beside it."""
    log = replace(planar_log(arm), robot=arm.robot)
    along = law_along(didim.identify(log), log, didim.CLOE())
    assert along is not None
    rows = LogRows(along.robot, along.signal, along.parts, logs=along.logs)
    assert friction_findings(rows, None, chosen=False) == []


@pytest.mark.parametrize("moves", [True, False])
def test_a_torque_that_is_noise_alone_is_a_finding_where_the_joint_moves(
    arm: Experiment, moves: bool
) -> None:
    log = planar_log(arm)
    (recording,) = log.recordings
    assert recording.tau is not None
    noise = 0.05 * np.random.default_rng(0).standard_normal(len(recording.tau))
    tau = np.column_stack([recording.tau[:, 0], 3.0 + noise])
    flat = replace(log, recordings=(replace(recording, q=recording.q * [1.0, float(moves)], tau=tau),))
    assert ("constant-torque" in [item.code for item in check(flat)]) is moves
    if moves:
        assert "constant-torque" in [item.code for item in didim.identify(flat).verdict.grave]


def test_notes_stand_before_the_table_of_the_closed_loop() -> None:
    shown = str(Findings("log", closed_loop=(("joint", "kp"), ("1", "1.00")), notes=("a gain is open",)))
    assert shown.splitlines()[:3] == ["log: nothing found.", "Note: a gain is open.", ""]


@pytest.mark.parametrize("factor", [1.0, 0.9])
def test_a_factor_is_found_to_the_percent_and_none_where_none_is(arm: Experiment, factor: float) -> None:
    """The scale of the position of joint 2, noise and friction of the arm beside it."""
    log = planar_log(arm)
    (recording,) = log.recordings
    scaled = replace(log, recordings=(replace(recording, q=recording.q * [1.0, factor]),))
    found = [item for item in check(scaled) if "ties" in item.facts]
    if factor == 1.0:
        assert found == []
    else:
        (item,) = found
        named = [(item.code, item.value), *((tie["code"], tie["value"]) for tie in item.facts["ties"])]
        (value,) = [value for code, value in named if code == "position-scale"]
        assert value == pytest.approx(1.0 / factor, rel=0.02)


def test_the_causes_of_friction_say_what_a_file_takes(arm: Experiment, tmp_path: Path) -> None:
    """What the advice says to write is read: friction = "auto" at the top of a file, as it once said, is not."""
    robot = didim.load_robot("planar2")
    for line in ("stribeck = true", 'terms = "auto"', 'coulomb = "tanh"\nsmoothing_rad_s = 0.01'):
        path = tmp_path / "robot.toml"
        robot_text = (Path(didim.__file__).parent / "packaged" / "robots" / "planar2.toml").read_text(
            encoding="utf-8"
        )
        path.write_text(f"{robot_text}\n[friction]\n{line}\n", encoding="utf-8")
        assert didim.load_robot(path).n_dof == robot.n_dof
