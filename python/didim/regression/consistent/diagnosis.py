"""Faults of a log that least squares hides: comparison of the residuals with and without physical constraints.

Without constraints, physically impossible parameters can compensate for a reversed torque or a wrong gravity. Tested in
``tests/test_consistent.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..fit import Fit

CONTRADICTION = 1.25
"""Ratio of the constrained to the plain residual, the plain one without its degrees of freedom, above which a cause is sought.
Chosen on the packaged TX40, whose published parameters are no robot's (1.48); first fits of eight real logs of TX40, EMPS, UR10e,
UR10 and Panda have 1.00 to 1.11, and only counted."""
JOINT_CONTRADICTIONS = ((2.0, 0.1), (1.2, 0.5))
"""Pairs for a single joint: ratio of the constrained to the plain residual, and relative error, above which a cause is
sought."""
NOTHING = 0.5
"""Relative error of a constrained fit above which the model explains hardly anything."""
ROUNDING = float(np.sqrt(np.finfo(float).eps))
"""Relative error of a constrained fit below which it is that of the solver."""


@dataclass(frozen=True)
class Contradiction:
    """Torques that only physically impossible parameters explain.

    Attributes
    ----------
    plain, constrained : float
        Relative errors without and with the conditions of a robot, all joints together.
    hopeless : bool
        Whether the model explains hardly anything.
    """

    plain: float
    constrained: float
    hopeless: bool = False


def diagnosis(fit: Fit) -> list[Contradiction]:
    """Return what only parameters of no robot explain; empty for a sound log.

    Parameters
    ----------
    fit : Fit
        Consistent solution along the measured motion, with the record of both residuals.
    """
    plain, constrained = (fit.record.get(f"{key}_relative_error") for key in ("plain", "constrained"))
    if plain is None or constrained is None or not plain > 0.0 or constrained < ROUNDING:
        return []
    # Least squares without conditions follows the noise of a short log, which a robot cannot.
    rows, unknowns = len(fit.residual), len(fit.solution)
    follows = np.sqrt(rows / max(rows - unknowns, 1))
    # A light wrist hardly counts in the error of all joints together.
    every = zip(fit.record["plain_relative_errors"], fit.record["constrained_relative_errors"], strict=True)
    joint = any(
        free is not None
        and any(held > ratio * follows * free and held > least for ratio, least in JOINT_CONTRADICTIONS)
        for free, held in every
    )
    torn = constrained > CONTRADICTION * follows * plain or joint
    if not torn and constrained <= NOTHING:
        return []
    return [Contradiction(float(plain), float(constrained), hopeless=constrained > NOTHING)]
