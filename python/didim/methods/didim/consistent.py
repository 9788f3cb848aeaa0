"""The problem of consistent DIDIM: every iterate is a robot, and time steps follow from the rates of each.

Tested in ``tests/test_consistent.py`` and ``tests/test_consistent_methods.py``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..._tools.arrays import Array
from ...errors import DidimError
from ...evidence.naming import torque_findings
from ...evidence.torques import contradiction_findings
from ...experiment.experiment import Experiment
from ...experiment.loop import recordings_of
from ...experiment.loop_tables import MadeUpRecipe
from ...experiment.specs import ControllerSpec
from ...loop.tuning import made_up
from ...regression.classical.instrumental import solve_with_instruments
from ...regression.consistent.diagnosis import diagnosis
from ...regression.consistent.nearest import root_of
from ...regression.consistent.solver import ConsistentSolver
from ...regression.covariance import inverse
from ...regression.fit import Fit
from ...result.iteration import Reporter
from ...signal.window import Window
from ...terms.rows import LinearSystem
from ..job import Job
from ..start import further_of, standard_start
from .problem import Problem
from .settings import DIDIMSettings
from .simulability import chosen_steps, damping_of, largest_rates, simulable

POSITIONS = 60
"""Number of positions of the log at which rates and inertias are evaluated."""
STARTS = ("consistent", "idim-ls")
"""Names of the start at the physically consistent robot nearest to the estimate of IDIM-LS, along the measured motion."""


class ConsistentProblem(Problem):
    """The system with physical constraints.

    The log along its measured motion defines the size of the prior, invented gains (from the consistent solution), and the
    conditions (B) of the largest admissible time step.

    Attributes
    ----------
    q : (n, n_dof) array
        Positions of the log at which rates and inertias are evaluated.
    damping : (n_dof,) array
        Damping gains of a continuous controller (`simulability.damping_of`).
    free : Fit
        Consistent solution along the measured motion.
    real : (p + e,) array
        Its standard parameters, with the inertias for the controller.
    """

    steady_within = 3.0
    most_lost = 3
    steps_follow_rates = True

    def __init__(self, method: DIDIMSettings, job: Job, reporter: Reporter, solver: ConsistentSolver) -> None:
        super().__init__(method, job, reporter)
        try:
            parts = job.parts("fit", self.delay)
        except DidimError:
            # Without positions the reference replaces the motion before the first simulation.
            parts = [
                window.along([values[window.kept] for values in window.loop.reference.at(window.loop.t)])
                for window in self.windows_of(job.experiment)
            ]
        self.measured = job.system(parts)
        q = np.concatenate([part.q for part in parts])
        self.q = np.ascontiguousarray(q[:: max(1, len(q) // POSITIONS)])
        free = replace(solver, problem=solver.on(self.measured))
        direct = free(self.measured, job.settings)
        assert direct.standard is not None
        own = direct.standard[: len(self.robot.parameter_names)]
        self.experiment = with_gains(job.experiment, own, self.q)
        self.damping = damping_of(self.windows_of(self.experiment)[0].loop.controller)
        self.solver, self.free, self.step_s = simulable(
            free, direct, self.measured, job.settings, self.damping
        )
        assert self.solver.problem is not None
        assert self.free.standard is not None
        self.conditions, self.real = self.solver.problem, self.free.standard
        self._prepared: dict[tuple[object, object], list[Window]] = {}
        self.choose_steps(self.real)
        self.contradictions = [*torque_findings(self.measured), *contradiction_findings(diagnosis(direct))]
        self.remarks += [finding.sentence for finding in self.contradictions]

    def experiment_at(self, x: Array) -> Experiment:
        """Return the experiment with time steps for the rates of a robot."""
        settings = self.experiment.simulation
        fitted = recordings_of(self.experiment)
        robots = np.unique([self.base.standard(x, number) for number, _ in fitted], axis=0)
        coarse, fine = chosen_steps(*largest_rates(self.robot, robots, self.q, self.damping), settings)
        return replace(self.experiment, simulation=replace(settings, step_s=coarse, fine_step_s=fine))

    def choose_steps(self, x: Array) -> None:
        """Switch to the time steps for the rates of a robot."""
        experiment = self.experiment_at(x)
        steps = experiment.simulation.step_s, experiment.simulation.fine_step_s
        if steps not in self._prepared:
            self._prepared[steps] = self.windows_of(experiment)
        self.windows = self._prepared[steps]

    def reference_positions(self) -> Array:
        """Return positions of the log."""
        return self.q

    def real_parameters(self) -> Array:
        """Return the standard parameters of the consistent solution."""
        return self.real

    def start(self) -> Array:
        """Return the standard parameters of the start, which belong to a robot."""
        start = self.method.chosen_start
        if isinstance(start, str) and start in STARTS:
            return self.real
        if isinstance(start, str) and start == "prior":
            return self.conditions.start
        x = self.base.extended(standard_start(self.robot, start), further_of(start))
        # The robot nearest to the start, in the units of the log.
        root = np.asarray(np.linalg.cholesky(inverse(self.free.covariance)).T, dtype=np.float64)
        return self.conditions.solve(root, root @ self.job.estimated(x)).x

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

    def record(self) -> dict[str, Any]:
        """Return the settings of the method and of the closed loop, for the record of a result."""
        record = super().record()
        own = record[self.method.name.replace("-", "_")]
        start = "consistent" if own["start"] in STARTS else own["start"]
        own |= {"physical": True, "start": start, "simulable_step_s": self.step_s}
        return record


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
