"""Friction that the model lacks: false alarms on right models, alarms on missing laws, and the intervals after them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.regression.friction.alarm import (
    LEVEL,
    FrictionAlarm,
    _Whitening,
    autoregression,
    bounded,
    joint_test,
)
from didim.result.identification import Identification
from didim.robot.friction import FrictionTerm
from didim.terms.rows import LinearSystem, stacked
from friction_logs import Law, atan, coulomb, dahl, fitted, load, logged, robot, stribeck, truth
from scripts import script
from verdict_arms import ARMS, INDEPENDENT, built


def alarm(fit: Identification) -> FrictionAlarm:
    assert fit.uncertainty is not None
    assert fit.uncertainty.friction is not None
    return fit.uncertainty.friction


@pytest.mark.parametrize(
    "settings",
    [{}, {"noise": "correlated"}, {"rate_hz": 100.0}, {"counts": 65536}, {"counts": 4096}],
    ids=["white", "correlated", "100 Hz", "2^16 counts", "4096 counts"],
)
def test_right_models_raise_no_alarm(settings: dict[str, object]) -> None:
    for seed in range(4):
        found = alarm(fitted(coulomb, 500 + seed, **settings))
        assert not found.raised, found.p_value
        assert not found.shift.any()
        assert found.law == ""


@pytest.mark.parametrize("name", ["ur5e-like", "arm7", "iiwa14-like"])
def test_errors_of_sampling_at_a_low_rate_are_no_friction(name: str) -> None:
    """With a noise of 0.3 % of the torque, central differences and held torques are the largest errors at 100 Hz."""
    log = built({**ARMS, **INDEPENDENT}[name], None, rate_hz=100.0).noisy(0, 0.003)
    found = alarm(didim.identify(log, didim.IDIMLS()))
    assert not found.raised, found.p_value


@pytest.mark.parametrize(
    ("law", "names"),
    [
        (stribeck(0.2), {"stribeck", "atan"}),
        (atan(0.4), {"atan", "stribeck"}),
        (load(0.08), {"load"}),
        (dahl(0.02), {"dahl"}),
    ],
    ids=["stribeck", "atan", "load", "dahl"],
)
def test_a_missing_law_is_seen_and_its_shift_is_in_the_intervals(law: Law, names: set[str]) -> None:
    inside, before = [], []
    for seed in range(3):
        fit = fitted(law, 500 + seed)
        found = alarm(fit)
        assert found.raised, found.p_value
        assert found.law in names
        assert {law.law for law in found.missing} <= names
        error = np.abs(fit.beta - truth())
        assert fit.uncertainty is not None
        factor = fit.uncertainty.factor(0.95)
        inside.append(error <= factor * fit.std)
        before.append(error <= factor * fit.uncertainty.noise)
    assert np.mean(inside) >= 0.9
    assert np.mean(before) < np.mean(inside)


@pytest.mark.parametrize("motion", range(4))
def test_a_law_is_seen_under_noise_that_lasts(motion: int) -> None:
    """Its slow waves hide a Stribeck term of 0.2 Fc from the plain scores of half of the logs."""
    assert alarm(fitted(stribeck(0.2), 5000 + motion, draw=motion, noise="correlated")).raised


def test_memory_alone_is_enough_for_an_alarm_of_seven_joints() -> None:
    """Probabilities are times seven, by two tests, and memory has a quarter of the level: the patterns are as many more."""
    rng = np.random.default_rng(3)
    blocks = [np.arange(k, k + 10) for k in range(0, 200, 10)]
    column = rng.standard_normal(200)
    memory = np.ones(1, dtype=bool)
    probability, _ = joint_test(column[:, None], column, (blocks, blocks), memory, 2)
    assert 7.0 * probability[0] < LEVEL


def test_an_autoregression_whitens_what_it_made() -> None:
    rng = np.random.default_rng(1)
    white = rng.standard_normal(8000)
    made = np.zeros(8000)
    for k in range(2, 8000):
        made[k] = 1.2 * made[k - 1] - 0.5 * made[k - 2] + white[k]
    law = autoregression([made[:3000], made[3000:]], 0.3)
    assert len(autoregression([made], 0.8)) == 0  # no more than a filter makes
    np.testing.assert_allclose(law, [1.2, -0.5], atol=0.03)
    assert len(autoregression([white])) == 0
    assert len(autoregression([np.zeros(5)])) == 0
    system = LinearSystem(w=made[:, None], y=made, blocks=stacked(1, [3000, 5000]), names=("a",))
    rest = _Whitening.of(system, made).rows(made)
    # The first rows of each window have none before them.
    assert not rest[[0, 1, 3000, 3001]].any()
    np.testing.assert_allclose(rest[2:3000], white[2:3000], atol=0.3)


def test_intervals_hold_with_every_bias_up_to_a_bound() -> None:
    rng = np.random.default_rng(5)
    noise = rng.standard_normal(400_000)
    for bias in (0.0, 0.3, 1.0, 2.5, 9.0):
        half = 1.96 * float(bounded(np.array([1.0]), np.array([bias]))[0])
        assert np.mean(np.abs(noise + bias) <= half) == pytest.approx(0.95, abs=0.002)
        assert np.mean(np.abs(noise + 0.5 * bias) <= half) >= 0.948
    scaled = bounded(np.array([2.0, 0.0]), np.array([-1.0, 3.0]))
    np.testing.assert_allclose(scaled[0], 2.0 * bounded(np.array([1.0]), np.array([0.5]))[0], rtol=1e-12)
    assert scaled[1] == 0.0  # without a deviation nothing is known


def test_a_coarse_encoder_is_not_tested_for_memory() -> None:
    assert "dahl" in alarm(fitted(coulomb, 500, counts=65536)).tested
    assert "dahl" not in alarm(fitted(coulomb, 500, counts=4096)).tested


def test_what_the_log_would_show_is_said_in_torque() -> None:
    """A law of the visible amplitude raises the alarm, one of a thirtieth does not."""
    right = alarm(fitted(coulomb, 501))
    fc = np.array(
        [robot().parameter_set("reference")[robot().parameter_names.index(f"Fc{j}")] for j in (1, 2)]
    )
    share = float((right.visible["stribeck"] / fc).min())
    assert alarm(fitted(stribeck(share, 0.2), 501)).raised
    assert not alarm(fitted(stribeck(share / 30.0, 0.2), 501)).raised


@pytest.mark.parametrize("law", ["stribeck", "atan"])
def test_curves_of_speed_are_tested_beside_a_law_of_speed(law: str) -> None:
    """The model's own law leaves nothing to see; a second bend at another velocity does."""
    velocity, right = {"stribeck": (0.15, stribeck(0.2)), "atan": (0.3, atan(0.4))}[law]
    terms = tuple(didim.FrictionTerm(law=law, joint=joint, velocity=velocity) for joint in (0, 1))  # type: ignore[arg-type]
    arm = robot().with_terms(terms)
    bent = stribeck(0.3, 0.6)
    for seed in range(3):
        known = alarm(didim.identify(logged(arm, right, 500 + seed), didim.IDIMLS()))
        assert not known.raised
        assert set(known.tested) == {"stribeck", "atan", "load", "dahl"}
        log = logged(arm, lambda *motion: right(*motion) + bent(*motion), 500 + seed)
        assert alarm(didim.identify(log, didim.IDIMLS())).raised


