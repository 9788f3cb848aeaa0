"""Friction of MuJoCo that is not as soft as by its defaults: a leg whose foot has little inertia beside that of its motors."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from didim.export.drives import drives_of
from didim.export.mjcf_edit import edit_mjcf
from didim.methods.cloe.cloe import CLOE
from didim.methods.positions.problem import Problem
from didim.methods.positions.replay import position_errors, replayed
from didim.studies.in_mujoco import validate_in_mujoco
from quadrupeds import followed, recorded

mujoco = pytest.importorskip("mujoco", reason="needs mujoco, the group 'test'")

TRUTH = {"armature": 0.012, "damping": 0.2, "frictionloss": 0.4}
LEG = """<mujoco><compiler angle="radian"/><option integrator="{integrator}"/>
<default><joint armature="{armature}" damping="{damping}" frictionloss="{frictionloss}"{soft}/>
<position kp="20" kv="0.6"/></default>
<worldbody><body pos="0 0 1"><inertial pos="0 0 -0.05" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/><joint name="pitch" axis="0 1 0"/>
<body><inertial pos="0.03 0 -0.02" mass="0.6" diaginertia="0.0003 0.0016 0.0017"/><joint name="roll" axis="1 0 0"/></body>
</body></worldbody><actuator><position joint="pitch"/><position joint="roll"/></actuator></mujoco>"""
EXPERIMENT = """
schema = 1
robot = "leg.xml"
[parameters]
links = "fixed"
[controller]
kind = "pd"
[reference]
kind = "recorded"
between_samples = "held"
[unknown]
delay_s = { max = 0.025 }
[[recording]]
name = "log"
rate_hz = 100
"""
EXPERIMENT += recorded("log.npz", "q", "r")


def fitted(
    folder: Path,
    soft: str = "",
    compiled: float = TRUTH["armature"],
    own: str = "",
    seconds: int = 6,
) -> didim.Identification:
    """Fit of a log with attributes of friction, whose armatures were changed after the file was compiled with others.

    `own` are the attributes of the user's file.
    """
    guess = {"armature": 0.01, "damping": 0.1, "frictionloss": 0.1, "soft": own, "integrator": "implicitfast"}
    (folder / "leg.xml").write_text(LEG.format(**guess))
    (folder / "leg.toml").write_text(EXPERIMENT)
    text = LEG.format(**{**TRUTH, "armature": compiled, "soft": soft, "integrator": "RK4"})
    model = mujoco.MjModel.from_xml_string(text)
    model.dof_armature[:] = TRUTH["armature"]
    rng, t = np.random.default_rng(1), np.arange(100 * seconds) / 100.0
    waves = 0.2 * np.sin(2.0 * np.pi * np.outer(t, rng.uniform(0.2, 1.0, 2)) + rng.uniform(0.0, 6.0, 2))
    jumps = np.repeat(rng.uniform(-0.2, 0.2, (2 * seconds, 2)), 50, axis=0)
    r = np.where((t % 3.0 > 1.5)[:, None], jumps, waves)
    q = followed(mujoco, model, r, 100.0, 0.008, 5e-4)
    np.savez(folder / "log.npz", q=q + 2e-5 * rng.standard_normal(q.shape), r=r)
    return didim.identify(didim.load_experiment(folder / "leg.toml"), CLOE(threads=1), verbose=False)


def of(fit: didim.Identification, kind: str) -> list[float]:
    """Estimates of both joints."""
    return [float(fit.beta[fit.names.index(f"{kind}{j}")]) for j in (1, 2)]


def test_the_default_softness_is_simulated(tmp_path: Path) -> None:
    fit = fitted(tmp_path)
    assert fit.verdict.sound
    assert [finding.code for finding in fit.evidence] == ["untold"]  # the factor of all torques
    assert "rest_s" not in fit.names
    for kind, value in zip(("Ia", "Fv", "Fc"), TRUTH.values(), strict=True):
        assert of(fit, kind) == pytest.approx([value] * 2, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("soft", "compiled"),
    [
        (' solreffriction="0.05 1"', TRUTH["armature"]),
        (' solreffriction="0.01 1"', TRUTH["armature"]),
        (' solreffriction="0.003 1"', TRUTH["armature"]),
        (' solimpfriction="0.8 0.95"', TRUTH["armature"]),
        (' solimpfriction="0.98 0.99" solreffriction="0.005 1"', TRUTH["armature"]),
        ("", 0.006),
        ("", 0.001),
    ],
)
def test_another_softness_is_estimated(tmp_path: Path, soft: str, compiled: float) -> None:
    """With MuJoCo's defaults the armature of the foot would be up to ten times too small, with a smooth sign some 10 % off."""
    fit = fitted(tmp_path, soft, compiled)
    assert fit.verdict.sound
    for kind, value in zip(("Ia", "Fv", "Fc"), TRUTH.values(), strict=True):
        assert of(fit, kind) == pytest.approx([value] * 2, rel=1e-3)
        for j in (1, 2):
            low, high = next((row["low"], row["high"]) for row in rows(fit) if row["name"] == f"{kind}{j}")
            assert low < value < high
    rest = float(fit.beta[fit.names.index("rest_s")])
    assert rest == pytest.approx(rest_of(soft), rel=0.1)


