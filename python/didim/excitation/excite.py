"""Design of a motion with maximum information, within the robot's limits.

Tested in ``tests/test_excitation.py``; ``benches/excitation.py`` has the study (docs/excitation.md).
"""

from __future__ import annotations

import time
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from ..errors import ExcitationError
from ..loop.reference import Reference
from ..robot.robot import Robot
from ..robot.robot_file import load_robot
from .criterion import condition_number, log_determinant
from .design import Excitation
from .export import reference_table
from .limits import MotionLimits
from .points import MOVE_RATE_HZ, PointDesign
from .problem import FINE, Information, Problem, scaled
from .ramps import Ramp, ramp
from .search import TRIALS, DesignLine, Progress, search_all
from .series import Motion, ScaledSeries, Series, SeriesBasis
from .settings import ExcitationSettings
from .settings_file import read_excitation
from .task import Task

TRIAL_SEED = 1_000_003
"""Offset between the seeds of a start's random motions, large enough that no two starts share a motion."""


def excite(
    robot: Robot | str | Path,
    settings: ExcitationSettings | str | Path | None = None,
    *,
    progress: Progress | None = None,
    executor: Executor | None = None,
    verbose: bool | None = None,
) -> Excitation:
    """Design a motion for the identification of a robot.

    The log determinant of the information on the base parameters (7) is maximised over Fourier series that are at rest at
    both ends, from several random starts; or over the points of a motion from point to point.
    Tested in ``tests/test_excitation.py``.

    Parameters
    ----------
    robot : Robot, str or Path
        The robot, the name of an included one, or its file.
    settings : ExcitationSettings, str or Path, optional
        Settings of the design, or their file (``excite.toml``).
    progress : callable, optional
        Callback with start, evaluations and value, called in the threads of the starts.
    executor : Executor, optional
        Runs the starts of a Fourier series instead of threads: any of `concurrent.futures`, without progress.
    verbose : bool, optional
        By default a terminal or a notebook shows one line with the remaining time, and removes it at the end; False hides it.

    Returns
    -------
    Excitation
        The best motion; the same bits for any number of threads. After Ctrl-C the best one so far.

    Raises
    ------
    ExcitationError
        For limits without room for a motion, and for contradictory settings; one sentence.
    """
    began = time.perf_counter()
    if not isinstance(robot, Robot):
        robot = load_robot(robot)
    if settings is None:
        settings = ExcitationSettings()
    elif not isinstance(settings, ExcitationSettings):
        settings = read_excitation(settings, robot)
    if settings.friction:
        robot = robot.with_friction(**settings.friction)
    task = Task(robot, settings)
    points = settings.kind == "point-to-point"
    line = DesignLine(settings.starts, None if points else settings.iterations, verbose is not False)

    def both(start: int, evaluations: int, value: float) -> None:
        line(start, evaluations, value)
        if progress is not None:
            progress(start, evaluations, value)

    with closing(line):
        motions = _points(task, both) if points else _series(task, both, executor)
    return replace(motions, elapsed=time.perf_counter() - began)


def _series(task: Task, progress: Progress, executor: Executor | None) -> Excitation:
    """Design a Fourier series."""
    settings, limits = task.settings, task.limits
    basis = SeriesBasis(period_s=settings.duration_s, harmonics=settings.harmonics)
    shrinks = task.limited or not task.clearance.empty
    problems, starts, randoms = [], [], []
    for index in range(settings.starts):
        scaling = ScaledSeries(basis, limits, task.start, shrinks)
        trials = []
        for trial in range(TRIALS):
            seed = settings.seed + index + trial * TRIAL_SEED
            offset = task.start if task.start is not None else task.resting_place(seed)
            shape = _random_shape(basis, limits, offset, seed)
            start = None
            if task.start is None:
                share = (offset - limits.lowest) / (limits.highest - limits.lowest)
                start = np.log(share / (1.0 - share))
            trials.append(scaling.pack(shape, start))
            randoms.append(Series(basis=basis, scaled=shape, offset=offset))
        problems.append(task.problem(scaling))
        starts.append(trials)
    random = problems[0].feasible(randoms[0])
    reached, problems, interrupted = search_all(problems, starts, settings, progress, executor)
    ends = [_end(problem, one) for problem, one in zip(problems, reached, strict=True)]
    values = [
        -np.inf if end is None else problem.criterion(problem.information.matrix(*end.motion()[:3]))[0]
        for problem, end in zip(problems, ends, strict=True)
    ]
    chosen = ends[int(np.argmax(values))]
    if chosen is None:
        raise ExcitationError(
            "no motion has been found that keeps all limits: the workspace or the torques leave too little room"
        )
    fine = chosen.motion(FINE)
    sine, cosine = chosen.amplitudes()
    duration = settings.duration_s * settings.periods
    reference = Reference.fourier(
        sine, cosine, period_s=settings.duration_s, offset=chosen.offset, duration_s=duration
    )
    table = {
        "kind": "fourier",
        "period_s": settings.duration_s,
        "duration_s": duration,
        "offset": chosen.offset,
        "sine": sine,
        "cosine": cosine,
    }
    motions = (chosen.motion(), random.motion())
    return _result(task, problems[0], reference, table, fine, motions, values, interrupted)