def test_a_velocity_that_is_fitted_leaves_no_second_law_of_its_kind() -> None:
    """A law with another velocity is nearly its own change with the velocity, so its amount would be arbitrary."""
    terms = [
        didim.FrictionTerm(law="stribeck", joint=joint, velocity=0.15, estimated=True) for joint in (0, 1)
    ]
    right, bent = stribeck(0.2), stribeck(0.3, 0.6)
    log = logged(robot().with_terms(terms), lambda *motion: right(*motion) + bent(*motion), 500)
    fit = didim.identify(log, didim.IDIMLS())
    found = alarm(fit)
    assert found.raised
    assert {law.law for law in found.missing} == {"atan"}
    assert fit.uncertainty is not None
    shift = found.shift[: fit.beta.size]
    assert np.all(shift < 30.0 * fit.uncertainty.without_shift(fit.std)), shift


LOADED = [didim.FrictionTerm(law="load", joint=joint) for joint in (0, 1)]
"""Laws that a file may have beside the one that its log lacks."""


def test_a_further_law_is_tried_on_blocks_left_out_before_it_is_missed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    right, more = load(0.08), stribeck(0.3)
    log = logged(robot().with_terms(LOADED), lambda *motion: right(*motion) + more(*motion), 500)
    fit = didim.identify(log, didim.IDIMLS())
    (found,) = (reason for reason in fit.verdict.reasons if reason.code == "friction")
    assert (found.grade, found.joints) == ("doubtful", (1, 2))
    assert found.advice == "Add joints 1 and 2 to stribeck under [friction]: blocks left out support it"
    assert found.remedy is not None
    assert (found.remedy.key, found.remedy.action, found.remedy.joints) == ("stribeck", "add", (1, 2))
    terms = [
        didim.FrictionTerm(law="stribeck", joint=joint, velocity=0.1, estimated=True) for joint in (0, 1)
    ]
    done = didim.identify(replace(log, robot=robot().with_terms([*LOADED, *terms])), didim.IDIMLS())
    assert not any(reason.code == "friction" for reason in done.verdict.reasons)
    # What blocks do not support is a note, and stays in the intervals.
    monkeypatch.setattr("didim.evidence.judge.further_laws", lambda *given: {})
    refused = didim.identify(log, didim.IDIMLS())
    (note,) = (reason for reason in refused.evidence if reason.code == "friction")
    assert (note.grade, note.remedy) == ("note", None)
    assert "blocks left out support no further law; intervals include it" in note.sentence
    np.testing.assert_array_equal(refused.std, fit.std)


