"""DIDIM of a robot whose limbs share nothing: each iterates by itself, as a robot of its own, until its own end.

One that has converged is neither simulated nor solved while the others go on. The iterates of all limbs are joined to one of the
robot, for whose result all rows are solved once more. Tested in ``tests/test_limbs.py``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array, ratio
from ..._tools.words import series
from ...experiment.experiment import Experiment
from ...loop.outcome import Outcome
from ...model.limbs import Limb, limbs_of, renamed
from ...regression.covariance import Branches, Factors
from ...regression.fit import Fit
from ...regression.least_squares import solve
from ...result.finding import Finding
from ...result.identification import Identification
from ...result.iteration import Iteration, Reporter, Status
from ...signal.window import Window
from ...terms.model import Model
from ...terms.rows import LinearSystem
from ..job import Job
from ..uncertainty import with_velocities
from .iterations import Iterations
from .problem import Problem
from .settings import DIDIMSettings
from .simulator import LogSimulator
from .windows import Iterate, Simulated, Solved, of_motions

LEAST = ("step_length", "largest_safe_step")
"""Numbers of an iteration whose least one stands for all limbs; of the others the largest does."""


@dataclass(frozen=True, eq=False)
class LimbInRobot:
    """A limb, and its parameters among those of the robot.

    Attributes
    ----------
    limb : Limb
        The limb.
    columns : list of int
        Its base parameters among those of the robot.
    """

    limb: Limb
    columns: list[int]

    @property
    def joints(self) -> list[int]:
        """Its driven joints, from 0."""
        return list(self.limb.joints)

    def job(self, problem: Problem) -> Job:
        """Return the job of the limb by itself."""
        job, robot = problem.job, self.limb.robot
        entries = (job.model.unknowns.entries[column] for column in self.columns)
        named = zip(robot.base_parameters.names, entries, strict=True)
        roles = {name: (each.role, each.value) for name, each in named}
        return replace(job, model=Model(robot, roles=roles), delay_setting=problem.simulator.delay)


def iterations_of(method: DIDIMSettings, job: Job, reporter: Reporter) -> Iterations:
    """Return the iterations of a job: limb by limb where limbs share neither motion, parameters nor conditions."""
    together = Iterations.of(method, job, reporter)
    limbs = limbs_in(together.problem)
    return ByLimb(together.problem, limbs) if limbs else together


def limbs_in(problem: Problem) -> list[LimbInRobot]:
    """Return the limbs that iterate by themselves; none where something is common to all."""
    job, limbs = problem.job, limbs_of(problem.job.robot)
    apart = all(len(window.loop.limbs) == len(limbs) > 1 for window in problem.simulator.windows)
    if not apart or job.solver is not solve or not job.model.simple or problem.instrumental:
        return []
    column = {index: k for k, index in enumerate(job.robot.base_parameters.indices)}
    inside = [
        LimbInRobot(limb, [column[index] for index in limb.indices[list(limb.robot.base_parameters.indices)]])
        for limb in limbs
    ]
    estimated = set(job.model.unknowns.estimated)
    return inside if all(estimated.intersection(each.columns) for each in inside) else []


class LimbSimulator(LogSimulator):
    """The closed loops of one limb, in the windows of the robot."""

    def __init__(self, whole: LogSimulator, limb_in_robot: LimbInRobot, job: Job, reporter: Reporter) -> None:
        self.whole, self.limb_in_robot = whole, limb_in_robot
        super().__init__(whole.method, job, reporter)

    def windows_of(self, experiment: Experiment) -> list[Window]:
        """Return the windows of the robot, with the loop and torques of the limb."""
        return [self._of_limb(window) for window in self.whole.windows]

    def _of_limb(self, window: Window) -> Window:
        (loop,) = (loop for limb, loop in window.loop.limbs if limb.joints == self.limb_in_robot.limb.joints)
        tau = np.ascontiguousarray(window.tau[:, self.limb_in_robot.joints])
        return replace(window, closed_loop=loop, tau=tau)

    def simulate(self, x: Array, scale: Array | None = None, checked: bool = False) -> Simulated | Outcome:
        """Simulate every window of the limb; an early end has the number of the joint in the robot."""
        run = super().simulate(x, scale, checked)
        return run.of_limb(self.limb_in_robot.joints) if isinstance(run, Outcome) else run

    def direct(self) -> Identification:
        """Return the IDIM-LS estimate of the robot."""
        return self.whole.direct()

    def real_parameters(self) -> Array:
        """Return the standard parameters of the limb with the inertias for the controller."""
        return self.whole.real_parameters()[self.limb_in_robot.limb.indices]

    def suspicions(self) -> list[Finding]:
        """Return suspected faults of the log."""
        return self.whole.suspicions()


class LimbProblem(Problem):
    """The linear system of one limb, with the names of the robot's parameters."""

    def __init__(self, whole: Problem, limb_in_robot: LimbInRobot, x: Array, reporter: Reporter) -> None:
        self._x = x[limb_in_robot.limb.indices]
        super().__init__(LimbSimulator(whole.simulator, limb_in_robot, limb_in_robot.job(whole), reporter))
        names = self.robot.base_parameters.names
        self._names = {name: renamed(name, limb_in_robot.limb.links) for name in names}

    def start(self) -> Array:
        """Return the start of the limb."""
        return self._x

    def observe(self, iterate: Iterate) -> LinearSystem:
        """Return (7) of the limb."""
        system, names = super().observe(iterate), self._names
        return replace(
            system,
            names=tuple(names[name] for name in system.names),
            slopes={names[name]: column for name, column in system.slopes.items()},
            alternatives=tuple((names[name], column) for name, column in system.alternatives),
        )


