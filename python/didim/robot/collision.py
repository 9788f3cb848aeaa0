"""Capsules as collision geometry of the links: the tables ``[[collision]]`` of a robot file.

    [[collision]]
    link = 3                    # 0 is the base; coordinates are those of the link's frame, as for MX MY MZ
    from_m = [0.0, 0.0, 0.0]
    to_m = [0.39, 0.0, 0.0]
    radius_m = 0.06

Tested in ``tests/test_clearance.py``, against the geometry of Pinocchio too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._tools.toml import Table
from .placement import carriers

NEIGHBOURS = 1
"""Largest distance along the chain of two links whose capsules touch at their common joint and are not checked against each
other."""


@dataclass(frozen=True, kw_only=True)
class Capsule:
    """All points within a radius of a segment, fixed to a link.

    Tested in ``tests/test_clearance.py``.

    Attributes
    ----------
    link : int
        Link that carries it; 0 is the base.
    start, end : tuple of float
        Ends of the segment in the link's frame (m); the same point for a sphere.
    radius : float
        Radius (m).
    """

    link: int
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float


def read_capsules(tables: Sequence[Table], n_dof: int) -> tuple[Capsule, ...]:
    """Read the tables ``[[collision]]`` of a file."""
    capsules = []
    for table in tables:
        link = table.integer("link", maximum=n_dof)
        start, end = (_point(table, key) for key in ("from_m", "to_m"))
        capsules.append(Capsule(link=link, start=start, end=end, radius=table.number("radius_m")))
        table.done()
    return tuple(capsules)


def _point(table: Table, key: str) -> tuple[float, float, float]:
    x, y, z = table.numbers(key, length=3)
    return x, y, z


def checked_pairs(capsules: Sequence[Capsule], parents: Sequence[int | None]) -> NDArray[np.intp]:
    """Return the pairs of capsules that must not touch, ``(n_pairs, 2)``: those of links that are not neighbours.

    Links are neighbours by the joints between them: the thighs of two legs on one trunk have two.
    """
    ways = [set(carriers(parents, capsule.link - 1) if capsule.link else ()) for capsule in capsules]
    pairs = [
        (i, j)
        for i, one in enumerate(capsules)
        for j, other in enumerate(capsules[i + 1 :], i + 1)
        if one.link != other.link and len(ways[i] ^ ways[j]) > NEIGHBOURS
    ]
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)
