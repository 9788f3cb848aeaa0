"""Logs and files of `since_0_1_0.py`: made once by the present version, read by both, with keys that both have."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import didim
from didim import Controller, Experiment, Recording, Reference, SignalProcessing
from didim.experiment.loop import closed_loop
from didim.experiment.specs import SimulationSettings
from didim.studies.simulated_log import PACKAGED, packaged_experiment, simulated_log

Array = NDArray[np.float64]

PROJECT = Path(__file__).resolve().parent.parent
COUNT, COARSE = 2.0 * np.pi / 2**17, 2.0 * np.pi / 2**13
"""Steps of the encoders of row 1 (rad)."""

RECORDING = """
[[recording]]
name = "log"
rate_hz = {rate}
position = {{ file = "{data}", variable = "q", unit = "{unit}", side = "joint" }}
torque = {{ file = "{data}", variable = "tau", unit = "{force}", side = "joint" }}
"""
Q_REF = 'reference = {{ file = "{data}", variable = "q_ref", unit = "{unit}", side = "joint" }}\n'
ROBOT = 'schema = 1\nname = "{name}"\nrobot = "{robot}"\n'

SLIDE = """\
schema = 1
name = "slide"
gravity_m_s2 = [0.0, 0.0, 0.0]
[[joint]]
kind = "prismatic"
alpha_deg = 0.0
d_m = 0.0
theta_deg = 0.0
r_m = 0.0
limits = { position_m = [-2.0, 2.0], velocity_m_s = 3.0, force_n = 500.0 }
[friction]
coulomb = "tanh"
smoothing_m_s = 0.004
[parameters.reference]
Ia1 = 2.0
Fv1 = 5.0
Fc1 = 3.0
Off1 = 0.5
"""

UR = (
    (0.0, 0.0, 0.16),
    (1.0, 0.0, 0.0),
    (0.0, -0.6, 0.0),
    (0.0, -0.57, 0.17),
    (1.0, 0.0, 0.12),
    (-1.0, 0.0, 0.1),
)
"""Twist in right angles, distance and offset (m) of an arm like a UR."""


def write(
    folder: Path,
    name: str,
    log: Experiment,
    loop: str,
    *,
    robot: str = "planar2",
    unit: str = "rad",
    force: str = "N.m",
    q_ref: Array | None = None,
) -> None:
    """Write the only recording of a log and an experiment file that reads it."""
    (recording,) = log.recordings
    assert recording.tau is not None
    arrays = {"q": recording.q, "tau": recording.tau} | ({} if q_ref is None else {"q_ref": q_ref})
    np.savez(folder / f"{name}.npz", **arrays)  # type: ignore[arg-type]
    keys = {"rate": f"{recording.rate_hz:g}", "data": f"{name}.npz", "unit": unit, "force": force}
    text = ROBOT.format(name=name, robot=robot) + RECORDING.format(**keys)
    if q_ref is not None:
        text += Q_REF.format(**keys) + '[reference]\nkind = "recorded"\n'
    (folder / f"{name}.toml").write_text(text + loop, encoding="utf-8")


def pd(log: Experiment) -> str:
    """Return the gains of the controller of a log."""
    laws = closed_loop(log).controller.laws
    return f'[controller]\nkind = "pd"\nkp = {laws[:, 0].tolist()}\nkv = {laws[:, 1].tolist()}\n'


def noisy(log: Experiment, size: Sequence[float], seed: int) -> Experiment:
    """Return the log with white noise on its torques."""
    (recording,) = log.recordings
    assert recording.tau is not None
    noise = np.random.default_rng(seed).standard_normal(recording.tau.shape) * size
    return replace(log, recordings=(replace(recording, tau=recording.tau + noise),))


def fourier(seed: int, *, period_s: float = 4.0, harmonics: int = 8) -> Reference:
    return Reference.random_fourier(
        harmonics=harmonics,
        period_s=period_s,
        max_position=[1.5, 1.5],
        max_velocity=[4.0, 5.0],
        max_acceleration=[30.0, 40.0],
        seed=seed,
    )


def arm(folder: Path, name: str, frequency_hz: float) -> None:
    """Write a log of the planar arm behind a tight or a slack loop, with noise on the torques."""
    robot, reference = didim.load_robot("planar2"), fourier(1)
    experiment = Experiment(
        name=name,
        robot=robot,
        recordings=(),
        reference=reference,
        controller=Controller.tuned([frequency_hz] * 2, [0.7] * 2, [1.0, 0.2]),
        signal=SignalProcessing(cutoff_hz=50.0, trim_start=25, trim_end=25, decimation=(10,)),
        simulation=SimulationSettings(rate_hz=500.0, smoothing=(0.02, 0.02), step_s=1e-3, fine_step_s=5e-4),
    )
    log = simulated_log(experiment, robot.parameter_set("reference"), noise=False, refinement=1)
    loop = pd(log) + (
        '[simulation]\nsmoothing_rad_s = 0.02\nstep_s = 0.001\nfine_step_s = 0.0005\nstart = "reference"\n'
        "[signal]\ncutoff_hz = 50\ntrim_start = 25\ntrim_end = 25\ndecimation = [10]\n"
    )
    q_ref = reference.at(log.recordings[0].t)[0]
    write(folder, name, noisy(log, [0.2, 0.1], 3), loop, q_ref=q_ref)


def one_joint_at_a_time(folder: Path) -> None:
    """Row 1: joint 2 rests on one count of its encoder in nine tenths of the log."""
    robot, t = didim.load_robot("planar2"), np.arange(0.0, 10.0, 0.002)
    first = 0.8 * np.sin(2.0 * np.pi * 0.5 * t) + 0.3 * np.sin(2.0 * np.pi * 1.7 * t)
    inside = np.clip(t - 9.0, 0.0, 1.0)
    second = 0.6 * np.sin(4.0 * np.pi * inside) * np.sin(np.pi * inside) ** 2
    experiment = Experiment(
        name="rest",
        robot=robot,
        recordings=(),
        reference=Reference.sampled(np.column_stack([first, second]), rate_hz=500.0),
        controller=Controller.tuned([10.0, 30.0], [0.7] * 2, [1.0, 0.2]),
        signal=SignalProcessing(cutoff_hz=60.0, trim_start=50, trim_end=50, decimation=(10,)),
        simulation=SimulationSettings(rate_hz=500.0, smoothing=(0.05, 0.05), step_s=1e-3, fine_step_s=5e-4),
    )
    log = simulated_log(experiment, robot.parameter_set("reference"), noise=False, refinement=2)
    (recording,) = log.recordings
    steps = np.array([COUNT, COARSE])
    rounded = replace(recording, q=np.round(recording.q / steps) * steps)
    loop = pd(log) + (
        "[simulation]\nsmoothing_rad_s = 0.05\nstep_s = 0.001\nfine_step_s = 0.0005\n"
        "[signal]\ncutoff_hz = 60\ntrim_start = 50\ntrim_end = 50\ndecimation = [10]\n"
    )
    q_ref = np.column_stack([first, second])[: len(recording.q)]
    write(folder, "rest", noisy(replace(log, recordings=(rounded,)), [0.2, 0.1], 1), loop, q_ref=q_ref)


def cut(folder: Path) -> None:
    """Row 2: a log under PID that begins two seconds after its start, without noise."""
    robot = didim.load_robot("planar2").with_smoothing([0.05, 0.05])
    reference = fourier(3, period_s=5.0, harmonics=5)
    kp, kv, ki = [300.0, 60.0], [40.0, 5.0], [600.0, 150.0]
    run = didim.simulate(
        robot,
        robot.parameter_set("reference"),
        reference,
        Controller.pid(kp, kv, ki),
        step=2e-4,
        fine_step=2e-4,
        rate_hz=1000.0,
    )
    recording = Recording.from_arrays(run.q[2000:], run.tau[2000:], rate_hz=1000.0)
    loop = (
        f'[controller]\nkind = "pid"\nkp = {kp}\nkv = {kv}\nki = {ki}\n'
        "[simulation]\nsmoothing_rad_s = 0.05\nstep_s = 0.0002\nfine_step_s = 0.0002\n[signal]\n"
    )
    log = Experiment(name="cut", robot=robot, recordings=(recording,))
    write(folder, "cut", log, loop, q_ref=reference.at(run.t)[0][2000:])


def windows(folder: Path) -> None:
    """Row 3: torques of the model along a smooth motion, for eight windows."""
    robot = didim.load_robot("planar2").with_smoothing((0.2, 0.2))
    motion = fourier(2, period_s=8.0, harmonics=6).at(np.arange(8000) / 1000.0)
    tau = didim.inverse_dynamics(robot, *motion, robot.parameter_set("reference"))
    np.savez(folder / "windows.npz", q=motion[0], tau=tau)


def creeping(folder: Path) -> None:
    """Row 11: a slide that swings about a ramp; a heavily damped start only creeps forwards."""
    (folder / "slide.toml").write_text(SLIDE, encoding="utf-8")
    robot = didim.load_robot(folder / "slide.toml")
    t = np.arange(0.0, 4.001, 0.002)[:, None]
    q_ref = 0.2 * t + 0.04 * np.sin(3.0 * np.pi * t)
    experiment = Experiment(
        name="creeping",
        robot=robot,
        recordings=(),
        reference=Reference.sampled(q_ref, rate_hz=500.0),
        controller=Controller.tuned([3.0], [0.7], [2.0]),
        signal=SignalProcessing(cutoff_hz=50.0, trim_start=300, trim_end=25, decimation=(10,)),
        simulation=SimulationSettings(rate_hz=500.0, step_s=5e-4),
    )
    log = simulated_log(experiment, robot.parameter_set("reference"), noise=False, refinement=1)
    loop = pd(log) + (
        "[simulation]\nstep_s = 0.0005\n"
        "[signal]\ncutoff_hz = 50\ntrim_start = 300\ntrim_end = 25\ndecimation = [10]\n"
    )
    q_ref = q_ref[: len(log.recordings[0].q)]
    log = noisy(log, [0.2], 0)
    write(folder, "creeping", log, loop, robot="slide.toml", unit="m", force="N", q_ref=q_ref)


def hold(folder: Path) -> None:
    """Row 13: the planar arm of the examples, whose controller runs at 1 kHz, without noise."""
    source = PROJECT / "examples" / "planar2_simulation.toml"
    experiment = didim.load_experiment(source)
    log = simulated_log(experiment, experiment.robot.parameter_set("reference"), noise=False)
    (recording,) = log.recordings
    assert recording.tau is not None
    np.savez(folder / "hold.npz", q=recording.q, tau=recording.tau)
    keys = {"rate": f"{recording.rate_hz:g}", "data": "hold.npz", "unit": "rad", "force": "N.m"}
    signal = "[signal]\ncutoff_hz = 100\ntrim_start = 25\ntrim_end = 25\ndecimation = [5]\n"
    text = source.read_text(encoding="utf-8") + RECORDING.format(**keys) + signal
    (folder / "hold.toml").write_text(text, encoding="utf-8")


def tx40(folder: Path) -> None:
    """Row 12: the packaged experiment with the filter of 60 Hz."""
    experiment = packaged_experiment("tx40")
    (recording,) = simulated_log(experiment, experiment.robot.parameter_set("didim")).recordings
    assert recording.tau is not None
    np.savez(folder / "sound.npz", q=recording.q, tau=recording.tau)
    text = (PACKAGED / "tx40.toml").read_text(encoding="utf-8")
    text = re.sub(r"(?m)^cutoff_hz = .*$", "cutoff_hz = 60", text)
    keys = {"rate": f"{recording.rate_hz:g}", "data": "sound.npz", "unit": "rad", "force": "N.m"}
    (folder / "sound.toml").write_text(text + RECORDING.format(**keys), encoding="utf-8")


def robots(folder: Path) -> None:
    """Rows 15 and 16: rounded right angles, and a planar arm of the same name with a longer link."""
    for digits in ("1.5708", "1.5707963267948966"):
        lines = ['schema = 1\nname = "ur"\ngravity_m_s2 = [0, 0, -9.81]\n']
        for turns, d, r in UR:
            alpha = "0" if turns == 0.0 else digits if turns > 0.0 else f"-{digits}"
            lines.append(f'[[joint]]\nkind = "revolute"\nalpha_rad = {alpha}\nd_m = {d}\nr_m = {r}\n')
        (folder / f"ur_{digits}.toml").write_text("".join(lines), encoding="utf-8")
    packaged = PROJECT / "python" / "didim" / "packaged" / "robots" / "planar2.toml"
    text = packaged.read_text(encoding="utf-8").replace("d_m = 0.5", "d_m = 0.9")
    (folder / "longer.toml").write_text(text, encoding="utf-8")
    experiment = (folder / "arm.toml").read_text(encoding="utf-8")
    experiment = experiment.replace('robot = "planar2"', 'robot = "longer.toml"')
    (folder / "arm_longer.toml").write_text(experiment, encoding="utf-8")


def recipes(folder: Path) -> None:
    """Write the recipes of the published figures for both versions: where a default is another one, the key says the old one."""
    for name in ("emps", "tx40_log_best"):
        text = (PROJECT / "examples" / f"{name}.toml").read_text(encoding="utf-8")
        if "uncertainty" not in text:
            text = text.replace("[least_squares]\n", '[least_squares]\nuncertainty = "decimated"\n')
        (folder / f"{name}_now.toml").write_text(text, encoding="utf-8")
        old = re.sub(r"(?m)^ends = .*\n", "", text)
        old = old.replace('uncertainty = "white"', "decimation_corrected = false")
        old = old.replace('uncertainty = "decimated"', "decimation_corrected = true")
        (folder / f"{name}_old.toml").write_text(old, encoding="utf-8")


def write_logs(folder: Path) -> None:
    """Write every log and file that the rows read."""
    arm(folder, "arm", 10.0)
    arm(folder, "slack", 2.0)
    for make in (one_joint_at_a_time, cut, windows, creeping, hold, tx40, robots, recipes):
        make(folder)