class ByLimb(Iterations):
    """The iterations of all limbs abreast: iteration k of the robot is that of each limb that takes so many.

    Attributes
    ----------
    parts : list of Iterations
        Those of each limb.
    """

    parts: list[Iterations]

    def __init__(self, problem: Problem, limbs: Sequence[LimbInRobot]) -> None:
        super().__init__(problem)
        self.limbs = limbs

    def begin(self) -> None:
        """Begin at the start, (17) by default."""
        self._x, self.parts = self.problem.start(), []
        for limb_in_robot in self.limbs:
            problem = LimbProblem(self.problem, limb_in_robot, self._x, self._reporter(limb_in_robot))
            self.parts.append(Iterations(problem))
            self.parts[-1].begin()
        self.iterate = self._best = self._joined([part.iterate for part in self.parts])
        self._first_error = self.iterate.simulated.error

    def _reporter(self, limb_in_robot: LimbInRobot) -> Reporter:
        return Reporter(say=lambda sentence: self.reporter.say(f"{limb_in_robot.limb.name}: {sentence}"))

    def advance(self) -> None:
        """Take one iteration of each limb that has not ended."""
        number = len(self.history) + 1
        for part in self.parts:
            while not part.over and len(part.history) < number:
                part.advance()
        self.history.append(self._entry_of(number))
        stopped = self.reporter.progress(self.history[-1])
        self.over = stopped or all(part.over and len(part.history) <= number for part in self.parts)
        if self.over:
            self._gather(stopped)

    def _entry_of(self, number: int) -> Iteration:
        """Return the entry of an iteration; limbs that have ended stay as they are."""
        entries = [part.history[min(number, len(part.history)) - 1] for part in self.parts]
        moving = [entry for entry in entries if entry.iteration == number]
        rests = [part.iterate.simulated.error for part in self.parts]
        windows = [part.simulator.windows for part in self.parts]
        sizes = np.array([np.linalg.norm(part.iterate.x) for part in self.parts])
        torques = np.array([np.linalg.norm(part.solved.system.measured) for part in self.parts])
        raw = np.array([math.sqrt(sum(float(np.sum(window.tau**2)) for window in own)) for own in windows])

        def total(values: Iterable[float], of: Array) -> float:
            return ratio(np.linalg.norm(np.array([*values]) * of), np.linalg.norm(of))

        def output(key: str) -> float:
            each = zip(entries, rests, strict=True)
            return total((entry.more[key] if entry in moving else rest for entry, rest in each), raw)

        error = total((entry.relative_error for entry in entries), torques)
        before = self.history[-1].relative_error if self.history else math.nan
        steps = (entry.step if entry in moving else 0.0 for entry in entries)
        worst = {
            key: float((np.fmin if key in LEAST else np.fmax).reduce([entry.more[key] for entry in moving]))
            for key in moving[0].more
        }
        own = {
            "residual_change": ratio(abs(error - before), before),
            **{key: output(key) for key in ("output_error_before", "output_error_after")},
        }
        return Iteration(
            iteration=number, relative_error=error, step=total(steps, sizes), more={**worst, **own}
        )

    def _gather(self, stopped: bool) -> None:
        """Join the ends of all limbs."""
        parts, statuses = self.parts, {part.status for part in self.parts}
        ends = [part.iterate if part.status is Status.CONVERGED else part._best for part in parts]
        # Each limb has its own steps in time, and may have been run with half of them already.
        finer = [part.simulator.finer(end.x, end.simulated) for part, end in zip(parts, ends, strict=True)]
        self.status = Status.STOPPED if stopped else Status.NOT_CONVERGED
        if not stopped and statuses == {Status.CONVERGED}:
            self.status = Status.CONVERGED
        elif Status.NO_STEP in statuses:
            self.status = Status.NO_STEP
        self.simulator.n_simulations += max(part.simulator.n_simulations for part in parts)
        for limb_in_robot, part in zip(self.limbs, parts, strict=True):
            for iteration, names in part.problem.stuck.items():
                known = self.problem.stuck.get(iteration)
                self.problem.stuck[iteration] = names if known is None else f"{known}, {names}"
            self.simulator.remarks += [
                f"{limb_in_robot.limb.name}: {text}" for text in part.simulator.remarks
            ]
            self._remarks += [f"{limb_in_robot.limb.name}: {text}" for text in part._remarks]
        end = self._joined(ends)
        finest = replace(end.simulated, finer=self._side_by_side(finer))
        self.iterate = self._best = replace(end, simulated=finest)
        if self.status is Status.CONVERGED:
            last = max(parts, key=lambda part: len(part.history))
            counts = series(str(len(part.history)) for part in parts)
            self._ending = f"{last._ending} Iterations by limb: {counts}."
            self.solved = self._solved()

    def _side_by_side(self, values: Sequence[Array]) -> Array:
        """Return the values of each limb's joints, (..., n_limb_joints), as those of the robot, (..., n_dof)."""
        whole = np.empty((*values[0].shape[:-1], self.problem.robot.n_dof))
        for limb_in_robot, own in zip(self.limbs, values, strict=True):
            whole[..., limb_in_robot.joints] = own
        return whole

    def _joined(self, iterates: Sequence[Iterate]) -> Iterate:
        """Return the iterate of the robot of one of each limb."""
        x, windows, runs = self._x.copy(), self.simulator.windows, [iterate.simulated for iterate in iterates]
        for limb_in_robot, iterate in zip(self.limbs, iterates, strict=True):
            x[limb_in_robot.limb.indices] = iterate.x
        motions = []
        for each in zip(*(run.motions for run in runs), strict=True):
            q, dq, ddq, tau = map(self._side_by_side, zip(*each, strict=True))
            motions.append((q, dq, ddq, tau))
        number = max(iterate.iteration for iterate in iterates)
        return Iterate(x, of_motions(self.problem.base, windows, x, motions, None), number)

    def _solved(self) -> Solved:
        """Return the solution of all rows, with the errors of the limbs that ended at the fixed point of a slack loop."""
        along = self._joined([part.solved.along for part in self.parts])
        solved = self.problem.solve(along, self.problem.observe(along))
        if all(part.solved.fit.factors is None for part in self.parts):
            return solved
        return replace(solved, fit=self._with_errors(solved.system, solved.fit))

    def _with_errors(self, system: LinearSystem, fit: Fit) -> Fit:
        estimated = self.problem.job.model.unknowns.estimated
        position = {column: k for k, column in enumerate(estimated)}
        branches: list[tuple[NDArray[np.intp], NDArray[np.intp], Factors]] = []
        covariance, residual, n = fit.covariance.copy(), np.zeros_like(fit.residual), len(estimated)
        for limb_in_robot, part in zip(self.limbs, self.parts, strict=True):
            rows = np.r_[tuple(system.joints[joint] for joint in limb_in_robot.joints)]
            columns = np.array([position[column] for column in limb_in_robot.columns if column in position])
            own, factors = part.solved.fit, part.solved.fit.factors
            if isinstance(factors, Factors):
                covariance[np.ix_(columns, columns)] = own.covariance
            else:
                w = with_velocities(part.solved.system, own.solution).w
                factors = Factors.of(w * own.weights[:, None], own.residual * own.weights)
            velocities = np.arange(n, n + len(factors.inverse) - len(columns))
            n += len(velocities)
            branches.append((rows, np.concatenate([columns, velocities]), factors))
            residual[rows] = factors.residual
        return replace(fit, covariance=covariance, factors=Branches.joined(branches, n, residual))
