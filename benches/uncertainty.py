"""How honest standard deviations are: parts of real logs against each other, and controls with a known truth.

    python benches/uncertainty.py [--data FOLDER] [--draws N] [--seeds N]

FOLDER holds tx40/, emps/ and ur10e/ with the measured logs; without it only the controls are run. z is the difference of two
estimates over the root of the sum of their variances: rms 1 and 95 % within 1.96 are right.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

import didim
from didim.methods.uncertainty import spread_of_fit
from didim.regression.least_squares import solve
from didim.result.uncertainty import student_factor
from didim.signal.filters import decimate, decimation_stages
from didim.studies.simulated_log import measured

Array = NDArray[np.float64]
EXAMPLES = Path(__file__).parents[1] / "examples"
GAINS_UR10E = (10.56, 12.38, 9.95, 10.38, 10.27, 10.31)
"""Drive gains (N.m/A) of the UR10e, by maximum likelihood from both logs."""


def parts(experiment: didim.Experiment, count: int) -> list[didim.Experiment]:
    """Cut the log of an experiment into pieces of equal length."""
    (recording,) = experiment.recordings
    (window,) = recording.windows
    edges = np.linspace(*window, count + 1).astype(int).tolist()
    return [
        replace(experiment, recordings=(replace(recording, windows=(window,)),)) for window in pairwise(edges)
    ]


def distances(fits: Sequence[didim.Identification]) -> Array:
    """Differences of all pairs of estimates over their combined standard deviations, without the shift of missing friction."""
    return np.concatenate(
        [(a.beta - b.beta) / np.hypot(noise(a), noise(b)) for a, b in combinations(fits, 2)]
    )


def noise(fit: didim.Identification) -> Array:
    """Return the standard deviations of the noise alone: parts of one log share the error of a missing law."""
    assert fit.uncertainty is not None
    return fit.uncertainty.without_shift(fit.std)


def line(name: str, z: Array, factor: float | Array = 1.96) -> str:
    inside = 100.0 * np.mean(np.abs(z) < factor)
    return f"{name:52} rms {np.sqrt(np.mean(z**2)):5.2f}   within {np.mean(factor):.2f}: {inside:5.1f} %"


def ur10e(folder: Path, robot: didim.Robot) -> didim.Experiment:
    """The free log at an even rate of 100 Hz, currents times gains."""
    table = np.loadtxt(folder / "free.csv", delimiter=",")[195:4966]
    t = table[:, 0] - table[0, 0]
    even = np.arange(0.0, t[-1], 0.01)
    q, current = (
        np.column_stack([np.interp(even, t, table[:, column]) for column in columns])
        for columns in (range(1, 7), range(13, 19))
    )
    recording = didim.Recording.from_arrays(q, current * GAINS_UR10E, rate_hz=100.0, name="free")
    signal = didim.SignalProcessing(cutoff_hz=8.0, trim_start=50, trim_end=50, decimation=(5,))
    return didim.Experiment(name="UR10e, free", robot=robot, recordings=(recording,), signal=signal)


def real_logs(folder: Path) -> Iterator[tuple[str, didim.Experiment, tuple[int, ...]]]:
    yield "TX40", didim.load_experiment(EXAMPLES / "tx40_log_best.toml", data=folder / "tx40"), (2, 3)
    for name in ("emps", "emps_asymmetric"):
        yield name.upper(), didim.load_experiment(EXAMPLES / f"{name}.toml", data=folder / "emps"), (2, 3)
    robot = didim.load_robot(folder / "ur10e" / "ur10e.urdf").with_friction(dead_zone_rad_s=0.01)
    yield "UR10e", ur10e(folder / "ur10e", robot), (2, 3)


def coloured(rng: np.random.Generator, shape: tuple[int, int], time_constant: float) -> Array:
    """White noise of size one, or AR(1) with a time constant in samples."""
    if not time_constant:
        return rng.standard_normal(shape)
    a = float(np.exp(-1.0 / time_constant))
    noise = rng.standard_normal((shape[0] + int(20 * time_constant), shape[1]))
    return np.asarray(lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], noise, axis=0))[-shape[0] :]


def controls(draws: int) -> None:
    """Errors of estimates on the observation matrix of the simulated TX40, noise on the torques alone."""
    experiment = didim.packaged_experiment("tx40")
    x = experiment.robot.parameter_set("didim")
    log = didim.simulated_log(experiment, x, noise=False)
    assert log.measurement is not None
    job = didim.IDIMLS().job(log)
    (part,) = job.parts("fit")
    system = job.system([part])
    truth = log.robot.base_parameters.project(x)
    stages = decimation_stages(len(part.tau), job.signal)
    for name, time_constant in (
        ("white noise", 0.0),
        ("AR(1) noise, 66 ms", 66.0),
        ("AR(1) noise, 0.3 s", 300.0),
        ("AR(1) noise, 1 s", 1000.0),
    ):
        ratios: dict[str, list[Array]] = {"jackknife": [], "decimated": []}
        factors: dict[str, list[float]] = {"jackknife": [], "decimated": []}
        for seed in range(draws):
            noise = coloured(np.random.default_rng(seed), part.tau.shape, time_constant)
            rows = decimate(noise * log.measurement.torque_noise, stages)[job.signal.kept_rows].T
            noisy = replace(system, y=system.w @ truth + rows.ravel())
            fit = solve(noisy, job.settings)
            for kind, found in ratios.items():
                settings = replace(job.settings, uncertainty=kind)  # type: ignore[arg-type]
                spread = spread_of_fit(noisy, fit, settings, job.model.unknowns)
                assert spread.uncertainty is not None
                found.append((fit.solution - truth) / np.sqrt(np.diag(spread.covariance)))
                factors[kind].append(student_factor(0.95, spread.uncertainty.degrees_of_freedom))
        for kind, found in ratios.items():
            print(line(f"{name}, {kind}, {draws} draws", np.array(found), np.array(factors[kind])[:, None]))


def chance(name: str, pieces: Sequence[didim.Experiment], draws: int) -> None:
    """What rms z of these very pieces is by chance: their observation matrices, with noise in place of the measured torques."""
    rows = []
    for piece in pieces:
        job = didim.IDIMLS().job(piece)
        (part,) = job.parts("fit", job.delay())
        system = job.system([part])
        residual = job.solve(system).residual
        sizes = np.array([np.sqrt(np.mean(residual[joint] ** 2)) for joint in system.joints])
        rows.append((job, part, system, sizes))
    for title, time_constant_s in (("white", 0.0), ("AR(1), 66 ms", 0.066), ("AR(1), 0.3 s", 0.3)):
        found, covered = [], []
        for seed in range(draws):
            rng = np.random.default_rng(seed)
            estimates = []
            for job, part, system, sizes in rows:
                noise = coloured(rng, part.tau.shape, time_constant_s * part.rate_hz) * sizes
                kept = decimate(noise, decimation_stages(len(part.tau), job.signal))[job.signal.kept_rows]
                noisy = replace(system, y=kept.T.ravel(), known=None)
                fit = solve(noisy, job.settings)
                spread = spread_of_fit(noisy, fit, job.settings, job.model.unknowns)
                estimates.append((fit.solution, np.diag(spread.covariance)))
            z = np.concatenate([(a - b) / np.sqrt(c + d) for (a, c), (b, d) in combinations(estimates, 2)])
            found.append(np.sqrt(np.mean(z**2)))
            covered.append(np.mean(np.abs(z) < 1.96))
        low, high = np.quantile(found, [0.05, 0.95])
        print(
            f"{name} in {len(pieces)} parts, torques of {title} noise: rms {np.mean(found):.2f} +- {np.std(found, ddof=1):.2f} "
            f"(90 % of {draws} draws within {low:.2f} to {high:.2f}), within 1.96: {100.0 * np.mean(covered):.1f} %",
            flush=True,
        )


def of_didim(seeds: int) -> None:
    experiment = didim.packaged_experiment("tx40")
    x = experiment.robot.parameter_set("didim")
    log, truth = didim.simulated_log(experiment, x, noise=False), experiment.robot.base_parameters.project(x)
    fits = [didim.identify(measured(log, seed), didim.DIDIM(physical=False)) for seed in range(seeds)]
    print(
        line(
            f"DIDIM, {seeds} seeds, jackknife",
            np.array([(fit.beta - truth) / fit.std for fit in fits]),
            2.093,
        )
    )
    print(
        line(f"DIDIM, {seeds} seeds, white", np.array([(fit.beta - truth) / fit.std_white for fit in fits]))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--data", type=Path, help="folder of the measured logs")
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=40)
    options = parser.parse_args()
    if options.data is not None:
        for name, experiment, counts in real_logs(options.data):
            for count in counts:
                pieces = parts(experiment, count)
                for kind in ("jackknife", "decimated"):
                    fits = [didim.identify(piece, didim.IDIMLS(uncertainty=kind)) for piece in pieces]
                    print(line(f"{name} in {count} parts, {kind}", distances(fits)), flush=True)
                if name == "TX40":
                    chance(name, pieces, options.draws)
    controls(options.draws)
    of_didim(options.seeds)


if __name__ == "__main__":
    main()
