"""Descent by a quasi-Newton method that can be paused and continued.

Limited-memory BFGS in the two-loop form (Nocedal and Wright, algorithm 7.4) with a backtracking line search. SciPy's
implementation factorizes matrices of twice its memory, for which linear algebra libraries start threads beside those of the
other starts, and it cannot be resumed. Tested in ``tests/test_excitation_search.py``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from ..._tools.arrays import Array

Objective = Callable[[Array], tuple[float, Array]]
"""Value and gradient at a point."""

MEMORY = 60
"""Number of pairs (step, change of the gradient) stored for the quasi-Newton direction."""
DECREASE = 1e-4
"""Share of the decrease predicted by the slope that a step must achieve (Armijo)."""
LINE_SEARCH_HALVINGS = 15
"""Largest number of times a step is halved before the stored pairs are discarded."""
CURVED = 1e-10
"""Smallest cosine between a step and the change of the gradient for a pair to be stored: below it the curvature is rounding."""
CONVERGED = 1e-9
"""Relative decrease in one step below which the descent has converged."""


class Descent:
    """A descent from one point.

    Parameters
    ----------
    objective : callable
        Value and gradient.
    x : (n,) array
        First point.

    Attributes
    ----------
    x, value : (n,) array, float
        Best point so far, and the objective there.
    converged : bool
        Whether the descent has converged.
    """

    def __init__(self, objective: Objective, x: Array) -> None:
        self._objective, self.x = objective, x
        self.value, self._gradient = objective(x)
        self._pairs: deque[tuple[Array, Array, float]] = deque(maxlen=MEMORY)
        self.converged = False

    def run(self, evaluations: int) -> None:
        """Continue for a number of evaluations of the objective, up to the end of a step; fewer if it converges."""
        while evaluations > 0 and not self.converged:
            evaluations -= self._step()

    def _step(self) -> int:
        """Take one step, and return the number of evaluations."""
        direction = self._direction()
        slope = float(self._gradient @ direction)
        if not slope < 0.0:
            self._give_up()
            return 0
        length = 1.0
        for count in range(1, LINE_SEARCH_HALVINGS + 1):
            x = self.x + length * direction
            value, gradient = self._objective(x)
            if value <= self.value + DECREASE * length * slope:
                self._accept(x, value, gradient)
                return count
            # Minimum of the parabola through both values and the slope, within bounds.
            bent = 2.0 * (value - self.value - length * slope)
            best = -slope * length / bent if np.isfinite(bent) else 0.0
            length *= min(0.5, max(0.1, best))
        self._give_up()
        return LINE_SEARCH_HALVINGS

    def _accept(self, x: Array, value: float, gradient: Array) -> None:
        step, change = x - self.x, gradient - self._gradient
        product = float(step @ change)
        if product > CURVED * float(np.sqrt((step @ step) * (change @ change))):
            self._pairs.append((step, change, 1.0 / product))
        self.converged = self.value - value <= CONVERGED * max(abs(self.value), abs(value), 1.0)
        self.x, self.value, self._gradient = x, value, gradient

    def _give_up(self) -> None:
        """Restart with the steepest descent, which is the last resort."""
        self.converged = not self._pairs
        self._pairs.clear()

    def _direction(self) -> Array:
        """Return the next direction: the negative product of the estimated inverse Hessian and the gradient."""
        direction = self._gradient.copy()
        shares = []
        for step, change, inverse in reversed(self._pairs):
            share = inverse * float(step @ direction)
            shares.append(share)
            direction -= share * change
        if self._pairs:
            _, change, inverse = self._pairs[-1]
            direction /= inverse * float(change @ change)
        else:
            direction *= min(1.0, 1.0 / max(float(np.abs(direction).sum()), np.finfo(float).tiny))
        for (step, change, inverse), share in zip(self._pairs, reversed(shares), strict=True):
            direction += (share - inverse * float(change @ direction)) * step
        return -direction
