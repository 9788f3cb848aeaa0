"""Dahl's memory in displacement: exact between reversals, and linear in the state at its start."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import didim
from didim.errors import FitError, RobotError
from didim.experiment.specs import SimulationSettings
from didim.model.dynamics import rigid_torque
from didim.model.memory import sliding, start_column, state
from didim.robot.friction import HOLD_WIDTH, FrictionTerm
from didim.robot.robot_text import robot_text
from didim.studies.simulated_log import simulated_log
from test_friction_terms import log, motion, parameters, planar

pytestmark = pytest.mark.usefixtures("without_verdict")

HELD = (
    FrictionTerm(law="hold", joint=0),
    FrictionTerm(law="stribeck", joint=0, velocity=0.3),
    FrictionTerm(law="load", joint=0),
    FrictionTerm(law="root", joint=0),
    FrictionTerm(law="dahl", joint=1, velocity=0.02),
)
REFERENCE = didim.Reference.point_to_point(
    [[0.0, 0.0], [0.3, -0.4], [-0.2, 0.3]], max_velocity=[1.0, 1.0], max_acceleration=[4.0, 4.0], dwell_s=0.5
)
CONTROLLER = didim.Controller.tuned([8.0, 12.0], 0.7, inertia=[1.5, 0.2])


def walk(seed: int, n: int = 400) -> np.ndarray:
    rng = np.random.default_rng(seed)
    q = np.cumsum(rng.standard_normal((n, 2)), axis=0) * 0.01
    q[100:110] = q[100]  # at rest
    return np.asarray(q)


def stepped(q: np.ndarray, h: float, start: float) -> np.ndarray:
    """Steps from sample to sample, as the equation says."""
    z = np.full(q.shape[1], start)
    found = [z]
    for change in np.diff(q, axis=0):
        s = np.sign(change)
        z = np.where(s == 0.0, z, s - (s - z) * np.exp(-np.abs(change) / h))
        found.append(z)
    return np.array(found)


@given(st.integers(0, 1000), st.floats(1e-3, 0.3))
def test_the_state_is_that_of_steps_from_sample_to_sample(seed: int, h: float) -> None:
    q = walk(seed)
    np.testing.assert_allclose(state(q, h), stepped(q, h, 0.0), atol=1e-12)


def test_more_samples_on_the_same_way_change_nothing() -> None:
    q = walk(3)
    fine = np.empty((2 * len(q) - 1, 2))
    fine[::2], fine[1::2] = q, 0.5 * (q[1:] + q[:-1])
    np.testing.assert_allclose(state(fine, 0.02)[::2], state(q, 0.02), atol=1e-12)


def test_what_a_start_leaves_is_linear() -> None:
    q = walk(5)
    np.testing.assert_allclose(
        stepped(q, 0.05, 0.7), state(q, 0.05) + 0.7 * start_column(q, 0.05), atol=1e-12
    )


def test_what_a_start_leaves_does_not_underflow() -> None:
    q = np.linspace(0.0, 100.0, 50)[:, None]
    assert np.all(start_column(q, 0.01) >= 1e-27)


def test_widths_are_those_of_their_joints_and_rest_keeps_the_state() -> None:
    q = walk(1)
    both = state(q, np.array([0.01, 0.1]))
    np.testing.assert_array_equal(both[:, 0], state(q, 0.01)[:, 0])
    np.testing.assert_array_equal(both[:, 1], state(q, 0.1)[:, 1])
    assert np.ptp(both[100:110], axis=0).max() == 0.0
    assert not state(np.zeros((5, 2)), 0.1).any()


def stopping(n: int = 600) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A motion that stops twice: the second time it goes on backwards."""
    q, dq, ddq = motion(n)
    for array, value in ((q, q[200]), (dq, 0.0), (ddq, 0.0)):
        array[200:300] = value
    return q, dq, ddq


