"""The iteration of DIDIM and IDIM-IV, plain and consistent: a problem, a rule for the step, and a rule for the end.

    simulate the start
    repeat: (7) along the motion of the iterate, solved; a step towards the solution, simulated there

Limbs that share nothing come to rest one by one: the parameters of one that has converged stay while the others go on. Tested in
``tests/test_didim.py``, ``tests/test_consistent.py``, ``tests/test_limbs.py`` and ``tests/test_contrast.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array, ratio, rms
from ..._tools.words import counted, series
from ...loop.outcome import LARGE_ERROR, Outcome
from ...model.safe_step import thinned
from ...regression.consistent.solver import ConsistentSolver
from ...result.finding import Finding
from ...result.identification import Identification
from ...result.iteration import Iteration, Reporter, Status
from ..builder import Run, fitted
from ..job import Job
from .consistent import ConsistentProblem
from .convergence import (
    SLOW,
    Path,
    best_sentence,
    lost_sentence,
    motion_record,
    rule_sentence,
    slow_sentence,
    step_sentence,
    stuck_sentence,
)
from .problem import Iterate, Problem, Solved
from .settings import DIDIMSettings
from .slack import MOST_ATTEMPTS, run_to_fixed_point
from .steps import SafeSteps, SecantSteps, Step

ROUNDING = 1e-10
"""Residual, as a share of the torques, below which it is rounding."""


class Iterations:
    """The iterations of one run.

    Attributes
    ----------
    problem : Problem
        Linear problem along the motion of an iterate.
    descent : SafeSteps or SecantSteps
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
    rests : dict of int to int
        Iteration at which a part of the problem came to rest, by its number.
    """

    solved: Solved

    def __init__(self, method: DIDIMSettings, job: Job, reporter: Reporter) -> None:
        self.method, self.reporter = method, reporter
        self.problem: Problem
        self.descent: SafeSteps | SecantSteps
        if isinstance(job.solver, ConsistentSolver):
            self.problem = ConsistentProblem(method, job, reporter, job.solver)
            self.descent = SecantSteps(self.problem)
        else:
            self.problem = Problem(method, job, reporter)
            self.descent = SafeSteps(self.problem)
        self.history: list[Iteration] = []
        self.status, self.over = Status.NOT_CONVERGED, False
        self.rests: dict[int, int] = {}
        self._ending, self._exact = "", False
        self._remarks: list[str] = []
        self._path = Path()
        # Attempts at the fixed point, and the iterations after the last one before the rule is evaluated again.
        self._attempts, self._patience = 0, 0
        self._norms = np.full(len(self.problem.parts), np.nan)
        self._lost = 0
        self.iterate = self._start()
        self._bests = [self.iterate] * len(self.problem.parts)
        self._first_error = self.iterate.simulated.error

    def result(self) -> Identification:
        """Iterate to the end, and build the result."""
        while not self.over:
            self.advance()
        return self._finish()

    def advance(self) -> None:
        """Take one iteration."""
        solved = self.problem.solve(self.iterate)  # (7) along the simulated motion, (6), and its solution (8)
        step = self.descent.step(solved)  # towards the solution, and simulated there
        self.iterate = self.stop(solved, step)  # or continue from here

    def _start(self) -> Iterate:
        """Simulate the start, (17) by default, with smaller time steps if those of the experiment fail."""
        problem = self.problem
        x = problem.start()
        scale = problem.gain_scale(x)
        simulated = problem.simulate(x, scale)
        if isinstance(simulated, Outcome) and problem.take_small_steps():
            simulated = problem.simulate(x, scale)
        if isinstance(simulated, Outcome):
            raise problem.no_start(f"the simulation {simulated}")
        return Iterate(x, simulated, 0)

    def stop(self, solved: Solved, step: Step) -> Iterate:
        """Record the iteration, and end the run by the stopping rule or the callback; return the current iterate."""
        after = step.after
        if isinstance(after, Iterate) and step.repeated:
            return after
        self.solved = solved
        norms, self._norms = self._norms, self._norms_of(solved)
        self.history.append(self._entry(solved, step, norms))
        stopped = self.reporter.progress(self.history[-1])
        self.over = stopped or len(self.history) >= self.method.max_iterations
        if isinstance(after, Outcome):
            self.status, self.over = Status.NO_STEP, True
            self._remarks.append(f"after the shortest step tried the simulation {after}")
            return solved.along
        self.status = Status.STOPPED if stopped else Status.NOT_CONVERGED
        self._compare(after)
        if not stopped and self._all_rest(after, solved, step, norms):
            # Repeat the last iterations with the experiment's time steps, so the result does not depend on the start.
            self.problem.rouse()
            usual = self.problem.take_usual_steps(after.x)
            if usual is not None:
                self.rests = {}
                return replace(after, simulated=usual)
            self.status = Status.CONVERGED
            if self.over or self.method.stop:
                return self._settle(after)
            self.rests = {}
        return after

    def _compare(self, after: Iterate) -> None:
        """Record the best iterate of each part, and give up if only worse ones follow."""
        error, best = after.simulated.error, min(each.simulated.error for each in self._bests)
        self._lost = self._lost + 1 if error >= max(1.0, best) else 0
        for number, part in enumerate(self.problem.parts):
            if after.simulated.error_of(part.joints) < self._bests[number].simulated.error_of(part.joints):
                self._bests[number] = after
        if self._lost >= self.problem.most_lost and self.status is not Status.STOPPED:
            self.over = True
            self._remarks.append(lost_sentence(self._lost, error))

    def _norms_of(self, solved: Solved) -> Array:
        """Return the norm of the residual of each part."""
        joints = solved.system.norms(solved.fit.residual)
        return np.array([np.linalg.norm(joints[part.joints]) for part in self.problem.parts])

    def _all_rest(self, after: Iterate, solved: Solved, step: Step, norms: Array) -> bool:
        """Let parts rest whose residual or parameters have converged; whether all do. Stores the sentence on the rule.

        `norms` are those of the iteration before.
        """
        method, problem = self.method, self.problem
        torques, exact = solved.system.norms(solved.system.measured), []
        sound = not solved.held and len(self.history) >= self._patience
        for number, part in enumerate(problem.parts):
            norm, before = self._norms[number], norms[number]
            # Without noise the residual, and the sigmas from it, become rounding.
            exact.append(ratio(norm, np.linalg.norm(torques[part.joints])) <= ROUNDING)
            # A diverging robot may have steady residuals, but is further from the log than zero torque.
            taken = sound and step.lengths[number] >= step.wanted
            if number in self.rests or not taken or not after.simulated.error_of(part.joints) < 1.0:
                continue
            change, largest = ratio(abs(norm - before), before), float(step.changes[part.columns].max())
            steady = change <= method.tolerance and largest <= problem.steady_within
            if exact[-1] or largest <= method.sigma_fraction or steady:
                self.rests[number] = len(self.history)
                problem.rest(part)
                self._ending = rule_sentence(
                    largest, method.sigma_fraction, change, method.tolerance, exact=exact[-1]
                )
        self._exact = all(exact)
        return len(self.rests) == len(problem.parts)

    def _finish(self) -> Identification:
        """Build the result, with the errors of its parameters: the last iterate if the iterations converged, else the best one."""
        problem, job, converged = self.problem, self.problem.job, self.status.converged
        if not converged:
            problem.rouse()
            self.iterate = best = self._joined_bests()
            self._ending = best_sentence(best.iteration, len(self.history), best.simulated.error)
            self.solved = problem.solve(best)
        elif len(self.rests) > 1:
            steps = len(self.history) - max(self.rests.values())  # Newton's, of all limbs
            counts = series(str(self.rests[number] + steps) for number in range(len(self.rests)))
            self._ending += f" Iterations by limb: {counts}."
        self.reporter.say(counted(problem.n_simulations, "simulation"))
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
        suspected = problem.suspected(system, converged=converged)
        run = Run(
            job=job,
            method=self.method,
            status=self.status,
            history=self.history,
            delay=problem.delay,
            q=thinned(np.concatenate([motion[0] for motion in point.simulated.motions]), 2000),
            settings={
                **problem.record(),
                "simulated": motion_record(job.signal, problem.windows, point.simulated),
            },
            remarks=[*problem.remarks, *self._remarks, *self._sentences(suspected)],
            evidence=problem.evidence(suspected, point.simulated.error),
        )
        parts = () if job.model.n_gains else problem.along(point.simulated)
        return replace(
            fitted(run, system, fit, beta=job.model.project(point.x), parts=parts),
            ending=self._ending,
            output_error=(self._first_error, point.simulated.error),
            n_simulations=problem.n_simulations,
        )

    def _joined_bests(self) -> Iterate:
        """Return the iterate with the parameters of each part's best one."""
        best = min(self._bests, key=lambda each: each.simulated.error)
        if all(each is best for each in self._bests):
            return best
        x = best.x.copy()
        for part, each in zip(self.problem.parts, self._bests, strict=True):
            x[part.indices] = each.x[part.indices]
        run = self.problem.simulate(x)
        last = max(each.iteration for each in self._bests)
        return best if isinstance(run, Outcome) else Iterate(x, run, last)

    def _sentences(self, suspected: Sequence[Finding]) -> list[str]:
        """Return sentences on stuck joints, time steps and the reference."""
        sentences, problem = [], self.problem
        if problem.stuck:
            sentences.append(stuck_sentence(problem.stuck))
        if not problem.steps_follow_rates:
            fine, torque = problem.finer(self.iterate), self.iterate.simulated.motions[0][3]
            error, size = rms(fine - torque), rms(fine)
            # With a wrong log no time step is small enough.
            if not suspected and not np.all(error <= LARGE_ERROR * size):
                sentences.append(step_sentence(error, size))
        if getattr(problem.experiment.reference, "kind", "") == "measured":
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
                self.status, self.rests = Status.NOT_CONVERGED, {}
                return iterate
        self.history = end.continued(self.history)
        self._remarks += end.remarks
        self.solved = end.solved
        return end.solved.along

    def _entry(self, solved: Solved, step: Step, norms: Array) -> Iteration:
        """Return the entry of the history; `norms` are the residuals of the iteration before."""
        iterate, after = solved.along, step.after
        x = after.x if isinstance(after, Iterate) else iterate.x
        norm, before = (float(np.linalg.norm(each)) for each in (self._norms, norms))
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
                "residual_change": ratio(abs(norm - before), before),
                "output_error_before": iterate.simulated.error,
                "output_error_after": after.simulated.error if isinstance(after, Iterate) else np.nan,
                "condition_number": solved.fit.condition_number,
                "contraction": np.nan if contraction is None else contraction.rate,
                "remaining_sigma": np.nan if contraction is None else contraction.remaining_largest,
            },
        )
