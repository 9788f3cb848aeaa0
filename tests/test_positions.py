"""CLOE with known links: drives and friction from commanded and measured positions, on simulated twins and a real quadruped."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from didim import Identification
from didim.cli.main import main
from didim.errors import ExperimentError, FitError
from didim.excitation.positions import excite_positions
from didim.export.drives import drives_of
from didim.export.mjcf_edit import edit_mjcf
from didim.loop.servos import Held, ServoLoop, Servos
from didim.methods.cloe.cloe import CLOE
from didim.methods.positions import laws
from didim.methods.positions.knowledge import held_at
from didim.methods.positions.laws import searched
from didim.methods.positions.problem import Problem
from didim.methods.positions.replay import _problem, other_gains, position_errors, replayed
from didim.methods.positions.search import begun, search
from didim.methods.positions.stops import Stop
from didim.model.limbs import limbs_of
from didim.report import write
from didim.result.iteration import Iteration, Reporter, Status
from didim.result.positions.record import PositionRecord
from didim.studies.in_mujoco import validate_in_mujoco
from quadrupeds import recorded

RATE = 100.0
LEG = """
<body name="{name}_hip" pos="{x} {y} 0"><inertial pos="0 {s}0.02 0" mass="0.7" diaginertia="0.0005 0.0009 0.0006"/>
 <joint name="{name}_hip_joint" axis="1 0 0" range="-2 2"/>
 <body name="{name}_thigh" pos="0 {s}0.1 0"><inertial pos="-0.004 0 -0.03" mass="1.1" diaginertia="0.006 0.006 0.001"/>
  <joint name="{name}_thigh_joint" axis="0 1 0" range="-2 2"/>
  <body name="{name}_calf" pos="0 0 -0.2"><inertial pos="0.005 0 -0.1" mass="0.25" diaginertia="0.002 0.002 0.00004"/>
   <joint name="{name}_calf_joint" axis="0 1 0" range="-3 1"/></body></body></body>"""
LEGS = "<mujoco><worldbody><body name='base' pos='0 0 1'>{legs}</body></worldbody></mujoco>"
ARM = """<mujoco>{option}<worldbody>
<body name="turn"><inertial pos="0.01 0 0.02" mass="1" diaginertia="0.002 0.002 0.002"/><joint name="turn" axis="0 0 1"/>
 <body name="lift" pos="0 0 0.1"><inertial pos="0.1 0 0" mass="0.6" diaginertia="0.0006 0.003 0.003"/>
  <joint name="lift" axis="0 1 0"/>
  <body name="bend" pos="0.2 0 0"><inertial pos="0.08 0 0" mass="0.3" diaginertia="0.0002 0.001 0.001"/>
   <joint name="bend" axis="0 1 0"/></body></body></body></worldbody></mujoco>"""
EXPERIMENT = """
schema = 1
robot = "robot.xml"
[friction]
coulomb = "tanh"
smoothing_rad_s = 0.02
[parameters]
links = "fixed"
{parameters}
[controller]
kind = "pd"
kp = {kp}
kv = 0.5
{controller}
[reference]
kind = "recorded"
between_samples = "held"
[unknown]
{unknown}
[[recording]]
name = "log"
rate_hz = 100
{windows}
"""
EXPERIMENT += recorded("log.npz", "q", "r")


FALSE_GAINS = [
    pytest.param(False, 40.0, {"Fc": 1.5, "Off": 0.3}, {}, 2e-3, id="slow waves with much friction"),
    pytest.param(
        True, 17.0, {"Fc": 0.6, "Off": 0.3}, {"lag_s": 0.08, "bias_rad": 0.03}, 25e-3, id="steps behind a lag"
    ),
]
"""Steps or waves, assumed kp (20 is true), the truth, and the largest error (rad): that of the noise, 1 mrad, in the first; the lag
that the model lacks leaves 20 mrad in the second."""


def legs() -> str:
    parts = [LEG.format(name=name, x=0.1, y=y, s=s) for name, y, s in (("L", 0.1, ""), ("R", -0.1, "-"))]
    return LEGS.format(legs="".join(parts))


def commands(n: int, seconds: float, *, steps: bool, seed: int = 0) -> np.ndarray:
    """Smooth moves, or steps of half a second between random positions."""
    rng = np.random.default_rng(seed)
    count = int(seconds * RATE)
    t = np.arange(count)[:, None] / RATE
    if steps:
        return np.repeat(rng.uniform(-0.4, 0.4, (count // 50 + 1, n)), 50, axis=0)[:count]
    f = rng.uniform(0.2, 0.6, (3, 1, n))
    return np.asarray(0.25 * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.0, (3, 1, n))).sum(axis=0))


def twin(
    folder: Path,
    text: str,
    r: np.ndarray,
    *,
    truth: Mapping[str, float] | None = None,
    drive: Mapping[str, float] | None = None,
    unknown: str = "delay_s = { max = 0.05 }",
    parameters: str = "",
    controller: str = "",
    windows: str = "",
    kp: float = 20.0,
    noise: float = 0.0,
    seed: int = 0,
    pushed: slice | None = None,
    smoothing: float = 0.02,
) -> didim.Experiment:
    """Write a robot, a log of it by finer steps than those of the fit, and the experiment; return the experiment."""
    (folder / "robot.xml").write_text(text)
    robot = didim.load_robot(folder / "robot.xml").with_smoothing([smoothing] * r.shape[1])
    integrator = "rk4" if smoothing > 1e-3 else "imex"
    names, n = robot.parameter_names, r.shape[1]
    x = np.array(next(iter(robot.sets.values())))
    values = {"Ia": 0.012, "Fv": 0.15, "Fc": 0.2, "Off": 0.05} | dict(truth or {})
    for kind, value in values.items():
        for joint in range(n):
            x[names.index(f"{kind}{joint + 1}")] = value * (1.0 + 0.1 * joint)
    numbers = {
        "kp": 20.0,
        "kv": 0.5,
        "saturation": np.inf,
        "delay_s": 0.0123,
        "lag_s": 0.0,
        "bias_rad": 0.0,
    } | dict(drive or {})
    q = np.empty_like(r)
    for limb in limbs_of(robot):
        at = list(limb.joints)
        held = Held(np.ascontiguousarray(r[:, at]), RATE)
        loop = ServoLoop(
            limb.robot, held, held.values, step_s=2.5e-4, fine_step_s=2.5e-4, integrator=integrator
        )
        rows: dict[str, Any] = {kind: np.full((1, len(at)), value) for kind, value in numbers.items()}
        start: dict[str, Any] = {"q": r[:1, at], "dq": np.zeros((1, len(at)))}
        found, completed = loop.run(x[limb.indices][None], Servos(**rows, **start))
        assert completed.all()
        q[:, at] = found[0]
    rng = np.random.default_rng(seed)
    q += noise * rng.standard_normal(q.shape)
    if pushed is not None:
        q[pushed] += 0.1 * np.sin(np.linspace(0.0, 20.0, len(q[pushed])))[:, None]
    np.savez(folder / "log.npz", q=q, r=r)
    fields = {
        "unknown": unknown,
        "parameters": parameters,
        "controller": controller,
        "windows": windows,
        "kp": kp,
    }
    (folder / "log.toml").write_text(EXPERIMENT.format(**fields))
    return didim.load_experiment(folder / "log.toml")


def fitted(experiment: didim.Experiment, **settings: Any) -> Identification:
    return didim.identify(experiment, CLOE(threads=1, **settings), verbose=False)


def record(fit: Identification) -> PositionRecord:
    found = PositionRecord.of(fit.settings)
    assert found is not None
    return found


def rows(fit: Identification) -> dict[str, Mapping[str, Any]]:
    return {row["name"]: row for row in record(fit).rows}


def test_limbs_move_by_themselves(tmp_path: Path) -> None:
    (tmp_path / "legs.xml").write_text(legs())
    robot = didim.load_robot(tmp_path / "legs.xml")
    limbs = limbs_of(robot)
    assert [(limb.name, limb.joints) for limb in limbs] == [("L", (0, 1, 2)), ("R", (3, 4, 5))]
    rng = np.random.default_rng(0)
    x = rng.uniform(0.1, 1.0, len(robot.parameter_names))
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 7, 6))
    whole = didim.inverse_dynamics(robot, q, dq, ddq, x)
    for limb in limbs:
        at = list(limb.joints)
        alone = didim.inverse_dynamics(limb.robot, q[:, at], dq[:, at], ddq[:, at], x[limb.indices])
        np.testing.assert_allclose(alone, whole[:, at], rtol=1e-12, atol=1e-12)
        assert [robot.parameter_names[k] for k in limb.indices] == [
            f"{name.rstrip('123')}{int(name[-1]) + at[0]}" for name in limb.robot.parameter_names
        ]


def test_chains_are_one_limb() -> None:
    robot = didim.load_robot("ur5e")
    assert [limb.joints for limb in limbs_of(robot)] == [tuple(range(6))]
    # The coupled wrist of a TX40 shares motors.
    assert len(limbs_of(didim.load_robot("tx40"))) == 1


@pytest.mark.parametrize("lag", [0.0, 0.013])
def test_means_of_a_held_reference(lag: float) -> None:
    values = np.array([[0.0, 1.0], [0.3, 1.0], [-0.2, 0.5], [0.4, 0.1], [0.4, -0.3]])
    held, delay = Held(values, 50.0), 0.0073
    edges = np.array([0.0, 0.003, 0.011, 0.0273, 0.0311, 0.06, 0.099])
    means = held.means(edges, np.full(2, delay), np.full(2, lag))
    fine = np.arange(-0.2, 0.1, 1e-6)
    r = values[np.clip(np.floor((fine - delay) * 50.0), 0, 4).astype(int)]
    if lag:
        keep, smooth = np.exp(-1e-6 / lag), np.empty_like(r)
        smooth[0] = r[0]
        for k in range(1, len(r)):
            smooth[k] = r[k - 1] + (smooth[k - 1] - r[k - 1]) * keep
        r = smooth
    expected = [r[(fine >= a) & (fine < b)].mean(axis=0) for a, b in itertools.pairwise(edges)]
    np.testing.assert_allclose(means, expected, atol=2e-4)
    np.testing.assert_allclose(held.jumps(delay), np.arange(1, 5) / 50.0 + delay)


@pytest.mark.slow
@pytest.mark.usefixtures("without_drawing")
def test_two_legs_give_their_drives_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    experiment = twin(tmp_path, legs(), commands(6, 8.0, steps=True))
    fit = fitted(experiment)
    assert fit.converged
    assert fit.n_iterations <= 8
    found = rows(fit)
    for kind, value in {"Ia": 0.012, "Fv": 0.15, "Fc": 0.2, "Off": 0.05}.items():
        for joint in range(6):
            row = found[f"{kind}{joint + 1}"]
            assert row["value"] == pytest.approx(value * (1.0 + 0.1 * joint), rel=0.02), row["name"]
    assert found["delay_s"]["value"] == pytest.approx(0.0123, abs=5e-5)
    after, before = record(fit).errors["after"], record(fit).errors["before"]
    assert after is not None
    assert before is not None
    assert max(after) < 2e-4 < min(before)
    assert fit.parameters[fit.parameter_names.index("Ia5")] == found["Ia5"]["value"]
    text = str(fit)
    assert "L" in text
    assert "thigh_joint Ia" in text
    assert "rms error" in text
    assert fit.verdict.sound
    write(tmp_path / "fit.html", fit, experiment)
    page = (tmp_path / "fit.html").read_text()
    assert "thigh_joint Ia" in page
    assert page.count("<figure") == 1
    fit.save(tmp_path / "fit.json")
    assert (
        main(
            [
                "validate",
                str(tmp_path / "fit.json"),
                str(tmp_path / "log.toml"),
                "--json",
                str(tmp_path / "e.json"),
            ]
        )
        == 0
    )
    data, printed = json.loads((tmp_path / "e.json").read_text()), capsys.readouterr().out.splitlines()
    errors, ahead = data["position_errors"]["log"], data["horizon_errors"]["log"]
    assert len(errors) == 6
    assert max(errors) < 1e-3
    assert [*ahead] == ["0.1", "0.5", "2"]
    assert all(len(row) == 6 and max(row) < 5e-3 for row in ahead.values())
    assert printed[1].split() == [
        "recording",
        "'log'",
        "from",
        "the",
        "start",
        *(f"{1e3 * value:.2f}" for value in errors),
    ]
    assert printed[4].split() == ["2", "s", "ahead", *(f"{1e3 * value:.2f}" for value in ahead["2"])]
    assert str(Identification.load(tmp_path / "fit.json")) == text
    other = (tmp_path / "log.toml").read_text().replace("kv = 0.5", "kv = 0.6")
    (tmp_path / "other.toml").write_text(other)
    assert main(["validate", str(tmp_path / "fit.json"), str(tmp_path / "other.toml")]) == 0
    assert "simulated with kv of this experiment" in capsys.readouterr().out


def test_predictions_begin_with_measured_states(tmp_path: Path) -> None:
    """With the truth they follow a log from any time on, delay and lag of the commands before it included."""
    truth, drive = {"Ia": 0.012, "Fv": 0.15, "Fc": 0.2, "Off": 0.05}, {"delay_s": 0.0323, "lag_s": 0.02}
    unknown = "".join(f"{kind} = {{ start = {value}, max = 0.05 }}\n" for kind, value in drive.items())
    experiment = twin(
        tmp_path, ARM.format(option=""), commands(3, 6.0, steps=True), drive=drive, unknown=unknown
    )
    values = {f"{kind}{j + 1}": value * (1.0 + 0.1 * j) for kind, value in truth.items() for j in range(3)}
    problem = Problem(experiment, given=values)
    (rollout,) = problem.rollouts
    every, at = problem.ahead(rollout, problem.start, (2.0, 0.1), np.full(3, np.inf))
    assert at.tolist() == [*range(rollout.first, len(rollout.q) - 2, 10)]
    assert every.shape == (len(at), 201, 3)
    q, smooth = problem.ahead(rollout, problem.start, (2.0, 0.1), np.full(3, 2e-4))
    assert 20 < len(smooth) < len(at)
    assert {*smooth.tolist()} < {*at.tolist()}
    ends = smooth[smooth + 200 < len(rollout.q)]
    truth_of = rollout.q[ends[:, None] + np.arange(201)]
    assert np.sqrt(np.mean((q[: len(ends)] - truth_of) ** 2)) < 5e-4 < 0.01 * np.std(rollout.q)
    assert not problem.ahead(rollout, problem.start, (2.0, 0.1), np.zeros(3))[1].size
    wrong, column = problem.start, [column.name for column in problem.columns].index("delay_s")
    wrong[column] += 0.01
    late = problem.ahead(rollout, wrong, (2.0, 0.1), np.full(3, 2e-4))[0]
    assert np.sqrt(np.mean((late - q) ** 2)) > 5e-3


@pytest.mark.slow
def test_saturating_steps_tell_the_gains(tmp_path: Path) -> None:
    unknown = (
        "delay_s = { max = 0.05 }\nkp = { start = 12.0 }\nkv = { start = 0.2 }\nsaturation = { start = 6.0 }"
    )
    r = 1.5 * commands(3, 10.0, steps=True)
    experiment = twin(tmp_path, ARM.format(option=""), r, unknown=unknown, drive={"saturation": 4.0}, kp=12.0)
    fit = fitted(experiment)
    assert fit.converged
    found = rows(fit)
    for name, value in {"kp2": 20.0, "kp3": 20.0, "saturation2": 4.0, "saturation3": 4.0}.items():
        assert found[name]["by"] == "log", name
        assert found[name]["value"] == pytest.approx(value, rel=0.02), name
    assert found["delay_s"]["value"] == pytest.approx(0.0123, abs=1e-4)
    # An experiment that asks for none of these is simulated with the estimates too, not with the gains of its own file.
    silent = replace(experiment, unknown={})
    errors = np.array(position_errors(replayed(fit, silent))["log"])
    np.testing.assert_allclose(errors, np.array(record(fit).errors["after"]), rtol=1e-6)
    assert other_gains(fit, silent) == []
    # What holds a joint is found with the gains that the search began with, not with those of the last joint.
    for own in (experiment, silent):
        began = Problem(own).values.drive["kp"]
        np.testing.assert_array_equal(_problem(fit, own)[0].values.drive["kp"], began)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("unknown", "name", "words", "steps"),
    [
        ("kp = { min = 2, max = 100 }", "kp1", "only (J + Ia)/kp", False),
        ("kv = { max = 3 }", "kv2", "only Fv + kv is known", True),
        ("bias_rad = {}", "bias_rad1", "a bias has no effect", True),
        ("saturation = { start = 50.0 }", "saturation3", "the limit of the torque is never reached", True),
        ("delay_s = { start = 0.01 }", "delay_s", "slow commands show only delay_s", None),
    ],
)
def test_what_a_log_cannot_tell_is_held(
    tmp_path: Path, unknown: str, name: str, words: str, steps: bool | None
) -> None:
    r = commands(3, 8.0, steps=bool(steps))
    if steps is None:  # ramps without a turn
        r = np.linspace(0.0, 0.5, 800)[:, None] * [1.0, 0.8, -0.6]
    parameters = 'dropped = ["Off"]' if "bias" in unknown else ""
    truth = {"Off": 0.0} if parameters else {}
    experiment = twin(tmp_path, ARM.format(option=""), r, unknown=unknown, parameters=parameters, truth=truth)
    fit = fitted(experiment)
    row = rows(fit)[name]
    assert row["by"] == "held"
    assert words in row["text"]
    assert row["value"] == row["before"]
    assert row["std"] is None
    assert fit.roles[fit.names.index(name)] == "fixed"
    finding = next(reason for reason in fit.verdict.reasons if name in reason.parameters)
    assert finding.sentence.endswith(row["text"])
    assert len(finding.sentence) <= 200
    assert f"({row['value']:.4g})" in str(fit)


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "kp", "truth", "drive", "largest"), FALSE_GAINS)
def test_several_false_gains_leave_ratios(
    tmp_path: Path, steps: bool, kp: float, truth: dict[str, float], drive: dict[str, float], largest: float
) -> None:
    """Gains that a log does not identify go astray together; friction is identified for all that, as a ratio to kp."""
    r = commands(3, 16.0, steps=steps) * (1.0 if steps else 0.3)
    experiment = twin(
        tmp_path, ARM.format(option=""), r, unknown="kp = {}", truth=truth, kp=kp, noise=1e-3, drive=drive
    )
    fit = fitted(experiment)
    assert fit.converged
    found = rows(fit)
    for joint in (1, 2, 3):
        assert "/kp" in found[f"kp{joint}"]["text"]
        assert [found[f"{kind}{joint}"]["by"] for kind in ("Fv", "Fc", "Off")] == ["log"] * 3
    assert max(record(fit).errors["after"] or ()) < largest


@pytest.mark.slow
def test_joints_that_stay_where_they_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Moves with rests of two seconds, in which a smooth sign and MuJoCo's friction creep by many times the noise."""
    monkeypatch.setattr(laws, "_of_another_softness", lambda now, shift, options: (now, shift))
    rng = np.random.default_rng(2)
    moves = np.repeat(0.4 * rng.choice([-1.0, 1.0], (6, 3)) * rng.uniform(0.5, 1.0, (6, 3)), 200, axis=0)
    r = np.array(
        [np.convolve(np.pad(one, 40, mode="edge"), np.ones(81) / 81.0, "valid") for one in moves.T]
    ).T
    truth = {"Ia": 0.03, "Fc": 0.8, "Fv": 0.4}
    twin(tmp_path, ARM.format(option=""), r, truth=truth, noise=2e-4, smoothing=1e-4)
    path = tmp_path / "log.toml"
    table = '[friction]\ncoulomb = "tanh"\nsmoothing_rad_s = 0.02\n'
    path.write_text(path.read_text().replace(table, ""))
    experiment = didim.load_experiment(path)
    creeping = search(begun(Problem(experiment)), most=40, tolerance=1e-2, reporter=Reporter())
    fit = fitted(experiment)
    assert record(fit).sticks
    after = record(fit).errors["after"] or ()
    assert max(after) < 1.2 * 2e-4 < 0.2 * creeping.problem.joint_errors(creeping.errors).max()
    for joint in (1, 2, 3):
        value = rows(fit)[f"Fc{joint}"]["value"]
        assert value == pytest.approx(0.8 * (1.0 + 0.1 * (joint - 1)), rel=0.02)
    np.testing.assert_allclose(position_errors(replayed(fit, experiment))["log"], after, rtol=1e-6)
    pytest.importorskip("mujoco")
    content, _ = edit_mjcf(drives_of(fit, "fit"), tmp_path / "robot.xml")
    (tmp_path / "new.xml").write_bytes(content)
    assert validate_in_mujoco(fit, experiment, tmp_path / "new.xml", step_s=5e-4).after.max() < 5e-4


