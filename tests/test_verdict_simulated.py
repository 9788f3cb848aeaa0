"""The simulated robot beside the measured one, and errors on held-out recordings, as evidence of the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import didim
from arm import arm_log
from didim.evidence.loop.simulated import MotionComparison, compare_motions, motion_findings, slope_findings
from didim.experiment.loop import closed_loop
from didim.methods.idim_ls import IDIMLS
from didim.methods.measured import least_errors
from verdict_arms import ARMS, Fault, Log, _controller, _stiffer, built, faults, planted


@pytest.fixture(scope="module")
def sound() -> Log:
    return built(ARMS["gantry"], None)


def found_in(experiment: didim.Experiment, method: didim.DIDIM | didim.CLOE) -> set[str]:
    return {reason.code for reason in didim.identify(experiment, method).verdict.grave}


def cloe() -> didim.CLOE:
    return didim.CLOE(optimizer="levenberg-marquardt", start="idim-ls")


def test_a_right_loop_moves_as_measured_with_a_slope_of_one(sound: Log) -> None:
    experiment = sound.noisy(1, 0.01)
    fit = didim.identify(experiment, didim.DIDIM())
    found = MotionComparison.of_record(fit.settings["simulated"])
    assert found.position.max() < 1e-3
    np.testing.assert_allclose(found.slope, 1.0, atol=0.002)
    np.testing.assert_allclose(found.error, least_errors(IDIMLS().job(experiment)), rtol=0.1)
    # By hand: torques of twice the size have half the slope, and positions that stand still are missed wholly.
    (recording,) = experiment.recordings
    assert recording.tau is not None
    still = np.tile(recording.q.mean(axis=0), (len(recording.q), 1))
    other = compare_motions(experiment.signal, [(recording.q, still, recording.tau, 2.0 * recording.tau)])
    np.testing.assert_allclose(other.position, 1.0)
    np.testing.assert_allclose(other.slope, 0.5)
    np.testing.assert_allclose(other.error, other.torque)


@pytest.mark.slow
def test_cloe_with_gains_one_percent_low_is_doubted_by_the_slope(sound: Log) -> None:
    """Every parameter of such a fit is 1 % off, and the fit converges."""
    one = Fault("kp and kv 1 % low", ("torque-slope",), plant=_controller(_both(0.99)))
    experiment = planted(sound, one, 0, 0.003)
    fit = didim.identify(experiment, cloe())
    assert fit.converged
    (reason,) = [item for item in fit.verdict.grave if item.code == "torque-slope"]
    assert reason.joints == (1, 2, 3, 4, 5)
    assert reason.value == pytest.approx(1.01, abs=0.002)
    assert found_in(sound.noisy(0, 0.003), cloe()) == set()


def pushed(name: str, torques: bool) -> didim.Experiment:
    """A log of a planar arm on which something acts that no model has; with measured torques or from positions alone."""
    log = arm_log(1)
    (recording,) = log.recordings
    loop = closed_loop(log, recording)
    q, dq, _ = loop.reference.at(recording.t)
    x, t = log.robot.parameter_set("reference"), recording.t / recording.t[-1]
    coulomb = np.array([x[log.robot.parameter_names.index(f"Fc{j}")] for j in (1, 2)])
    assert recording.tau is not None
    size, sign = np.std(recording.tau, axis=0), np.tanh(dq / 0.02)
    push = {
        "nothing": 0.0 * q,
        "asymmetric friction": -0.4 * coulomb * np.abs(sign) - 0.2 * np.maximum(dq, 0.0),
        "Stribeck friction": -0.5 * coulomb * sign * np.exp(-((dq / 0.3) ** 2)),
        "a spring": -0.15 * size / np.std(q, axis=0) * q,
        "drifting friction": 0.5 * coulomb * sign * t[:, None],
        "a contact": -0.5 * size * ((t > 0.4) & (t < 0.55))[:, None],
    }[name]
    (moved, _, _, tau), _ = closed_loop(log, replace(recording, external=push)).run(x[None])
    rng = np.random.default_rng(0)
    noisy_tau = tau[0] + 0.01 * size * rng.standard_normal(q.shape)
    seen = replace(
        recording, q=moved[0] + 2e-6 * rng.standard_normal(q.shape), tau=noisy_tau if torques else None
    )
    return replace(log, recordings=(seen,))


@pytest.mark.parametrize("torques", [True, False], ids=["torques", "positions alone"])
@pytest.mark.parametrize(
    ("name", "codes"),
    [
        ("nothing", set()),
        ("asymmetric friction", {"not-white"}),
        ("Stribeck friction", {"friction"}),
        ("a spring", {"not-white"}),
        ("drifting friction", {"not-white"}),
        ("a contact", {"size", "not-white"}),
    ],
)
def test_cloe_sees_what_its_positions_miss_as_torques(name: str, codes: set[str], torques: bool) -> None:
    """The declared law makes a torque of each position that is missed, with a torque in the log and without."""
    log = pushed(name, torques)
    x = log.robot.parameter_set("reference")
    verdict = didim.identify(log, didim.CLOE(start=x, max_iterations=20)).verdict
    found = {reason.code for reason in verdict.grave}
    assert codes.issubset(found)
    assert verdict.sound == (name == "nothing")
    assert {use.name for use in verdict.uses} == {"simulation", "gravity compensation", "control", "payload"}


def _both(share: float):  # type: ignore[no-untyped-def]
    def change(controller: didim.Controller) -> didim.Controller:
        laws = controller.laws.copy()
        laws[:, :2] *= share
        return replace(controller, laws=laws)

    return change


@pytest.mark.slow
def test_didim_with_a_wrong_loop_is_compared_with_idim_ls(sound: Log) -> None:
    assert "worse-than-idim-ls" in found_in(
        planted(sound, Fault("kp", (), plant=_controller(_stiffer(0.64))), 0), didim.DIDIM()
    )
    (late,) = [fault for fault in faults(ARMS["gantry"]) if fault.name == "reference 20 ms late"]
    assert {"simulated-motion", "worse-than-idim-ls"} <= found_in(planted(sound, late, 0), didim.DIDIM())


def test_thresholds() -> None:
    one = np.ones(2)
    found = MotionComparison(np.array([0.004, 0.2]), np.array([1.004, 1.1]), np.array([1e-5, 0.01]), one, one)
    experiment = didim.packaged_experiment("tx40")
    (moved,) = motion_findings(experiment, found)
    assert moved.joints == (2,)
    assert moved.grade == "wrong"
    (slope,) = slope_findings(found)
    assert slope.joints == (2,)
    assert slope_findings(replace(found, sigma=np.array([1e-5, 0.02]))) == []


def test_a_held_out_log_that_differs_is_named(sound: Log) -> None:
    experiment = sound.noisy(3, 0.01)
    (recording,) = experiment.recordings
    (other,) = sound.noisy(4, 0.01).recordings
    kept = replace(other, name="kept out", role="held-out")
    fit = didim.identify(replace(experiment, recordings=(recording, kept)))
    assert fit.verdict.sound
    (item,) = fit.held_out
    assert fit.uncertainty is not None
    np.testing.assert_allclose(item.error_rms, fit.uncertainty.joint_std, rtol=0.15)
    assert kept.tau is not None
    heavier = replace(kept, tau=kept.tau * np.array([1.0, 1.0, 1.1, 1.0, 1.0]))
    fit = didim.identify(replace(experiment, recordings=(recording, heavier)))
    (reason,) = fit.verdict.grave
    assert (reason.code, reason.joints) == ("held-out", (3,))
    assert "'kept out'" in reason.sentence
