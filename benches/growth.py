"""How the cost grows: with samples, joints, candidates and threads.

    python benches/growth.py [--json FILE]

needs ``pip install didim[test]`` (the random robots are those of the tests). Each curve is
measured in alternating rounds over all of its sizes. The exponent is the slope of log(smallest time) over log(size), fitted
to the larger half of the sizes: below, what a call costs at all hides it. One thread, unless threads are what is counted.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from peer.threads import THREADS  # before NumPy is imported

# isort: split
import numpy as np
from numpy.typing import NDArray
from peer.task import Task, tx40
from peer.timing import Contestant, Figures, alternate, one_core, seconds

import didim
from didim.experiment.experiment import Experiment
from didim.experiment.specs import Measurement
from didim.log.recording import Recording
from didim.loop.closed_loop import ClosedLoop
from didim.loop.tuning import mean_inertia
from didim.regression import least_squares
from didim.regression.settings import LeastSquaresSettings
from didim.robot.placement import Mount
from didim.robot.robot import Geometry, Robot
from didim.signal.processing import SignalProcessing
from didim.studies.simulated_log import measured as with_noise
from didim.terms.rows import LinearSystem, stacked

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from robots import make_robot, random_motion, random_parameters
from simulated import closed_loop_log

Array = NDArray[np.float64]

ROUNDS = 3
MORE_ROUNDS = 7
"""Factor on the rounds of a measurement that takes milliseconds."""
RATE_HZ = 1000.0
STEP_S = 1e-3
DURATIONS_S = (1, 3, 10, 30, 100, 300, 1000)
JOINTS = tuple(range(1, 13))
CANDIDATES = (1, 4, 10, 40, 100, 400, 1000, 4000, 10_000)
SHORT_S = 0.1
"""Simulated time where candidates are counted."""
LEGS = (1, 2, 3, 4)
LEG_SAMPLES = 500
"""Rows of each joint where legs are counted."""
LEG_LOG_S = 20.0
"""Length of the log of legs."""
LOOP_METHODS = (didim.DIDIM(physical=False), didim.CLOE(start="idim-ls", output="both"))
"""Methods that simulate, over the log of legs in closed loop."""
BATCH, CACHED = 1024, 256
"""Samples where joints are counted; of the regressor, whose 12 joints would fill more than a cache."""
LIMITS: dict[str, Any] = {
    "max_position": [1.5] * 6,
    "max_velocity": [4.0] * 6,
    "max_acceleration": [25.0] * 6,
}
"""Limits of the random motions (rad, rad/s, rad/s^2)."""
TORQUE_NOISE = 0.1
"""Standard deviation (N.m) in the logs."""
ENCODER_NOISE = 1e-6
"""Standard deviation of positions (rad) in the logs of legs in closed loop."""


@dataclass(frozen=True)
class Curve:
    """A cost over sizes.

    Attributes
    ----------
    name : str
        What is done.
    over : str
        What is counted.
    runs : dict of int to callable
        Work by size.
    one_core : bool
        Whether the whole process is kept on one core, for work that takes all of them and has no option for threads.
    more_rounds : int
        So many times the rounds that are asked for.
    """

    name: str
    over: str
    runs: Mapping[int, Callable[[], object]]
    one_core: bool = False
    more_rounds: int = 1


def main() -> int:
    """Print exponents."""
    parser = argparse.ArgumentParser(description="Measure how the cost grows.")
    parser.add_argument("--json", metavar="FILE", type=Path, help="also write all times as JSON")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="rounds (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="one round over the smallest three sizes")
    arguments = parser.parse_args()
    if arguments.rounds < 1:
        parser.error(f"--rounds must be at least 1, got {arguments.rounds}")
    rounds = 1 if arguments.quick else arguments.rounds
    measured: list[tuple[Curve, dict[int, Figures]]] = []
    for make in (over_samples, over_joints, over_legs, over_candidates, over_threads):
        for curve in make(arguments.quick):
            measured.append((curve, measure(curve, rounds * (1 if arguments.quick else curve.more_rounds))))
            tell(*measured[-1])
    if arguments.json is not None:
        content = [record(curve, figures) for curve, figures in measured]
        arguments.json.write_text(
            json.dumps({"threads": THREADS, "curves": content}, indent=2) + "\n", encoding="utf-8"
        )
    return 0


def over_samples(quick: bool) -> list[Curve]:
    """Costs of a log or a motion of the TX40 at 1 kHz, by its length in seconds."""
    task = tx40()
    durations = DURATIONS_S[:3] if quick else DURATIONS_S
    experiments = {duration: _log(task, duration) for duration in durations}
    return [
        Curve(
            "IDIM-LS of a TX40 log, arrays to estimate",
            "seconds of the log",
            {duration: partial(didim.identify, log, didim.IDIMLS()) for duration, log in experiments.items()},
            one_core=True,
        ),
        Curve(
            "closed loop of a TX40, 1 candidate",
            "seconds of the motion",
            {duration: _simulation(_loop(task, float(duration)), task.x, 1, 1) for duration in durations},
        ),
    ]


def over_joints(quick: bool) -> list[Curve]:
    """Costs of chains of random joints, by their number: each chain is the beginning of the next one."""
    rng = np.random.default_rng(0)
    largest = max(JOINTS)
    alpha = rng.choice([0.0, np.pi / 2.0, -np.pi / 2.0], largest)
    lengths = rng.uniform(0.05, 0.4, (2, largest))
    theta = rng.uniform(-3.0, 3.0, largest)
    runs: dict[str, dict[int, Callable[[], object]]] = {}
    for n in JOINTS[:3] if quick else JOINTS:
        robot = make_robot(
            Geometry(
                kinds=("revolute",) * n,
                alpha=tuple(alpha[:n]),
                d=tuple(lengths[0, :n]),
                theta=tuple(theta[:n]),
                r=tuple(lengths[1, :n]),
                gravity=(0.0, 0.0, -9.81),
                coupling=tuple(tuple(row) for row in np.eye(n).tolist()),
            ),
            coulomb="tanh",
            smoothing=(0.05,) * n,
        )
        for name, run in _chain(robot, rng).items():
            runs.setdefault(name, {})[n] = run
    return [Curve(name, "joints", by_size, more_rounds=MORE_ROUNDS) for name, by_size in runs.items()]


def _chain(robot: Robot, rng: np.random.Generator) -> dict[str, Callable[[], object]]:
    x, motion = random_parameters(rng, robot), random_motion(rng, BATCH, robot.n_dof)
    q, dq, ddq = motion.q, motion.dq, motion.ddq
    few = [np.ascontiguousarray(values[:CACHED]) for values in (q, dq, ddq)]
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    limits = np.ones(robot.n_dof)
    reference = didim.Reference.random_fourier(
        harmonics=5, period_s=10.0, max_position=limits, max_velocity=limits, max_acceleration=2.0 * limits
    )
    controller = didim.Controller.tuned([5.0] * robot.n_dof, 0.7, mean_inertia(robot, x, reference))
    loop = ClosedLoop.of(
        robot, reference, controller, rate_hz=RATE_HZ, duration_s=1.0, step=STEP_S, fine_step=STEP_S
    )
    return {
        f"inverse_dynamics, {BATCH} samples": lambda: didim.inverse_dynamics(robot, q, dq, ddq, x),
        f"direct_dynamics, {BATCH} samples": lambda: didim.direct_dynamics(robot, q, dq, tau, x),
        f"regressor, {CACHED} samples": lambda: didim.regressor(robot, *few),
        "closed loop of 1000 steps, 4 candidates": _simulation(loop, x, 4, 1),
    }


def over_legs(quick: bool) -> list[Curve]:
    """Costs of a trunk that is held with legs of three joints each: those of the legs one by one, if the exponent is 1."""
    runs: dict[str, dict[int, Callable[[], object]]] = {}
    for count in LEGS[:3] if quick else LEGS:
        n, rng = 3 * count, np.random.default_rng(0)
        robot = make_robot(
            Geometry(
                kinds=("revolute",) * n,
                alpha=(0.0, np.pi / 2.0, 0.0) * count,
                d=(0.1, 0.05, 0.2) * count,
                theta=(0.0,) * n,
                r=(0.2, 0.0, 0.0) * count,
                gravity=(9.81, 0.0, 0.0),
                coupling=tuple(tuple(row) for row in np.eye(n).tolist()),
                mounts=tuple(Mount(parent=j - 1 if j % 3 else None) for j in range(n)),
            ),
            coulomb="tanh",
            smoothing=(0.05,) * n,
        )
        few = random_motion(rng, LEG_SAMPLES, n)
        base = robot.base_parameters
        columns = didim.regressor(robot, few.q, few.dq, few.ddq)[:, :, list(base.indices)]
        w = np.concatenate(list(np.moveaxis(columns, 1, 0)))
        system = LinearSystem(
            w=w,
            y=w @ rng.normal(size=len(base.names)) + rng.normal(size=len(w)),
            blocks=stacked(n, [LEG_SAMPLES]),
            names=tuple(base.names),
        )
        runs.setdefault("IDIM-LS, arrays to estimate and verdict", {})[count] = partial(
            didim.identify, _legs_log(robot, rng), didim.IDIMLS()
        )
        in_loop = _legs_in_loop(robot, rng)
        for method in LOOP_METHODS:
            runs.setdefault(f"{method.name}, simulations and verdict", {})[count] = partial(
                didim.identify, in_loop, method
            )
        # A system of its own each time: it remembers which rows share what.
        solution = f"solution of {LEG_SAMPLES} samples, sigma included"
        runs.setdefault(solution, {})[count] = partial(_solved, system)
        for name, run in _chain(robot, rng).items():
            runs.setdefault(name, {})[count] = run
    return [
        Curve(name, "legs", by_size, more_rounds=1 if "simulations" in name else MORE_ROUNDS)
        for name, by_size in runs.items()
    ]


def _legs_in_loop(robot: Robot, rng: np.random.Generator) -> Experiment:
    """Return a log of legs in closed loop, whose noise is white: its verdict looks for no cause of the residual."""
    n = robot.n_dof
    clean = closed_loop_log(robot, random_parameters(rng, robot))
    noise = Measurement(torque_noise=(TORQUE_NOISE,) * n, position_noise=(ENCODER_NOISE,) * n, seed=0)
    return with_noise(replace(clean, measurement=noise), 0)


def _legs_log(robot: Robot, rng: np.random.Generator) -> Experiment:
    reference = didim.Reference.random_fourier(
        harmonics=10,
        period_s=LEG_LOG_S,
        seed=1,
        max_position=[1.0] * robot.n_dof,
        max_velocity=[4.0] * robot.n_dof,
        max_acceleration=[25.0] * robot.n_dof,
    )
    q, dq, ddq = reference.at(np.arange(LEG_LOG_S * RATE_HZ) / RATE_HZ)
    tau = didim.inverse_dynamics(robot, q, dq, ddq, random_parameters(rng, robot))
    return _experiment(robot, q, tau + TORQUE_NOISE * rng.standard_normal(tau.shape))


def _solved(system: LinearSystem) -> object:
    return least_squares.solve(replace(system), LeastSquaresSettings())


def over_candidates(quick: bool) -> list[Curve]:
    """Cost of a batch of short simulations of the TX40, by its size."""
    task = tx40()
    loop = _loop(task, SHORT_S)
    sizes = CANDIDATES[:3] if quick else CANDIDATES
    runs = {size: _simulation(loop, task.x, size, 1) for size in sizes}
    return [Curve(f"closed loops of a TX40, {SHORT_S:g} s", "candidates", runs)]


def over_threads(quick: bool) -> list[Curve]:
    """Cost of the same work by threads."""
    task = tx40()
    size = 8 if quick else 1000
    loop = _loop(task, SHORT_S)
    runs = {threads: _simulation(loop, task.x, size, threads) for threads in (1, 2)}
    name = f"{size} closed loops of a TX40, {SHORT_S:g} s"
    return [Curve(name, "threads", runs, more_rounds=MORE_ROUNDS)]


def _log(task: Task, duration_s: int) -> Experiment:
    """Return a log with the torques of the model, plus noise: a second of motion over and over, since the shortest has no more."""
    reference = didim.Reference.random_fourier(harmonics=10, period_s=1.0, seed=1, **LIMITS)
    t = np.arange(duration_s * int(RATE_HZ)) / RATE_HZ
    q, dq, ddq = reference.at(t % reference.duration)
    tau = didim.inverse_dynamics(task.robot, q, dq, ddq, task.x)
    tau += TORQUE_NOISE * np.random.default_rng(1).standard_normal(tau.shape)
    return _experiment(task.robot, q, tau)


def _experiment(robot: Robot, q: Array, tau: Array) -> Experiment:
    return Experiment(
        name="simulated",
        robot=robot,
        recordings=(Recording.from_arrays(q, tau, rate_hz=RATE_HZ, name="log"),),
        signal=SignalProcessing(cutoff_hz=60.0, trim_start=50, trim_end=50, decimation=(5, 10)),
    )


def _loop(task: Task, duration_s: float) -> ClosedLoop:
    """Return the closed loop of the task for as long as that."""
    reference = didim.Reference.random_fourier(
        harmonics=20, period_s=10.0, duration_s=max(10.0, duration_s), seed=1, **LIMITS
    )
    return ClosedLoop.of(
        task.robot,
        reference,
        task.loop.controller,
        rate_hz=RATE_HZ,
        duration_s=duration_s,
        step=STEP_S,
        fine_step=STEP_S,
    )


def _simulation(loop: ClosedLoop, x: Array, candidates: int, threads: int) -> Callable[[], None]:
    xs, one = np.tile(x, (candidates, 1)), np.ones(loop.robot.n_dof)
    q = loop.reference.at(loop.t)[0]
    tau = np.zeros_like(q)

    def run() -> None:
        found, _ = loop.costs(xs, q, tau, weight_q=one, weight_tau=one, threads=threads)
        if not np.isfinite(found).all():
            raise SystemExit("a closed loop did not run to its end")

    return run


def measure(curve: Curve, rounds: int) -> dict[int, Figures]:
    """Seconds by size."""
    contestants = [
        Contestant(name=str(size), measure=seconds(run), unit="s", rounds=rounds)
        for size, run in curve.runs.items()
    ]
    contestants[0].measure()
    if curve.one_core:
        with one_core():
            found = alternate(contestants)
    else:
        found = alternate(contestants)
    return {int(name): figures for name, figures in found.items()}


def exponent(figures: Mapping[int, Figures]) -> float | None:
    """Slope in the larger half of the sizes; None where there are fewer than three of them."""
    sizes = sorted(figures)
    if len(sizes) < 3:
        return None
    upper = sizes[(len(sizes) - 1) // 2 :]
    smallest = [figures[size].smallest for size in upper]
    return float(np.polyfit(np.log(upper), np.log(smallest), 1)[0])


def tell(curve: Curve, figures: Mapping[int, Figures]) -> None:
    """Print a curve."""
    power = exponent(figures)
    print(f"{curve.name}, by {curve.over}{'' if power is None else f': exponent {power:.2f}'}")
    print(f"  {'':>8} {'smallest':>10} {'median':>10} s")
    for size, figure in figures.items():
        print(f"  {size:8d} {figure.smallest:10.4g} {figure.median:10.4g}", flush=True)
    if curve.over == "legs":
        most = max(figures)
        ratio = figures[most].smallest / (most * figures[1].smallest)
        print(f"  {most} legs cost {ratio:.2f} times as much as one by one", flush=True)


def record(curve: Curve, figures: Mapping[int, Figures]) -> dict[str, Any]:
    """Return a curve as JSON has it."""
    return {
        "name": curve.name,
        "over": curve.over,
        "one_core": curve.one_core,
        "exponent": exponent(figures),
        "sizes": list(figures),
        "smallest_s": [figure.smallest for figure in figures.values()],
        "median_s": [figure.median for figure in figures.values()],
        "rounds_s": [figure.rounds for figure in figures.values()],
    }


if __name__ == "__main__":
    sys.exit(main())
