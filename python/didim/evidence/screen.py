"""Cheap screening of hypotheses along the decimated motion.

Links and rotors are evaluated along the decimated motion; friction, which jumps at reversals, is that of the fit. The difference
between the columns of a fit and these approximate ones is assumed to be the same for another robot:

    dec(W'(q, dq, ddq)) ~ W'(dec q, dec dq, dec ddq) + [dec(W(q, dq, ddq)) - W(dec q, dec dq, dec ddq)]

The term in brackets is up to 3 % of a torque on fast motions. It is omitted if a joint turns the other way. Tested in
``tests/test_evidence_products.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._tools.arrays import Array
from ..errors import FitError
from ..model.dynamics import friction_places, regressor
from ..robot.robot import Robot

NEAR = 3.5
"""Ratio of a joint's motion to the declared one, up to which a joint's torques along both are similar."""
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
    exact : (n_dof, n_rows, m) array
        Columns of all its standard parameters as those of a fit.
    """

    def __init__(self, robot: Robot, motion: Sequence[Array], exact: Array) -> None:
        self.robot, self.exact = robot, exact
        self.motion = [np.ascontiguousarray(values.T) for values in motion]
        self.friction = list(friction_places(robot))
        self.smooth = _columns(robot, self.motion)
        self.correction = exact - self.smooth

    def of_robot(self, robot: Robot) -> Array:
        """Return the columns of another robot along the same motion, (n_dof, n_rows, m).

        Raises
        ------
        DidimError
            For numbers that are too large.
        """
        return _columns(robot, self.motion) + self.correction

    def of_motion(self, position: Array, rate: float = 1.0) -> Array:
        """Return the columns for positions ``A q``, A (n_dof, n_dof), at r times the rate; friction keeps its size."""
        moved = [rate**k * np.ascontiguousarray(values @ position.T) for k, values in enumerate(self.motion)]
        w = _columns(self.robot, moved)
        after, smooth = w[:, :, self.friction], self.smooth[:, :, self.friction]
        exact = self.exact[:, :, self.friction]
        even, odd = (np.all(after == sign * smooth, axis=(0, 1)) for sign in (1.0, -1.0))
        # The error of the decimated motion is about the same where each joint keeps its direction.
        scale = np.diag(position)
        if np.array_equal(position, np.diag(scale)) and (scale > 1.0 / NEAR).all() and (scale < NEAR).all():
            w += self.correction
        w[:, :, self.friction] = np.where(even, exact, np.where(odd, -exact, w[:, :, self.friction]))
        return w


def _columns(robot: Robot, motion: Sequence[Array]) -> Array:
    w = np.ascontiguousarray(regressor(robot, *motion).transpose(1, 0, 2))
    if not np.isfinite(w).all():
        raise FitError("positions, velocities or accelerations are too large for floating point")
    return w
