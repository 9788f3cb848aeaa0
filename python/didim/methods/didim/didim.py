"""DIDIM: closed-loop output error on the torques, by linear least squares per iteration (section IV of the paper).

The closed loop is simulated with the current parameters; the regressor along the simulated motion, filtered and decimated
in parallel with the measured torques, gives the next ones by least squares. Only torques are needed: no positions, no
velocities, no band-pass filter. Tested in ``tests/test_didim.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import numpy as np

import didim._core as _core

from ..._tools.arrays import Array
from ..._tools.words import counted, listing
from ...errors import DidimError, FitError, RankError
from ...experiment.experiment import Experiment
from ...loop.outcome import Outcome, SimulationStatus
from ...model.safe_step import safe_step
from ...regression.consistent.solver import ConsistentSolver
from ...regression.gains.currents import Currents
from ...regression.least_squares import solve_partly
from ...regression.linear_system import LinearSystem
from ...result.identification import Identification
from ...result.iteration import Iteration
from ...result.status import Status
from ..job import Job, ratio
from ..start import FROM_LOG, further_of, standard_start, start_from_log
from .consistent import ConsistentRun
from .convergence import SLOW, Path, best_sentence, rule_sentence, slow_sentence
from .ending import result_at
from .loops import Loops
from .settings import DIDIMSettings
from .slack import Attempts, Loop, settled
from .windows import Point, Simulated, Solved, Step, checked_positions, segments_of

ROUNDING = 1e-10
"""Share of the torques below which a residual is rounding."""
MOST_HALVINGS = 20
"""How often a step is halved when the simulation after it does not reach its end."""


class DIDIM(DIDIMSettings):
    """DIDIM with its settings, those of `DIDIMSettings` and `FitSettings`.

    By default every iterate is a robot (`didim.methods.didim.consistent`); ``physical=False`` is the DIDIM of the paper.
    """

    physical_by_default: ClassVar[bool] = True

    def run(
        self,
        experiment: Experiment,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> Identification:
        """Identify the parameters of an experiment's robot; parameters as for `IDIMLS.run`.

        Raises
        ------
        DidimError
            One of its kinds: without a reference or a controller, for a start with which the robot cannot be simulated,
            for a log that allows no estimate.
        """
        job = self.job(experiment, experiment.simulation.robot(experiment.robot))
        if isinstance(job.solver, ConsistentSolver):
            return ConsistentRun(self, job, job.solver, progress, say).result()
        iterations = Iterations(self, job, progress, say)
        point = iterations.simulate()  # the start, (17) by default
        while not iterations.over:
            system = iterations.observe(point)  # Y, and W along the simulated motion, (6)
            solved = iterations.solve(point, system)  # (7) and (8)
            step = iterations.step(point, solved)  # towards the solution, and simulated there
            point = iterations.stop(point, solved, step)  # or go on from here
        return iterations.result(point)


class Iterations:
    """The iterations of one run.

    Attributes
    ----------
    over : bool
        Whether the last iteration has been made.
    history : list of Iteration
        Iterations so far.
    status : Status
        Ending, as far as it is known.
    """

    def __init__(
        self,
        method: DIDIMSettings,
        job: Job,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> None:
        self.method, self.job, self.progress, self.say = method, job, progress, say
        self.robot, self.base = job.robot, job.parameters
        self.loops = Loops(method, job, job.delay(), say)
        self.history: list[Iteration] = []
        self.status, self.over = Status.NOT_CONVERGED, False
        self._ending, self._exact = "", False
        self._remarks: list[str] = []
        self._stuck: dict[int, str] = {}
        self._path = Path()
        self._attempts = Attempts(method.max_iterations)
        self._last_norm = float("nan")
        self._best: Point | None = None
        self._first_error = float("nan")
        self._solved: Solved | None = None

    def simulate(self) -> Point:
        """Simulate the start, with smaller steps in time where those of the experiment do not do."""
        x = self._start()
        scale = self.loops.gain_scale(x) if self.method.gain_updating != "never" else None
        simulated = self.loops.simulate(x, scale)
        if isinstance(simulated, Outcome) and self.loops.take_small_steps():
            simulated = self.loops.simulate(x, scale)
        if isinstance(simulated, Outcome):
            raise self._no_start(f"the simulation {simulated}")
        self._first_error = simulated.error
        self._best = Point(x, simulated, 0)
        return self._best

    def observe(self, point: Point) -> LinearSystem:
        """Return the linear system (7): measured torques, and the regressor along the simulated motion."""
        system = self.job.system(segments_of(self.loops.windows, point.simulated), self.base.project(point.x))
        return self.about(point, system)

    def about(self, point: Point, system: LinearSystem) -> LinearSystem:
        """Return a system as it is, or with unknown drive gains the system that is linear in them about a point.

        The start knows nothing of the torques, so the first system is about the estimate with its gains.
        """
        n = self.base.n_gains
        if not n:
            return system
        currents = Currents.of(system, self.job.reduction)
        values = self.base.project(point.x)[self.job.selection.estimated]
        gains = values[-n:]
        return currents.linearised(values[:-n] if point.iteration else currents.parameters(gains), gains)

    def solve(self, point: Point, system: LinearSystem) -> Solved:
        """Solve (7) along the motion of a point.

        Parameters that this motion does not identify, because simulated joints stick in friction, keep the values of the point;
        it is the log that lacks them only if the measured motion does not identify them either.
        """
        job = self.job
        try:
            fit = job.solve(system)
            kept: tuple[int, ...] = ()
        except RankError as reason:
            self._blame_log()
            values = self.base.project(point.x)[job.selection.estimated]
            fit, kept = solve_partly(system, job.solve, values, reason.columns)
            self._stuck[point.iteration] = listing([system.names[column] for column in kept])
        target = self.base.lift(job.selection.expand(fit.solution))
        std = np.sqrt(np.diag(job.selection.expand_covariance(fit.covariance)))
        return Solved(system, fit, target, std, kept)

    def step(self, point: Point, solved: Solved) -> Step:
        """Go towards the solution as far as M(q) > 0 and the simulation there allow."""
        largest = self._largest_step(point, solved.target)
        moved = self._in_sigma(solved, solved.target - point.x)
        # The simulation that may be the last one has its check of the steps in time beside it.
        length, after = self._advance(point, solved.target, largest, moved <= self.method.sigma_fraction)
        if length < largest and self.loops.take_small_steps():
            # A step that keeps M(q) > 0 leads to a robot; that it cannot be simulated is a matter of the steps in time.
            again = self.loops.simulate(point.x, point.simulated.scale)
            if isinstance(again, Simulated):
                return Step(length, largest, moved, replace(point, simulated=again), repeated=True)
        return Step(length, largest, moved, after)

    def _largest_step(self, point: Point, target: Array) -> float:
        """Largest share of the way that keeps M(q) > 0 of the robot with every payload."""
        parameters = self.base
        groups: dict[int, list[Array]] = {}
        for window, motion in zip(self.loops.windows, point.simulated.motions, strict=True):
            groups.setdefault(-1 if parameters.simple else window.recording, []).append(motion[0])
        return min(
            safe_step(
                self.robot,
                checked_positions(np.concatenate(q)),
                parameters.standard(point.x, recording),
                parameters.standard(target, recording),
                self.method.margin,
            )
            for recording, q in groups.items()
        )

    def stop(self, point: Point, solved: Solved, step: Step) -> Point:
        """Record the iteration, and end the run where the rule or the callback says so; return the point reached."""
        if isinstance(step.after, Point) and step.repeated:
            return step.after
        self._solved = solved
        self.history.append(self._entry(point, solved, step))
        stopped = self.progress(self.history[-1])
        self.over = stopped or len(self.history) >= self.method.max_iterations
        if isinstance(step.after, Outcome):
            self.status, self.over = Status.NO_STEP, True
            self._remarks.append(f"after the shortest step tried the simulation {step.after}")
            return point
        point = step.after
        if self._best is None or point.simulated.error < self._best.simulated.error:
            self._best = point
        self.status = Status.STOPPED if stopped else Status.NOT_CONVERGED
        if not stopped and self._rule_holds(point, solved, step):
            # Repeat the last iterations with the experiment's own steps in time: the result must not depend on the start.
            usual = self.loops.take_usual_steps(point.x)
            if usual is not None:
                return replace(point, simulated=usual)
            self.status = Status.CONVERGED
            if self.over or self.method.stop:
                return self._settle(point, solved)
        return point

    def result(self, point: Point) -> Identification:
        """Put together the result: the last point if the iterations converged, the best one otherwise."""
        solved, best = self._solved, self._best
        assert solved is not None  # every run makes an iteration, and has simulated its start
        assert best is not None
        if self.status is not Status.CONVERGED:
            point = best
            self._ending = best_sentence(best.iteration, len(self.history), best.simulated.error)
            solved = self.solve(best, self.observe(best))
        self.say(counted(self.loops.n_simulations, "simulation"))
        return result_at(
            point,
            solved,
            self.loops,
            status=self.status,
            ending=self._ending,
            history=self.history,
            first_error=self._first_error,
            stuck=self._stuck,
            remarks=self._remarks,
        )

    def _settle(self, point: Point, solved: Solved) -> Point:
        """End the run, at the fixed point in a slack loop; with instruments or unknown gains the iteration is another one."""
        self.over = True
        if self._exact or self.method.motion != "simulated" or self.base.n_gains:
            return point
        method, slow = self.method, self._path.contraction(solved.std)
        end, count = settled(
            Loop(self.job, self.loops.windows, self.base, self.job.solve),
            point.x,
            point.simulated,
            slow,
            self.history,
            method.max_iterations,
            self.progress,
        )
        self.loops.n_simulations += count
        if end is None:
            if slow is not None and slow.remaining_largest > SLOW:
                self._remarks.append(slow_sentence(slow, len(self.history)))
            return point
        if not end.reached:
            self._attempts.failed(len(self.history))
            rested = self.history[-1].more["largest_change_in_sigma"] <= method.sigma_fraction
            self.over = rested or self._attempts.exhausted or len(self.history) >= method.max_iterations
            if not self.over:
                self.status = Status.NOT_CONVERGED
                return point
        self.history = end.continued(self.history)
        self._remarks += end.remarks
        self._solved = replace(solved, system=end.place.system, fit=end.place.fit)
        return Point(end.place.x, end.place.simulated, len(self.history))

    def _start(self) -> Array:
        """Return the standard parameters to start from, with fixed and dropped ones at their values."""
        start = self.method.chosen_start
        further: dict[str, float] = {}
        if isinstance(start, str) and start == "idim-ls":
            direct = self.loops.direct()
            x, further = direct.parameters, further_of(direct)
        elif isinstance(start, str) and start in FROM_LOG:
            x = start_from_log(self.job, self.loops.delay, start)
        else:
            x, further = standard_start(self.robot, start), further_of(start)
        if self.base.n_gains:
            # Of the rows along the measured motion: without gains there are no torques to begin with.
            further = {**further_of(self.loops.direct()), **further}
        x = self.base.extended(x, further)
        beta = self.base.project(x)
        beta[[role != "estimated" for role in self.job.selection.roles]] = 0.0
        x = self.base.lift(beta + self.job.selection.values)
        unloaded = x[: len(self.robot.parameter_names)]
        smallest = _core.smallest_eigenvalue(self.robot.core, self.loops.reference_positions(), unloaded)
        if smallest is not None and not smallest[1] > 0.0:
            raise self._no_start(
                f"M(q) is not positive definite on the reference (smallest eigenvalue {smallest[1]:.3g})"
            )
        return x

    def _no_start(self, reason: str) -> FitError:
        # A log that is wrong makes IDIM-LS wrong, which may be the start and scales the gains.
        why = "".join(f"; {sentence}" for sentence in self.loops.suspicions())
        return FitError(f"DIDIM cannot start from these parameters: {reason}{why}")

    def _blame_log(self) -> None:
        """Raise the error of a log whose measured motion does not identify all parameters either."""
        try:
            self.loops.direct()
        except RankError:
            raise
        except DidimError:
            return  # the measured motion says nothing

    def _in_sigma(self, solved: Solved, step: Array) -> float:
        """Largest change of a base parameter, in standard deviations."""
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.abs(self.base.project(step)) / solved.std
        return float(np.nanmax(np.where(solved.std > 0.0, change, 0.0)))

    def _advance(
        self, point: Point, target: Array, largest: float, checked: bool
    ) -> tuple[float, Point | Outcome]:
        """Halve the step until the simulation after it reaches its end; stay where no step does."""
        length, ended = largest, Outcome(SimulationStatus.DIVERGED)
        for _ in range(MOST_HALVINGS):
            x = point.x + length * (target - point.x) if length < 1.0 else target
            # With "first" the scale has served its turn; after a full step it would only spoil known gains.
            updating = self.method.gain_updating == "always" and length < 1.0
            found = self.loops.simulate(x, self.loops.gain_scale(x) if updating else None, checked)
            if isinstance(found, Simulated):
                return length, Point(x, found, point.iteration + 1)
            ended = found
            self.say(f"with a step of {length:.3g} the simulation {found}; half of it")
            length *= 0.5
        return 0.0, ended

    def _entry(self, point: Point, solved: Solved, step: Step) -> Iteration:
        """Entry of the history."""
        after = step.after
        x = after.x if isinstance(after, Point) else point.x
        norm = float(np.linalg.norm(solved.fit.residual))
        change = ratio(abs(norm - self._last_norm), self._last_norm)
        self._last_norm = norm
        self._path.add(self.base.project(x - point.x), full=step.length == 1.0)
        contraction = self._path.contraction(solved.std)
        return Iteration(
            iteration=len(self.history) + 1,
            relative_error=ratio(norm, np.linalg.norm(solved.system.measured)),
            step=ratio(np.linalg.norm(x - point.x), np.linalg.norm(x)),
            more={
                "step_length": step.length,
                "largest_safe_step": step.largest,
                "largest_change_in_sigma": step.moved,
                "residual_change": change,
                "output_error_before": point.simulated.error,
                "output_error_after": after.simulated.error if isinstance(after, Point) else np.nan,
                "condition_number": solved.fit.condition_number,
                "contraction": np.nan if contraction is None else contraction.rate,
                "remaining_sigma": np.nan if contraction is None else contraction.remaining_largest,
            },
        )

    def _rule_holds(self, point: Point, solved: Solved, step: Step) -> bool:
        """Whether the residual or the parameters have come to rest; keeps the sentence on the rule that fired."""
        method, entry = self.method, self.history[-1]
        change = entry.more["residual_change"]
        # A diverging robot may have steady residuals; it is further from the log than no torque at all.
        sound = step.length == 1.0 and point.simulated.error < 1.0 and not solved.kept
        sound = sound and len(self.history) >= self._attempts.patience
        # Without noise the residual, and the sigmas made of it, end as rounding.
        self._exact = entry.relative_error <= ROUNDING
        if not sound or not (
            self._exact or step.moved <= method.sigma_fraction or change <= method.tolerance
        ):
            return False
        self._ending = rule_sentence(
            step.moved, method.sigma_fraction, change, method.tolerance, exact=self._exact
        )
        return True
