"""Expected error of a result in each use, from held-out blocks and recordings and from the covariance.

Along random motions of the log's size (positions within its range, speeds and accelerations of its root mean squares) the torques
``W beta`` have the standard deviations ``sqrt(diag(W C W'))``; beside them stands what the model misses of torques that it was
not fitted to. Tested in ``tests/test_evidence_result.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array, rms
from ..model.dynamics import inertia_matrix, inverse_dynamics, regressor
from ..model.memory import instantaneous
from ..regression.friction.velocity import slope_at
from ..result.finding import Finding
from ..result.identification import Identification
from ..result.sentences import percent
from ..result.verdict import Use
from ..robot.payload import ends, link_columns
from ..robot.rigid_body import INERTIAL
from ..robot.robot import Robot
from ..signal.filters import row_values
from ..signal.processing import SignalProcessing
from ..signal.window import Window
from ..terms.rows import LinearSystem
from .residual import Residual
from .thresholds import KNOWN_PERCENT, SIZE_DOUBTFUL

STATES = 300
"""Number of random states of the motions."""
TAILS = (0.02, 0.98)
"""Quantiles of the log's positions between which the random ones lie."""
DRIVES = ("F", "Off", "Rest")
"""First letters of the names of friction and offset parameters."""
NO_GRAVITY = 1e-6
"""Torque of gravity at rest, as a share of the torques, below which there is none."""
ROUNDING = 1e-9
"""Error, as a share of the joint's largest torque, below which it is rounding."""
PAYLOAD_BLOCKS = 10
"""Number of time stretches whose masses give a payload's standard deviation."""


@dataclass(frozen=True, eq=False)
class Motions:
    """Random states of the size of a log's motion.

    Attributes
    ----------
    q, dq, ddq : (k, n) arrays
        Positions, velocities and accelerations.
    """

    q: Array
    dq: Array
    ddq: Array

    @classmethod
    def like(cls, parts: Sequence[Window]) -> Motions:
        """Return states like those of a log, the same ones for the same log."""
        rng = np.random.default_rng(0)
        q, dq, ddq = (np.concatenate([getattr(part, key) for part in parts]) for key in ("q", "dq", "ddq"))
        low, high = np.quantile(np.ascontiguousarray(q.T), TAILS, axis=1)
        shape = (STATES, q.shape[1])
        sizes = (rms(values) for values in (dq, ddq))
        return cls(rng.uniform(low, high, shape), *(rng.normal(0.0, size, shape) for size in sizes))


@dataclass(frozen=True)
class Spread:
    """Torques of a result along motions, and what its covariance makes of them.

    Attributes
    ----------
    torque, std, gravity : float
        Root mean squares over states and joints (N.m or N); gravity is the torque without friction and offsets.
    """

    torque: float
    std: float
    gravity: float

    @property
    def share(self) -> float:
        """Standard deviation over torque; infinite without a torque."""
        return self.std / self.torque if self.torque > 0.0 else float("inf")


def spread_of(robot: Robot, fit: Identification, q: Array, dq: Array, ddq: Array) -> Spread:
    """Return the torques of a result along states, and their standard deviations."""
    w = regressor(robot, q, dq, ddq, x=fit.parameters)[:, :, list(robot.base_parameters.indices)]
    torque = w @ fit.beta
    covariance, open_ = fit.covariance, w
    if fit.uncertainty is not None:
        covariance = fit.uncertainty.noise_covariance(fit.covariance, fit.std)
        open_ = np.concatenate([w, _velocity_columns(robot, fit, dq)], axis=2)
    variance = np.sum((open_ @ covariance) * open_, axis=2)
    bodies = w @ np.where([name.startswith(DRIVES) for name in fit.names], 0.0, fit.beta)
    squares = (torque**2, variance, bodies**2)
    return Spread(*(float(np.sqrt(np.mean(np.maximum(values, 0.0)))) for values in squares))


def _velocity_columns(robot: Robot, fit: Identification, dq: Array) -> Array:
    """Return the derivative of the torque by the estimated velocities of friction laws along states, (k, n, v)."""
    assert fit.uncertainty is not None
    terms = {term.parameter: term for term in robot.friction.terms}
    values = dict(zip(fit.names, fit.beta, strict=True))
    columns = np.zeros((*dq.shape, len(fit.uncertainty.velocities)))
    signs = instantaneous(robot, dq)
    for k, name in enumerate(fit.uncertainty.velocities):
        j = terms[name].joint
        columns[:, j, k] = values[name] * slope_at(
            terms[name].law, dq[:, j], signs[:, j], terms[name].velocity
        )
    return columns


