"""CLOE with physical constraints: steps of Levenberg and Marquardt in which every iterate is a robot.

    x+ = argmin |e + J (B x - beta)|^2 / s^2 + damping |D (B x - beta)|^2 / s^2 + prior,   x a robot          (A)

``e`` are the weighted output errors and ``J`` their derivatives with respect to the base parameters. ``s^2`` is the variance of
the errors for the number of independent rows in DIDIM, so the prior has the same weight as there; the rows of CLOE are many
times oversampled. The search starts at the estimate of consistent DIDIM, with its conditions, invented gains and time steps.
Tested in ``tests/test_consistent_methods.py``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array, unit_diagonal
from ...evidence.torques import CONTRADICTIONS
from ...experiment.experiment import Experiment
from ...regression.consistent.problem import ConstrainedProblem
from ...result.identification import Identification
from ...result.iteration import Reporter
from ..didim.consistent import ConsistentProblem
from ..didim.didim import DIDIM
from ..didim.iterations import Iterations
from ..start import further_of
from .jacobian import Jacobian
from .levenberg_marquardt import DAMPINGS, Advance, SafeSteps
from .output_error import OutputError
from .settings import CLOESettings

NEAREST = 100.0
"""Weight of a random point beside the prior, per change that doubles the torques: the projected robot stays near the point."""
UNDAMPED = 1e-8
"""Damping of the corrections with finer steps: they are at most a standard deviation or two and need none."""
AT_OPTIMUM = 1e-4
"""Largest decrease of the cost, as a share, that the linear model predicts at an optimum: less than moving every parameter by
one sigma."""


class ConsistentSteps(SafeSteps):
    """Steps of Levenberg and Marquardt among robots; candidates are standard parameters and those of logs, (p + e,)."""

    measure = "promised_fall"
    most_raises = 4
    least_fall = AT_OPTIMUM

    def __init__(
        self, problem: OutputError, constrained: ConstrainedProblem, x: Array, begun: Identification
    ) -> None:
        super().__init__(problem)
        self.constrained, self.x, self.begun = constrained, x, begun

    def begin(self) -> Array:
        """Return the robot at the start."""
        return self.x

    def begun_near(self, target: Array) -> ConsistentSteps:
        """Return the search from the robot nearest to a point, (n,), in the units of torques."""
        root = np.diag(NEAREST / self.problem.scale)
        x = self.constrained.solve(root, root @ target).x
        problem = self.problem.begun_at(self.problem.start)
        return ConsistentSteps(problem, self.constrained, x, self.begun)

    def point(self, candidate: Array) -> Array:
        """Return the estimated base parameters of a robot."""
        return self.problem.job.estimated(candidate)

    def trials(
        self, candidate: Array, errors: Array, jacobian: Jacobian, damping: float
    ) -> tuple[list[Array], float]:
        """Return a robot for each damping, and the share of the cost by which the linear model decreases with the least damping."""
        robots = self._robots(
            self.point(candidate), errors, jacobian, damping * DAMPINGS, float(errors @ errors)
        )
        left = jacobian.changed(errors, self.point(robots[0]) - self.point(candidate))
        return robots, 1.0 - float(left @ left) / float(errors @ errors)

    def _robots(
        self, point: Array, errors: Array, jacobian: Jacobian, dampings: Array, cost: float
    ) -> list[Array]:
        n = len(point)
        scale = np.sqrt(max(0, errors.size - n) / cost * min(1.0, self.begun.n_rows / errors.size))
        triangle = jacobian.triangles(point, errors)
        _, size = unit_diagonal(jacobian.normal)
        robots = []
        for damping in dampings:
            held = np.sqrt(damping) * size
            rows = np.vstack([triangle, np.column_stack([np.diag(held), held * point])])
            both = np.asarray(np.linalg.qr(scale * rows, mode="r"))
            robots.append(self.constrained.solve(both[:n, :n], both[:n, n]).x)
        return robots

    def met(self, measure: float, fall: float, *, accepted: bool) -> bool:
        """Whether the predicted or an accepted decrease is small: a failed step with a large prediction is not an optimum."""
        return measure <= AT_OPTIMUM or (accepted and fall <= AT_OPTIMUM)

    def correction(self, jacobian: Jacobian, cost: float) -> Advance:
        """Return the undamped step among robots."""

        def advance(x: Array, errors: Array) -> Array:
            return self._robots(self.point(x), errors, jacobian, UNDAMPED * DAMPINGS[:1], cost)[0]

        return advance

    def finish(self, fit: Identification, candidate: Array) -> Identification:
        """Return the result with the robot, and with the findings of consistent DIDIM on the log."""
        begun, asked = self.begun, fit.settings["cloe"]
        remarks = begun.remarks
        if not begun.converged:
            remarks = (*remarks, f"the search starts where consistent DIDIM ended: {begun.status.value}")
        # Contradictions of the torques do not depend on the end of the search.
        contradictions = [
            reason
            for reason in begun.evidence
            if reason.code in CONTRADICTIONS and reason not in fit.evidence
        ]
        return replace(
            fit,
            parameters=candidate[: len(self.problem.robot.parameter_names)],
            settings={
                **fit.settings,
                "cloe": {**asked, "start": begun.settings["didim"]["start"], "physical": True},
                "didim": begun.settings["didim"],
                "solver": begun.settings["solver"],
            },
            remarks=(*fit.remarks, *(remark for remark in remarks if remark not in fit.remarks)),
            evidence=(*fit.evidence, *contradictions),
        )


def consistent_steps(method: CLOESettings, experiment: Experiment, reporter: Reporter) -> ConsistentSteps:
    """Return the search from the estimate of consistent DIDIM.

    Raises
    ------
    DidimError
        Any of its subclasses: without a reference or a controller, or if consistent DIDIM cannot start.
    """
    didim = DIDIM(physical=True, start=method.chosen_start, **method.shared)
    robot = experiment.simulated_robot
    job = didim.job(experiment, robot)
    iterations = Iterations(didim, job, reporter.without_iterations)
    begun, consistent = iterations.result(), iterations.problem
    assert isinstance(consistent, ConsistentProblem)
    x = job.model.extended(begun.parameters, further_of(begun))
    problem = OutputError(
        replace(method, start=begun), method.job(consistent.experiment_at(x), robot), reporter
    )
    problem.n_simulations = begun.n_simulations
    return ConsistentSteps(problem, consistent.conditions, x, begun)
