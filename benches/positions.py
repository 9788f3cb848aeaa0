"""A hobby arm whose truth MuJoCo simulates, logged as data sets of positions are: how near CLOE comes, and how sure it is.

    python benches/positions.py [--seeds 3] [--step 1e-4]
    python benches/positions.py --fleet 20
    python benches/positions.py --quadruped FOLDER

needs the package mujoco. Six position actuators with armature, damping, frictionloss, gains, a torque limit of 3.35 N.m and a
delay of 15 ms follow smooth moves and, a third of the time, steps that saturate; 60 s at 50 Hz are logged, to 0.088 degrees.
Printed are, kind by kind, the errors of the estimates (rms and largest, in per cent of the truth), the share of the truth inside
the 95 % intervals, and processor seconds.

A fleet has armature, damping and frictionloss of its own in each arm, drawn from known spreads; one fit has a log of half of its
arms. Printed is how much of another motion of the others lies between the 5 and 95 % of 200 draws of that fit, and between all of
them, to half a count of the encoder. A third of it is tried in ``tests/test_samples.py``.
"""

from __future__ import annotations

import argparse
import copy
import re
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from time import process_time

import mujoco
import numpy as np
from mujoco import minimize, rollout

import didim
from didim.methods.cloe.cloe import CLOE
from didim.methods.positions.problem import Problem
from didim.result.positions.record import PositionRecord

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from quadrupeds import recorded

RATE_HZ, SECONDS, DELAY_S, QUANTUM, LIMIT = 50.0, 60.0, 0.015, 2.0 * np.pi / 4096, 3.35
KINDS = ("Ia", "Fv", "Fc", "kp", "kv")
BODIES = (  # name, position, axis, mass, centre, principal inertias
    ("pan", "0 0 0.05", "0 0 1", 0.15, "0.01 0 0.03", "1e-4 1e-4 9e-5"),
    ("lift", "0.03 0 0.05", "0 1 0", 0.10, "0.02 0 0.06", "1.6e-4 1.7e-4 3e-5"),
    ("elbow", "0.03 0 0.11", "0 1 0", 0.10, "0.07 0 0.01", "3e-5 1.5e-4 1.6e-4"),
    ("flex", "0.135 0 0", "0 1 0", 0.08, "0.03 0 0", "2e-5 5e-5 5e-5"),
    ("roll", "0.06 0 0", "1 0 0", 0.09, "0.02 0.01 0", "4e-5 4e-5 5e-5"),
    ("jaw", "0.03 0.02 0", "0 0 1", 0.03, "0.04 0 0", "5e-6 3e-5 3e-5"),
)


SPREAD = {"Ia": 0.15, "Fv": 0.15, "Fc": 0.2, "kp": 0.0, "kv": 0.0}
"""Standard deviations of the arms of a fleet, as shares of the mean."""