def test_an_unknown_is_not_held_at_a_higher_cost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What counts as unidentified is held at its start only if the start explains the log as well."""
    experiment = twin(tmp_path, ARM.format(option=""), commands(3, 6.0, steps=True), noise=1e-4)
    now = begun(Problem(experiment))
    k = next(k for k, column in enumerate(now.problem.columns) if column.name == "Fv2")
    options = {"most": 40, "tolerance": 1e-4, "reporter": Reporter()}
    free = searched(now, dict(options))
    told = iter([{k: "known otherwise"}, {}])
    monkeypatch.setattr(laws, "unidentified", lambda now: next(told))
    held = searched(begun(Problem(experiment)), dict(options))
    assert held.cost <= 1.1 * free.cost
    assert held.theta[k] == pytest.approx(free.theta[k], rel=0.01)
    assert held_at(held, k) == f"known otherwise; Fv is held at {held.theta[k]:.6g} N.m.s/rad"


def test_each_search_has_its_own_iterations(tmp_path: Path) -> None:
    now = begun(Problem(twin(tmp_path, ARM.format(option=""), commands(3, 4.0, steps=True), noise=1e-4)))
    reporter = Reporter()
    costs = [search(now, most=1, tolerance=1e-4, reporter=reporter).cost for _ in range(3)]
    assert costs[0] > costs[1] > costs[2]
    assert len(now.history) == 3


def test_derivatives_are_corrected_by_steps_and_kept_in_other_rows(tmp_path: Path) -> None:
    """Corrected ones give the errors of the last step; those of the rest of a log are those simulated there, but for its start."""
    experiment = twin(tmp_path, ARM.format(option=""), commands(3, 12.0, steps=True), noise=1e-4)
    now = begun(Problem(experiment))
    rest = replace(now.problem, pushed=[Stop(1, 0, 500, 560, None, True)])
    before, kept = now.problem.n_simulations, begun(rest, now.theta, now, kept=True)
    assert rest.n_simulations - before == len(rest.rollouts) == 2
    assert not kept.fresh
    for own, new in zip(kept.blocks, begun(rest, now.theta).blocks, strict=True):
        assert np.linalg.norm(own - new) < 0.05 * np.linalg.norm(new)
    assert begun(now.problem, now.theta, kept, kept=True).fresh  # not all rows are there
    step = 5.0 * np.array([column.step for column in now.problem.columns])
    moved, first = now.problem.errors(now.theta + step), now.errors
    now.learn(step, moved, np.diag(now.normal()[0]))
    for one, other, block in zip(moved, first, now.blocks, strict=True):
        np.testing.assert_allclose(block @ step, one - other, atol=1e-12)


def test_derivatives_that_cannot_be_simulated_leave_those_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = begun(Problem(twin(tmp_path, ARM.format(option=""), commands(3, 2.0, steps=True))))
    errors, blocks, cost = now.errors, now.blocks, now.cost
    nothing = [np.full_like(e, np.nan) for e in errors], [np.zeros_like(j) for j in blocks]
    monkeypatch.setattr(Problem, "derivatives", lambda self, theta: nothing)
    now.fresh = False
    now.renew()
    assert now.errors is errors
    assert now.blocks is blocks
    assert (now.cost, now.fresh) == (cost, True)


@pytest.mark.usefixtures("without_drawing")
def test_a_limited_acceleration_of_set_points(tmp_path: Path) -> None:
    """A chirp beyond the limit shows it, asked for or not, and steps of goals that rest pass it by."""
    t = np.arange(8 * RATE)[:, None] / RATE
    chirp = 0.15 * np.sin(2.0 * np.pi * (0.5 + 0.16 * t) * t + np.arange(3.0))
    r = np.concatenate([chirp, commands(3, 4.0, steps=True)])
    unknown = "delay_s = { max = 0.05 }\nacceleration = { start = 90.0 }"
    truth = {"unknown": unknown, "noise": 1e-4, "drive": {"acceleration": 40.0}}
    text = ARM.format(option="")
    fit = fitted(twin(tmp_path, text, r, **truth))  # type: ignore[arg-type]
    assert fit.converged
    found = rows(fit)
    assert found["acceleration"]["value"] == pytest.approx(40.0, rel=2e-3)
    assert found["Ia2"]["value"] == pytest.approx(0.0132, rel=0.02)
    assert max(record(fit).errors["after"] or ()) < 5e-4  # 30 to 50 times less than without
    assert "at most 40 rad/s^2" in str(drives_of(fit, "fit").sentences)
    plain = (tmp_path / "log.toml").read_text().replace("acceleration", "# acceleration")
    (tmp_path / "plain.toml").write_text(plain)
    without = didim.load_experiment(tmp_path / "plain.toml")
    other = fitted(without)
    assert rows(other)["acceleration"]["value"] == pytest.approx(40.0, rel=2e-3)  # found where nobody asked
    assert "set-points seem to accelerate by at most 40 rad/s^2" in str(other.verdict.notes)
    replay = np.array(position_errors(replayed(other, without))["log"])
    np.testing.assert_allclose(replay, np.array(record(other).errors["after"]), rtol=1e-6)
    (tmp_path / "lag.toml").write_text(plain.replace("# acceleration = {", "lag_s = {}\nacceleration = {"))
    with pytest.raises(FitError, match="without lag_s"):
        fitted(didim.load_experiment(tmp_path / "lag.toml"))
    (tmp_path / "zero.toml").write_text(plain.replace("# acceleration = {", "acceleration = { min = 0.0,"))
    with pytest.raises(ExperimentError, match="min must be above 0"):
        didim.load_experiment(tmp_path / "zero.toml")


@pytest.mark.usefixtures("without_drawing")
def test_a_search_stops_in_the_trial_of_an_acceleration(tmp_path: Path) -> None:
    t = np.arange(8 * RATE)[:, None] / RATE
    r = 0.15 * np.sin(2.0 * np.pi * (0.5 + 0.16 * t) * t + np.arange(3.0))
    twin(tmp_path, ARM.format(option=""), r, noise=1e-4, drive={"acceleration": 40.0})
    path = tmp_path / "log.toml"
    path.write_text(path.read_text().replace('[friction]\ncoulomb = "tanh"\nsmoothing_rad_s = 0.02\n', ""))
    experiment = didim.load_experiment(path)
    errors = [one.more["rms"] for one in fitted(experiment).history]
    tried = 1 + next(k for k, (one, other) in enumerate(itertools.pairwise(errors)) if other < 0.5 * one)
    for last in (tried, tried + 1):
        seen: list[float] = []

        def stop(now: Iteration, seen: list[float] = seen, last: int = last) -> bool:
            seen.append(now.more["rms"])
            return len(seen) == last

        fit = didim.identify(experiment, callback=stop)
        assert fit.status is Status.STOPPED
        assert len(seen) == last


def test_set_points_arrive_in_the_shortest_time() -> None:
    """They take 2 sqrt(d / a) at the largest acceleration; one that rests is left by a jump, 27 ms after its command."""
    goals = np.repeat([0.0, 0.03, 0.04, 0.05, 0.3, -0.2, 0.0, -0.2], [1, 1, 1, 1, 50, 10, 2, 8])[:, None]
    held, none, step = Held(goals, 100.0), np.zeros(1), 1e-4
    s = held.means(np.arange(7_401, dtype=np.float64) * step, none, none, np.array([40.0]))[:, 0]
    assert s[:370] == pytest.approx(0.0)
    assert s[370:400] == pytest.approx(0.05)
    moves = round(2.0 * np.sqrt(0.25 / 40.0) / step)
    assert s[400 + moves // 2] == pytest.approx(0.175, abs=1e-3)
    accelerations = np.diff(s[400 : 400 + moves], 2) / step**2
    assert np.sort(np.abs(accelerations))[3:] == pytest.approx(40.0, rel=1e-3)
    assert s[402 + moves : 5_670] == pytest.approx(0.3)
    assert s[5_670:] == pytest.approx(-0.2)  # also where a command is withdrawn before the jump


def test_no_gravity_leaves_the_ratio(tmp_path: Path) -> None:
    text = ARM.format(option='<option gravity="0 0 0"/>')
    fit = fitted(twin(tmp_path, text, commands(3, 8.0, steps=True), unknown="kp = { start = 25.0 }", kp=25.0))
    held = [row for row in rows(fit).values() if row["kind"] == "kp" and row["by"] == "held"]
    assert held
    assert all("/kp" in row["text"] for row in held)
    assert not fit.verdict.sound


@pytest.mark.slow
def test_rollouts_start_by_themselves_and_a_bad_one_is_left_out(tmp_path: Path) -> None:
    windows = "windows_s = [" + ", ".join(f"[{2 * k}.0, {2 * k + 2}.0]" for k in range(9)) + "]"
    experiment = twin(
        tmp_path,
        ARM.format(option=""),
        commands(3, 18.0, steps=True),
        windows=windows,
        noise=2e-4,
        pushed=slice(1000, 1200),
    )
    fit = fitted(experiment)
    assert record(fit).kind == "rollouts"
    assert record(fit).blocks == 8
    held = [item for item in fit.evidence if item.code == "held"]
    assert held
    for item in held:
        assert item.facts["pushed"]
        assert all(10.0 <= begin < end <= 12.0 for begin, end in item.facts["times"])
    found = rows(fit)
    assert found["Fc2"]["value"] == pytest.approx(0.22, rel=0.02)
    assert found["delay_s"]["value"] == pytest.approx(0.0123, abs=1e-4)


@pytest.mark.slow
def test_intervals_cover_the_truth(tmp_path: Path) -> None:
    inside = []
    for seed in range(6):
        r = commands(3, 8.0, steps=True, seed=seed)
        fit = fitted(twin(tmp_path, ARM.format(option=""), r, noise=5e-4, seed=seed))
        truth = {"Ia": 0.012, "Fv": 0.15, "Fc": 0.2, "Off": 0.05}
        for row in record(fit).rows:
            value = (
                truth[row["kind"]] * (1.0 + 0.1 * (row["joints"][0] - 1)) if row["kind"] in truth else 0.0123
            )
            inside.append(row["low"] <= value <= row["high"])
            assert row["high"] - row["low"] < 2.0 * abs(value) + 0.05
    assert np.mean(inside) > 0.85


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (("delay_s = { max = 0.05 }", "delai_s = {}"), "there is no unknown 'delai_s'"),
        (("delay_s = { max = 0.05 }", "kp = { min = 3, max = 2 }"), "must be in order"),
        (("delay_s = { max = 0.05 }", 'kp = { shared = "leg" }'), "shared must be"),
        (('links = "fixed"', ""), "[unknown] is for known links"),
        (('kind = "recorded"', 'kind = "measured"'), "between_samples = 'held' is for kind 'recorded'"),
    ],
)
def test_wrong_keys_are_named(tmp_path: Path, edit: tuple[str, str], words: str) -> None:
    twin(tmp_path, ARM.format(option=""), commands(3, 2.0, steps=False))
    path = tmp_path / "log.toml"
    path.write_text(path.read_text().replace(*edit))
    with pytest.raises(didim.DidimError) as error:
        didim.load_experiment(path)
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"checkpoint": "search.npz"}, "takes no checkpoint"),
        ({"max_evaluations": 10}, "takes no max_evaluations"),
        ({"start": "idim-ls"}, "start is a mapping of names to values, got 'idim-ls'"),
        ({"noise": [1e-3]}, "noise needs one number per joint, 3, got 1"),
        ({"starts": 2}, "from one start"),
    ],
)
def test_settings_of_other_searches_are_refused(tmp_path: Path, settings: dict[str, Any], words: str) -> None:
    experiment = twin(tmp_path, ARM.format(option=""), commands(3, 2.0, steps=False))
    with pytest.raises(didim.DidimError) as error:
        fitted(experiment, **settings)
    assert words in str(error.value)


@pytest.mark.parametrize(("smoothing", "exact"), [(0.02, True), (0.2, False)])
def test_intervals_say_what_they_lack(tmp_path: Path, smoothing: float, exact: bool) -> None:
    """Friction that is smooth below another speed than the robot's leaves errors that are no noise."""
    twin(tmp_path, ARM.format(option=""), commands(3, 8.0, steps=True), noise=2e-4)
    path = tmp_path / "log.toml"
    path.write_text(path.read_text().replace("smoothing_rad_s = 0.02", f"smoothing_rad_s = {smoothing}"))
    fit = fitted(didim.load_experiment(path))
    found = [finding for finding in fit.evidence if finding.code == "model-error"]
    assert len(found) == (0 if exact else 1)
    if not exact:
        assert "so they are too narrow" in found[0].sentence
        assert max(found[0].facts["over_noise"]) > 3.0
        assert not found[0].facts["widened"]


