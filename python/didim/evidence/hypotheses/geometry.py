"""The robot file read otherwise: gravity, conventions, twists, lengths. Tested in ``tests/test_evidence_causes.py``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ..._tools.arrays import Array
from ...robot.robot import Robot
from ...robot.robot_file import packaged_robots
from ..rows import LogRows
from .hypothesis import Hypothesis, best_factor

SMALLEST_LENGTH_M = 5e-3
"""Length (m) below which a row of the robot file has no visible effect on the torques."""
GRAVITY = 9.81
"""Gravity (m/s^2) where the robot file declares none."""


def with_geometry(robot: Robot, **changes: object) -> Robot:
    """Return a robot with other rows or gravity, without the frames of its file."""
    return replace(robot, geometry=replace(robot.geometry, **changes), correspondence=None, _named={})  # type: ignore[arg-type]


def other_robots(rows: LogRows) -> Iterator[Hypothesis]:
    """Return the geometry of each included robot with the same kinds of joints, mounted as its file says or as declared."""
    declared = rows.robot.geometry
    if declared.mounts or rows.known is not None:  # known parameters are those of the declared rows
        return
    for name, included in _included().items():
        other = included.geometry
        table = {key: getattr(other, key) for key in ("alpha", "d", "theta", "r")}
        if name == rows.robot.name or other.kinds != declared.kinds or other.mounts:
            continue
        if all(getattr(declared, key) == values for key, values in table.items()):
            continue
        for gravity in dict.fromkeys((other.gravity, declared.gravity)):
            robot = with_geometry(rows.robot, **table, gravity=gravity)
            yield Hypothesis(
                code="another-robot", robot=robot, facts={"robot": name, "declared": rows.robot.name}
            )


_included = lru_cache(packaged_robots)


def gravities(rows: LogRows) -> Iterator[Hypothesis]:
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
        yield Hypothesis(
            code="gravity",
            robot=with_geometry(rows.robot, gravity=tuple(direction.tolist())),
            facts={"vector": [value + 0.0 for value in direction.tolist()], "declared": declared.tolist()},
        )


def of_other_convention(robot: Robot) -> Robot:
    """Return a robot whose rows of lengths and twists are read by the other Denavit-Hartenberg convention."""
    g = robot.geometry
    if robot.standard is not None:
        return with_geometry(robot, alpha=tuple(robot.standard.alpha), d=tuple(robot.standard.a))
    # Modified rows have the twist and the length of the link before; standard ones have their own.
    return with_geometry(robot, alpha=(0.0, *g.alpha[:-1]), d=(0.0, *g.d[:-1]))


def conventions(rows: LogRows) -> Iterator[Hypothesis]:
    """Return the same rows read by the other convention, and with a and d exchanged."""
    g, robot = rows.robot.geometry, rows.robot
    if len(g.kinds) < 2 or g.mounts:  # the rows of a tree have one convention
        return
    hypotheses = [
        ("a-and-d", with_geometry(robot, d=tuple(g.r), r=tuple(g.d))),
        ("a-and-d", with_geometry(robot, d=(g.d[0], *g.r[:-1]), r=(*g.d[1:], g.r[-1]))),
    ]
    if robot.correspondence is None:  # a URDF has no convention
        hypotheses.insert(0, ("dh-convention", of_other_convention(robot)))
    for code, changed in hypotheses:
        other = changed.geometry
        if not all(np.allclose(getattr(g, key), getattr(other, key)) for key in ("alpha", "d", "r")):
            yield Hypothesis(code=code, robot=changed, facts={"standard": robot.standard is not None})


def twists(rows: LogRows) -> Iterator[Hypothesis]:
    """Return a hypothesis for each twist with the other sign."""
    g = rows.robot.geometry
    for joint, alpha in enumerate(g.alpha):
        if abs(np.sin(alpha)) > 1e-6 and not g.mounts:
            changed = _changed(rows.robot.geometry.alpha, joint, -alpha)
            yield Hypothesis(
                code="twist-sign",
                joints=(joint + 1,),
                robot=with_geometry(rows.robot, alpha=changed),
                facts=place_of(rows.robot, "alpha", joint),
            )


def lengths(rows: LogRows) -> Iterator[Hypothesis]:
    """Return hypotheses for each length: its best factor, and the other sign."""
    g = rows.robot.geometry
    for key, symbol in (
        (("d", "a"), ("r", "d")) if rows.robot.standard is not None else (("d", "d"), ("r", "r"))
    ):
        values: tuple[float, ...] = getattr(g, key)
        for joint, value in enumerate(values):
            prismatic = key == "r" and g.kinds[joint] == "prismatic"
            if abs(value) < SMALLEST_LENGTH_M or prismatic:
                continue

            def made(
                factor: float,
                key: str = key,
                symbol: str = symbol,
                values: tuple[float, ...] = values,
                j: int = joint,
            ) -> Hypothesis:
                return Hypothesis(
                    code="link-length",
                    joints=(j + 1,),
                    robot=with_geometry(rows.robot, **{key: _changed(values, j, factor * values[j])}),
                    value=factor * values[j],
                    facts={
                        "symbol": f"{symbol}_m",
                        "declared": values[j],
                        **place_of(rows.robot, key, j),
                    },
                )

            yield made(-1.0)
            best, at_end = best_factor(
                lambda factor, made=made: rows.rough_ratios(made(factor))  # type: ignore[misc]
            )
            if best != 1.0:
                yield replace(made(best), at_end=at_end)


def place_of(robot: Robot, key: str, joint: int) -> dict[str, object]:
    """Return the row of the file that a twist or length is in, from 1, and whether it is a URDF, which has no rows.

    A standard table has the twist and the length before a joint in the row before.
    """
    row = joint if robot.standard is not None and key != "r" else joint + 1
    return {"row": row, "urdf": robot.correspondence is not None}


def _changed(values: tuple[float, ...], index: int, value: float) -> tuple[float, ...]:
    return (*values[:index], value, *values[index + 1 :])
