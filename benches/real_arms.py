"""Do consistent methods converge on arms whose least-squares estimate is not physically consistent?

    python benches/real_arms.py [--methods didim idim-iv cloe] [--arms 40] [--first 0] [--minutes 9]
                                [--results real_arms.jsonl] [--plain-seconds 20]

makes random arms of 6 and 7 revolute axes with light wrists: bodies, rotors and friction fall from the shoulder to the wrist. Each
follows a slow random motion under its own PD controller, every other one a digital controller with a delay, and its torques
have white noise and a ripple of friction by position that no model has. Arms whose plain IDIM-LS estimate has a positive
definite M(q) at 500 random positions are left out. The others are identified by the methods that are asked for, with physical
consistency and the other defaults of each, for DIDIM (the default) also by the plain method, and every estimate predicts the
torques of another motion. Rows go to a file, one JSON line an arm: started again, the bench goes on behind the last one.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import didim
from didim.experiment.loop import closed_loop
from didim.experiment.specs import Measurement, SimulationSettings
from didim.loop.controller import Controller, Digital
from didim.loop.reference import Reference
from didim.loop.tuning import mean_inertia
from didim.methods.method import Method
from didim.signal.processing import SignalProcessing
from didim.studies.simulated_log import measured, simulated_log

Array = NDArray[np.float64]

METHODS: dict[str, Callable[[], Method]] = {
    "didim": didim.DIDIM,
    "idim-iv": lambda: didim.IDIMIV(physical=True),
    "cloe": lambda: didim.CLOE(physical=True),
}
"""The methods with physical consistency: plain IDIM-IV and CLOE have no start on most of these arms."""
MOST_ITERATIONS = 8
"""In which consistent DIDIM shall converge."""
WORSE = 1.05
"""Ratio to the prediction error of IDIM-LS beyond which a prediction is worse."""
POSITIONS = 500
"""Random positions at which M(q) is looked at."""
RIPPLE = 0.06
"""Friction by position, as a share of the Coulomb friction."""


class Arm(NamedTuple):
    """A robot, its true parameters, and the logs of two motions."""

    robot: didim.Robot
    truth: Array
    log: didim.Experiment
    other: Callable[[], didim.Experiment]
    digital: bool


def robot_text(rng: np.random.Generator, n: int) -> str:
    """Return a robot file with a random geometry and the parameter set "truth", bodies that can exist."""
    lines = ['schema = 1\nname = "arm"\ndescription = "a random arm"\ngravity_m_s2 = [0.0, 0.0, -9.81]']
    tilts = [0.0, *rng.choice([-90.0, 90.0], n - 1)]
    tilts[2] = float(rng.choice([0.0, tilts[2]]))
    for j, tilt in enumerate(tilts):
        long = float(rng.uniform(0.25, 0.45) if j in (2, 4) or (j == 3 and n == 6) else rng.uniform(0.0, 0.1))
        d, r = (long, 0.0) if tilt == 0.0 and j else (0.0, long)
        lines.append(
            f'[[joint]]\nkind = "revolute"\nalpha_deg = {tilt}\nd_m = {d}\ntheta_deg = 0.0\nr_m = {r}\n'
            "limits = { position_rad = [-3.0, 3.0], velocity_rad_s = 3.0, torque_n_m = 500.0 }"
        )
    lines.append(
        '[friction]\ncoulomb = "tanh"\nsmoothing_rad_s = 0.02\nmodel = "symmetric"\n[parameters.truth]'
    )
    mass, fall = rng.uniform(5.0, 12.0), rng.uniform(0.5, 0.65)
    for j in range(1, n + 1):
        size = fall ** (j - 1)
        own = mass * size
        # A cloud of points is a body.
        points = rng.normal(size=(20, 3)) * rng.uniform(0.02, 0.09, 3) * (0.5 + 0.5 * size)
        points += rng.uniform(-0.06, 0.06, 3)
        about = own / 20 * (np.sum(points**2) * np.eye(3) - points.T @ points)
        values = {"M": own, "XX": about[0, 0], "XY": about[0, 1], "XZ": about[0, 2]}
        values |= {"YY": about[1, 1], "YZ": about[1, 2], "ZZ": about[2, 2]}
        values |= dict(zip(("MX", "MY", "MZ"), own * points.mean(axis=0), strict=True))
        values |= {"Ia": rng.uniform(0.5, 1.5) * fall ** (2 * (j - 1)), "Fv": rng.uniform(2.0, 6.0) * size}
        values |= {"Fc": rng.uniform(3.0, 8.0) * size, "Off": rng.normal() * 0.3 * size}
        lines += [f"{name}{j} = {float(value)!r}" for name, value in values.items()]
    return "\n".join(lines) + "\n"


def random_arm(seed: int) -> Arm:
    """Return a random arm with its logs."""
    rng = np.random.default_rng([20, seed])
    n = int(rng.choice([6, 7]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "arm.toml")
        path.write_text(robot_text(rng, n), encoding="utf-8")
        robot = didim.load_robot(path)
    truth = robot.parameter_set("truth")
    speed = rng.uniform(0.6, 1.4)
    period = float(rng.uniform(4.0, 6.0))

    def motion(number: int) -> Reference:
        return Reference.random_fourier(
            harmonics=6,
            period_s=period,
            max_position=[1.5] * n,
            max_velocity=[speed] * n,
            max_acceleration=[4.0 * speed] * n,
            seed=1000 * seed + number,
        )

    inertia = mean_inertia(robot, truth, motion(0))
    digital = seed % 2 == 1
    frequency = rng.uniform(6.0, 14.0, n)
    controller = Controller.tuned(frequency, [0.7] * n, inertia)
    if digital:
        controller = replace(
            controller, digital=Digital(sample_time_s=0.001, delay_samples=1, smoothing=(0.25,) * 4)
        )
    noise = 0.01 * rng.uniform(0.5, 2.0)
    ripple = rng.uniform(2.0, 8.0, n), rng.uniform(0.0, 2.0 * np.pi, n)

    def log(number: int) -> didim.Experiment:
        reference = motion(number)
        experiment = didim.Experiment(
            name=f"arm {seed}",
            robot=robot,
            recordings=(),
            reference=reference,
            controller=controller,
            signal=SignalProcessing(cutoff_hz=20.0, trim_start=25, trim_end=25, decimation=(5,)),
            simulation=SimulationSettings(
                rate_hz=250.0, smoothing=(0.02,) * n, step_s=5e-4, fine_step_s=1e-4, start="reference"
            ),
            measurement=Measurement(position_noise=(5e-6,) * n, seed=number),
        )
        exact = simulated_log(experiment, truth, noise=False, refinement=1)
        (recording,) = exact.recordings
        # The ripple acts in the loop, so the controller reacts to it.
        coulomb = np.array([truth[robot.parameter_names.index(f"Fc{j}")] for j in range(1, n + 1)])
        q, dq, _ = reference.at(recording.t)
        wave = RIPPLE * coulomb * np.sin(ripple[0] * q + ripple[1]) * np.tanh(dq / 0.02)
        arrays, _ = closed_loop(exact, replace(recording, external=-wave)).run(truth[None])
        white = np.random.default_rng([seed, number]).standard_normal(wave.shape)
        tau = arrays[3][0] + noise * np.sqrt(np.mean(arrays[3][0] ** 2, axis=0)) * white
        felt = replace(recording, q=arrays[0][0], tau=tau)
        return measured(replace(exact, recordings=(felt,)), number)

    return Arm(robot, truth, log(0), lambda: log(1), digital)


def run(method: Callable[[], Method], arm: Arm, other: didim.Experiment, seconds: float) -> dict[str, Any]:
    """Return how a method ends on an arm: its status, effort, and the error of the other motion."""
    begin = time.monotonic()
    try:
        fit = didim.identify(arm.log, method(), callback=lambda iteration: time.monotonic() - begin > seconds)
    except didim.DidimError as reason:
        return {"status": "no start", "why": str(reason)[:200], "seconds": time.monotonic() - begin}
    return {"seconds": time.monotonic() - begin, **row_of(fit, other)}


def row_of(fit: didim.Identification, other: didim.Experiment) -> dict[str, Any]:
    """Return the numbers of a result, and the error of the torques that it predicts for another motion."""
    (check,) = didim.validate(fit, replace(other, controller=None)).recordings
    return {
        "status": fit.status.name,
        "iterations": fit.n_iterations,
        "simulations": fit.n_simulations,
        "error": fit.overall_relative_error,
        "other": check.direct_overall,
        "simulated": None if fit.output_error is None else fit.output_error[1],
        "remarks": [text[:120] for text in fit.remarks[:2]],
    }


def measure(seed: int, methods: list[str], plain_seconds: float) -> dict[str, Any]:
    """Return the row of an arm; without methods where IDIM-LS gives a robot."""
    arm = random_arm(seed)
    fit = didim.identify(arm.log, didim.IDIMLS())
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (POSITIONS, arm.robot.n_dof))
    smallest = float(np.linalg.eigvalsh(didim.inertia_matrix(arm.robot, q, fit.parameters)).min())
    row: dict[str, Any] = {"arm": seed, "axes": arm.robot.n_dof, "digital": arm.digital, "smallest": smallest}
    if smallest > 0.0:
        return row
    other = arm.other()
    row["idim-ls"] = row_of(fit, other)
    if "didim" in methods:
        row["didim"] = run(lambda: didim.DIDIM(physical=False), arm, other, plain_seconds)
    return row | {f"{name}-consistent": run(METHODS[name], arm, other, 1e9) for name in methods}


def converged(row: dict[str, Any], name: str) -> bool:
    """Return whether a method converged on an arm."""
    return bool(row[name]["status"] == "CONVERGED")


def predicts(row: dict[str, Any], name: str) -> bool:
    """Return whether a method converged and predicts the other motion as well as IDIM-LS."""
    return converged(row, name) and bool(row[name]["other"] <= WORSE * row["idim-ls"]["other"])


def meets(row: dict[str, Any]) -> bool:
    """Return whether consistent DIDIM converged in few iterations."""
    return converged(row, "didim-consistent") and row["didim-consistent"]["iterations"] <= MOST_ITERATIONS


def summary(rows: list[dict[str, Any]], methods: list[str]) -> str:
    """Return a table with a row for each method."""
    lines = [
        f"| consistent method, {len(rows)} arms | converges | iterations, median / most | predicts as well as IDIM-LS |",
        "|---|---|---|---|",
    ]
    for name in methods:
        key = f"{name}-consistent"
        steps = [row[key]["iterations"] for row in rows if converged(row, key)] or [0]
        lines.append(
            f"| {name} | {sum(converged(row, key) for row in rows)} | {np.median(steps):g} / {max(steps)} | "
            f"{sum(predicts(row, key) for row in rows)} |"
        )
    return "\n".join(lines)


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table of the arms, and how many meet what is asked."""
    lines = [
        "| arm | axes | least eigenvalue of M, IDIM-LS | IDIM-LS, own / other motion | plain DIDIM | consistent DIDIM, iterations "
        "| s | own / other motion |",
        "|---|---|---|---|---|---|---|---|",
    ]

    def percent(one: dict[str, Any]) -> str:
        return f"{100.0 * one['error']:.2f} / {100.0 * one['other']:.2f} %"

    for row in rows:
        direct, plain, consistent = (row[name] for name in ("idim-ls", "didim", "didim-consistent"))
        old = "no start" if plain["status"] == "no start" else f"{plain['status'].lower().replace('_', ' ')}"
        if plain["status"] == "CONVERGED":
            old += f", {percent(plain)}"
        new = (
            "no start"
            if consistent["status"] == "no start"
            else f"{consistent['status'].lower()}, {consistent['iterations']}"
        )
        errors = "" if consistent["status"] == "no start" else percent(consistent)
        lines.append(
            f"| {row['arm']} | {row['axes']}{', digital' if row['digital'] else ''} | {row['smallest']:.3g} | {percent(direct)} | "
            f"{old} | {new} | {consistent['seconds']:.1f} | {errors} |"
        )
    lines += [
        "",
        f"consistent DIDIM converges on {sum(map(meets, rows))} of {len(rows)} arms in at most {MOST_ITERATIONS} iterations, and "
        f"predicts the other motion no worse than {WORSE} times IDIM-LS on "
        f"{sum(meets(row) and predicts(row, 'didim-consistent') for row in rows)}; plain DIDIM converges and predicts as well on "
        f"{sum(predicts(row, 'didim') for row in rows)}",
    ]
    return "\n".join(lines)


