"""Priors of physically consistent estimates: a robot as the centre of the prior for links, rotors and friction.

Only the log-det divergence (11) from the prior bounds parameters that the log does not identify, such as the mass of a link
that hardly moves. Tested in ``tests/test_consistent.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...model.consistency import Cone, places_of, pseudo_inertias
from ...model.drive_cones import FREE
from ...robot.placement import carriers
from ...robot.rigid_body import INERTIAL, ten_parameters
from ...robot.robot import Geometry, Robot
from ...terms.rows import LinearSystem, unit_columns
from ...terms.unknown import Unknowns

GAMMA = 1e-2
"""Default weight (nats) of a prior, beside the information of a log with uncorrelated errors."""
RADIUS_SHARE = 0.08
"""Radius of gyration of a generic solid, as a share of the arm's length."""
LEAST_LENGTH = 0.1
"""Length (m) assumed for an arm without extent."""
LEAST_MASS = 0.1
"""Smallest mass (kg) of a generic solid: a log without gravity may yield none."""
DEFAULT_MASS = 3.0
"""Mass (kg) of a generic solid without a log."""
INNER = 1e-2
"""Share of a generic solid mixed into bodies of a given robot that are plates or rods: they have no volume."""
THIN = 1e-4
"""Smallest second moment of a body, as a share of a generic solid's, from which it has a volume and is taken as it is."""


@dataclass(frozen=True, eq=False)
class Prior:
    """The robot at the centre of a prior.

    Tested in ``tests/test_consistent.py``.

    Attributes
    ----------
    name : str
        Name for the record of a result.
    bodies : tuple of (4, 4) arrays
        Pseudo-inertia of each link about its frame, positive definite.
    rotors : (n_dof,) array
        Rotor inertia of each motor (kg.m^2 or kg), joint side.
    """

    name: str
    bodies: tuple[Array, ...]
    rotors: Array

    def parameters(self, robot: Robot) -> Array:
        """Return standard parameters of the prior with friction of 1: they are feasible."""
        places, x = places_of(robot), np.zeros(len(robot.parameter_names))
        for j, body in enumerate(self.bodies, start=1):
            for name, value in zip(INERTIAL, ten_parameters(body), strict=True):
                x[places[f"{name}{j}"]] = value
        coupling = np.array(robot.geometry.coupling)
        squares = (coupling / np.diag(coupling)[:, None]) ** 2
        for j, inertia in enumerate(squares.T @ self.rotors, start=1):
            x[places[f"Ia{j}"]] = inertia
        for j in range(robot.n_dof + 1, robot.n_joints + 1):
            x[places[f"Ia{j}"]] = 1.0
        for index, parameter in enumerate(robot.standard_parameters):
            if parameter.kind in ("Fvm", "Fcm"):
                x[index] = 0.1
            elif parameter.kind in ("Fv", "Fc"):
                x[index] = 1.0
        for term in robot.friction.terms:
            if term.law not in FREE:
                x[places[term.parameter]] = 0.1
        return x


def generic_prior(
    robot: Robot, system: LinearSystem | None = None, selection: Unknowns | None = None
) -> Prior:
    """Return solids of equal mass at every frame, with a size proportional to the arm, and unit rotors.

    The radius of gyration is 0.08 of the length of the arm. The mass is fitted to the torques of a log, together with rotors,
    friction and offsets; it is 3 kg without a log.

    Parameters
    ----------
    robot : Robot
        Robot whose geometry gives the size.
    system : LinearSystem, optional
        Rows of a log, for the mass.
    selection : Unknowns, optional
        Base parameters of the columns.
    """
    geometry = robot.geometry
    length = max(_way(geometry, joint) for joint in range(robot.n_joints))
    radius = RADIUS_SHARE * max(length, LEAST_LENGTH)
    one = Prior("generic", (np.diag([radius**2] * 3 + [1.0]),) * robot.n_joints, np.ones(robot.n_dof))
    mass = DEFAULT_MASS if system is None or selection is None else _mass(robot, one, system, selection)
    return replace(one, bodies=tuple(mass * body for body in one.bodies))