def fleet(
    folder: Path, arms: int, seconds: float, draws: int
) -> tuple[didim.Identification, list[dict[str, np.ndarray]], np.ndarray]:
    """Fit half of a fleet, and return the fit, the truth of these arms, and how much of the others' motion is within its draws.

    The shares are those between 5 and 95 % and between all, (n_arms // 2, 2, 6).
    """
    random, mean = (
        np.random.default_rng(5),
        {kind: np.full(6, values.mean()) for kind, values in truth().items()},
    )
    every = [
        {kind: mean[kind] * (1.0 + SPREAD[kind] * random.standard_normal(6)) for kind in KINDS}
        for _ in range(arms)
    ]
    known, others = every[: arms // 2], every[arms // 2 :]
    text, recording = EXPERIMENT.split("[[recording]]")[0], ""
    for kind, guess in (("kp", "15.0"), ("kv", "0.8")):
        text = text.replace(f"{kind} = {guess}", f"{kind} = {mean[kind][0]}").replace(
            f"{kind} = {{ start = {guess} }}\n", ""
        )
    for k, p in enumerate(known):
        r = commands(k, seconds)
        np.savez(folder / f"log{k}.npz", q=simulated(p, r, 5e-4), r=r)
        recording += f'[[recording]]\nname = "log{k}"\nrate_hz = 50\n' + recorded(f"log{k}.npz", "q", "r")
    (folder / "arm.toml").write_text(text + recording)
    (folder / "arm.xml").write_text(mjcf(mean))
    fit = didim.identify(didim.load_experiment(folder / "arm.toml"), CLOE(threads=1), verbose=False)
    samples, r = fit.samples(draws), commands(99, seconds)
    values = {kind: samples.values[:, np.array(samples.kinds) == kind] for kind in (*KINDS, "delay_s")}
    drawn = [
        simulated(
            {kind: values[kind][k] if values[kind].size else mean[kind] for kind in KINDS},
            r,
            5e-4,
            float(values["delay_s"][k, 0]),
            0.0,
        )
        for k in range(draws)
    ]
    low, high = np.percentile(drawn, [5, 95], axis=0), (np.min(drawn, axis=0), np.max(drawn, axis=0))
    shares = []
    for p in others:
        q = simulated(p, r, 5e-4)
        shares.append([(np.abs(q - np.clip(q, *band)) <= 0.5 * QUANTUM).mean(axis=0) for band in (low, high)])
    return fit, known, np.array(shares)


def truth() -> dict[str, np.ndarray]:
    """Parameters of the drives by kind, (6,) each."""
    spread = np.random.default_rng(1).uniform(0.8, 1.25, (5, 6))
    return dict(zip(KINDS, (np.array([0.028, 0.6, 0.15, 17.8, 0.5])[:, None] * spread), strict=True))


def mjcf(p: dict[str, np.ndarray]) -> str:
    """The arm as MJCF, with its drives."""
    opened, actuators = "", ""
    for k, (name, place, axis, mass, centre, inertia) in enumerate(BODIES):
        opened += (
            f'<body name="{name}" pos="{place}"><inertial pos="{centre}" mass="{mass}" diaginertia="{inertia}"/>'
            f'<joint name="{name}" axis="{axis}" armature="{p["Ia"][k]}" damping="{p["Fv"][k]}" frictionloss="{p["Fc"][k]}"/>'
        )
        actuators += (
            f'<position joint="{name}" kp="{p["kp"][k]}" kv="{p["kv"][k]}" forcerange="-{LIMIT} {LIMIT}"/>'
        )
    closed = "</body>" * len(BODIES)
    return f"<mujoco><worldbody>{opened}{closed}</worldbody><actuator>{actuators}</actuator></mujoco>"


def commands(seed: int, seconds: float = SECONDS) -> np.ndarray:
    """Smooth moves, and steps in a third of the log, (n, 6)."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    f = rng.uniform(0.1, 1.5, (12, 6))
    phase = rng.uniform(0.0, 2.0 * np.pi, (12, 1, 6))
    smooth = 0.5 * (np.sin(2.0 * np.pi * f[:, None] * t[:, None] + phase) * 0.25 / np.sqrt(f[:, None])).sum(
        axis=0
    )
    steps = np.repeat(rng.uniform(-0.35, 0.35, (int(seconds), 6)), int(RATE_HZ), axis=0)
    r = np.where((t % 15.0 < 5.0)[:, None], steps, smooth)
    r[:25] = 0.0
    return r


def simulated(
    p: dict[str, np.ndarray], r: np.ndarray, step: float, delay_s: float = DELAY_S, quantum: float = QUANTUM
) -> np.ndarray:
    """Measured positions by MuJoCo, (n, 6)."""
    model = mujoco.MjModel.from_xml_string(mjcf(p))
    model.opt.timestep, model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    per_sample = round(1.0 / (RATE_HZ * step))
    late = np.arange(len(r) * per_sample) * step - delay_s
    commanded = r[np.floor(late * RATE_HZ + 1e-9).astype(int).clip(0)]
    start = np.zeros((1, 1 + 2 * r.shape[1]))
    states, _ = rollout.rollout([model], [mujoco.MjData(model)], start, commanded[None])
    out = np.vstack([np.zeros(6), states[0, per_sample - 1 : -1 : per_sample, 1:7]])
    return np.asarray(np.round(out / quantum) * quantum if quantum else out)


EXPERIMENT = """
schema = 1
name = "arm"
robot = "arm.xml"
[parameters]
links = "fixed"
dropped = ["Off"]
[controller]
kind = "pd"
kp = 15.0
kv = 0.8
saturation_n_m = 3.35
[reference]
kind = "recorded"
between_samples = "held"
[unknown]
Ia = { start = 0.05, min = 0.002 }
Fv = { start = 0.8 }
Fc = { start = 0.1 }
kp = { start = 15.0 }
kv = { start = 0.8 }
delay_s = { start = 0.02, max = 0.06 }
[[recording]]
name = "log"
rate_hz = 50
"""
EXPERIMENT += recorded("log.npz", "q", "r")


def fitted(folder: Path, p: dict[str, np.ndarray]) -> didim.Identification:
    """The estimate of a log in a folder."""
    (folder / "arm.toml").write_text(EXPERIMENT)
    (folder / "arm.xml").write_text(mjcf(p))
    return didim.identify(didim.load_experiment(folder / "arm.toml"), CLOE(threads=1), verbose=False)


QUADRUPED = """
schema = 1
name = "go2"
robot = "go2.xml"
[friction]
coulomb = "tanh"
smoothing_rad_s = 0.01
[parameters]
links = "fixed"
[controller]
kind = "pd"
kp = 20.0
kv = 1.5
[reference]
kind = "recorded"
between_samples = "held"
[unknown]
delay_s = { start = 0.005, max = 0.025 }
[[recording]]
name = "log"
rate_hz = 200
"""
QUADRUPED += recorded("traj_0.pt", "dof_pos", "des_dof_pos")
KP, KV, RATE = 20.0, 1.5, 200.0
BOUNDS = np.array(
    [[1e-5, 1.0]] * 12 + [[0.0, 7.0]] * 12 + [[0.0, 3.0]] * 12 + [[-3.0, 3.0]] * 12 + [[0.0, 0.025]]
)


class Rollouts:
    """The same cost by MuJoCo's rollouts of the whole robot, base welded: Ia, Fv, Fc, Off of 12 joints, and the delay."""

    def __init__(self, folder: Path, q: np.ndarray, r: np.ndarray) -> None:
        text = (folder / "go2.xml").read_text()
        for pattern in (
            r"<geom[^>]*?mesh=[^>]*?/>",
            r"<mesh [^>]*?/>",
            r"<freejoint[^>]*?/>",
            r"<keyframe>.*?</keyframe>",
        ):
            text = re.sub(pattern, "", text, flags=re.DOTALL)
        self.model, self.q, self.r, self.runs = mujoco.MjModel.from_xml_string(text), q, r, 0
        m = self.model
        m.opt.timestep, m.opt.integrator = 1.0 / RATE, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
        m.actuator_gaintype[:], m.actuator_biastype[:] = 0, 1
        m.actuator_gainprm[:, 0], m.actuator_biasprm[:, 1], m.actuator_biasprm[:, 2] = KP, -KP, -KV
        m.actuator_ctrllimited[:] = m.actuator_forcelimited[:] = 0

    def residual(self, thetas: np.ndarray, steps: int = 1) -> np.ndarray:
        """Return errors of candidates, (n_rows, n_candidates), with so many steps a sample."""
        self.model.opt.timestep = 1.0 / (RATE * steps)
        models, controls, states = [], [], []
        for theta in thetas.T:
            m = copy.copy(self.model)
            m.dof_armature[:], m.dof_damping[:], m.dof_frictionloss[:] = (
                theta[:12],
                theta[12:24],
                theta[24:36],
            )
            models.append(m)
            # A constant torque is a shift of what the servo follows; a held sample that is late is a mean over the step.
            share = theta[48] * RATE
            back = int(share)
            late = [self.r[np.clip(np.arange(len(self.r)) - back - k, 0, None)] for k in (0, 1)]
            controls.append((1.0 - (share - back)) * late[0] + (share - back) * late[1] - theta[36:48] / KP)
            controls[-1] = np.repeat(controls[-1], steps, axis=0)
            states.append(np.concatenate([[0.0], self.q[0], np.zeros(12)]))
        self.runs += len(models)
        out, _ = rollout.rollout(models, [mujoco.MjData(self.model)], np.array(states), np.array(controls))
        simulated = np.concatenate(
            [np.array(states)[:, None, 1:13], out[:, steps - 1 : -1 : steps, 1:13]], axis=1
        )
        return np.asarray((simulated - self.q)[:, 100:].reshape(len(models), -1).T)


MODELS = (  # title, dropped, unknowns
    ("PACE's model", '["Off"]', "bias_rad = { min = -0.1, max = 0.1 }"),
    ("with Off", "[]", ""),
    (
        "with Off, from the centre of PACE's bounds",
        "[]",
        "Ia = { start = 0.5, max = 1.0 }\nFv = { start = 3.5, max = 7.0 }\nFc = { start = 0.5, max = 3.0 }",
    ),
)
HALF_S = 11.75
"""Half of the log: the triangles of the second one are faster."""


def quadruped_log(
    folder: Path, dropped: str = "[]", unknown: str = "", halves: bool = False
) -> didim.Experiment:
    """The experiment of the quadruped's log, or of its fast half with the slow one held out."""
    text = QUADRUPED.replace("go2.xml", str(folder / "go2.xml"))
    text = text.replace('links = "fixed"', f'links = "fixed"\ndropped = {dropped}')
    text = text.replace("[[recording]]", f"{unknown}\n[[recording]]")
    if unknown.startswith("Ia"):
        text = text.replace("start = 0.005", "start = 0.0125")
    if halves:
        head, recording = text.split("[[recording]]")
        fast = recording.replace("rate_hz", f"windows_s = [[{HALF_S}, 23.4]]\nrate_hz")
        slow = recording.replace('"log"', '"slow"').replace(
            "rate_hz", f'role = "held-out"\nwindows_s = [[0.0, {HALF_S}]]\nrate_hz'
        )
        text = f"{head}[[recording]]{fast}\n[[recording]]{slow}"
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "go2.toml").write_text(text)
        return didim.load_experiment(Path(name) / "go2.toml", data=folder)


