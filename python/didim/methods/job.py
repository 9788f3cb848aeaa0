"""A job: an experiment with the settings that hold for one run of a method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..log.recording import Recording
from ..regression.delay import DelayEstimate, estimate_delay
from ..regression.fit import Fit, Progress
from ..regression.friction.velocity import settled
from ..regression.least_squares import solve
from ..regression.linear_system import LinearSystem, check_size, linear_system
from ..regression.selection import Selection, select
from ..regression.settings import LeastSquaresSettings
from ..regression.solver import Solver, SolverChoice
from ..result.iteration import HeldOut
from ..robot.robot import Robot
from ..signal.processing import SignalProcessing
from ..signal.segments import Segment, at_place, segments


@dataclass(frozen=True)
class Delay:
    """Delay of the torque after the motion that a run takes back.

    Attributes
    ----------
    samples : float
        In samples of the recordings; positive: the torque was recorded late.
    estimate : DelayEstimate or None
        Where it comes from; None for a given number.
    """

    samples: float = 0.0
    estimate: DelayEstimate | None = None

    def record(self) -> dict[str, float]:
        """Return what a result says about the delay."""
        record = {"compensated_samples": self.samples}
        if self.estimate is not None:
            record |= {
                "estimated_samples": self.estimate.samples,
                "estimated_seconds": self.estimate.seconds,
            }
        return record


@dataclass(frozen=True)
class Job:
    """An experiment with the settings that hold for this run."""

    experiment: Experiment
    robot: Robot
    signal: SignalProcessing
    settings: LeastSquaresSettings
    selection: Selection
    fixed: Mapping[str, float]
    dropped: tuple[str, ...]
    delay_setting: float | str
    solver_choice: SolverChoice
    solver: Solver

    def parts(self, role: str, delay_samples: float) -> list[Segment]:
        """Return the filtered windows of the recordings of a role, the torque taken back by a delay."""
        recordings = [
            (number, item) for number, item in enumerate(self.experiment.recordings) if item.role == role
        ]
        if role == "fit" and not recordings:
            raise FitError(f"experiment '{self.experiment.name}' has no recording with role 'fit'")
        return [
            part
            for number, item in recordings
            for part in segments(item, self.signal, delay_samples, number=number)
        ]

    def system(self, parts: Sequence[Segment], beta: Array | None = None) -> LinearSystem:
        """Return the linear system (7) of filtered windows.

        Load friction needs the torque of links and rotors: that of the base parameters `beta`, (b,), or without them that of the
        estimate from these very windows.
        """
        if self.robot.friction.has_load and beta is None:

            def solved(system: LinearSystem) -> tuple[Array, Array]:
                fit = solve(system, self.settings)
                return fit.solution, fit.weights

            return settled(self.robot, parts, self.signal, (dict(self.fixed), self.dropped), solved).system
        return linear_system(self.robot, parts, self.signal, self.selection, beta)

    def solve(self, system: LinearSystem, progress: Progress | None = None) -> Fit:
        """Solve a system (7) with the solver of this run."""
        return self.solver(system, self.settings, progress)

    def delay(self) -> Delay:
        """Return the delay that is taken back, by estimate if one was asked for."""
        if self.delay_setting != "estimate":
            return Delay(float(self.delay_setting))
        estimate = self.estimate_delay()
        return Delay(estimate.samples, estimate)

    def estimate_delay(self) -> DelayEstimate:
        """Estimate how late the torque was recorded."""

        def observe(parts: Sequence[Segment]) -> tuple[LinearSystem, Array]:
            system = self.system(parts)
            return system, solve(system, self.settings).weights

        return estimate_delay(self.parts("fit", 0.0), self.signal, observe)

    def predicted(self, recording: Recording, beta: Array, delay_samples: float) -> tuple[Array, Array]:
        """Norms of the errors and of the torques of each joint, predicted with `beta` along a recording, all windows together.

        The friction is that of the experiment, not that of its simulation, as in `didim.studies.prediction.predict`.
        """
        robot = self.experiment.robot
        parts = segments(recording, self.signal, delay_samples)
        system = linear_system(robot, parts, self.signal, select(robot, {}, ()), beta)
        with at_place(f"recording '{recording.name}'"):
            check_size(system)
        return system.norms(prediction_error(system, beta)), system.norms(system.y)

    def held_out(self, beta: Array, delay_samples: float) -> list[HeldOut]:
        """Errors of the torques predicted for the recordings kept out."""
        found = []
        for recording in self.experiment.recordings:
            if recording.role != "held-out":
                continue
            errors, torques = self.predicted(recording, beta, delay_samples)
            found.append(
                HeldOut(
                    name=recording.name,
                    relative_error=tuple(float(value) for value in ratios(errors, torques)),
                    overall_relative_error=ratio(np.linalg.norm(errors), np.linalg.norm(torques)),
                )
            )
        return found


def prediction_error(system: LinearSystem, beta: Array) -> Array:
    """``Y - W beta``, infinite where floating point ends."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(system.y - system.w @ beta)


def ratio(part: float | np.floating, whole: float | np.floating) -> float:
    """Return part over whole; NaN without a whole."""
    return float(part / whole) if whole > 0.0 else float("nan")


def ratios(parts: Array, wholes: Array) -> Array:
    """Return `ratio` of each pair."""
    return np.array([ratio(part, whole) for part, whole in zip(parts, wholes, strict=True)])
