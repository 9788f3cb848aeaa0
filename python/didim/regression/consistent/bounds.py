"""Bounds on masses and centres of mass from the user, as conditions on the standard parameters.

Links count from 1; lengths and positions are in the frame of the link (m). Tested in ``tests/test_consistent.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...model.consistency import Cone, cone, link_cones, places_of
from ...robot.robot import Robot

Span = tuple[float, float]
"""Lower and upper bound."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Bounds on masses and centres of mass.

    Tested in ``tests/test_consistent.py``.

    Parameters
    ----------
    masses : mapping of int to (float, float)
        Lowest and highest mass of a link (kg).
    total_mass : (float, float), optional
        Lowest and highest mass of all links together (kg).
    centres : mapping of int to three (float, float)
        Box that holds the centre of mass of a link: lowest and highest x, y and z (m).
    ellipsoids : mapping of int to (centre, radii)
        Ellipsoid that holds all mass of a link, axes along those of its frame: three coordinates and three radii (m).

    Raises
    ------
    FitError
        For a span that is empty or not finite, or a radius that is not positive.
    """

    masses: Mapping[int, Span] = field(default_factory=dict)
    total_mass: Span | None = None
    centres: Mapping[int, Sequence[Span]] = field(default_factory=dict)
    ellipsoids: Mapping[int, tuple[Sequence[float], Sequence[float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        masses = {f"the mass of link {link}": span for link, span in self.masses.items()}
        if self.total_mass is not None:
            masses["the total mass"] = self.total_mass
        for what, span in masses.items():
            _check_span(what, span)
            if span[0] < 0.0:
                raise FitError(f"{what} cannot be negative, got {span[0]:g} kg")
        for link, box in self.centres.items():
            if len(box) != 3:
                raise FitError(f"the centre of link {link} needs three spans, got {len(box)}")
            for span in box:
                _check_span(f"the centre of link {link}", span)
        for link, (centre, radii) in self.ellipsoids.items():
            if len(centre) != 3 or len(radii) != 3 or not np.isfinite([*centre, *radii]).all():
                raise FitError(f"the ellipsoid of link {link} needs three coordinates and three radii")
            if min(radii) <= 0.0:
                raise FitError(f"the radii of the ellipsoid of link {link} must be positive")

    def cones(self, robot: Robot) -> list[Cone]:
        """Return the conditions.

        Raises
        ------
        FitError
            For a link that the robot does not have.
        """
        for link in (*self.masses, *self.centres, *self.ellipsoids):
            if not 1 <= link <= robot.n_joints:
                raise FitError(
                    f"robot {robot.name!r} has no link {link}: its links are 1 to {robot.n_joints}"
                )
        places, cones = places_of(robot), []
        for link, span in self.masses.items():
            cones += _between(places, f"mass of link {link}", [f"M{link}"], span)
        if self.total_mass is not None:
            masses = [f"M{link}" for link in range(1, robot.n_joints + 1)]
            cones += _between(places, "total mass", masses, self.total_mass)
        for link, box in self.centres.items():
            for axis, (low, high) in zip("XYZ", box, strict=True):
                label, moment, mass = f"centre of link {link}", f"M{axis}{link}", f"M{link}"
                cones += [
                    cone(places, label, {moment: 1.0, mass: -low}),
                    cone(places, label, {moment: -1.0, mass: high}),
                ]
        bodies = link_cones(robot)
        for link, (centre, radii) in self.ellipsoids.items():
            body = bodies[link - 1]
            values = np.tensordot(body.basis, _ellipsoid(np.asarray(centre), np.asarray(radii)), 2)
            cones.append(
                Cone(f"ellipsoid of link {link}", body.indices, values[:, None, None], np.zeros((1, 1)))
            )
        return cones


def _check_span(what: str, span: Span) -> None:
    if len(span) != 2 or not np.isfinite(span).all() or not span[0] < span[1]:
        raise FitError(f"{what} needs a lowest and a higher highest value, got {span!r}")


def _between(places: Mapping[str, int], label: str, names: Sequence[str], span: Span) -> list[Cone]:
    """Return ``low <= sum <= high``, in units of the highest value."""
    low, high = span
    share = dict.fromkeys(names, 1.0 / high)
    return [
        cone(places, label, share, -low / high),
        cone(places, label, {name: -value for name, value in share.items()}, 1.0),
    ]


def _ellipsoid(centre: Array, radii: Array) -> Array:
    """Return ``Q`` with ``tr(Q P) = integral of 1 - (p - c)^T D (p - c)`` over the mass of pseudo-inertia ``P``."""
    shape = np.diag(radii**-2.0)
    q = np.empty((4, 4))
    q[:3, :3], q[3, 3] = -shape, 1.0 - centre @ shape @ centre
    q[:3, 3] = q[3, :3] = shape @ centre
    return q
