"""The iteration of DIDIM and IDIM-IV, plain and consistent: a problem, a rule for the step, and a rule for the end.

    simulate the start
    repeat: (7) along the motion of the iterate, solved; a step towards the solution, simulated there

Tested in ``tests/test_didim.py``, ``tests/test_consistent.py`` and ``tests/test_contrast.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..._tools.arrays import ratio, rms
from ..._tools.words import counted
from ...loop.outcome import LARGE_ERROR, Outcome
from ...model.safe_step import thinned
from ...regression.consistent.solver import ConsistentSolver
from ...result.finding import Finding
from ...result.identification import Identification
from ...result.iteration import Iteration, Reporter, Status
from ..builder import Run, fitted
from ..job import Job
from .convergence import (
    SLOW,
    Path,
    best_sentence,
    lost_sentence,
    rule_sentence,
    slow_sentence,
    step_sentence,
    stuck_sentence,
)
from .globalisation import SafeSteps, SecantSteps
from .problem import ConsistentProblem, Problem
from .settings import DIDIMSettings
from .simulator import LogSimulator, RateSimulator
from .slack import MOST_ATTEMPTS, run_to_fixed_point
from .windows import Iterate, Solved, Step, along_motion, motion_record

ROUNDING = 1e-10
"""Residual, as a share of the torques, below which it is rounding."""


class Iterations:
    """The iterations of one run.

    Attributes
    ----------
    problem : Problem
        Linear problem along the motion of an iterate.
    globalisation : SafeSteps or SecantSteps
        Rule for the length of a step: secant steps among robots.
    history : list of Iteration
        Iterations so far.
    status : Status
        Ending, if known.
    over : bool
        Whether the run has ended.
    iterate : Iterate
        The current iterate.
    solved : Solved
        The last solution.
    """

    iterate: Iterate
    solved: Solved

    def __init__(self, problem: Problem) -> None:
        self.problem, self.reporter = problem, problem.reporter
        self.globalisation: SafeSteps | SecantSteps = SafeSteps(problem)
        if isinstance(problem, ConsistentProblem):
            self.globalisation = SecantSteps(problem)
        self.method, self.simulator = problem.method, problem.simulator
        self.history: list[Iteration] = []
        self.status, self.over = Status.NOT_CONVERGED, False
        self._ending, self._exact = "", False
        self._remarks: list[str] = []
        self._path = Path()
        # Attempts at the fixed point, and the iterations after the last one before the rule is evaluated again.
        self._attempts, self._patience = 0, 0
        self._last_norm = float("nan")
        self._lost = 0

    @classmethod
    def of(cls, method: DIDIMSettings, job: Job, reporter: Reporter) -> Iterations:
        """Return the iterations of a job: among robots if its solver is consistent."""
        if isinstance(job.solver, ConsistentSolver):
            return cls(ConsistentProblem(RateSimulator(method, job, reporter), job.solver))
        return cls(Problem(LogSimulator(method, job, reporter)))

    def result(self) -> Identification:
        """Iterate to the end, and build the result."""
        self.begin()
        while not self.over:
            self.advance()
        return self._finish()

    def begin(self) -> None:
        """Begin at the start, (17) by default."""
        self.iterate = self._best = self._start()
        self._first_error = self.iterate.simulated.error

    def advance(self) -> None:
        """Take one iteration."""
        system = self.problem.observe(self.iterate)  # Y, and W along the simulated motion, (6)
        solved = self.problem.solve(self.iterate, system)  # (7) and (8)
        step = self.globalisation.step(solved)  # towards the solution, and simulated there
        self.iterate = self.stop(solved, step)  # or continue from here

    def _start(self) -> Iterate:
        """Simulate the start, with smaller time steps if those of the experiment fail."""
        x = self.problem.start()
        scale = self.simulator.gain_scale(x)
        simulated = self.simulator.simulate(x, scale)
        if isinstance(simulated, Outcome) and self.simulator.take_small_steps():
            simulated = self.simulator.simulate(x, scale)
        if isinstance(simulated, Outcome):
            raise self.problem.no_start(f"the simulation {simulated}")
        return Iterate(x, simulated, 0)

    def stop(self, solved: Solved, step: Step) -> Iterate:
        """Record the iteration, and end the run by the stopping rule or the callback; return the current iterate."""
        if isinstance(step.after, Iterate) and step.repeated:
            return step.after
        self.solved = solved
        self.history.append(self._entry(solved, step))
        stopped = self.reporter.progress(self.history[-1])
        self.over = stopped or len(self.history) >= self.method.max_iterations
        if isinstance(step.after, Outcome):
            self.status, self.over = Status.NO_STEP, True
            self._remarks.append(f"after the shortest step tried the simulation {step.after}")
            return solved.along
        after = step.after
        self.status = Status.STOPPED if stopped else Status.NOT_CONVERGED
        self._compare(after)
        if not stopped and self._rule_holds(after, solved, step):
            # Repeat the last iterations with the experiment's time steps, so the result does not depend on the start.
            usual = self.simulator.take_usual_steps(after.x)
            if usual is not None:
                return replace(after, simulated=usual)
            self.status = Status.CONVERGED
            if self.over or self.method.stop:
                return self._settle(after)
        return after

    def _compare(self, after: Iterate) -> None:
        """Record the best iterate, and give up if only worse ones follow."""
        error, best = after.simulated.error, self._best.simulated.error
        self._lost = self._lost + 1 if error >= max(1.0, best) else 0
        if error < best:
            self._best = after
        if self._lost >= self.problem.most_lost and self.status is not Status.STOPPED:
            self.over = True
            self._remarks.append(lost_sentence(self._lost, error))

    def _finish(self) -> Identification:
        """Build the result, with the errors of its parameters: the last iterate if the iterations converged, else the best one."""
        problem, job, simulator, converged = (
            self.problem,
            self.problem.job,
            self.simulator,
            self.status.converged,
        )
        if not converged:
            self.iterate = best = self._best
            self._ending = best_sentence(best.iteration, len(self.history), best.simulated.error)
            self.solved = problem.solve(best, problem.observe(best))
        self.reporter.say(counted(simulator.n_simulations, "simulation"))
        point, system, fit = self.iterate, self.solved.system, self.solved.fit
        # After a shortened step the iterate is not the solution, so the residual is computed again.
        estimate = job.estimated(point.x)
        fit = replace(
            fit,
            solution=estimate,
            residual=system.y - system.w @ estimate,
            standard=None if fit.standard is None else point.x,
            # (10) is only valid at the minimum.
            covariance=fit.covariance if converged else np.zeros_like(fit.covariance),
        )
        suspected = problem.suspected(system, fit, converged=converged)
        run = Run(
            job=job,
            method=self.method,
            status=self.status,
            history=self.history,
            delay=simulator.delay,
            q=thinned(np.concatenate([motion[0] for motion in point.simulated.motions]), 2000),
            settings={
                **problem.record(),
                "simulated": motion_record(job, simulator.windows, point.simulated),
            },
            remarks=[*problem.remarks, *self._remarks, *self._sentences(suspected)],
            evidence=problem.evidence(suspected, point.simulated.error),
        )
        parts = () if job.model.n_gains else along_motion(simulator.windows, point.simulated)
        return replace(
            fitted(run, system, fit, beta=job.model.project(point.x), parts=parts),
            ending=self._ending,
            output_error=(self._first_error, point.simulated.error),
            n_simulations=simulator.n_simulations,
        )

    def _sentences(self, suspected: Sequence[Finding]) -> list[str]:
        """Return sentences on stuck joints, time steps and the reference."""
        sentences, simulator, point = [], self.simulator, self.iterate
        if self.problem.stuck:
            sentences.append(stuck_sentence(self.problem.stuck))
        if not simulator.steps_follow_rates:
            fine, torque = simulator.finer(point.x, point.simulated), point.simulated.motions[0][3]
            error, size = rms(fine - torque), rms(fine)
            # With a wrong log no time step is small enough.
            if not suspected and not np.all(error <= LARGE_ERROR * size):
                sentences.append(step_sentence(error, size))
        if getattr(simulator.experiment.reference, "kind", "") == "measured":
            sentences.append(
                "the reference is the measured position, not the commanded one: the simulated robot follows it with an error that "
                "the real one did not have"
            )
        return sentences

    def _settle(self, iterate: Iterate) -> Iterate:
        """End the run, in a slack loop at the fixed point; not with instruments or unknown gains, whose iteration differs."""
        self.over = True
        problem, method = self.problem, self.method
        if self._exact or problem.instrumental or problem.base.n_gains:
            return iterate
        slow = self._path.contraction(self.solved.std)
        end = run_to_fixed_point(problem, iterate, slow, self.history)
        if end is None:
            if slow is not None and slow.remaining_largest > SLOW:
                self._remarks.append(slow_sentence(slow, len(self.history)))
            return iterate
        if not end.reached:
            self._attempts += 1
            # The rule is also evaluated at the last iteration, at which the run may have converged.
            self._patience = min(2 * len(self.history), method.max_iterations)
            rested = self.history[-1].more["largest_change_in_sigma"] <= method.sigma_fraction
            few = self._attempts < MOST_ATTEMPTS and len(self.history) < method.max_iterations
            self.over = rested or not few
            if not self.over:
                self.status = Status.NOT_CONVERGED
                return iterate
        self.history = end.continued(self.history)
        self._remarks += end.remarks
        self.solved = end.solved
        return end.solved.along

    def _entry(self, solved: Solved, step: Step) -> Iteration:
        """Return the entry of the history."""
        iterate, after = solved.along, step.after
        x = after.x if isinstance(after, Iterate) else iterate.x
        norm = float(np.linalg.norm(solved.fit.residual))
        change = ratio(abs(norm - self._last_norm), self._last_norm)
        self._last_norm = norm
        self._path.add(self.problem.base.project(x - iterate.x), full=step.length == 1.0)
        contraction = self._path.contraction(solved.std)
        return Iteration(
            iteration=len(self.history) + 1,
            relative_error=solved.system.relative_error(solved.fit.residual),
            step=ratio(np.linalg.norm(x - iterate.x), np.linalg.norm(x)),
            more={
                "step_length": step.length,
                "largest_safe_step": step.largest,
                "largest_change_in_sigma": step.largest_change,
                "residual_change": change,
                "output_error_before": iterate.simulated.error,
                "output_error_after": after.simulated.error if isinstance(after, Iterate) else np.nan,
                "condition_number": solved.fit.condition_number,
                "contraction": np.nan if contraction is None else contraction.rate,
                "remaining_sigma": np.nan if contraction is None else contraction.remaining_largest,
            },
        )

    def _rule_holds(self, after: Iterate, solved: Solved, step: Step) -> bool:
        """Whether the residual or the parameters have converged; stores the sentence on the rule."""
        method, entry = self.method, self.history[-1]
        change = entry.more["residual_change"]
        # A diverging robot may have steady residuals, but is further from the log than zero torque.
        sound = step.length >= step.wanted and after.simulated.error < 1.0 and not solved.held
        sound = sound and len(self.history) >= self._patience
        # Without noise the residual, and the sigmas from it, become rounding.
        self._exact = entry.relative_error <= ROUNDING
        steady = change <= method.tolerance and step.largest_change <= self.problem.steady_within
        if not sound or not (self._exact or step.largest_change <= method.sigma_fraction or steady):
            return False
        self._ending = rule_sentence(
            step.largest_change, method.sigma_fraction, change, method.tolerance, exact=self._exact
        )
        return True
