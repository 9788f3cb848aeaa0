"""Trial points that a simplex of Nelder and Mead will probably ask for, evaluated together as lanes of one simulation.

Seven in ten iterations accept the reflection, so most of what the next iterations ask for is known before the values are. A wrong
guess costs a lane and no more: values are looked up by the bits of their points.

Tested in ``tests/test_nelder_mead.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop, heappush
from itertools import count

import numpy as np

from ..._tools.arrays import Array

REFLECTION, EXPANSION, OUTSIDE, INSIDE = range(4)
SHARES = (0.7, 0.16, 0.03, 0.11)
"""Share of the iterations that end with each trial point (a thousand iterations on the TX40)."""
TOGETHER = 4
"""Points evaluated together: the lanes of a simulation, which take little longer than one."""
GUESSES = 4 * TOGETHER
"""Largest number of guesses for a batch; those of a collapsed simplex are all the same point."""
REMEMBERED = 1000
"""Number of values after which old ones are forgotten."""


class Lookahead:
    """Values of the trial points of a simplex.

    Attributes
    ----------
    made : int
        Evaluations so far.
    """

    def __init__(self, batch: Callable[[Array], Array], steps: tuple[float, float, float, float]) -> None:
        self.batch, self.steps = batch, steps
        self.made = 0
        self.values: dict[bytes, float] = {}

    def trial(self, points: Array, move: int) -> tuple[Array, float]:
        """Return a trial point of a simplex, (n,), and its value.

        Parameters
        ----------
        points : (n + 1, n) array
            Vertices, the worst one last.
        move : int
            `REFLECTION`, `EXPANSION`, `OUTSIDE` or `INSIDE`.
        """
        point = self._point(points, move)
        key = point.tobytes()
        if key not in self.values:
            chosen = self._guesses(points, move)
            if len(self.values) > REMEMBERED:
                self.values.clear()
            self.values.update(zip(chosen, self.batch(np.stack(list(chosen.values()))).tolist(), strict=True))
            self.made += len(chosen)
        return point, self.values[key]

    def _point(self, points: Array, move: int) -> Array:
        # Each coordinate is added up in ascending order: the sum of a guessed simplex, whose ranks nobody knows, has the same bits.
        centre = np.add.reduce(np.sort(points[:-1], axis=0), 0) / (len(points) - 1)
        step = self.steps[move]
        return np.asarray((1.0 + step) * centre - step * points[-1])

    def _guesses(self, points: Array, move: int) -> dict[bytes, Array]:
        """Return the point that is asked for and the likeliest further ones, by their bits."""
        chosen: dict[bytes, Array] = {}
        number = count()
        queue = [(-1.0, next(number), points, move)]
        for _ in range(GUESSES):
            share, _, points, move = heappop(queue)
            point = self._point(points, move)
            key = point.tobytes()
            if key not in self.values:
                chosen[key] = point
            if len(chosen) == TOGETHER:
                break
            # An accepted point is rarely the worst one again.
            following = np.concatenate([point[None], points[:-1]])
            if move == REFLECTION:
                for other in (EXPANSION, OUTSIDE, INSIDE):
                    heappush(queue, (share * SHARES[other], next(number), points, other))
                share *= SHARES[REFLECTION]
            heappush(queue, (share, next(number), following, REFLECTION))
        return chosen