def fit_of(experiment: didim.Experiment) -> tuple[didim.Identification, PositionRecord, float]:
    """A fit, its record and its processor seconds."""
    clock = process_time()
    fit = didim.identify(experiment, CLOE(threads=1), verbose=False)
    seconds = process_time() - clock
    record = PositionRecord.of(fit.settings)
    assert record is not None
    return fit, record, seconds


def quadruped(folder: Path) -> None:
    """Print what fits of the quadruped's log take, ours and MuJoCo's least squares on the same cost."""
    for title, dropped, unknown in MODELS:
        experiment = quadruped_log(folder, dropped, unknown)
        fit, record, seconds = fit_of(experiment)
        print(f"{title}: {1e3 * rms(record.errors['after']):.3f} mrad, {fit.n_iterations} iterations, "
              f"{fit.n_simulations} simulations of a leg, {seconds:.2f} s", flush=True)  # fmt: skip
    _, record, _ = fit_of(quadruped_log(folder, halves=True))
    told = " ".join(f"{1e3 * value:.1f}" for value in list(record.errors["held_out"] or ())[3:6])
    print(f"front right leg, fitted on the fast half, tried on the slow one: {told} mrad", flush=True)
    experiment = quadruped_log(folder)
    fit, record, seconds = fit_of(experiment)
    (recording,) = experiment.recordings
    peer = Rollouts(folder, np.array(recording.q), np.array(recording.q_ref))
    start = np.concatenate([np.full(12, 0.01), np.full(12, 0.6), np.full(12, 0.2), np.zeros(12), [0.005]])
    clock = process_time()
    found, _ = minimize.least_squares(
        start, peer.residual, bounds=list(BOUNDS.T), eps=1e-5, verbose=minimize.Verbosity.SILENT, max_iter=30
    )
    theirs = process_time() - clock
    print(f"mujoco.minimize.least_squares, steps of 5 ms: {1e3 * rms(peer.residual(np.reshape(found, (-1, 1)))):.3f} mrad, "
          f"{peer.runs} simulations, {theirs:.1f} s, {theirs / seconds:.1f} times ours in the same run")  # fmt: skip
    equal_accuracy(experiment, fit, peer)


