"""The iteration of DIDIM and IDIM-IV, plain and consistent: a problem, a rule for the step, and a rule for the end.

    simulate the start
    repeat: (7) along the motion of the iterate, solved; a step towards the solution, simulated there

Tested in ``tests/test_didim.py``, ``tests/test_consistent.py`` and ``tests/test_contrast.py``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..._tools.words import counted
from ...loop.outcome import Outcome
from ...regression.consistent.solver import ConsistentSolver
from ...result.identification import Identification
from ...result.iteration import Iteration, Reporter
from ...result.status import Status
from ..job import Job, ratio
from .convergence import SLOW, Path, best_sentence, lost_sentence, rule_sentence, slow_sentence
from .ending import result_at
from .globalisation import Globalisation, SafeSteps, SecantSteps
from .problem import ConsistentProblem, Problem
from .settings import DIDIMSettings
from .slack import Attempts, Loop, run_to_fixed_point
from .windows import Iterate, Solved, Step

ROUNDING = 1e-10
"""Residual, as a share of the torques, below which it is rounding."""


class Iterations:
    """The iterations of one run.

    Attributes
    ----------
    problem : Problem
        Linear problem along the motion of an iterate.
    globalisation : Globalisation
        Rule for the length of a step.
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
    along : Iterate
        The iterate along whose motion that was.
    """

    iterate: Iterate
    solved: Solved
    along: Iterate

    def __init__(self, problem: Problem, globalisation: Globalisation) -> None:
        self.problem, self.globalisation, self.reporter = problem, globalisation, problem.reporter
        self.method, self.simulator = problem.method, problem.simulator
        self.history: list[Iteration] = []
        self.status, self.over = Status.NOT_CONVERGED, False
        self._ending, self._exact = "", False
        self._remarks: list[str] = []
        self._path = Path()
        self._attempts = Attempts(self.method.max_iterations)
        self._last_norm = float("nan")
        self._lost = 0

    @classmethod
    def of(cls, method: DIDIMSettings, job: Job, reporter: Reporter) -> Iterations:
        """Return the iterations of a job: among robots if its solver is consistent."""
        if isinstance(job.solver, ConsistentSolver):
            consistent = ConsistentProblem(method, job, job.solver, reporter)
            return cls(consistent, SecantSteps(consistent))
        problem = Problem(method, job, reporter)
        return cls(problem, SafeSteps(problem))

    def result(self) -> Identification:
        """Iterate to the end, and build the result."""
        self.begin()
        while not self.over:
            self.advance()
        return self._finish(self.iterate)

    def begin(self) -> None:
        """Begin at the start, (17) by default."""
        self.iterate = self._best = self._start()
        self._first_error = self.iterate.simulated.error

    def advance(self) -> None:
        """Take one iteration."""
        system = self.problem.observe(self.iterate)  # Y, and W along the simulated motion, (6)
        solved = self.problem.solve(self.iterate, system)  # (7) and (8)
        step = self.globalisation.step(self.iterate, solved)  # towards the solution, and simulated there
        self.iterate = self.stop(self.iterate, solved, step)  # or continue from here

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

    def stop(self, iterate: Iterate, solved: Solved, step: Step) -> Iterate:
        """Record the iteration, and end the run by the stopping rule or the callback; return the current iterate."""
        if isinstance(step.after, Iterate) and step.repeated:
            return step.after
        self.solved, self.along = solved, iterate
        self.history.append(self._entry(iterate, solved, step))
        stopped = self.reporter.progress(self.history[-1])
        self.over = stopped or len(self.history) >= self.method.max_iterations
        if isinstance(step.after, Outcome):
            self.status, self.over = Status.NO_STEP, True
            self._remarks.append(f"after the shortest step tried the simulation {step.after}")
            return iterate
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
                return self._settle(after, solved)
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

    def _finish(self, iterate: Iterate) -> Identification:
        """Build the result: the last iterate if the iterations converged, the best one otherwise."""
        best = self._best
        if self.status is not Status.CONVERGED:
            iterate = best
            self._ending = best_sentence(best.iteration, len(self.history), best.simulated.error)
            self.solved = self.problem.solve(best, self.problem.observe(best))
        self.reporter.say(counted(self.simulator.n_simulations, "simulation"))
        return result_at(
            iterate,
            self.solved,
            self.problem,
            status=self.status,
            ending=self._ending,
            history=self.history,
            first_error=self._first_error,
            remarks=self._remarks,
        )

    def _settle(self, iterate: Iterate, solved: Solved) -> Iterate:
        """End the run, in a slack loop at the fixed point; not with instruments or unknown gains, whose iteration differs."""
        self.over = True
        problem, method = self.problem, self.method
        if self._exact or problem.instrumental or problem.base.n_gains:
            return iterate
        slow = self._path.contraction(solved.std)
        end, count = run_to_fixed_point(
            Loop(problem.job, self.simulator.windows, problem.base, problem.solution, problem.conditions),
            iterate.x,
            iterate.simulated,
            slow,
            self.history,
            method.max_iterations,
            self.reporter.progress,
        )
        self.simulator.n_simulations += count
        if end is None:
            if slow is not None and slow.remaining_largest > SLOW:
                self._remarks.append(slow_sentence(slow, len(self.history)))
            return iterate
        if not end.reached:
            self._attempts.failed(len(self.history))
            rested = self.history[-1].more["largest_change_in_sigma"] <= method.sigma_fraction
            self.over = rested or self._attempts.exhausted or len(self.history) >= method.max_iterations
            if not self.over:
                self.status = Status.NOT_CONVERGED
                return iterate
        self.history = end.continued(self.history)
        self._remarks += end.remarks
        self.solved = replace(solved, system=end.iterate.system, fit=end.iterate.fit)
        self.along = Iterate(end.iterate.x, end.iterate.simulated, len(self.history))
        return self.along

    def _entry(self, iterate: Iterate, solved: Solved, step: Step) -> Iteration:
        """Return the entry of the history."""
        after = step.after
        x = after.x if isinstance(after, Iterate) else iterate.x
        norm = float(np.linalg.norm(solved.fit.residual))
        change = ratio(abs(norm - self._last_norm), self._last_norm)
        self._last_norm = norm
        self._path.add(self.problem.base.project(x - iterate.x), full=step.length == 1.0)
        contraction = self._path.contraction(solved.std)
        return Iteration(
            iteration=len(self.history) + 1,
            relative_error=ratio(norm, np.linalg.norm(solved.system.measured)),
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
        sound = sound and len(self.history) >= self._attempts.patience
        # Without noise the residual, and the sigmas from it, become rounding.
        self._exact = entry.relative_error <= ROUNDING
        steady = change <= method.tolerance and step.largest_change <= self.problem.steady_within
        if not sound or not (self._exact or step.largest_change <= method.sigma_fraction or steady):
            return False
        self._ending = rule_sentence(
            step.largest_change, method.sigma_fraction, change, method.tolerance, exact=self._exact
        )
        return True
