"""Do physical conditions help where the truth is a robot, and do the drawn intervals hold it?

    python benches/consistent_truth.py [--seeds 12] [--first 0] [--noise 1 5 20] [--draws 200] [--uncertainty decimated]

simulates logs of the packaged TX40 with the parameters ``didim_physical``, which are a robot, and so many times the torque noise
of the experiment. Each is identified by plain DIDIM and moved to the nearest robot by ``fit.consistent()``. Printed are the torque
errors of both on a random motion, joint by joint, the distance from the truth in standard deviations, and how many of the
drawn 95 % intervals of identified parameters hold the truth: of all, of those that no active condition has moved by more
than a twentieth of a standard deviation, and of the base parameters of plain DIDIM. The errors of one log belong together, so the
standard error after +- is that of the logs' own shares.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import didim
from didim.loop.reference import Reference
from didim.studies.simulated_log import measured, simulated_log

Array = NDArray[np.float64]

FREE = 0.05
"""Standard deviations by which a parameter may move and still count as untouched by the conditions."""


def torque_errors(robot: didim.Robot, truth: Array, x: Array) -> Array:
    """Relative errors of the torques of a random motion, (n_dof,)."""
    n = robot.n_dof
    motion = Reference.random_fourier(
        harmonics=8,
        period_s=10.0,
        max_position=[1.5] * n,
        max_velocity=[3.0] * n,
        max_acceleration=[20.0] * n,
    )
    q, dq, ddq = motion.at(np.linspace(0.0, 10.0, 2000))
    tau, other = (didim.inverse_dynamics(robot, q, dq, ddq, values) for values in (truth, x))
    return np.asarray(np.linalg.norm(other - tau, axis=0) / np.linalg.norm(tau, axis=0))


def share(logs: list[list[bool]]) -> str:
    """Return the share of intervals that hold, over all logs, with its standard error."""
    own = [np.mean(log) for log in logs if log]
    error = 100.0 * np.std(own, ddof=1) / np.sqrt(len(own)) if len(own) > 1 else np.nan
    return f"{100.0 * np.mean(np.concatenate(logs)):.1f} +- {error:.1f} % of {sum(map(len, logs))}"


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--uncertainty", choices=["decimated", "jackknife", "white"], default="decimated")
    parser.add_argument("--noise", type=float, nargs="+", default=[1.0, 5.0, 20.0])
    parser.add_argument("--draws", type=int, default=200)
    asked = parser.parse_args()
    experiment = didim.packaged_experiment("tx40")
    robot = experiment.robot
    truth = robot.parameter_set("didim_physical")
    beta = robot.base_parameters.project(truth)
    exact = simulated_log(experiment, truth, noise=False)
    noise = experiment.measurement
    assert noise is not None
    print(
        "| torque noise | DIDIM, % | nearest robot, % | off, sigma | in the intervals | untouched | base parameters |"
    )
    print("|---|---|---|---|---|---|---|")
    for times in asked.noise:
        torque = tuple(times * value for value in noise.torque_noise)
        louder = replace(exact, measurement=replace(noise, torque_noise=torque))
        errors, offs, held, free, base = [], [], [], [], []
        for seed in range(asked.first, asked.first + asked.seeds):
            method = didim.DIDIM(physical=False, uncertainty=asked.uncertainty)
            fit = didim.identify(measured(louder, seed), method)
            near = fit.consistent(draws=asked.draws)
            errors.append([torque_errors(robot, truth, one.parameters) for one in (fit, near)])
            offs.append([np.sqrt(np.mean(((one.beta - beta) / fit.std) ** 2)) for one in (fit, near)])
            rows = near.settings["consistent"]["parameters"]
            moved = np.abs(near.beta - fit.beta) / fit.std
            touched = {name for name, value in zip(fit.names, moved, strict=True) if value > FREE}
            met = {
                row["name"]: row["low"] <= value <= row["high"]
                for row, value in zip(rows, truth, strict=True)
                if row["source"] == "identified"
            }
            held.append(list(met.values()))
            free.append([met[name] for name in met if not touched & {name, f"{name}R"}])
            low, high = fit.confidence_interval()
            base.append(((low <= beta) & (beta <= high)).tolist())
        means = np.mean(errors, axis=0)
        both = [" ".join(f"{100.0 * value:.2f}" for value in row) for row in means]
        off = np.mean(offs, axis=0)
        print(
            f"| x {times:g} | {both[0]} | {both[1]} | {off[0]:.3f}, {off[1]:.3f} | {share(held)} | {share(free)} | {share(base)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
