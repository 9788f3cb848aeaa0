"""Whether the load that a log gives is one: seen at all, a body, and not in the robot already.

Tested in ``tests/test_wrong_calls.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._tools.arrays import Array
from ...result.finding import Finding
from ...result.uncertainty import student_factor
from ...robot.rigid_body import INERTIAL

CLEAR_SIGMA = 5.0
"""Standard deviations by which mass or first moments of a load must differ from zero."""
ABSURD = 10.0
"""Torques of a load over those of the robot itself, root mean squares over all joints, beyond which no arm carries it: arms carry
at most about their own mass, and their links weigh on the same joints."""
MOMENTS = tuple(INERTIAL.index(name) for name in ("M", "MX", "MY", "MZ"))
"""Places of mass and first moments among the ten parameters."""
MASS = INERTIAL.index("M")
"""Place of the mass."""


def clearly_loaded(ten: Array, std: Array) -> bool:
    """Whether mass or first moments of a payload, of its ten parameters, differ clearly from zero."""
    return bool((np.abs(ten) > CLEAR_SIGMA * std)[list(MOMENTS)].any())


def load_findings(
    ten: Array, std: Array, freedom: float, names: Sequence[str], ratio: float, *, same_log: bool
) -> list[Finding]:
    """Return what speaks against a load.

    Parameters
    ----------
    ten, std : (10,) arrays
        Its parameters about the flange, and their standard deviations; zero for known and unidentifiable ones.
    freedom : float
        Degrees of freedom of the intervals.
    names : sequence of str
        Names of those that are estimated.
    ratio : float
        Torques of the load over those of the robot itself.
    same_log : bool
        Whether the log is one that the robot was fitted to, with its load as a part of the robot.
    """
    mass, sigma = float(ten[MASS]), float(std[MASS])
    value, deviation = (mass, sigma) if "M" in names else (None, None)
    if not clearly_loaded(ten, std):
        bound = mass + student_factor(0.95, freedom) * sigma if "M" in names else None
        return [
            Finding(
                code="no-load",
                grade="wrong" if same_log else "doubtful",
                value=bound,
                facts={"same": same_log},
            )
        ]
    if "M" in names and mass < -CLEAR_SIGMA * sigma:
        return [Finding(code="load-inside", grade="wrong", value=mass, deviation=sigma)]
    if ratio > ABSURD:
        return [Finding(code="absurd-load", grade="wrong", value=value, deviation=deviation, effect=ratio)]
    return []


def body_findings(half_distance: float, n_unknown: int) -> list[Finding]:
    """Return the finding of an estimate further from every body than noise explains: half the squared distance (nats)."""
    if not half_distance > n_unknown:
        return []
    return [Finding(code="no-body", grade="doubtful", value=half_distance)]
