"""Wrong calls of `payload`, `validate` and `residual`, and right ones: the cases of ``benches/wrong_calls.py``."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
import simulated
from arm import arm_log
from didim import Experiment, Identification, _core
from didim.cli.main import main
from didim.evidence.applied.load import ABSURD, load_findings
from didim.evidence.products import Products
from didim.result.finding import Finding
from didim.signal.filters import differentiate
from didim.studies.loaded import as_fitted
from scripts import script

WRONG = {
    ("torques in mN.m", "payload"): ("torque-unit", "wrong"),
    ("degrees read as rad", "payload"): ("unit", "wrong"),
    ("rad declared as deg", "payload"): ("unit", "wrong"),
    ("joints in reversed order", "payload"): ("reversed-order", "wrong"),
    ("torques of joints 2 and 3 exchanged", "payload"): ("swapped-torques", "wrong"),
    ("torques of the motors", "payload"): ("side", "wrong"),
    ("the tool is in the model already", "payload"): ("no-load", "doubtful"),
    ("no load on the flange", "payload"): ("no-load", "doubtful"),
    ("a log of another robot", "payload"): ("other-robot", "wrong"),
    ("friction 60 % above that of the fit", "payload"): ("other-friction", "doubtful"),
    ("a tool that is not declared", "validate"): ("undeclared-load", "wrong"),
    ("the tool of the model was taken off", "payload"): ("load-inside", "wrong"),
    ("torques in mN.m", "validate"): ("torque-unit", "wrong"),
    ("degrees read as rad", "validate"): ("unit", "wrong"),
    ("joints in reversed order", "validate"): ("reversed-order", "wrong"),
    ("torques of joints 2 and 3 exchanged", "validate"): ("swapped-torques", "wrong"),
    ("torques of the motors", "validate"): ("side", "wrong"),
    ("a log of another robot", "validate"): ("other-robot", "wrong"),
    ("torques in mN.m", "residual"): ("torque-unit", "wrong"),
    ("torques of joints 2 and 3 exchanged", "residual"): ("swapped-torques", "wrong"),
    ("a tool that is not declared", "residual"): ("undeclared-load", "doubtful"),
}
"""Code of the first reason, and state of the verdict, by name and command of a case; right calls are sound."""


CALLS = script(Path(__file__).resolve().parents[1] / "benches" / "wrong_calls.py")
"""The program; its fits are made once in a process."""


ESTIMATING = [case for case in CALLS.CASES if not case.command.startswith(("init", "check"))]


@pytest.mark.parametrize("case", ESTIMATING, ids=lambda case: f"{case.command.split()[0]}: {case.name}")
def test_a_call_ends_in_its_word(
    case: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    case.write(tmp_path)
    monkeypatch.chdir(tmp_path)
    code = main([*shlex.split(case.command), "--json", "said.json"])
    out = capsys.readouterr().out
    said: dict[str, Any] = json.loads(Path("said.json").read_text(encoding="utf-8"))
    verdict = said["verdict"]
    assert out.rstrip().splitlines()[-1].startswith(f"Verdict: {verdict['state']}")
    first, state = (None, "sound") if case.right else WRONG[case.name, case.command.split()[0]]
    assert verdict["state"] == state
    assert code == (1 if state == "wrong" else 0)
    reasons = [reason for reason in verdict["reasons"] if reason["grade"] != "note"]
    assert (reasons[0]["code"] if reasons else None) == first
    assert "of the fit" in out
    if first in ("no-load", "load-inside", "torque-unit") and "payload" in case.command:
        assert said["body"] is None
        assert "For a pendant" not in out


def test_all_wrong_calls_are_expected() -> None:
    wrong = [(case.name, case.command.split()[0]) for case in ESTIMATING if not case.right]
    assert sorted(wrong) == sorted(WRONG)


def test_what_no_robot_explains_is_told_and_is_no_load(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The published parameters of the TX40 are no robot's: a fit among robots says so, and its errors are no load's."""
    example = project / "python" / "didim" / "packaged" / "examples" / "tx40"
    monkeypatch.chdir(tmp_path)
    for name, file in (("log", "tx40_simulation"), ("other", "tx40_simulation_other")):
        main(["simulate", str(example / f"{file}.toml"), "--parameters", "didim", "-o", f"{name}.csv"])
        main(["init", "tx40", f"{name}.csv", "--plain"])
        with Path(f"{name}.toml").open("a", encoding="utf-8") as experiment:
            experiment.write((example / "friction.toml").read_text(encoding="utf-8"))
    assert main(["identify", "log.toml", "--physical", "--json", "fit.json"]) == 0
    assert "physical conditions raise the residual from" in capsys.readouterr().out
    assert main(["validate", "fit.json", "other.toml"]) == 0
    out = capsys.readouterr().out
    assert "Verdict: doubtful" in out
    assert "carries a load" not in out
    assert main(["identify", "log.toml", "--plain"]) == 0
    assert "Verdict: sound" in capsys.readouterr().out


