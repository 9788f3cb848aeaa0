"""Friction that changes with a recorded temperature: columns, recovery, the choice, files, and what refuses it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.errors import FitError, RecordingError, ShapeError
from didim.model.memory import direction
from didim.regression.friction.candidates import LEAST_WARMING
from didim.robot.friction import FrictionTerm
from didim.robot.robot_file import load_robot
from didim.robot.robot_text import robot_text
from test_friction_terms import RATE, log, motion, parameters, planar

pytestmark = pytest.mark.usefixtures("without_causes")

REFERENCE = 30.0
WARM = tuple(
    FrictionTerm(law=law, joint=joint, values=(REFERENCE,))
    for joint in range(2)
    for law in ("warm_viscous", "warm_coulomb")
)
TRUTH = {"Fvt1": -0.03, "Fct1": 0.05, "Fvt2": -0.02, "Fct2": -0.04}
"""About 1 to 3 % of the friction per kelvin."""


def temperature(first: float = 26.0, change: float = 9.0, n: int = 4000) -> np.ndarray:
    """Temperature of joint 1, that of joint 2 is 5 K higher: warming up with 8 s (degC)."""
    rise = 1.0 - np.exp(-np.arange(n) / RATE / 8.0)
    return np.asarray(first + change * rise[:, None] + np.array([0.0, 5.0]))


def warm_log(
    *terms: FrictionTerm, noise: float = 0.1, seed: int = 0, recorded: np.ndarray | None = None
) -> didim.Experiment:
    """A log of a robot that warms up, with a model that has `terms`."""
    robot = planar(*WARM)
    q, dq, ddq = motion()
    warmth = temperature() if recorded is None else recorded
    tau = didim.inverse_dynamics(robot, q, dq, ddq, parameters(robot, **TRUTH), temperature=warmth)
    tau = tau + noise * np.random.default_rng(seed).standard_normal(tau.shape)
    recording = replace(didim.Recording.from_arrays(q, tau, rate_hz=RATE), temperature=warmth)
    return replace(log(robot, parameters(robot)), robot=planar(*terms), recordings=(recording,))


def test_columns_are_those_of_the_equations() -> None:
    robot = planar(*WARM, dead_zone=0.2)
    x = parameters(robot, **TRUTH)
    q, dq, ddq = motion(300)
    warmth = temperature(n=300)
    plain = didim.inverse_dynamics(robot, q, dq, ddq, x)
    sign = np.sign(dq) * (np.abs(dq) > 0.2)
    viscous, coulomb = (np.array([TRUTH[f"{key}{j}"] for j in (1, 2)]) for key in ("Fvt", "Fct"))
    expected = plain + (warmth - REFERENCE) * (viscous * dq + coulomb * sign)
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x, temperature=warmth)
    np.testing.assert_allclose(tau, expected, rtol=1e-12, atol=1e-12)
    w = didim.regressor(robot, q, dq, ddq, temperature=warmth)
    np.testing.assert_allclose(w @ x, tau, rtol=1e-9, atol=1e-9)
    # One temperature for all joints; at the reference temperature, and in simulations, the terms are zero.
    one = didim.inverse_dynamics(robot, q, dq, ddq, x, temperature=warmth[:, 0])
    np.testing.assert_array_equal(one[:, 0], tau[:, 0])
    at_reference = didim.inverse_dynamics(robot, q, dq, ddq, x, temperature=np.full(300, REFERENCE))
    np.testing.assert_array_equal(at_reference, plain)
    np.testing.assert_allclose(didim.direct_dynamics(robot, q, dq, plain, x), ddq, rtol=1e-9, atol=1e-9)
    units = dict(zip(robot.parameter_names, robot.parameter_units, strict=True))
    assert (units["Fvt1"], units["Fct2"]) == ("N.m.s/rad/K", "N.m/K")
    with pytest.raises(ShapeError, match="temperature must have shape"):
        didim.inverse_dynamics(robot, q, dq, ddq, x, temperature=np.zeros((300, 3)))


def test_the_sign_of_a_held_joint_is_that_of_its_last_motion() -> None:
    robot = planar(FrictionTerm(law="hold", joint=0), WARM[1], dead_zone=0.2)
    x = parameters(robot, Fct1=0.05)
    q, dq, ddq = motion(300)
    warmth = np.full(300, REFERENCE + 10.0)
    warm = didim.inverse_dynamics(robot, q, dq, ddq, x, temperature=warmth)
    change = warm - didim.inverse_dynamics(robot, q, dq, ddq, x)
    held = direction(robot, q, dq)[:, 0]
    assert np.abs(held[np.abs(dq[:, 0]) < 0.2]).max() == pytest.approx(1.0)
    np.testing.assert_allclose(change[:, 0], 0.5 * held, atol=1e-12)


def test_errors_are_as_large_as_sigma_says() -> None:
    robot = planar(*WARM)
    truth = robot.base_parameters.project(parameters(robot, **TRUTH))
    fits = [didim.identify(warm_log(*WARM, noise=0.5, seed=seed), uncertainty="white") for seed in range(12)]
    z = np.array([(fit.beta - truth) / fit.std for fit in fits])
    warm = [fits[0].names.index(name) for name in TRUTH]
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.2
    assert 0.7 < np.sqrt(np.mean(z[:, warm] ** 2)) < 1.35
    fit = didim.identify(warm_log(*WARM, noise=0.5))
    assert fit.verdict.state == "sound", str(fit.verdict)


def test_the_choice_takes_them_where_they_help_and_only_there() -> None:
    experiment = warm_log()
    fit = didim.identify(experiment, didim.IDIMLS(friction="auto"))
    assert {item["parameter"] for item in fit.settings["friction"]["chosen"]} == set(TRUTH)
    value = dict(zip(fit.names, fit.beta, strict=True))
    for name, true in TRUTH.items():
        assert value[name] == pytest.approx(true, abs=max(4.0 * fit.std[fit.names.index(name)], 1e-3)), name
    (reference,) = {term["values"][0] for term in fit.settings["robot"]["friction"]["terms"][:1]}
    assert reference in (np.round(temperature().mean(axis=0))).tolist()
    # Validation has the temperature of the log.
    report = didim.validate(fit, experiment)
    assert report.recordings[0].direct_overall == pytest.approx(fit.overall_relative_error, rel=1e-6)
    # A simulation has one temperature, and a log of a robot that does not warm up needs no such term.
    robot = planar()
    cold = log(robot, parameters(robot), noise=0.1)
    cold = replace(cold, recordings=(replace(cold.recordings[0], temperature=temperature()),))
    fit = didim.identify(cold, didim.IDIMLS(friction="auto"))
    assert not fit.settings["friction"]["chosen"]


def test_a_temperature_that_hardly_varies_is_refused_and_no_candidate() -> None:
    still = temperature(change=0.9 * LEAST_WARMING)
    with pytest.raises(
        FitError, match=r"temperature of joint 1 varies by 1\.\d K, which is too little for Fvt1"
    ):
        didim.identify(warm_log(*WARM, recorded=still))
    fit = didim.identify(warm_log(recorded=still), didim.IDIMLS(friction="auto"))
    assert not {"Fvt1", "Fct1", "Fvt2", "Fct2"} & set(fit.names)


def test_methods_that_simulate_and_logs_without_temperature_refuse_them() -> None:
    experiment = warm_log(*WARM)
    with pytest.raises(
        FitError, match="Fvt1 depends on the temperature, and didim simulates the robot at one"
    ):
        didim.identify(experiment, "didim")
    (recording,) = experiment.recordings
    without = replace(experiment, recordings=(replace(recording, temperature=None),))
    with pytest.raises(
        FitError, match=r"has no temperature, on which Fvt1 depends: give \[recording.temperature\]"
    ):
        didim.identify(without)


FILE = """schema = 1
name = "warm"
robot = "planar2"

