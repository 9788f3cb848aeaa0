"""IDIM-LS: the inverse dynamic model with measured motion, and least squares (section III of the paper)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from . import signals
from .delay import DelayEstimate, DelaySettings, estimate_delay
from .errors import FitError
from .identification import HeldOut, Identification, Iteration
from .least_squares import (
    LeastSquaresSettings,
    LinearSystem,
    Variance,
    WeightedFit,
    Weights,
    check_size,
    residual_std,
    row_weights,
    solve,
)
from .observations import Segment, linear_system, segments, told
from .physics import physical_flags
from .selection import Selection, dropped_names, select
from .signals import SignalProcessing
from .status import Status

if TYPE_CHECKING:
    from .experiment import Experiment

Array = NDArray[np.float64]

# Beyond this condition number fewer than about six of the sixteen digits of the estimate are left.
LARGEST_CONDITION_NUMBER = 1e10


@dataclass(frozen=True, kw_only=True)
class IDIMLS:
    """Settings of IDIM-LS; what is None is taken from the experiment file.

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

    Notes
    -----
    ``test_published.py`` meets the published figures of the EMPS, and those of a prototype for the TX40.
    """

    name: ClassVar[str] = "idim-ls"

    weights: Weights | None = None
    reweightings: int | None = None
    variance: Variance | None = None
    decimation_corrected: bool | None = None
    signal: SignalProcessing | None = None
    compensate_samples: float | Literal["estimate"] | None = None
    fixed: Mapping[str, float] | None = None
    dropped: Sequence[str] | None = None

    def __post_init__(self) -> None:
        # Wrong values are told when the settings are made, not after a long reading of files.
        self._least_squares(LeastSquaresSettings())
        if self.compensate_samples is not None:
            DelaySettings(compensate_samples=self.compensate_samples)
        if self.dropped is not None:
            object.__setattr__(self, "dropped", dropped_names(self.dropped))

    def _least_squares(self, default: LeastSquaresSettings) -> LeastSquaresSettings:
        keys = ("weights", "reweightings", "variance", "decimation_corrected")
        return replace(default, **{key: getattr(self, key) for key in keys if getattr(self, key) is not None})

    def run(
        self,
        experiment: Experiment,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> Identification:
        """Identify the parameters of an experiment's robot.

        Parameters
        ----------
        experiment : Experiment
            Robot, recordings and settings.
        progress : callable
            Told every iteration; True stops.
        say : callable
            Told in words what is going on.

        Returns
        -------
        Identification
            With ``elapsed`` still zero.

        Raises
        ------
        DidimError
            One of its kinds, for a log or a wish that allows no estimate.
        """
        robot = experiment.robot
        settings = self._least_squares(experiment.least_squares)
        signal = experiment.signal if self.signal is None else self.signal
        wish = (
            experiment.delay.compensate_samples
            if self.compensate_samples is None
            else self.compensate_samples
        )
        fixed = dict(experiment.fixed if self.fixed is None else self.fixed)
        dropped = experiment.dropped if self.dropped is None else dropped_names(self.dropped)
        selection = select(robot, fixed, dropped)
        fixed = {name: float(value) for name, value in fixed.items()}
        job = _Job(experiment, signal, settings, selection)

        estimate = job.estimate_delay() if wish == "estimate" else None
        if estimate is not None:
            say(f"torque {estimate.samples:+.2f} samples ({1e3 * estimate.seconds:+.3f} ms) after the motion")
        compensated = estimate.samples if estimate is not None else float(wish)
        parts = job.parts("fit", compensated)
        say(f"{len(parts)} windows of {sum(part.q.shape[0] for part in parts)} samples")
        system = linear_system(robot, parts, signal, selection)
        say(f"observation matrix of {system.w.shape[0]} rows and {system.w.shape[1]} columns")

        history: list[Iteration] = []
        measured = system.measured
        last = np.zeros(system.w.shape[1])

        def record(number: int, solution: Array, residual: Array) -> bool:
            nonlocal last
            change, last = np.linalg.norm(solution - last), solution
            history.append(
                Iteration(
                    iteration=number,
                    relative_error=_ratio(np.linalg.norm(residual), np.linalg.norm(measured)),
                    step=_ratio(change, np.linalg.norm(solution)),
                )
            )
            return progress(history[-1])

        band = signals.retained_band(signal) if settings.decimation_corrected else 1.0
        fit = solve(system, settings, band=band, progress=record)
        beta = selection.expand(fit.solution)
        covariance = selection.expand_covariance(fit.covariance)
        errors = system.norms(fit.residual)
        return Identification(
            name=experiment.name,
            robot=robot.name,
            method=self.name,
            status=_status(fit),
            names=robot.base_parameters.names,
            units=robot.base_parameters.units,
            roles=selection.roles,
            beta=beta,
            covariance=covariance,
            parameter_names=robot.parameter_names,
            parameters=robot.base_parameters.lift(beta),
            relative_error=_ratios(errors, system.norms(measured)),
            overall_relative_error=history[-1].relative_error,
            error_norm=float(np.linalg.norm(fit.residual)),
            error_std=residual_std(system, fit, settings),
            condition_number=fit.condition_number,
            n_rows=system.w.shape[0],
            history=tuple(history),
            held_out=tuple(job.held_out(beta, compensated)),
            warnings=physical_flags(
                robot, beta, np.sqrt(np.diag(covariance)), np.concatenate([part.q for part in parts])
            ),
            delay=_delay_record(compensated, estimate),
            settings=job.record(fixed, dropped, wish),
            digests=_digests(experiment),
        )


@dataclass(frozen=True)
class _Job:
    """An experiment with the settings that hold for this run."""

    experiment: Experiment
    signal: SignalProcessing
    settings: LeastSquaresSettings
    selection: Selection

    def parts(self, role: str, delay_samples: float) -> list[Segment]:
        recordings = [item for item in self.experiment.recordings if item.role == role]
        if role == "fit" and not recordings:
            raise FitError(f"experiment '{self.experiment.name}' has no recording with role 'fit'")
        return [part for item in recordings for part in segments(item, self.signal, delay_samples)]

    def estimate_delay(self) -> DelayEstimate:
        def observe(parts: Sequence[Segment]) -> tuple[LinearSystem, Array]:
            system = linear_system(self.experiment.robot, parts, self.signal, self.selection)
            return system, row_weights(system, solve(system, self.settings))

        return estimate_delay(self.parts("fit", 0.0), self.signal, observe)

    def held_out(self, beta: Array, delay_samples: float) -> list[HeldOut]:
        """Errors of the torques predicted for the recordings kept out, all windows of one together."""
        everything = select(self.experiment.robot, {}, ())
        found = []
        for recording in self.experiment.recordings:
            if recording.role != "held-out":
                continue
            parts = segments(recording, self.signal, delay_samples)
            system = linear_system(self.experiment.robot, parts, self.signal, everything)
            with told(f"recording '{recording.name}'"):
                check_size(system)
            errors, torques = system.norms(_error(system, beta)), system.norms(system.y)
            found.append(
                HeldOut(
                    name=recording.name,
                    relative_error=tuple(float(value) for value in _ratios(errors, torques)),
                    overall_relative_error=_ratio(np.linalg.norm(errors), np.linalg.norm(torques)),
                )
            )
        return found

    def record(self, fixed: dict[str, float], dropped: tuple[str, ...], wish: float | str) -> dict[str, Any]:
        """Return settings and recordings of this run, as JSON has them (lists, no tuples)."""
        asked = {
            **{package: metadata.version(package) for package in ("didim", "numpy", "scipy")},
            "experiment": self.experiment.name,
            # With the friction of the experiment, which the digest of the robot file does not tell.
            "robot": {
                "name": self.experiment.robot.name,
                "geometry": asdict(self.experiment.robot.geometry),
                "friction": asdict(self.experiment.robot.friction),
            },
            "signal": asdict(self.signal),
            "least_squares": asdict(self.settings),
            "delay": {"compensate_samples": wish},
            "fixed": fixed,
            "dropped": dropped,
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
        }
        restored: dict[str, Any] = json.loads(json.dumps(asked))
        return restored


def _status(fit: WeightedFit) -> Status:
    if fit.stopped:
        return Status.STOPPED
    return Status.SOLVED if fit.condition_number < LARGEST_CONDITION_NUMBER else Status.ILL_CONDITIONED


def _error(system: LinearSystem, beta: Array) -> Array:
    """``Y - W beta``, infinite where floating point ends."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(system.y - system.w @ beta)


def _ratio(part: float | np.floating[Any], whole: float | np.floating[Any]) -> float:
    return float(part / whole) if whole > 0.0 else float("nan")


def _ratios(parts: Array, wholes: Array) -> Array:
    return np.array([_ratio(part, whole) for part, whole in zip(parts, wholes, strict=True)])


def _delay_record(compensated: float, estimate: DelayEstimate | None) -> dict[str, float]:
    record = {"compensated_samples": compensated}
    if estimate is not None:
        record |= {"estimated_samples": estimate.samples, "estimated_seconds": estimate.seconds}
    return record


def _digests(experiment: Experiment) -> dict[str, str]:
    found = dict(experiment.digests)
    for recording in experiment.recordings:
        found |= {f"data {file}": digest for file, digest in recording.digests.items()}
    return found