def test_a_sign_that_is_kept_takes_the_place_of_the_sign_in_every_law() -> None:
    robot = planar(*HELD, dead_zone=0.2)
    assert robot.parameter_names[-4:] == ("Fs1", "Fl1", "Fr1", "Fz2")
    x = parameters(robot, Fs1=0.7, Fl1=0.1, Fr1=0.2, Fz2=1.5)
    q, dq, ddq = stopping()
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    plain = planar()
    rest = didim.inverse_dynamics(plain, q, dq, ddq, parameters(plain))
    fc = parameters(plain)[[plain.parameter_names.index(f"Fc{j}") for j in (1, 2)]]
    width = HOLD_WIDTH["revolute"]
    z = state(q, width) + np.sign(dq[0]) * start_column(q, width)
    load = rigid_torque(robot, q, dq, ddq, x)
    speed = dq[:, 0]
    held = fc[0] * (z[:, 0] - np.sign(speed)) + z[:, 0] * (
        0.7 * np.exp(-((speed / 0.3) ** 2)) + 0.1 * np.abs(load[:, 0]) + 0.2 * np.sqrt(np.abs(speed))
    )
    np.testing.assert_allclose(tau[:, 0], rest[:, 0] + held, atol=1e-12)
    sign = np.sign(dq[:, 1]) * (np.abs(dq[:, 1]) > 0.2)
    remembered = 1.5 * state(q, 0.02, np.sign(dq[0]) * (np.abs(dq[0]) > 0.2))[:, 1] + fc[1] * (
        sign - np.sign(dq[:, 1])
    )
    np.testing.assert_allclose(tau[:, 1], rest[:, 1] + remembered, atol=1e-12)
    np.testing.assert_allclose(didim.regressor(robot, q, dq, ddq, x=x) @ x, tau, atol=1e-11)
    # At rest the sign is that of the last motion, not zero.
    assert np.abs(np.abs(z[210:300, 0]) - 1.0).max() < 1e-12


def test_a_log_of_such_a_robot_is_explained_by_it_alone() -> None:
    robot = planar(*HELD, dead_zone=0.05)
    x = parameters(robot, Fs1=0.7, Fl1=0.1, Fr1=0.2, Fz2=1.5)
    experiment = log(robot, x)
    signal = replace(experiment.signal, trim_start=0, trim_end=0)  # states begin with the log
    experiment = replace(experiment, signal=signal)
    fit = didim.identify(experiment)
    forgetful = replace(
        experiment, robot=robot.with_terms([term for term in HELD if term.law not in ("hold", "dahl")])
    )
    assert fit.overall_relative_error < 0.02 * didim.identify(forgetful).overall_relative_error
    value = dict(zip(fit.names, fit.beta, strict=True))
    assert value["Fz2"] == pytest.approx(1.5, rel=2e-3)


def test_the_terms_are_written_and_read(tmp_path: Path) -> None:
    robot = planar(*HELD, dead_zone=0.05)
    path = tmp_path / "remembers.toml"
    path.write_text(robot_text(robot))
    read = didim.load_robot(path)
    assert set(read.friction.terms) == set(robot.friction.terms)
    again = planar().with_friction(hold=[1, 2], dahl=[2], dahl_width_rad=[0.01, 0.02])
    assert [(term.law, term.joint, term.velocity) for term in again.friction.terms] == [
        ("hold", 0, 0.0),
        ("hold", 1, 0.0),
        ("dahl", 1, 0.02),
    ]
    assert planar().with_friction(dahl=True).friction.estimated
    with pytest.raises(RobotError, match="dahl_width of joint 1 must be above 0"):
        planar().with_friction(dahl=True, dahl_width_rad=0.0)


def stopping_run(*terms: FrictionTerm) -> tuple[didim.Robot, np.ndarray, didim.Simulation]:
    """Simulate a motion that stops for half a second before it goes on."""
    robot = planar(*terms).with_smoothing([0.01, 0.01])
    values = {"Fs1": 0.7, "Fl1": 0.1, "Fr1": 0.2, "Fz2": 1.5}
    x = parameters(robot, **{name: values[name] for name in robot.parameter_names if name in values})
    return robot, x, didim.simulate(robot, x, REFERENCE, CONTROLLER, rate_hz=2000)