def _way(geometry: Geometry, joint: int) -> float:
    """Return the sum of the lengths from the base to a frame (m)."""
    way_length = 0.0
    for j in carriers(geometry.parents, joint):
        way_length += abs(geometry.d[j]) + abs(geometry.r[j])
        if geometry.mounts:
            mount = geometry.mounts[j]
            way_length += abs(mount.b) + math.hypot(*mount.shift)
    return way_length


def _mass(robot: Robot, one: Prior, system: LinearSystem, selection: Unknowns) -> float:
    """Return the mass of the equal solids that fit the torques best, together with the drives."""
    x = one.parameters(robot)
    inertial = [parameter.kind in INERTIAL for parameter in robot.standard_parameters]
    whole = robot.base_parameters.matrix
    own = [index for index in selection.estimated if index < len(whole)]
    # The further parameters of logs follow those of the robot.
    w, further = system.w[:, : len(own)], system.w[:, len(own) :]
    matrix = whole[own]
    body = w @ (matrix @ np.where(inertial, x, 0.0))
    drives = w @ matrix[:, np.logical_not(inertial)]
    drives = drives[:, np.any(drives != 0.0, axis=0)]
    if not body.any():
        return DEFAULT_MASS
    columns, sizes = unit_columns(np.column_stack([body, drives, further]))
    solution = np.linalg.lstsq(columns, system.y, rcond=1e-10)[0]
    return float(max(solution[0] / sizes[0], LEAST_MASS))


def drawn(condition: Cone, body: Array, weight: float) -> Cone:
    """Return the condition on a pseudo-inertia in units of a prior's, (4, 4), with a log-det term of a weight (nats)."""
    root = np.linalg.inv(np.linalg.cholesky(body))
    return replace(
        condition,
        basis=root @ condition.basis @ root.T,
        constant=root @ condition.constant @ root.T,
        weight=weight,
        slope=np.eye(4),
    )


def prior_near(robot: Robot, x: Array, name: str) -> Prior:
    """Return the prior at given standard parameters, such as those of a URDF or of CAD.

    A small share of a generic solid is mixed into plates and rods, so that they have a volume.

    Parameters
    ----------
    robot : Robot
        The robot.
    x : (p,) array
        Standard parameters; links that are not bodies are replaced by generic solids.
    name : str
        Name for the record.

    Raises
    ------
    FitError
        For a wrong length.
    """
    if np.shape(x) != (len(robot.parameter_names),):
        raise FitError(f"the prior needs {len(robot.parameter_names)} standard parameters, got {np.shape(x)}")
    generic, places = generic_prior(robot), places_of(robot)
    bodies = []
    for body, solid in zip(pseudo_inertias(robot, x), generic.bodies, strict=True):
        mass = max(body[3, 3], 0.0)
        least, moment = np.linalg.eigvalsh(body)[0], mass * solid[0, 0]
        if not (mass > 0.0 and least >= -INNER * moment):
            body = solid
        elif least < THIN * moment:
            body = body + INNER * (mass / DEFAULT_MASS) * solid
        bodies.append(body)
    given = np.array([x[places[f"Ia{j}"]] for j in range(1, robot.n_dof + 1)])
    return Prior(name, tuple(bodies), np.where(given > 0.0, given, 1.0))


def prior_of(
    robot: Robot,
    choice: str | Mapping[str, float] | Array | Prior,
    system: LinearSystem | None = None,
    selection: Unknowns | None = None,
) -> Prior:
    """Return a prior by choice.

    Parameters
    ----------
    robot : Robot
        The robot.
    choice : str, mapping, array or Prior
        "generic", a parameter set of the robot such as "urdf", values by name such as those of CAD, or standard parameters.
    system, selection
        As for `generic_prior`.

    Raises
    ------
    FitError, RobotError
        For a wrong choice.
    """
    if isinstance(choice, Prior):
        if len(choice.bodies) != robot.n_joints:
            raise FitError(
                f"the prior has {len(choice.bodies)} links and robot {robot.name!r} has {robot.n_joints}"
            )
        return choice
    if isinstance(choice, str):
        if choice == "generic":
            return generic_prior(robot, system, selection)
        return prior_near(robot, robot.parameter_set(choice), choice)
    if isinstance(choice, Mapping):
        return prior_near(robot, robot.parameters_by_name(choice, "the prior:"), "given")
    return prior_near(robot, np.asarray(choice, dtype=np.float64), "given")
