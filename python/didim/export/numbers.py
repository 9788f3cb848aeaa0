"""Numbers in exported files, the shortest text that reads back as the same bits, and elements of XML."""

from __future__ import annotations

from collections.abc import Iterable
from xml.sax.saxutils import quoteattr

from .._tools.arrays import Array
from ..robot.rigid_body import central


def number(value: float) -> str:
    """Return one number; zero has no sign."""
    return repr(float(value) + 0.0)


def numbers(values: Iterable[float]) -> str:
    """Return several numbers with spaces between."""
    return " ".join(map(number, values))


def xml(tag: str, *inside: Iterable[str], **attributes: str | None) -> list[str]:
    """Return the lines of an XML element with others inside; attributes that are None are left out."""
    words = "".join(f" {key}={quoteattr(value)}" for key, value in attributes.items() if value is not None)
    lines = [f"  {line}" for part in inside for line in part]
    return [f"<{tag}{words}>", *lines, f"</{tag}>"] if lines else [f"<{tag}{words}/>"]


def moments(inertia: Array) -> dict[str, str]:
    """Return the entries of an inertia matrix (3, 3) by their names in URDF and SDF."""
    return {f"i{'xyz'[a]}{'xyz'[b]}": number(inertia[a, b]) for a in range(3) for b in range(a, 3)}


def inertial(pseudo: Array) -> dict[str, str]:
    """Return the attributes of MJCF's ``<inertial>`` of a pseudo-inertia (4, 4); those of no mass where it is zero."""
    if not pseudo.any():
        return {"pos": "0 0 0", "mass": "0", "diaginertia": "0 0 0"}
    mass, centre, inertia = central(pseudo)
    entries = (inertia[at] for at in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    return {"pos": numbers(centre), "mass": number(mass), "fullinertia": numbers(entries)}
