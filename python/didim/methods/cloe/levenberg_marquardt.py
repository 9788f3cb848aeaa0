"""CLOE by Levenberg and Marquardt: Gauss-Newton with damping, steps with M(q) > 0, and a covariance.

Tested in ``tests/test_cloe.py``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array, quotient, unit_diagonal
from ..._tools.words import joints_text, series
from ...errors import FitError
from ...regression.covariance import Branches, Factors, autocorrelated
from ...result.identification import Identification
from ...result.iteration import Iteration, Status
from ...signal.noise import white_noise
from ..uncertainty import Spread, spread_of_factors
from .finer_steps import corrected
from .jacobian import Jacobian
from .output_error import OutputError

DAMPINGS = np.array([1e-4, 1e-2, 1.0, 1e2])
"""Factors of the damping that are tried at once, one in each lane."""
GRADIENT = 0.03
"""Cosine between the residual and the Jacobian's columns below which the gradient counts as zero."""
SINGULAR_NORMAL_MATRIX = 1e-14
"""Smallest ratio of the extreme eigenvalues of the scaled normal matrix for it to be regular: rounding is about 1e-16."""
MOST_ITERATIONS = 100
"""Default upper bound of the iterations; the packaged experiment takes four."""
NOISE_SAMPLES = 5
"""Number of samples below which the noise is not estimated: fifth differences need more."""

Advance = Callable[[Array, Array], Array]
"""Function that corrects a candidate once, given the candidate and its errors."""


def search(steps: SafeSteps) -> Identification:
    """Search from the start of the steps, or resume from the checkpoint of their problem."""
    weigh_by_noise(steps.problem)
    run = Search(steps)
    try:
        status = run.iterate()
        run.finish(status)
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    return run.result(status)


class Search:
    """A search in progress: its candidate, with the errors, the cost and the derivatives there."""

    def __init__(self, steps: SafeSteps) -> None:
        problem = steps.problem
        self.problem, self.steps, self.checkpoint = problem, steps, problem.checkpoint
        self.candidate, self.damping, self.initial = steps.begin(), 1e-3, math.nan
        self.history: list[Iteration] = []
        self.finished = self.accepted = False
        self.shift_by_finer_steps: float | None = None
        saved = self.checkpoint.load()
        if saved is not None:
            arrays, numbers, self.history = saved
            self.candidate, self.damping, self.initial = (
                arrays["point"],
                numbers["damping"],
                numbers["initial"],
            )
            self.finished = bool(numbers["finished"])
            problem.n_simulations = numbers["simulations"]
            problem.reporter.say(f"goes on from iteration {len(self.history)} of {problem.method.checkpoint}")
        self.point = steps.point(self.candidate)
        errors, completed = problem.errors(self.point[None])
        if not completed[0]:
            raise problem.no_start()
        self.errors = errors[0]
        self.initial = self.cost if math.isnan(self.initial) else self.initial
        self.jacobian: Jacobian | None = None

    @property
    def cost(self) -> float:
        """Sum of squares of the errors."""
        return float(self.errors @ self.errors)

    def iterate(self) -> Status:
        """Step until an optimum, the largest number of iterations or the callback ends the search."""
        if self.finished:  # a finished search is not continued
            return Status.CONVERGED
        problem, steps = self.problem, self.steps
        begin, done_before = time.monotonic(), len(self.history)
        most = problem.method.max_iterations or MOST_ITERATIONS
        for number in range(done_before + 1, most + 1):
            measure, fall, length = self.step()
            self.history.append(self._entry(number, measure, length))
            each = (time.monotonic() - begin) / (number - done_before)
            problem.reporter.say(
                f"iteration {number}: cost per row {self.cost / self.errors.size:.6g}, "
                f"{steps.measure.replace('_', ' ')} {measure:.2g}, damping {self.damping:.1g}, "
                f"{problem.n_simulations} simulations; {each:.2g} s an iteration, at most {each * (most - number):.0f} s left"
            )
            ended = not self.accepted or fall <= max(problem.method.tolerance, steps.least_fall)
            # (20) alone would also hold if the damping suppressed all steps.
            converged = ended and steps.met(measure, fall, accepted=self.accepted)
            state = {
                "damping": self.damping,
                "initial": self.initial,
                "simulations": problem.n_simulations,
                "finished": converged,
            }
            self.checkpoint.save({"point": self.candidate}, state, self.history)
            if problem.reporter.progress(self.history[-1]):
                return Status.STOPPED
            if ended:
                return Status.CONVERGED if converged else Status.NOT_CONVERGED
        return Status.NOT_CONVERGED

    def step(self) -> tuple[float, float, float]:
        """Make a damped step; return the measure of optimality, and the relative decrease and the step, zero without one."""
        self.jacobian = jacobian = self.problem.derivatives(self.point, self.errors)
        self.accepted = False
        trials, measure = self.steps.trials(self.candidate, self.errors, jacobian, self.damping)
        for raised in range(self.steps.most_raises):
            if raised:
                trials, _ = self.steps.trials(self.candidate, self.errors, jacobian, self.damping)
            points = np.stack([self.steps.point(trial) for trial in trials])
            costs = self.problem.costs(points)
            best = int(np.argmin(costs))
            if costs[best] < self.cost:
                break
            self.damping *= 1e4
        else:
            return measure, 0.0, 0.0
        self.accepted = True
        fall = 1.0 - float(costs[best]) / self.cost
        length = float(np.max(np.abs(points[best] - self.point) / self.problem.scale))
        self.candidate, self.point = trials[best], points[best]
        self.errors = self.problem.errors(self.point[None])[0][0]
        self.damping = max(1e-12, self.damping * float(DAMPINGS[best]) * 3.0)
        return measure, fall, length

    def finish(self, status: Status) -> None:
        """Take the derivatives at the end, and correct a converged search for the steps in time."""
        if self.jacobian is None or (self.accepted and status is not Status.STOPPED):
            self.jacobian = self.problem.derivatives(self.point, self.errors)
        if status is not Status.CONVERGED:
            return
        advance = self.steps.correction(self.jacobian, self.cost)
        if advance is None:
            return
        end = corrected(self.problem, self.candidate, self.jacobian.normal, advance, self.steps.point)
        if end is not None:
            self.problem, self.candidate, self.errors, self.shift_by_finer_steps = end

    def result(self, status: Status) -> Identification:
        """Return the result at the last candidate."""
        problem = self.problem
        spread, condition = spread_at(problem, self.errors, self.jacobian)
        if math.isinf(condition) and status is Status.CONVERGED:
            status = Status.ILL_CONDITIONED
        positions = problem.weights.get("q")
        fit = problem.result(
            self.steps.point(self.candidate),
            status=status,
            history=self.history,
            spread=spread,
            condition_number=condition,
            settings={
                "noise_position": None if positions is None else (1.0 / np.sqrt(positions)).tolist(),
                "cost": self.cost,
                "initial_cost": self.initial,
                "moved_by_finer_steps": self.shift_by_finer_steps,
            },
        )
        return self.steps.finish(fit, self.candidate)

    def _entry(self, number: int, measure: float, length: float) -> Iteration:
        return Iteration(
            iteration=number,
            relative_error=math.sqrt(self.cost / self.initial) if self.initial > 0.0 else 0.0,
            step=length,
            more={
                "cost": self.cost,
                "cost_per_row": self.cost / max(1, self.errors.size - self.point.size),
                "damping": self.damping,
                self.steps.measure: measure,
                "simulations": float(self.problem.n_simulations),
            },
        )


