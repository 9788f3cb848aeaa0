"""Friction chosen on one real log, judged on another: errors of torques that nothing was fitted to.

    python benches/friction_held_out.py DATA [--arms tx40 ur10e emps ur10 panda tiago kr300]
    python benches/friction_held_out.py DATA --between
    python benches/friction_held_out.py DATA --picture docs/img/friction.png

prints, for public logs in DATA, the error (%) without further friction terms and with `friction = "auto"`. Logs of which there is
one only are cut in parts after their filters, and each part is predicted from the others. The load of the UR10e is unknown:
friction comes from one log, and rigid parameters are fitted to the other. docs/friction.md has the table. `--between`
compares estimates from parts of a log, or from two logs, by their standard deviations. The picture shows the
friction of two joints of the UR10e over speed, and what laws leave of it over the way since a reversal.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import didim
from didim.cli.main import main as didim_command
from didim.plot.style import CYCLE, MEASURED, MODEL, new_figure, plain_ticks, styled
from didim.regression.friction.choice import choose_terms
from didim.regression.friction.velocity import settled
from didim.result.iteration import Reporter
from didim.signal.noise import coarsest_steps
from didim.signal.processing import SignalProcessing
from didim.terms.model import Model, torques

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from test_springs import OPTIONS, moving
from test_springs import kr300 as kr300_robot

Array = NDArray[np.float64]
UR10E_GAINS = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])
"""Drive gains of the UR10e by its publishers (N.m/A)."""
UR10E_MOVES = {"free": (195, 4966), "loaded": (308, 5071)}
"""Rows of the UR10e's logs in which the arm moves."""
FITS = 4
"""Fits of rigid parameters beside given friction: each has the load and the weights of the one before."""


class Cut(SignalProcessing):
    """Filters of a log of which some decimated rows are used."""

    rows: slice | Array = slice(None)

    @property
    def kept_rows(self) -> slice:  # an array of places serves as well
        """Rows that are used."""
        return Cut.rows  # type: ignore[return-value]

    @classmethod
    def of(cls, signal: SignalProcessing) -> Cut:
        """Return the same filters."""
        return cls(**{field.name: getattr(signal, field.name) for field in dataclasses.fields(signal)})


def fitted(experiment: didim.Experiment, auto: bool) -> tuple[didim.Robot, Array, str]:
    """Return the robot with its friction, its base parameters, and the terms that were chosen."""
    job = didim.IDIMLS().job(experiment)
    parts = job.parts("fit", job.delay())

    robot = experiment.robot
    if auto:
        steps = coarsest_steps(one.measured_positions() for one in experiment.recordings if one.role == "fit")
        choice = choose_terms(job.model, parts, job.signal, job.estimate, steps)
        robot = robot.with_terms(choice.friction.terms)
    found = settled(job.model.with_robot(robot), parts, job.signal, job.estimate)
    beta = found.beta
    if auto:  # among robots, as a fit with chosen laws is solved
        job = didim.IDIMLS(physical=True).job(replace(experiment, robot=found.robot))
        beta = job.model.unknowns.expand(job.solve(found.system).solution)
    return found.robot, beta, " ".join(term.parameter for term in found.robot.friction.terms)


def errors(
    experiment: didim.Experiment, robot: didim.Robot, beta: Array, refit: bool = False
) -> tuple[Array, Array]:
    """Return the error of the predicted torques and the torques, rows joint by joint; `refit`: rigid parameters are fitted."""
    job = didim.IDIMLS().job(replace(experiment, robot=robot))
    parts = job.parts("fit", job.delay())
    rigid = np.array([not name.startswith(("F", "Rest", "Off")) for name in robot.base_parameters.names])
    beta = beta.copy()
    for _ in range(FITS if refit else 1):
        system = Model(robot).rows(parts, job.signal, beta)
        if refit:
            rest, scale = system.y - system.w[:, ~rigid] @ beta[~rigid], np.ones(system.y.size)
            for _ in range(FITS):
                beta[rigid] = np.linalg.lstsq(system.w[:, rigid] * scale[:, None], rest * scale, rcond=None)[
                    0
                ]
                left = rest - system.w[:, rigid] @ beta[rigid]
                for rows in system.joints:
                    scale[rows] = 1.0 / np.sqrt(np.mean(left[rows] ** 2))
    return system.y - system.w @ beta, system.y


