"""Friction at speeds inside the log, where the parameters of its law exchange.

Coulomb friction and a law of speed can be nearly the same column in a log, or the velocity of the law is unknown: then their
parameters are uncertain but their sum is not. For a joint alone, in steady sliding, half the difference between both directions is

    f(v) = g(v)^T beta,     s^2 = h(v)^T C h(v)

with the columns g at speed v and the derivatives h by the parameters and the estimated velocities, whose covariance is C.
Tested in ``tests/test_friction_exchange.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import didim._core as _core

from ..._tools.arrays import Array
from ...model.dynamics import friction_places
from ...model.memory import instantaneous
from ...robot.friction import OF_PATH, FrictionTerm
from ...robot.parameters import friction_names
from ...robot.robot import Robot
from ...signal.window import Window

EXCHANGED = 0.95
"""Size of the correlation of two friction parameters from which they exchange: the variance inflation factor of two columns is then
10, the usual limit of collinearity."""
SHARES = (10.0, 50.0, 90.0)
"""Percentiles of a joint's speeds in the log, above its dead zone, at which its friction is stated."""
CURVED = frozenset(("atan", "stribeck", "root"))
"""Laws of speed that can exchange with viscous and Coulomb friction."""
VELOCITY_CHANGE = 1e-4
"""Relative change of a velocity, both ways, in the finite difference of its law."""


@dataclass(frozen=True, kw_only=True)
class Exchange:
    """Friction of a joint whose parameters exchange, at speeds inside the log.

    Attributes
    ----------
    joint : int
        Joint, from 0.
    kind : {"revolute", "prismatic"}
        Its kind.
    parameters : (str, str)
        The parameter of the law, and that of viscous or Coulomb friction with which it is most correlated.
    correlation : float
        Their correlation.
    refused : bool
        Whether the log does not identify the velocity of the law.
    speeds : tuple of float
        Speeds (rad/s or m/s).
    torques, stds : tuple of float
        Friction at these speeds (N.m or N), half the difference between both directions at the median load, and its standard
        deviation, without the shift by laws that the model lacks.
    """

    joint: int
    kind: str
    parameters: tuple[str, str]
    correlation: float
    refused: bool
    speeds: tuple[float, ...]
    torques: tuple[float, ...]
    stds: tuple[float, ...]


def exchanges(
    robot: Robot,
    parts: Sequence[Window],
    load: Sequence[Array],
    x: Array,
    names: Sequence[str],
    velocities: Sequence[str],
    covariance: Array,
) -> tuple[Exchange, ...]:
    """Return the joints at which a law of speed exchanges with viscous or Coulomb friction, or has no velocity.

    Parameters
    ----------
    robot : Robot
        Robot with known velocities.
    parts : sequence of Window
        Motion of the log.
    load : sequence of (n_samples, n_dof) arrays
        Torque of links and rotors along each part (N.m or N).
    x : ndarray, shape (n_parameters,)
        Estimated standard parameters.
    names, velocities : sequence of str
        Estimated base parameters, and parameters of the laws with an estimated velocity.
    covariance : ndarray, shape (n_names + n_velocities,) * 2
        Covariance of the base parameters and the velocities.
    """
    std = np.sqrt(np.diag(covariance))
    exchanged = []
    for term in robot.friction.terms:
        if term.law not in CURVED or term.parameter not in names:
            continue
        own = names.index(term.parameter)
        beside = [index for index, name in enumerate(names) if name in friction_names(term.joint)]
        if not beside or not std[[own, *beside]].all():
            continue
        correlations = covariance[own, beside] / (std[own] * std[beside])
        most = int(np.argmax(np.abs(correlations)))
        if not term.refused and abs(correlations[most]) < EXCHANGED:
            continue
        speeds = _speeds(robot, term.joint, parts)
        if not speeds.size:
            continue
        typical = np.median(np.abs(np.concatenate(load)), axis=0)
        torques, stds = _curve(robot, term.joint, speeds, typical, x, (names, velocities), covariance)
        exchanged.append(
            Exchange(
                joint=term.joint,
                kind=robot.joint_kinds[term.joint],
                parameters=(term.parameter, names[beside[most]]),
                correlation=float(correlations[most]),
                refused=term.refused,
                speeds=tuple(speeds.tolist()),
                torques=tuple(torques.tolist()),
                stds=tuple(stds.tolist()),
            )
        )
    return tuple(exchanged)


def _speeds(robot: Robot, joint: int, parts: Sequence[Window]) -> Array:
    """Return speeds inside the log (rad/s or m/s); none for a joint that rests."""
    sizes = [np.abs(part.dq[instantaneous(robot, part.dq)[:, joint] != 0.0, joint]) for part in parts]
    moving = np.concatenate(sizes)
    return np.percentile(moving, SHARES) if moving.any() else np.zeros(0)


def _curve(
    robot: Robot,
    joint: int,
    speeds: Array,
    load: Array,
    x: Array,
    estimated: tuple[Sequence[str], Sequence[str]],
    covariance: Array,
) -> tuple[Array, Array]:
    """Return friction and its standard deviation at speeds, (n_speeds,) each."""
    names, velocities = estimated
    columns = _columns(robot, joint, speeds, load)
    values = dict(zip(robot.parameter_names, x, strict=True))
    nothing = np.zeros_like(speeds)
    slopes = [columns.get(name, nothing) for name in names]
    terms = {term.parameter: term for term in robot.friction.terms}
    for term in (terms[name] for name in velocities):
        up, down = (
            _columns(_with_velocity(robot, term, factor), joint, speeds, load).get(term.parameter, nothing)
            for factor in (1.0 + VELOCITY_CHANGE, 1.0 - VELOCITY_CHANGE)
        )
        slopes.append(values[term.parameter] * (up - down) / (2.0 * VELOCITY_CHANGE * term.velocity))
    h = np.array(slopes)
    torques = np.sum([values[name] * column for name, column in columns.items()], axis=0)
    return torques, np.sqrt(np.maximum(np.einsum("as,ab,bs->s", h, covariance, h), 0.0))


def _with_velocity(robot: Robot, term: FrictionTerm, factor: float) -> Robot:
    changed = replace(term, velocity=factor * term.velocity)
    return robot.with_terms([changed if other is term else other for other in robot.friction.terms])


def _columns(robot: Robot, joint: int, speeds: Array, load: Array) -> dict[str, Array]:
    """Return the friction columns of a joint that moves alone in steady sliding, half the difference of both directions."""
    plain = robot.with_terms([term for term in robot.friction.terms if term.law not in OF_PATH])
    dq = np.zeros((2 * len(speeds), robot.n_dof))
    dq[:, joint] = np.concatenate([speeds, -speeds])
    still = np.zeros_like(dq)
    w = _core.regressor(plain.core, still, dq, still, None, np.tile(load, (len(dq), 1)))[:, joint]
    half = 0.5 * (w[: len(speeds)] - w[len(speeds) :])
    columns = {plain.parameter_names[index]: half[:, index] for index in friction_places(plain)}
    for term in robot.friction.terms:
        if term.law == "dahl" and term.joint == joint:  # its state is the sign
            columns[term.parameter] = instantaneous(plain, dq[: len(speeds)])[:, joint]
    return columns