def uses_of(
    robot: Robot,
    fit: Identification,
    parts: Sequence[Window],
    residual: Residual,
    signal: SignalProcessing,
    growth: float,
    system: LinearSystem | None = None,
) -> tuple[list[Use], list[Finding]]:
    """Return the error to expect in each use, and a finding where too little is identified for any.

    Parameters
    ----------
    robot, fit
        Whose parameters.
    parts : sequence of Window
        Filtered windows of the log.
    residual : Residual
        What the result leaves of its torques.
    signal : SignalProcessing
        Decimation.
    growth : float
        Error of blocks left out over that of the same blocks fitted.
    system : LinearSystem, optional
        The system (7) of `parts` with all base columns and no others.
    """
    states = Motions.like(parts)
    rest = np.zeros_like(states.dq)
    moving = spread_of(robot, fit, states.q, states.dq, states.ddq)
    still = spread_of(robot, fit, states.q, rest, rest)
    missed, evidence = _missed(fit, residual, growth)
    root = float(np.sqrt(len(residual.size)))
    known = fit.std.any()
    own = float(np.linalg.norm(residual.size))
    share, why = combined(missed / max(own, np.finfo(float).tiny), moving.share if known else 0.0, evidence)
    definite = np.linalg.eigvalsh(inertia_matrix(robot, states.q, fit.parameters))[:, 0] > 0.0
    if not fit.converged:
        unfit = "the method did not end where it aims"
        return [
            Use(name, None, False, unfit) for name in ("simulation", "gravity compensation", "control")
        ], []
    uses = [
        Use("simulation", share, True, why)
        if definite.all()
        else Use(
            "simulation",
            None,
            False,
            f"M(q) is not positive definite in {percent(float(np.mean(~definite)))} % of the positions within the log's range: "
            "write physical = true under [least_squares]",
        ),
        _gravity(still, missed / root, evidence),
        Use("control", share, True, why),
        Use(
            "payload",
            2.0 * payload_std(robot, parts, residual, signal, system),
            True,
            "twice the standard deviation of a mass on the flange that a log like this one gives",
        ),
    ]
    return uses, _uncertain(fit, moving) if known else []


def _missed(fit: Identification, residual: Residual, growth: float) -> tuple[float, str]:
    """Return what is missed of torques that were not fitted, the norm over the joints, and where it comes from."""
    outside = [each for each in fit.held_out if len(each.error_rms) == len(residual.size)]
    if outside:
        worst = max(outside, key=lambda each: each.overall_relative_error)
        return float(np.linalg.norm(worst.error_rms)), f"as on recording '{worst.name}', which was held out"
    own = np.sqrt(np.mean(residual.error**2, axis=1))
    return growth * float(np.linalg.norm(own)), "as on blocks of the log that were left out"


def _gravity(still: Spread, missed: float, evidence: str) -> Use:
    if not still.gravity > NO_GRAVITY * still.torque or not still.torque > 0.0:
        return Use("gravity compensation", None, False, "gravity makes no torque on this robot")
    share, why = combined(missed / still.torque, still.share, evidence)
    return Use("gravity compensation", share, True, why)


def combined(missed: float, spread: float, evidence: str) -> tuple[float, str]:
    """Return the error of what is missed and of the parameters together, shares of the torque, and where most of it comes from."""
    why = evidence if missed >= spread else "mostly from the uncertainty of the parameters"
    return float(np.hypot(missed, spread)), why


def _uncertain(fit: Identification, moving: Spread) -> list[Finding]:
    """Return a finding where the uncertainty of the parameters alone makes more of the torques than a user can take."""
    if not moving.share > SIZE_DOUBTFUL:
        return []
    roles = np.array([role == "estimated" for role in fit.roles])
    percent = np.nan_to_num(fit.relative_std_percent, nan=np.inf)
    poor = [name for name, bad in zip(fit.names, roles & (percent > KNOWN_PERCENT), strict=True) if bad]
    return [
        Finding(
            code="unidentified",
            grade="doubtful",
            parameters=tuple(poor),
            value=moving.share if np.isfinite(moving.share) else None,
            effect=moving.share if np.isfinite(moving.share) else None,
            facts={"count": len(poor), "of": int(roles.sum()), "limit": SIZE_DOUBTFUL},
        )
    ]


def payload_std(
    robot: Robot,
    parts: Sequence[Window],
    residual: Residual,
    signal: SignalProcessing,
    system: LinearSystem | None = None,
) -> float:
    """Return the standard deviation of a mass at the last frame that a log like this one gives (kg); the largest of a tree's ends.

    The mass that explains the residual best is found on each of ten stretches of time, joints weighted by their residuals.
    """
    # A joint without errors, such as one without torque, would have infinite weight.
    floor = ROUNDING**2 * float(np.max(residual.size)) ** 2
    if not floor > 0.0:
        return 0.0
    weight = 1.0 / np.maximum(np.mean(residual.error**2, axis=1), floor)
    deviations = []
    for joint in ends(robot):
        unit = link_columns(robot, joint)[:, INERTIAL.index("M")]
        if system is not None:
            column = (system.w @ robot.base_parameters.project(unit)).reshape(robot.n_dof, -1)
        else:
            torques = (inverse_dynamics(robot, part.q, part.dq, part.ddq, unit) for part in parts)
            column = np.concatenate([row_values(torque, signal).T for torque in torques], axis=1)
        moments, information = (
            np.array([float(part.sum()) for part in np.array_split(weight @ values, PAYLOAD_BLOCKS)])
            for values in (column * residual.error, column**2)
        )
        masses = moments / np.maximum(information, np.finfo(float).tiny)
        deviations.append(float(np.std(masses, ddof=1) / np.sqrt(PAYLOAD_BLOCKS)))
    return max(deviations)
