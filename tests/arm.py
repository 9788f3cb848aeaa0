"""A log of a planar arm whose robot, controller and reference are known: quick to simulate, and to identify back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import didim
from didim import Experiment
from didim.experiment.loop import closed_loop
from didim.experiment.specs import ReferenceSpec, SimulationSettings
from didim.loop.controller import Controller
from didim.loop.reference import Reference
from didim.signal.processing import SignalProcessing
from didim.studies.simulated_log import simulated_log

FILE = """\
schema = 1
name = "NAME"
robot = "planar2"
[[recording]]
name = "NAME"
rate_hz = 500
position = { file = "log.npz", variable = "q", unit = "rad", side = "joint" }
torque = { file = "log.npz", variable = "tau", unit = "N.m", side = "joint" }
reference = { file = "log.npz", variable = "q_ref", unit = "rad", side = "joint" }
[reference]
kind = "recorded"
[controller]
kind = "pd"
kp = KP
kv = KV
[simulation]
smoothing_rad_s = 0.02
step_s = 0.001
fine_step_s = 0.0005
start = "reference"
[signal]
cutoff_hz = 50
trim_start = 25
trim_end = 25
decimation = [10]
"""


def arm_log(
    seed: int, *, natural_frequency_hz: float = 10.0, rate_hz: float = 500.0, **settings: Any
) -> Experiment:
    """Log of a planar arm without noise that follows a recorded reference: quick to simulate."""
    robot = didim.load_robot("planar2")
    reference = Reference.random_fourier(
        harmonics=8,
        period_s=4.0,
        max_position=[1.5, 1.5],
        max_velocity=[4.0, 5.0],
        max_acceleration=[30.0, 40.0],
        seed=seed,
    )
    experiment = Experiment(
        name="arm",
        robot=robot,
        recordings=(),
        reference=reference,
        controller=Controller.tuned([natural_frequency_hz] * 2, [0.7] * 2, [1.0, 0.2]),
        signal=SignalProcessing(
            cutoff_hz=min(50.0, 0.4 * rate_hz),
            trim_start=25,
            trim_end=25,
            decimation=(round(rate_hz / 50.0),),
        ),
        simulation=SimulationSettings(
            rate_hz=rate_hz, smoothing=(0.02, 0.02), step_s=1e-3, fine_step_s=5e-4, start="reference"
        ),
        **settings,
    )
    made = simulated_log(experiment, robot.parameter_set("reference"), noise=False, refinement=1)
    (recording,) = made.recordings
    recording = replace(recording, name=f"log {seed}", q_ref=reference.at(recording.t)[0])
    return replace(made, recordings=(recording,), reference=ReferenceSpec("recorded", None, {}))


def noisy(log: Experiment, seed: int = 3) -> Experiment:
    """The log with noise on the torques."""
    (recording,) = log.recordings
    assert recording.tau is not None
    noise = np.random.default_rng(seed).standard_normal(recording.tau.shape) * [0.2, 0.1]
    return replace(log, recordings=(replace(recording, tau=recording.tau + noise),))


def arm_file(log: Experiment, data: Path, file: Path) -> Path:
    """Write a log to a folder and its experiment file, named as the file is."""
    (recording,) = log.recordings
    assert recording.tau is not None
    assert recording.q_ref is not None
    np.savez(data / "log.npz", q=recording.q, tau=recording.tau, q_ref=recording.q_ref)
    laws = closed_loop(log, recording).controller.laws
    text = FILE.replace("NAME", file.stem)
    text = text.replace("KP", str(laws[:, 0].tolist())).replace("KV", str(laws[:, 1].tolist()))
    file.write_text(text, encoding="utf-8")
    return file
