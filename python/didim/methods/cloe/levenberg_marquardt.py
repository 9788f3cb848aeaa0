"""CLOE by Levenberg and Marquardt: Gauss-Newton with damping, a step that keeps M(q) > 0, and a covariance.

Tested in ``tests/test_cloe.py``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...regression.covariance import autocorrelated
from ...regression.jackknife import Factors
from ...result.identification import Identification
from ...result.iteration import Iteration
from ...result.status import Status
from ...signal.noise import white_noise
from ..uncertainty import Spread, spread_of_factors
from .finer_steps import corrected
from .output_error import OutputError

DAMPINGS = np.array([1e-4, 1e-2, 1.0, 1e2])
"""Factors of the damping that are tried at once, one in each lane."""
GRADIENT = 0.03
"""Cosine of the residual and the derivatives below which the gradient counts as zero."""
SINGULAR_NORMAL_MATRIX = 1e-14
"""Largest ratio of the extreme eigenvalues of the scaled normal matrix that counts as singular: rounding is about 1e-16 of it."""
MOST_ITERATIONS = 100
"""Default upper bound of the iterations; the packaged experiment takes four."""
NOISE_SAMPLES = 5
"""Fifth differences need more samples than these."""


def search(problem: OutputError, progress: Callable[[Iteration], bool]) -> Identification:
    """Search to the end from the problem's start, or from where its checkpoint has it."""
    method = problem.method
    weigh_by_noise(problem)
    point, damping, history, initial = problem.start, 1e-3, list[Iteration](), math.nan
    checkpoint = problem.checkpoint()
    found = checkpoint.load()
    if found is not None:
        arrays, numbers, history = found
        point, damping, initial = arrays["point"], numbers["damping"], numbers["initial"]
        problem.n_simulations = numbers["simulations"]
        problem.say(f"goes on from iteration {len(history)} of {method.checkpoint}")
    every, completed = problem.errors(point[None])
    if not completed[0]:
        raise problem.no_start()
    errors = every[0]
    cost = float(errors @ errors)
    initial = cost if math.isnan(initial) else initial
    # A search that has ended stays where it is.
    finished = found is not None and numbers["finished"]
    status = Status.CONVERGED if finished else Status.NOT_CONVERGED
    normal = np.eye(point.size)
    jacobian: Array | None = None
    accepted, moved = False, None
    most, begin, done_before = method.max_iterations or MOST_ITERATIONS, time.monotonic(), len(history)
    try:
        for number in range(len(history) + 1, len(history) if finished else most + 1):
            jacobian = problem.derivatives(point, errors)
            normal, gradient = jacobian @ jacobian.T, jacobian @ errors
            diagonal = np.diag(normal).copy()
            diagonal[diagonal == 0.0] = 1.0
            cosine = float(np.max(np.abs(gradient) / np.sqrt(diagonal * cost))) if cost > 0.0 else 0.0
            accepted = False
            step_length, fall = 0.0, 0.0
            for _ in range(8):
                trials = _trials(problem, point, normal, gradient, diagonal, damping * DAMPINGS)
                costs = problem.costs(trials)
                best = int(np.argmin(costs))
                if costs[best] < cost:
                    accepted = True
                    break
                damping *= 1e4
            if accepted:
                fall = 1.0 - costs[best] / cost
                step_length = float(np.max(np.abs(trials[best] - point) / problem.scale))
                point = trials[best]
                errors = problem.errors(point[None])[0][0]
                cost = float(errors @ errors)
                damping = max(1e-12, damping * float(DAMPINGS[best]) * 3.0)
            history.append(
                Iteration(
                    iteration=number,
                    relative_error=math.sqrt(cost / initial) if initial > 0.0 else 0.0,
                    step=step_length,
                    more={
                        "cost": cost,
                        "cost_per_row": cost / max(1, errors.size - point.size),
                        "damping": damping,
                        "gradient_cosine": cosine,
                        "simulations": float(problem.n_simulations),
                    },
                )
            )
            each = (time.monotonic() - begin) / (number - done_before)
            problem.say(
                f"iteration {number}: cost per row {cost / errors.size:.6g}, gradient {cosine:.2g}, damping {damping:.1g}, "
                f"{problem.n_simulations} simulations; {each:.2g} s an iteration, at most {each * (most - number):.0f} s left"
            )
            ended = not accepted or fall <= method.tolerance
            # (20) alone would also be met where the damping has taken all steps away.
            converged = bool(ended and cosine <= GRADIENT)
            state = {
                "damping": damping,
                "initial": initial,
                "simulations": problem.n_simulations,
                "finished": converged,
            }
            checkpoint.save({"point": point}, state, history)
            if progress(history[-1]):
                status = Status.STOPPED
                break
            if ended:
                status = Status.CONVERGED if converged else Status.NOT_CONVERGED
                break
        if jacobian is None or (accepted and status is not Status.STOPPED):
            jacobian = problem.derivatives(point, errors)
            normal = jacobian @ jacobian.T
        if status is Status.CONVERGED and identifies(normal):
            end = corrected(problem, point, normal, partial(_correction, problem, jacobian), lambda at: at)
            if end is not None:
                problem, point, errors, cost, moved = (
                    end.problem,
                    end.candidate,
                    end.errors,
                    end.cost,
                    end.moved,
                )
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    spread, condition, remarks = spread_at(problem, normal, errors, jacobian)
    if math.isinf(condition) and status is Status.CONVERGED:
        status = Status.ILL_CONDITIONED
    return problem.result(
        point,
        status=status,
        history=history,
        covariance=spread.covariance,
        uncertainty=spread.uncertainty,
        condition_number=condition,
        settings={
            "noise_position": (1.0 / np.sqrt(problem.weight_q)).tolist() if problem.weight_q.all() else None,
            "cost": cost,
            "initial_cost": initial,
            "moved_by_finer_steps": moved,
        },
        remarks=(*remarks, *spread.remarks),
    )