def equal_accuracy(experiment: didim.Experiment, fit: didim.Identification, peer: Rollouts) -> None:
    """Print the processor time of a simulation of all legs, MuJoCo's with the longest steps that are as accurate as ours."""
    theta, count = np.array(fit.beta), 32
    exact, usual = (Problem(experiment_at(experiment, step), threads=1) for step in (1e-4, None))
    errors = [
        rms(np.concatenate(a) - np.concatenate(b)) for a, b in [(usual.errors(theta), exact.errors(theta))]
    ]
    thetas = np.tile(theta, (count, 1))
    clock = process_time()
    for rollout_of in usual.rollouts:
        usual.positions(rollout_of, thetas)
    ours = (process_time() - clock) / count
    print(
        f"ours: {1e3 * errors[0]:.4f} mrad from steps of 0.1 ms, {1e3 * ours:.2f} ms a simulation of all legs"
    )
    by_kind = {
        kind: [k for k, name in enumerate(fit.names) if name.startswith(kind)]
        for kind in ("Ia", "Fv", "Fc", "Off")
    }
    delay = float(theta[fit.names.index("delay_s")])
    values = np.concatenate([*(theta[by_kind[kind]] for kind in ("Ia", "Fv", "Fc", "Off")), [delay]])[:, None]
    exact_there = peer.residual(values, 160)
    for steps in (1, 2, 5, 10, 20, 40, 80):
        clock = process_time()
        found = peer.residual(values, steps)
        theirs, error = process_time() - clock, rms(found - exact_there)
        print(f"MuJoCo, steps of {5.0 / steps:.4g} ms: {1e3 * error:.4f} mrad from 0.031 ms, {1e3 * theirs:.0f} ms, "
              f"{theirs / ours:.0f} times ours", flush=True)  # fmt: skip
        if error < errors[0]:
            break


