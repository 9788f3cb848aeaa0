"""The whole motion for a controller: a ramp from the robot's home, the periods, and a ramp back.

Tested in ``tests/test_excitation.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..errors import ExcitationError
from ..loop.reference import Reference
from .clearance import Clearance
from .limits import MotionLimits
from .settings import sample_count

LOOKS = 400
"""Number of samples of a ramp on which torques and clearances are verified."""
PEAKS = (15.0 / 8.0, 10.0 / np.sqrt(3.0), 60.0)
"""Largest velocity, acceleration and jerk of the quintic from 0 to 1 within 1 s, at rest at both ends."""
MOST_LONGER = 20
"""Largest number of prolongations; a torque that is still too large comes from the path itself."""
LONGER = 1.25
"""Factor by which a ramp is prolonged until its torques keep their limits."""


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """A quintic from rest to rest.

    Attributes
    ----------
    start, end : (n_dof,) arrays
        Positions (rad or m).
    duration : float
        Length (s).
    """

    start: Array
    end: Array
    duration: float

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations at times within the ramp, ``(n_times, n_dof)`` each."""
        u = t / self.duration
        span = self.end - self.start
        s = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        ds = 30.0 * u**2 * (1.0 - u) ** 2 / self.duration
        dds = 60.0 * u * (1.0 - 3.0 * u + 2.0 * u**2) / self.duration**2
        return self.start + np.outer(s, span), np.outer(ds, span), np.outer(dds, span)


def ramp(
    start: Array,
    end: Array,
    limits: MotionLimits,
    clearance: Clearance,
    torques: Callable[[Array, Array, Array], Array | None],
) -> Ramp | None:
    """Return the shortest quintic within all limits, or None if start and end coincide.

    Parameters
    ----------
    start, end : (n_dof,) arrays
        Positions (rad or m).
    limits : MotionLimits
        Velocities, accelerations, jerks, torques.
    clearance : Clearance
        Clearances.
    torques : callable
        Torques of ``q dq ddq``, (n_samples, n_dof); None if they are not limited.

    Raises
    ------
    ExcitationError
        When the path itself violates the limits; the sentence names the joint or the obstacle.
    """
    span = np.abs(end - start)
    if not span.any():
        return None
    kinds = (limits.velocity, limits.acceleration, limits.jerk)
    duration = max(
        float((peak * span / limit).max()) ** (1.0 / order)
        for order, (peak, limit) in enumerate(zip(PEAKS, kinds, strict=True), 1)
    )
    shortest = Ramp(start=start, end=end, duration=duration)
    if not clearance.empty:
        distances = clearance.distances(shortest.at(np.linspace(0.0, duration, LOOKS))[0])
        sample, column = np.unravel_index(int(distances.argmin()), distances.shape)
        if distances[sample, column] < 0.0:
            raise ExcitationError(
                f"the ramp between home and the start of the motion comes too near: {clearance.describe(int(column))}; "
                "give another home or another start"
            )
    for _ in range(MOST_LONGER):
        needed = torques(*shortest.at(np.linspace(0.0, shortest.duration, LOOKS)))
        if needed is None:
            return shortest
        relative = np.abs(needed) / limits.torque
        if (relative <= 1.0).all():
            return shortest
        shortest = Ramp(start=start, end=end, duration=LONGER * shortest.duration)
    joint = int(relative.max(axis=0).argmax()) + 1
    raise ExcitationError(
        f"the ramp between home and the start of the motion needs more torque of joint {joint} than its limit, at any speed; "
        "give another home or another start"
    )


def whole_motion(
    reference: Reference, before: Ramp | None, after: Ramp | None, rate_hz: float
) -> tuple[Array, Array, Array, Array]:
    """Sample a motion with its ramps: times from 0 (s), positions, velocities and accelerations.

    Returns
    -------
    t : (n_samples,) array
    q, dq, ddq : (n_samples, n_dof) arrays
    """
    first = 0.0 if before is None else before.duration
    second = first + reference.duration
    end = second + (0.0 if after is None else after.duration)
    sample_count(end, rate_hz)
    # The last sample is at rest: the end of the motion, or the first sample after it.
    t = np.arange(int(np.ceil(end * rate_hz - 1e-9)) + 1) / rate_hz
    q, dq, ddq = (np.array(values) for values in reference.at(np.clip(t - first, 0.0, reference.duration)))
    dq[t > second], ddq[t > second] = 0.0, 0.0
    for piece, begin, stop in ((before, 0.0, first), (after, second, np.inf)):
        if piece is None:
            continue
        inside = (t >= begin) & (t < stop) if begin == 0.0 else t > begin
        q[inside], dq[inside], ddq[inside] = piece.at(np.clip(t[inside] - begin, 0.0, piece.duration))
    return t, q, dq, ddq
