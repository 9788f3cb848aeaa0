"""What the methods share: an experiment with the settings of a run, and the result made of a weighted fit."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np

from .._tools.arrays import Array
from .._tools.version import __version__
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..log.recording import Recording
from ..model.physics import physical_flags
from ..regression.delay import DelayEstimate, estimate_delay
from ..regression.least_squares import WeightedFit, residual_std, row_weights, solve
from ..regression.linear_system import LinearSystem, check_size, linear_system
from ..regression.selection import Selection, dropped_names, select
from ..regression.settings import LeastSquaresSettings, Variance, Weights
from ..result.identification import Identification
from ..result.iteration import HeldOut, Iteration
from ..result.status import Status
from ..robot.robot import Robot
from ..signal.align import DelaySettings
from ..signal.processing import SignalProcessing
from ..signal.segments import Segment, at_place, segments


class Method(Protocol):
    """Settings of a method, and how it runs; a new one needs no more than this and a place in `methods.METHODS`."""

    @property
    def name(self) -> str:
        """Name on the command line and in results."""

    def run(
        self,
        experiment: Experiment,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> Identification:
        """Identify, telling every iteration to ``progress`` (True stops) and what goes on to ``say``."""


# Beyond this condition number fewer than about six of the sixteen digits of the estimate are left.
LARGEST_CONDITION_NUMBER = 1e10


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """Settings that every method on torques has; what is None is taken from the experiment file.

    Parameters
    ----------
    weights, reweightings, variance, decimation_corrected : optional
        As in `LeastSquaresSettings`.
    signal : SignalProcessing, optional
        Filters, trimming and decimation.
    compensate_samples : float or "estimate", optional
        Delay of the torque that is taken back, as in `DelaySettings`.
    fixed : mapping of str to float, optional
        Base parameters that are known.
    dropped : sequence of str, optional
        Base parameters taken as zero.
    """

    weights: Weights | None = None
    reweightings: int | None = None
    variance: Variance | None = None
    decimation_corrected: bool | None = None
    signal: SignalProcessing | None = None
    compensate_samples: float | Literal["estimate"] | None = None
    fixed: Mapping[str, float] | None = None
    dropped: Sequence[str] | None = None

    def __post_init__(self) -> None:
        # Wrong values are at_place when the settings are made, not after a long reading of files.
        self.least_squares(LeastSquaresSettings())
        if self.compensate_samples is not None:
            DelaySettings(compensate_samples=self.compensate_samples)
        if self.dropped is not None:
            object.__setattr__(self, "dropped", dropped_names(self.dropped))

    def least_squares(self, default: LeastSquaresSettings) -> LeastSquaresSettings:
        """Return settings of least squares, with the defaults of an experiment where nothing was asked for."""
        keys = ("weights", "reweightings", "variance", "decimation_corrected")
        return replace(default, **{key: getattr(self, key) for key in keys if getattr(self, key) is not None})

    def job(self, experiment: Experiment, robot: Robot | None = None) -> Job:
        """Return the experiment with the settings that hold; `robot` for other friction than the experiment's."""
        fixed = dict(experiment.fixed if self.fixed is None else self.fixed)
        dropped = experiment.dropped if self.dropped is None else dropped_names(self.dropped)
        robot = robot or experiment.robot
        wish = experiment.delay.compensate_samples
        return Job(
            experiment=experiment,
            robot=robot,
            signal=experiment.signal if self.signal is None else self.signal,
            settings=self.least_squares(experiment.least_squares),
            selection=select(robot, fixed, dropped),
            fixed={name: float(value) for name, value in fixed.items()},
            dropped=dropped,
            wish=wish if self.compensate_samples is None else self.compensate_samples,
        )


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
    wish: float | str

    def parts(self, role: str, delay_samples: float) -> list[Segment]:
        """Return the filtered windows of the recordings of a role, the torque taken back by a delay."""
        recordings = [item for item in self.experiment.recordings if item.role == role]
        if role == "fit" and not recordings:
            raise FitError(f"experiment '{self.experiment.name}' has no recording with role 'fit'")
        return [part for item in recordings for part in segments(item, self.signal, delay_samples)]

    def delay(self) -> tuple[float, DelayEstimate | None]:
        """Return the samples by which the torque is taken back, and their estimate if one was asked for."""
        if self.wish != "estimate":
            return float(self.wish), None
        estimate = self.estimate_delay()
        return estimate.samples, estimate

    def estimate_delay(self) -> DelayEstimate:
        """Estimate how late the torque was recorded."""

        def observe(parts: Sequence[Segment]) -> tuple[LinearSystem, Array]:
            system = linear_system(self.robot, parts, self.signal, self.selection)
            return system, row_weights(system, solve(system, self.settings))

        return estimate_delay(self.parts("fit", 0.0), self.signal, observe)

    def predicted(self, recording: Recording, beta: Array, delay_samples: float) -> tuple[Array, Array]:
        """Norms of the errors and of the torques of each joint, predicted with `beta` along a recording, all windows together."""
        everything = select(self.robot, {}, ())
        parts = segments(recording, self.signal, delay_samples)
        system = linear_system(self.robot, parts, self.signal, everything)
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

    def result(
        self,
        system: LinearSystem,
        fit: WeightedFit,
        *,
        method: str,
        status: Status,
        history: Sequence[Iteration],
        delay: tuple[float, DelayEstimate | None],
        q: Array,
        beta: Array | None = None,
        settings: Mapping[str, Any] | None = None,
        remarks: Sequence[str] = (),
        n_simulations: int = 0,
    ) -> Identification:
        """Put together the result of a fit of `system`; `q` has positions at which physics is checked, (n_samples, n_dof).

        `beta` are the parameters reached, (b,), where they are not those of the last solution.
        """
        robot = self.robot
        beta = self.selection.expand(fit.solution) if beta is None else beta
        covariance = self.selection.expand_covariance(fit.covariance)
        measured = system.measured
        return Identification(
            name=self.experiment.name,
            robot=robot.name,
            method=method,
            status=status,
            names=robot.base_parameters.names,
            units=robot.base_parameters.units,
            roles=self.selection.roles,
            beta=beta,
            covariance=covariance,
            parameter_names=robot.parameter_names,
            parameters=robot.base_parameters.lift(beta),
            relative_error=ratios(system.norms(fit.residual), system.norms(measured)),
            overall_relative_error=ratio(np.linalg.norm(fit.residual), np.linalg.norm(measured)),
            error_norm=float(np.linalg.norm(fit.residual)),
            error_std=residual_std(system, fit, self.settings),
            condition_number=fit.condition_number,
            n_rows=system.w.shape[0],
            n_simulations=n_simulations,
            history=tuple(history),
            held_out=tuple(self.held_out(beta, delay[0])),
            warnings=physical_flags(robot, beta, np.sqrt(np.diag(covariance)), q),
            remarks=tuple(remarks),
            delay=delay_record(*delay),
            settings=self.record(**(settings or {})),
            digests=digests(self.experiment),
        )

    def record(self, **more: Any) -> dict[str, Any]:
        """Return settings and recordings of this run, as JSON has them (lists, no tuples)."""
        import scipy  # loads subprocess and more

        asked = {
            "versions": {"didim": __version__, "numpy": np.__version__, "scipy": scipy.__version__},
            "experiment": self.experiment.name,
            # With the friction of the experiment, which the digest of the robot file does not tell.
            "robot": {
                "name": self.robot.name,
                "geometry": asdict(self.robot.geometry),
                "friction": asdict(self.robot.friction),
            },
            "signal": asdict(self.signal),
            "least_squares": asdict(self.settings),
            "delay": {"compensate_samples": self.wish},
            "fixed": dict(self.fixed),
            "dropped": self.dropped,
            "recordings": [
                {
                    "name": item.name,
                    "role": item.role,
                    "rate_hz": item.rate_hz,
                    "windows": item.windows,
                    **item.origin,
                }
                for item in self.experiment.recordings
            ],
            **more,
        }
        restored: dict[str, Any] = json.loads(json.dumps(asked))
        return restored