def rows(fit: didim.Identification) -> list[dict[str, Any]]:
    """Rows of the unknowns in the record."""
    return list(fit.settings["positions"]["rows"])


def rest_of(soft: str) -> float:
    """``dmax timeconst / 2`` of attributes of friction."""
    found = {"solreffriction": "0.02 1", "solimpfriction": "0.9 0.95"}
    found |= dict(re.findall(r'(\w+)="([^"]*)"', soft))
    return float(found["solimpfriction"].split()[1]) * float(found["solreffriction"].split()[0]) / 2.0


def test_the_softness_of_the_file_is_simulated_and_kept_by_an_export(tmp_path: Path) -> None:
    """With the softness of the log in the file, no other one is looked for; an export to another file writes it."""
    soft = ' solreffriction="0.005 1"'
    fit = fitted(tmp_path, soft, own=soft)
    assert fit.verdict.sound
    assert "rest_s" not in fit.names
    assert of(fit, "Ia") == pytest.approx([TRUTH["armature"]] * 2, rel=1e-3)
    kept, _ = edit_mjcf(drives_of(fit, "fit"), tmp_path / "leg.xml")
    assert kept.decode().count("solreffriction") == 1
    (tmp_path / "other.xml").write_text((tmp_path / "leg.xml").read_text().replace(soft, ""))
    content, _ = edit_mjcf(drives_of(fit, "fit"), tmp_path / "other.xml")
    model = mujoco.MjModel.from_xml_string(content.decode())
    assert model.dof_solref == pytest.approx(np.array([[0.005, 1.0]] * 2))
    assert model.dof_solimp[:, :2] == pytest.approx(np.array([[0.9, 0.95]] * 2))


def test_an_estimated_softness_is_exported_and_replayed(tmp_path: Path) -> None:
    fit = fitted(tmp_path, ' solreffriction="0.008 1" solimpfriction="0.95 0.95"')
    content, _ = edit_mjcf(drives_of(fit, "fit"), tmp_path / "leg.xml")
    (tmp_path / "new.xml").write_bytes(content)
    model = mujoco.MjModel.from_xml_string(content.decode())
    assert model.dof_solref[:, 0] == pytest.approx(np.array([0.008] * 2), rel=0.02)
    assert model.dof_solimp[:, 0] == pytest.approx(np.array([0.95] * 2), rel=0.01)
    replay = validate_in_mujoco(fit, didim.load_experiment(tmp_path / "leg.toml"), tmp_path / "new.xml")
    assert replay.ratio is not None
    assert replay.ratio < 1.1
    replays = replayed(fit, didim.load_experiment(tmp_path / "leg.toml"))
    assert position_errors(replays)["log"] == pytest.approx(list(np.array(replay.own)), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.002, 0.05])
def test_a_smooth_sign_of_another_width_is_near_its_intervals(tmp_path: Path, speed: float) -> None:
    """No law of the search is this friction: estimates are 1 to 2 % off, at most 1.5 half widths of their intervals."""
    fitted(tmp_path, seconds=9)
    experiment = didim.load_experiment(tmp_path / "leg.toml")
    truth = Problem(
        replace(
            experiment,
            robot=experiment.robot.with_smoothing([speed] * 2),
            simulation=replace(experiment.simulation, step_s=5e-4, fine_step_s=1e-4),
        )
    )
    theta = truth.start
    names = [column.name for column in truth.columns]
    for kind, value in zip(("Ia", "Fv", "Fc"), TRUTH.values(), strict=True):
        theta[[names.index(f"{kind}{j}") for j in (1, 2)]] = value
    theta[names.index("delay_s")] = 0.008
    with np.load(tmp_path / "log.npz") as log:
        q, r = log["q"], log["r"]
    (rollout,) = truth.rollouts
    q = truth.positions(rollout, theta[None])[0][0]
    np.savez(tmp_path / "log.npz", q=q + 2e-5 * np.random.default_rng(2).standard_normal(q.shape), r=r)
    fit = didim.identify(didim.load_experiment(tmp_path / "leg.toml"), CLOE(threads=1), verbose=False)
    off = []
    for kind, value in zip(("Ia", "Fv", "Fc"), TRUTH.values(), strict=True):
        for row in rows(fit):
            if row["kind"] == kind:
                assert row["value"] == pytest.approx(value, rel=0.025)
                off.append(abs(row["value"] - value) / (row["high"] - row["low"]) * 2.0)
    assert max(off) < 1.5
    assert np.median(off) < 1.0
