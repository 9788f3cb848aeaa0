"""CLOE: closed-loop output error, criterion (19), by the simplex of the paper and by Levenberg and Marquardt.

The closed loop is simulated with candidate parameters, many at once in the lanes of vector registers; the cost is the
sum of squared differences between simulated and measured positions (CLOE), torques (CLIE, closed-loop input error), or
both. Tested in ``tests/test_cloe.py``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from . import _core, nelder_mead
from .closed_loop import closed_loop
from .errors import FitError
from .fitting import FitSettings, Job, digests, ratio, ratios
from .identification import Identification, Iteration
from .idim_ls import IDIMLS
from .model import regressor
from .physics import physical_flags
from .signals import white_noise
from .simulation import ClosedLoop
from .starts import Start, standard_start
from .status import Status

if TYPE_CHECKING:
    from .experiment import Experiment

Array = NDArray[np.float64]
Optimizer = Literal["levenberg-marquardt", "nelder-mead"]
Output = Literal["position", "torque", "both"]
Variant = Literal["scaled", "adaptive", "literal"]

DIFFERENCE = 1e-4
"""Parameter step of a derivative: what changes the torques by this share of their size."""
EDGE = 0.1
"""Edge of a scaled simplex, likewise."""
DAMPINGS = np.array([1e-4, 1e-2, 1.0, 1e2])
"""Factors of the damping that are tried at once, one in each lane."""
CHECKED_POSITIONS = 200
"""Positions at which M(q) is kept positive definite."""
GRADIENT = 1e-3
"""Cosine of the residual and the derivatives below which the gradient counts as zero."""


@dataclass(frozen=True, kw_only=True)
class CLOE:
    """Settings of CLOE.

    Parameters
    ----------
    optimizer : {"levenberg-marquardt", "nelder-mead"}
        Gauss-Newton steps with damping, a covariance included; or the paper's simplex.
    output : {"position", "torque", "both"}
        What is compared: positions (19), torques, or both.
    start : str, mapping, array or Identification
        Initial parameters (`didim.starts.standard_start`); "apriori" is (21), "idim-ls" the estimate of IDIM-LS.
    max_iterations : int, optional
        100 for Levenberg-Marquardt, 200 per parameter for the simplex.
    max_evaluations : int, optional
        Of the simplex; 200 per parameter.
    variant : {"adaptive", "scaled", "literal"}
        Of the simplex. Literal: ``fminsearch`` as it is, first edges of 5 % or 0.00025, coefficients 1, 2, 1/2, 1/2. Scaled:
        first edges that change the torques by a tenth of their size. Adaptive: those, and the coefficients of Gao and
        Han (2012). The last two restart with smaller edges from the best point when the simplex has collapsed.
    tolerance : float
        Levenberg-Marquardt stops when the cost falls by less than this share (20).
    noise : sequence of float, optional
        Standard deviation of the measured positions per joint (rad or m): weights of Levenberg-Marquardt. Estimated from
        fifth differences of the measured positions by default; for torques, from the residual.
    fixed, dropped : mapping, sequence, optional
        As in `FitSettings`.
    threads : int, optional
        All cores by default.

    Raises
    ------
    FitError
        For a value out of its range.
    """

    optimizer: Optimizer = "levenberg-marquardt"
    output: Output = "position"
    start: Start = "apriori"
    max_iterations: int | None = None
    max_evaluations: int | None = None
    variant: Variant = "adaptive"
    tolerance: float = 1e-6
    noise: Sequence[float] | None = None
    fixed: dict[str, float] | None = None
    dropped: Sequence[str] | None = None
    threads: int | None = None

    kind: ClassVar[str] = "cloe"

    @property
    def name(self) -> str:
        """Name in results: "cloe-nelder-mead" or "cloe-levenberg-marquardt", "clie-..." on torques."""
        return f"{'clie' if self.output == 'torque' else 'cloe'}-{self.optimizer}"

    def __post_init__(self) -> None:
        for key, known in (
            ("optimizer", ("levenberg-marquardt", "nelder-mead")),
            ("output", ("position", "torque", "both")),
            ("variant", ("adaptive", "scaled", "literal")),
        ):
            if getattr(self, key) not in known:
                raise FitError(f"{key} must be one of {', '.join(known)}, got {getattr(self, key)!r}")
        for key in ("max_iterations", "max_evaluations"):
            value = getattr(self, key)
            if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 1):
                raise FitError(f"{key} must be a whole number of at least 1, got {value!r}")
        if not 0.0 <= self.tolerance < 1.0:
            raise FitError(f"tolerance must be at least 0 and below 1, got {self.tolerance!r}")

    def run(
        self,
        experiment: Experiment,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> Identification:
        """Identify the parameters of an experiment's robot; parameters as for `IDIMLS.run`.

        Ctrl-C ends the search with the best point so far.

        Raises
        ------
        DidimError
            One of its kinds: without a reference or a controller, or for a start with which the robot cannot be simulated.
        """
        settings = FitSettings(fixed=self.fixed, dropped=self.dropped)
        job = settings.job(experiment, experiment.simulation.robot(experiment.robot))
        problem = _Problem(self, job, say)
        if self.optimizer == "nelder-mead":
            return _simplex(problem, progress)
        return _levenberg_marquardt(problem, progress)


@dataclass(frozen=True)
class _Window:
    loop: ClosedLoop
    q: Array
    tau: Array
    kept: slice


class _Problem:
    """The cost of candidates, and their outputs."""

    def __init__(self, method: CLOE, job: Job, say: Callable[[str], None]) -> None:
        self.method, self.job, self.say = method, job, say
        self.robot, self.base = job.robot, job.robot.base_parameters
        self.estimated = job.selection.estimated
        self.windows = _windows(job, method.output)
        self.n_simulations = 0
        self.start = self._start()
        self.scale = self._scale()
        n = self.robot.n_dof
        self.weight_q, self.weight_tau = np.zeros(n), np.zeros(n)
        if method.output in ("position", "both"):
            self.weight_q[:] = 1.0
        if method.output in ("torque", "both"):
            self.weight_tau[:] = 1.0

    def standard(self, points: Array) -> Array:
        """Return standard parameters of (m, n_estimated) points."""
        beta = np.tile(self.job.selection.values, (len(points), 1))
        beta[:, self.estimated] = points
        return np.ascontiguousarray([self.base.lift(row) for row in beta])

    def costs(self, points: Array) -> Array:
        """Return sums of weighted squared errors, (m,); infinite where a run ends early or a point is no number."""
        total = np.zeros(len(points))
        good = np.isfinite(points).all(axis=1)
        total[~good] = np.inf
        if good.any():
            x = self.standard(points[good])
            for window in self.windows:
                found, _ = window.loop.costs(
                    x,
                    window.q,
                    window.tau,
                    weight_q=self.weight_q,
                    weight_tau=self.weight_tau,
                    threads=self.method.threads,
                )
                total[good] += np.where(np.isnan(found), np.inf, found)
        self.n_simulations += len(points)
        return total

    def outputs(self, points: Array) -> tuple[Array, Array]:
        """Weighted errors of points, (m, n_rows), and which runs completed."""
        x = self.standard(points)
        rows, completed = [], np.ones(len(points), dtype=bool)
        root_q, root_tau = np.sqrt(self.weight_q), np.sqrt(self.weight_tau)
        for window in self.windows:
            (q, _, _, tau), outcomes = window.loop.run(x, threads=self.method.threads)
            completed &= np.array([outcome.completed for outcome in outcomes])
            if root_q.any():
                rows.append(((q - window.q) * root_q).reshape(len(points), -1))
            if root_tau.any():
                rows.append(((tau - window.tau) * root_tau).reshape(len(points), -1))
        self.n_simulations += len(points)
        return np.concatenate(rows, axis=1), completed

    def safe_share(self, point: Array, target: Array) -> float:
        """Return the share of the way to a target that keeps M(q) positive definite."""
        q = np.concatenate([window.q for window in self.windows])
        q = np.ascontiguousarray(q[:: max(1, len(q) // CHECKED_POSITIONS)])
        x, y = self.standard(np.stack([point, target]))
        if _core.largest_safe_step(self.robot.core, q, x, y, 1e-3) == 1.0:
            return 1.0
        return float(_core.largest_safe_step(self.robot.core, q, x, y, 0.1))

    def _start(self) -> Array:
        start = self.method.start
        if isinstance(start, str) and start == "idim-ls":
            idim = IDIMLS(fixed=self.method.fixed, dropped=self.method.dropped)
            x = idim.run(self.job.experiment, lambda iteration: False, self.say).parameters
        else:
            x = standard_start(self.robot, start)
        return np.asarray(self.base.project(x)[self.estimated])

    def _scale(self) -> Array:
        """Change of each parameter that changes the torques, along the reference, by as much as they are large."""
        columns = [self.base.indices[index] for index in self.estimated]
        squares, sizes = np.zeros((self.robot.n_dof, len(columns))), np.zeros(self.robot.n_dof)
        for window in self.windows:
            t = window.loop.t[:: max(1, window.loop.n_records // 2000)]
            w = regressor(self.robot, *window.loop.motion.at(t))[:, :, columns]
            squares += np.mean(w**2, axis=0)
            sizes += np.mean(window.tau**2, axis=0)
        share = np.sqrt(np.sum(squares / np.where(sizes > 0.0, sizes, 1.0)[:, None], axis=0))
        return 1.0 / np.where(share > 0.0, share, 1.0)

    def result(
        self,
        point: Array,
        *,
        status: Status,
        history: Sequence[Iteration],
        covariance: Array,
        condition_number: float,
        settings: dict[str, Any],
        remarks: Sequence[str] = (),
    ) -> Identification:
        """Put together the result at a point, with the errors of the simulated torques there."""
        x = self.standard(point[None])[0]
        beta = self.base.project(x)
        errors_tau, sizes = np.zeros(self.robot.n_dof), np.zeros(self.robot.n_dof)
        positions, n_rows, cost = [], 0, 0.0
        for window in self.windows:
            (q, _, _, tau), _ = window.loop.run(x[None], threads=self.method.threads)
            errors_tau += np.sum((tau[0] - window.tau)[window.kept] ** 2, axis=0)
            sizes += np.sum(window.tau[window.kept] ** 2, axis=0)
            cost += float(np.sum((q[0] - window.q) ** 2))
            positions.append(q[0])
            n_rows += q[0].size
        self.n_simulations += len(self.windows)
        full = self.job.selection.expand_covariance(covariance)
        everything = np.concatenate(positions)
        norm = float(np.sqrt(errors_tau.sum()))
        return Identification(
            name=self.job.experiment.name,
            robot=self.robot.name,
            method=self.method.name,
            status=status,
            names=self.base.names,
            units=self.base.units,
            roles=self.job.selection.roles,
            beta=beta,
            covariance=full,
            parameter_names=self.robot.parameter_names,
            parameters=self.base.lift(beta),
            relative_error=ratios(np.sqrt(errors_tau), np.sqrt(sizes)),
            overall_relative_error=ratio(np.sqrt(errors_tau.sum()), np.sqrt(sizes.sum())),
            error_norm=norm,
            error_std=norm / math.sqrt(max(1, n_rows - len(self.estimated))),
            condition_number=condition_number,
            n_rows=n_rows,
            n_simulations=self.n_simulations,
            history=tuple(history),
            warnings=physical_flags(
                self.robot, beta, np.sqrt(np.diag(full)), everything[:: max(1, len(everything) // 2000)]
            ),
            remarks=tuple(remarks),
            settings=self.job.record(cloe={**settings, "position_error_norm": math.sqrt(cost)}),
            digests=digests(self.job.experiment),
        )

    def settings(self) -> dict[str, Any]:
        """Return what was asked for."""
        asked = asdict(replace(self.method, start="unit"))
        asked["start"] = self.method.start if isinstance(self.method.start, str) else "given"
        return asked


def _windows(job: Job, output: Output) -> list[_Window]:
    experiment = job.experiment
    found = []
    for recording in experiment.recordings:
        if recording.role != "fit":
            continue
        if recording.tau is None and output != "position":
            raise FitError(f"recording '{recording.name}' has no torques, which output {output!r} needs")
        for start, stop in recording.windows:
            loop = closed_loop(experiment, recording, (start, stop))
            q = np.ascontiguousarray(recording.q[start:stop])
            tau = (
                np.zeros_like(q) if recording.tau is None else np.ascontiguousarray(recording.tau[start:stop])
            )
            kept = slice(job.signal.trim_start, len(q) - job.signal.trim_end)
            found.append(_Window(loop, q, tau, kept))
    if not found:
        raise FitError(f"experiment '{experiment.name}' has no recording with role 'fit'")
    return found


def _simplex(problem: _Problem, progress: Callable[[Iteration], bool]) -> Identification:
    method = problem.method
    n = problem.start.size
    most_iterations, most_evaluations = method.max_iterations or 200 * n, method.max_evaluations or 200 * n
    history: list[Iteration] = []
    begin = time.monotonic()
    stopped = False

    def batch(points: Array) -> Array:
        return np.sqrt(problem.costs(points))

    first = (
        nelder_mead.literal_simplex(problem.start)
        if method.variant == "literal"
        else nelder_mead.edged_simplex(problem.start, EDGE * problem.scale)
    )
    simplex = nelder_mead.start(batch, first)
    initial = float(batch(problem.start[None])[0])
    if not math.isfinite(initial):
        raise FitError("CLOE cannot start from these parameters: the robot cannot be simulated with them")

    def told(now: nelder_mead.Simplex) -> bool:
        nonlocal stopped, simplex
        simplex = now
        if now.iterations % 100 and now.iterations + 1 < most_iterations:
            return False
        share = max(now.iterations / most_iterations, now.evaluations / most_evaluations)
        left = (time.monotonic() - begin) * (1.0 / share - 1.0)
        problem.say(
            f"iteration {now.iterations}, {now.evaluations} evaluations: norm {now.values[0]:.6g} of {initial:.4g}; "
            f"at most {left:.0f} s left"
        )
        history.append(
            Iteration(
                iteration=now.iterations,
                relative_error=now.values[0] / initial,
                step=float(np.max(np.abs(now.points[1:] - now.points[0]) / problem.scale)),
                more={"norm": float(now.values[0]), "evaluations": float(now.evaluations)},
            )
        )
        stopped = progress(history[-1])
        return stopped

    status, edge = Status.NOT_CONVERGED, EDGE
    try:
        while True:
            # A step of 1e-4 of each parameter's own scale, as the tolerance of a well-scaled problem would be.
            literal = method.variant == "literal"
            simplex, collapsed = nelder_mead.minimise(
                batch if literal else _scaled(batch, problem.scale),
                simplex if literal else _over(simplex, problem.scale),
                adaptive=method.variant == "adaptive",
                x_tolerance=1e-4,
                f_tolerance=1e-4 if literal else 1e-4 * initial,
                max_iterations=most_iterations,
                max_evaluations=most_evaluations,
                progress=told if literal else (lambda now: told(_back(now, problem.scale))),
            )
            simplex = simplex if literal else _back(simplex, problem.scale)
            if not collapsed or literal:
                status = Status.CONVERGED if collapsed else Status.NOT_CONVERGED
                break
            # A collapsed simplex may lie on a slope: once more from its best point, with smaller edges.
            edge *= 0.5
            if edge < 1e-3 * EDGE:
                status = Status.CONVERGED
                break
            fresh = nelder_mead.edged_simplex(simplex.points[0], edge * problem.scale)
            restarted = nelder_mead.start(batch, fresh)
            simplex = replace(
                restarted,
                iterations=simplex.iterations + 1,
                evaluations=simplex.evaluations + restarted.evaluations,
                simulations=simplex.simulations + restarted.simulations,
            )
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    if stopped:
        status = Status.STOPPED
    size = len(problem.estimated)
    return problem.result(
        simplex.points[0],
        status=status,
        history=history,
        covariance=np.zeros((size, size)),
        condition_number=math.inf,
        settings={
            **problem.settings(),
            "iterations": simplex.iterations,
            "evaluations": simplex.evaluations,
            "initial_norm": initial,
            "final_norm": float(simplex.values[0]),
        },
        remarks=(
            "the simplex gives no standard deviations; the local optimum it ends in need not be the best one",
        ),
    )


def _scaled(batch: Callable[[Array], Array], scale: Array) -> Callable[[Array], Array]:
    return lambda points: batch(points * scale)


def _over(simplex: nelder_mead.Simplex, scale: Array) -> nelder_mead.Simplex:
    return replace(simplex, points=simplex.points / scale)


def _back(simplex: nelder_mead.Simplex, scale: Array) -> nelder_mead.Simplex:
    return replace(simplex, points=simplex.points * scale)


def _levenberg_marquardt(problem: _Problem, progress: Callable[[Iteration], bool]) -> Identification:
    method = problem.method
    _weigh_by_noise(problem)
    point = problem.start
    errors, completed = problem.outputs(point[None])
    if not completed[0]:
        raise FitError("CLOE cannot start from these parameters: the robot cannot be simulated with them")
    errors = errors[0]
    cost = float(errors @ errors)
    initial = cost
    history: list[Iteration] = []
    damping, status = 1e-3, Status.NOT_CONVERGED
    normal = np.eye(point.size)
    condition = math.inf
    jacobian: Array | None = None
    try:
        for number in range(1, (method.max_iterations or 100) + 1):
            jacobian = _derivatives(problem, point, errors)
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
                errors = problem.outputs(point[None])[0][0]
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
            problem.say(
                f"iteration {number}: cost per row {cost / errors.size:.6g}, gradient {cosine:.2g}, damping {damping:.1g}, "
                f"{problem.n_simulations} simulations"
            )
            if progress(history[-1]):
                status = Status.STOPPED
                break
            if not accepted or fall <= method.tolerance:
                # (20) alone would also be met where the damping has taken all steps away.
                status = Status.CONVERGED if cosine <= math.sqrt(GRADIENT) else Status.NOT_CONVERGED
                break
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    if status is not Status.INTERRUPTED:
        jacobian = _derivatives(problem, point, errors)
        normal = jacobian @ jacobian.T
    covariance, condition = _covariance(problem, normal, errors, jacobian)
    return problem.result(
        point,
        status=status,
        history=history,
        covariance=covariance,
        condition_number=condition,
        settings={
            **problem.settings(),
            "noise_position": (1.0 / np.sqrt(problem.weight_q)).tolist() if problem.weight_q.all() else None,
            "cost": cost,
            "initial_cost": initial,
        },
    )


def _weigh_by_noise(problem: _Problem) -> None:
    method = problem.method
    q = np.concatenate([window.q for window in problem.windows])
    if method.output in ("position", "both"):
        noise = white_noise(q) if method.noise is None else np.asarray(method.noise, dtype=np.float64)
        if noise.shape != (problem.robot.n_dof,) or not (noise > 0.0).all():
            raise FitError(
                f"noise needs {problem.robot.n_dof} positive numbers, one per joint, got {method.noise!r}"
            )
        problem.weight_q = 1.0 / noise**2
    if method.output in ("torque", "both"):
        tau = np.concatenate([window.tau for window in problem.windows])
        problem.weight_tau = 1.0 / white_noise(tau) ** 2


def _derivatives(problem: _Problem, point: Array, errors: Array) -> Array:
    """Return derivatives of the weighted errors, (n, n_rows), by differences of simulations side by side."""
    steps = DIFFERENCE * problem.scale
    moved, completed = problem.outputs(point + np.diag(steps))
    rows = (moved - errors) / steps[:, None]
    if not completed.all():
        # At the edge of the feasible set the other side is inside.
        back = np.flatnonzero(np.logical_not(completed))
        other, inside = problem.outputs(point - np.diag(steps)[back])
        rows[back] = np.where(inside[:, None], (errors - other) / steps[back, None], 0.0)
    return np.asarray(rows)


def _trials(
    problem: _Problem, point: Array, normal: Array, gradient: Array, diagonal: Array, dampings: Array
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


def _covariance(
    problem: _Problem, normal: Array, errors: Array, jacobian: Array | None
) -> tuple[Array, float]:
    """Return the covariance with the noise that each joint shows, and the condition number of the scaled columns."""
    if jacobian is None:
        return np.zeros_like(normal), math.inf
    size = np.sqrt(np.where(np.diag(normal) > 0.0, np.diag(normal), 1.0))
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    if values[0] <= 1e-14 * values[-1]:
        return np.zeros_like(normal), math.inf
    inverse = (vectors / values) @ vectors.T / np.outer(size, size)
    n = problem.robot.n_dof
    middle = np.zeros_like(normal)
    # Rows stand window by window, output by output, sample by sample, joint by joint.
    for joint in range(n):
        rows, part = jacobian[:, joint::n], errors[joint::n]
        plain = rows @ rows.T
        freedom = part.size - float(np.sum(inverse * plain))
        middle += float(part @ part) / max(1.0, freedom) * plain
    return inverse @ middle @ inverse, float(np.sqrt(values[-1] / values[0]))
