"""Linear problem of an iteration: (7) along simulated motion (DIDIM), or along measured motion with instruments (IDIM-IV).

    DIDIM      W, y of (7) along the motion of the iterate
    IDIM-IV    W, y along the measured motion, instruments along that of the iterate

solved by the solver of the run, for the identifiable parameters only, or with physical constraints. Tested
in ``tests/test_didim.py``, ``tests/test_consistent.py`` and ``tests/test_contrast.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

import didim._core as _core

from ..._tools.arrays import Array, quotient
from ..._tools.words import brief, listing
from ...errors import DidimError, FitError, RankError
from ...evidence.naming import torque_findings
from ...evidence.torques import contradiction_findings, following_findings
from ...experiment.experiment import Experiment
from ...experiment.loop_tables import MadeUpRecipe
from ...experiment.specs import ControllerSpec
from ...loop.tuning import made_up
from ...regression.classical.instrumental import solve_with_instruments
from ...regression.consistent.diagnosis import diagnosis
from ...regression.consistent.nearest import root_of
from ...regression.consistent.problem import ConstrainedProblem
from ...regression.consistent.solver import ConsistentSolver
from ...regression.covariance import inverse
from ...regression.fit import Fit
from ...regression.gains.currents import Currents
from ...regression.least_squares import solve_partly
from ...result.finding import Finding
from ...signal.window import Window
from ...terms.rows import LinearSystem
from ..start import extended_start, further_of, standard_start
from .simulability import damping_of, simulable
from .simulator import LogSimulator, RateSimulator
from .windows import Iterate, Solved, along_motion

RECORDED = ("tolerance", "sigma_fraction", "max_iterations", "gain_updating", "margin")
"""Settings that a result records, in addition to the start."""
POSITIONS = 60
"""Number of positions of the log at which rates and inertias are evaluated."""
STARTS = ("consistent", "idim-ls")
"""Names of the start at the physically consistent robot nearest to the estimate of IDIM-LS, along the measured motion."""


def _first_of(findings: Sequence[Finding]) -> str:
    """Return the first suspected fault of a log as the end of a message; empty for none."""
    return f"; {brief(findings[0].sentence, 90)}" if findings else ""


class Problem:
    """The linear system of an iterate, solved for the parameters that its motion identifies.

    Attributes
    ----------
    simulator : LogSimulator
        Closed loops of the log.
    stuck : dict of int to str
        Parameters that a simulated motion did not identify, by iteration, 0 for the start.
    steady_within : float
        Largest change in standard deviations at which a steady residual ends the iteration.
    most_lost : float
        Number of successive iterations, further from the log than zero torque and than the best one, after which the run gives up.
    """

    steady_within = np.inf
    most_lost = np.inf
    conditions: ConstrainedProblem | None = None
    contradictions: Sequence[Finding] = ()

    def __init__(self, simulator: LogSimulator) -> None:
        self.simulator, self.job = simulator, simulator.job
        self.method, self.reporter = simulator.method, simulator.reporter
        self.robot, self.base = self.job.robot, self.job.model
        self.stuck: dict[int, str] = {}

    @cached_property
    def measured(self) -> LinearSystem:
        """(7) along the measured motion."""
        return self.job.system(self.job.parts("fit", self.simulator.delay))

    @property
    def instrumental(self) -> bool:
        """Whether the simulated motion provides instruments for the measured one."""
        return self.method.motion == "measured"

    def start(self) -> Array:
        """Return the standard parameters of the start, with fixed and dropped ones at their values."""
        simulator = self.simulator
        x = extended_start(self.job, self.method.chosen_start, simulator.direct, lambda: simulator.delay)
        beta = self.base.project(x)
        beta[[role != "estimated" for role in self.job.model.unknowns.roles]] = 0.0
        x = self.base.lift(beta + self.job.model.unknowns.values)
        unloaded = x[: len(self.robot.parameter_names)]
        smallest = _core.smallest_eigenvalue(self.robot.core, simulator.reference_positions(), unloaded)
        if smallest is not None and not smallest[1] > 0.0:
            raise self.no_start(
                f"M(q) is not positive definite on the reference (smallest eigenvalue {smallest[1]:.3g})"
            )
        return x

    def no_start(self, reason: str) -> FitError:
        """Return the error for a start that cannot be simulated."""
        # A wrong log makes IDIM-LS wrong, which may be the start and scales the gains.
        return FitError(
            f"DIDIM cannot start from these parameters: {reason}{_first_of(self.simulator.suspicions())}"
        )

    def observe(self, iterate: Iterate) -> LinearSystem:
        """Return (7): measured torques, and the regressor along the simulated motion or with instruments from it."""
        parts = along_motion(self.simulator.windows, iterate.simulated)
        along = self._about(iterate, self.job.system(parts, self.base.project(iterate.x)))
        if not self.instrumental:
            return along
        return replace(self._about(iterate, self.measured), instruments=along.w)

    def _about(self, iterate: Iterate, system: LinearSystem) -> LinearSystem:
        """Return a system, linearised about an iterate if drive gains are unknown.

        The start contains no information on the torques, so the first system is about the estimate with its gains.
        """
        n = self.base.n_gains
        if not n:
            return system
        currents = Currents.of(system, self.job.reduction)
        values = self.job.estimated(iterate.x)
        gains = values[-n:]
        return currents.linearised(values[:-n] if iterate.iteration else currents.parameters(gains), gains)

    def solution(self, system: LinearSystem) -> Fit:
        """Solve a system with the solver of the run."""
        return self.job.solve(system)

    def solve(self, iterate: Iterate, system: LinearSystem) -> Solved:
        """Solve the system of an iterate.

        Parameters that this motion does not identify, because simulated joints stick in friction, keep the values of the
        iterate. The log is at fault only if the measured motion does not identify them either.
        """
        try:
            return self.solved(iterate, system, self.solution(system))
        except RankError as reason:
            self._blame_log()
            values = self.job.estimated(iterate.x)
            fit, unidentified = solve_partly(system, self.solution, values, reason.columns)
            self.stuck[iterate.iteration] = listing([system.names[column] for column in unidentified])
            return self.solved(iterate, system, fit, unidentified)

    def solved(self, iterate: Iterate, system: LinearSystem, fit: Fit, held: tuple[int, ...] = ()) -> Solved:
        """Return the system of an iterate with a solution that holds some columns."""
        target = self.job.lift(fit.solution) if fit.standard is None else fit.standard
        std = np.sqrt(np.diag(self.job.model.unknowns.expand_covariance(fit.covariance)))
        return Solved(iterate, system, fit, target, std, held)

    def change_in_sigma(self, solved: Solved) -> float:
        """Return the largest change of a base parameter towards the solution, in standard deviations."""
        change = np.abs(self.base.project(solved.target - solved.along.x))
        return float(quotient(change, solved.std).max(initial=0.0))

    def _blame_log(self) -> None:
        """Raise the error on the log, if its measured motion does not identify all parameters either."""
        try:
            self.simulator.direct()
        except RankError:
            raise
        except DidimError:
            return  # the measured motion is not available

    def suspected(self, system: LinearSystem, fit: Fit, *, converged: bool) -> list[Finding]:
        """Return the suspected faults of a result's torques."""
        if not converged:
            return self.simulator.suspicions()
        # With unknown gains the rows are on the motor side, and the sign of a gain is estimated.
        return torque_findings(system) if not self.base.n_gains else []

    @property
    def remarks(self) -> list[str]:
        """Sentences on the steps in time, and on contradictions of the torques."""
        return [*self.simulator.remarks, *(finding.sentence for finding in self.contradictions)]

    def evidence(self, suspected: Sequence[Finding], output_error: float) -> list[Finding]:
        """Return the findings against a result."""
        updating = self.method.gain_updating != "never"
        return [*suspected, *following_findings(output_error, updating=updating)]

    def record(self) -> dict[str, Any]:
        """Return the settings of the method and of the closed loop, for the record of a result."""
        method, experiment = self.method, self.simulator.experiment
        start = method.chosen_start if isinstance(method.chosen_start, str) else "given"
        loop = self.simulator.windows[0].loop
        return {
            method.name.replace("-", "_"): {
                "start": start,
                **{key: getattr(method, key) for key in RECORDED},
                **self._own_record(start),
            },
            "closed_loop": {
                "reference": getattr(experiment.reference, "settings", None),
                "controller": getattr(experiment.controller, "settings", None),
                "laws": loop.controller.laws.tolist(),
                "steps": loop.n_steps,
            },
        }

    def _own_record(self, start: str) -> dict[str, Any]:
        return {}