def main() -> int:
    """Run the bench; 1 where DIDIM converges and predicts as well on fewer than 19 of 20 arms."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--methods", nargs="+", choices=METHODS, default=["didim"], help="what to identify by"
    )
    parser.add_argument("--arms", type=int, default=40, help="arms with an indefinite IDIM-LS")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after so many, to go on later")
    parser.add_argument("--results", type=Path, default=Path("real_arms.jsonl"), help="where rows are kept")
    parser.add_argument("--plain-seconds", type=float, default=20.0, help="that plain DIDIM may take")
    asked = parser.parse_args()
    begin = time.monotonic()
    rows = [json.loads(line) for line in asked.results.open()] if asked.results.exists() else []
    seed = max((row["arm"] + 1 for row in rows), default=asked.first)
    while (
        sum("idim-ls" in row for row in rows) < asked.arms and time.monotonic() - begin < 60.0 * asked.minutes
    ):
        row = measure(seed, asked.methods, asked.plain_seconds)
        rows.append(row)
        with asked.results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(f"arm {seed}: {row}", file=sys.stderr, flush=True)
        seed += 1
    chosen = [row for row in rows if "idim-ls" in row][: asked.arms]
    if "didim" in asked.methods:
        print(table(chosen), end="\n\n")
    print(summary(chosen, asked.methods))
    print(f"{len(rows) - len(chosen)} arms whose IDIM-LS estimate has a positive definite M(q) were left out")
    if "didim" not in asked.methods:
        return 0
    good = sum(meets(row) and predicts(row, "didim-consistent") for row in chosen)
    return 0 if chosen and good >= 0.95 * len(chosen) else 1


if __name__ == "__main__":
    sys.exit(main())