[[recording]]
rate_hz = 200.0
{table}
[recording.position]
file = "log.csv"
columns = ["q1", "q2"]
unit = "rad"
side = "joint"
[recording.torque]
file = "log.csv"
columns = ["tau1", "tau2"]
unit = "N.m"
side = "joint"
[friction]
coulomb = "sign"
temperature_viscous = true
temperature_coulomb = [1, 2]
reference_degc = 30.0
"""


@pytest.mark.parametrize(
    ("columns", "unit", "zero"),
    [('["T1", "T2"]', "degC", 0.0), ('["T1"]', "K", 273.15)],
)
def test_an_experiment_file_has_a_temperature(tmp_path: Path, columns: str, unit: str, zero: float) -> None:
    (recording,) = warm_log().recordings
    assert recording.temperature is not None
    assert recording.tau is not None
    values = np.hstack([recording.q, recording.tau, recording.temperature + zero])
    np.savetxt(tmp_path / "log.csv", values, delimiter=",", header="q1,q2,tau1,tau2,T1,T2", comments="")
    table = f'[recording.temperature]\nfile = "log.csv"\ncolumns = {columns}\nunit = "{unit}"'
    (tmp_path / "log.toml").write_text(FILE.format(table=table))
    experiment = didim.load_experiment(tmp_path / "log.toml")
    (read,) = experiment.recordings
    assert read.temperature is not None
    expected = recording.temperature[:, [0, 0]] if columns == '["T1"]' else recording.temperature
    np.testing.assert_allclose(read.temperature, expected, atol=1e-9)
    assert [(term.parameter, term.values) for term in experiment.robot.friction.warmed] == [
        (name, (30.0,)) for name in ("Fvt1", "Fvt2", "Fct1", "Fct2")
    ]
    # The robot is written with them, and read again.
    (tmp_path / "robot.toml").write_text(robot_text(experiment.robot))
    assert load_robot(tmp_path / "robot.toml").friction.warmed == experiment.robot.friction.warmed


def test_a_wrong_temperature_is_named() -> None:
    (recording,) = warm_log().recordings
    with pytest.raises(RecordingError, match="temperature and q differ in shape"):
        replace(recording, temperature=np.zeros((4000, 3)))
    values = temperature()
    values[7, 1] = np.nan
    with pytest.raises(RecordingError, match="temperature of joint 2 is nan at sample 7"):
        replace(recording, temperature=values)


def test_exports_are_at_the_reference_temperature() -> None:
    warm, plain = planar(*WARM), planar()
    code = [
        re.sub(r"t\d+", "t", didim.export.to_c(robot, x, prefix="arm").partition("#include")[2])
        for robot, x in ((warm, parameters(warm, **TRUTH)), (plain, parameters(plain)))
    ]
    assert code[0] == code[1] != ""
    with pytest.raises(FitError, match="friction term Fvt1 depends on the temperature"):
        didim.export.to_latex(warm)
