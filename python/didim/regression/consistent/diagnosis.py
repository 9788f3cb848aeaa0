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
CLEAR = 0.75
"""Share of the constrained residual that must be left at most for a joint to be named."""
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
    if constrained <= CONTRADICTION * plain and constrained <= NOTHING:
        return []
    percent = f"{100.0 * constrained:.3g} % (without conditions {100.0 * plain:.3g} %)"
    found = [] if constrained <= CONTRADICTION * plain else _reversed(system, problem, plain, constrained)
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


def _reversed(
    system: LinearSystem, problem: ConstrainedProblem, plain: float, constrained: float
) -> list[str]:
    """Return the joint whose reversed torque leaves much less, or nothing."""
    # Weights of the torques themselves: residuals of the wrong sign would hide the joint.
    scale = per_row(system, 1.0 / joint_sigma(system, system.y))
    measured = system.measured
    known = measured - system.y
    shares = []
    for joint in (None, *range(len(system.joints))):
        torque = measured.copy()
        if joint is not None:
            torque[system.joints[joint]] *= -1.0
        right = (torque - known) * scale
        triangle, side = triangle_of(system.w * scale[:, None], right)
        # Rows in units of their noise, as the weight of the prior wants them.
        noise = constrained
        x = problem.solve(triangle / noise, side / noise).x
        error = torque - known - system.w @ (problem.matrix @ x)
        shares.append(float(np.linalg.norm(error) / np.linalg.norm(measured)))
    best = int(np.argmin(shares[1:]))
    if shares[best + 1] > CLEAR * min(shares[0], constrained):
        return []
    return [
        f"the torque of joint {best + 1} looks reversed: the residual of physically consistent parameters is "
        f"{100.0 * constrained:.3g} % (without conditions {100.0 * plain:.3g} %), and reversing that torque would bring it to "
        f"{100.0 * shares[best + 1]:.3g} %"
    ]