GO2 = Path(__file__).resolve().parents[2] / "shared" / "data" / "go2"


def quadruped(folder: Path, unknown: str, parameters: str = "") -> Identification:
    """The fit of the log of a Go2."""
    text = EXPERIMENT.format(parameters=parameters, unknown=unknown, kp=20.0, controller="", windows="")
    text = (
        text.replace("kv = 0.5", "kv = 1.5")
        .replace("= 0.02", "= 0.01")
        .replace("rate_hz = 100", "rate_hz = 200")
    )
    for old, new in (
        ("log.npz", "traj_0.pt"),
        ('"q"', '"dof_pos"'),
        ('"r"', '"des_dof_pos"'),
        ("robot.xml", str(GO2 / "go2.xml")),
    ):
        text = text.replace(old, new)
    (folder / "go2.toml").write_text(text)
    return fitted(didim.load_experiment(folder / "go2.toml", data=GO2))


@pytest.mark.slow
@pytest.mark.skipif(not GO2.is_dir(), reason=f"needs the log in {GO2}")
@pytest.mark.parametrize(
    ("parameters", "unknown", "most_mrad", "most_iterations"),
    [
        ("", "delay_s = { start = 0.005, max = 0.025 }", 5.78, 6),
        (
            'dropped = ["Off"]',
            "delay_s = { start = 0.005, max = 0.025 }\nbias_rad = { min = -0.1, max = 0.1 }",
            6.68,
            6,
        ),
        (
            "",
            "delay_s = { start = 0.0125, max = 0.025 }\nIa = { start = 0.5, max = 1 }\nFv = { start = 3.5, max = 7 }\n"
            "Fc = { start = 0.5, max = 3 }",
            5.78,
            12,
        ),
    ],
)
def test_a_real_quadruped(
    tmp_path: Path, parameters: str, unknown: str, most_mrad: float, most_iterations: int
) -> None:
    fit = quadruped(tmp_path, unknown, parameters)
    after = np.array(record(fit).errors["after"])
    assert 1e3 * np.sqrt(np.mean(after**2)) < most_mrad
    assert fit.converged
    assert fit.n_iterations <= most_iterations
    if most_iterations == 6 and not parameters:
        assert fit.n_simulations <= 360
        assert any("RL_calf_joint" in text and "Fc is 1.2" in text for text in fit.remarks)