def experiment_at(experiment: didim.Experiment, step_s: float | None) -> didim.Experiment:
    """An experiment with steps of the simulation."""
    if step_s is None:
        return experiment
    return replace(experiment, simulation=replace(experiment.simulation, step_s=step_s, fine_step_s=step_s))


def rms(values: object) -> float:
    """Root mean square of numbers."""
    return float(np.sqrt(np.mean(np.square(np.array(values, dtype=float)))))


def print_fleet(fit: didim.Identification, arms: list[dict[str, np.ndarray]], shares: np.ndarray) -> None:
    """Print the spread between logs by the fit beside that of the arms that were fitted, and the shares within the draws."""
    samples = fit.samples(100)
    for kind in ("Ia", "Fv", "Fc"):
        true = np.array([p[kind] for p in arms])
        ratio = samples.runs[np.array(samples.kinds) == kind] / true.std(axis=0, ddof=1)
        print(
            f"{kind}: spread between logs over that of the {len(arms)} arms {np.array2string(ratio, precision=2)}"
        )
    within, all_of = shares.mean(axis=(0, 2))
    whole = (shares[:, 1] == 1.0).mean()
    print(
        f"{len(shares)} other arms, another motion: {100 * within:.1f} % of the samples between 5 and 95 % of the draws, "
        f"{100 * all_of:.1f} % between all of them; {100 * whole:.1f} % of the joints' rollouts entirely"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--step", type=float, default=1e-4, help="step of the truth (s)")
    parser.add_argument("--fleet", type=int, metavar="ARMS", help="a fleet of so many arms beside its draws")
    parser.add_argument(
        "--quadruped",
        type=Path,
        metavar="FOLDER",
        help="go2.xml and traj_0.pt: MuJoCo's least squares beside ours",
    )
    options = parser.parse_args()
    if options.quadruped is not None:
        quadruped(options.quadruped)
        return
    if options.fleet is not None:
        with tempfile.TemporaryDirectory() as name:
            print_fleet(*fleet(Path(name), options.fleet, 20.0, 200))
        return
    p = truth()
    errors: dict[str, list[float]] = {}
    inside, seconds = [], []
    for seed in range(options.seeds):
        with tempfile.TemporaryDirectory() as name:
            folder, r = Path(name), commands(seed)
            np.savez(folder / "log.npz", q=simulated(p, r, options.step), r=r)
            clock = process_time()
            fit = fitted(folder, p)
            seconds.append(process_time() - clock)
            record = PositionRecord.of(fit.settings)
            assert record is not None
        for row in record.rows:
            true = DELAY_S if row["kind"] == "delay_s" else p[row["kind"]][row["joints"][0] - 1]
            if row["by"] == "held":
                print(f"  held: {row['text']}")
                continue
            off = (row["value"] - true) * (1e3 if row["kind"] == "delay_s" else 100.0 / true)
            errors.setdefault(row["kind"], []).append(off)
            inside.append(row["low"] <= true <= row["high"])
        print(f"seed {seed}: {fit.n_iterations} iterations, {fit.n_simulations} simulations, {seconds[-1]:.1f} s, "
              f"inside {np.mean(inside):.2f}, rms {1e3 * np.array(record.errors['after'])} mrad", flush=True)  # fmt: skip
    for kind, found in errors.items():
        unit = "ms" if kind == "delay_s" else "%"
        print(
            f"{kind:8s} rms {np.sqrt(np.mean(np.square(found))):.3f} {unit}, largest {np.max(np.abs(found)):.3f} {unit}"
        )
    print(
        f"inside the 95 % intervals: {100.0 * np.mean(inside):.1f} % of {len(inside)}; {np.mean(seconds):.1f} processor seconds"
    )


if __name__ == "__main__":
    main()