def solved_status(fit: WeightedFit) -> Status:
    """Return how a single least-squares problem ended."""
    if fit.stopped:
        return Status.STOPPED
    return Status.SOLVED if fit.condition_number < LARGEST_CONDITION_NUMBER else Status.ILL_CONDITIONED


def prediction_error(system: LinearSystem, beta: Array) -> Array:
    """``Y - W beta``, infinite where floating point ends."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(system.y - system.w @ beta)


def ratio(part: float | np.floating[Any], whole: float | np.floating[Any]) -> float:
    """Return part over whole; NaN without a whole."""
    return float(part / whole) if whole > 0.0 else float("nan")


def ratios(parts: Array, wholes: Array) -> Array:
    """Return `ratio` of each pair."""
    return np.array([ratio(part, whole) for part, whole in zip(parts, wholes, strict=True)])


def delay_record(compensated: float, estimate: DelayEstimate | None) -> dict[str, float]:
    """Return what a result says about the delay."""
    record = {"compensated_samples": compensated}
    if estimate is not None:
        record |= {"estimated_samples": estimate.samples, "estimated_seconds": estimate.seconds}
    return record


def digests(experiment: Experiment) -> dict[str, str]:
    """Return the digests of all files that an experiment was read from."""
    found = dict(experiment.digests)
    for recording in experiment.recordings:
        found |= {f"data {file}": digest for file, digest in recording.digests.items()}
    return found
