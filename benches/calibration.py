"""Are the reported standard deviations right, and does every start end at the same parameters?

    python benches/calibration.py [--seeds 100] [--starts 20]
    python benches/calibration.py --methods cloe --seeds 20 --starts 0 --workers 2
    python benches/calibration.py --methods idim-ls --seeds 40 --starts 0 --cutoff-hz 60
    python benches/calibration.py --methods didim cloe --seeds 10 --starts 0 --friction

simulates the log of the packaged TX40 experiment once, adds noise once per seed, and identifies each log by IDIM-LS and
DIDIM, or by CLOE (Levenberg and Marquardt from (21)). (estimate - truth) / sigma has Student's distribution where sigma is that
of the jackknife, with 19 degrees of freedom for 20 blocks, so 0.74 % of the truths lie beyond 3 sigma. Standard deviations for
white noise, which this noise is, stand in a second row: there 95 % lie within 1.96 sigma and 0.27 % beyond 3. Then DIDIM starts
from (17), (21), IDIM-LS and random points on the log of seed 0. The figures are those of docs/didim.md and docs/cloe.md.
With ``--friction`` every joint has atan friction of known velocity, and joints 3 and 4 have load friction (docs/friction.md).
"""

from __future__ import annotations

import argparse
import functools
import math
import re
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

import didim
from didim.experiment.loop import closed_loop
from didim.methods.method import Method
from didim.methods.start import Start
from didim.monte_carlo.engine import run_all
from didim.monte_carlo.executors import pool
from didim.studies.simulated_log import LOG_REFINEMENT, measured, packaged_experiment, simulated_log

Array = NDArray[np.float64]

SIGMA_95 = 1.959964
"""Standard deviations on both sides of the mean that hold 95 % of a normal distribution."""
SIGMA_FAR = 3.0
"""Standard deviations beyond which a truth is counted as far off."""
SMALLEST_FACTOR, LARGEST_FACTOR = 0.3, 3.0
"""Smallest and largest factor by which random starts differ from the truth."""
KINDS = {
    **dict.fromkeys(("XX", "XY", "XZ", "YY", "YZ", "ZZ"), "inertia"),
    **dict.fromkeys(("MX", "MY", "MZ"), "moment"),
}


def random_starts(experiment: didim.Experiment, parameters: str, count: int, seed: int) -> list[Array]:
    """Base parameters times one random factor per joint and kind, of those that leave M(q) positive definite on the reference."""
    robot = experiment.robot
    base = robot.base_parameters
    groups = []
    for name in base.names:
        letters, joint = re.match(r"([A-Za-z]+?)(\d+)", name).groups()  # type: ignore[union-attr]
        groups.append((KINDS.get(letters, letters), joint))
    truth = np.asarray(robot.set_base(parameters))
    loop = closed_loop(experiment, experiment.recordings[0])
    q, _, _ = loop.reference.at(loop.t[::50])
    rng = np.random.default_rng(seed)
    found: list[Array] = []
    while len(found) < count:
        keys = sorted(set(groups))
        logs = rng.uniform(np.log(SMALLEST_FACTOR), np.log(LARGEST_FACTOR), len(keys))
        factors = dict(zip(keys, np.exp(logs), strict=True))
        start = truth * np.array([factors[group] for group in groups])
        if np.linalg.eigvalsh(didim.inertia_matrix(robot, q, base.lift(start))).min() > 0.0:
            found.append(start)
    return found


def with_friction(experiment: didim.Experiment, x: Array) -> tuple[didim.Experiment, Array]:
    """Add atan friction at every joint, half the size of its Coulomb friction, and load friction at joints 3 and 4."""
    robot = experiment.robot
    terms = [
        *(didim.FrictionTerm(law="atan", joint=joint, velocity=0.5) for joint in range(robot.n_dof)),
        *(didim.FrictionTerm(law="load", joint=joint) for joint in (2, 3)),
    ]
    coulomb = [x[robot.parameter_names.index(f"Fc{joint + 1}")] for joint in range(robot.n_dof)]
    values = np.concatenate([x, 0.5 * np.array(coulomb), [0.2, 0.2]])
    return replace(experiment, robot=robot.with_terms(terms)), values


@functools.cache
def clean_log(cutoff_hz: float | None, friction: bool) -> tuple[didim.Experiment, Array]:
    """Log without noise, and the true base parameters."""
    experiment = packaged_experiment("tx40")
    if cutoff_hz is not None:
        experiment = replace(experiment, signal=replace(experiment.signal, cutoff_hz=cutoff_hz))
    x = experiment.robot.parameter_set("didim")
    if friction:
        experiment, x = with_friction(experiment, x)
    log = simulated_log(experiment, x, noise=False, refinement=LOG_REFINEMENT)
    return log, experiment.robot.base_parameters.project(x)


