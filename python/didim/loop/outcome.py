"""Outcome and integration error of a simulation. Tested in ``tests/test_simulation.py``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

from .._tools.arrays import Array

LARGE_ERROR = 0.01
"""Integration error, as a share of the torque (rms), from which a smaller step is recommended."""


class SimulationStatus(Enum):
    """Ending of a simulation; the value is a sentence.

    Tested in ``tests/test_simulation.py``.
    """

    COMPLETED = "The simulation ran to its end."
    DIVERGED = "The simulation diverged: the controller does not hold this robot."
    INDEFINITE = "The simulation ended: M(q) is not positive definite, so that no such robot exists."


@dataclass(frozen=True)
class Outcome:
    """Outcome of the run of one candidate.

    Attributes
    ----------
    status : SimulationStatus
        Ending of the run.
    time_s : float or None
        Time (s) of an early end.
    joint : int or None
        Joint concerned, from 1.
    """

    status: SimulationStatus
    time_s: float | None = None
    joint: int | None = None

    @property
    def completed(self) -> bool:
        """Whether the run reached its end."""
        return self.status is SimulationStatus.COMPLETED

    def of_limb(self, joints: Sequence[int]) -> Outcome:
        """Return the outcome in a robot, of a run of a limb with some of its joints, from 0."""
        return self if self.joint is None else replace(self, joint=joints[self.joint - 1] + 1)

    def __str__(self) -> str:
        if self.status is SimulationStatus.DIVERGED:
            return (
                f"diverged at {self.time_s:.4g} s: joint {self.joint} has left its reference; the controller does "
                "not hold this robot, or the step is too large"
            )
        if self.status is SimulationStatus.INDEFINITE:
            return (
                f"ended at {self.time_s:.4g} s: M(q) is not positive definite, the inertia at joint {self.joint} "
                "is not positive with these parameters"
            )
        return "completed"


@dataclass(frozen=True)
class IntegrationError:
    """Estimate of the error of the integration, from the same run with half the steps.

    Attributes
    ----------
    q : (n_dof,) array
        Largest position error (rad or m).
    tau : (n_dof,) array
        Torque error, rms (N.m or N).
    tau_relative : float
        The largest ratio of that to the rms torque of the joint.
    """

    q: Array
    tau: Array
    tau_relative: float

    @property
    def large(self) -> bool:
        """Whether the step is too large for accurate torques."""
        return not self.tau_relative <= LARGE_ERROR


def outcomes_of(endings: Sequence[tuple[int, float, int]]) -> tuple[Outcome, ...]:
    """Return the outcomes for the core's endings ``(kind, time, joint)``."""
    kinds = (SimulationStatus.COMPLETED, SimulationStatus.DIVERGED, SimulationStatus.INDEFINITE)
    # The core evaluates 1e-9 of a step inside, which is removed by rounding.
    return tuple(
        Outcome(kinds[0]) if kind == 0 else Outcome(kinds[kind], round(time, 9), joint + 1)
        for kind, time, joint in endings
    )


def first_to_end(outcomes: Sequence[Outcome]) -> Outcome:
    """Return the outcome of a robot from those of its limbs: the one that ended first."""
    return min(outcomes, key=lambda outcome: math.inf if outcome.time_s is None else outcome.time_s)
