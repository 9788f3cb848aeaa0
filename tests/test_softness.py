"""Friction of MuJoCo that is not as soft as by its defaults: a leg whose foot has little inertia beside that of its motors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import didim
from didim.methods.cloe.cloe import CLOE
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


def fitted(folder: Path, soft: str = "", compiled: float = TRUTH["armature"]) -> didim.Identification:
    """Fit of a log with attributes of friction, whose armatures were changed after the file was compiled with others."""
    guess = {"armature": 0.01, "damping": 0.1, "frictionloss": 0.1, "soft": "", "integrator": "implicitfast"}
    (folder / "leg.xml").write_text(LEG.format(**guess))
    (folder / "leg.toml").write_text(EXPERIMENT)
    text = LEG.format(**{**TRUTH, "armature": compiled, "soft": soft, "integrator": "RK4"})
    model = mujoco.MjModel.from_xml_string(text)
    model.dof_armature[:] = TRUTH["armature"]
    rng, t = np.random.default_rng(1), np.arange(900) / 100.0
    waves = 0.2 * np.sin(2.0 * np.pi * np.outer(t, rng.uniform(0.2, 1.0, 2)) + rng.uniform(0.0, 6.0, 2))
    jumps = np.repeat(rng.uniform(-0.2, 0.2, (18, 2)), 50, axis=0)
    r = np.where((t % 3.0 > 1.5)[:, None], jumps, waves)
    q = followed(mujoco, model, r, 100.0, 0.008, 5e-4)
    np.savez(folder / "log.npz", q=q + 2e-5 * rng.standard_normal(q.shape), r=r)
    return didim.identify(didim.load_experiment(folder / "leg.toml"), CLOE(threads=1), verbose=False)


def test_the_default_softness_is_simulated(tmp_path: Path) -> None:
    fit = fitted(tmp_path)
    assert fit.verdict.sound
    assert not fit.evidence
    for kind, value in zip(("Ia", "Fv", "Fc"), TRUTH.values(), strict=True):
        assert [fit.beta[fit.names.index(f"{kind}{j}")] for j in (1, 2)] == pytest.approx(
            [value] * 2, rel=1e-3
        )


@pytest.mark.parametrize(
    ("soft", "compiled"),
    [
        (' solreffriction="0.05 1"', TRUTH["armature"]),
        (' solreffriction="0.026 1"', TRUTH["armature"]),
        (' solreffriction="0.015 1"', TRUTH["armature"]),
        (' solimpfriction="0.8 0.95"', TRUTH["armature"]),
        ("", 0.006),
        ("", 0.001),
    ],
)
def test_another_softness_is_doubtful(tmp_path: Path, soft: str, compiled: float) -> None:
    """With armatures that were 0.001 the fit has 0.0009 for the foot, where 0.012 is true."""
    fit = fitted(tmp_path, soft, compiled)
    (finding,) = [item for item in fit.evidence if item.code == "softness"]
    assert not fit.verdict.sound
    assert ("harder" in finding.sentence) == ("0.015" in soft)
