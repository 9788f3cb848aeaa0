"""Friction: standstill, where its sign is that of the noise, and recordings in which it differs.

The friction torque ``f`` of a joint by the fit of all recordings, in the rows of one of them and zero in the others, weighted and
freed of the columns of (7), has as its least-squares factor the share by which that recording has more friction. Residuals
last, so its deviation is that of the sums over stretches of time. Tested in ``tests/test_check.py`` and
``tests/test_check_notes.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..methods.job import Job
from ..regression.fit import Fit
from ..regression.linear_system import LinearSystem
from ..result.finding import Finding, said
from ..robot.robot import Robot
from ..signal.segments import Segment

SLOW = 0.005
"""Speed, as a share of the top speed, below which a joint stands still if this lasts for `LONG_S`."""
LONG_S = 0.1
"""Shortest standstill (s): a reversal takes less."""
LARGEST_SHARE = 0.05
"""Share of a log at standstill from which it is reported: 17 % decided some friction parameters of a real log
(docs/tx40_recipes.md)."""


STRETCHES = 20
"""Number of stretches of a recording over which residuals are summed."""
CLEAR_DEVIATIONS = 3.5
"""Difference, in standard deviations, from which it is reported: 12 joints and logs give one false alarm in 200 experiments."""
CLEAR_SHARE = 0.03
"""Difference, as a share of the friction, from which it is reported."""


def check_standstill(robot: Robot, parts: list[Segment]) -> list[Finding]:
    """Tell joints that stand still for long, where Coulomb friction is a plain sign."""
    if robot.friction.coulomb != "sign":
        return []
    held = [term.joint for term in robot.friction.terms if term.law == "hold"]
    shares: dict[int, float] = {}
    for joint in range(robot.n_dof):
        if robot.friction.dead_zone[joint] > 0.0 or joint in held:
            continue
        top = max(float(np.abs(part.dq[:, joint]).max()) for part in parts)
        resting = sum(
            _resting(np.abs(part.dq[:, joint]) < SLOW * top, LONG_S * part.rate_hz) for part in parts
        )
        share = resting / sum(len(part.q) for part in parts)
        if share > LARGEST_SHARE:
            shares[joint + 1] = share
    if not shares:
        return []
    shown = ", ".join(f"{joint} ({100.0 * share:.0f} %)" for joint, share in shares.items())
    prismatic = robot.joint_kinds[next(iter(shares)) - 1] == "prismatic"
    return [
        said(
            kind="standstill",
            sentence=f"the arm rests in a part of the log, joint{'s' if len(shares) > 1 else ''} {shown}: there the noise "
            "of the velocity decides the sign of the Coulomb friction",
            advice=f"Write a dead zone under [friction], dead_zone_{'m' if prismatic else 'rad'}_s = "
            f"{'0.001' if prismatic else '0.01'}, or leave these times out with windows_s",
            joints=tuple(shares),
            value=max(shares.values()),
        )
    ]


def _resting(slow: np.ndarray[tuple[int], np.dtype[np.bool_]], shortest: float) -> int:
    """Count samples in stretches that are slow for long enough."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(int))).reshape(-1, 2)
    lengths = edges[:, 1] - edges[:, 0]
    return int(lengths[lengths >= shortest].sum())


def check_friction(job: Job, solved: tuple[LinearSystem, Fit] | None) -> list[Finding]:
    """Compare Coulomb and viscous friction of each joint in one recording with that in all of them."""
    recordings: Sequence[str] = [item.name for item in job.experiment.recordings]
    if solved is None or len({block.recording for block in solved[0].blocks}) < 2:
        return []
    system, fit = solved
    weights = fit.weights
    q, _ = np.linalg.qr(system.w * weights[:, None])
    residual = weights * (system.y - system.w @ fit.solution)
    found = []
    for joint, blocks in enumerate(system.joint_blocks):
        names = [f"{kind}{joint + 1}{side}" for kind in ("Fv", "Fc") for side in ("", "+", "-")]
        places = [system.names.index(name) for name in names if name in system.names]
        friction = system.w[:, places] @ fit.solution[places] * weights
        numbers = sorted({block.recording for block in blocks})
        # Of two recordings the second says it all.
        for number in numbers[1:] if len(numbers) == 2 else numbers:
            rows = np.concatenate(
                [
                    np.arange(block.rows.start, block.rows.stop)
                    for block in blocks
                    if block.recording == number
                ]
            )
            column = np.zeros_like(friction)
            column[rows] = friction[rows]
            column -= q @ (q.T @ column)
            size = float(column @ column)
            if size <= 0.0:
                continue
            share = float(column @ residual) / size
            left = column * (residual - share * column)
            sums = np.array([left[part].sum() for part in np.array_split(rows, STRETCHES)])
            std = float(np.sqrt(np.sum(sums**2) * STRETCHES / (STRETCHES - 1.0))) / size
            if abs(share) > max(CLEAR_SHARE, CLEAR_DEVIATIONS * std):
                found.append((joint, number, share, share / std))
    return [
        said(
            kind="friction-between",
            joints=(joint + 1,),
            recording=recordings[number],
            sentence=f"recording '{recordings[number]}': friction of joint {joint + 1} is {100.0 * abs(share):.1f} % "
            f"{'higher' if share > 0.0 else 'lower'} than in the others ({abs(z):.1f} sigma)",
            advice=f"Is the joint {'colder, or more' if share > 0.0 else 'warmer, or less'} loaded? Give the recording "
            'friction = "own", or a payload',
            value=share,
        )
        for joint, number, share, z in found
    ]
