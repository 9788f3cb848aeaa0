"""Flags on estimates that physics forbids: negative friction or inertia, M(q) not positive definite.

A base parameter is a sum of standard parameters. If all of them cannot be negative
(masses, moments of inertia, rotor inertias, friction) and enter with positive coefficients, neither can the
sum. Moreover, the inertia matrix must be positive definite, at least in the configurations of the log.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..robot.robot import Robot
from .dynamics import inertia_matrix, regressor

# Names of the standard parameters that cannot be negative: letters, then joint number and perhaps a
# direction.
NOT_NEGATIVE = re.compile(r"(XX|YY|ZZ|M|Ia|Fv|Fc|Fvm|Fcm)\d+[+-]?")

NOISE_SIGMAS = 2.0
"""Standard deviations below which the sign of an estimate is not significant: one estimate in forty is negative by chance."""
MOST_CONFIGURATIONS = 1000
"""Largest number of samples of the log in which M(q) is evaluated."""


@dataclass(frozen=True)
class Flag:
    """A property of an estimate that no robot has.

    Attributes
    ----------
    sentence : str
        Description of the property.
    parameters : tuple of str
        Base parameters concerned; empty for M(q).
    sigmas : float
        Distance beyond zero in standard deviations; infinite if these are unknown.
    """

    sentence: str
    parameters: tuple[str, ...]
    sigmas: float


def physical_flags(
    robot: Robot, beta: Array, covariance: Array, q: Array, unknown: Collection[str] = ()
) -> tuple[Flag, ...]:
    """Return the properties of an estimate that no robot can have.

    Parameters
    ----------
    robot : Robot
        Robot with names and groupings.
    beta : ndarray, shape (b,)
        Base parameters.
    covariance : ndarray, shape (b, b)
        Their covariance.
    q : ndarray, shape (n_samples, n_dof)
        Joint positions of the log.
    unknown : collection of str
        Parameters whose variance is unknown where it is zero; others with a variance of zero are fixed.

    Returns
    -------
    tuple of Flag
        Empty when nothing is forbidden.

    Notes
    -----
    ``test_physics.py`` flags spoiled parameters and leaves true ones alone.
    """
    base = robot.base_parameters
    std = np.sqrt(np.diag(covariance))
    flags = []
    for index, (name, unit) in enumerate(zip(base.names, base.units, strict=True)):
        if beta[index] < 0.0 and _cannot_be_negative(robot, index):
            times = float(-beta[index] / std[index]) if std[index] > 0.0 else np.inf
            without = ", of unknown significance" if name in unknown else ", as fixed"
            sentence = (
                f"{name} = {beta[index]:.4g} {unit} is negative"
                + (f", by {times:.1f} sigma" if np.isfinite(times) else without)
                + (" (noise can explain it)" if times < NOISE_SIGMAS else "")
            )
            flags.append(Flag(sentence, (name,), times))
    if q.shape[0]:
        flags += _indefinite(robot, beta, covariance, q)
    return tuple(flags)


def _cannot_be_negative(robot: Robot, index: int) -> bool:
    row = robot.base_parameters.matrix[index]
    involved = np.flatnonzero(row)
    return all(
        row[column] > 0.0 and NOT_NEGATIVE.fullmatch(robot.parameter_names[column]) for column in involved
    )


def _indefinite(robot: Robot, beta: Array, covariance: Array, q: Array) -> list[Flag]:
    """Flag on M(q), or nothing."""
    chosen = np.unique(
        np.linspace(0, q.shape[0] - 1, min(q.shape[0], MOST_CONFIGURATIONS)).round().astype(int)
    )
    x = robot.base_parameters.lift(beta)
    matrices = inertia_matrix(robot, q[chosen], x)
    try:
        np.linalg.cholesky(matrices)  # much cheaper than the eigenvalues, which are only needed for the size
    except np.linalg.LinAlgError:
        smallest = np.linalg.eigvalsh(matrices)[:, 0]
    else:
        return []
    bad = smallest <= 0.0
    if not bad.any():
        return []
    worst = int(np.argmin(smallest))
    # v' M(q) v is linear in the parameters: its derivatives are those of the torques at the acceleration v.
    vector = np.linalg.eigh(matrices[worst])[1][:, 0]
    at = q[chosen[worst]][None]
    rest = np.zeros_like(at)
    # Load friction has no sign at rest; its columns are zero here, whatever its load.
    columns = regressor(robot, at, rest, vector[None], x=x) - regressor(robot, at, rest, rest, x=x)
    slopes = vector @ columns[0][:, list(robot.base_parameters.indices)]
    sigma = float(np.sqrt(max(0.0, slopes @ covariance @ slopes)))
    times = float(-smallest[worst]) / sigma if sigma > 0.0 else np.inf
    sentence = (
        f"M(q) is not positive definite in {100.0 * bad.mean():.3g} % of {len(chosen)} poses of the log "
        f"(smallest eigenvalue {smallest[worst]:.3g}"
        + (f", {times:.1f} sigma below zero" if np.isfinite(times) else "")
        + "): this estimate cannot be simulated"
        + (" (noise can explain it)" if times < NOISE_SIGMAS else "")
    )
    return [Flag(sentence, (), times)]
