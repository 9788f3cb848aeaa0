"""Prior information of earlier logs: information matrices of results and experiments, and the noise of their torques.

Tested in ``tests/test_excitation.py``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from ..errors import ExcitationError
from ..experiment.experiment import Experiment
from ..experiment.experiment_file import experiment_of
from ..experiment.loop import windows
from ..result.identification import Identification
from ..robot.friction import OF_TEMPERATURE
from ..robot.robot import Robot
from ..signal.window import Window
from ..terms.model import Model
from .settings import Prior


def prior_information(source: Prior, robot: Robot, sigma: Array, log_rate_hz: float) -> Array:
    """Information of an earlier log on the base parameters, ``(n_base, n_base)``.

    Parameters
    ----------
    source : Identification, Experiment or path
        A result gives the inverse of its covariance. An experiment gives the information of its recorded motion, which may be
        singular, for example if a joint did not move.
    robot : Robot
        The robot, with the friction model of the design.
    sigma : (n_dof,) array
        Noise of the torques at each sample of `log_rate_hz` (N.m or N); used for experiments.
    log_rate_hz : float
        Rate of `sigma` (Hz): logs at other rates have the same noise per unit of time.

    Raises
    ------
    ExcitationError
        For a source of another robot or another friction model.
    """
    if isinstance(source, str | Path) and Path(source).suffix == ".json":
        source = Identification.load(source)
    if isinstance(source, Identification):
        return _of_result(source, robot)
    columns = list(robot.base_parameters.indices)
    total = np.zeros((len(columns), len(columns)))
    for part in _fitted(source, robot)[1]:
        weights = log_rate_hz / part.rate_hz / sigma**2
        total += _core.information(robot.core, part.q, part.dq, part.ddq, columns, weights)
    return total


def _of_result(fit: Identification, robot: Robot) -> Array:
    names = robot.base_parameters.names
    if fit.names != names:
        other = next((name for name in names if name not in fit.names), fit.names[-1])
        raise ExcitationError(
            f"the prior {fit.name!r} is for robot {fit.robot!r}, and {other} is not a base parameter of both it and "
            f"{robot.name!r}; do robot and friction differ?"
        )
    estimated = np.flatnonzero([role == "estimated" for role in fit.roles])
    covariance = fit.covariance[np.ix_(estimated, estimated)]
    # Scaled by standard deviations, because units differ.
    std = np.sqrt(np.diag(covariance))
    if not ((std > 0.0) & np.isfinite(std)).all():
        name = names[estimated[int(np.argmin((std > 0.0) & np.isfinite(std)))]]
        raise ExcitationError(f"the prior {fit.name!r} has no standard deviation for {name}")
    values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    scaled = vectors / std[:, None]
    information = np.zeros((len(names), len(names)))
    # An agreement of two estimates to the last digits is not information.
    information[np.ix_(estimated, estimated)] = (scaled / np.maximum(values, 1e-12)) @ scaled.T
    return information


def at_reference_temperature(robot: Robot) -> Robot:
    """Return a robot without terms of temperature, whose columns are zero at the reference temperature; or the robot itself."""
    return robot.without(*OF_TEMPERATURE) if robot.friction.warmed else robot


def _fitted(source: Experiment | str | Path, robot: Robot) -> tuple[Experiment, list[Window]]:
    """Return an experiment of a robot, and the windows of its recordings that are not held out."""
    experiment = experiment_of(source)
    if at_reference_temperature(experiment.robot).parameter_names != robot.parameter_names:
        raise ExcitationError(
            f"experiment {experiment.name!r} is for robot {experiment.robot.name!r} with other parameters than robot "
            f"{robot.name!r}; is it the same robot with the same friction?"
        )
    return experiment, windows(experiment)


def noise_from(source: Experiment | str | Path, robot: Robot, log_rate_hz: float) -> Array:
    """Estimate the standard deviation of each joint's torque noise per logged sample from an earlier log, ``(n_dof,)``.

    The residuals of its least squares problem (7) contain the noise after decimation, which is assumed to be white up to the
    rate after decimation: the variance then grows with the rate.

    Raises
    ------
    ExcitationError
        For an experiment of another robot, or a log without degrees of freedom.
    """
    experiment, parts = _fitted(source, robot)
    model = Model(robot).choosing(experiment.fixed, experiment.dropped)
    system = model.rows(parts, experiment.signal)
    solution = np.linalg.lstsq(system.w, system.y, rcond=1e-10)
    residual = system.y - system.w @ solution[0]
    rows_per_joint = len(system.y) // robot.n_dof
    seconds = sum(len(part.q) / part.rate_hz for part in parts)
    # Degrees of freedom are reduced by the same share at each joint.
    share = 1.0 - int(solution[2]) / len(system.y)
    if share <= 0.0:
        raise ExcitationError(
            f"experiment {experiment.name!r} has too few samples to estimate the noise of its torques"
        )
    variance = np.array([np.mean(residual[rows] ** 2) for rows in system.joints]) / share
    return np.asarray(np.sqrt(variance * log_rate_hz / (rows_per_joint / seconds)))
