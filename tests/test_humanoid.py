"""A humanoid's legs, 12 joints in two limbs on a held pelvis, from commanded and measured positions: a simulated twin by MuJoCo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from quadrupeds import followed

mujoco = pytest.importorskip("mujoco", reason="needs mujoco, the group 'test'")

JOINTS = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
AXES = ("0 1 0", "1 0 0", "0 0 1", "0 1 0", "0 1 0", "1 0 0")
DROPS = (0.0, 0.05, 0.05, 0.25, 0.3, 0.0)
"""Height of each joint below the one before (m)."""
BODIES = (
    (1.3, 2e-3, 2e-3, 1e-3),
    (1.4, 2e-3, 2e-3, 2e-3),
    (1.6, 1e-2, 1e-2, 2e-3),
    (1.9, 1e-2, 1e-2, 2e-3),
    (0.1, 1e-4, 1e-4, 1e-4),
    (0.6, 3e-4, 1.6e-3, 1.7e-3),
)
"""Mass (kg) and moments of inertia (kg.m^2) of the bodies of a leg."""
KP, KV = (100.0, 100.0, 60.0, 120.0, 40.0, 30.0), (3.0, 3.0, 1.5, 4.0, 1.2, 0.8)
ARMATURE = (0.01, 0.025, 0.01, 0.025, 0.007, 0.006)
DAMPING, FRICTION = (0.6, 0.9, 0.4, 0.8, 0.3, 0.2), (0.9, 1.2, 0.5, 1.1, 0.4, 0.3)
RATE, DELAY_S = 100.0, 0.006


def robot_text(*, truth: bool) -> str:
    """The MJCF of the user, whose pelvis floats and whose drives are guesses; or that of the truth, which hangs on a rack."""
    legs, actuators = "", ""
    for side, y in (("left", 0.06), ("right", -0.06)):
        open_bodies = ""
        for j, joint in enumerate(JOINTS):
            name = f"{side}_{joint}_joint"
            drive = (ARMATURE[j], DAMPING[j], FRICTION[j]) if truth else (0.01, 0.1, 0.1)
            values = [*drive, *BODIES[j]]
            open_bodies += (
                f'<body name="{side}_{joint}" pos="0 {0 if j else y} {-DROPS[j]}">'
                '<inertial pos="0.01 0.005 -0.05" mass="{3}" diaginertia="{4} {5} {6}"/>'.format(*values)
                + f'<joint name="{name}" axis="{AXES[j]}" '
                'armature="{0}" damping="{1}" frictionloss="{2}"/>'.format(*values)
            )
            actuators += f'<position joint="{name}" kp="{KP[j]}" kv="{KV[j]}"/>'
        legs += open_bodies + "</body>" * len(JOINTS)
    free, steps = ("", "RK4") if truth else ('<freejoint name="base"/>', "implicitfast")
    return (
        f'<mujoco model="humanoid"><compiler angle="radian"/><option integrator="{steps}"/><worldbody>'
        f'<body name="pelvis" pos="0 0 1">{free}<inertial pos="0 0 0" mass="8" diaginertia="0.1 0.1 0.1"/>{legs}</body>'
        f"</worldbody><actuator>{actuators}</actuator></mujoco>"
    )


@pytest.mark.slow
def test_both_legs_come_out_of_one_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("humanoid.xml").write_text(robot_text(truth=False))
    rng, t, n = np.random.default_rng(4), np.arange(800) / RATE, 2 * len(JOINTS)
    waves = 0.15 * np.sin(2.0 * np.pi * np.outer(t, rng.uniform(0.3, 1.2, n)) + rng.uniform(0.0, 6.0, n))
    jumps = np.repeat(rng.uniform(-0.15, 0.15, (20, n)), 40, axis=0)
    r = np.where((t % 2.0 > 1.0)[:, None], jumps, waves)
    q = followed(mujoco, robot_text(truth=True), r, RATE, DELAY_S, 1e-3)
    q += 5e-5 * rng.standard_normal(q.shape)
    np.savez("pace.npz", time=t, dof_pos=q, des_dof_pos=r)

    assert main(["init", "humanoid.xml", "pace.npz", "-o", "log.toml"]) == 0
    assert main(["identify", "log.toml", "--method", "cloe", "--json", "fit.json"]) == 0
    fit = didim.Identification.load("fit.json")
    record = fit.settings["positions"]
    assert [limb["joints"] for limb in record["limbs"]] == [[1, 2, 3, 4, 5, 6], [7, 8, 9, 10, 11, 12]]
    assert fit.verdict.sound
    inside = []
    for row in record["rows"]:
        if row["kind"] in ("Ia", "Fv", "Fc"):
            leg = dict(zip(("Ia", "Fv", "Fc"), (ARMATURE, DAMPING, FRICTION), strict=True))[row["kind"]]
            value = leg[(row["joints"][0] - 1) % 6]
            inside.append(row["low"] <= value <= row["high"])
            assert row["value"] == pytest.approx(value, rel=0.005), row["name"]
    assert len(inside) == 36
    assert np.mean(inside) >= 0.9
    assert record["drive"]["delay_s"][0] == pytest.approx(DELAY_S, abs=1e-4)
