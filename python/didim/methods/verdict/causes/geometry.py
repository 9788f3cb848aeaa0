"""Hypotheses on the robot file: gravity, conventions, lengths, twists. Tested in ``tests/test_verdict_faults.py``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...._tools.arrays import Array
from ....robot.robot import Geometry, Robot
from .hypothesis import Hypothesis
from .rows import Rows

FACTORS = (0.8, 1.25)
"""Factors of a length that are tried; a parabola through their scores tells where the best one is."""
SMALLEST_LENGTH_M = 5e-3
"""Shorter lengths change no torque that a log shows."""
GRAVITY = 9.81
"""Size of gravity where the robot file declares none (m/s^2)."""


def with_geometry(robot: Robot, **changes: object) -> Robot:
    """Return a robot with other rows or gravity, and without what its file says of frames."""
    return replace(robot, geometry=replace(robot.geometry, **changes), correspondence=None, _named={})  # type: ignore[arg-type]


def gravities(rows: Rows) -> Iterator[Hypothesis]:
    """Return gravity along each axis of frame 0, either way, and away from where it points."""
    declared = np.array(rows.robot.geometry.gravity)
    size = float(np.linalg.norm(declared)) or GRAVITY
    directions = [sign * size * axis for axis in np.eye(3) for sign in (-1.0, 1.0)]
    if declared.any():
        directions.append(-declared)
    tried: list[Array] = [declared]
    for direction in directions:
        if any(np.allclose(direction, other, atol=1e-3 * size) for other in tried):
            continue
        tried.append(direction)
        products = rows.of_robot(with_geometry(rows.robot, gravity=tuple(direction.tolist())))
        if products is not None:
            text = ", ".join(f"{value + 0.0:.3g}" for value in direction)  # zero has no sign
            yield Hypothesis(
                code="gravity",
                sentence=f"gravity looks as if it were [{text}] m/s^2 in frame 0, not {_vector(declared)}",
                advice=f"Write gravity_m_s2 = [{text}] in the robot file, or look at how the robot is mounted",
                score=products.score(rows.weights),
                simplicity=2,
            )


def conventions(rows: Rows) -> Iterator[Hypothesis]:
    """Return the same rows read by the other convention, and with a and d exchanged."""
    g = rows.robot.geometry
    n = len(g.kinds)
    if n < 2 or g.mounts:  # the rows of a tree have one convention
        return
    readings: list[tuple[str, str, str, dict[str, object]]] = []
    if rows.robot.standard is not None:
        other = {"alpha": tuple(rows.robot.standard.alpha), "d": tuple(rows.robot.standard.a)}
        names = ("modified convention (Khalil-Kleinfinger)", "standard one", "mdh")
    else:
        # Modified rows have the twist and the length of the link before; standard ones have their own.
        other = {"alpha": (0.0, *g.alpha[:-1]), "d": (0.0, *g.d[:-1])}
        names = ("standard convention (Denavit-Hartenberg)", "modified one", "dh")
    if rows.robot.correspondence is None:  # a URDF has no convention
        readings.append(
            (
                "dh-convention",
                f"the rows of the robot file look as if they were of the {names[0]}, not the {names[1]}",
                f'Write convention = "{names[2]}" in the robot file',
                dict(other),
            )
        )
    exchange = (
        "a-and-d",
        "the lengths a and d of the robot file look exchanged",
        "Exchange them, row by row",
    )
    readings += [
        (*exchange, {"d": g.r, "r": g.d}),
        (*exchange, {"d": (g.d[0], *g.r[:-1]), "r": (*g.d[1:], g.r[-1])}),
    ]
    for code, sentence, advice, changes in readings:
        if all(np.allclose(getattr(g, key), value) for key, value in changes.items()):  # type: ignore[arg-type]
            continue
        products = rows.of_robot(with_geometry(rows.robot, **changes))
        if products is not None:
            yield Hypothesis(
                code=code, sentence=sentence, advice=advice, score=products.score(rows.weights), simplicity=3
            )


def twists(rows: Rows) -> Iterator[Hypothesis]:
    """Return each twist turned, and the positions of each joint turned, with and without its torques."""
    g = rows.robot.geometry
    for joint, alpha in enumerate(g.alpha):
        if abs(np.sin(alpha)) < 1e-6 or g.mounts:
            continue
        products = rows.of_robot(with_geometry(rows.robot, alpha=_changed(g.alpha, joint, -alpha)))
        if products is not None:
            yield Hypothesis(
                code="twist-sign",
                sentence=f"the twist alpha of row {row_of(rows.robot, 'alpha', joint)} looks as if its sign were wrong",
                advice="Turn its sign in the robot file",
                joints=(joint + 1,),
                score=products.score(rows.weights),
                simplicity=4,
            )
    n = len(g.kinds)
    if n < 2:
        return
    for joint in range(n):
        flip = np.eye(n)
        flip[joint, joint] = -1.0
        gains = np.stack([np.ones(n), np.diag(flip)])
        turned = rows.of_motion(flip, gains)
        if turned is None:
            continue
        sides = (
            ("position-sign", gains[0], "the position of joint {} looks as if its sign were wrong"),
            ("joint-sign", gains[1], "joint {} looks as if it turned the other way"),
        )
        for code, gain, sentence in sides:
            yield Hypothesis(
                code=code,
                sentence=sentence.format(joint + 1),
                advice="Turn the sign of its column, or of its axis in the robot file",
                joints=(joint + 1,),
                score=turned.score(rows.weights, gain),
                simplicity=4,
            )


def lengths(rows: Rows) -> Iterator[Hypothesis]:
    """Return the best factor of each length."""
    g: Geometry = rows.robot.geometry
    standard = rows.robot.standard is not None
    for key, symbol in (
        (("d", "a (a_m)"), ("r", "d (d_m)")) if standard else (("d", "a (d_m)"), ("r", "d (r_m)"))
    ):
        values: tuple[float, ...] = getattr(g, key)
        for joint, value in enumerate(values):
            prismatic = key == "r" and g.kinds[joint] == "prismatic"
            if abs(value) < SMALLEST_LENGTH_M or prismatic:
                continue

            def changed(
                factor: float,
                key: str = key,
                values: tuple[float, ...] = values,
                joint: int = joint,
                value: float = value,
            ) -> Robot:
                return with_geometry(rows.robot, **{key: _changed(values, joint, factor * value)})

            shares = {1.0: 1.0, **{factor: rows.rough_share(changed(factor)) for factor in FACTORS}}
            factor = _bottom(shares)
            if min(shares.values()) >= 0.98 or factor == 1.0:
                continue  # the log says nothing against this length
            products = rows.of_robot(changed(factor))
            if products is None:
                continue
            yield Hypothesis(
                code="link-length",
                sentence=f"the length {symbol} of row {row_of(rows.robot, key, joint)} looks as if it were {factor * value:.4g} m, "
                f"not {value:.4g} m",
                advice="Measure it, or look at the data sheet",
                joints=(joint + 1,),
                score=products.score(rows.weights),
                simplicity=5,
                value=factor * value,
            )


def row_of(robot: Robot, key: str, joint: int) -> int:
    """Return the row of the file that a twist or length is in: a standard table has those before a joint in the row before."""
    return joint if robot.standard is not None and key != "r" else joint + 1


def _bottom(scores: dict[float, float]) -> float:
    """Return the factor at the bottom of the parabola through three scores, within a factor of two."""
    logs = np.log(list(scores))
    a, b, _ = np.polyfit(logs, list(scores.values()), 2)
    if not a > 0.0:
        return min(scores, key=lambda factor: scores[factor])
    return float(np.exp(np.clip(-b / (2.0 * a), -0.7, 0.7)))


def _changed(values: tuple[float, ...], place: int, value: float) -> tuple[float, ...]:
    return (*values[:place], value, *values[place + 1 :])


def _vector(values: Array) -> str:
    return f"[{', '.join(f'{value:.3g}' for value in values)}]"
