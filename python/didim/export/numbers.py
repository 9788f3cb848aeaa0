"""Numbers in exported files: the shortest text that reads back as the same bits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from .._tools.arrays import Array
from ..robot.rigid_body import central


def number(value: float) -> str:
    """Return one number; zero has no sign."""
    return repr(float(value) + 0.0)


def numbers(values: Iterable[float]) -> str:
    """Return several numbers with spaces between."""
    return " ".join(map(number, values))


def attributes(values: Mapping[str, float]) -> str:
    """Return numbers as XML attributes, each after a space."""
    return "".join(f' {key}="{number(value)}"' for key, value in values.items())


def moments(inertia: Array) -> dict[str, float]:
    """Return the entries of an inertia matrix (3, 3) by their names in URDF and SDF."""
    return {f"i{'xyz'[a]}{'xyz'[b]}": inertia[a, b] for a in range(3) for b in range(a, 3)}


def inertial(pseudo: Array) -> dict[str, str]:
    """Return the attributes of MJCF's ``<inertial>`` of a pseudo-inertia (4, 4); those of no mass where it is zero."""
    if not pseudo.any():
        return {"pos": "0 0 0", "mass": "0", "diaginertia": "0 0 0"}
    mass, centre, inertia = central(pseudo)
    entries = (inertia[at] for at in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    return {"pos": numbers(centre), "mass": number(mass), "fullinertia": numbers(entries)}
