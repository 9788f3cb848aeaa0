"""Maximum likelihood for logs with noise in positions and torques: Olsen, Swevers and Verdonck (2003).

    min sum_t e_t^T G_t^-1 e_t,   e_t = tau_t - W_t beta,   G_t = S_tau + J_q S_q J_q^T + J_v S_v J_v^T + J_a S_a J_a^T

The weight of each sample depends on the motion and on the parameters, so the solution is iterated. The position noise is that
of the log; times the gains of filter and differences it gives the noise of velocities and accelerations. Tested in
``tests/test_maximum_likelihood.py``; docs/robust.md has an evaluation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from .._tools.arrays import Array, real_array
from .._tools.settings import whole
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..methods.builder import Run, fitted, solved_status
from ..methods.job import Job, ratio
from ..methods.method import MethodSettings
from ..regression.fit import Fit
from ..regression.jackknife import Factors
from ..regression.least_squares import solve
from ..regression.linear_system import LinearSystem
from ..result.identification import Identification
from ..result.iteration import Iteration, Reporter
from ..signal.decimation import row_values
from ..signal.noise import row_noise, white_noise
from ..signal.segments import Segment
from .partials import torque_partials
from .sample_weights import sample_covariances, whitened, whitening

SETTLED_SIGMA = 1e-3
"""Change of every parameter, as a share of its standard deviation, at which the iteration ends."""


@dataclass(frozen=True, kw_only=True)
class MaximumLikelihood(MethodSettings):
    """Maximum likelihood with its settings, beside those of `MethodSettings`.

    Parameters
    ----------
    position_noise, torque_noise : sequence of float, optional
        Standard deviations of a sample of the log, per joint (rad or m; N.m or N). By default position noise is estimated from
        fifth differences, and torque noise from the residual, less the part due to the motion's noise.
    max_iterations : int
        Upper bound of the weighted solutions.

    Raises
    ------
    FitError
        For a value out of its range.

    Notes
    -----
    It changes the variance of the estimate but not the bias due to a noisy observation matrix. Use it for comparison with the
    literature, not for reported parameters.
    """

    name: ClassVar[str] = "ml"

    position_noise: Sequence[float] | None = None
    torque_noise: Sequence[float] | None = None
    max_iterations: int = 30

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("max_iterations", self.max_iterations, FitError, least=1)
        for key in ("position_noise", "torque_noise"):
            given = getattr(self, key)
            if given is None:
                continue
            noise = real_array(key, given, FitError)
            if noise.ndim != 1 or not (np.isfinite(noise) & (noise > 0.0)).all():
                raise FitError(f"{key} needs positive numbers, one per joint, got {given!r}")
            object.__setattr__(self, key, tuple(noise.tolist()))

    def run(self, experiment: Experiment, reporter: Reporter) -> Identification:
        """Identify the parameters of an experiment's robot, as `Method.run`."""
        job = self.job(experiment)
        if not job.parameters.simple:
            raise FitError(
                "maximum likelihood with noisy positions is for logs that share all parameters: it takes no payloads, own offsets "
                "or own friction"
            )
        delay = job.delay()
        parts = job.parts("fit", delay)
        system = job.system(parts)
        noise = _Noise.of(self, job, parts, system)
        history: list[Iteration] = []
        fit = first = solve(system, job.settings)
        converged = stopped = False
        for number in range(1, self.max_iterations + 1):
            before, fit = fit, _weighted(system, job, noise.whiteners(fit), first.condition_number)
            step = np.abs(fit.solution - before.solution) / np.sqrt(np.diag(fit.covariance))
            history.append(
                Iteration(
                    iteration=number,
                    relative_error=ratio(np.linalg.norm(fit.residual), np.linalg.norm(system.measured)),
                    step=ratio(np.linalg.norm(fit.solution - before.solution), np.linalg.norm(fit.solution)),
                )
            )
            converged = bool(step.max() <= SETTLED_SIGMA)
            stopped = reporter.progress(history[-1]) and not converged
            if converged or stopped:
                break
        fit = replace(fit, converged=converged, stopped=stopped)
        record = {"position_noise": noise.position.tolist(), "torque_noise": noise.torque.tolist()}
        run = Run(
            job=job,
            method=self,
            status=solved_status(fit),
            history=history,
            delay=delay,
            q=np.concatenate([part.q for part in parts]),
            settings={"maximum_likelihood": record},
        )
        return fitted(run, system, fit)


