"""The extended Kalman filter as a method: one pass over the log, sample by sample (limits in docs/robust.md).

Tested in ``tests/test_ekf.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .._tools.arrays import Array
from .._tools.settings import positive
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..methods.builder import Run, TorqueErrors, identification
from ..methods.idim_ls import direct_estimate
from ..methods.job import Delay, Job, ratio
from ..methods.method import MethodSettings
from ..methods.start import Start, standard_start
from ..regression.linear_system import LinearSystem
from ..result.identification import Identification
from ..result.iteration import Iteration, Reporter
from ..result.status import Status
from ..signal.noise import white_noise
from .kalman import Filter

PARTS = 10
"""Number of equal parts of the pass, each with an entry in the history."""

MOST_SAMPLES = 500_000
"""Largest number of samples of a pass: it takes a minute and, with the least squares beside it, half a gigabyte."""


@dataclass(frozen=True, kw_only=True)
class EKF(MethodSettings):
    """The extended Kalman filter with its settings, in addition to those of `MethodSettings`.

    Parameters
    ----------
    start : str, mapping, array or Identification
        Initial parameters, as for `DIDIM`; they must be near those of the robot.
    prior : float
        Standard deviation of each initial parameter, as the resulting share of the torques.

    Raises
    ------
    FitError
        For a value out of its range.

    Notes
    -----
    Inputs are measured torques, outputs measured positions. Its standard deviations are several times too small, and it
    diverges from a distant start. Use it for online monitoring, not for reported parameters.
    """

    name: ClassVar[str] = "ekf"

    start: Start = "idim-ls"
    prior: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        positive("prior", self.prior, FitError)
        if self.uncertainty is not None:
            raise FitError(
                "the standard deviations of the Kalman filter are its own: it has no setting for uncertainty"
            )

    def run(self, experiment: Experiment, reporter: Reporter) -> Identification:
        """Identify the parameters of an experiment's robot, as `Method.run`."""
        job = self.job(experiment, experiment.simulated_robot)
        _check(job)
        recordings = [item for item in experiment.recordings if item.role == "fit"]
        count = sum(stop - start for item in recordings for start, stop in item.windows)
        if count > MOST_SAMPLES:
            raise FitError(
                f"the Kalman filter takes at most {MOST_SAMPLES} samples, and the log has {count}: give shorter windows"
            )
        parts = job.parts("fit", 0.0)
        system = job.system(parts)
        windows = [
            (item.q[start:stop], np.asarray(item.driving)[start:stop], item.rate_hz)
            for item in recordings
            for start, stop in item.windows
        ]
        position_noise, torque_noise = (
            white_noise(np.concatenate([window[k] for window in windows])) for k in (0, 1)
        )
        if isinstance(self.start, str) and self.start == "idim-ls":
            x = direct_estimate(self, experiment, reporter).parameters
        else:
            x = standard_start(job.robot, self.start)
        beta = job.robot.base_parameters.project(x)[job.selection.estimated]
        covariance = np.diag((self.prior / _shares(system)) ** 2)
        history: list[Iteration] = []
        status = Status.SOLVED
        remarks = [
            "the standard deviations are those of the filter, which takes its linear model for the truth: too small"
        ]
        d = 2 * job.robot.n_dof
        for q, tau, rate in windows:
            filtered = _filter(job, q, rate, beta, covariance, torque_noise, position_noise)
            ended = _pass(filtered, q, tau, rate, history, reporter)
            if ended is not None:
                status, sentence = ended
                remarks += [sentence] if sentence else []
                covariance = np.zeros_like(covariance)
                break
            beta, covariance = filtered.state[d:].copy(), filtered.covariance[d:, d:].copy()
        begun = self.start if isinstance(self.start, str) else "given"
        run = Run(
            job=job,
            method=self,
            status=status,
            history=history,
            delay=Delay(),
            q=np.concatenate([part.q for part in parts]),
            remarks=remarks,
            settings={"ekf": {"prior": self.prior, "start": begun}},
        )
        return identification(
            run,
            beta=job.selection.expand(beta),
            covariance=covariance,
            errors=TorqueErrors.of(system, system.y - system.w @ beta),
            condition_number=float(np.linalg.cond(system.w)),
        )


def _check(job: Job) -> None:
    """Refuse an experiment that the filter does not take."""
    if not job.parameters.simple:
        raise FitError(
            "the Kalman filter estimates one robot along one motion: it takes no payloads, own offsets or own friction"
        )
    if job.delay_setting not in (0.0, "hold"):
        raise FitError(
            f"the Kalman filter takes no delay of the torque back, and compensate_samples is {job.delay_setting!r}"
        )
    if not job.robot.friction.smoothing or not all(job.robot.friction.smoothing):
        raise FitError(
            "the Kalman filter needs smooth friction: write smoothing_rad_s or smoothing_m_s under [simulation]"
        )


def _filter(
    job: Job,
    q: Array,
    rate_hz: float,
    beta: Array,
    covariance: Array,
    torque_noise: Array,
    position_noise: Array,
) -> Filter:
    """Return the filter at the first sample of a window, with the parameters reached, (b,), and their covariance, (b, b)."""
    d = job.robot.n_dof
    # The initial velocity is that of the window's first samples.
    state = np.concatenate([q[0], (q[1] - q[0]) * rate_hz, beta])
    whole = np.zeros((state.size, state.size))
    whole[:d, :d] = np.diag(position_noise**2)
    whole[d : 2 * d, d : 2 * d] = np.diag((2.0 * position_noise * rate_hz) ** 2)
    whole[2 * d :, 2 * d :] = covariance
    chosen = job.selection
    return Filter(job.robot, state, whole, chosen.values, chosen.estimated, torque_noise, position_noise)


def _pass(
    filtered: Filter, q: Array, tau: Array, rate_hz: float, history: list[Iteration], reporter: Reporter
) -> tuple[Status, str] | None:
    """Filter one window; return the ending if it stopped early."""
    marks = set(np.linspace(0, len(q) - 1, PARTS + 1).astype(int)[1:].tolist())
    last = filtered.beta
    for sample, (position, torque) in enumerate(zip(q, tau, strict=True)):
        filtered.correct(position)
        if sample in marks:
            error = float(np.linalg.norm(position - filtered.state[: position.size]))
            change = ratio(np.linalg.norm(filtered.beta - last), np.linalg.norm(filtered.beta))
            last = filtered.beta
            history.append(
                Iteration(
                    iteration=len(history) + 1,
                    relative_error=ratio(error, np.linalg.norm(position)),
                    step=change,
                    more={"time_s": sample / rate_hz},
                )
            )
            if reporter.progress(history[-1]):
                return Status.STOPPED, ""
        if not filtered.predict(torque, 1.0 / rate_hz):
            return (
                Status.NOT_CONVERGED,
                f"the filter diverged after {sample / rate_hz:.3g} s: start nearer to the robot, or take a smaller prior",
            )
    return None


def _shares(system: LinearSystem) -> Array:
    """Return the share of the torques per unit of each parameter, (b,), over all joints."""
    squares = sum(
        np.mean(system.w[rows] ** 2, axis=0) / max(float(np.mean(system.y[rows] ** 2)), 1e-300)
        for rows in system.joints
    )
    share = np.sqrt(np.asarray(squares))
    return np.where(share > 0.0, share, 1.0)
