"""Limits of a motion: those of the robot file, or of the design, with a margin.

Tested in ``tests/test_excitation.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._tools.arrays import Array, real_array
from .._tools.words import counted
from ..errors import ExcitationError
from ..robot.robot import Robot
from .settings import ExcitationSettings, Values

LARGEST_LIMIT = 1e9
"""Largest limit of a motion (SI), and inverse of the smallest: squares of its numbers stay far from the ends of floating point."""
ACCELERATION_TIME = 0.25
"""Time (s) to reach the velocity limit where no acceleration limit is known; the report says where it was used."""


@dataclass(frozen=True, kw_only=True)
class MotionLimits:
    """Limits of a motion, joint side, reduced by the margins; infinite without a limit.

    Attributes
    ----------
    lowest, highest : (n_dof,) arrays
        Positions (rad or m).
    velocity, acceleration, jerk, torque : (n_dof,) arrays
        Largest absolute values (per s, s^2, s^3; N.m or N).
    margin : float
        Ratio of these limits to the user's, for positions about the middle of the range.
    assumed : tuple of str
        Sentences on missing limits.
    """

    lowest: Array
    highest: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    torque: Array
    margin: float = 1.0
    assumed: tuple[str, ...] = ()

    @property
    def middle(self) -> Array:
        """Middle of the ranges of the positions, ``(n_dof,)``."""
        return np.asarray((self.highest + self.lowest) / 2.0)

    @property
    def whole(self) -> MotionLimits:
        """The user's limits, without the margin."""
        half = (self.highest - self.lowest) / 2.0 / self.margin
        largest = ("velocity", "acceleration", "jerk", "torque")
        whole = {name: getattr(self, name) / self.margin for name in largest}
        return replace(self, lowest=self.middle - half, highest=self.middle + half, margin=1.0, **whole)

    def use(self, q: Array, dq: Array, ddq: Array, jerk: Array) -> dict[str, Array]:
        """Return the largest use of each limit, as a share per joint; positions count from the middle of the range."""
        shares = {
            "position": (q - self.middle) / ((self.highest - self.lowest) / 2.0),
            "velocity": dq / self.velocity,
            "acceleration": ddq / self.acceleration,
            "jerk": jerk / self.jerk,
        }
        return {kind: np.asarray(np.abs(share).max(axis=0)) for kind, share in shares.items()}


def motion_limits(robot: Robot, settings: ExcitationSettings) -> MotionLimits:
    """Collect the limits of a motion: those of the settings, and of the robot where they give none.

    Raises
    ------
    ExcitationError
        For a joint without position or velocity limits, and for a limit out of range; the sentence names the joint
        (``test_excitation.py``).
    """
    margin = settings.margin
    ranges: Sequence[Sequence[float] | None] = settings.position or [limit.position for limit in robot.limits]
    n = robot.n_dof
    if not 0.0 < margin <= 1.0:
        raise ExcitationError(f"margin must be above 0 and at most 1, got {margin}")
    if len(ranges) != n:
        raise ExcitationError(f"position limits need {counted(n, 'pair')}, one per joint, got {len(ranges)}")
    lowest, highest = np.empty(n), np.empty(n)
    for joint, pair in enumerate(ranges):
        if pair is None:
            raise ExcitationError(
                f"robot {robot.name!r} has no position limits for joint {joint + 1}: give them in its file, or to excite"
            )
        low, high = (float(value) for value in pair)
        if not (low >= -LARGEST_LIMIT and low + 1.0 / LARGEST_LIMIT <= high <= LARGEST_LIMIT):
            raise ExcitationError(
                f"joint {joint + 1} has no room: its positions are limited to [{low:g}, {high:g}]"
            )
        middle, half = (low + high) / 2.0, margin * (high - low) / 2.0
        lowest[joint], highest[joint] = middle - half, middle + half
    speeds = _values(robot, "velocity", settings.velocity, [limit.velocity for limit in robot.limits])
    if np.isinf(speeds).any():
        joint = int(np.argmax(np.isinf(speeds)))
        raise ExcitationError(
            f"robot {robot.name!r} has no velocity limit for joint {joint + 1}: give it in its file, or to excite"
        )
    assumed = []
    accelerations = _values(robot, "acceleration", settings.acceleration, [None] * n)
    if np.isinf(accelerations).any():
        accelerations = np.where(np.isinf(accelerations), speeds / ACCELERATION_TIME, accelerations)
        assumed.append(
            f"no acceleration limits are known: the motion reaches the velocity limit in {ACCELERATION_TIME:g} s at best"
        )
    return MotionLimits(
        lowest=lowest,
        highest=highest,
        velocity=margin * speeds,
        acceleration=margin * accelerations,
        jerk=margin * _values(robot, "jerk", settings.jerk, [None] * n),
        torque=margin * _values(robot, "torque", settings.torque, [limit.effort for limit in robot.limits]),
        margin=margin,
        assumed=tuple(assumed),
    )


def _values(robot: Robot, name: str, given: Values, known: Sequence[float | None]) -> Array:
    """Return one positive number per joint, infinite without a limit."""
    if given is None:
        # Files of makers have 0 and 1e16 where no limit is known.
        values = np.array(
            [np.inf if value is None or not 0.0 < value <= LARGEST_LIMIT else value for value in known]
        )
    else:
        array = real_array(f"{name} limits", given, ExcitationError)
        if array.shape not in ((), (robot.n_dof,)):
            raise ExcitationError(
                f"{name} limits need one number or {robot.n_dof}, one per joint, got an array of shape {array.shape}"
            )
        values = np.broadcast_to(array, (robot.n_dof,)).astype(float)
    sensible = (values >= 1.0 / LARGEST_LIMIT) & ((values <= LARGEST_LIMIT) | np.isinf(values))
    if not sensible.all():
        joint = int(np.argmin(sensible))
        raise ExcitationError(
            f"the {name} limit of joint {joint + 1} must lie between {1.0 / LARGEST_LIMIT:g} and {LARGEST_LIMIT:g}, "
            f"got {values[joint]:g}"
        )
    return values
