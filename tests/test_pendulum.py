"""One servo with pendulums of several masses and lengths: short logs with gains and payloads of their own, some of them spoilt."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import ExperimentError, FitError
from didim.loop.servos import Held, ServoLoop, Servos
from didim.methods.cloe.cloe import CLOE
from didim.result.positions.record import PositionRecord
from quadrupeds import recorded

RATE, STEP = 100.0, 2.0 * np.pi / 4096
GAINS, LOADS = (4.0, 10.0), {"light": (0.3, 0.15), "heavy": (0.5, 0.1)}
TRUTH = {"Ia": 0.012, "Fv": 0.25, "Fc": 0.13}
DELAY_S = 0.0087
PENDULUM = """<mujoco><worldbody><body name="arm" pos="0 0 1">
<inertial pos="0 0 -0.05" mass="0.06" diaginertia="0.00006 0.00006 0.000002"/>
<joint name="servo" axis="0 1 0" armature="0.005" damping="0.1" frictionloss="0.05"/>{load}</body></worldbody>
<actuator><position joint="servo" kp="5" kv="0.05"/></actuator></mujoco>"""
LOAD = """<body name="load" pos="0 0 -{length}"><inertial pos="0 0 0" mass="{mass}" diaginertia="1e-5 1e-5 1e-5"/></body>"""
EXPERIMENT = """
schema = 1
robot = "pendulum.xml"
[friction]
coulomb = "tanh"
smoothing_rad_s = 0.02
[parameters]
links = "fixed"
[reference]
kind = "recorded"
between_samples = "held"
[controller]
kind = "pd"
kp = 5.0
kv = 0.05
[unknown]
delay_s = { max = 0.025 }
"""
RECORDING = """
[[recording]]
name = "{name}"
role = "{role}"
rate_hz = 100
kp = {kp}
payload = "{payload}"
"""


def commands(kind: int, t: np.ndarray) -> np.ndarray:
    """A sweep of growing frequency, a lift that drops, and steps."""
    return np.asarray(
        [
            np.sin(t**2),
            np.where(t < 3.0, 0.4 * t, 0.0),
            0.8 * np.sign(np.sin(2.5 * t)) * (t > 0.3),
        ][kind]
    )


def simulated(text: str, folder: Path, kp: float, r: np.ndarray) -> np.ndarray:
    """Encoder counts of a pendulum that is one body with its load."""
    (folder / "whole.xml").write_text(text)
    robot = didim.load_robot(folder / "whole.xml").with_smoothing([0.02])
    x = np.array(next(iter(robot.sets.values())))
    for kind, value in TRUTH.items():
        x[robot.parameter_names.index(f"{kind}1")] = value
    held = Held(r[:, None], RATE)
    loop = ServoLoop(robot, held, held.values, step_s=2.5e-4, fine_step_s=2.5e-4)
    numbers = {"kp": kp, "kv": 0.05, "saturation": np.inf, "delay_s": DELAY_S, "lag_s": 0.0, "bias_rad": 0.0}
    rows: dict[str, Any] = {kind: np.full((1, 1), value) for kind, value in numbers.items()}
    found, completed = loop.run(x[None], Servos(**rows, q=r[:1, None], dq=np.zeros((1, 1))))
    assert completed.all()
    return np.asarray(np.round(found[0] / STEP) * STEP)


@pytest.fixture
def logs(tmp_path: Path) -> didim.Experiment:
    """Twelve logs of 5 s, three of them held out."""
    (tmp_path / "pendulum.xml").write_text(PENDULUM.format(load=""))
    text, t = EXPERIMENT, np.arange(500) / RATE
    for name, (mass, length) in LOADS.items():
        text += f"[payload.{name}]\nmass_kg = {mass}\ncom_m = [0, 0, {-length}]\n"
        text += "inertia_kg_m2 = [1e-5, 0, 0, 1e-5, 0, 1e-5]\n"
    for number, (kp, name, kind) in enumerate(itertools.product(GAINS, LOADS, range(3))):
        r, (mass, length) = commands(kind, t), LOADS[name]
        q = simulated(PENDULUM.format(load=LOAD.format(mass=mass, length=length)), tmp_path, kp, r)
        np.savez(tmp_path / f"log{number}.npz", q=q, r=r[:, None])
        role = "held-out" if number % 4 == 3 else "fit"
        text += RECORDING.format(name=f"log{number}", role=role, kp=kp, payload=name)
        text += recorded(f"log{number}.npz", "q", "r")
    (tmp_path / "logs.toml").write_text(text)
    return didim.load_experiment(tmp_path / "logs.toml")


def fitted(experiment: didim.Experiment) -> tuple[didim.Identification, PositionRecord]:
    fit = didim.identify(experiment, CLOE(threads=1), verbose=False)
    record = PositionRecord.of(fit.settings)
    assert record is not None
    for kind, value in TRUTH.items():
        assert fit.beta[fit.names.index(f"{kind}1")] == pytest.approx(value, rel=0.01)
    assert fit.beta[fit.names.index("delay_s")] == pytest.approx(DELAY_S, abs=1e-4)
    assert max(record.errors["after"] or ()) < 1.2 * STEP / np.sqrt(12.0)
    return fit, record


@pytest.mark.slow
def test_gains_and_payloads_of_logs(logs: didim.Experiment, tmp_path: Path) -> None:
    fit, record = fitted(logs)
    assert fit.verdict.sound
    assert max(record.errors["held_out"] or ()) < 1.2 * STEP / np.sqrt(12.0)
    pytest.importorskip("mujoco")
    fit.save(tmp_path / "fit.json")
    paths = [
        str(tmp_path / name) for name in ("fit.json", "pendulum.xml", "new.xml", "logs.toml", "replay.json")
    ]
    assert main(["export", paths[0], "--mjcf", paths[1], "-o", paths[2]]) == 0
    assert (
        main(["validate", paths[0], paths[3], "--mujoco", paths[2], "--step", "0.001", "--json", paths[4]])
        == 0
    )
    replay = json.loads(Path(paths[4]).read_text())
    # Its friction is another law. Without the gains and loads of the logs 260 mrad are left.
    assert max(replay["after"]) < 4e-3


def test_spoilt_logs_are_left_out(logs: didim.Experiment, tmp_path: Path) -> None:
    """An encoder that slips, one that stands still for a while, and commands of another time."""
    for name in ("log2", "log5", "log9"):
        with np.load(tmp_path / f"{name}.npz") as arrays:
            q, r = arrays["q"].copy(), arrays["r"].copy()
        if name == "log2":
            q[250:] += 0.15
        elif name == "log5":
            q[150:350] = q[150]
        else:
            r = np.roll(r, 30)
        np.savez(tmp_path / f"{name}.npz", q=q, r=r)
    fit, _ = fitted(didim.load_experiment(tmp_path / "logs.toml"))
    held = [item for item in fit.evidence if item.code == "held"]
    assert {name for item in held for name in item.recordings} == {"log2", "log5", "log9"}
    assert all("of 'log" in item.sentence for item in held)


def test_payloads_that_are_not_known_are_refused(logs: didim.Experiment, tmp_path: Path) -> None:
    text = (tmp_path / "logs.toml").read_text()
    (tmp_path / "a.toml").write_text(text.replace("mass_kg = 0.3\n", ""))
    with pytest.raises(FitError, match=r"needs mass_kg, com_m and inertia_kg_m2 of \[payload.light\]"):
        fitted(didim.load_experiment(tmp_path / "a.toml"))
    (tmp_path / "b.toml").write_text(text.replace("kp = 4.0\n", 'kp = 4.0\nfriction = "own"\n', 1))
    with pytest.raises(FitError, match="no own friction"):
        fitted(didim.load_experiment(tmp_path / "b.toml"))
    (tmp_path / "c.toml").write_text(text.replace("kp = 4.0\n", "kp = 0.0\n", 1))
    with pytest.raises(ExperimentError, match="kp must be above 0"):
        didim.load_experiment(tmp_path / "c.toml")
