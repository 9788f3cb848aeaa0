"""A rougher look at a hypothesis, which costs a small part of the columns of a fit. Tested in ``tests/test_verdict_rows.py``.

Links and rotors are formed along the decimated motion, and friction, which jumps at reversals, is that of the fit:

    dec(W(q, dq, ddq)) ~ W(dec q, dec dq, dec ddq)

What of the columns changes faster than decimation lets through makes a difference of up to 3 % of a torque on fast motions. That is
enough to tell what is hopeless, and too much to name a cause: on a log whose residual is smaller than that, another length may well
fit the difference.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...._tools.arrays import Array
from ....errors import FitError
from ....model.dynamics import friction_places, regressor
from ....robot.robot import Robot

MOTION = ("q", "dq", "ddq")
"""Names of the motion's signals."""


class Screen:
    """Columns along a decimated motion.

    Parameters
    ----------
    robot : Robot
        As declared.
    motion : sequence of (n_dof, n_rows) arrays
        Positions, velocities and accelerations, decimated.
    exact : (n_dof, n_rows, b) array
        Columns of its base parameters as those of a fit.

    Attributes
    ----------
    declared : (n_dof, n_rows, m) array
        Columns of the declared robot.
    friction, smooth : (n_dof, n_rows, k) arrays
        Its columns of friction, decimated, and along the decimated motion.
    """

    def __init__(self, robot: Robot, motion: Sequence[Array], exact: Array) -> None:
        self.robot = robot
        self.motion = [np.ascontiguousarray(values.T) for values in motion]
        base = list(robot.base_parameters.indices)
        # Friction that base parameters have taken up is smooth: an offset beside a weight.
        self.places = [place for place in friction_places(robot) if place in base]
        self.friction = exact[:, :, [base.index(place) for place in self.places]]
        self.declared = _columns(robot, self.motion)
        self.smooth = self.declared[:, :, self.places]
        self.declared[:, :, self.places] = self.friction

    def of_robot(self, robot: Robot) -> Array:
        """Return the columns of another robot along the same motion, (n_dof, n_rows, m).

        Raises
        ------
        DidimError
            For numbers that are too large.
        """
        w = _columns(robot, self.motion)
        w[:, :, self.places] = self.friction
        return w

    def of_motion(self, position: Array) -> Array:
        """Return the columns for positions ``A q``, A (n_dof, n_dof); friction keeps its values or turns its sign."""
        w = _columns(self.robot, [np.ascontiguousarray(values @ position.T) for values in self.motion])
        after = w[:, :, self.places]
        even, odd = (np.all(after == sign * self.smooth, axis=(0, 1)) for sign in (1.0, -1.0))
        w[:, :, self.places] = np.where(even, self.friction, np.where(odd, -self.friction, after))
        return w


def _columns(robot: Robot, motion: Sequence[Array]) -> Array:
    w = np.ascontiguousarray(regressor(robot, *motion).transpose(1, 0, 2))
    if not np.isfinite(w).all():
        raise FitError("positions, velocities or accelerations are too large for floating point")
    return w
