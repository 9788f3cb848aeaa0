"""Classical regressions beside weighted least squares: what they are worth. The figures are those of docs/idim_ls.md.

    python benches/classical.py [--data FOLDER] [--seeds N]

With FOLDER, which holds tx40/ and emps/: each of five contiguous parts of a real log is predicted from the other four, with
5 rows of gap. Then, on simulated logs of the packaged experiment: the estimators of Huber and Tukey and Hampel's filter on torques
with spikes, and IDIM-IV without decimation. Errors in standard deviations, rms.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import didim
from didim.methods.method import Method
from didim.regression.solver import SOLVERS, solver_of
from didim.studies.simulated_log import measured
from didim.terms.rows import LinearSystem

Array = NDArray[np.float64]

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PARTS, GAP = 5, 5
"""Parts of a log, and rows between them that serve neither the fit nor the prediction."""
SPIKES, SPIKE_SIZE = 0.005, 30.0
"""Share of the samples of each torque that are wrong, and by how many times its noise."""
UNDECIMATED_HZ = 450.0
"""Cut-off of the log without decimation, where noise of the motion counts."""


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def rows_of(system: LinearSystem, kept: Array) -> LinearSystem:
    """The system of some of the rows of every joint, `kept` counted within a joint."""
    n = system.joints[0].stop
    rows = np.concatenate([joint.start + kept for joint in system.joints])
    blocks = tuple(
        replace(blocks[0], rows=slice(index * kept.size, (index + 1) * kept.size))
        for index, blocks in enumerate(system.joint_blocks)
    )
    assert n * len(system.joints) == system.y.size
    return replace(
        system, w=np.ascontiguousarray(system.w[rows]), y=system.y[rows], known=None, blocks=blocks
    )


def left_out(experiment: didim.Experiment) -> None:
    """Errors of parts of a log, predicted from the others by each solver."""
    job = didim.IDIMLS().job(experiment)
    system = job.system(job.parts("fit", job.delay()))
    n = system.joints[0].stop
    edges = np.linspace(0, n, PARTS + 1).round().astype(int)
    for name in SOLVERS:
        if name == "consistent":
            continue
        solve = solver_of(name, job.model)
        squares = 0.0
        for start, stop in pairwise(edges):
            index = np.arange(n)
            fit = solve(rows_of(system, index[(index < start - GAP) | (index >= stop + GAP)]), job.settings)
            held = rows_of(system, index[start:stop])
            squares += float(np.sum((held.y - held.w @ fit.solution) ** 2))
        print(
            f"{experiment.name}, {name}: left out {100.0 * np.sqrt(squares) / np.linalg.norm(system.y):.2f} %",
            flush=True,
        )


def off(logs: Sequence[didim.Experiment], method: Method, truth: Array, sigma: Array) -> list[float]:
    """Errors of a method on each log in standard deviations, rms."""
    return [rms((didim.identify(log, method).beta - truth) / sigma) for log in logs]


def errors(logs: Sequence[didim.Experiment], method: Method, truth: Array, sigma: Array) -> str:
    """Errors of a method on logs with different noise."""
    each = off(logs, method, truth, sigma)
    return f"{rms(np.array(each)):.2f} ({min(each):.2f} to {max(each):.2f})"


def with_spikes(experiment: didim.Experiment, seed: int) -> didim.Experiment:
    """The same log with wrong samples of the torques."""
    (recording,) = experiment.recordings
    assert recording.tau is not None
    assert experiment.measurement is not None
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], recording.tau.shape) * (rng.random(recording.tau.shape) < SPIKES)
    tau = recording.tau + SPIKE_SIZE * signs * np.array(experiment.measurement.torque_noise)
    return replace(experiment, recordings=(replace(recording, tau=tau),))


def spiked(seeds: int) -> None:
    """Errors with and without spikes in standard deviations of the log without them."""
    experiment = didim.packaged_experiment("tx40")
    x = experiment.robot.parameter_set("didim")
    truth = experiment.robot.base_parameters.project(x)
    hampel = replace(experiment.signal, spikes="hampel")
    methods = {
        "IDIM-LS": didim.IDIMLS(),
        "huber": didim.IDIMLS(solver="huber"),
        "bisquare": didim.IDIMLS(solver="bisquare"),
        "Hampel, then IDIM-LS": didim.IDIMLS(signal=hampel),
    }
    errors: dict[str, list[list[Array]]] = {name: [[], []] for name in methods}
    for seed in range(seeds):
        clean = didim.simulated_log(experiment, x, seed=seed)
        sigma = didim.identify(clean, didim.IDIMLS(uncertainty="decimated")).std
        for name, method in methods.items():
            for found, log in zip(errors[name], (with_spikes(clean, seed), clean), strict=True):
                found.append((didim.identify(log, method).beta - truth) / sigma)
    for name, (with_them, without) in errors.items():
        print(
            f"{name}: {rms(np.array(with_them)):.2f} with spikes, {rms(np.array(without)):.2f} without",
            flush=True,
        )


def simulated(seeds: int) -> None:
    """Least squares and IDIM-IV on simulated logs of the TX40 without decimation."""
    experiment = didim.packaged_experiment("tx40")
    x = experiment.robot.parameter_set("didim")
    clean, truth = (
        didim.simulated_log(experiment, x, noise=False),
        experiment.robot.base_parameters.project(x),
    )
    assert clean.measurement is not None
    logs = [measured(clean, seed) for seed in range(seeds)]
    sigma = didim.identify(logs[0], didim.DIDIM(physical=False)).std_white
    signal = didim.SignalProcessing(cutoff_hz=UNDECIMATED_HZ, trim_start=50, trim_end=50)
    for factor in (1.0, 10.0):
        noise = tuple(factor * value for value in clean.measurement.position_noise)
        measurement = replace(clean.measurement, position_noise=noise)
        noisy = [measured(replace(clean, measurement=measurement), seed) for seed in range(seeds)]
        for name, method in (
            ("weighted least squares", didim.IDIMLS(signal=signal)),
            ("IDIM-IV", didim.IDIMIV(signal=signal)),
        ):
            print(f"encoder noise x {factor:g}, {name}: {errors(noisy, method, truth, sigma)}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--data", type=Path, help="folder of the measured logs")
    parser.add_argument("--seeds", type=int, default=4)
    options = parser.parse_args()
    if options.data is not None:
        left_out(didim.load_experiment(EXAMPLES / "tx40_log_best.toml", data=options.data / "tx40"))
        left_out(didim.load_experiment(EXAMPLES / "emps.toml", data=options.data / "emps"))
    spiked(options.seeds)
    simulated(options.seeds)


if __name__ == "__main__":
    main()
