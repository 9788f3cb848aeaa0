"""Classical regressions beside weighted least squares: what they are worth. The figures are those of docs/robust.md.

    python benches/classical.py [--data FOLDER] [--seeds N]

With FOLDER, which holds tx40/ and emps/: each of five contiguous parts of a real log is predicted from the other four, with
5 rows of gap. Then total least squares on the packaged experiment with a cut-off of 60 Hz, and maximum likelihood and IDIM-IV on
its log without decimation: errors in standard deviations, rms.
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
from didim.regression.linear_system import LinearSystem
from didim.regression.solver import SOLVERS, solver_of
from didim.studies.simulated_log import measured

Array = NDArray[np.float64]

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PARTS, GAP = 5, 5
"""Parts of a log, and rows between them that serve neither the fit nor the prediction."""
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
        solve = solver_of(name, job.robot, job.selection)
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


def errors(
    logs: Sequence[didim.Experiment],
    method: didim.IDIMLS | didim.MaximumLikelihood | didim.IDIMIV,
    truth: Array,
    sigma: Array,
) -> str:
    """Errors of a method on logs with different noise."""
    each = [rms((didim.identify(log, method).beta - truth) / sigma) for log in logs]
    return f"{rms(np.array(each)):.2f} ({min(each):.2f} to {max(each):.2f})"


def simulated(seeds: int) -> None:
    """Total least squares and maximum likelihood on simulated logs of the TX40."""
    experiment = didim.packaged_experiment("tx40")
    x = experiment.robot.parameter_set("didim")
    clean, truth = (
        didim.simulated_log(experiment, x, noise=False),
        experiment.robot.base_parameters.project(x),
    )
    assert clean.measurement is not None
    logs = [measured(clean, seed) for seed in range(seeds)]
    sigma = didim.identify(logs[0], didim.DIDIM(physical=False)).std_white
    slow = replace(clean.signal, cutoff_hz=60.0)
    squares: dict[str, list[float]] = {"least-squares": [], "total": []}
    for log in logs:
        plain = didim.identify(log, didim.IDIMLS(signal=slow, uncertainty="decimated"))
        total = didim.identify(log, didim.IDIMLS(signal=slow, solver="total"))
        for name, fit in (("least-squares", plain), ("total", total)):
            squares[name].append(rms((fit.beta - truth) / plain.std))
    plain_rms, total_rms = (rms(np.array(values)) for values in squares.values())
    print(
        f"60 Hz, decimated: weighted least squares {plain_rms:.4f}, total {total_rms:.4f}: "
        f"{100.0 * (total_rms / plain_rms - 1.0):+.2f} %",
        flush=True,
    )
    signal = didim.SignalProcessing(cutoff_hz=UNDECIMATED_HZ, trim_start=50, trim_end=50)
    for factor in (1.0, 10.0):
        noise = tuple(factor * value for value in clean.measurement.position_noise)
        measurement = replace(clean.measurement, position_noise=noise)
        noisy = [measured(replace(clean, measurement=measurement), seed) for seed in range(seeds)]
        given = didim.MaximumLikelihood(
            signal=signal, position_noise=noise, torque_noise=measurement.torque_noise
        )
        for name, method in (
            ("weighted least squares", didim.IDIMLS(signal=signal)),
            ("ml, noise given", given),
            ("ml, two solutions", replace(given, max_iterations=2)),
            ("ml, noise estimated", didim.MaximumLikelihood(signal=signal)),
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
    simulated(options.seeds)


if __name__ == "__main__":
    main()