@dataclass(eq=False)
class _Noise:
    """Noise of a log and of its rows.

    Attributes
    ----------
    job, parts, system
        Job, its motion and its linear system.
    position : (n_dof,) array
        Standard deviation of a sample's positions (rad or m).
    torque : (n_dof,) array
        Standard deviation of a row's torques (N.m or N); by default from the residual of the last solution.
    least : (n_dof,) array
        Lower bound of `torque`: the white noise of the logged torques.
    given : bool
        Whether the settings give the torque noise.
    """

    job: Job
    parts: Sequence[Segment]
    system: LinearSystem
    position: Array
    torque: Array
    least: Array
    given: bool

    @classmethod
    def of(
        cls, method: MaximumLikelihood, job: Job, parts: Sequence[Segment], system: LinearSystem
    ) -> _Noise:
        """Return the noise of the settings, or that estimated from the log."""
        windows = [
            (item.q[start:stop], np.asarray(item.tau)[start:stop])
            for item in job.experiment.recordings
            if item.role == "fit"
            for start, stop in item.windows
        ]
        n_dof = job.robot.n_dof
        share = row_noise(job.signal, parts[0].rate_hz)[0]

        def noise(name: str, given: Sequence[float] | None, index: int) -> Array:
            if given is None:
                return np.median([white_noise(window[index]) for window in windows], axis=0)
            if len(given) != n_dof:
                raise FitError(f"{name} needs {n_dof} numbers, one per joint, got {len(given)}")
            return np.array(given)

        position = noise("position_noise", method.position_noise, 0)
        torque = share * noise("torque_noise", method.torque_noise, 1)
        return cls(job, parts, system, position, torque, torque, method.torque_noise is not None)

    def whiteners(self, fit: Fit) -> Array:
        """Return the whiteners of all rows for the parameters of a solution, (rows per joint, n_dof, n_dof)."""
        job = self.job
        n_dof, x = job.robot.n_dof, job.robot.base_parameters.lift(job.selection.expand(fit.solution))
        motion = np.concatenate([self._of_motion(part, x) for part in self.parts])
        if not self.given:
            squares = np.array([np.mean(fit.residual[rows] ** 2) for rows in self.system.joints])
            explained = np.einsum("tjj->j", motion) / len(motion)
            self.torque = np.sqrt(np.maximum(squares - explained, self.least**2))
        return whitening(motion + np.diag(self.torque**2).reshape(1, n_dof, n_dof))

    def _of_motion(self, part: Segment, x: Array) -> Array:
        """Return the covariance of the torque error due to the motion's noise, at the rows of a window."""
        robot, signal = self.job.robot, self.job.signal
        partials = torque_partials(robot, part.q, part.dq, part.ddq, x)
        _, *gains = row_noise(signal, part.rate_hz)
        at_rows = []
        for partial in partials:
            rows = row_values(partial.reshape(len(part.q), -1), signal)
            at_rows.append(rows.reshape(-1, robot.n_dof, robot.n_dof))
        return sample_covariances(np.zeros(robot.n_dof), at_rows, [gain * self.position for gain in gains])


def _weighted(system: LinearSystem, job: Job, whiteners: Array, condition_number: float) -> Fit:
    """Solve the whitened system, and return the solution for the original system."""
    white = replace(
        system, w=whitened(system.w, whiteners), y=whitened(system.y[:, None], whiteners)[:, 0], known=None
    )
    fit = solve(white, replace(job.settings, weights="none"))
    return replace(
        fit,
        residual=system.y - system.w @ fit.solution,
        condition_number=condition_number,
        factors=Factors.of(white.w, fit.residual),
    )
