"""Flags on estimates that physics forbids: negative friction or inertia, M(q) not positive definite.

A base parameter is a sum of standard parameters. Where all of them are of a kind that cannot be negative
(masses, moments of inertia, rotor inertias, friction) and enter with positive coefficients, neither can the
sum. And the inertia matrix must be positive definite at every configuration, those of the log at least.
"""

from __future__ import annotations

import re

import numpy as np

from .._tools.arrays import Array
from ..robot.robot import Robot
from .dynamics import inertia_matrix

# Names of the standard parameters that cannot be negative: letters, then joint number and perhaps a
# direction.
NOT_NEGATIVE = re.compile(r"(XX|YY|ZZ|M|Ia|Fv|Fc|Fvm|Fcm)\d+[+-]?")

# M(q) is looked at in so many samples of the log at most.
MOST_CONFIGURATIONS = 1000


def physical_flags(robot: Robot, beta: Array, std: Array, q: Array) -> tuple[str, ...]:
    """Sentences on what the estimate has that no robot can have.

    Parameters
    ----------
    robot : Robot
        Gives names and groupings.
    beta, std : ndarray, shape (b,)
        Base parameters and their standard deviations.
    q : ndarray, shape (n_samples, n_dof)
        Joint positions of the log.

    Returns
    -------
    tuple of str
        Empty when nothing is forbidden.

    Notes
    -----
    ``test_physics.py`` flags spoiled parameters and leaves true ones alone.
    """
    base = robot.base_parameters
    flags = []
    for index, (name, unit) in enumerate(zip(base.names, base.units, strict=True)):
        if beta[index] < 0.0 and _cannot_be_negative(robot, index):
            times = -beta[index] / std[index] if std[index] > 0.0 else np.inf
            flags.append(
                f"{name} = {beta[index]:.4g} {unit} is negative"
                + (f", by {times:.1f} sigma" if np.isfinite(times) else ", as fixed")
                + (" (noise can explain it)" if times < 2.0 else "")
            )
    if q.shape[0]:
        flags += _indefinite(robot, base.lift(beta), q)
    return tuple(flags)


def _cannot_be_negative(robot: Robot, index: int) -> bool:
    row = robot.base_parameters.matrix[index]
    involved = np.flatnonzero(row)
    return all(
        row[column] > 0.0 and NOT_NEGATIVE.fullmatch(robot.parameter_names[column]) for column in involved
    )


def _indefinite(robot: Robot, x: Array, q: Array) -> list[str]:
    """Flag on M(q), or nothing."""
    chosen = np.unique(
        np.linspace(0, q.shape[0] - 1, min(q.shape[0], MOST_CONFIGURATIONS)).round().astype(int)
    )
    matrices = inertia_matrix(robot, q[chosen], x)
    try:
        np.linalg.cholesky(matrices)  # far less work than the eigenvalues, which say how bad it is
    except np.linalg.LinAlgError:
        smallest = np.linalg.eigvalsh(matrices)[:, 0]
    else:
        return []
    bad = smallest <= 0.0
    if not bad.any():
        return []
    worst = int(np.argmin(smallest))
    angles = ", ".join(f"{value:.3f}" for value in q[chosen[worst]])
    return [
        f"M(q) is not positive definite in {100.0 * bad.mean():.3g} % of {len(chosen)} configurations of the "
        f"log (smallest eigenvalue {smallest[worst]:.3g} at q = {angles}): this estimate cannot be simulated"
        # A bad estimate is indefinite here and there; one with the signs turned round, everywhere.
        + ("; is the sign of the torques wrong?" if bad.all() else "")
    ]