@pytest.mark.slow
@pytest.mark.skipif(not GO2.is_dir(), reason=f"needs the log in {GO2}")
def test_gains_of_a_real_quadruped_are_ratios(tmp_path: Path) -> None:
    """Free, they end at half of the true 20 N.m/rad: gravity and links hardly show in this motion."""
    fit = quadruped(tmp_path, "kp = { min = 2, max = 100 }\ndelay_s = { start = 0.005, max = 0.025 }")
    gains = [row for row in rows(fit).values() if row["kind"] == "kp"]
    assert len(gains) == 12
    assert all(row["by"] == "held" and row["value"] == 20.0 for row in gains)
    assert all("only (J + Ia)/kp, (Fv + kv)/kp, Fc/kp and Off/kp are known" in row["text"] for row in gains)
    assert not fit.verdict.sound


def test_check_says_before_the_fit_what_a_log_can_tell(tmp_path: Path) -> None:
    unknown = "delay_s = {}\nkp = { start = 20.0 }"
    found = didim.check(twin(tmp_path, ARM.format(option=""), commands(3, 6.0, steps=False), unknown=unknown))
    said = [item.sentence for item in found]
    assert any("kp is held" in sentence for sentence in said)
    assert any("hardly identifies Ia" in sentence for sentence in said)
    assert any(note.startswith("Fc: 95 % intervals of about") for note in found.notes)
    lively = didim.check(twin(tmp_path, ARM.format(option=""), commands(3, 12.0, steps=True)))
    assert not lively.items