def percent(error: Array, torque: Array) -> float:
    """Return the relative error."""
    return float(100.0 * np.linalg.norm(error) / np.linalg.norm(torque))


def in_parts(experiment: didim.Experiment, parts: int, auto: bool) -> tuple[float, list[str]]:
    """Return the error of each part of a log predicted from the others, all together, and the terms of each fit."""
    experiment = replace(experiment, signal=Cut.of(experiment.signal))
    Cut.rows = slice(None)
    job = didim.IDIMLS().job(experiment)
    total = sum(torques(part, job.signal).shape[1] for part in job.parts("fit"))
    edges = np.linspace(0, total, parts + 1).round().astype(int)
    missed, torque, names = [], [], []
    for k in range(parts):
        Cut.rows = np.r_[tuple(np.arange(edges[i], edges[i + 1]) for i in range(parts) if i != k)]
        robot, beta, terms = fitted(experiment, auto)
        Cut.rows = np.arange(edges[k], edges[k + 1])
        error, y = errors(experiment, robot, beta)
        missed.append(error)
        torque.append(y)
        names.append(terms)
    return percent(np.concatenate(missed), np.concatenate(torque)), names


def ur10e(data: Path, name: str) -> didim.Experiment:
    """Return a log of the UR10e at even times, its currents times the published gains."""
    start, stop = UR10E_MOVES[name]
    table = np.loadtxt(data / f"ur10e/{name}.csv", delimiter=",")[start:stop]
    t = table[:, 0] - table[0, 0]
    even = np.arange(0.0, t[-1], 0.01)
    q, current = (
        np.column_stack([np.interp(even, t, table[:, column]) for column in columns])
        for columns in (range(1, 7), range(13, 19))
    )
    return didim.Experiment(
        name=f"UR10e, {name}",
        robot=didim.load_robot(data / "ur10e/ur10e.urdf").with_friction(dead_zone_rad_s=0.01),
        recordings=(didim.Recording.from_arrays(q, current * UR10E_GAINS, rate_hz=100.0),),
        signal=didim.SignalProcessing(cutoff_hz=8.5, trim_start=24, trim_end=24, decimation=(5,)),
    )


