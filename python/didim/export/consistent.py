"""Physically consistent parameters for an export, from any result: the bodies nearest to its estimate.

Base parameters alone give no masses. `Identification.consistent` finds the robot nearest to the estimate, in the metric of its
covariance; a prior (the own inertias of the URDF or MJCF, where it has some) decides on what the log leaves open. Tested in
``tests/test_export_consistent.py``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..errors import FitError
from ..regression.consistent.bounds import Bounds
from ..regression.consistent.nearest import FEWEST_DRAWS
from ..result.identification import Identification
from ..robot.rigid_body import INERTIAL
from ..robot.robot import Robot
from ..robot.urdf.reading import MJCF_SET, file_set

GAMMAS_KNOWN = (1.0, 10.0, 100.0, 1000.0)
"""Weights (nats) of a prior that describes this robot, such as its URDF: a link with a tenth of the mass is some 2.3 of them away
from it. The largest holds masses within 3 %, and is taken unless the log contradicts it."""
NOISE = 1.0
"""Largest squared distance to the estimate for each parameter (in variances) that is noise of the estimate: beyond it the log
contradicts the prior. A UR5e that is its URDF has 0.4 with the largest weight, a UR10e with other masses and a tool 0.7 with the
second and 6.8 with the third."""

GAMMA_GENERIC = 0.01
"""Weight (nats) of a prior that only knows the size of the arm: it only affects parameters that the log does not identify."""


SPECK_KG, SPECK_M = 0.01, 0.01
"""Mass and radius of what a link between the joints of one body may hold before others take it over: with ten times the mass the
bodies of a half cheetah, a reacher and a hopper still stay bodies."""

ROUNDING = 1e-9
"""Variance, as a share of the others, that keeps a metric regular where parameters are known or correlate fully."""


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
    fit: Identification, robot: Robot, prior: str | None = None, empty: Collection[int] = ()
) -> ConsistentParameters:
    """Find the physically consistent parameters nearest to a result.

    Parameters
    ----------
    fit : Identification
        Any result with standard deviations.
    robot : Robot
        Its robot, with the friction of the result.
    prior : str, optional
        Parameter set of the robot, or "generic" for solids that fit the arm; by default that of its URDF or MJCF, if any.
    empty : collection of int
        Links (from 0) without mass, see `links_between`.

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
        prior = file_set(robot) or "generic"
    known = fit.std > 0.0
    generic = prior == "generic"
    # Nearly none first, so that what others take over is small enough for them to stay bodies.
    bounds = Bounds(
        masses={j + 1: (0.0, SPECK_KG) for j in empty},
        ellipsoids={j + 1: ((0.0,) * 3, (SPECK_M,) * 3) for j in empty},
    )
    # What the log tells is told by a prior that hardly holds it.
    weight = GAMMA_GENERIC if generic else GAMMAS_KNOWN[0]
    told = nearest = fit.consistent(prior, gamma=weight, robot=robot, bounds=bounds)
    for weight in () if generic else GAMMAS_KNOWN[1:]:
        near = fit.consistent(prior, gamma=weight, robot=robot, bounds=bounds, draws=FEWEST_DRAWS)
        if 2.0 * near.settings["consistent"]["half_distance"] > NOISE * np.count_nonzero(known):
            break
        nearest = near
    x = without_links_between(fit, robot, nearest.parameters, empty)
    difference = (robot.base_parameters.project(x) - fit.beta)[known] / fit.std[known]
    return ConsistentParameters(
        x=x,
        prior=prior,
        sigmas=float(np.sqrt(np.mean(difference**2))),
        from_prior=parameters_from_prior(told, robot),
    )


def inertial_of(robot: Robot, links: Iterable[int]) -> list[int]:
    """Return the places of the inertial parameters of links (from 0) among the standard parameters."""
    return [robot.parameter_names.index(f"{key}{j + 1}") for j in links for key in INERTIAL]


def links_between(robot: Robot) -> tuple[int, ...]:
    """Return the links between the joints of one body of an MJCF, from 0: those that have no mass and carry others."""
    if MJCF_SET not in robot.sets:
        return ()
    carrying = sorted({parent for parent in robot.geometry.parents if parent is not None})
    return tuple(j for j in carrying if not robot.sets[MJCF_SET][inertial_of(robot, [j])].any())


def without_links_between(fit: Identification, robot: Robot, x: Array, empty: Collection[int]) -> Array:
    """Return parameters (n_parameters,) whose `empty` links have no mass.

    The other parameters take the base parameters over: exactly where they can, and else the nearest in the metric of the estimate
    (``tests/test_export_links.py``).
    """
    dropped = inertial_of(robot, empty)
    if not x[dropped].any():
        return x
    new = x.copy()
    new[dropped] = 0.0
    others = np.setdiff1d(np.arange(len(x)), dropped)
    std = np.where(fit.std > 0.0, fit.std, np.abs(fit.beta).max() * ROUNDING)
    correlation = fit.covariance / np.outer(std, std) + ROUNDING * np.eye(len(std))
    correlation[np.diag_indices(len(std))] = 1.0 + ROUNDING
    metric = np.linalg.inv(np.linalg.cholesky(correlation)) / std
    matrix = robot.base_parameters.matrix
    size = np.abs(new[others]) + ROUNDING
    step, *_ = np.linalg.lstsq(metric @ matrix[:, others] * size, metric @ (matrix @ (x - new)), rcond=None)
    new[others] += size * step
    return new


def parameters_from_prior(fit: Identification, robot: Robot) -> dict[int, tuple[str, ...]]:
    """Return the inertial parameters of each link (from 0) that a consistent result has from its prior alone."""
    record = fit.settings.get("consistent", {}).get("parameters", ())
    open_names = {entry["name"] for entry in record if entry["source"] != "identified"}
    return {
        j: tuple(name for key in INERTIAL if (name := f"{key}{j + 1}") in open_names)
        for j in range(robot.n_joints)
    }