class SafeSteps:
    """Candidates of a search, and its test of convergence: damped Gauss-Newton steps, shortened until M(q) is positive definite.

    Candidates are points here, (n,).

    Attributes
    ----------
    measure : str
        Name, in the history, of the number that tests for an optimum.
    most_raises : int
        Number of times that the damping is raised beyond `DAMPINGS` before the search ends.
    least_fall : float
        Relative decrease of the cost at which the search ends, whatever the tolerance.
    """

    measure = "gradient_cosine"
    most_raises = 8
    least_fall = 0.0

    def __init__(self, problem: OutputError) -> None:
        self.problem = problem

    def begin(self) -> Array:
        """Return the candidate at the start."""
        return self.problem.start

    def begun_near(self, target: Array) -> SafeSteps:
        """Return the search from another point, (n,)."""
        return SafeSteps(self.problem.begun_at(target))

    def point(self, candidate: Array) -> Array:
        """Return the estimated base parameters of a candidate, (n,)."""
        return candidate

    def trials(
        self, candidate: Array, errors: Array, jacobian: Jacobian, damping: float
    ) -> tuple[list[Array], float]:
        """Return a candidate for each of `DAMPINGS`, and the measure: the largest cosine of the errors and a derivative."""
        _, size = unit_diagonal(jacobian.normal)
        cosines = quotient(np.abs(jacobian.gradient(errors)), size * np.linalg.norm(errors))
        trials = self._moved(candidate, errors, jacobian, damping * DAMPINGS)
        return trials, float(np.max(cosines))

    def met(self, measure: float, fall: float, *, accepted: bool) -> bool:
        """Whether the search has ended at an optimum: the gradient is zero."""
        return measure <= GRADIENT

    def correction(self, jacobian: Jacobian, cost: float) -> Advance | None:
        """Return the undamped step with given errors (`finer_steps.corrected`); None if the outputs do not determine it."""

        def advance(point: Array, errors: Array) -> Array:
            return self._moved(point, errors, jacobian, np.zeros(1))[0]

        return advance if identifies(jacobian.normal) else None

    def finish(self, fit: Identification, candidate: Array) -> Identification:
        """Return the result at a candidate."""
        return fit

    def _moved(self, point: Array, errors: Array, jacobian: Jacobian, dampings: Array) -> list[Array]:
        """Return the point after a step with each damping, shortened until M(q) is positive definite."""
        scaled, size = unit_diagonal(jacobian.normal)
        slope, moved = jacobian.gradient(errors) / size, []
        for damping in dampings:
            step = np.linalg.solve(scaled + damping * np.eye(point.size), -slope) / size
            moved.append(point + self.problem.safe_share(point, point + step) * step)
        return moved