def initialised(robot: str, files: list[Path], options: list[str], plain: bool = True) -> didim.Experiment:
    """Return the experiment that `didim init` makes of a log, without friction laws where it is `plain`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.toml"
        options = [*options, *(["--plain"] if plain else []), "-o", str(path)]
        didim_command(["init", robot, *map(str, files), *options])
        return didim.load_experiment(path)


def unisa(data: Path, which: str) -> didim.Experiment:
    """Return the UR10 or the Panda of ROS bags."""
    files = [data / "unisa" / f"{which}_exciting.db3"]
    return initialised(which, files if which == "panda" else [*files, data / "unisa/ur10_validation.db3"], [])


def tiago(data: Path) -> didim.Experiment:
    """Return the log of the TIAGo."""
    files = [data / f"tiago/tiago_{what}.csv" for what in ("position", "velocity", "effort")]
    return initialised(str(data / "tiago/tiago_48_hey5.urdf"), files, [])


def kr300(data: Path, whole: bool = False) -> didim.Experiment:
    """Return both recordings of the KR300 where it moves, or whole."""
    from scipy.io import loadmat

    logs = [data / f"kr300/{run}.mat" for run in "AB"]
    ratios = loadmat(logs[0])["para"][0, 0]["u"].ravel()
    with tempfile.TemporaryDirectory() as folder:
        both = initialised(str(kr300_robot(Path(folder), ratios, "")), logs, OPTIONS)
    if whole:
        return both
    parts = [moving(replace(both, recordings=(one,))).recordings[0] for one in both.recordings]
    return replace(both, recordings=tuple(parts))


Terms = Literal["plain", "auto, laws of the first", "auto, laws of all", "auto, own laws"]


def between(logs: Sequence[didim.Experiment], parts: int, terms: Terms) -> tuple[float, float, float]:
    """Return the differences of estimates over their standard deviations, rms: of logs, or of a log's parts.

    Of all parameters; of those without offsets; and of those that more than one block of either determines, whose standard
    deviation is that of the jackknife.

    With laws of the first log, or of all logs together, all estimates have the same, whose velocities have their columns in each
    covariance. With laws that each part chooses for itself, friction of a joint is compared where its laws are the same: elsewhere
    it is defined otherwise.
    """
    logs = [replace(log, signal=Cut.of(log.signal)) for log in logs]
    method = didim.IDIMLS(uncertainty="jackknife")
    Cut.rows = slice(None)
    recordings = tuple(one for log in logs for one in log.recordings)
    chosen_on = replace(logs[0], recordings=recordings) if terms == "auto, laws of all" else logs[0]
    robot = fitted(chosen_on, terms != "plain")[0]
    estimates = []
    for log in logs:
        job = didim.IDIMLS().job(log)
        total = sum(torques(part, job.signal).shape[1] for part in job.parts("fit"))
        for start, stop in pairwise(np.linspace(0, total, parts + 1).round().astype(int)):
            Cut.rows = np.arange(start, stop)
            robot = fitted(log, True)[0] if terms == "auto, own laws" else robot
            estimates.append((robot, method.run(replace(log, robot=robot), Reporter())))
        Cut.rows = slice(None)
    ratios: list[tuple[str, bool, float]] = []
    for (one_robot, one), (two_robot, two) in combinations(estimates, 2):
        values = dict(zip(two.names, zip(two.beta, two.std, strict=True), strict=True))
        other = {
            str(joint + 1) for joint in range(robot.n_dof) if laws(one_robot, joint) != laws(two_robot, joint)
        }
        for name, value, std in zip(one.names, one.beta, one.std, strict=True):
            if name not in values or (name.startswith("F") and name[-1] in other):
                continue
            size = np.hypot(std, values[name][1])
            if std > 0.0 and values[name][1] > 0.0:
                single = any(fit.uncertainty and name in fit.uncertainty.single_block for fit in (one, two))
                ratios.append((name, single, (value - values[name][0]) / size))
    kinds = (
        [ratio for *_, ratio in ratios],
        [ratio for name, _, ratio in ratios if not name.startswith("Off")],
        [ratio for _, single, ratio in ratios if not single],
    )
    every, without, several = (float(np.sqrt(np.mean(np.square(kind)))) for kind in kinds)
    return every, without, several


def laws(robot: didim.Robot, joint: int) -> set[str]:
    """Return the laws of a joint that have a parameter."""
    return {term.law for term in robot.friction.terms if term.joint == joint and term.law != "hold"}


JOINTS = (1, 3)
"""Joints of the picture, from 0: one with friction that falls with speed, one without."""
STAGES = {
    "sign with a dead zone": frozenset[str](),
    "sign kept through rest": frozenset(("hold",)),
    "with speed and load": frozenset(("hold", "rest", "atan", "stribeck", "load", "forward")),
    "with memory, all that auto chose": frozenset(
        ("hold", "rest", "atan", "stribeck", "load", "forward", "dahl")
    ),
}
"""Laws of each curve of the picture."""
WAYS = np.array([1e-4, 3e-4, 1e-3, 2e-3, 4e-3, 8e-3, 0.016, 0.03, 0.06, 0.12, 0.25])
"""Edges of the ways since a reversal over which residuals are averaged (rad)."""


def ways(q: Array) -> Array:
    """Return the way of a joint since its last reversal at each sample (rad), (n_samples,)."""
    moves = np.sign(np.diff(q))
    way, origin, sign = np.zeros(q.size), q[0], 0.0
    for k, move in enumerate(moves, start=1):
        if move and move != sign:
            origin, sign = q[k - 1], move
        way[k] = abs(q[k] - origin)
    return way


def staged(experiment: didim.Experiment) -> Iterator[tuple[str, Array, Array, Array]]:
    """Yield each stage with residuals, friction and measured friction (N.m) at all samples, (n_dof, n_samples) each."""
    chosen, _, _ = fitted(experiment, True)
    job = didim.IDIMLS().job(experiment)
    parts = job.parts("fit", job.delay())
    for name, laws in STAGES.items():
        terms = [term for term in chosen.friction.terms if term.law in laws]
        robot, beta, _ = fitted(replace(experiment, robot=experiment.robot.with_terms(terms)), False)
        system = Model(robot).rows(parts, replace(job.signal, decimation=()), beta)
        own = np.array([column.startswith(("F", "Rest", "Off")) for column in system.names])
        friction, rigid = (system.w[:, part] @ beta[part] for part in (own, ~own))
        found = (system.y - friction - rigid, friction, system.y - rigid)
        residual, modelled, measured = (
            np.stack([values[rows] for rows in system.joints]) for values in found
        )
        yield name, residual, modelled, measured


@styled
def picture(data: Path, file: Path) -> None:
    """Draw torque over speed and residuals over the way since a reversal of two joints."""
    experiment = ur10e(data, "free")
    job = didim.IDIMLS().job(experiment)
    (part,) = job.parts("fit", job.delay())
    figure = new_figure(5.4, 9.5)
    panels = figure.subplots(len(JOINTS), 2)
    stages = list(staged(experiment))
    _, _, modelled, measured = stages[-1]
    for (left, right), joint in zip(panels, JOINTS, strict=True):
        dq, way = part.dq[:, joint], ways(part.q[:, joint])
        left.plot(
            dq, measured[joint], ".", color=MEASURED, markersize=1.5, label="measured less links and rotors"
        )
        left.plot(dq, modelled[joint], color=MODEL, linewidth=0.6, label="all that auto chose")
        left.set(
            title=f"Friction of joint {joint + 1}, UR10e", xlabel="velocity (rad/s)", ylabel="torque (N.m)"
        )
        centre = np.sqrt(WAYS[1:] * WAYS[:-1])
        for colour, (name, residual, _, _) in zip(CYCLE, stages, strict=False):
            along = residual[joint] * np.sign(dq)
            means = [along[(way >= a) & (way < b)].mean() for a, b in pairwise(WAYS)]
            right.plot(centre, means, "o-", color=colour, markersize=3.0, label=name)
        right.set_xscale("log")
        plain_ticks(right.xaxis)
        right.set(
            title=f"What the laws leave at joint {joint + 1}, mean along the motion",
            xlabel="way since the reversal (rad)",
            ylabel="torque (N.m)",
        )
    for panel in panels[0]:
        panel.legend(loc="lower right")
    figure.savefig(file, dpi=70)
    Image.open(file).convert("RGB").quantize(128).save(file, optimize=True)


Case = tuple[str, Callable[[bool], tuple[float, list[str]]]]


def cases(data: Path, examples: Path, arms: list[str]) -> Iterator[Case]:
    """Yield what is predicted from what, and how."""

    def across(
        one: didim.Experiment, other: didim.Experiment, refit: bool
    ) -> Callable[[bool], tuple[float, list[str]]]:
        def run(auto: bool) -> tuple[float, list[str]]:
            robot, beta, terms = fitted(one, auto)
            return percent(*errors(other, robot, beta, refit)), [terms]

        return run

    def cut(experiment: didim.Experiment, parts: int) -> Callable[[bool], tuple[float, list[str]]]:
        return lambda auto: in_parts(experiment, parts, auto)

    if "tx40" in arms:
        yield (
            "TX40 in thirds",
            cut(didim.load_experiment(examples / "tx40_log_best.toml", data=data / "tx40"), 3),
        )
    if "ur10e" in arms:
        free, loaded = ur10e(data, "free"), ur10e(data, "loaded")
        yield "UR10e, loaded from free", across(free, loaded, True)
        yield "UR10e, free from loaded", across(loaded, free, True)
    if "emps" in arms:
        yield "EMPS in thirds", cut(didim.load_experiment(examples / "emps.toml", data=data / "emps"), 3)
    for which in ("ur10", "kr300"):
        if which in arms:
            both = unisa(data, which) if which == "ur10" else kr300(data)
            first, second = (
                replace(both, recordings=(replace(one, role="fit"),)) for one in both.recordings[:2]
            )
            yield (
                f"{which}, {second.recordings[0].name} from {first.recordings[0].name}",
                across(first, second, False),
            )
            yield (
                f"{which}, {first.recordings[0].name} from {second.recordings[0].name}",
                across(second, first, False),
            )
    if "panda" in arms:
        yield "Panda in halves", cut(unisa(data, "panda"), 2)
    if "tiago" in arms:
        yield "TIAGo in halves", cut(tiago(data), 2)


def compared(
    data: Path, examples: Path, arms: list[str]
) -> Iterator[tuple[str, list[didim.Experiment], int]]:
    """Yield logs of one robot and the number of parts of each that are compared."""
    for which in ("ur10", "kr300"):
        if which in arms:
            both = unisa(data, which) if which == "ur10" else kr300(data)
            fit = [replace(both, recordings=(replace(one, role="fit"),)) for one in both.recordings[:2]]
            yield f"{which}, two logs", fit, 1
            for log in fit:
                yield f"{which}, halves of {log.recordings[0].name}", [log], 2
    if "tx40" in arms:
        yield "TX40, thirds", [didim.load_experiment(examples / "tx40_log_best.toml", data=data / "tx40")], 3
    if "ur10e" in arms:
        for name in UR10E_MOVES:
            yield f"UR10e, halves of the {name} log", [ur10e(data, name)], 2
    if "emps" in arms:
        yield "EMPS, thirds", [didim.load_experiment(examples / "emps.toml", data=data / "emps")], 3
    if "panda" in arms:
        yield "Panda, halves", [unisa(data, "panda")], 2
    if "tiago" in arms:
        yield "TIAGo, halves", [tiago(data)], 2


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    every = ["tx40", "ur10e", "emps", "ur10", "panda", "tiago", "kr300"]
    parser.add_argument("--arms", nargs="+", choices=every, default=every)
    parser.add_argument("--picture", type=Path, help="write this PNG in place of the table")
    parser.add_argument(
        "--between", action="store_true", help="compare estimates of parts in place of errors"
    )
    args = parser.parse_args()
    if args.picture:
        picture(args.data, args.picture)
        return 0
    examples = Path(__file__).resolve().parents[1] / "examples"
    if args.between:
        kinds = get_args(Terms)
        what = "differences of estimates over their standard deviations, rms (without offsets; without parameters of one block)"
        print(f"{what}: {'; '.join(kinds)}", flush=True)
        for name, logs, parts in compared(args.data, examples, args.arms):
            pairs = [between(logs, parts, terms) for terms in kinds]
            print(
                f"{name:45} {' '.join(f'{one:7.2f} ({two:.2f}; {three:.2f})' for one, two, three in pairs)}",
                flush=True,
            )
        return 0
    print(f"{'predicted':45} {'plain':>7} {'auto':>7}   seconds, terms", flush=True)
    for name, run in cases(args.data, examples, args.arms):
        plain, _ = run(False)
        start = time.process_time()
        auto, terms = run(True)
        print(
            f"{name:45} {plain:7.2f} {auto:7.2f}   {time.process_time() - start:.1f}, {' | '.join(terms)}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