def one_seed(
    task: tuple[int, tuple[str, ...], float | None, bool],
) -> list[tuple[str, bool, list[float], list[float], float, int, float]]:
    """Identify the log of a seed by each method.

    Each row has the name, whether the method converged, errors in sigmas and in those for white noise, degrees of freedom,
    iterations and seconds.
    """
    seed, names, cutoff_hz, friction = task
    log, truth = clean_log(cutoff_hz, friction)
    noisy = measured(log, seed)
    methods: dict[str, Method] = {
        "idim-ls": didim.IDIMLS(),
        "didim": didim.DIDIM(physical=False),
        "cloe": didim.CLOE(start="idim-ls" if friction else "apriori"),
    }
    found = []
    for method in (methods[name] for name in names):
        fit = didim.identify(noisy, method)
        sigmas, white = (
            ((fit.beta - truth) / np.where(std > 0.0, std, np.nan)).tolist()
            for std in (fit.std, fit.std_white)
        )
        known = fit.uncertainty
        assert known is not None
        found.append(
            (
                method.name,
                fit.converged,
                sigmas,
                white,
                known.degrees_of_freedom,
                fit.n_iterations,
                fit.elapsed,
            )
        )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Calibration of the standard deviations on the simulated TX40."
    )
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--starts", type=int, default=20, help="random starts")
    parser.add_argument(
        "--methods", nargs="+", choices=("idim-ls", "didim", "cloe"), default=["idim-ls", "didim"]
    )
    parser.add_argument(
        "--cutoff-hz", type=float, help="of the filter of IDIM-LS, instead of the packaged one"
    )
    parser.add_argument("--friction", action="store_true", help="a TX40 with atan and load friction")
    parser.add_argument(
        "--workers", type=int, default=1, help="processes for the seeds (default: %(default)s)"
    )
    arguments = parser.parse_args()

    log, truth = clean_log(arguments.cutoff_hz, arguments.friction)
    base = log.robot.base_parameters
    off: dict[str, list[list[float]]] = {}
    freedom: dict[str, float] = {}
    iterations: dict[str, list[int]] = {}
    seconds: dict[str, list[float]] = {}
    tasks = [
        (seed, tuple(arguments.methods), arguments.cutoff_hz, arguments.friction)
        for seed in range(arguments.seeds)
    ]
    executor = "serial" if arguments.workers == 1 else "process"
    with pool(executor, arguments.workers) as some:
        outcomes = sorted(run_all(one_seed, tasks, some), key=lambda outcome: outcome[0][0])
    for (seed, *_), fits, lost in outcomes:
        if lost is not None:
            raise SystemExit(f"seed {seed}: {lost}")
        for name, converged, sigmas, white, degrees, count, took in fits:
            if not converged:
                raise SystemExit(f"seed {seed}: {name} does not converge")
            off.setdefault(name, []).append(sigmas)
            off.setdefault(f"{name}, white", []).append(white)
            freedom[name], freedom[f"{name}, white"] = degrees, math.inf
            iterations.setdefault(name, []).append(count)
            seconds.setdefault(name, []).append(took)
    print(f"{arguments.seeds} seeds, {len(truth)} parameters")
    print(
        f"{'':32}  {'rms':>6}  {'in 1.96':>8}  {'beyond 3 sigma':>14}  {'expected':>8}  {'largest mean':18}  "
        "iterations  seconds (median, most)"
    )
    for name, rows in off.items():
        values = np.array(rows)
        mean = values.mean(axis=0)
        worst = int(np.argmax(np.abs(mean)))
        alone = name.removesuffix(", white")
        found, took = iterations[alone], seconds[alone]
        expected = 2.0 * float(stats.t.sf(SIGMA_FAR, freedom[name]))
        print(
            f"{name:32}  {np.sqrt(np.mean(values**2)):6.3f}  {100.0 * np.mean(np.abs(values) < SIGMA_95):6.2f} %  "
            f"{100.0 * np.mean(np.abs(values) > SIGMA_FAR):12.2f} %  {100.0 * expected:6.2f} %  "
            f"{f'{mean[worst]:+.2f} ({base.names[worst]})':18}  "
            f"{min(found)} to {max(found)}      {np.median(took):.2f}, {max(took):.2f}"
        )
    if arguments.starts == 0:
        return

    noisy = measured(log, None)
    reference = didim.identify(noisy, didim.DIDIM(physical=False))
    starts: list[Start] = ["apriori", "idim-ls", *random_starts(noisy, "didim", arguments.starts, seed=0)]
    fits = [didim.identify(noisy, didim.DIDIM(start=start, physical=False)) for start in starts]
    for fit in fits:
        if not fit.converged:
            raise SystemExit(f"a start does not converge: {fit.status.value}")
    apart = [float(np.max(np.abs(fit.beta - reference.beta) / reference.std)) for fit in fits]
    counts = [fit.n_iterations for fit in fits]
    print(
        f"\n(21), IDIM-LS and {arguments.starts} random starts: {min(counts)} to {max(counts)} iterations, all within "
        f"{max(apart):.2g} sigma of the estimate from (17)"
    )


if __name__ == "__main__":
    main()
