"""Commands that tell drives and friction apart by positions alone: ramps, holds, steps and chirps of all joints.

Slow commands show ``(Fv + kv)/kp`` and the delay as one number, and no inertia; fast ones show no friction at rest. So the motion
has slow and fast ramps both ways (friction), holds at five poses that are reached from both sides (gravity, friction at rest),
small and large steps (delay, limits) and chirps up to the bandwidth of the loop (armature). It is simulated with the values of the
robot file, and the intervals that its log would give are reported. Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.files import write_atomically
from ..errors import ExcitationError
from ..experiment.experiment import Experiment
from ..experiment.experiment_file import load_experiment
from ..experiment.loop_tables import of_actuators
from ..experiment.unknown import Unknown
from ..log.recording import Recording
from ..loop.controller import Controller
from ..methods.positions.columns import Values, file_values
from ..methods.positions.problem import Problem
from ..methods.positions.prospect import prospect_of
from ..methods.positions.search import begun
from ..model.dynamics import inertia_matrix
from ..robot.robot import Robot
from ..robot.robot_file import load_robot
from .clearance import Clearance
from .settings import ExcitationSettings

SWING = {"revolute": 0.3, "prismatic": 0.05}
"""Largest distance (rad, m) from the middle, if the joint's limits allow it: errors of links and gears stay small."""
SPEEDS = (0.05, 0.3)
"""Speeds (rad/s) of the slow and the fast ramp; other moves have the second."""
LEVELS = (0.0, -0.7, 0.35, 0.7, -0.35)
"""Poses that are held, as shares of the swing; joint k takes every k-th of them, so that poses of the arm differ."""
BESIDE, HELD_S = 0.3, 1.5
"""Distance from which a pose is reached, as a share of the swing, and the time (s) that it is held."""
STEPS, STEP_S = (0.2, 0.8), 1.0
"""Steps to both sides, as shares of the swing (60 and 240 mrad), and the time (s) that each is held."""
CHIRPS, CHIRP_S, CHIRP_HZ = (0.1, 0.5), 10.0, (0.2, 3.5)
"""Amplitudes of the chirps, as shares of the swing (30 and 150 mrad), their time (s) and frequencies (Hz). A loop of larger
bandwidth has a chirp up to that, whose amplitude falls beyond the last frequency so that its speed stays."""
COUNT = 2.0 * np.pi / 4096
"""Count (rad) of a usual encoder, to which the simulated log is rounded."""
SHRUNK, MOST_SHRINKS = 0.8, 8
"""Factor of the swing where links come too near to each other or to the floor, and the most such steps."""
SHARE_OF_RANGE = 0.4
"""Largest distance from the middle, as a share of the joint's range."""


@dataclass(frozen=True, eq=False)
class PositionMotion:
    """Commands for all joints.

    Attributes
    ----------
    name : str
        Experiment or robot that they are for.
    rate_hz : float
        Commands per second.
    q : (n_samples, n_dof) array
        Commanded positions (rad or m).
    joint_names : tuple of str
        Names of the columns.
    ranges : tuple of ((float, float) or None)
        Limits of the joints (rad or m): LeRobot commands a gripper in percent of its range.
    told : tuple of str
        Sentences on what a log of this motion identifies, and how well.
    """

    name: str
    rate_hz: float
    q: Array
    joint_names: tuple[str, ...]
    ranges: tuple[tuple[float, float] | None, ...]
    told: tuple[str, ...]

    def __str__(self) -> str:
        head = f"{self.name}: ramps, holds, steps and chirps, {len(self.q) / self.rate_hz:.3g} s at {self.rate_hz:g} Hz"
        return "\n".join([head, *(f"- {text}" for text in self.told)])

    def save(self, path: Path) -> None:
        """Write a table of times (s) and commanded positions (rad or m) as CSV, or the actions of a LeRobot arm as JSON.

        Raises
        ------
        ExcitationError
            For another ending.
        """
        if path.suffix == ".json":
            write_atomically(path, json.dumps({"fps": self.rate_hz, "actions": self.actions()}) + "\n", ())
            return
        if path.suffix != ".csv":
            raise ExcitationError(
                f"'{path.name}': commanded positions end in .csv, or in .json for actions of LeRobot"
            )
        head = ",".join(["t_s", *self.joint_names])
        rows = [
            f"{k / self.rate_hz:.6f}," + ",".join(f"{v:.6f}" for v in row) for k, row in enumerate(self.q)
        ]
        write_atomically(path, "\n".join([head, *rows]) + "\n", ())

    def actions(self) -> list[dict[str, float]]:
        """Return LeRobot's actions: degrees by motor, a gripper in percent of its range."""
        values = np.degrees(self.q)
        for k, (name, limits) in enumerate(zip(self.joint_names, self.ranges, strict=True)):
            if "gripper" in name and limits is not None:
                values[:, k] = 100.0 * (self.q[:, k] - limits[0]) / (limits[1] - limits[0])
        names = [f"{name.removesuffix('_joint')}.pos" for name in self.joint_names]
        return [dict(zip(names, np.round(row, 4).tolist(), strict=True)) for row in values]


