"""Iterations and processor time of the constrained solutions, on a collection of problems from real and random logs.

    python benches/interior_point.py [--random 1100] [--seed 0] [--data FOLDER] [--draws]

A problem is a log, a robot, a prior, its weight, and conditions. Random ones have chains of 1 to 9 joints of both kinds, some with
a coupled wrist, whose bodies may be feasible or not; their logs are rich or thin, of little noise or much, and some have a reversed
torque. Some hardly move, or have noise of a ten-thousandth: these stand apart in the summary. With --data (a folder with the public
logs ``tx40``, ``ur10e`` and ``emps``) the same is made of these logs, whole and in thirds, as they are and with a reversed torque.
Printed are the iterations by weight of the prior, the processor time of a solution whose conditions are built, and every problem
that needs more than 20 iterations; --draws times 200 draws of the TX40. Exit code 1 where a problem is not solved.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import didim
from didim.model.dynamics import regressor
from didim.regression.consistent.prior import Prior, generic_prior
from didim.regression.consistent.problem import ConstrainedProblem, Simulability
from didim.regression.consistent.solver import triangle_of
from didim.regression.fit import Fit, Progress
from didim.regression.least_squares import solve
from didim.regression.settings import LeastSquaresSettings
from didim.terms.model import Model
from didim.terms.rows import LinearSystem

Array = NDArray[np.float64]

MOST = 20
"""Iterations of a problem at most."""
LONGEST = 5e-3
"""Processor time (s) of a solution at most."""
REPEATS = 3
"""Solutions of a problem, of which the fastest counts."""
GAMMAS = (0.0, 1e-6, 1e-4, 1e-2, 0.06, 1.0)
"""Weights of the prior (nats)."""
EXTREMES = ("speed 0.05", "noise 0.0001")
"""Labels of logs that hardly move or have hardly any noise."""
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


class Problem(NamedTuple):
    """A constrained problem, its rows and right side, and what it is."""

    label: str
    problem: ConstrainedProblem
    rows: Array
    right: Array


def weighted(w: Array, y: Array, n_dof: int) -> tuple[Array, Array]:
    """Return triangle and right side of rows joint by joint, in units of the residuals of each joint."""
    sizes = np.linalg.norm(w, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    rest = y - w @ (np.linalg.lstsq(w / sizes, y, rcond=1e-10)[0] / sizes)
    sigma = np.sqrt(np.mean(rest.reshape(n_dof, -1) ** 2, axis=1))
    sigma = np.repeat(np.maximum(sigma, 1e-6 * np.abs(y).max()), len(y) // n_dof)
    return triangle_of(w / sigma[:, None], y / sigma)


def scaled(prior: Prior, factor: float) -> Prior:
    """Return a prior with bodies and rotors so many times as large."""
    return replace(prior, bodies=tuple(factor * body for body in prior.bodies), rotors=factor * prior.rotors)


def random_robot(rng: np.random.Generator) -> didim.Robot:
    """Return a chain of 1 to 9 joints, some with a coupled wrist."""
    n = int(rng.integers(1, 10))
    kinds = rng.choice(["revolute", "revolute", "revolute", "prismatic"], n)
    lines = ['schema = 1\nname = "chain"\ndescription = "random"\ngravity_m_s2 = [0.0, 0.0, -9.81]']
    for kind in kinds:
        tilt, length, place = rng.choice([0.0, 90.0, -90.0, 35.0]), *rng.choice([0.0, 0.1, 0.35], 2)
        variable = (
            f"theta_deg = 0.0\nr_m = {place}"
            if kind == "revolute"
            else f"theta_deg = {100.0 * place}\nr_m = 0.0"
        )
        lines.append(f'[[joint]]\nkind = "{kind}"\nalpha_deg = {tilt}\nd_m = {length}\n{variable}')
    if n >= 2 and kinds[-1] == kinds[-2] == "revolute" and rng.random() < 0.5:
        matrix = np.eye(n)
        matrix[-1, -2] = rng.choice([1.0, -0.7])
        lines.append(f"[transmission]\ncoupling = {matrix.tolist()}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "chain.toml")
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return didim.load_robot(path).with_smoothing([0.01] * n)


def random_log(rng: np.random.Generator, robot: didim.Robot) -> tuple[Array, Array, str]:
    """Return rows and torques of a random log, joint by joint."""
    n, base = robot.n_dof, robot.base_parameters
    samples = int(rng.choice([20, 60, 200]))
    slow = float(rng.choice([0.05, 0.5, 1.0, 3.0]))
    t = np.linspace(0.0, 10.0, samples)
    motion = np.zeros((3, samples, n))
    for harmonic in range(1, 6):
        phase, size = rng.uniform(0.0, 2.0 * np.pi, n), rng.normal(size=n) / harmonic
        rate = 0.6 * slow * harmonic
        angle = rate * t[:, None] + phase
        motion += size * np.array([np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)])
    rows = regressor(robot, *motion)
    w = rows.transpose(1, 0, 2).reshape(n * samples, -1)
    x = generic_prior(robot).parameters(robot)
    light = rng.uniform(0.3, 1.0) ** np.array(
        [int(name.lstrip("XYZMIFacvmOf").rstrip("+-") or 1) for name in robot.parameter_names]
    )
    x = x * light * np.exp(rng.normal(size=len(x)) * 0.3)
    if rng.random() < 0.4:
        x = x + 0.3 * np.abs(x).mean() * rng.normal(size=len(x)) * light
    tau = (w @ x).reshape(n, samples)
    noise = float(rng.choice([1e-4, 1e-2, 0.1, 1.0]))
    tau = tau + noise * np.sqrt(np.mean(tau**2, axis=1, keepdims=True) + 1e-12) * rng.normal(size=tau.shape)
    if rng.random() < 0.15:
        tau[rng.integers(n)] *= -1.0
    return (
        np.asarray(w[:, base.indices]),
        tau.reshape(-1),
        f"{n} joints, {samples} samples, speed {slow:g}, noise {noise:g}",
    )


def simulability(rng: np.random.Generator, n: int) -> Simulability | None:
    """Return conditions (B), or none."""
    step = rng.choice([0.0, 0.0, 1e-4, 2.5e-5])
    return (
        None
        if step == 0.0
        else Simulability(float(step), 1.5, (float(rng.choice([0.0, 5.0])),) * n, (0.01,) * n)
    )


def random_problems(count: int, seed: int = 0) -> Iterator[Problem]:
    """Return problems of random logs."""
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        robot = random_robot(rng)
        w, y, label = random_log(rng, robot)
        gamma = float(rng.choice(GAMMAS))
        prior = scaled(generic_prior(robot), float(rng.choice([0.1, 1.0, 1.0, 10.0])))
        chosen = simulability(rng, robot.n_dof)
        problem = ConstrainedProblem(Model(robot), prior, gamma, None, chosen)
        step = "" if chosen is None else f", steps of {chosen.step_s:g} s"
        yield Problem(
            f"random {number}: {label}, gamma {gamma:g}{step}", problem, *weighted(w, y, robot.n_dof)
        )


@dataclass
class Seen:
    """A solver that keeps the systems that it is given."""

    found: list[tuple[Model, LinearSystem]]

    def for_model(self, model: Model) -> Callable[..., Fit]:
        """Return the solver for a model."""

        def seen(
            system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
        ) -> Fit:
            self.found.append((model, system))
            return solve(system, settings, progress)

        return seen


def real_logs(data: Path) -> Iterator[tuple[str, Model, Array, Array]]:
    """Return rows (n, samples, b) and torques (n, samples) of the public logs."""
    for name, folder in (("tx40_log_best", "tx40"), ("emps", "emps"), ("ur10e_currents", "ur10e")):
        experiment = didim.load_experiment(EXAMPLES / f"{name}.toml", data=data / folder)
        if name == "ur10e_currents":
            known = [14.87, 13.26, 11.13, 10.62, 11.03, 11.47]
            recording = experiment.recordings[0]
            experiment = replace(experiment, recordings=(recording.with_gains(np.array(known)),))
        seen = Seen([])
        didim.identify(experiment, didim.IDIMLS(solver=seen, compensate_samples=0))
        model, system = seen.found[-1]
        n = model.own.n_dof
        yield folder, model, system.w.reshape(n, -1, system.w.shape[1]), system.y.reshape(n, -1)


def real_problems(data: Path) -> Iterator[Problem]:
    """Return problems of the public logs: parts, priors, weights, conditions, reversed torques."""
    for name, model, w, y in real_logs(data):
        n, samples = y.shape
        parts = {"whole": (0, samples)}
        parts |= {f"third {k + 1}": (k * samples // 3, (k + 1) * samples // 3) for k in range(3)}
        faults = (None, *range(n))
        rng = np.random.default_rng(len(name))
        for (part, (first, last)), fault in itertools.product(parts.items(), faults):
            tau = y[:, first:last].copy()
            if fault is not None:
                tau[fault] *= -1.0
            triangle, right = weighted(w[:, first:last].reshape(-1, w.shape[2]), tau.reshape(-1), n)
            for gamma in GAMMAS:
                prior = scaled(generic_prior(model.own), float(rng.choice([0.1, 1.0, 1.0, 10.0])))
                chosen = simulability(rng, n)
                problem = ConstrainedProblem(model, prior, gamma, None, chosen)
                step = "" if chosen is None else f", steps of {chosen.step_s:g} s"
                wrong = "" if fault is None else f", torque {fault + 1} reversed"
                noise = float(rng.choice([0.0, 1.0])) * rng.normal(size=right.shape)
                yield Problem(
                    f"{name}, {part}{wrong}, gamma {gamma:g}{step}", problem, triangle, right + noise
                )


def draws(data: Path) -> str:
    """Return a sentence on 200 draws of the TX40."""
    experiment = didim.load_experiment(EXAMPLES / "tx40_log_best.toml", data=data / "tx40")
    fit = didim.identify(experiment, didim.IDIMLS())
    begin, wall = time.process_time(), time.monotonic()
    fit.consistent(draws=200)
    spent, passed = time.process_time() - begin, time.monotonic() - wall
    return f"200 draws of the TX40: {spent:.2f} s of processor time, {passed:.2f} s by the clock"


def summary(what: str, rows: list[dict[str, Any]]) -> str:
    """Return a sentence on iterations and processor time."""
    iterations, times, built = (np.array([row[key] for row in rows]) for key in ("n", "s", "build"))
    failed = sum(row["ending"] != "solved" for row in rows)
    milliseconds = 1e3 * times
    return (
        f"logs {what}: {len(rows)} problems, {failed} not solved, {np.sum(iterations > MOST)} with more than {MOST} iterations; "
        f"{np.median(iterations):.0f} in the median, {iterations.max()} at most; processor time of a solution "
        f"{np.median(milliseconds):.1f} ms in the median, {np.quantile(milliseconds, 0.99):.1f} ms in 99 of 100, "
        f"{milliseconds.max():.1f} ms at most, {np.sum(times > LONGEST)} above {1e3 * LONGEST:g} ms; "
        f"of building its conditions {1e3 * np.median(built):.1f} ms in the median"
    )


def main() -> int:
    """Run the bench."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--random", type=int, default=1100, help="problems of random logs")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random logs")
    parser.add_argument("--data", type=Path, help="folder of the public logs")
    parser.add_argument("--draws", action="store_true", help="time 200 draws too")
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = []
    collection = itertools.chain(
        random_problems(asked.random, asked.seed), [] if asked.data is None else real_problems(asked.data)
    )
    for label, problem, triangle, right in collection:
        begin = time.process_time()
        problem.solve(triangle, right)
        built = time.process_time() - begin
        spent = np.inf
        for _ in range(REPEATS):
            begin = time.process_time()
            solved = problem.solve(triangle, right)
            spent = min(spent, time.process_time() - begin)
        row = {"gamma": problem.gamma, "ending": solved.ending, "n": solved.iterations, "s": spent}
        row["build"] = max(built - spent, 0.0)
        rows.append({**row, "extreme": any(extreme in label for extreme in EXTREMES)})
        if solved.ending != "solved" or solved.iterations > MOST:
            print(f"{label}: {solved.ending}, {solved.iterations} iterations", flush=True)
    for gamma in GAMMAS:
        needed = [row["n"] for row in rows if row["gamma"] == gamma]
        if needed:
            counts = " ".join(f"{n}:{times}" for n, times in sorted(Counter(needed).items()))
            print(f"gamma {gamma:g}, {len(needed)} problems, iterations {counts}")
    for what, extreme in (("usual", False), ("that hardly move, or have hardly any noise", True)):
        chosen = [row for row in rows if row["extreme"] == extreme]
        if chosen:
            print(summary(what, chosen))
    if asked.draws and asked.data is not None:
        print(draws(asked.data))
    return int(any(row["ending"] != "solved" for row in rows))


if __name__ == "__main__":
    sys.exit(main())
