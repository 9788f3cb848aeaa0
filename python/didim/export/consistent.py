"""Physically consistent parameters for an export, from any result: the bodies nearest to its estimate.

Base parameters alone give no masses. `Identification.consistent` finds the robot nearest to the estimate, in the metric of its
covariance; a prior (the URDF's own inertias, where it has some) decides on what the log leaves open. Tested in
``tests/test_export_consistent.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..errors import FitError
from ..result.identification import Identification
from ..robot.rigid_body import INERTIAL
from ..robot.robot import Robot
from ..robot.urdf.reading import URDF_SET

GAMMA_KNOWN = 1.0
"""Weight (nats) of a prior that describes this robot, such as its URDF: a link with a tenth of the volume is 2.3 nats away from
it. On a simulated UR10e it brings the masses, which the log does not identify, within 8 % of the truth and leaves the error of
the base parameters unchanged (docs/ur10e.md)."""

GAMMA_GENERIC = 0.01
"""Weight (nats) of a prior that only knows the size of the arm: it only affects parameters that the log does not identify."""


@dataclass(frozen=True, eq=False)
class ConsistentParameters:
    """Standard parameters of real bodies, near an estimate.

    Attributes
    ----------
    x : (n_parameters,) array
        Standard parameters.
    prior : str
        Name of the prior.
    sigmas : float
        Distance to the estimate: root mean square of the differences in standard deviations.
    from_prior : mapping of int to tuple of str
        For each link (from 0), its parameters that only the prior knows.
    """

    x: Array
    prior: str
    sigmas: float
    from_prior: Mapping[int, tuple[str, ...]]


def consistent_parameters(
    fit: Identification, robot: Robot, prior: str | None = None
) -> ConsistentParameters:
    """Find the physically consistent parameters nearest to a result.

    Parameters
    ----------
    fit : Identification
        Any result with standard deviations.
    robot : Robot
        Its robot, with the friction of the result.
    prior : str, optional
        Parameter set of the robot, or "generic" for solids that fit the arm; by default the set of the URDF where there is one.

    Raises
    ------
    FitError
        When the result has no standard deviations or is of another robot, or no parameters meet all conditions.
    RobotError
        When the robot has no such set.
    """
    if fit.names != robot.base_parameters.names:
        raise FitError(f"result {fit.name!r}: its base parameters are not those of robot {robot.name!r}")
    if prior is None:
        prior = URDF_SET if URDF_SET in robot.sets else "generic"
    weight = GAMMA_GENERIC if prior == "generic" else GAMMA_KNOWN
    nearest = fit.consistent(prior, gamma=weight, robot=robot)
    known = fit.std > 0.0
    difference = (nearest.beta - fit.beta)[known] / fit.std[known]
    return ConsistentParameters(
        x=nearest.parameters,
        prior=prior,
        sigmas=float(np.sqrt(np.mean(difference**2))),
        from_prior=parameters_from_prior(nearest, robot),
    )


def parameters_from_prior(fit: Identification, robot: Robot) -> dict[int, tuple[str, ...]]:
    """Return the inertial parameters of each link (from 0) that a consistent result has from its prior alone."""
    record = fit.settings.get("consistent", {}).get("parameters", ())
    open_names = {entry["name"] for entry in record if entry["source"] != "identified"}
    return {
        j: tuple(name for key in INERTIAL if (name := f"{key}{j + 1}") in open_names)
        for j in range(robot.n_joints)
    }