def weigh_by_noise(problem: OutputError) -> None:
    """Weight outputs by the noise of their measurements, given or estimated."""
    method = problem.method
    q = np.concatenate([window.q for window in problem.windows])
    if len(q) <= NOISE_SAMPLES:
        raise FitError(
            f"{problem.job.experiment.name}: CLOE estimates the noise from more than {NOISE_SAMPLES} samples, got {len(q)}"
        )
    if method.output in ("position", "both"):
        noise = white_noise(q) if method.noise is None else np.asarray(method.noise, dtype=np.float64)
        if noise.shape != (problem.robot.n_dof,):
            raise FitError(
                f"noise needs {problem.robot.n_dof} positive numbers, one per joint, got {method.noise!r}"
            )
        problem.weight_q = 1.0 / noise**2
    if method.output in ("torque", "both"):
        tau = np.concatenate([window.tau for window in problem.windows])
        problem.weight_tau = 1.0 / white_noise(tau) ** 2


def _trials(
    problem: OutputError, point: Array, normal: Array, gradient: Array, diagonal: Array, dampings: Array
) -> Array:
    """Return points for several dampings, each kept where M(q) is positive definite."""
    size = np.sqrt(diagonal)
    scaled = normal / np.outer(size, size)
    trials = []
    for damping in dampings:
        step = np.linalg.solve(scaled + damping * np.eye(point.size), -gradient / size) / size
        share = problem.safe_share(point, point + step)
        trials.append(point + share * step)
    return np.stack(trials)


def _correction(problem: OutputError, jacobian: Array, point: Array, errors: Array) -> Array:
    """Return a point after an undamped step with given errors, kept where M(q) is positive definite."""
    normal = jacobian @ jacobian.T
    diagonal = np.where(np.diag(normal) > 0.0, np.diag(normal), 1.0)
    return np.asarray(_trials(problem, point, normal, jacobian @ errors, diagonal, np.zeros(1))[0])


def _scaled(normal: Array) -> tuple[Array, Array, Array]:
    """Return the lengths of the derivatives, and eigenvalues and eigenvectors of the normal matrix of unit derivatives."""
    size = np.sqrt(np.where(np.diag(normal) > 0.0, np.diag(normal), 1.0))
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    return size, values, vectors


def identifies(normal: Array) -> bool:
    """Return whether the outputs identify every combination of the parameters."""
    _, values, _ = _scaled(normal)
    return bool(values[0] > SINGULAR_NORMAL_MATRIX * values[-1])


def spread_at(
    problem: OutputError, normal: Array, errors: Array, jacobian: Array | None
) -> tuple[Spread, float, list[str]]:
    """Return the spread of the estimate, the condition number of the scaled columns, and remarks.

    The covariance is that of the correlation which the output errors show, with the variances of the jackknife unless the settings
    say otherwise: of the linear problem with the last Jacobian, without another simulation.
    """
    nothing = Spread(np.zeros_like(normal), None)
    if jacobian is None:
        return (
            nothing,
            math.inf,
            ["stopped before the Jacobian was computed, so there are no standard deviations"],
        )
    size, values, vectors = _scaled(normal)
    if values[0] <= SINGULAR_NORMAL_MATRIX * values[-1]:
        names = [problem.base.names[index] for index in problem.estimated]
        hardly = ", ".join(names[k] for k in np.flatnonzero(np.abs(vectors[:, 0]) > 0.1))
        told = f"the outputs hardly identify {hardly}: there are no standard deviations; fix or drop one"
        return nothing, math.inf, [told]
    inverse = (vectors / values) @ vectors.T / np.outer(size, size)
    blocks = problem.blocks()
    covariance, correlated = autocorrelated(jacobian.T, errors, blocks, inverse)
    root = (vectors / np.sqrt(values)) / size[:, None]
    q = jacobian.T @ root
    spread = spread_of_factors(
        Factors(q, q, root, -errors),
        covariance,
        "correlated",
        blocks,
        problem.job.settings,
        problem.job.selection,
        [problem.base.names[index] for index in problem.estimated],
    )
    remarks = []
    if correlated:
        joints = ", ".join(str(joint + 1) for joint in sorted(set(correlated)))
        remarks.append(
            f"the output errors of joint {joints} are correlated in time: they are model error more than noise; the standard "
            "deviations take the correlation into account, and no bias"
        )
    return spread, float(np.sqrt(values[-1] / values[0])), remarks