def test_a_load_whose_mass_the_log_does_not_tell_is_named() -> None:
    """Vertical axes, the first joint at rest: the log tells moments of the load alone."""
    robot = didim.load_robot("planar2")
    robot = replace(robot, geometry=replace(robot.geometry, gravity=(0.0, 0.0, 0.0)))
    x = robot.parameter_set("reference")
    fit = didim.identify(
        simulated.experiment(robot, simulated.log(robot, x, n_samples=6000, noise=0.1)), didim.IDIMLS()
    )
    x = x.copy()
    for name, value in (("M2", 1.0), ("MX2", 0.3), ("YY2", 0.09), ("ZZ2", 0.09)):
        x[robot.parameter_names.index(name)] += value
    q = simulated.motion(2, 4000, 5)
    q[:, 0] = q[0, 0]
    tau = _core.inverse_dynamics(robot.core, *differentiate(q, simulated.RATE_HZ, simulated.SIGNAL), x)
    tau = np.asarray(tau) + 0.1 * np.random.default_rng(1).standard_normal(tau.shape)
    other = didim.Recording.from_arrays(q, tau, rate_hz=simulated.RATE_HZ, name="other")
    found = didim.validate(fit, simulated.experiment(robot, other)).verdict.reasons
    assert found[0].code == "undeclared-load"


def test_no_load_has_a_bound_in_the_sentence() -> None:
    std = np.array([1e-3] * 9 + [5e-3])
    ten = np.zeros(10)
    ten[9] = 2e-3
    names = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
    (found,) = load_findings(ten, std, 1e9, names, 0.0, same_log=False)
    assert found.code == "no-load"
    assert "no load seen, below 12 g" in found.sentence
    (same,) = load_findings(ten, std, 1e9, names, 0.0, same_log=True)
    assert same.grade == "wrong"
    ten[9] = 6930.0
    (heavy,) = load_findings(ten, std, 1e9, names, 1.1 * ABSURD, same_log=False)
    assert (heavy.code, heavy.grade) == ("absurd-load", "wrong")
    assert load_findings(ten, std, 1e9, names, 0.9 * ABSURD, same_log=False) == []
    ten[9] = -2.0
    (less,) = load_findings(ten, std, 1e9, names, 0.1, same_log=False)
    assert less.code == "load-inside"


# Known parameters beside unknown ones.


def test_parameters_beside_known_ones_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(4)
    columns, torque = rng.standard_normal((2, 80, 5)), rng.standard_normal((2, 80))
    given = np.array([0.5, np.nan, -1.0, np.nan, 2.0])
    free = np.isnan(given)
    judged = Products.of(columns, torque, given=given).judged()
    np.testing.assert_allclose(judged.beta[~free], given[~free], rtol=1e-12)
    left = torque - columns[:, :, ~free] @ given[~free]
    beta = np.linalg.lstsq(columns[0][:, free], left[0], rcond=None)[0]
    for _ in range(6):  # the weights are those of the errors
        size = np.sum((left - columns[:, :, free] @ beta) ** 2, axis=1)
        a = np.concatenate([columns[j][:, free] / np.sqrt(size[j]) for j in range(2)])
        b = np.concatenate([left[j] / np.sqrt(size[j]) for j in range(2)])
        beta = np.linalg.lstsq(a, b, rcond=None)[0]
    np.testing.assert_allclose(judged.beta[free], beta, atol=1e-3)


def test_the_factor_of_all_torques_is_found_beside_what_is_fitted() -> None:
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((3, 60, 4))
    given = np.array([1.0, -2.0, np.nan, 0.7])
    truth = np.array([1.0, -2.0, 5.0, 0.7])
    products = Products.of(columns, 1e3 * columns @ truth, given=given)
    assert products.factor() == pytest.approx(1e3, rel=1e-6)
    assert np.isnan(Products.of(columns, columns @ truth).factor())


# Friction and filters are the result's.


