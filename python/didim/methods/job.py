"""A job: an experiment with the settings of one run of a method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from .._tools.arrays import Array, quotient, ratio
from ..errors import FitError, SignalError
from ..experiment.experiment import Experiment
from ..experiment.loop import recordings_of, windows
from ..experiment.specs import ControllerSpec
from ..log.recording import Recording
from ..model.dynamics import inverse_dynamics
from ..regression.delay import DelayEstimate, Moved, Observed, estimate_delay
from ..regression.fit import Fit, Progress
from ..regression.friction.velocity import settled, with_slopes
from ..regression.least_squares import estimated
from ..regression.settings import LeastSquaresSettings
from ..regression.solver import Solver, SolverChoice
from ..result.iteration import HeldOut
from ..robot.robot import Robot
from ..signal.processing import SignalProcessing
from ..signal.window import Window, at_place, windows_of
from ..terms.model import Model
from ..terms.rows import LinearSystem, check_size

CUTOFFS = (1.0, 2.0, 4.0)
"""Cut-offs for the delay estimate, as multiples of the fit's; the best is used, because a filter that rounds off reversals
biases the delay."""
LARGEST_CUTOFF = 0.4
"""Upper bound of these cut-offs, as a share of the sampling rate."""


@dataclass(frozen=True)
class Delay:
    """Torque delay that a run compensates.

    Attributes
    ----------
    samples : float or tuple of float
        Delay of the recorded torque, in samples: of all joints, or of each.
    hold_s : float
        Sample time (s) of a digital controller whose hold is compensated along measured motion (`signal.window.hold_samples`);
        zero for none.
    estimate : DelayEstimate or None
        Estimate of the samples; None for given numbers.
    """

    samples: float | tuple[float, ...] = 0.0
    hold_s: float = 0.0
    estimate: DelayEstimate | None = None

    def record(self) -> dict[str, Any]:
        """Return the record of the delay for a result."""
        samples = list(self.samples) if isinstance(self.samples, tuple) else self.samples
        record: dict[str, Any] = {"compensated_samples": samples}
        if self.hold_s:
            record["hold_s"] = self.hold_s
        if self.estimate is not None:
            record |= {
                "estimated_samples": self.estimate.samples,
                "estimated_seconds": self.estimate.seconds,
                "estimated_std_samples": self.estimate.std_samples,
                "estimated_joints": list(self.estimate.joints),
                "estimated_joints_std": list(self.estimate.joints_std),
                "estimated_cutoff_hz": self.estimate.cutoff_hz,
            }
        return record

    @classmethod
    def recorded(cls, record: Mapping[str, Any]) -> Delay:
        """Return the delay compensated in a result.

        Raises
        ------
        FitError
            For a delay that is not a finite number (``test_residual.py``).
        """
        samples = record.get("compensated_samples", 0.0)
        if not np.isfinite(np.asarray(samples, dtype=np.float64)).all():
            raise FitError(f"the delay of the result must be a finite number, got {samples}")
        return cls(tuple(samples) if isinstance(samples, list) else samples, record.get("hold_s", 0.0))


NO_DELAY = Delay()
"""Delay of a torque that belongs to its sample."""


@dataclass(frozen=True, eq=False)
class MeasuredRows:
    """Filtered windows of an IDIM-LS, and their system (7).

    Attributes
    ----------
    job : Job
        Experiment and settings.
    delay : Delay
        Compensated delay.
    parts : sequence of Window
        Windows of the recordings of the fit.
    system : LinearSystem
        Their rows.
    """

    job: Job
    delay: Delay
    parts: Sequence[Window]
    system: LinearSystem

    def along(self, job: Job, delay: Delay) -> bool:
        """Whether the windows are those of another job with a delay too."""
        own_recordings, other = self.job.experiment.recordings, job.experiment.recordings
        return (
            [*map(id, own_recordings)] == [*map(id, other)]
            and self.job.signal == job.signal
            and (self.delay.samples, self.delay.hold_s) == (delay.samples, delay.hold_s)
        )

    def every_column(self, job: Job) -> LinearSystem | None:
        """Return the system if it has all base columns of the robot of another job along the same windows, and no others."""
        whole = self.system.known is None and self.system.names == job.model.unknowns.names
        simple = job.model.simple and not job.robot.friction.has_load
        return self.system if whole and simple and self.job.robot is job.robot else None


@dataclass(frozen=True)
class Job:
    """An experiment with the settings of this run."""

    experiment: Experiment
    model: Model
    signal: SignalProcessing
    settings: LeastSquaresSettings
    delay_setting: float | Sequence[float] | Literal["hold", "estimate"] | Delay
    solver_choice: SolverChoice
    solver: Solver

    @property
    def robot(self) -> Robot:
        """The robot, with the friction of this run."""
        return self.model.own

    def parts(self, role: str, delay: Delay = NO_DELAY) -> list[Window]:
        """Return the filtered windows of a role's recordings, with compensation of a delay."""
        return windows(self.experiment, self.signal, role=role, delay=delay.samples, hold_s=delay.hold_s)

    def system(self, parts: Sequence[Window], beta: Array | None = None) -> LinearSystem:
        """Return the linear system (7) of filtered windows.

        Load friction needs the torque of links and rotors, computed from the base parameters `beta`, (b,), or by default from
        an estimate with these windows.
        """
        if self.robot.friction.has_load and beta is None:
            system = settled(self.model, parts, self.signal, self.estimate).system
        else:
            system = self.model.rows(parts, self.signal, beta)
        return with_slopes(system, self.robot, parts, self.signal)

    def estimate(self, system: LinearSystem) -> tuple[Array, Array]:
        """Return plain least squares of a system (7), (n,), and the weights of its rows, (r,)."""
        return estimated(system, self.settings)

    def solve(self, system: LinearSystem, progress: Progress | None = None) -> Fit:
        """Solve a system (7) with the solver of this run."""
        return self.solver(system, self.settings, progress)

    def lift(self, estimate: Array) -> Array:
        """Return extended standard parameters, (p + e,), of the estimated base parameters, (n,)."""
        return self.model.lift(self.model.unknowns.expand(estimate))

    def estimated(self, x: Array) -> Array:
        """Return the estimated base parameters, (n,), of extended standard parameters, (p + e,)."""
        return np.asarray(self.model.project(x)[self.model.unknowns.estimated])

    @property
    def reduction(self) -> Array:
        """Return the reduction matrix of the motors with logged currents, (n_dof, n_dof): the identity for joint-side currents."""
        drives = recordings_of(self.experiment)[0][1].drives  # those of all recordings to fit
        return np.eye(self.robot.n_dof) if drives is None else np.array(drives)

    @property
    def declared_delay(self) -> Delay:
        """Return the delay of the settings, without any estimate."""
        setting = self.delay_setting
        if isinstance(setting, Delay):
            return setting
        if setting in ("hold", "estimate"):
            return Delay(0.0, sample_time_s(self.experiment))
        if isinstance(setting, (int, float)):
            return Delay(float(setting))
        return Delay(tuple(float(value) for value in setting))

    def delay(self) -> Delay:
        """Return the delay to be compensated, estimated if the settings ask for it."""
        declared = self.declared_delay
        if self.delay_setting != "estimate":
            return declared
        if self.model.n_gains:
            raise FitError(
                "the delay of currents with unknown gains is not estimated: give compensate_samples, or estimate it with gains "
                "near the true ones"
            )
        estimate = self.estimate_delay()
        return replace(
            declared, samples=estimate.joints if estimate.differs else estimate.samples, estimate=estimate
        )

    def estimate_delay(self) -> DelayEstimate:
        """Estimate the delay of the torque, with the cut-off that explains the log best."""
        cutoff = self.signal.cutoff_hz
        most = LARGEST_CUTOFF * min(recording.rate_hz for recording in self.experiment.recordings)
        signals = [self.signal]
        if cutoff is not None:
            cutoffs = [factor * cutoff for factor in CUTOFFS if factor <= 1.0 or factor * cutoff <= most]
            signals = [replace(self.signal, cutoff_hz=each) for each in cutoffs]
        estimates: list[tuple[DelayEstimate, float]] = []
        failures: list[FitError | SignalError] = []
        moved: Moved = {}  # the torques are not filtered, so their rows do not depend on the cut-off
        for signal in signals:
            try:
                estimates.append(replace(self, signal=signal)._estimated_delay(moved))
            except (FitError, SignalError) as error:
                failures.append(error)
        if not estimates:
            raise failures[0]
        return min(estimates, key=lambda estimate: estimate[1])[0]

    def _estimated_delay(self, moved: Moved) -> tuple[DelayEstimate, float]:
        def observe(parts: Sequence[Window]) -> Observed:
            system = self.system(parts)
            solution, weights = self.estimate(system)
            return Observed(system, weights, solution)

        def torque(part: Window, solution: Array) -> Array:
            x = self.model.standard(self.lift(solution), part.recording)
            return inverse_dynamics(self.robot, part.q, part.dq, part.ddq, x, temperature=part.temperature)

        declared = self.declared_delay
        return estimate_delay(
            self.parts("fit"),
            self.signal,
            observe,
            torque,
            moved,
            hold_s=declared.hold_s,
            declared=declared.samples,
        )

    def predicted(self, recording: Recording, beta: Array, delay: Delay) -> tuple[Array, Array, int]:
        """Return norms of errors and torques, and the rows, per joint, for predictions along all windows of a recording.

        `beta` are the base parameters (b,) of the robot in this recording.
        The friction is that of the experiment, not that of its simulation, as in `didim.studies.prediction.predict`.
        """
        robot = self.experiment.robot
        parts = windows_of(recording, self.signal, delay=delay.samples, hold_s=delay.hold_s)
        system = Model(robot).rows(parts, self.signal, beta)
        with at_place(f"recording '{recording.name}'"):
            check_size(system)
        with np.errstate(over="ignore", invalid="ignore"):
            error = np.asarray(system.y - system.w @ beta)
        return system.norms(error), system.norms(system.y), system.y.size // robot.n_dof

    def held_out(self, beta: Array, delay: Delay) -> list[HeldOut]:
        """Return the torque errors on held-out recordings, with all parameters of the run, (b + e,)."""
        by_recording = []
        for number, recording in recordings_of(self.experiment, "held-out"):
            recording = recording.with_gains(beta[len(beta) - self.model.n_gains :])
            errors, torques, n_rows = self.predicted(recording, self.model.base(beta, number), delay)
            by_recording.append(
                HeldOut(
                    name=recording.name,
                    relative_error=tuple(quotient(errors, torques, np.nan).tolist()),
                    overall_relative_error=ratio(np.linalg.norm(errors), np.linalg.norm(torques)),
                    error_rms=tuple((errors / np.sqrt(max(1, n_rows))).tolist()),
                )
            )
        return by_recording


def sample_time_s(experiment: Experiment) -> float:
    """Return the sample time of an experiment's digital controller (s); zero for a continuous one, or without one."""
    law = experiment.controller
    if isinstance(law, ControllerSpec):
        return law.sample_time_s
    return law.digital.sample_time_s if law is not None and law.digital is not None else 0.0