def excite_positions(
    source: Experiment | Robot | str | Path,
    *,
    rate_hz: float = 50.0,
    settings: ExcitationSettings | None = None,
) -> PositionMotion:
    """Return commanded positions that identify drives and friction.

    Parameters
    ----------
    source : Experiment, Robot, str or Path
        An experiment with known links, whose unknowns and pose count, or a robot with position actuators, or the file of either.
    rate_hz : float
        Commands per second, without a recording that has a rate.
    settings : ExcitationSettings, optional
        Their workspace and capsules count: links keep clear of each other, the floor and the walls.

    Raises
    ------
    DidimError
        One of its kinds: for a robot without position actuators, and where no motion is clear.
    """
    experiment = source if isinstance(source, Experiment) else _experiment(source)
    rate = experiment.recordings[0].rate_hz if experiment.recordings else rate_hz
    robot, values = experiment.robot, file_values(experiment)
    middle, swing = _room(experiment)
    bandwidth = _bandwidth(experiment, values, middle)
    settings = settings or ExcitationSettings()
    clearance = Clearance(robot, (*robot.collision, *settings.capsules), settings.workspace)
    q = _commands(middle, swing, bandwidth, rate)
    for _ in range(MOST_SHRINKS):
        if clearance.empty or (near := clearance.distances(q)).min() >= 0.0:
            break
        swing = SHRUNK * swing
        q = _commands(middle, swing, bandwidth, rate)
    else:
        worst = clearance.describe(int(np.argmin(near.min(axis=0))))
        raise ExcitationError(
            f"{experiment.name}: {worst} meet even in small motions about the pose of the log"
        )
    told = [
        "neither self-collision nor the floor is checked: the robot has no [[collision]], and no floor_m is given"
    ] * clearance.empty
    # The positions that the values of the file give stand for the measured ones.
    measured = q
    for _ in range(2):
        recording = Recording.from_arrays(measured, rate_hz=rate, q_ref=q, name="motion")
        log = Experiment.from_recordings(experiment.robot, [recording]).reference
        problem = Problem(replace(experiment, recordings=(recording,), reference=log))
        measured = measured.copy()
        for rollout in problem.rollouts:
            positions, _ = problem.positions(rollout, problem.start[None])
            begin = rollout.window.begin
            measured[begin : begin + len(positions[0]), rollout.joints] = (
                np.round(positions[0] / COUNT) * COUNT
            )
    findings, remarks = prospect_of(begun(problem))
    names = robot.joint_names or tuple(f"q{j + 1}" for j in range(robot.n_dof))
    ranges = tuple(limits.position for limits in robot.limits)
    sentences = (*told, *remarks, *(finding.sentence for finding in findings))
    return PositionMotion(experiment.name, rate, q, names, ranges, sentences)