def weigh_by_noise(problem: OutputError) -> None:
    """Weight outputs by the given or estimated noise of their measurements."""
    method = problem.method
    q = np.concatenate([window.measured for window in problem.windows])
    if len(q) <= NOISE_SAMPLES:
        raise FitError(
            f"{problem.job.experiment.name}: CLOE estimates the noise from more than {NOISE_SAMPLES} samples, got {len(q)}"
        )
    if "q" in problem.weights:
        noise = white_noise(q) if method.noise is None else np.asarray(method.noise, dtype=np.float64)
        if noise.shape != (problem.robot.n_dof,):
            raise FitError(
                f"noise needs {problem.robot.n_dof} positive numbers, one per joint, got {method.noise!r}"
            )
        problem.weights["q"] = 1.0 / noise**2
    if "tau" in problem.weights:
        tau = np.concatenate([window.logged for window in problem.windows])
        problem.weights["tau"] = 1.0 / white_noise(tau) ** 2


def _eigen(normal: Array) -> tuple[Array, Array, Array]:
    """Return the lengths of the derivatives, and eigenvalues and eigenvectors of the normal matrix of unit derivatives."""
    scaled, size = unit_diagonal(normal)
    return size, *np.linalg.eigh(scaled)


def identifies(normal: Array) -> bool:
    """Return whether the outputs identify every combination of the parameters."""
    _, values, _ = _eigen(normal)
    return bool(values[0] > SINGULAR_NORMAL_MATRIX * values[-1])


def spread_at(problem: OutputError, errors: Array, jacobian: Jacobian | None) -> tuple[Spread, float]:
    """Return the spread of the estimate, and the condition number of the scaled columns.

    The covariance is that of the linear problem with the last Jacobian, without another simulation. It includes the correlation
    of the output errors and, unless the settings say otherwise, the variances of the jackknife.
    """
    names = [problem.base.unknowns.names[index] for index in problem.estimated]
    empty = np.zeros((len(names), len(names)))
    if jacobian is None:
        remark = "stopped before the Jacobian was computed, so there are no standard deviations"
        return Spread(empty, None, (remark,)), math.inf
    scaled = [_eigen(part.normal) for part in jacobian.parts]
    worst = min(range(len(scaled)), key=lambda k: scaled[k][1][0])
    least, largest = scaled[worst][1][0], max(values[-1] for _, values, _ in scaled)
    if least <= SINGULAR_NORMAL_MATRIX * largest:
        weak = jacobian.parts[worst].columns[np.abs(scaled[worst][2][:, 0]) > 0.1]
        hardly = series((names[k] for k in weak), 90)
        remark = f"the outputs hardly identify {hardly}: there are no standard deviations; fix or drop one"
        return Spread(empty, None, (remark,)), math.inf
    blocks, correlated = problem.blocks(), list[int]()
    covariance, roots, factors = empty.copy(), empty.copy(), []
    for part, (size, values, vectors) in zip(jacobian.parts, scaled, strict=True):
        own, square = part.errors(errors), np.ix_(part.columns, part.columns)
        inverse = (vectors / values) @ vectors.T / np.outer(size, size)
        covariance[square], lasting = autocorrelated(part.slopes.T, own, part.blocks(blocks), inverse)
        correlated += lasting
        roots[square] = root = (vectors / np.sqrt(values)) / size[:, None]
        q = part.slopes.T @ root
        factors.append((part.rows, part.columns, Factors(q, q, root, -own)))
    spread = spread_of_factors(
        Branches(factors, roots, -errors),
        covariance,
        "correlated",
        blocks,
        problem.job.settings,
        problem.job.model.unknowns,
        names,
    )
    if correlated:
        joints = joints_text(sorted(set(correlated)))
        remark = (
            f"the output errors of {joints} are correlated in time: they are model error more than noise; the standard deviations "
            "include the correlation, but no bias"
        )
        spread = replace(spread, remarks=(remark, *spread.remarks))
    return spread, float(np.sqrt(largest / least))
