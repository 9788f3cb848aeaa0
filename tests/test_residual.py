"""`didim residual`: torques from outside, the momentum observer, contacts and changes of the payload."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from arm import arm_file
from didim import Experiment
from didim.cli.main import main
from didim.errors import ExperimentError, FitError
from didim.robot.payload import Payload, flange_in_last_frame, last_link
from didim.studies.loads.detection import contacts, payload_change, shortest_s
from didim.studies.loads.observer import low_pass, observe
from didim.studies.loads.payload import identify_payload
from didim.studies.loads.residual import residual_torques
from several import arm_logs
from test_payload import LOAD, loaded, tx40_log

pytestmark = pytest.mark.usefixtures("without_verdict")

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def known() -> didim.Identification:
    robot = didim.load_robot("tx40")
    return didim.identify(tx40_log(robot.parameter_set("didim"), 1), didim.IDIMLS())


def clean(seed: int) -> Experiment:
    return tx40_log(didim.load_robot("tx40").parameter_set("didim"), seed)


def pushed(log: Experiment, start_s: float, stop_s: float, joint: int, torque: float) -> Experiment:
    (item,) = log.recordings
    assert item.tau is not None
    tau = item.tau.copy()
    # The motor gives less where the environment pushes forward.
    tau[(item.t >= start_s) & (item.t < stop_s), joint] -= torque
    return replace(log, recordings=(replace(item, tau=tau),))


def test_without_noise_the_observer_sees_a_low_pass_of_the_push() -> None:
    robot = didim.load_robot("tx40").with_smoothing([0.05] * 6)
    x = robot.parameter_set("didim")
    reference = didim.Reference.random_fourier(
        harmonics=5, period_s=4.0, max_position=[1.0] * 6, max_velocity=[2.0] * 6, max_acceleration=[9.0] * 6, seed=2
    )  # fmt: skip
    rate = 1000.0
    t = np.arange(0.0, 4.0, 1.0 / rate)
    q, dq, ddq = reference.at(t)
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    quiet = observe(robot, x, q, tau, rate).torque
    assert (np.abs(quiet[200:]).max(axis=0) < 0.02 * np.abs(tau).max(axis=0)).all()
    step = tau.copy()
    step[2000:, 2] -= 5.0
    seen = observe(robot, x, q, step, rate).torque - quiet
    np.testing.assert_allclose(seen[2500:, 2], 5.0, rtol=1e-6)
    constant = 1.0 / (2.0 * np.pi * 8.0)
    after = 2000 + round(rate * (constant + 1.4 / (2.0 * np.pi * 100.0)))
    assert seen[after, 2] == pytest.approx(5.0 * (1.0 - np.exp(-1.0)), rel=0.05)
    assert np.abs(np.delete(seen, 2, axis=1)).max() < 1e-9


def test_clean_logs_are_quiet_and_a_push_is_reported_within_50_ms(known: didim.Identification) -> None:
    for seed in (5, 6):
        found = residual_torques(known, clean(seed))
        assert found.quiet
        assert "no external torque" in str(found)
        (window,) = found.windows
        low, high = window.interval()
        assert 0.90 < np.mean((low <= 0.0) & (high >= 0.0)) < 0.99
    found = residual_torques(known, pushed(clean(5), 3.0, 3.4, 2, 5.0))
    (contact,) = found.windows[0].contacts
    assert 0.0 <= contact.start_s - 3.0 < 0.05
    assert abs(contact.stop_s - 3.4) < 0.08
    assert contact.joints[0] == 3
    assert contact.peak[0] == pytest.approx(5.0, abs=1.0)
    assert found.windows[0].payload_change is None
    assert "external torque from 3.0" in str(found)


def with_rounded_stamps(log: Experiment, step_s: float) -> Experiment:
    """The log as sampled at other times than its stamps say: these are those times, rounded."""
    (item,) = log.recordings
    t = item.t + np.random.default_rng(0).uniform(-0.5 * step_s, 0.5 * step_s, item.t.size)
    q = np.column_stack([np.interp(t, item.t, column) for column in item.q.T])
    return replace(log, recordings=(replace(item, q=q),))


def test_rounded_time_stamps_are_no_contacts(known: didim.Identification) -> None:
    log = with_rounded_stamps(clean(5), 0.002)
    (window,) = residual_torques(known, log).windows
    assert not window.contacts
    # Without the errors of the stamps the limits were left, by the joints that carry the arm.
    (sound,) = residual_torques(known, clean(5)).windows
    assert (np.abs(window.observed) > sound.limits).any()
    # A push while the arm is fast must be as large as these errors.
    assert residual_torques(known, pushed(log, 3.0, 3.4, 5, 5.0)).windows[0].contacts


@pytest.mark.slow
def test_nothing_touches_a_measured_ur10e(shared: Path) -> None:
    """Its stamps are rounded to 1 ms, 10 % of the velocity: the observer sees 30 N.m of joint 1 in that."""
    file = Path(__file__).resolve().parents[1] / "examples" / "ur10e_currents.toml"
    experiment = didim.load_experiment(file, data=shared / "data" / "ur10e")
    fit = didim.identify(experiment, didim.IDIMLS())
    assert residual_torques(fit, experiment).quiet


def test_a_payload_that_is_picked_up_is_told_from_a_contact(known: didim.Identification) -> None:
    free = clean(7)
    (one,), (two,) = free.recordings, loaded(7).recordings
    assert one.tau is not None
    assert two.tau is not None
    # The same motion and noise: only the torques differ.
    np.testing.assert_array_equal(one.q, two.q)
    picked = replace(one, tau=np.where((one.t < 4.0)[:, None], one.tau, two.tau))
    found = residual_torques(known, replace(free, recordings=(picked,)))
    change = found.windows[0].payload_change
    assert change is not None
    assert not change.whole
    assert abs(change.start_s - 4.0) < 0.2
    assert abs(change.change[9] - LOAD[9]) < 6.0 * change.std[9]
    assert "the payload differs from the model at 4" in str(found)
    whole = residual_torques(known, loaded(8)).windows[0].payload_change
    assert whole is not None
    assert whole.whole


@pytest.mark.slow
def test_the_payload_that_residual_reports_is_that_of_payload(known: didim.Identification) -> None:
    """Estimate and standard deviations are those of `didim payload`, for a whole log with a load that is not declared."""
    log = loaded(8)
    change = residual_torques(known, log).windows[0].payload_change
    assert change is not None
    found = identify_payload(known, log)
    np.testing.assert_allclose(change.std, found.std, rtol=1e-9)
    np.testing.assert_allclose(change.change, found.ten, rtol=1e-9, atol=1e-12)
    # A load that is declared is part of the model: a further one is the change.
    (item,) = log.recordings
    tool = Payload(
        name="tool",
        mass_kg=1.5,
        com_m=(0.03, -0.02, 0.11),
        inertia_kg_m2=(0.009, 0.0, 0.0, 0.0075, 0.0, 0.0045),
    )
    named = replace(log, recordings=(replace(item, payload="tool"),), payloads={"tool": tool})
    further = residual_torques(known, named).windows[0].payload_change
    assert further is not None
    assert abs(further.change[9] - 0.5) < 4.0 * further.std[9]
    assert further.std[9] == pytest.approx(found.std[9], rel=0.2)


def test_a_short_tip_of_a_residual_that_lasts_is_no_contact() -> None:
    """The shortest contact follows the correlation of the residual: a tip of 30 ms counts in white noise, not in a model error."""
    rate, n = 100.0, 6000
    t = np.arange(n) / rate
    noise = np.random.default_rng(0).standard_normal((n, 1))
    slow = low_pass(noise, rate, 0.5)
    for residual, expected in ((noise, 1), (slow, 0)):
        residual = residual / residual.std()
        limits = np.full((n, 1), 6.0)
        shortest = shortest_s(residual, limits, rate, 6.0)
        tip = residual.copy()
        tip[3000:3003] = 7.0
        assert len(contacts(t, tip, limits, shortest)) == expected
        # One that is far beyond its limit is a contact however short, and so is one that stays.
        tip[3000:3003] = 12.0
        assert len(contacts(t, tip, limits, shortest)) == 1
        tip[3000:3060] = 7.0
        assert len(contacts(t, tip, limits, shortest)) == 1
    # The correlation time of a first-order low-pass of 0.5 Hz is 2 / (2 pi 0.5 Hz).
    expected_s = np.sqrt(2.0 * np.pi) * 2.0 / np.pi / 6.0
    assert shortest_s(slow, np.full((n, 1), 6.0 * slow.std()), rate, 6.0)[0] == pytest.approx(
        expected_s, rel=0.35
    )


def test_a_residual_beside_which_no_load_is_seen_is_no_payload() -> None:
    t, residual = np.arange(100.0), np.full((100, 2), 1e300)
    columns = np.random.default_rng(0).normal(size=(100, 2, 3))
    assert payload_change(t, residual, columns, np.zeros(2), (0, 1, 2)) is None


def test_a_payload_that_is_known_is_part_of_the_model(known: didim.Identification) -> None:
    log = loaded(9)
    (item,) = log.recordings
    named = replace(log, recordings=(replace(item, payload="tool"),))
    tool = Payload(
        name="tool",
        mass_kg=2.0,
        com_m=(0.03, -0.02, 0.11),
        inertia_kg_m2=(0.012, 0.0, 0.0, 0.010, 0.0, 0.006),
    )
    robot = log.robot
    np.testing.assert_allclose(tool.split[0], LOAD, atol=1e-12)
    assert last_link(robot, flange_in_last_frame(robot)).shape[1] == 10
    assert residual_torques(known, replace(named, payloads={"tool": tool})).quiet
    with pytest.raises(FitError, match="payload 'tool' is not known"):
        residual_torques(known, replace(named, payloads={"tool": Payload(name="tool", mass_kg=2.0)}))


def test_a_delay_that_is_not_finite_is_one_sentence(known: didim.Identification) -> None:
    with pytest.raises(FitError, match="the delay of the result must be a finite number, got nan"):
        residual_torques(replace(known, delay={"compensated_samples": float("nan")}), clean(1))


def test_a_log_that_ends_before_the_observer_settles_is_one_sentence(known: didim.Identification) -> None:
    with pytest.raises(
        ExperimentError, match=r"an observer of 0\.01 Hz settles in \d+ s, and the recording has"
    ):
        residual_torques(known, clean(1), bandwidth_hz=0.01)


def test_the_command_prints_writes_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fit = didim.identify(arm_logs([False], noise=(0.3, 0.2)), didim.IDIMLS())
    fit.save(tmp_path / "fit.json")
    log = pushed(arm_logs([False], noise=(0.3, 0.2), seed=3), 2.0, 2.3, 1, 4.0)
    file = arm_file(log, tmp_path, tmp_path / "log.toml")
    found, rows, picture = (tmp_path / name for name in ("found.json", "rows.csv", "found.svg"))
    outputs = ["--json", str(found), "-o", str(rows), "--plot", str(picture)]
    assert main(["residual", str(tmp_path / "fit.json"), str(file), *outputs]) == 0
    assert "external torque from 2.0" in capsys.readouterr().out
    data = json.loads(found.read_text())
    assert not data["quiet"]
    (contact,) = data["windows"][0]["contacts"]
    assert contact["joints"][0] == 2
    assert rows.read_text().startswith("recording,t_s,external_1,external_2,std_1,std_2\n")
    assert "<svg" in picture.read_text()
    assert main(["residual", str(tmp_path / "fit.json"), str(file), "--threshold", "0"]) == 2
    assert "threshold" in capsys.readouterr().err