def _experiment(source: Robot | str | Path) -> Experiment:
    """Return the experiment of a file, or one without a log for a robot with position actuators."""
    if (
        not isinstance(source, Robot)
        and Path(source).suffix == ".toml"
        and "[[recording]]" in Path(source).read_text(encoding="utf-8")
    ):
        return load_experiment(source)
    robot = source if isinstance(source, Robot) else load_robot(source)
    gains = of_actuators(robot)
    if "kp" not in gains:
        raise ExcitationError(
            f"{robot.name}: joints without position actuators; give an experiment file with the gains (didim init ... --kp)"
        )
    law = Controller.pd(
        gains["kp"], gains.get("kv", 0.0), reference_velocity=0.0, saturation=gains.get("saturation", np.inf)
    )
    delay = Unknown(low=0.0, high=0.025, shared="robot")
    return Experiment(
        name=robot.name, robot=robot, recordings=(), controller=law, links="fixed", unknown={"delay_s": delay}
    )


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


def _commands(middle: Array, swing: Array, bandwidth: Array, rate: float) -> Array:
    """Return commands, (n_samples, n_dof): the parts of all joints begin together, and their steps one after the other."""
    n, rest = len(middle), np.zeros(round(rate))
    every: list[list[Array]] = []
    for j, (size, band) in enumerate(zip(swing.tolist(), bandwidth.tolist(), strict=True)):
        fast, slow = (speed * size / SWING["revolute"] / rate for speed in (SPEEDS[1], SPEEDS[0]))
        levels = [size * LEVELS[(k * (j + 1) if (j + 1) % 5 else k) % 5] for k in range(5)]
        beside = BESIDE * size
        sides = [(level - side * beside, level) for level in levels for side in (1.0, -1.0)]
        parts = [
            rest,
            _moves([0.0, size, -size, 0.0], slow, 0),
            _moves([0.0, size, -size, 0.0], fast, 0),
            *(
                _moves([before, beyond, level], fast, round(HELD_S * rate))
                for before, (beyond, level) in zip([0.0, *(s[1] for s in sides)], sides, strict=False)
            ),
            _moves([levels[-1], 0.0], fast, 0),
            np.zeros(round(STEP_S * rate * j / n)),
            np.repeat([s * share * size for share in STEPS for s in (1, 0, -1, 0)], round(STEP_S * rate)),
            *(share * size * _chirp(band, rate, np.pi * j / n) for share in CHIRPS),
            rest,
        ]
        every.append(parts)
    lengths = [max(len(part) for part in same) for same in zip(*every, strict=True)]
    padded = [
        np.concatenate(
            [
                np.append(part, np.full(length - len(part), part[-1] if len(part) else 0.0))
                for part, length in zip(parts, lengths, strict=True)
            ]
        )
        for parts in every
    ]
    return np.asarray(middle + np.transpose(padded))


def _moves(via: Sequence[float], step: float, held: int) -> Array:
    """Return a path between positions with equal steps, and so many samples at its last one."""
    parts = [np.linspace(a, b, max(2, round(abs(b - a) / step) + 1))[1:] for a, b in itertools.pairwise(via)]
    return np.concatenate([*parts, np.full(held, via[-1])])


def _chirp(bandwidth: float, rate: float, phase: float) -> Array:
    """Return an exponential chirp with a shift of its phase, faded in and out over its first and last tenth."""
    first, usual = CHIRP_HZ
    last = max(first, min(max(usual, bandwidth), 0.25 * rate))
    t = np.arange(round(CHIRP_S * rate)) / rate
    growth = max(np.log(last / first), 1e-9) / CHIRP_S
    frequency = first * np.exp(growth * t)
    angle = 2.0 * np.pi * (frequency - first) / growth
    fade = np.minimum(1.0, np.minimum(t, t[-1] - t) / (0.1 * CHIRP_S))
    return np.asarray(fade * np.minimum(1.0, usual / frequency) * np.sin(angle + phase))
