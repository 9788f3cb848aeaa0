"""Faults planted in logs of two arms are named by the verdict; `benches/verdicts.py` has all of them, over many seeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import didim
from didim.evidence.loop.law import loop_findings, recovered
from didim.experiment.experiment import Experiment
from didim.result.verdict import State
from verdict_arms import ARMS, INDEPENDENT, Log, built, expected_error, faults, obeyed, planted
from verdict_arms import experiment as experiment_of

QUICK = {
    # Errors of the other joints all vanish where its gain is far too small, as they do at the true one.
    "arm7": ("torque 6 x 2.0",),
    "gantry": (
        "gravity (0.0, 0.0, -9.81)",
        "other DH convention",
        "a length 20 % off",
        "torque 3 x 1.25",
        "sign of torque 5",
        "Stribeck friction",
        "asymmetric friction",
        "torque one sample late",
        "AR(1) 0.95 noise",
    ),
}


@pytest.fixture(scope="module")
def sound() -> dict[str, Log]:
    return {name: built(arm, None) for name, arm in ARMS.items()}


@pytest.mark.parametrize("name", ARMS)
def test_correct_logs_are_sound(sound: dict[str, Log], name: str) -> None:
    for level in (0.003, 0.03):
        verdict = didim.identify(sound[name].noisy(5, level)).verdict
        assert verdict.sound, str(verdict)


@pytest.mark.parametrize(
    ("name", "title"), [(name, title) for name, titles in QUICK.items() for title in titles]
)
def test_a_fault_is_named(sound: dict[str, Log], name: str, title: str) -> None:
    arm = ARMS[name]
    (fault,) = [item for item in faults(arm) if item.name == title]
    log = sound[name] if fault.truth is None else built(arm, fault)
    wrong = planted(log, fault, 1)
    fit = didim.identify(wrong)
    verdict = fit.verdict
    # Noise that lasts spoils no interval of the jackknife: it may be a note.
    assert not verdict.sound or fault.codes == ("not-white",)
    named = [reason for reason in verdict.reasons if reason.code in fault.codes]
    assert named, str(verdict)
    if fault.joints:
        assert named[0].joints == fault.joints
    if named[0].remedy is None:
        return
    # The edit makes the model better, and its finding is gone.
    edited = obeyed(wrong, didim.IDIMLS(), named[0].remedy)
    assert edited is not None
    after = didim.identify(*edited)
    assert expected_error(after) < expected_error(fit)
    assert not {reason.code for reason in after.verdict.grave} & set(fault.codes)


def test_a_delay_is_found_though_nothing_else_is_suspicious() -> None:
    """The test for missing friction leaves errors of time aside, so the delay is looked for without its alarm."""
    arm = INDEPENDENT["ur5e-like"]
    (fault,) = [item for item in faults(arm) if item.name == "torque one sample late"]
    (reason,) = didim.identify(planted(built(arm, fault, motion=500), fault, 500)).verdict.grave
    assert reason.code == "delay"


LOOPS = [fault.name for fault in faults(ARMS["gantry"]) if fault.method == "didim"]


@pytest.mark.parametrize("title", LOOPS)
def test_a_wrong_closed_loop_is_named(sound: dict[str, Log], title: str) -> None:
    arm = ARMS["gantry"]
    (fault,) = [item for item in faults(arm) if item.name == title]
    log = sound["gantry"] if fault.truth is None else built(arm, fault)
    experiment = planted(log, fault, 1)
    (reason,) = loop_findings(experiment, arm.truth(experiment.robot))
    assert reason.code in fault.codes, str(reason)
    assert reason.grade == "wrong"


@pytest.mark.slow
def test_a_torque_fed_forward_is_that_of_the_measured_motion() -> None:
    """The parameters of DIDIM under the wrong law explain it worse than gains ten times too high do."""
    arm = INDEPENDENT["tx40-like"]
    (fault,) = [item for item in faults(arm) if item.name == "missing feed-forward"]
    fit = didim.identify(planted(built(arm, fault, motion=500), fault, 500), didim.DIDIM())
    assert fit.verdict.grave[0].code == "feed-forward"


def test_a_right_closed_loop_is_recovered(sound: dict[str, Log]) -> None:
    for log in sound.values():
        experiment = log.noisy(2, 0.02)
        found = recovered(experiment)
        assert found is not None
        assert found.names == ("kp", "kv")
        np.testing.assert_allclose(found.factors, 1.0, atol=0.02)
        assert (found.relative < 0.02).all()
        assert loop_findings(experiment) == []


def test_a_wrong_gain_makes_a_converged_result_wrong(sound: dict[str, Log]) -> None:
    (fault,) = [item for item in faults(ARMS["gantry"]) if item.name == "kp 10 % off"]
    fit = didim.identify(planted(sound["gantry"], fault, 0), didim.DIDIM())
    assert fit.converged
    assert fit.verdict.state is State.WRONG
    assert fit.verdict.reasons[0].code == "controller-gain"
    assert fit.verdict.reasons[0].joints == (1, 2, 3, 4, 5)


def test_gains_of_a_cascade_have_the_names_of_its_file() -> None:
    """A wrong kv changes all three terms of the law, kp kv, kv and kv/Ti, and one key of the file."""
    arm = ARMS["gantry"]
    settings = experiment_of(arm)
    assert isinstance(settings.controller, didim.Controller)
    kp, kv = settings.controller.laws[:, 0], settings.controller.laws[:, 1]

    def cascade(gains: np.ndarray) -> didim.Controller:
        return didim.Controller.cascade(kp / kv, gains, integral_time_s=0.5, reference_velocity=1.0)

    true = cascade(kv)
    log = Log.of(arm, replace(settings, controller=true)).noisy(1, 0.003)
    wrong = replace(log, controller=cascade(0.8 * kv))
    found = recovered(wrong)
    assert found is not None
    names, factors, _ = found.keys()
    assert names == ("kp", "kv", "integral_time_s")
    np.testing.assert_allclose(factors[:2].T, [[1.0, 1.25]] * 5, atol=0.03)
    (reason,) = loop_findings(wrong)
    assert reason.code == "controller-gain"
    assert "kv of joints 1, 2, 3, 4 and 5 is 1.2" in reason.sentence
    assert "kp of" not in reason.sentence


def with_lasting_noise(experiment: Experiment, share: float) -> Experiment:
    """The log with noise of its torques that lasts 66 ms, as real torques have it."""
    (recording,) = experiment.recordings
    assert recording.tau is not None
    memory = np.exp(-1.0 / (0.066 * recording.rate_hz))
    white = np.random.default_rng(5).standard_normal(recording.tau.shape)
    lasting = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], white, axis=0)
    tau = recording.tau + share * np.std(recording.tau, axis=0) * lasting
    return replace(experiment, recordings=(replace(recording, tau=tau),))


def test_lasting_noise_of_the_torques_is_not_another_controller(sound: dict[str, Log]) -> None:
    """It is beyond white noise and beyond the floor of 3 %, and no signal of the loop explains it on blocks left out."""
    for log in sound.values():
        experiment = with_lasting_noise(log.noisy(2, 1e-3), 0.05)
        found = recovered(experiment)
        assert found is not None
        assert (found.relative > 0.04).any()
        assert loop_findings(experiment) == []


def test_a_fault_is_seen_without_noise_of_the_positions(sound: dict[str, Log]) -> None:
    """Then signals of the loop hardly differ, and directions that are rounding of the others explain nothing."""
    experiment = sound["gantry"].noisy(2, 1e-6)
    (recording,) = experiment.recordings
    assert recording.tau is not None
    added = 0.2 * np.std(recording.tau, axis=0) * np.sin(recording.q)
    wrong = replace(experiment, recordings=(replace(recording, tau=recording.tau + added),))
    (reason,) = loop_findings(with_lasting_noise(wrong, 0.03))
    assert reason.code == "controller"
    # The joint that is named is one of those that are accused.
    assert reason.facts["joint"] in reason.joints


@pytest.mark.parametrize("of", ["gravity", "torque", "dead band"])
def test_what_a_controller_adds_is_seen_under_lasting_noise(sound: dict[str, Log], of: str) -> None:
    """A torque that compensates gravity, a gain that grows with the torque, and a drive that gives no small torques."""
    experiment = sound["gantry"].noisy(2, 1e-3)
    (recording,) = experiment.recordings
    assert recording.tau is not None
    tau, size = recording.tau, np.std(recording.tau, axis=0)
    added = {
        "gravity": 0.2 * size * np.sin(recording.q),
        "torque": 0.15 * tau * np.abs(tau) / size,
        "dead band": -np.clip(tau, -0.15 * size, 0.15 * size),
    }
    wrong = replace(experiment, recordings=(replace(recording, tau=tau + added[of]),))
    (reason,) = loop_findings(with_lasting_noise(wrong, 0.05))
    assert reason.code in ("controller", "controller-gain", "feed-forward")


def test_white_noise_of_the_torques_is_not_another_controller(sound: dict[str, Log]) -> None:
    """Decimated, the noise is a few percent of the torque: the law is the declared one."""
    experiment = sound["gantry"].noisy(2, 0.3)
    found = recovered(experiment)
    assert found is not None
    assert (found.relative > 0.04).any()
    np.testing.assert_allclose(found.rows.noise, found.relative, rtol=0.3)
    assert loop_findings(experiment) == []
