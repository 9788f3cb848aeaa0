"""Joints that run into the ends of their ranges, and contacts: found in the log, left out, and reported."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.diagnosis.check import check
from didim.errors import FitError
from didim.methods.cloe.cloe import CLOE
from didim.methods.positions.problem import Problem
from didim.methods.positions.replay import position_errors, replayed
from didim.methods.positions.stops import STRONGEST, _held, pushed_stretches
from didim.studies.in_mujoco import validate_in_mujoco
from quadrupeds import ARM_DELAY_S, ARM_RATE, ARM_TRUTH, ENCODER, arm_text, followed, recorded

mujoco = pytest.importorskip("mujoco", reason="needs mujoco, the group 'test'")

EXPERIMENT = """
schema = 1
robot = "arm.xml"
[parameters]
links = "fixed"
[controller]
kind = "pd"
[reference]
kind = "recorded"
between_samples = "held"
[unknown]
delay_s = { max = 0.06 }
[[recording]]
name = "log"
rate_hz = 50
"""
EXPERIMENT += recorded("log.npz", "q", "r")
Push = Callable[[float, np.ndarray], list[float]]


def commands(shift: list[float], scale: float = 0.35, seconds: float = 12.0) -> np.ndarray:
    """Waves, and steps in half of the log, (n_samples, 4)."""
    rng = np.random.default_rng(0)
    t = np.arange(round(seconds * ARM_RATE)) / ARM_RATE
    waves = np.sin(2.0 * np.pi * np.outer(t, rng.uniform(0.2, 0.8, 4)) + rng.uniform(0.0, 6.0, 4))
    steps = np.repeat(rng.uniform(-1.0, 1.0, (round(seconds), 4)), round(ARM_RATE), axis=0)
    return np.asarray(
        np.where((t % 4.0 > 2.0)[:, None], steps, waves) * scale + np.array([0.0, 0.2, 0.4, 0.7]) + shift
    )


def logged(folder: Path, r: np.ndarray, file: str, *, push: Push | None = None) -> didim.Experiment:
    """Write the arm of a file and its log, whose ranges are those of the arm; a push acts on the joints."""
    text = arm_text(truth=True)
    q = followed(mujoco, text if push is None else without_ranges(text), r, ARM_RATE, ARM_DELAY_S, push=push)
    np.savez(folder / "log.npz", q=np.round(q / ENCODER) * ENCODER, r=r)
    (folder / "arm.xml").write_text(file)
    (folder / "arm.toml").write_text(EXPERIMENT)
    return didim.load_experiment(folder / "arm.toml")


def without_ranges(text: str) -> str:
    return re.sub(r' range="[^"]*"', "", text)


def held(fit: didim.Identification) -> list[str]:
    return [item.sentence for item in fit.evidence if item.code == "held"]


def drives_are_true(fit: didim.Identification, share: float) -> None:
    for kind, key in (("Ia", "armature"), ("Fv", "damping")):
        values = [fit.beta[fit.names.index(f"{kind}{joint + 1}")] for joint in range(4)]
        np.testing.assert_allclose(values, ARM_TRUTH[key], rtol=share)


@pytest.mark.slow
@pytest.mark.parametrize("ranges", [True, False])
def test_ends_of_the_range_are_left_out(tmp_path: Path, ranges: bool) -> None:
    """A gripper commanded beyond its end half of the time, with an end that the file has, or not."""
    r = commands([0.0, 0.0, 0.0, 0.9], seconds=16.0)
    file = arm_text() if ranges else without_ranges(arm_text())
    experiment = logged(tmp_path, r, file)
    fit = didim.identify(experiment, CLOE(threads=1), verbose=False)
    sentence = held(fit)[0]
    assert "(gripper) is held by " + ("the end of its range (1.75)" if ranges else "a contact") in sentence
    drives_are_true(fit, 0.03)
    (at_limit,) = np.nonzero(np.any(r[:, 3:] > 1.85, axis=1))
    stops = Problem(experiment).stops
    assert {item.joint for item in stops} == {3}
    left_out = np.concatenate([np.arange(item.begin, item.end) for item in stops])
    assert np.isin(at_limit[at_limit > 5] + 2, left_out).mean() > 0.8
    if ranges:
        assert sentence in [item.sentence for item in check(experiment).items]
        replay = validate_in_mujoco(fit, experiment, tmp_path / "arm.xml")
        assert replay.completed


@pytest.mark.parametrize("span", ["", "-0.1 0.5"])
def test_free_motion_has_no_word(tmp_path: Path, span: str) -> None:
    """Not even beyond ranges of a file that are too narrow: the joints follow their commands there."""
    file = arm_text() if not span else re.sub(r'range="[^"]*"', f'range="{span}"', arm_text())
    experiment = logged(tmp_path, commands([0.0] * 4), file)
    problem = Problem(experiment)
    assert not problem.stops
    assert [len(item.q) for item in problem.rollouts] == [600]


def test_a_short_pull_of_a_slow_motion_stays_short() -> None:
    """A joint that sticks for a quarter of a second on its way up is free before and after."""
    q = 0.001 * np.arange(1200.0)
    q[600:612], q[612:] = q[600], q[612:] - 0.012
    r = q + 0.005
    r[600:612] += 0.1
    ((begin, end, limit),) = _held(q, r, r - q, 10, 0.003, None)
    assert 595 <= begin <= 600 < 610 <= end <= 617
    assert limit is None
    assert not _held(q, np.full(1200, 0.5), r - q, 10, 0.003, None)  # its command rests: friction holds it


def test_a_joint_that_is_always_held_is_refused(tmp_path: Path) -> None:
    """A gripper that is closed, but for one move."""
    r = commands([0.0] * 4, seconds=20.0)
    r[:, 3] = np.where(np.arange(len(r)) < 75, 0.5, -0.6)
    with pytest.raises(
        FitError, match=r"joint 4 \(gripper\) is held .* for 1\d.\d s, and too little is left"
    ):
        didim.identify(logged(tmp_path, r, arm_text()), CLOE(threads=1), verbose=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("push", "begin", "end"),
    [
        (lambda t, q: [0.0, -0.5 if 6.0 < t < 9.0 else 0.0, 0.0, 0.0], 6.0, 9.0),
        (lambda t, q: [0.0, -5.0 * max(q[1] - 0.3, 0.0) if 5.0 < t < 9.0 else 0.0, 0.0, 0.0], 5.0, 9.0),
    ],
    ids=["a push", "a soft wall"],
)
def test_pushes_are_left_out(tmp_path: Path, push: Push, begin: float, end: float) -> None:
    """Errors that are several times those of the rest show what is too weak to hold a joint."""
    experiment = logged(tmp_path, commands([0.0] * 4, seconds=16.0), arm_text(), push=push)
    fit = didim.identify(experiment, CLOE(threads=1), verbose=False)
    (finding,) = [item for item in fit.evidence if item.code == "held"]
    assert "something pushes joint 2 (shoulder_lift)" in finding.sentence
    times = np.array(finding.facts["times"])
    assert begin - 1.5 < times[np.argmax(np.diff(times, axis=1))][0] < end
    assert np.sum(np.clip(times[:, 1], begin, end) - np.clip(times[:, 0], begin, end)) > 0.6 * (end - begin)
    drives_are_true(fit, 0.03)
    assert np.max(fit.settings["positions"]["errors"]["after"]) < 1.2e-3
    path = tmp_path / "fit.json"
    fit.save(path)
    errors = position_errors(replayed(didim.Identification.load(path), experiment))["log"]
    np.testing.assert_allclose(errors, fit.settings["positions"]["errors"]["after"], rtol=1e-6)


def test_larger_errors_of_faster_motions_are_no_pushes() -> None:
    """A fast third of a log, with errors of both model and tracking ten times those of the rest."""
    rng = np.random.default_rng(0)
    size = np.where(np.arange(2000) % 1000 < 300, 10.0, 1.0)
    errors, ahead = size * rng.standard_normal((2, 2000))
    assert pushed_stretches([errors], [30.0 * ahead], [0.0], [50.0], STRONGEST) == [[]]
    errors[1200:1300] *= 10.0
    ((found,),) = pushed_stretches([errors], [30.0 * ahead], [0.0], [50.0], STRONGEST)
    assert 1175 <= found[0] < found[1] <= 1325  # the strongest block and those beside it


@pytest.mark.slow
def test_friction_that_changes_makes_a_result_doubtful(tmp_path: Path) -> None:
    """A joint whose damping and friction are larger in the second half of the log: no single value is true."""
    r, step_s = commands([0.0] * 4, seconds=20.0), 2.5e-4
    model = mujoco.MjModel.from_xml_string(without_ranges(arm_text(truth=True)))
    added = 0.5 * np.array([model.dof_frictionloss[1], model.dof_damping[1]])
    before = [0.0]

    def push(t: float, q: np.ndarray) -> list[float]:
        speed, before[0] = (q[1] - before[0]) / step_s, float(q[1])
        return [0.0, -added @ [np.tanh(speed / 0.01), speed] if t > 10.0 else 0.0, 0.0, 0.0]

    fit = didim.identify(logged(tmp_path, r, arm_text(), push=push), CLOE(threads=1), verbose=False)
    (finding,) = [item for item in fit.evidence if item.code == "changes"]
    assert finding.joints == (2,)
    assert finding.grade == "doubtful"
    assert not fit.verdict.sound
    assert "Fv2" in finding.parameters or "Fc2" in finding.parameters


@pytest.mark.slow
def test_right_logs_have_no_change(tmp_path: Path) -> None:
    fit = didim.identify(
        logged(tmp_path, commands([0.0] * 4, seconds=16.0), arm_text()), CLOE(threads=1), verbose=False
    )
    assert fit.verdict.sound
    assert not [item for item in fit.evidence if item.code == "changes"]


def test_a_missing_law_of_friction_is_doubtful_and_no_push(tmp_path: Path) -> None:
    """Friction of two joints that grows with the square of their speed: its errors turn with the motion, so nothing is left out."""
    before = [np.zeros(4)]

    def push(t: float, q: np.ndarray) -> list[float]:
        speed, before[0] = (q - before[0]) / 2.5e-4, np.array(q)
        return list(np.clip(-0.25 * speed * np.abs(speed), -3.0, 3.0) * [0.0, 1.0, 1.0, 0.0] * (t > 0.0))

    fit = didim.identify(
        logged(tmp_path, commands([0.0] * 4, seconds=16.0), arm_text(), push=push),
        CLOE(threads=1),
        verbose=False,
    )
    assert not fit.verdict.sound
    (finding,) = [item for item in fit.evidence if item.code == "model-error"]
    assert {2, 3} <= {*finding.joints}
    assert not held(fit)