def test_joints_that_lack_friction_of_each_direction_and_another_law_are_named_apart() -> None:
    """Viscous friction differs by direction at both joints, and one lacks Stribeck's law: blocks support forward friction too."""
    right, more = load(0.08), stribeck(0.05)

    def law(*motion: np.ndarray) -> np.ndarray:
        falling = more(*motion) * [1.0, 0.0]
        return np.asarray(right(*motion) + 0.5 * motion[3] * np.maximum(motion[1], 0.0) + falling)

    fit = didim.identify(logged(robot().with_terms(LOADED), law, 500), didim.IDIMLS())
    (found,) = (reason for reason in fit.verdict.reasons if reason.code == "friction")
    assert "asymmetric" in found.facts["laws"]
    assert "friction of each direction at joint" in found.sentence
    assert found.advice.startswith(
        "Add joints 1 and 2 to forward_viscous, joint 1 to stribeck under [friction]"
    )


def test_load_friction_of_the_model_is_not_tested_again() -> None:
    arm = robot().with_terms([didim.FrictionTerm(law="load", joint=joint) for joint in (0, 1)])
    found = alarm(didim.identify(logged(arm, load(0.08), 500), didim.IDIMLS()))
    assert set(found.tested) == {"stribeck", "atan", "dahl"}
    assert not found.raised


def test_the_alarm_is_saved_with_the_result(tmp_path: Path) -> None:
    fit = fitted(stribeck(0.2), 500)
    fit.save(tmp_path / "fit.json")
    restored = Identification.load(tmp_path / "fit.json")
    assert np.array_equal(alarm(restored).p_value, alarm(fit).p_value)
    assert np.array_equal(alarm(restored).shift, alarm(fit).shift)
    assert alarm(restored).law == alarm(fit).law
    assert "Stribeck friction explains the residual of joint" in str(fit)
    assert f"{max(alarm(fit).joints) + 1} (p = " in str(fit)  # joints are printed from 1


def test_laws_that_a_choice_leaves_open_are_in_the_intervals() -> None:
    """The shift is that of fits without a doubtful term, and with the rival of an arctangent."""
    arm = robot()
    terms = [
        FrictionTerm(law="atan", joint=0, velocity=0.2, rival=0.3),
        FrictionTerm(law="load", joint=1, doubtful=True),
    ]
    law = atan(0.1, 0.2)  # small: refits with other laws weigh the joints nearly alike
    log = logged(arm, lambda *motion: np.asarray(law(*motion) * [1.0, 0.0]), 501)
    log = replace(log, robot=arm.with_terms(terms))
    fit = didim.identify(log, didim.IDIMLS())
    shift = alarm(fit).shift
    assert not alarm(fit).raised

    def without(*others: FrictionTerm) -> dict[str, float]:
        other = didim.identify(replace(log, robot=arm.with_terms(others)), didim.IDIMLS())
        return dict(zip(other.names, other.beta, strict=True))

    plain = replace(terms[0], rival=0.0)
    rival = FrictionTerm(law="stribeck", joint=0, velocity=0.3)
    fits = [without(plain), without(rival, terms[1])]
    for name, value, moved, white in zip(fit.names, fit.beta, shift, fit.std_white, strict=True):
        first, second = (one[name] - value if name in one else 0.0 for one in fits)
        expected = np.hypot(first, second)
        # The refits weigh joints by their own residuals.
        assert moved == pytest.approx(expected, rel=0.01, abs=0.05 * white), name
    assert fit.uncertainty is not None
    np.testing.assert_allclose(fit.std, bounded(fit.uncertainty.noise, shift), rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_noise_of_positions_is_no_friction(project: Path, seed: int) -> None:
    """The dual arm of docs/mechanisms.md: noise of 1e-5 rad at 500 Hz is in the residual and in the errors of sampling."""
    bench = script(project / "benches" / "calibration_of_trees.py")
    clean, _ = bench.dual_arm()
    fit = didim.identify(bench.measured(clean, seed), didim.IDIMLS())
    assert fit.uncertainty is not None
    assert fit.uncertainty.friction is not None
    assert not fit.uncertainty.friction.raised
