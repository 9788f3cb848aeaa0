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
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .._tools.arrays import Array
from ..errors import DidimError, FitError
from ..model.dynamics import friction_places, regressor
from ..model.limbs import Limb
from ..robot.robot import Geometry, Robot
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
    base : sequence of int, optional
        Parameters on whose columns those of the others depend, the base parameters by default.
    """

    def __init__(
        self, robot: Robot, motion: Sequence[Array], exact: Array, base: Sequence[int] | None = None
    ) -> None:
        self.robot, self.exact = robot, exact
        self.motion = [np.ascontiguousarray(values.T) for values in motion]
        self.base = list(robot.base_parameters.indices if base is None else base)
        self.smooth = _columns(robot, self.motion)
        self.correction = exact - self.smooth
        self._correction = self.correction[:, :, self.base]

    def of_robot(self, robot: Robot) -> Array:
        """Return the columns of another robot along the same motion, (n_dof, n_rows, m).

        Only those of the declared base parameters, (n_dof, n_rows, b), where the others of that robot depend on them too.

        Raises
        ------
        DidimError
            For numbers that are too large.
        """
        if _alike(robot.geometry, self.robot.geometry):
            return _columns(robot, self.motion, self.base) + self._correction
        return _columns(robot, self.motion) + self.correction

    def of_motion(self, position: Array, rate: float = 1.0) -> Array:
        """Return base columns, (n_dof, n_rows, b), of positions ``A q``, A (n_dof, n_dof), at r times the rate.

        Friction keeps its size.
        """
        moved = [rate**k * np.ascontiguousarray(values @ position.T) for k, values in enumerate(self.motion)]
        w = _columns(self.robot, moved, self.base)
        places = np.flatnonzero(np.isin(self.base, friction_places(self.robot)))
        rubbing = [self.base[place] for place in places]
        after, smooth, exact = w[:, :, places], self.smooth[:, :, rubbing], self.exact[:, :, rubbing]
        even, odd = (np.all(after == sign * smooth, axis=(0, 1)) for sign in (1.0, -1.0))
        # The error of the decimated motion is about the same where each joint keeps its direction.
        scale = np.diag(position)
        near = (
            np.array_equal(position, np.diag(scale)) and (scale > 1.0 / NEAR).all() and (scale < NEAR).all()
        )
        if near:
            w += self._correction
        w[:, :, places] = np.where(even, exact, np.where(odd, -exact, w[:, :, places]))
        if not near:
            # A joint that keeps its own position in another unit keeps the reversals; a column has any scale.
            alone = (scale != 0.0) & (np.count_nonzero(position, axis=1) == 1)
            own = np.ix_(alone, np.ones(w.shape[1], dtype=bool), places)
            w[own] = np.sign(scale[alone])[:, None, None] * exact[alone]
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
    given, given_further : (p,), (m,) array or None
        Standard parameters and further ones that are known, NaN for those that are fitted; None where all are.
    """

    screen: Screen
    further: Array
    torque: Array
    given: Array | None
    given_further: Array | None = None
    _latest: dict[tuple[object, ...], tuple[Hypothesis, Products]] = field(default_factory=dict)

    def of_limb(self, limb: Limb) -> ScreenedRows:
        """Return the rows of a limb."""
        at, rows = np.array(limb.joints), np.arange(self.torque.shape[1])
        motion = [values.T[at] for values in self.screen.motion]
        further = self.further[at]
        own = further.any(axis=(0, 1))
        return ScreenedRows(
            Screen(
                limb.robot,
                motion,
                self.screen.exact[np.ix_(at, rows, limb.indices)],
                np.flatnonzero(np.isin(limb.indices, self.screen.base)).tolist(),
            ),
            further[:, :, own],
            self.torque[at],
            None if self.given is None else self.given[limb.indices],
            None if self.given_further is None else self.given_further[own],
        )

    def ratios(self, hypothesis: Hypothesis) -> Array:
        """Return about the squared error of each channel over that of the declared model, (n_dof,), in sample."""
        key = id(hypothesis.robot), _bytes(hypothesis.position), hypothesis.rate, _bytes(hypothesis.torque)
        if key not in self._latest:
            self._latest.clear()
            try:
                self._latest[key] = hypothesis, self._products(self._moved(hypothesis), hypothesis.torque)
            except DidimError:
                return np.full(len(self.torque), math.inf)
        return self._latest[key][1].seen(*hypothesis.channels) / self._declared

    def _moved(self, hypothesis: Hypothesis) -> Array:
        if hypothesis.robot is not None:
            return self.screen.of_robot(hypothesis.robot)
        if hypothesis.position is None and hypothesis.rate == 1.0:
            return self.screen.exact[:, :, self.screen.base]
        return self.screen.of_motion(
            np.eye(len(self.torque)) if hypothesis.position is None else hypothesis.position, hypothesis.rate
        )

    @cached_property
    def _declared(self) -> Array:
        return self._products(self.screen.exact[:, :, self.screen.base]).seen()

    def _products(self, w: Array, mixing: Array | None = None) -> Products:
        w = w if mixing is None else np.tensordot(mixing, w, 1)
        whole = w.shape[2] == self.screen.exact.shape[2]
        given = self.given if self.given is None or whole else self.given[self.screen.base]
        if given is not None and self.given_further is not None:
            given = np.concatenate([given, self.given_further])
        columns = np.concatenate([w, self.further], axis=2) if self.further.shape[2] else w
        return Products.of(columns, self.torque, 1, given)


def _bytes(values: Array | None) -> bytes:
    return b"" if values is None else values.tobytes()


def _alike(geometry: Geometry, other: Geometry) -> bool:
    """Whether lengths and twists differ by sizes and signs alone, which leaves the dependent columns dependent."""
    return (
        geometry.gravity == other.gravity
        and np.array_equal(np.abs(geometry.alpha), np.abs(other.alpha))
        and all(
            np.array_equal(np.equal(getattr(geometry, key), 0.0), np.equal(getattr(other, key), 0.0))
            for key in ("d", "r")
        )
    )


def _columns(robot: Robot, motion: Sequence[Array], places: Sequence[int] | slice = slice(None)) -> Array:
    w = regressor(robot, *motion)
    if not np.isfinite(w).all():
        raise FitError("positions, velocities or accelerations are too large for floating point")
    return np.ascontiguousarray(w[:, :, places].transpose(1, 0, 2))