def test_commands_have_ramps_holds_steps_and_chirps(tmp_path: Path) -> None:
    """With the values of their names, about the pose of the log and within 0.3 rad of it."""
    experiment = twin(tmp_path, ARM.format(option=""), commands(3, 4.0, steps=False))
    motion = excite_positions(experiment)
    middle = np.median(experiment.recordings[0].q, axis=0)
    q = motion.q - middle
    assert np.abs(q).max() == pytest.approx(0.3)
    speed = np.abs(np.diff(q, axis=0)) * RATE
    assert np.isclose(speed, 0.05, rtol=0.02).sum(axis=0).min() > 20.0 * RATE
    assert np.isclose(speed, 0.3, rtol=0.02).sum(axis=0).min() > 4.0 * RATE
    jumps = np.abs(np.diff(q, axis=0))
    for k in range(3):
        sizes = jumps[jumps[:, k] > 0.05, k]
        assert sorted(np.round(sizes, 6)) == [0.06] * 4 + [0.24] * 4
        still = np.flatnonzero(np.convolve(np.diff(q[:, k]) == 0.0, np.ones(140), "valid") == 140)
        for level in (-0.21, -0.105, 0.0, 0.105, 0.21):  # each held after a move up, and after one down
            begins = [n for n in still if n and abs(q[n, k] - level) < 1e-9 and q[n - 1, k] != q[n, k]]
            assert {bool(q[n - 1, k] < level) for n in begins} == {True, False}, level
    (chirp,) = (q[-round(11 * RATE) :, 1],)
    assert np.abs(chirp).max() == pytest.approx(0.15, rel=0.02)
    crossings = np.flatnonzero(np.diff(np.sign(chirp[: round(9.5 * RATE)])) != 0)
    assert RATE / (2.0 * np.diff(crossings).min()) >= 3.1


