"""Laws that the test for missing friction tries, each as a column per joint. Tested in ``tests/test_friction_alarm.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array
from ...model.memory import FADED, direction, start_column, state
from ...robot.robot import Robot
from ...signal.processing import SignalProcessing
from ...signal.window import Window
from .velocity import decimated

STRIBECK = (0.05, 0.1, 0.2, 0.4)
"""Stribeck velocities (rad/s) of the hypotheses; a factor of two changes the column clearly."""
ATAN = (0.05, 0.2, 0.8)
"""Velocities (rad/s) of the arctangents among the hypotheses."""
WIDTHS = (0.003, 0.01, 0.03, 0.1)
"""Displacements (rad) of Dahl's memory among the hypotheses."""
PRISMATIC = 0.1
"""Ratio of velocities and displacements of a prismatic joint (m/s, m) to those of a revolute one (rad/s, rad)."""
RESOLVED_STEPS = 20.0
"""Smallest number of encoder steps within the smallest of `WIDTHS`: quantisation by coarser steps looks like memory of any
width."""


@dataclass(frozen=True, eq=False)
class LawColumns:
    """Law at one velocity or width.

    Attributes
    ----------
    family : {"stribeck", "atan", "load", "dahl"}
        The law.
    columns : ndarray, shape (n_rows, n_dof)
        Decimated column of each joint, zero where the joint does not test it.
    amplitude : ndarray, shape (n_dof,)
        Largest friction along the log per unit of the column.
    width : ndarray, shape (n_dof,), or None
        Displacements of a law of memory, zero where it is not tested (rad or m).
    """

    family: str
    columns: Array
    amplitude: Array
    width: Array | None = None

    def start(self, parts: Sequence[Window], signal: SignalProcessing) -> Array | None:
        """Return the columns of the unknown state at the first sample, (n_rows, n_dof); None for a law without memory."""
        if self.width is None:
            return None
        joints = np.flatnonzero(self.width)
        values = [start_column(part.q[:, joints], self.width[joints]) for part in parts]
        columns = np.zeros_like(self.columns)
        columns[:, joints] = decimated(values, parts, signal)
        return columns


def joint_scales(robot: Robot) -> Array:
    """Return the factors of velocities and displacements of the laws, (n_dof,): 1 of revolute joints, `PRISMATIC` of others."""
    return np.array([1.0 if kind == "revolute" else PRISMATIC for kind in robot.joint_kinds])


def laws_to_test(
    robot: Robot,
    parts: Sequence[Window],
    signal: SignalProcessing,
    load: Sequence[Array],
    encoder_step: Array,
) -> list[LawColumns]:
    """Return the laws that are tested, with their decimated columns."""
    n = robot.n_dof
    unit = joint_scales(robot)
    known = {(term.law, term.joint) for term in robot.friction.terms}
    every = np.ones(n, dtype=bool)  # a curve of speed may bend at more than one velocity
    loaded = np.array([("load", joint) not in known for joint in range(n)])
    signs = [direction(robot, part.q, part.dq) for part in parts]
    laws: list[LawColumns] = []

    def add(family: str, values: Sequence[Array], joints: NDArray[np.bool_]) -> None:
        if joints.any():
            own = values if joints.all() else [value * joints for value in values]
            rows = decimated(own, parts, signal)
            # Transposed first, because numpy reduces rows of few columns slowly.
            largest = np.max([np.abs(value.T, order="C").max(axis=1) for value in values], axis=0)
            laws.append(LawColumns(family, rows, largest))

    for velocity in STRIBECK:
        values = [
            sign * np.exp(-np.minimum(np.square(part.dq / (velocity * unit)), FADED))
            for part, sign in zip(parts, signs, strict=True)
        ]
        add("stribeck", values, every)
    for velocity in ATAN:
        values = [
            np.arctan(part.dq / (velocity * unit)) - 0.5 * np.pi * sign
            for part, sign in zip(parts, signs, strict=True)
        ]
        add("atan", values, every)
    add("load", [np.abs(torque) * sign for torque, sign in zip(load, signs, strict=True)], loaded)
    resolved = WIDTHS[0] * unit >= RESOLVED_STEPS * encoder_step
    if resolved.any():
        widths = np.outer(WIDTHS, unit)
        memories = [state(part.q, widths) for part in parts]
        for k, width in enumerate(widths):
            values = [memory[k] - sign for memory, sign in zip(memories, signs, strict=True)]
            add("dahl", values, resolved)
            laws[-1] = replace(laws[-1], width=width * resolved)
    return laws