def test_the_closed_loop_has_the_friction_of_the_inverse_model_and_holds_a_joint() -> None:
    frictions = []
    for terms in (HELD, HELD[1:]):
        robot, x, run = stopping_run(*terms)
        tau = didim.inverse_dynamics(robot, run.q, run.dq, run.ddq, x)
        assert np.abs(run.tau - tau).max() < 2e-3 * np.abs(tau).max()
        frictions.append((run.tau - rigid_torque(robot, run.q, run.dq, run.ddq, x))[[2840, 3200], 0])
    # Both rows are of one standstill: a sign that is kept has its torque there, a smooth one lets the joint go.
    (kept, later), (smooth, lost) = frictions
    assert kept == pytest.approx(later, rel=0.01)
    assert kept > 1.5
    assert abs(lost) < abs(smooth) < 0.3 * kept


@pytest.mark.slow
def test_didim_and_cloe_simulate_a_sign_that_is_kept() -> None:
    terms = [FrictionTerm(law="hold", joint=0), FrictionTerm(law="dahl", joint=1, velocity=0.01)]
    robot = planar(*terms, dead_zone=0.02)
    x = parameters(robot, Fz2=0.5)
    experiment = didim.Experiment(
        name="planar",
        robot=robot,
        recordings=(),
        reference=REFERENCE,
        controller=CONTROLLER,
        signal=didim.SignalProcessing(cutoff_hz=60.0, trim_start=40, trim_end=40, decimation=(5,)),
        simulation=SimulationSettings(rate_hz=500.0, smoothing=(0.01, 0.01)),
    )
    log = simulated_log(experiment, x, noise=False)
    forgetful = replace(log, robot=robot.with_terms(terms[1:]))
    # DIDIM filters the log and not the sign, so it comes near alone; CLOE has what made the log.
    for method, worst, share in ((didim.DIDIM(), 0.05, 0.2), (didim.CLOE(start="reference"), 1e-4, 1e-3)):
        fit, without = didim.identify(log, method), didim.identify(forgetful, method)
        value = dict(zip(fit.names, fit.beta, strict=True))
        for name, true in (("Fc1", 2.0), ("Fc2", 0.9), ("Fz2", 0.5)):
            assert value[name] == pytest.approx(true, rel=worst)
        assert fit.overall_relative_error < share * without.overall_relative_error


def test_formulas_without_a_path_refuse_memory() -> None:
    with pytest.raises(FitError, match="friction term Hold1 depends on the path"):
        didim.export.to_latex(planar(HELD[0]))


def test_one_sample_and_a_curve_over_speed_have_the_sign_of_their_velocity() -> None:
    robot = planar(*HELD, dead_zone=0.05)
    x = parameters(robot, Fs1=0.7, Fr1=0.2, Fz2=1.5)
    still = np.zeros((1, 2))
    (forward,), (backward,) = (
        didim.inverse_dynamics(robot, still, np.array([[s, s]]), still, x) for s in (0.5, -0.5)
    )
    fv, fc = (x[robot.parameter_names.index(name)] for name in ("Fv1", "Fc1"))
    wanted = 0.5 * fv + fc + 0.7 * np.exp(-((0.5 / 0.3) ** 2)) + 0.2 * np.sqrt(0.5)
    assert 0.5 * (forward[0] - backward[0]) == pytest.approx(wanted)
    plain, values = sliding(robot, x)
    names = [term.law for term in plain.friction.terms]
    assert names == ["stribeck", "load", "root"]
    assert values[plain.parameter_names.index("Fc2")] == pytest.approx(
        x[robot.parameter_names.index("Fc2")] + 1.5
    )