class ConsistentProblem(Problem):
    """The system with physical constraints: every iterate is a robot.

    The log along its measured motion defines the size of the prior, invented gains (from the consistent solution), and the
    conditions (B) of the largest admissible time step.
    """

    steady_within = 3.0
    most_lost = 3
    simulator: RateSimulator
    conditions: ConstrainedProblem

    def __init__(self, simulator: RateSimulator, solver: ConsistentSolver) -> None:
        super().__init__(simulator)
        job = self.job
        try:
            parts = job.parts("fit", simulator.delay)
        except DidimError:
            # Without positions the reference replaces the motion before the first simulation.
            parts = self._references()
        self.measured = job.system(parts)
        q = np.concatenate([part.q for part in parts])
        q = np.ascontiguousarray(q[:: max(1, len(q) // POSITIONS)])
        free = replace(solver, problem=solver.on(self.measured))
        direct = free(self.measured, job.settings)
        assert direct.standard is not None
        experiment = with_gains(job.experiment, direct.standard[: len(self.robot.parameter_names)], q)
        damping = damping_of(simulator.windows_of(experiment)[0].loop.controller)
        self.solver, self.direct, self.step_s = simulable(free, direct, self.measured, job.settings, damping)
        assert self.solver.problem is not None
        assert self.direct.standard is not None
        self.conditions = self.solver.problem
        simulator.prepare(experiment, q, damping, self.direct.standard)
        self.contradictions = [*torque_findings(self.measured), *contradiction_findings(diagnosis(direct))]

    def _references(self) -> list[Window]:
        return [
            window.along([values[window.kept] for values in window.loop.reference.at(window.loop.t)])
            for window in self.simulator.windows_of(self.job.experiment)
        ]

    def start(self) -> Array:
        """Return the standard parameters of the start, which belong to a robot."""
        start = self.method.chosen_start
        if isinstance(start, str) and start in STARTS:
            return self.simulator.real
        if isinstance(start, str) and start == "prior":
            return self.conditions.start
        x = self.base.extended(standard_start(self.robot, start), further_of(start))
        # The robot nearest to the start, in the units of the log.
        root = np.asarray(np.linalg.cholesky(inverse(self.direct.covariance)).T, dtype=np.float64)
        return self.conditions.solve(root, root @ self.job.estimated(x)).x

    def no_start(self, reason: str) -> FitError:
        """Return the error for a start that cannot be simulated."""
        return FitError(
            f"consistent DIDIM cannot start from these parameters: {reason}{_first_of(self.contradictions)}"
        )

    def solution(self, system: LinearSystem) -> Fit:
        """Solve a system with the constraints; an estimate with instruments is projected to the nearest robot (10)."""
        if system.instruments is None:
            return self.solver(system, self.job.settings)
        problem = self.conditions
        free = solve_with_instruments(system, self.job.settings)
        root = root_of(free.covariance)
        constrained = problem.solve(root, root @ free.solution)
        solution = np.asarray(problem.matrix @ constrained.x)
        return replace(
            free,
            solution=solution,
            residual=system.y - system.w @ solution,
            standard=constrained.x,
            record={
                "gamma": problem.gamma,
                "prior": problem.prior.name,
                "half_distance": constrained.half_distance,
                "iterations": constrained.iterations,
            },
        )

    def suspected(self, system: LinearSystem, fit: Fit, *, converged: bool) -> list[Finding]:
        """Return the suspected faults of a result's torques, unless already known."""
        return torque_findings(system) if converged and not self.contradictions else []

    def evidence(self, suspected: Sequence[Finding], output_error: float) -> list[Finding]:
        """Return the findings against a result."""
        return [
            *suspected,
            *self.contradictions,
            *following_findings(output_error),
        ]

    def _own_record(self, start: str) -> dict[str, Any]:
        return {
            "physical": True,
            "start": "consistent" if start in STARTS else start,
            "simulable_step_s": self.step_s,
        }


def with_gains(experiment: Experiment, x: Array, q: Array) -> Experiment:
    """Return the experiment with gains by rule (D) from a robot, if its controller is invented (``test_consistent_methods.py``)."""
    spec = experiment.controller
    if not isinstance(spec, ControllerSpec) or spec.settings.get("kind") != "made-up":
        return experiment
    controller = made_up(
        experiment.simulated_robot,
        x,
        q,
        frequency_hz=float(spec.settings.get("natural_frequency_hz", 10.0)),
        error=float(spec.settings.get("tracking_error", 1e-3)),
    )
    return replace(experiment, controller=ControllerSpec(MadeUpRecipe(controller), spec.settings))
