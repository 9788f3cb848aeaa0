"""A solver: least absolute deviations, which a few wild torques do not move.

    fit = didim.identify(experiment, didim.IDIMLS(solver=LeastAbsolute()))

``SOLVERS["least-absolute"] = "least_absolute:LeastAbsolute"`` gives it a name. The sum of absolute weighted residuals
is minimised by least squares whose rows are divided by the root of their residuals, again and again.
Tested in ``tests/test_extensions.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from didim.regression.fit import Fit, Progress
from didim.regression.least_squares import solve
from didim.regression.settings import LeastSquaresSettings
from didim.terms.rows import LinearSystem


@dataclass(frozen=True)
class LeastAbsolute:
    """Least absolute deviations; rows of different joints count by the weights of least squares."""

    max_iterations: int = 200
    tolerance: float = 1e-6
    name: str = "least-absolute"

    def __call__(
        self, system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
    ) -> Fit:
        """Solve (7); the covariance is that of the last least squares."""
        first = fit = solve(system, settings)
        plain = replace(settings, weights="none")
        for number in range(1, self.max_iterations + 1):
            size = np.abs(first.weights * fit.residual)
            # Below a share of the typical residual rows count by their squares: the cost stays differentiable.
            rows = first.weights / np.sqrt(np.maximum(size, 1e-3 * np.median(size) + np.finfo(float).tiny))
            scaled = replace(system, w=system.w * rows[:, None], y=system.y * rows, known=None)
            last, found = fit, solve(scaled, plain)
            fit = replace(
                found,
                residual=system.y - system.w @ found.solution,
                weights=rows,
                condition_number=first.condition_number,
            )
            if progress is not None and progress(number, fit.solution, fit.residual):
                return replace(fit, stopped=True)
            change = np.linalg.norm(fit.solution - last.solution)
            if change <= self.tolerance * np.linalg.norm(fit.solution):
                return replace(fit, record={"iterations": number})
        return replace(fit, converged=False)
