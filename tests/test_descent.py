"""Gauss-Newton steps that are halved while they raise the cost."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import pytest

from didim.regression.descent import LENGTHS, descend


@dataclass(frozen=True)
class Number:
    """A number whose Gauss-Newton step is that of ``|value - 1|``, times a factor that is wrong."""

    value: float
    factor: float = 1.0
    small: float = 1e-6
    seen: list[float] = field(default_factory=list)

    @property
    def cost(self) -> float:
        return abs(self.value - 1.0)

    def moved(self, share: float) -> Number:
        there = self.value + share * self.factor * (1.0 - self.value)
        self.seen.append(there)
        return Number(there, self.factor, self.small, self.seen)

    def rests(self, share: float) -> bool:
        return abs(share * self.factor * (1.0 - self.value)) < self.small


def test_a_right_step_is_taken_whole() -> None:
    start = Number(5.0)
    point, steps, settled = descend(start, 10)
    assert (point.value, steps, settled) == (1.0, 2, True)
    assert start.seen == [1.0, 1.0]


def test_a_step_that_is_too_long_is_halved_until_the_cost_falls() -> None:
    """Three times the step leaves twice the error; half of that leaves half of it on the other side."""
    start = Number(2.0, factor=3.0)
    point, _, _ = descend(start, 1)
    assert start.seen == [-1.0, 0.5]
    assert point.value == 0.5


def test_a_step_that_only_circles_ends() -> None:
    """Twice the step changes the sign of the error for ever: such a step does not raise the cost."""
    point, steps, settled = descend(Number(2.0, factor=2.0), 7)
    assert (abs(point.value - 1.0), steps, settled) == (1.0, 7, False)


def test_a_step_that_only_rises_is_taken_at_its_last_length() -> None:
    start = Number(2.0, factor=-1.0)
    point, steps, settled = descend(start, 1)
    assert len(start.seen) == LENGTHS
    assert point.value == pytest.approx(2.0, abs=2.0 ** (1 - LENGTHS))
    assert (steps, settled) == (1, False)


@pytest.mark.parametrize(("small", "steps"), [(0.1, 4), (1e-3, 10)])
def test_the_last_step_is_a_small_one(small: float, steps: int) -> None:
    """Half of each error is taken, so that the error after k steps is 2^-k."""
    point, taken, settled = descend(Number(2.0, factor=0.5, small=small), 99)
    assert (taken, settled) == (steps, True)
    assert math.log2(point.cost) == pytest.approx(-taken)
