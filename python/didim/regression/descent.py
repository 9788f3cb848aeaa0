"""Gauss-Newton steps on what rows depend on nonlinearly: drive gains, delays, velocities of friction laws.

Tested in ``tests/test_descent.py``.
"""

from __future__ import annotations

from typing import Protocol, Self, TypeVar

LENGTHS = 12
"""Largest number of lengths of a step that are tried, each half of the one before; the last is taken whatever its cost."""
ROUNDING = 1e-9
"""Rise of the cost, as a share of it, that counts as none."""


class Point(Protocol):
    """Values of the unknowns, with what was computed there."""

    @property
    def cost(self) -> float:
        """What is minimised."""

    def moved(self, share: float) -> Self:
        """Return the point at a share of the Gauss-Newton step from here."""

    def rests(self, share: float) -> bool:
        """Whether a share of the step from here is so small that it is the last."""


P = TypeVar("P", bound=Point)


def descend(start: P, most: int) -> tuple[P, int, bool]:
    """Take Gauss-Newton steps, each halved while it raises the cost.

    Parameters
    ----------
    start : Point
        Where the search begins.
    most : int
        Upper bound of the number of steps.

    Returns
    -------
    point : Point
        The last one.
    steps : int
        Number of steps.
    settled : bool
        Whether the last step was small enough.
    """
    point = start
    for number in range(1, most + 1):
        share = 1.0
        for _ in range(LENGTHS):
            there = point.moved(share)
            if there.cost <= point.cost + ROUNDING * abs(point.cost):
                break
            share *= 0.5
        settled, point = point.rests(share), there
        if settled:
            return point, number, True
    return point, most, False
