"""Friction beyond viscous, Coulomb and offset: columns, velocities, load, and the robot that is simulated with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.errors import ExperimentError, RobotError, ShapeError
from didim.model.dynamics import rigid_torque
from didim.robot.friction import Friction, FrictionTerm
from didim.robot.robot import Robot

pytestmark = pytest.mark.usefixtures("without_verdict")

RATE = 200.0


def planar(*terms: FrictionTerm, dead_zone: float = 0.0) -> Robot:
    robot = didim.load_robot("planar2")
    friction = replace(
        robot.friction, coulomb="sign", smoothing=(0.0, 0.0), dead_zone=(dead_zone,) * 2, terms=terms
    )
    return replace(robot, friction=friction)


def parameters(robot: Robot, **terms: float) -> np.ndarray:
    x = np.zeros(len(robot.parameter_names))
    known = didim.load_robot("planar2")
    (first, *_) = known.sets.values()
    x[: first.size] = first
    for name, value in terms.items():
        x[robot.parameter_names.index(name)] = value
    return x


def motion(n: int = 4000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A motion of two joints with reversals, exactly differentiated."""
    t = np.arange(n) / RATE
    q, dq, ddq = (np.zeros((n, 2)) for _ in range(3))
    for joint, (amplitudes, frequencies) in enumerate(
        (((0.8, 0.4), (0.31, 0.83)), ((0.6, 0.5), (0.43, 0.71)))
    ):
        for a, f in zip(amplitudes, frequencies, strict=True):
            w = 2.0 * np.pi * f
            q[:, joint] += a * np.sin(w * t + joint)
            dq[:, joint] += a * w * np.cos(w * t + joint)
            ddq[:, joint] -= a * w * w * np.sin(w * t + joint)
    return q, dq, ddq


def log(robot: Robot, x: np.ndarray, noise: float = 0.0, seed: int = 0) -> didim.Experiment:
    q, dq, ddq = motion()
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    tau = tau + noise * np.random.default_rng(seed).standard_normal(tau.shape)
    recording = didim.Recording.from_arrays(q, tau, rate_hz=RATE)
    signal = didim.SignalProcessing(cutoff_hz=None, trim_start=10, trim_end=10)
    return didim.Experiment(name="planar", robot=robot, recordings=(recording,), signal=signal)


EVERY = (
    FrictionTerm(law="rest", joint=0),
    FrictionTerm(law="atan", joint=0, velocity=0.3),
    FrictionTerm(law="stribeck", joint=1, velocity=0.4),
    FrictionTerm(law="root", joint=1),
    FrictionTerm(law="forward", joint=0),
    FrictionTerm(law="load", joint=1),
)


def test_torques_are_the_columns_times_the_parameters() -> None:
    robot = planar(*EVERY, dead_zone=0.2)
    assert robot.parameter_names[-6:] == ("Rest1", "Fa1", "Fs2", "Fr2", "Fvp1", "Fl2")
    x = parameters(robot, Rest1=0.4, Fa1=1.1, Fs2=-0.5, Fr2=0.3, Fvp1=0.2, Fl2=0.15)
    q, dq, ddq = motion(300)
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    w = didim.regressor(robot, q, dq, ddq, x=x)
    np.testing.assert_allclose(w @ x, tau, rtol=1e-11, atol=1e-11)
    with pytest.raises(ShapeError, match="load friction: its regressor needs the parameters x"):
        didim.regressor(robot, q, dq, ddq)


def test_columns_are_those_of_the_equations() -> None:
    robot = planar(*EVERY, dead_zone=0.2)
    x = parameters(robot)
    q, dq, ddq = motion(300)
    w = didim.regressor(robot, q, dq, ddq, x=x)
    column = {name: w[:, :, k] for k, name in enumerate(robot.parameter_names)}
    s = np.sign(dq) * (np.abs(dq) > 0.2)
    tau = rigid_torque(robot, q, dq, ddq, x)
    np.testing.assert_array_equal(column["Rest1"][:, 0], np.abs(dq[:, 0]) <= 0.2)
    np.testing.assert_allclose(column["Fa1"][:, 0], np.arctan(dq[:, 0] / 0.3), rtol=1e-14)
    np.testing.assert_allclose(column["Fs2"][:, 1], s[:, 1] * np.exp(-((dq[:, 1] / 0.4) ** 2)), rtol=1e-13)
    np.testing.assert_allclose(column["Fr2"][:, 1], s[:, 1] * np.sqrt(np.abs(dq[:, 1])), rtol=1e-14)
    np.testing.assert_array_equal(column["Fvp1"][:, 0], np.maximum(dq[:, 0], 0.0))
    np.testing.assert_allclose(column["Fl2"][:, 1], np.abs(tau[:, 1]) * s[:, 1], rtol=1e-13)
    for name, joint in (("Rest1", 1), ("Fa1", 1), ("Fs2", 0), ("Fl2", 0)):
        assert not column[name][:, joint].any()


