"""Size, single samples, identification and uses: what a result leaves of its torques, and what it is good for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
import friction_logs
import simulated
from didim import Experiment, identify
from didim.evidence.residual import residual_of
from didim.evidence.thresholds import SIZE_DOUBTFUL
from didim.evidence.uses import combined
from didim.methods.idim_ls import IDIMLS
from didim.robot.friction import FrictionTerm
from didim.signal.spikes import alone, without_lone
from planted import with_torques
from test_friction_terms import log as friction_log
from test_friction_terms import parameters
from test_friction_terms import planar as arm_with
from verdict_arms import ARMS, Log, built


@pytest.fixture(scope="module")
def sound() -> Log:
    return built(ARMS["gantry"], None)


def codes(fit: didim.Identification) -> dict[str, str]:
    return {item.code: item.grade for item in fit.verdict.reasons}


def planar(noise: float, n_samples: int = 6000) -> Experiment:
    robot = didim.load_robot("planar2")
    x = robot.parameter_set("reference")
    return simulated.experiment(robot, simulated.log(robot, x, n_samples=n_samples, noise=noise))


def tau_of(log: Experiment) -> np.ndarray:
    (recording,) = log.recordings
    assert recording.tau is not None
    return recording.tau.copy()


def test_white_noise_is_no_error_of_the_model_and_a_wave_is() -> None:
    """Noise of 2 N.m speaks against nothing; a wave at 3 Hz of a tenth of the torques does, however white its rows look."""
    log = planar(2.0)
    assert identify(log).verdict.sound
    tau = tau_of(log)
    t = np.arange(len(tau))[:, None] / log.recordings[0].rate_hz
    wave = 0.2 * np.std(tau, axis=0) * np.sqrt(2.0) * np.sin(2.0 * np.pi * 3.1 * t)
    fit = identify(with_torques(log, tau + wave))
    (finding,) = [item for item in fit.verdict.grave if item.code == "size"]
    assert finding.grade == "doubtful"
    assert finding.value == pytest.approx(0.2, rel=0.25)
    assert (finding.value or 0.0) > SIZE_DOUBTFUL


def test_the_residual_is_that_of_the_fit() -> None:
    log = planar(0.3)
    fit = identify(log)
    job = IDIMLS().job(log)
    parts = job.parts("fit", job.declared_delay)
    found = residual_of(job.robot, job.model, fit.beta, parts, job.signal)
    system = job.system(parts)
    wanted = (system.y - system.w @ fit.beta).reshape(found.error.shape)
    np.testing.assert_allclose(found.error, wanted, atol=1e-9 * np.abs(system.y).max())
    # What is left is the noise: about none of it lasts.
    assert found.share() < 0.3 * np.linalg.norm(found.error) / np.linalg.norm(found.torque)


@pytest.mark.slow
def test_outliers_are_named_and_not_the_controller(sound: Log) -> None:
    """A hundredth of the samples is off by thirty standard deviations of the noise."""
    log = sound.noisy(1, 0.01)
    clean = identify(log, didim.DIDIM())
    assert clean.verdict.sound
    rng = np.random.default_rng(3)
    tau = tau_of(log)
    hit = rng.random(tau.shape) < 0.01
    tau[hit] += (0.3 * np.std(tau, axis=0) * rng.choice([-1.0, 1.0], tau.shape))[hit]
    spoiled = with_torques(log, tau)
    fit = identify(spoiled, didim.DIDIM())
    assert codes(fit)["spikes"] == "doubtful"
    assert not any(code.startswith("controller") for code in codes(fit))
    (finding,) = [item for item in fit.verdict.grave if item.code == "spikes"]
    assert finding.remedy is not None
    assert (finding.remedy.table, finding.remedy.key, finding.remedy.value) == (
        "[signal]",
        "spikes",
        "hampel",
    )
    # Once obeyed, silent.
    obeyed = replace(spoiled, signal=replace(spoiled.signal, spikes="hampel"))
    assert "spikes" not in codes(identify(obeyed, didim.DIDIM()))


def test_noise_of_encoders_is_not_blamed_on_the_controller(sound: Log) -> None:
    """Noise times kv is as large as a twentieth of the torques here, and no controller that is wrong."""
    log = sound.noisy(2, 0.003)
    (recording,) = log.recordings
    q = recording.q + 1e-4 * np.random.default_rng(5).standard_normal(recording.q.shape)
    fit = identify(replace(log, recordings=(replace(recording, q=q),)), didim.DIDIM())
    assert not {"controller", "controller-gain", "simulated-motion"} & set(codes(fit))


def test_single_samples_stand_alone_and_steps_do_not() -> None:
    rng = np.random.default_rng(0)
    tau = rng.standard_normal((500, 2))
    assert not alone(tau).any()
    tau[250:, 0] += 50.0  # friction at a reversal
    assert not alone(tau).any()
    tau[100, 1] = 40.0
    assert np.argwhere(alone(tau)).tolist() == [[100, 1]]
    cleaned = without_lone(tau)
    assert abs(cleaned[100, 1]) < 5.0
    assert np.count_nonzero(cleaned != tau) == 1


def test_a_log_that_identifies_nothing_is_not_sound(sound: Log) -> None:
    """A second and a half of a slow motion with much noise."""
    log = sound.noisy(4, 0.05)
    (recording,) = log.recordings
    short = replace(log, recordings=(replace(recording, windows=((0, 280),)),))
    fit = identify(short)
    assert not fit.verdict.sound
    (finding,) = [item for item in fit.verdict.grave if item.code == "unidentified"]
    assert finding.value is None or finding.value > SIZE_DOUBTFUL
    assert finding.parameters
    assert "unidentified" not in codes(identify(log))


def test_uses_say_what_to_expect(sound: Log) -> None:
    """The error of another log of the same robot is the one that was foretold."""
    fit = identify(sound.noisy(1, 0.02))
    uses = {use.name: use for use in fit.verdict.uses}
    assert list(uses) == ["simulation", "gravity compensation", "control", "payload"]
    other = built(ARMS["gantry"], None, motion=1).noisy(7, 0.02)
    (recording,) = didim.validate(fit, replace(other, controller=None)).recordings
    control = uses["control"].error
    assert control is not None
    assert recording.direct_overall == pytest.approx(control, rel=0.5)
    assert uses["gravity compensation"].fit_for
    assert fit.to_dict()["verdict"]["uses"][0]["name"] == "simulation"
    assert str(uses["control"]) in str(fit)


def test_a_held_out_recording_says_what_to_expect(sound: Log) -> None:
    log, other = sound.noisy(1, 0.02), sound.noisy(2, 0.02)
    kept = replace(other.recordings[0], name="kept", role="held-out")
    fit = identify(replace(log, recordings=(*log.recordings, kept)))
    (control,) = [use for use in fit.verdict.uses if use.name == "control"]
    assert "'kept'" in control.why
    assert control.error == pytest.approx(fit.held_out[0].overall_relative_error, rel=0.2)


def test_of_held_out_recordings_the_worst_says_what_to_expect_and_gravity_has_its_mean() -> None:
    """The error of a joint, not of all together, stands over the mean torque of gravity of a joint."""
    robot = didim.load_robot("planar2")
    x = robot.parameter_set("reference")
    logs = [
        simulated.log(robot, x, seed=0, noise=0.3),
        simulated.log(robot, x, seed=1, noise=0.3, name="near", role="held-out"),
        simulated.log(robot, x, seed=2, noise=9.0, name="far", role="held-out"),
    ]
    fit = identify(simulated.experiment(robot, *logs))
    uses = {use.name: use for use in fit.verdict.uses}
    (far,) = [each for each in fit.held_out if each.name == "far"]
    assert "'far'" in uses["control"].why
    assert uses["control"].error == pytest.approx(far.overall_relative_error, rel=0.3)
    gravity = didim.gravity(robot, logs[0].q, x)
    wanted = np.sqrt(np.mean(np.square(far.error_rms))) / np.sqrt(np.mean(gravity**2))
    assert uses["gravity compensation"].error == pytest.approx(wanted, rel=0.3)


def test_an_estimate_that_is_no_robot_cannot_be_simulated_and_its_nearest_robot_can() -> None:
    robot = didim.load_robot("planar2")
    log = planar(0.3)
    fit = identify(log)
    base = robot.base_parameters
    beta = base.project(robot.parameter_set("reference"))
    beta[[name.startswith(("ZZ2", "Ia2")) for name in base.names]] = -0.5
    from didim.evidence.uses import uses_of

    job = IDIMLS().job(log)
    parts = job.parts("fit", job.declared_delay)
    residual = residual_of(job.robot, job.model, beta, parts, job.signal)
    bad = replace(fit, beta=beta, parameters=base.lift(beta))
    uses, _ = uses_of(job.robot, bad, parts, residual, job.signal, 1.0)
    assert not uses[0].fit_for
    assert uses[0].error is None
    assert "physical" in uses[0].why
    good = replace(fit, uses=tuple(uses)).consistent()
    assert good.verdict.uses[0].fit_for


@pytest.mark.slow
def test_cloe_is_asked_the_same_questions(sound: Log) -> None:
    log = sound.noisy(0, 0.003)
    cloe = didim.CLOE(optimizer="levenberg-marquardt", start="idim-ls")
    fit = identify(log, cloe)
    assert next(use.name for use in fit.verdict.uses) == "simulation"
    tau = tau_of(log)
    t = np.arange(len(tau))[:, None] / log.recordings[0].rate_hz
    wave = 0.15 * np.std(tau, axis=0) * np.sqrt(2.0) * np.sin(2.0 * np.pi * 3.1 * t)
    assert "size" in codes(identify(with_torques(log, tau + wave), cloe))


def test_the_larger_part_of_an_expected_error_is_named() -> None:
    assert combined(3.0, 4.0, "as on blocks") == (5.0, "mostly from the uncertainty of the parameters")
    assert combined(4.0, 3.0, "as on blocks") == (5.0, "as on blocks")


def test_an_estimated_velocity_hides_no_missing_friction() -> None:
    """Laws that a file gives were not chosen for the log: load friction of joint 2 is missing, whatever is known of joint 1."""
    known = FrictionTerm(law="atan", joint=0, velocity=0.3)
    truth = arm_with(known, FrictionTerm(law="load", joint=1))
    noisy = friction_log(truth, parameters(truth, Fa1=1.5, Fl2=0.3), noise=0.1)
    for term in (known, replace(known, estimated=True)):
        fit = didim.identify(replace(noisy, robot=arm_with(term)))
        (found,) = [reason for reason in fit.verdict.grave if reason.code == "friction"]
        assert found.joints == (2,)


def test_the_error_promised_among_robots_is_that_of_blocks_left_out_under_their_conditions(
    tmp_path: Path,
) -> None:
    log = friction_logs.logged(
        friction_logs.robot("ur5e-like"), friction_logs.coulomb, 4001, of="ur5e-like", noise="correlated"
    )
    plain, fit = (didim.identify(log, didim.IDIMLS(physical=asked)) for asked in (False, True))
    assert plain.uncertainty is not None
    assert fit.uncertainty is not None
    assert plain.uncertainty.unseen.size == 0
    growth = fit.uncertainty.unseen
    assert growth.shape == (6,)
    assert np.all(growth >= 1.0)
    control = fit.verdict.uses[2]
    assert control.error is not None
    assert fit.overall_relative_error < control.error <= 1.02 * growth.max() * fit.overall_relative_error
    fit.save(tmp_path / "fit.json")
    again = didim.Identification.load(tmp_path / "fit.json")
    assert again.uncertainty is not None
    np.testing.assert_array_equal(again.uncertainty.unseen, growth)


@pytest.mark.parametrize("physical", [False, True])
def test_a_turned_torque_drives_a_robot_to_its_bounds_and_is_named(physical: bool) -> None:
    """The curvature of the constraints is 1e15 there, and differences of it were negative."""
    log = friction_logs.logged(friction_logs.robot(), friction_logs.stribeck(0.3), 1001)
    tau = tau_of(log) * [1.0, -1.0]
    fit = identify(with_torques(log, tau), IDIMLS(physical=physical))
    assert (fit.verdict.state, fit.verdict.grave[0].code) == ("wrong", "torque-sign")
    assert np.isfinite(fit.std).all()
