"""Standstill, where the noise of the velocity decides the sign of the friction. Tested in ``tests/test_check.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from .._tools.arrays import quotient
from .._tools.words import series
from ..regression.friction.candidates import LEAST_REST, at_rest
from ..result.finding import Finding, worded
from ..result.identification import Identification
from ..robot.robot import Robot
from ..signal.window import Window
from .rows import LogRows
from .thresholds import FRICTION_SHIFT


def check_standstill(
    robot: Robot, parts: Sequence[Window], rows: LogRows | None = None, fit: Identification | None = None
) -> list[Finding]:
    """Report joints that stand still for long, where Coulomb friction is a plain sign.

    With rows and a result it is doubtful where parameters move without the rows at rest, by `FRICTION_SHIFT` of their deviations.
    """
    rests = at_rest(robot, parts)
    shares = np.mean(np.concatenate(rests), axis=0)
    joints = [int(joint) for joint in np.flatnonzero(shares > LEAST_REST)]
    if not joints:
        return []
    effect = None if rows is None or fit is None else _effect(rows, fit)
    grade: Literal["doubtful", "note"] = "doubtful" if effect is None or effect > FRICTION_SHIFT else "note"
    shown = series((f"{joint + 1} ({100.0 * shares[joint]:.0f} %)" for joint in joints), 60)
    prismatic = robot.joint_kinds[joints[0]] == "prismatic"
    return [
        worded(
            kind="standstill",
            grade=grade,
            sentence=f"the arm rests in a part of the log, joint{'s' if len(joints) > 1 else ''} {shown}: there the noise "
            "of the velocity decides the sign of the Coulomb friction",
            advice="Leave these times out with windows_s, where any torque within stiction is possible; inside a motion, write "
            f"a dead zone under [friction], dead_zone_{'m' if prismatic else 'rad'}_s = {'0.001' if prismatic else '0.01'}",
            joints=tuple(joint + 1 for joint in joints),
            value=float(shares[joints].max()),
            sigmas=effect,
        )
    ]


def _effect(rows: LogRows, fit: Identification) -> float:
    """Return the largest change of a parameter without the rows at rest, in its standard deviations."""
    moving = rows.reduced(at_rest(rows.robot, rows.parts)) < 0.5
    error = np.sqrt(np.mean(np.square(rows.y - rows.w @ rows.declared.beta), axis=1))
    weight = quotient(np.ones_like(error), error)[:, None]
    solutions = []
    for kept in (np.ones_like(moving), moving):
        scale = (weight * kept)[:, :, None]
        a = (rows.w * scale).reshape(-1, rows.w.shape[2])
        solutions.append(np.linalg.lstsq(a, (rows.y * scale[:, :, 0]).reshape(-1), rcond=None)[0])
    change = np.abs(solutions[1] - solutions[0])[: len(fit.std)]
    return float(np.max(quotient(change, fit.std[: len(change)]), initial=0.0))