def _random_shape(basis: SeriesBasis, limits: MotionLimits, offset: Array, seed: int) -> Array:
    """Return the coefficients of a seed's random motion about an offset, within the kinematic limits, ``(n_free, n_dof)``."""
    random = Reference.random_fourier(
        harmonics=basis.harmonics,
        period_s=basis.period_s,
        max_position=np.minimum(limits.highest - offset, offset - limits.lowest),
        max_velocity=limits.velocity,
        max_acceleration=limits.acceleration,
        seed=seed,
    )
    q = random.at(np.arange(basis.samples) * (basis.period_s / basis.samples))[0]
    return np.asarray(np.linalg.lstsq(basis.grid[0], q, rcond=None)[0])


def _end(problem: Problem, variables: Array) -> Series | None:
    """Return the motion of the best variables within all limits, or None."""
    series = problem.exact(problem.series.build(variables)[0])
    if problem.keeps(series):
        return series
    if not problem.keeps(scaled(series, 0.0)):
        return None
    return problem.feasible(series)


def _points(task: Task, progress: Progress) -> Excitation:
    """Design a motion from point to point."""
    settings = task.settings
    if np.isfinite(task.limits.jerk).any():
        raise ExcitationError(
            "motions from point to point have trapezoidal velocities, whose jerk has no bound: leave out the jerk limits, or "
            "design a Fourier series"
        )
    scaling = ScaledSeries(SeriesBasis(period_s=1.0, harmonics=4), task.limits, task.start, False)
    problem = task.problem(scaling)
    design = PointDesign(task, problem)
    found: list[tuple[Array, Array]] = []
    values: list[float] = []
    for index in range(settings.starts):
        points, random, interrupted = design.search(settings.seed + index)
        found.append((points, random))
        values.append(design.value([design.move(a, b) for a, b in pairwise(points)]))
        progress(index + 1, 1, values[-1])
        if interrupted:
            break
    best, _ = found[int(np.argmax(values))]
    reference = design.reference(best)
    table = {
        "kind": "point-to-point",
        "points": best,
        "max_velocity": task.limits.velocity,
        "max_acceleration": task.limits.acceleration,
        "dwell_s": settings.dwell_s,
    }

    def motion(reference: Reference, rate: float) -> Motion:
        count = round(reference.duration * rate)
        q, dq, ddq = reference.at((np.arange(count) + 0.5) * (reference.duration / count))
        return q, dq, ddq, np.zeros_like(q)

    motions = (motion(reference, MOVE_RATE_HZ), motion(design.reference(found[0][1]), MOVE_RATE_HZ))
    fine = motion(reference, MOVE_RATE_HZ * FINE)
    return _result(task, problem, reference, table, fine, motions, values, interrupted)


def _result(
    task: Task,
    problem: Problem,
    reference: Reference,
    table: dict[str, object],
    fine: Motion,
    motions: tuple[Motion, Motion],
    values: list[float],
    interrupted: bool,
) -> Excitation:
    """Collect the properties of a motion in a result."""
    robot, settings, limits = task.robot, task.settings, task.limits
    use = limits.whole.use(*fine)
    torques = problem.torques(*fine[:3])
    if torques is not None:
        use["torque"] = np.asarray(np.abs(torques / limits.whole.torque).max(axis=0))
    nearest = None
    if not task.clearance.empty:
        distances = task.clearance.distances(fine[0]).min(axis=0)
        column = int(distances.argmin())
        nearest = (task.clearance.describe(column), float(distances[column]))
    counted = Information(
        robot=robot, sigma=task.sigma, samples=task.rate * reference.duration, prior=task.prior
    )
    matrices = [counted.matrix(*motion[:3]) for motion in motions]
    conditions = [condition_number(counted.plain.matrix(*motion[:3])) for motion in motions]
    return Excitation(
        robot=robot,
        settings=settings,
        reference=reference,
        tables=reference_table(robot, table),
        ramps=_ramps(task, problem, reference),
        limits=limits,
        x=task.x,
        names=robot.base_parameters.names,
        units=robot.base_parameters.units,
        information=matrices[0],
        random_information=matrices[1],
        condition_number=conditions[0],
        random_condition_number=conditions[1],
        log_det=log_determinant(matrices[0])[0],
        random_log_det=log_determinant(matrices[1])[0],
        starts=tuple(values),
        use={kind: values for kind, values in use.items() if values.any()},
        nearest=nearest,
        remarks=tuple(task.remarks),
        interrupted=interrupted,
        elapsed=0.0,
    )


def _ramps(task: Task, problem: Problem, reference: Reference) -> tuple[Ramp | None, Ramp | None]:
    """Return the motions from home to the start of a reference and from its end back, if there is a home."""
    if task.home is None:
        return None, None
    start, end = (reference.at([t])[0][0] for t in (0.0, reference.duration))
    return (
        ramp(task.home, start, task.limits, task.clearance, problem.torques),
        ramp(end, task.home, task.limits, task.clearance, problem.torques),
    )
