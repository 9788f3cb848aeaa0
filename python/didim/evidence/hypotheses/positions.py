"""Positions read otherwise: a sign, a scale, a gear, a unit, a side, a rate, two exchanged. Tested in ``tests/test_check.py``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...log.units import POSITION, motor_ratios
from ..rows import LogRows
from ..thresholds import SCREEN
from .hypothesis import Hypothesis, best_factor, diagonal
from .torques import SMALLEST

DEGREE = POSITION["deg"]
"""Radians of a degree."""


def positions(rows: LogRows) -> Iterator[Hypothesis]:
    """Return hypotheses of a wrong sign of each position, with and without its torque."""
    n = rows.n
    for joint in range(n if n > 1 else 0):
        turn = diagonal(n, joint, -1.0)
        yield Hypothesis(code="position-sign", joints=(joint + 1,), position=np.diag(turn))
        yield Hypothesis(code="joint-sign", joints=(joint + 1,), position=np.diag(turn), factors=turn)


def exchanged(rows: LogRows) -> Iterator[Hypothesis]:
    """Return hypotheses of two exchanged positions, with and without their torques."""
    for i, j in combinations(range(rows.n), 2):
        order = list(range(rows.n))
        order[i], order[j] = j, i
        joints, swap = (i + 1, j + 1), np.eye(rows.n)[order]
        yield Hypothesis(code="swapped-positions", joints=joints, position=swap)
        yield Hypothesis(code="swapped-joints", joints=joints, position=swap, order=tuple(order))


def reversals(rows: LogRows) -> Iterator[Hypothesis]:
    """Return hypotheses of columns that begin with the last joint: positions, torques, or both."""
    if rows.n < 3:  # two joints are an exchange
        return
    order = tuple(range(rows.n))[::-1]
    for keys in (("position", "torque"), ("position",), ("torque",)):
        yield Hypothesis(
            code="reversed-order",
            position=np.eye(rows.n)[list(order)] if "position" in keys else None,
            order=order if "torque" in keys else None,
            facts={"keys": list(keys)},
        )


def scales(rows: LogRows) -> Iterator[Hypothesis]:
    """Return the best gear of each joint, the best scale of its encoder, and the best rate where no time stamps say it."""
    n = rows.n

    def gear(joint: int) -> Callable[[float], Hypothesis]:
        # A gear that is declared f times too small makes positions f times too large, and torques f times too small.
        return lambda f: Hypothesis(
            code="gear-ratio",
            joints=(joint + 1,),
            position=np.diag(diagonal(n, joint, 1.0 / f)),
            factors=diagonal(n, joint, 1.0 / f),
            value=f,
        )

    def encoder(joint: int) -> Callable[[float], Hypothesis]:
        return lambda f: Hypothesis(
            code="position-scale", joints=(joint + 1,), position=np.diag(diagonal(n, joint, f)), value=f
        )

    makers = [make(joint) for joint in range(n) for make in (gear, encoder)]
    if n == 1 and rows.known is None:
        return  # a single joint fits at any scale
    for make in makers:
        best, at_end = best_factor(lambda f, make=make: rows.rough_ratios(make(f)))  # type: ignore[misc]
        if best != 1.0 and not at_end:
            near = tuple(best * factor for factor in (0.9, 1.0, 1.1))
            best, _ = best_factor(lambda f, make=make: rows.seen(make(f)), near, promising=2.0)  # type: ignore[misc]
        if abs(np.log(best)) > SMALLEST:
            yield replace(make(best), at_end=at_end)
    if not rows.timed:
        best, at_end = best_factor(lambda f: rows.seen(_rate(f)))
        if abs(np.log(best)) > SMALLEST:
            yield replace(_rate(best), at_end=at_end)


def _rate(factor: float) -> Hypothesis:
    return Hypothesis(code="rate", rate=factor, value=factor)


def _unit(rows: LogRows) -> set[str | None]:
    unit = rows.origin.get("position", {}).get("unit")
    return set(unit if isinstance(unit, list) else [unit])


def units(rows: LogRows) -> Iterator[Hypothesis]:
    """Return positions in degrees or mrad for radians, in millimetres for metres, and the other way round."""
    declared = _unit(rows)
    for kind, own, other, factor in (
        ("revolute", "rad", "deg", np.pi / 180.0),
        ("revolute", "deg", "rad", 180.0 / np.pi),
        ("revolute", "rad", "mrad", 1e-3),
        ("revolute", "deg", "mrad", 1e-3 * 180.0 / np.pi),
        ("prismatic", "m", "mm", 1e-3),
        ("prismatic", "mm", "m", 1e3),
    ):
        concerned = [each == kind for each in rows.robot.joint_kinds]
        if any(concerned) and (declared == {None} or own in declared):
            yield Hypothesis(
                code="unit",
                joints=tuple(int(joint) + 1 for joint in np.flatnonzero(concerned)),
                position=np.diag(np.where(concerned, factor, 1.0)),
                facts={"unit": other, "declared": own},
            )


def sides(rows: LogRows) -> Iterator[Hypothesis]:
    """Return values of motors that are declared as those of joints, and the other way round.

    Degrees of joints may be radians of motors as well. Gears that no file declares are sought as one ratio for all joints.
    """
    side = {key: rows.origin.get(key, {}).get("side", "joint") for key in ("position", "torque")}
    reduction = rows.origin.get("reduction", rows.robot.reduction)
    r = np.eye(rows.n) if reduction is None else np.array(reduction)
    in_degrees = _unit(rows) == {"deg"} and side["position"] == "joint"
    if side["position"] == "joint" and rows.n > 1 and set(rows.robot.joint_kinds) == {"revolute"}:
        yield from _geared(rows, DEGREE if in_degrees else 1.0)
    if np.array_equal(r, np.eye(rows.n)):
        return
    position = np.asarray(np.linalg.inv(r) if side["position"] == "joint" else r, dtype=np.float64)
    torque = np.asarray(np.linalg.inv(r.T) if side["torque"] == "joint" else r.T, dtype=np.float64)
    for factor, unit in ((1.0, None), (1.0 / DEGREE, "rad"))[: 1 + in_degrees]:
        for keys in (("position", "torque"), ("position",), ("torque",))[: 3 if unit is None else 2]:
            yield Hypothesis(
                code="side",
                position=factor * position if "position" in keys else None,
                torque=torque if "torque" in keys else None,
                facts={
                    "keys": list(keys),
                    "declared": side[keys[0]],
                    "side": "motor" if side[keys[0]] == "joint" else "joint",
                    **({} if unit is None else {"unit": unit}),
                },
            )


def _geared(rows: LogRows, factor: float) -> Iterator[Hypothesis]:
    """Return positions of motors in radians behind gears of the ratio that fits best.

    `factor` turns logged values into declared ones. Torques are as good at any scale, so they are left alone.
    """

    def geared(ratio: float) -> Hypothesis:
        return Hypothesis(
            code="side",
            position=np.eye(rows.n) / (ratio * factor),
            facts={"keys": ["position"], "declared": "joint", "side": "motor", "ratio": ratio},
        )

    tried = motor_ratios()
    rough = [rows.rough(geared(ratio)) for ratio in tried]
    if min(rough) > SCREEN:
        return
    start = tried[int(np.argmin(rough))]
    best, _ = best_factor(lambda f: rows.seen(geared(f * start)), (0.9, 0.95, 1.0, 1.05, 1.1), promising=2.0)
    if abs(np.log(best * start * DEGREE)) > SMALLEST:  # degrees are a unit
        yield geared(float(f"{best * start:.3g}"))
