"""Standstill, where the noise of the velocity decides the sign of the friction. Tested in ``tests/test_check.py``."""

from __future__ import annotations

import math

import numpy as np

from .._tools.arrays import true_ranges
from .._tools.words import series
from ..result.finding import Finding, worded
from ..robot.robot import Robot
from ..signal.window import Window

SLOW = 0.005
"""Speed, as a share of the top speed, below which a joint stands still if this lasts for `LONG_S`."""
LONG_S = 0.1
"""Shortest standstill (s): a reversal takes less."""
LARGEST_SHARE = 0.05
"""Share of a log at standstill from which it is reported: 17 % decided some friction parameters of a real log
(docs/published.md)."""


def check_standstill(robot: Robot, parts: list[Window]) -> list[Finding]:
    """Report joints that stand still for long, where Coulomb friction is a plain sign."""
    if robot.friction.coulomb != "sign":
        return []
    held = [term.joint for term in robot.friction.terms if term.law == "hold"]
    shares: dict[int, float] = {}
    for joint in range(robot.n_dof):
        if robot.friction.dead_zone[joint] > 0.0 or joint in held:
            continue
        top = max(float(np.abs(part.dq[:, joint]).max()) for part in parts)
        resting = sum(
            stop - start
            for part in parts
            for start, stop in true_ranges(
                np.abs(part.dq[:, joint]) < SLOW * top, math.ceil(LONG_S * part.rate_hz)
            )
        )
        share = resting / sum(len(part.q) for part in parts)
        if share > LARGEST_SHARE:
            shares[joint + 1] = share
    if not shares:
        return []
    shown = series((f"{joint} ({100.0 * share:.0f} %)" for joint, share in shares.items()), 60)
    prismatic = robot.joint_kinds[next(iter(shares)) - 1] == "prismatic"
    return [
        worded(
            kind="standstill",
            sentence=f"the arm rests in a part of the log, joint{'s' if len(shares) > 1 else ''} {shown}: there the noise "
            "of the velocity decides the sign of the Coulomb friction",
            advice="Leave these times out with windows_s, where any torque within stiction is possible; inside a motion, write "
            f"a dead zone under [friction], dead_zone_{'m' if prismatic else 'rad'}_s = {'0.001' if prismatic else '0.01'}",
            joints=tuple(shares),
            value=max(shares.values()),
        )
    ]
