"""Commands that tell drives and friction apart by positions alone: steps and chirps up to the bandwidth of the loop.

Slow commands show ``(Fv + kv)/kp`` and the delay as one number, and no inertia. Families of motions within the limits of the
joints are simulated with the values of the robot file, and the one with the narrowest intervals of all unknowns is taken: the
mean logarithm of ``f_k / |J_k|``, J the derivatives of the positions (`didim.methods.positions.knowledge`). Tested in
``tests/test_positions.py``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..._tools.arrays import Array
from ..._tools.files import write_atomically
from ..._tools.words import series
from ...errors import ExcitationError
from ...experiment.experiment import Experiment
from ...log.recording import Recording
from ...model.dynamics import inertia_matrix
from .columns import Values, file_values
from .knowledge import by_sentence, unidentified, widening
from .problem import Problem
from .search import begun

SWING = {"revolute": 0.3, "prismatic": 0.05}
"""Largest distance (rad, m) from the middle, if the joint's limits allow it: errors of links and gears stay small."""
SHARE_OF_RANGE = 0.4
"""Largest distance from the middle, as a share of the joint's range."""
SLOWEST_HZ, BEYOND = 0.2, 1.5
"""First frequency of a chirp, and its last one as a multiple of the bandwidth of the loop."""
HOLD = 3.0
"""Shortest time between two steps, in time constants of the loop: 95 % of the motion is then over."""
FAMILIES = ("ramps", "steps", "chirps", "steps and chirps")
"""Kinds of motions that are compared."""
SEEDS = 2
"""Number of motions of each family."""
MODEL_ERROR = 1e-3
"""Position error (rad or m) of friction models on good robots: smaller effects on a joint are not identifiable."""


@dataclass(frozen=True, eq=False)
class PositionMotion:
    """Commands for all joints.

    Attributes
    ----------
    name : str
        Experiment that they are for.
    family : str
        One of `FAMILIES`.
    rate_hz : float
        Commands per second.
    q : (n_samples, n_dof) array
        Commanded positions (rad or m).
    joint_names : tuple of str
        Names of the columns.
    widths : mapping of str to float
        Mean logarithm of the widths of the intervals by family, the best motion of each.
    bandwidth_hz : (n_dof,) array
        Bandwidth of the loop of each joint.
    unidentified : tuple of str
        Sentences on the unknowns that this motion does not identify.
    """

    name: str
    family: str
    rate_hz: float
    q: Array
    joint_names: tuple[str, ...]
    widths: dict[str, float]
    bandwidth_hz: Array
    unidentified: tuple[str, ...]

    def __str__(self) -> str:
        best = self.widths[self.family]
        others = series(
            f"{family} {math.exp(width - best):.2f}"
            for family, width in self.widths.items()
            if family != self.family
        )
        lines = [
            f"{self.name}: {self.family}, {len(self.q) / self.rate_hz:g} s at {self.rate_hz:g} Hz",
            f"intervals of the others are wider: {others} times (geometric mean)",
            f"bandwidths of the loops (Hz): {'  '.join(f'{value:.2g}' for value in self.bandwidth_hz)}",
        ]
        return "\n".join([*lines, *(f"- {text}" for text in self.unidentified)])

    def save(self, path: Path) -> None:
        """Write a table of times (s) and commanded positions (rad or m) as CSV.

        Raises
        ------
        ExcitationError
            For another ending.
        """
        if path.suffix != ".csv":
            raise ExcitationError(f"'{path.name}': the file of commanded positions ends in .csv")
        head = ",".join(["t_s", *self.joint_names])
        rows = [
            f"{k / self.rate_hz:.6f}," + ",".join(f"{v:.6f}" for v in row) for k, row in enumerate(self.q)
        ]
        write_atomically(path, "\n".join([head, *rows]) + "\n", ())


def excite_positions(experiment: Experiment, *, duration_s: float = 20.0) -> PositionMotion:
    """Return commanded positions that separate the unknowns of an experiment.

    Parameters
    ----------
    experiment : Experiment
        With known links, a law, and [unknown]; a recording gives the rate and the pose in the middle.
    duration_s : float
        Length.

    Raises
    ------
    DidimError
        One of its kinds, for an experiment whose links are not known.
    """
    if experiment.links != "fixed":
        raise ExcitationError(
            f'{experiment.name}: motions for positions are for [parameters] links = "fixed"'
        )
    rate = experiment.recordings[0].rate_hz if experiment.recordings else 100.0
    values = file_values(experiment)
    middle, swing = _room(experiment)
    bandwidth = _bandwidth(experiment, values, middle)
    best: dict[str, tuple[float, Array, tuple[str, ...]]] = {}
    for family in FAMILIES:
        for seed in range(SEEDS):
            q = _motion(family, seed, middle, swing, bandwidth, rate, int(duration_s * rate))
            width, sentences = _width(_problem(experiment, q, rate))
            if family not in best or width < best[family][0]:
                best[family] = width, q, sentences
    family = min(best, key=lambda name: best[name][0])
    names = experiment.robot.joint_names or tuple(f"q{j + 1}" for j in range(experiment.robot.n_dof))
    _, q, sentences = best[family]
    widths = {name: design[0] for name, design in best.items()}
    return PositionMotion(experiment.name, family, rate, q, names, widths, bandwidth, sentences)


