"""CLOE whose every iterate is a robot: the steps of Levenberg and Marquardt under physical conditions.

    x+ = argmin |e + J (B x - beta)|^2 / s^2 + damping |D (B x - beta)|^2 / s^2 + prior,   x a robot          (A)

``e`` are the weighted output errors and ``J`` their derivatives with respect to the base parameters. ``s^2`` is the variance
of the errors for as many independent rows as DIDIM has, so the prior weighs here what it weighs there: the rows of CLOE are
many times oversampled. The search starts at the estimate of consistent DIDIM, with its conditions, made-up gains and steps in
time. Tested in ``tests/test_consistent_methods.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array
from ...experiment.experiment import Experiment
from ...regression.consistent.problem import ConstrainedProblem
from ...regression.consistent.solver import CONSISTENT
from ...result.identification import Identification
from ...result.iteration import Iteration
from ...result.status import Status
from ..didim.didim import DIDIM
from ..didim.globalisation import SecantSteps
from ..didim.iterations import Iterations
from ..didim.problem import ConsistentProblem
from ..start import further_of
from ..verdict.torques import CONTRADICTIONS
from .finer_steps import corrected
from .levenberg_marquardt import DAMPINGS, MOST_ITERATIONS, spread_at, weigh_by_noise
from .output_error import OutputError
from .settings import CLOESettings

MOST_RAISES = 4
"""How often the damping is raised beyond them before the search ends."""
UNDAMPED = 1e-8
"""Damping of corrections by finer steps: each is smaller than a standard deviation or two, and needs none."""
AT_OPTIMUM = 1e-4
"""Share of the cost that the linear model promises at most at an optimum; a change of all parameters by a sigma is more."""


def search_consistently(
    method: CLOESettings,
    experiment: Experiment,
    progress: Callable[[Iteration], bool],
    say: Callable[[str], None],
) -> Identification:
    """Search from the estimate of consistent DIDIM; parameters as for `IDIMLS.run`.

    Raises
    ------
    DidimError
        One of its kinds: without a reference or a controller, or where consistent DIDIM cannot start.
    """
    shared = ("variance", "uncertainty", "blocks", "decimation_corrected", "signal", "compensate_samples")
    didim = DIDIM(
        physical=True,
        start=method.chosen_start,
        fixed=method.fixed,
        dropped=method.dropped,
        **{key: getattr(method, key) for key in shared},
    )
    robot = experiment.simulation.robot(experiment.robot)
    job = didim.job(experiment, robot)
    solver = CONSISTENT.for_logs(job.parameters, job.selection)
    consistent = ConsistentProblem(didim, job, solver, say)
    begun = Iterations(consistent, SecantSteps(consistent, say), lambda iteration: False, say).result()
    assert consistent.conditions is not None
    x = job.parameters.extended(begun.parameters, further_of(begun))
    problem = OutputError(
        replace(method, start=begun), method.job(consistent.simulator.experiment_at(x), robot), say
    )
    problem.n_simulations = begun.n_simulations
    found = _Search(problem, consistent.conditions, x, begun.n_rows, progress).result()
    asked = method.chosen_start if isinstance(method.chosen_start, str) else "given"
    settings = {
        **found.settings,
        "cloe": {**found.settings["cloe"], "start": asked, "physical": True},
        "didim": begun.settings["didim"],
        "solver": begun.settings["solver"],
    }
    remarks = begun.remarks
    if not begun.converged:
        remarks = (*remarks, f"the search starts where consistent DIDIM ended: {begun.status.value}")
    # What contradicts the torques does so wherever the search ends.
    contradictions = [
        reason for reason in begun.evidence if reason.code in CONTRADICTIONS and reason not in found.evidence
    ]
    return replace(
        found,
        settings=settings,
        remarks=(*found.remarks, *(r for r in remarks if r not in found.remarks)),
        evidence=(*found.evidence, *contradictions),
    )


class _Search:
    """One search from standard parameters, (p + e,) with those that logs have beside the robot."""

    def __init__(
        self,
        problem: OutputError,
        constrained: ConstrainedProblem,
        x: Array,
        n_rows: int,
        progress: Callable[[Iteration], bool],
    ) -> None:
        self.problem, self.constrained, self.x, self.n_rows = problem, constrained, x, n_rows
        self.progress = progress
        weigh_by_noise(problem)

    def result(self) -> Identification:
        problem, method = self.problem, self.problem.method
        point = self._point(self.x)
        every, completed = problem.errors(point[None])
        if not completed[0]:
            raise problem.no_start()
        errors = every[0]
        initial = cost = float(errors @ errors)
        history: list[Iteration] = []
        status, damping = Status.NOT_CONVERGED, 1e-3
        jacobian = problem.derivatives(point, errors)
        while len(history) < (method.max_iterations or MOST_ITERATIONS):
            scale = np.sqrt(max(0, errors.size - point.size) / cost * min(1.0, self.n_rows / errors.size))
            trials, promised = self._trials(point, errors, jacobian, damping, float(scale))
            accepted, fall, length = False, 0.0, 0.0
            for _ in range(MOST_RAISES):
                points = np.stack([self._point(x) for x in trials])
                costs = problem.costs(points)
                best = int(np.argmin(costs))
                if costs[best] < cost:
                    accepted = True
                    break
                damping *= 1e4
                trials, _ = self._trials(point, errors, jacobian, damping, float(scale))
            if accepted:
                fall = 1.0 - float(costs[best]) / cost
                length = float(np.max(np.abs(points[best] - point) / problem.scale))
                self.x, point = trials[best], points[best]
                errors = problem.errors(point[None])[0][0]
                cost = float(errors @ errors)
                damping = max(1e-12, damping * float(DAMPINGS[best]) * 3.0)
                jacobian = problem.derivatives(point, errors)
            history.append(self._entry(len(history) + 1, cost, initial, length, damping, promised))
            problem.say(
                f"iteration {len(history)}: cost per row {cost / errors.size:.6g}, promised {promised:.2g} of it, damping "
                f"{damping:.1g}, {problem.n_simulations} simulations"
            )
            stopped = self.progress(history[-1])
            if stopped or not accepted or fall <= max(method.tolerance, AT_OPTIMUM):
                # A step that was to bring much and brought nothing is no optimum.
                met = promised <= AT_OPTIMUM or (accepted and fall <= AT_OPTIMUM)
                status = Status.STOPPED if stopped else (Status.CONVERGED if met else Status.NOT_CONVERGED)
                break
        moved: float | None = None
        if status is Status.CONVERGED:

            def advance(x: Array, errors: Array) -> Array:
                share = np.sqrt(max(0, errors.size - point.size) / cost * min(1.0, self.n_rows / errors.size))
                return self._trials(self._point(x), errors, jacobian, UNDAMPED, float(share))[0][0]

            end = corrected(problem, self.x, jacobian @ jacobian.T, advance, self._point)
            if end is not None:
                problem, self.x, errors, cost, moved = (
                    end.problem,
                    end.candidate,
                    end.errors,
                    end.cost,
                    end.moved,
                )
                point = self._point(self.x)
        spread, condition, remarks = spread_at(problem, jacobian @ jacobian.T, errors, jacobian)
        fit = problem.result(
            point,
            status=status,
            history=history,
            covariance=spread.covariance,
            uncertainty=spread.uncertainty,
            condition_number=condition,
            settings={"cost": cost, "initial_cost": initial, "moved_by_finer_steps": moved},
            remarks=(*remarks, *spread.remarks),
        )
        return replace(fit, parameters=self.x[: len(problem.robot.parameter_names)])

    def _point(self, x: Array) -> Array:
        return np.asarray(self.problem.base.project(x)[self.problem.estimated])

    def _trials(
        self, point: Array, errors: Array, jacobian: Array, damping: float, scale: float
    ) -> tuple[list[Array], float]:
        """Return robots for several dampings, and the share of the cost that the linear model promises with the least."""
        n = len(point)
        triangle = np.linalg.qr(np.column_stack([jacobian.T, jacobian.T @ point - errors]), mode="r")
        size = np.linalg.norm(jacobian, axis=1)
        size = np.where(size > 0.0, size, 1.0)
        found = []
        for share in damping * DAMPINGS:
            held = np.sqrt(share) * size
            rows = np.vstack([triangle, np.column_stack([np.diag(held), held * point])])
            both = np.asarray(np.linalg.qr(scale * rows, mode="r"))
            found.append(self.constrained.solve(both[:n, :n], both[:n, n]).x)
        left = errors + jacobian.T @ (self._point(found[0]) - point)
        return found, 1.0 - float(left @ left) / float(errors @ errors)

    def _entry(
        self, number: int, cost: float, initial: float, length: float, damping: float, promised: float
    ) -> Iteration:
        return Iteration(
            iteration=number,
            relative_error=float(np.sqrt(cost / initial)) if initial > 0.0 else 0.0,
            step=length,
            more={
                "cost": cost,
                "damping": damping,
                "promised_fall": promised,
                "simulations": float(self.problem.n_simulations),
            },
        )
