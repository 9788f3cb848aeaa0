"""Cheap screening of hypotheses along the decimated motion.

Links and rotors are evaluated along the decimated motion; friction, which jumps at reversals, is that of the fit. The difference
between the columns of a fit and these approximate ones is assumed to be the same for another robot:

    dec(W'(q, dq, ddq)) ~ W'(dec q, dec dq, dec ddq) + [dec(W(q, dq, ddq)) - W(dec q, dec dq, dec ddq)]

The term in brackets is up to 3 % of a torque on fast motions. It is omitted if a joint turns the other way. Tested in
``tests/test_evidence_products.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .._tools.arrays import Array
from ..errors import DidimError, FitError
from ..model.dynamics import friction_places, regressor
from ..model.limbs import Limb
from ..robot.robot import Robot
from .products import Products

if TYPE_CHECKING:
    from .hypotheses.hypothesis import Hypothesis

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


@dataclass(frozen=True, eq=False)
class ScreenedRows:
    """The rows of the screening, of a robot or of one of its limbs.

    Attributes
    ----------
    screen : Screen
        Columns of the standard parameters.
    further : (n_dof, n_rows, m) array
        Columns of parameters that the logs have beside the robot, which are about the same for another one.
    torque : (n_dof, n_rows) array
        Torques.
    given : (p,) array or None
        Standard parameters that are known: nothing is fitted then.
    """

    screen: Screen
    further: Array
    torque: Array
    given: Array | None

    def of_limb(self, limb: Limb) -> ScreenedRows:
        """Return the rows of a limb."""
        at, rows = np.array(limb.joints), np.arange(self.torque.shape[1])
        motion = [values.T[at] for values in self.screen.motion]
        further = self.further[at]
        return ScreenedRows(
            Screen(limb.robot, motion, self.screen.exact[np.ix_(at, rows, limb.indices)]),
            further[:, :, further.any(axis=(0, 1))],
            self.torque[at],
            None if self.given is None else self.given[limb.indices],
        )

    def ratios(self, item: Hypothesis) -> Array:
        """Return about the squared error of each channel over that of the declared model, (n_dof,), in sample."""
        n = len(self.torque)
        try:
            if item.robot is not None:
                w = self.screen.of_robot(item.robot)
            elif item.position is not None or item.rate != 1.0:
                w = self.screen.of_motion(np.eye(n) if item.position is None else item.position, item.rate)
            else:
                w = self.screen.exact
        except DidimError:
            return np.full(n, math.inf)
        w = w if item.torque is None else np.tensordot(item.torque, w, 1)
        return self._products(w).seen(item.order, item.factors) / self._declared

    @cached_property
    def _declared(self) -> Array:
        return self._products(self.screen.exact).seen()

    def _products(self, w: Array) -> Products:
        return Products.of(np.concatenate([w, self.further], axis=2), self.torque, 1, self.given)


def _columns(robot: Robot, motion: Sequence[Array]) -> Array:
    w = np.ascontiguousarray(regressor(robot, *motion).transpose(1, 0, 2))
    if not np.isfinite(w).all():
        raise FitError("positions, velocities or accelerations are too large for floating point")
    return w
