"""Design a motion that identifies a robot well, within its limits.

Tested in ``tests/test_excitation.py``; ``benches/excitation.py`` has the study (docs/excitation.md).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from .._tools.arrays import Array, real_array
from .._tools.words import did_you_mean
from ..errors import ExcitationError
from ..loop.reference import Reference
from ..methods.start import standard_start
from ..model.dynamics import standard_vector
from ..robot.robot import Robot
from ..robot.robot_file import load_robot
from .clearance import Clearance
from .criterion import condition_number, criterion, log_determinant
from .design import Excitation
from .export import reference_table
from .limits import MotionLimits, motion_limits
from .optimiser import TRIALS, Progress, search_all
from .points import PointDesign
from .prior import noise_from, prior_information
from .problem import FINE, Information, Problem, scaled
from .ramps import Ramp, ramp
from .series import ScaledSeries, Series, SeriesBasis
from .settings import ExcitationSettings
from .settings_file import read_excitation

TORQUE_SHARE = 0.01
"""Standard deviation of the torques' noise, as a share of the torque limit, where none is given."""
TRIAL_SEED = 1_000_003
"""Between the seeds of the random motions of one start: those of other starts are not among them."""
POSES = 2000
"""Random poses tried for one at which the robot can rest within all limits."""


def excite(
    robot: Robot | str | Path,
    settings: ExcitationSettings | str | Path | None = None,
    *,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Excitation:
    """Design a motion for the identification of a robot.

    The log determinant of the information on the base parameters (7) is maximised over Fourier series that are at rest at
    both ends, from several random starts; or over the points of a motion from point to point.

    Parameters
    ----------
    robot : Robot, str or Path
        The robot, its packaged name, or its file.
    settings : ExcitationSettings, str or Path, optional
        What is asked for, or the file that says it (``excite.toml``).
    progress : callable, optional
        Called with start, evaluations and value, from the threads of the starts.
    executor : Executor, optional
        Runs the starts of a Fourier series instead of threads: any of `concurrent.futures`, without progress.

    Returns
    -------
    Excitation
        The best motion; the same bits for any number of threads. After Ctrl-C the best one so far.

    Raises
    ------
    ExcitationError
        For limits without room, and for settings that contradict each other; one sentence.
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
    task = _Task(robot, settings)
    found = (
        _points(task, progress) if settings.kind == "point-to-point" else _series(task, progress, executor)
    )
    return replace(found, elapsed=time.perf_counter() - began)


class _Task:
    """What all starts share."""

    def __init__(self, robot: Robot, settings: ExcitationSettings) -> None:
        self.robot, self.settings = robot, settings
        for term in robot.friction.terms:
            if term.law == "load":
                raise ExcitationError(
                    f"the load friction of joint {term.joint + 1} depends on the torques that are still to be identified: "
                    "leave it out of the friction of the design"
                )
        # The sign of the velocity has no gradient.
        smooth = [max(settings.smoothing, one) for one in robot.friction.smoothing]
        self.smooth = robot.with_smoothing(smooth)
        self.limits = motion_limits(
            robot,
            position=settings.position,
            velocity=settings.velocity,
            acceleration=settings.acceleration,
            jerk=settings.jerk,
            torque=settings.torque,
            margin=settings.margin,
        )
        self.remarks = list(self.limits.assumed)
        self.x = self._parameters()
        self.rate = settings.rate_hz if settings.log_rate_hz is None else settings.log_rate_hz
        self.sigma = self._noise()
        capsules = (*getattr(robot, "collision", ()), *settings.capsules)
        self.clearance = Clearance(robot, capsules, settings.workspace)
        self.start = self._pose("start", settings.start)
        self.home = self._pose("home", settings.home)
        base = len(robot.base_parameters.names)
        prior = np.zeros((base, base))
        for source in settings.prior:
            prior = prior + prior_information(source, self.smooth, self.sigma, self.rate)
        self.prior = prior
        self.wanted = self._wanted()
        self.limited = self.x is not None and bool(np.isfinite(self.limits.torque).any())

    def _parameters(self) -> Array | None:
        given = self.settings.parameters
        if given is None and "urdf" in self.robot.sets:
            given = "urdf"
        if given is None:
            if np.isfinite(self.limits.torque).any():
                self.remarks.append(
                    "torque limits are not checked, for want of parameters: give parameters, such as those of an earlier result"
                )
            return None
        return standard_vector(self.robot, standard_start(self.robot, given))

    def _noise(self) -> Array:
        given, n = self.settings.torque_noise, self.robot.n_dof
        if given is not None:
            values = real_array("torque_noise", given, ExcitationError)
            if values.shape not in ((), (n,)) or not (values > 0.0).all():
                raise ExcitationError(
                    f"torque_noise needs one positive number or {n}, one per joint, got {given!r}"
                )
            return np.broadcast_to(values, (n,)).astype(float)
        if self.settings.noise_of is not None:
            return noise_from(self.settings.noise_of, self.smooth, self.rate)
        known = np.isfinite(self.limits.torque)
        self.remarks.append(
            f"the noise of the torques is taken as {100.0 * TORQUE_SHARE:g} % of the torque limit after the margin, 1 N.m or N "
            "where there is none: give torque_noise for deviations that can be relied on"
        )
        return np.where(known, TORQUE_SHARE * np.where(known, self.limits.torque, 1.0), 1.0)

    def _pose(self, name: str, given: object) -> Array | None:
        if given is None:
            return None
        pose = real_array(name, given, ExcitationError)  # type: ignore[arg-type]
        if pose.shape != (self.robot.n_dof,):
            raise ExcitationError(f"{name} needs {self.robot.n_dof} numbers, one per joint, got {given!r}")
        for joint, (value, low, high) in enumerate(
            zip(pose, self.limits.lowest, self.limits.highest, strict=True)
        ):
            if not low < value < high:
                raise ExcitationError(
                    f"the {name} of joint {joint + 1} is {value:g}, outside what its limits leave it, [{low:g}, {high:g}]"
                )
        why = self._cannot_rest(pose)
        if why:
            raise ExcitationError(f"the robot cannot rest at its {name}: {why}")
        return pose

    def _cannot_rest(self, pose: Array) -> str:
        """Sentence on what forbids a pose, or an empty text."""
        distances = None if self.clearance.empty else self.clearance.distances(pose[None])[0]
        if distances is not None and (distances < 0.0).any():
            column = int(distances.argmin())
            return f"{self.clearance.describe(column)} are {-1e3 * distances[column]:.3g} mm too near"
        if self.x is None:
            return ""
        rest = np.zeros((1, len(pose)))
        problem = self.problem(
            ScaledSeries(SeriesBasis(period_s=1.0, harmonics=4), self.limits, pose, False), bare=True
        )
        torques = problem.torques((pose[None], rest, rest, rest))
        relative = np.abs(torques[0]) / self.limits.torque if torques is not None else np.zeros(len(pose))
        if (relative > 1.0).any():
            joint = int(relative.argmax())
            return (
                f"joint {joint + 1} needs {relative[joint] * self.limits.torque[joint]:.3g} there, where at most "
                f"{self.limits.torque[joint]:.3g} N.m or N are allowed"
            )
        return ""

    def resting_place(self, seed: int) -> Array:
        """Pose that a free motion is built about: the middle of the ranges, or a random one where the robot can rest."""
        middle = (self.limits.lowest + self.limits.highest) / 2.0
        why = self._cannot_rest(middle)
        if not why:
            return np.asarray(middle)
        rng = np.random.default_rng(seed)
        for _ in range(POSES):
            pose = self.limits.lowest + rng.random(len(middle)) * (self.limits.highest - self.limits.lowest)
            if not self._cannot_rest(pose):
                return np.asarray(pose)
        raise ExcitationError(
            f"the limits leave no room: in none of {POSES} random poses can the robot rest; in the middle, {why}"
        )

    def _wanted(self) -> Array | None:
        if not self.settings.wanted:
            return None
        names = self.robot.base_parameters.names
        for name in self.settings.wanted:
            if name not in names:
                raise ExcitationError(
                    f"robot {self.robot.name!r} has no base parameter {name!r}{did_you_mean(name, names)}"
                )
        return np.array(sorted({names.index(name) for name in self.settings.wanted}))

    def information(self, samples: float) -> Information:
        """How information is counted: with the noise, or for the condition number of W without it."""
        bare = self.settings.criterion == "condition"
        n = self.robot.n_dof
        return Information(
            robot=self.smooth,
            sigma=np.ones(n) if bare else self.sigma,
            samples=1.0 if bare else samples,
            prior=np.zeros_like(self.prior) if bare else self.prior,
        )

    def problem(self, series: ScaledSeries, *, bare: bool = False) -> Problem:
        """Return the problem of one start."""
        samples = self.rate * self.settings.duration_s * self.settings.periods
        if bare:
            information = Information(
                robot=self.smooth, sigma=np.ones(self.robot.n_dof), samples=1.0, prior=np.empty(0)
            )
        else:
            information = self.information(samples)
        chosen = criterion(self.settings.criterion, None if bare else self.wanted)
        return Problem(series, information, chosen, self.x, self.clearance)


def _series(task: _Task, progress: Progress | None, executor: Executor | None) -> Excitation:
    """Design a Fourier series."""
    settings, limits = task.settings, task.limits
    basis = SeriesBasis(period_s=settings.duration_s, harmonics=settings.harmonics)
    shrinks = task.limited or not task.clearance.empty
    problems, starts, randoms = [], [], []
    for index in range(settings.starts):
        scaling = ScaledSeries(basis, limits, task.start, shrinks)
        problem = task.problem(scaling)
        trials = []
        for trial in range(TRIALS):
            seed = settings.seed + index + trial * TRIAL_SEED
            offset = task.start if task.start is not None else task.resting_place(seed)
            shape = _random_shape(basis, limits, offset, seed)
            place = None
            if task.start is None:
                share = (offset - limits.lowest) / (limits.highest - limits.lowest)
                place = np.log(share / (1.0 - share))
            trials.append(scaling.pack(shape, place))
            randoms.append((problem, Series(basis=basis, scaled=shape, offset=offset)))
        problems.append(problem)
        starts.append(trials)
    random = randoms[0][0].feasible(randoms[0][1])
    found, problems, interrupted = search_all(
        problems, starts, settings.iterations, _threads(settings), progress, executor
    )
    ends = [_end(problem, one) for problem, one in zip(problems, found, strict=True)]
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
    return _result(task, problems[0], reference, table, fine, motions, values, interrupted, duration)


def _random_shape(basis: SeriesBasis, limits: MotionLimits, offset: Array, seed: int) -> Array:
    """Coefficients of the random motion of a seed about an offset, within the kinematic limits, ``(n_free, n_dof)``."""
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
    """Motion of the best variables within all limits; None where there is none."""
    series = problem.exact(problem.series.build(variables)[0])
    if problem.keeps(series):
        return series
    if not problem.keeps(scaled(series, 0.0)):
        return None
    return problem.feasible(series)


def _points(task: _Task, progress: Progress | None) -> Excitation:
    """Design a motion from point to point."""
    settings = task.settings
    scaling = ScaledSeries(SeriesBasis(period_s=1.0, harmonics=4), task.limits, task.start, False)
    problem = task.problem(scaling)
    design = PointDesign(problem, settings.points, settings.dwell_s, task.rate, settings.duration_s)
    best: tuple[float, Array, Array] | None = None
    values: list[float] = []
    interrupted = False
    first_random: Array | None = None
    for index in range(settings.starts):
        points, random, interrupted = design.search(settings.seed + index, task.start)
        first_random = random if first_random is None else first_random
        value = design.value([design.move(a, b) for a, b in pairwise(points)])
        values.append(value)
        if progress is not None:
            progress(index + 1, 1, value)
        if best is None or value > best[0]:
            best = (value, points, random)
        if interrupted:
            break
    if best is None or first_random is None:
        raise ExcitationError("the design needs at least one start")
    reference = design.reference(best[1])
    table = {
        "kind": "point-to-point",
        "points": best[1],
        "max_velocity": task.limits.velocity,
        "max_acceleration": task.limits.acceleration,
        "dwell_s": settings.dwell_s,
    }

    def motion(reference: Reference, rate: float) -> tuple[Array, Array, Array, Array]:
        count = round(reference.duration * rate)
        q, dq, ddq = reference.at((np.arange(count) + 0.5) * (reference.duration / count))
        return q, dq, ddq, np.zeros_like(q)

    motions = (motion(reference, 100.0), motion(design.reference(first_random), 100.0))
    fine = motion(reference, 100.0 * FINE)
    return _result(task, problem, reference, table, fine, motions, values, interrupted, reference.duration)


def _result(
    task: _Task,
    problem: Problem,
    reference: Reference,
    table: dict[str, object],
    fine: tuple[Array, Array, Array, Array],
    motions: tuple[tuple[Array, Array, Array, Array], tuple[Array, Array, Array, Array]],
    values: list[float],
    interrupted: bool,
    duration: float,
) -> Excitation:
    """Collect what a reader wants to know of a motion."""
    robot, settings, limits = task.robot, task.settings, task.limits
    use = limits.use(*fine)
    torques = problem.torques(fine)
    if torques is not None:
        use["torque"] = np.asarray(np.abs(torques / limits.torque).max(axis=0))
    use = {kind: values for kind, values in use.items() if values.any()}
    nearest = None
    if not task.clearance.empty:
        distances = task.clearance.distances(fine[0]).min(axis=0)
        column = int(distances.argmin())
        nearest = (task.clearance.describe(column), float(distances[column]))
    matrices, conditions = [], []
    plain = Information(robot=robot, sigma=np.ones(robot.n_dof), samples=1.0, prior=np.zeros_like(task.prior))
    counted = Information(robot=robot, sigma=task.sigma, samples=task.rate * duration, prior=task.prior)
    for motion in motions:
        matrices.append(counted.matrix(*motion[:3]))
        conditions.append(condition_number(plain.matrix(*motion[:3])))
    ramps: tuple[Ramp | None, Ramp | None] = (None, None)
    if task.home is not None:
        start = reference.at([0.0])[0][0]
        end = reference.at([reference.duration])[0][0]
        limited: Callable[[Array, Array, Array], Array | None] | None = None
        if task.limited:

            def limited(q: Array, dq: Array, ddq: Array) -> Array | None:
                return problem.torques((q, dq, ddq, ddq))

        ramps = (
            ramp(task.home, start, limits, task.clearance, limited),
            ramp(end, task.home, limits, task.clearance, limited),
        )
    return Excitation(
        robot=robot,
        settings=settings,
        reference=reference,
        tables=reference_table(robot, table),
        ramps=ramps,
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
        use=use,
        nearest=nearest,
        remarks=tuple(task.remarks),
        interrupted=interrupted,
        elapsed=0.0,
    )


def _threads(settings: ExcitationSettings) -> int:
    return settings.threads or os.cpu_count() or 1