@pytest.fixture(scope="module")
def zoned() -> tuple[Identification, Experiment, Experiment]:
    """A fit with a dead zone, another log as its file has it, and with the settings of the fit."""

    def log(seed: int) -> Experiment:
        made = replace(arm_log(seed), controller=None, reference=None)
        (recording,) = made.recordings
        return replace(made, recordings=(replace(recording, q_ref=None),))

    options: dict[str, Any] = {"coulomb": "sign", "dead_zone_rad_s": 0.3}
    first, other = log(1), log(2)
    fit = didim.identify(replace(first, robot=first.robot.with_friction(**options)), didim.IDIMLS())
    as_fit = replace(other, robot=other.robot.with_friction(**options))
    as_file = replace(other, signal=replace(other.signal, cutoff_hz=30.0, decimation=(8,)))
    return fit, as_file, as_fit


def test_friction_and_filters_are_those_of_the_result(
    zoned: tuple[Identification, Experiment, Experiment],
) -> None:
    fit, as_file, as_fit = zoned
    found, wanted = didim.validate(fit, as_file), didim.validate(fit, as_fit)
    assert found.recordings[0].direct is not None
    np.testing.assert_array_equal(found.recordings[0].direct, wanted.recordings[0].direct)
    (note,) = [reason for reason in found.verdict.notes if reason.code == "as-fitted"]
    assert note.sentence == (
        "taken from the result, not from this log's file: coulomb = sign (file: tanh), dead_zone = 0.3 (file: 0.0), "
        "cutoff_hz = 50.0 (file: 30.0), decimation = [10] (file: [8])"
    )
    assert not [reason for reason in wanted.verdict.reasons if reason.code == "as-fitted"]


def test_filters_in_samples_belong_to_the_rate(
    zoned: tuple[Identification, Experiment, Experiment],
) -> None:
    fit, as_file, _ = zoned
    (recording,) = as_file.recordings
    slow = replace(as_file, recordings=(replace(recording, rate_hz=250.0, t=2.0 * recording.t),))
    signal = as_fitted(fit, slow)[0].signal
    assert (signal.cutoff_hz, signal.decimation) == (50.0, (8,))
    slower = replace(as_file, recordings=(replace(recording, rate_hz=80.0, t=6.25 * recording.t),))
    assert as_fitted(fit, slower)[0].signal.cutoff_hz == 30.0


def test_errors_above_those_of_the_fit_name_the_joints() -> None:
    finding = Finding(
        code="held-out",
        grade="doubtful",
        joints=(3,),
        recordings=("cold",),
        facts={"share": 0.31, "ratios": [4.2], "applied": True, "explained": False},
    )
    assert finding.sentence == (
        "recording cold: the torques of joint 3 are off by up to 31 %, 4.2 times as much (N.m) as in the fit"
    )
    assert "fit lacks motion" in finding.advice


FOUND = {
    ("motors behind gears of 100", "init"): "positions are those of motors behind gears of about 10",
    ("motors by the gears of the robot file", "init"): "positions are those of the motors",
    ("torques that are noise", "init"): "which is not usual",
    ("positions and torques in two files", "init"): "2 files are signals of one recording",
    ("one value a line in three files", "init"): "3 files are signals of one recording",
    ("torques in mN.m", "check"): "torque-unit: ",
    ("motors behind gears of 100", "check"): "side: ",
    ("positions in mrad", "check"): "unit: ",
    ("joints in reversed order", "check"): "reversed-order: ",
    ("the file of another included robot", "check"): "another-robot: ",
}
"""Words of `init` and `check`, by name and command of a case; nothing about right calls."""
BEGINNING = [case for case in CALLS.CASES if case not in ESTIMATING]


@pytest.mark.parametrize("case", BEGINNING, ids=lambda case: f"{case.command.split()[0]}: {case.name}")
def test_a_first_hour_has_one_line_for_one_mistake(
    case: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case.write(tmp_path)
    monkeypatch.chdir(tmp_path)
    command = case.command.split()[0]
    # What is found does not depend on the laws of friction that `init` chooses, which takes most of the time.
    code = main([*shlex.split(case.command), *(["--plain"] if command == "init" else [])])
    out = capsys.readouterr().out
    if case.right:
        assert code == 0
        assert not any(words in out for words in FOUND.values())
        return
    (line,) = [line for line in out.splitlines() if FOUND[case.name, command] in line]
    if command == "check":
        assert code == 1
        assert [each for each in out.splitlines() if each.startswith("- ")] == [line]
    else:
        assert code == 0