def test_the_torque_of_links_and_rotors_has_no_friction() -> None:
    robot = planar(*EVERY, dead_zone=0.2)
    x = parameters(robot, Fa1=1.1, Fl2=0.3)
    plain = didim.load_robot("planar2")
    without = np.array(x[: len(plain.parameter_names)])
    for place, name in enumerate(plain.parameter_names):
        if name.startswith(("Fv", "Fc", "Off")):
            without[place] = 0.0
    q, dq, ddq = motion(50)
    np.testing.assert_allclose(
        rigid_torque(robot, q, dq, ddq, x), didim.inverse_dynamics(plain, q, dq, ddq, without), rtol=1e-12
    )


def test_the_direct_model_undoes_every_term() -> None:
    robot = planar(*EVERY, dead_zone=0.2)
    x = parameters(robot, Rest1=0.4, Fa1=1.1, Fs2=-0.5, Fr2=0.3, Fvp1=0.2, Fl2=0.4)
    q, dq, ddq = motion(300)
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    np.testing.assert_allclose(didim.direct_dynamics(robot, q, dq, tau, x), ddq, rtol=1e-9, atol=1e-9)


def test_velocities_and_load_friction_come_back_from_a_noise_free_log() -> None:
    terms = (
        FrictionTerm(law="atan", joint=0, velocity=0.37),
        FrictionTerm(law="stribeck", joint=1, velocity=0.21),
        FrictionTerm(law="load", joint=0),
        FrictionTerm(law="load", joint=1),
    )
    robot = planar(*terms, dead_zone=1e-6)
    x = parameters(robot, Fa1=1.1, Fs2=0.4, Fl1=0.06, Fl2=0.1)
    experiment = log(robot, x)
    unknown = [replace(term, velocity=0.1, estimated=True) if term.velocity else term for term in terms]
    open_robot = planar(*unknown, dead_zone=1e-6)
    # Differences of sampled positions are the only error left.
    fit = didim.identify(replace(experiment, robot=open_robot))
    found = {item["parameter"]: item for item in fit.settings["friction"]["velocities"]}
    assert found["Fa1"]["velocity"] == pytest.approx(0.37, rel=0.02)
    assert found["Fs2"]["velocity"] == pytest.approx(0.21, rel=0.02)
    value = dict(zip(fit.names, fit.beta, strict=True))
    for name, true in (("Fa1", 1.1), ("Fs2", 0.4), ("Fl1", 0.06), ("Fl2", 0.1)):
        assert value[name] == pytest.approx(true, rel=0.03), name
    assert fit.overall_relative_error < 2e-3
    # The result knows its velocities: another log needs none.
    other = didim.validate(fit, replace(experiment, robot=open_robot))
    assert other.recordings[0].direct_overall == pytest.approx(fit.overall_relative_error, rel=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("without_alarm")
def test_errors_are_as_large_as_sigma_says_and_velocities_have_a_sigma() -> None:
    terms = (FrictionTerm(law="atan", joint=0, velocity=0.3), FrictionTerm(law="load", joint=1))
    robot = planar(*terms)
    x = parameters(robot, Fa1=1.5, Fl2=0.1)
    truth = robot.base_parameters.project(x)
    unknown = planar(replace(terms[0], velocity=0.1, estimated=True), terms[1])
    z, velocity = [], []
    for seed in range(12):
        experiment = replace(log(robot, x, noise=0.1, seed=seed), robot=unknown)
        fit = didim.identify(experiment, didim.IDIMLS(weights="per-joint"))
        keep = [name not in ("Fv1", "Fc1", "Fa1") for name in fit.names]  # theirs move with the velocity
        z.append(((fit.beta - truth) / fit.std)[keep])
        (item,) = fit.settings["friction"]["velocities"]
        velocity.append((item["velocity"] - 0.3) / item["std"])
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.35
    assert 0.5 < np.sqrt(np.mean(np.square(velocity))) < 1.7


def test_recordings_share_one_velocity() -> None:
    """Logs of different motions and slightly different laws have one velocity between those of each alone."""
    term = FrictionTerm(law="atan", joint=0, velocity=0.1, estimated=True)
    unknown = planar(term)
    logs = []
    for seed, (velocity, size) in enumerate(((0.28, 1.0), (0.36, 0.5))):
        robot = planar(replace(term, velocity=velocity, estimated=False))
        q, dq, ddq = (size * values for values in motion())
        tau = didim.inverse_dynamics(robot, q, dq, ddq, parameters(robot, Fa1=2.0))
        tau = tau + 0.05 * np.random.default_rng(seed).standard_normal(tau.shape)
        recording = didim.Recording.from_arrays(q, tau, rate_hz=RATE, name=f"log {seed + 1}")
        logs.append(replace(log(robot, parameters(robot)), robot=unknown, recordings=(recording,)))
    both = replace(logs[0], recordings=tuple(item.recordings[0] for item in logs))
    found = []
    for experiment in (*logs, both):
        (item,) = didim.identify(experiment).settings["friction"]["velocities"]
        found.append((item["velocity"], item["std"]))
    (first, first_std), (second, second_std), (shared, _) = found
    assert first + 4.0 * (first_std + second_std) < second
    assert first < shared < second


def test_a_velocity_that_the_log_does_not_identify_is_replaced_by_the_square_root() -> None:
    robot = planar()
    x = parameters(robot)
    unknown = planar(FrictionTerm(law="atan", joint=0, velocity=0.1, estimated=True))
    fit = didim.identify(replace(log(robot, x, noise=0.05), robot=unknown))
    (item,) = fit.settings["friction"]["velocities"]
    assert not item["identified"]
    assert "Fr1" in fit.names
    assert any("does not identify the velocity of Fa1" in remark for remark in fit.remarks)


def test_a_law_of_ones_own_is_identified_and_simulated() -> None:
    term = FrictionTerm.from_function("Fq", 1, lambda v: v * np.abs(v), fastest=8.0)
    robot = planar(term)
    x = parameters(robot, Fq2=0.3)
    fit = didim.identify(log(robot, x))
    value = dict(zip(fit.names, fit.beta, strict=True))
    assert value["Fq2"] == pytest.approx(0.3, rel=0.01)
    q, dq, ddq = motion(100)
    law = didim.inverse_dynamics(robot, q, dq, ddq, x) - didim.inverse_dynamics(
        robot, q, dq, ddq, parameters(robot)
    )
    np.testing.assert_allclose(law[:, 1], 0.3 * dq[:, 1] * np.abs(dq[:, 1]), atol=1e-3)
    with pytest.raises(RobotError, match="one finite number per speed"):
        FrictionTerm.from_function("Fq", 0, lambda v: 1.0 / v, fastest=1.0)
    with pytest.raises(RobotError, match="at least 4 speeds"):
        FrictionTerm.from_function("Fq", 0, np.abs, fastest=1.0, speeds=3)
    with pytest.raises(RobotError, match="letters and digits"):
        FrictionTerm.from_function("my law", 0, np.abs, fastest=1.0)


FILE = """
schema = 1
robot = "planar2"
[friction]
coulomb = "sign"
dead_zone_rad_s = 0.01
{friction}
[[recording]]
rate_hz = 100
[recording.position]
file = "log.csv"
columns = ["q1", "q2"]
unit = "rad"
side = "joint"
[recording.torque]
file = "log.csv"
columns = ["t1", "t2"]
unit = "N.m"
side = "joint"
"""


def written(tmp_path: Path, friction: str) -> didim.Experiment:
    rows = "\n".join(f"{0.1 * k},{0.2 * k},{0.3 * k},{0.1 * k}" for k in range(50))
    (tmp_path / "log.csv").write_text(f"q1,q2,t1,t2\n{rows}\n")
    path = tmp_path / "experiment.toml"
    path.write_text(FILE.format(friction=friction))
    return didim.load_experiment(path)


def test_an_experiment_file_chooses_terms_joint_by_joint(tmp_path: Path) -> None:
    experiment = written(
        tmp_path, "standstill = true\natan = [2]\natan_velocity_rad_s = 0.4\nload = [1]\nstribeck = [1]"
    )
    terms = {term.parameter: term for term in experiment.robot.friction.terms}
    assert sorted(terms) == ["Fa2", "Fl1", "Fs1", "Rest1", "Rest2"]
    assert terms["Fa2"].velocity == 0.4
    assert not terms["Fa2"].estimated
    assert terms["Fs1"].estimated
    assert written(tmp_path, 'terms = "auto"').robot.friction.auto


@pytest.mark.parametrize(
    ("friction", "message"),
    [
        ("atan = [3]", "atan must be true, false or a list of joints from 1 to 2"),
        ("load = [1, 1]", "load names a joint twice"),
        ("atan_velocity_rad_s = 0.3", "atan_velocity needs the key atan"),
        ("atan = true\natan_velocity_rad_s = 0", "atan_velocity of joint 1 must be above 0"),
        ("stand_still = true", "stand_still"),
        ('terms = "all"', "terms must be"),
    ],
)
def test_wrong_friction_keys_are_named(tmp_path: Path, friction: str, message: str) -> None:
    with pytest.raises((ExperimentError, RobotError), match="(?s)" + message.replace("[", r"\[")):
        written(tmp_path, friction)


def test_terms_survive_a_result_file(tmp_path: Path) -> None:
    robot = planar(FrictionTerm(law="atan", joint=0, velocity=0.3), dead_zone=0.01)
    fit = didim.identify(log(robot, parameters(robot, Fa1=1.0)))
    fit.save(tmp_path / "fit.json")
    saved = didim.Identification.load(tmp_path / "fit.json")
    terms = Friction.terms_of(saved.settings["robot"]["friction"]["terms"])
    assert terms == robot.friction.terms