def test_commands_keep_clear_or_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    twin(tmp_path, ARM.format(option=""), commands(3, 4.0, steps=False))
    servos = "".join(f'<position joint="{name}" kp="20" kv="0.5"/>' for name in ("turn", "lift", "bend"))
    robot, settings = tmp_path / "robot.xml", tmp_path / "excite.toml"
    robot.write_text(
        ARM.format(option="").replace("</worldbody>", f"</worldbody><actuator>{servos}</actuator>")
    )
    paths = [tmp_path / name for name in ("motion.csv", "motion.json")]
    command = ["excite", str(robot), "--positions", "-o", str(paths[0]), "-o", str(paths[1])]
    assert main(command) == 0
    told = capsys.readouterr().out
    assert "neither self-collision nor the floor is checked" in told
    assert "Ia: 95 % intervals of about" in told
    table = np.loadtxt(paths[0], delimiter=",", skiprows=1)
    assert paths[0].read_text().splitlines()[0] == "t_s,turn,lift,bend"
    played = json.loads(paths[1].read_text())
    assert played["fps"] == 50.0
    actions = np.array([list(action.values()) for action in played["actions"]])
    assert list(played["actions"][0]) == ["turn.pos", "lift.pos", "bend.pos"]
    np.testing.assert_allclose(actions, np.degrees(table[:, 1:]), atol=2e-4)

    free = np.abs(table[:, 1:]).max()
    link = "[[collision]]\nlink = 3\nfrom_m = [0.0, 0.0, 0.0]\nto_m = [0.2, 0.0, 0.0]\nradius_m = 0.01\n"
    settings.write_text(f"schema = 1\n[workspace]\nfloor_m = -0.03\n{link}")
    assert main([*command[:2], str(settings), *command[2:]]) == 0
    tight = np.abs(np.loadtxt(paths[0], delimiter=",", skiprows=1)[:, 1:]).max()
    assert 0.05 < tight < free
    settings.write_text(f"schema = 1\n[workspace]\nfloor_m = 0.5\n{link}")
    assert main([*command[:2], str(settings), *command[2:]]) == 2
    assert "link 3 and the floor meet even in small motions" in capsys.readouterr().err