def _room(experiment: Experiment) -> tuple[Array, Array]:
    """Return the pose in the middle of the motion, and how far each joint goes from it."""
    robot = experiment.robot
    swing = np.array([SWING[kind] for kind in robot.joint_kinds])
    middle = np.zeros(robot.n_dof)
    if experiment.recordings and experiment.recordings[0].has_positions:
        middle = np.median(experiment.recordings[0].q, axis=0)
    for joint, limits in enumerate(robot.limits):
        if limits.position is not None:
            low, high = limits.position
            swing[joint] = min(swing[joint], SHARE_OF_RANGE * (high - low))
            middle[joint] = min(max(middle[joint], low + swing[joint]), high - swing[joint])
    return middle, swing


def _bandwidth(experiment: Experiment, values: Values, middle: Array) -> Array:
    """Return the bandwidth (Hz) of each loop: that of the oscillator kp, M, or of the damped servo where that is less."""
    robot, names = experiment.robot, experiment.robot.parameter_names
    inertia = np.diag(inertia_matrix(robot, middle[None], values.x)[0])
    fv = np.array([values.x[names.index(f"Fv{j + 1}")] for j in range(robot.n_dof)])
    kp, damping = values.drive["kp"], values.drive["kv"] + fv
    natural = np.sqrt(kp / np.maximum(inertia, 1e-12))
    return np.asarray(np.minimum(natural, kp / np.maximum(damping, 1e-12)) / (2.0 * np.pi))


def _motion(
    family: str, seed: int, middle: Array, swing: Array, bandwidth: Array, rate: float, count: int
) -> Array:
    """Return commands of a family, (count, n_dof), at rest in the middle for the first second."""
    rng, n = np.random.default_rng(seed), len(middle)
    t = np.arange(count) / rate
    q = np.empty((count, n))
    for j in range(n):
        part = count // 2 if family == "steps and chirps" else 0
        if family == "ramps":
            period = rng.uniform(3.0, 5.0)
            phase = t / period + rng.uniform()
            q[:, j] = swing[j] * (4.0 * np.abs(phase - np.floor(phase + 0.5)) - 1.0)
            continue
        fastest = min(BEYOND * bandwidth[j], 0.25 * rate)
        hold = max(HOLD / (2.0 * np.pi * bandwidth[j]), 2.0 / rate)
        if family != "chirps":
            q[: part or count, j] = _steps(rng, swing[j], hold, rate, part or count)
        if family != "steps":
            late = t[part:] - t[part]
            q[part:, j] = swing[j] * _chirp(
                late, min(SLOWEST_HZ, fastest), fastest, rng.uniform(0.0, 2.0 * np.pi)
            )
    q[t < 1.0] = 0.0
    return middle + q


def _steps(rng: np.random.Generator, swing: float, hold: float, rate: float, count: int) -> Array:
    """Return random levels, each held for one to three times `hold` (s)."""
    out = np.empty(count)
    start = 0
    while start < count:
        length = max(1, round(rng.uniform(1.0, 3.0) * hold * rate))
        out[start : start + length] = rng.uniform(-swing, swing)
        start += length
    return out


def _chirp(t: Array, first: float, last: float, phase: float) -> Array:
    """Return an exponential chirp between two frequencies (Hz), whose amplitude falls with the root of the frequency."""
    growth = math.log(last / first) / t[-1] if last > first else 0.0
    angle = 2.0 * np.pi * first * (np.expm1(growth * t) / growth if growth else t)
    return np.asarray(np.sin(angle + phase) * np.exp(-0.5 * growth * t))


def _problem(experiment: Experiment, q: Array, rate: float) -> Problem:
    """Return the problem of a log of these commands, with the positions that the values of the file give."""
    measured = q
    for _ in range(2):
        recording = Recording.from_arrays(measured, rate_hz=rate, q_ref=q, name="motion")
        problem = Problem(replace(experiment, recordings=(recording,)))
        measured = measured.copy()
        for rollout in problem.rollouts:
            positions, _ = problem.positions(rollout, problem.start[None])
            measured[:, rollout.joints] = positions[0]
    return problem


def _width(problem: Problem) -> tuple[float, tuple[str, ...]]:
    """Return the mean logarithm of widths of unknowns for equal errors, and sentences on unidentified ones."""
    now = begun(problem)
    held = unidentified(now, error=MODEL_ERROR)
    a, _ = now.normal()
    steps = np.array([column.step for column in problem.columns])
    use = now.used(a)
    f, _ = widening(a, use)
    now.held = held
    return float(np.mean(np.log(f / np.sqrt(np.diag(a)[use]) / steps[use]))), tuple(by_sentence(now))
