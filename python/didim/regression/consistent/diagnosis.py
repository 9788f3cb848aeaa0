"""What a log has wrong that least squares hides: the residual of physical parameters beside that of any parameters.

Without constraints a reversed torque or a wrong gravity hides in parameters that no robot has. Tested in
``tests/test_consistent.py``.
"""

from __future__ import annotations

import numpy as np

from ..fit import Fit
from ..linear_system import LinearSystem
from ..weights import joint_sigma, per_row
from .problem import ConstrainedProblem
from .solver import triangle_of

CONTRADICTION = 1.5
"""Ratio of the constrained to the plain residual beyond which a cause is looked for."""
JOINT_CONTRADICTIONS = ((2.0, 0.1), (1.2, 0.5))
"""The same at a single joint: a ratio, and the relative error beyond which it counts."""
NAMED_JOINT_RESIDUAL = 0.75
"""Largest share of the constrained residual that reversing the torque of a joint may leave for the joint to be named."""
NOTHING = 0.5
"""Relative error of a constrained fit beyond which the model explains hardly anything."""


def diagnosis(system: LinearSystem, fit: Fit, problem: ConstrainedProblem) -> list[str]:
    """Sentences on torques that only parameters of no robot explain; empty for a sound log.

    Parameters
    ----------
    system : LinearSystem
        Rows along the measured motion.
    fit : Fit
        Consistent solution, with the record of both residuals.
    problem : ConstrainedProblem
        The problem that was solved.
    """
    plain, constrained = (fit.record.get(f"{key}_relative_error") for key in ("plain", "constrained"))
    if plain is None or constrained is None or not plain > 0.0:
        return []
    # A light wrist hardly counts in the error of all joints together.
    every = zip(fit.record["plain_relative_errors"], fit.record["constrained_relative_errors"], strict=True)
    joint = any(
        free is not None
        and any(held > ratio * free and held > least for ratio, least in JOINT_CONTRADICTIONS)
        for free, held in every
    )
    torn = constrained > CONTRADICTION * plain or joint
    if not torn and constrained <= NOTHING:
        return []
    percent = f"{100.0 * constrained:.3g} % (without conditions {100.0 * plain:.3g} %)"
    found = _reversed(system, fit, problem) if torn else []
    if found:
        return found
    if constrained > NOTHING:
        return [
            f"no robot explains these torques: the residual of physically consistent parameters is {percent}; check the "
            "direction of gravity, the mounting of the robot and the units of the torques"
        ]
    return [
        f"physical conditions raise the residual to {percent}: a model or a log that is wrong; check the signs of the torques, the "
        "direction of gravity and the friction model"
    ]


def _reversed(system: LinearSystem, fit: Fit, problem: ConstrainedProblem) -> list[str]:
    """Return the joint whose reversed torque leaves much less, or nothing."""
    # Weights of the torques themselves: residuals of the wrong sign would hide the joint.
    scale = per_row(system, 1.0 / joint_sigma(system, system.y))
    measured = system.measured
    known, sizes = measured - system.y, system.norms(measured)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    shares = []
    for joint in (None, *range(len(system.joints))):
        torque = measured.copy()
        if joint is not None:
            torque[system.joints[joint]] *= -1.0
        right = (torque - known) * scale
        triangle, side = triangle_of(system.w * scale[:, None], right)
        # Rows in units of their noise, as the weight of the prior wants them.
        noise = fit.record["constrained_relative_error"]
        x = problem.solve(triangle / noise, side / noise).x
        shares.append(system.norms(torque - known - system.w @ (problem.matrix @ x)) / sizes)
    # All joints count alike.
    together = np.sqrt(np.mean(np.square(shares), axis=1))
    best = int(np.argmin(together[1:]))
    if together[best + 1] > NAMED_JOINT_RESIDUAL * together[0]:
        return []
    plain, constrained = (fit.record[f"{key}_relative_errors"][best] for key in ("plain", "constrained"))
    return [
        f"the torque of joint {best + 1} looks reversed: the residual of physically consistent parameters is "
        f"{100.0 * constrained:.3g} % there (without conditions {100.0 * plain:.3g} %), and reversing that torque would bring it "
        f"to {100.0 * shares[best + 1][best]:.3g} %"
    ]
