"""Huber and bisquare as solvers: ``IDIMLS(solver="huber")``, ``DIDIM(solver="bisquare")``.

Each starts from weighted least squares, and uses its weights per joint. docs/idim_ls.md compares them with least
squares. Tested in ``tests/test_robust.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...terms.rows import LinearSystem
from ..covariance import Factors, covariance
from ..fit import Fit, Progress
from ..least_squares import per_row, solve
from ..settings import LeastSquaresSettings
from .robust import Loss, reweighted


@dataclass(frozen=True)
class Robust:
    """Huber's or Tukey's M-estimator, by iteratively reweighted least squares.

    Parameters
    ----------
    loss : {"huber", "bisquare"}
        Loss function.
    constant : float, optional
        Tuning constant in robust standard deviations: 1.345 and 4.685 by default.
    """

    loss: Loss = "huber"
    constant: float | None = None

    @property
    def name(self) -> str:
        """Name in the record of a result."""
        return self.loss

    def __call__(
        self, system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
    ) -> Fit:
        """Solve a system."""
        first = solve(system, settings, progress)
        if first.stopped:
            return first
        solution = reweighted(
            system.w, system.y, system.joints, first.solution, loss=self.loss, constant=self.constant
        )
        weights = per_row(system, 1.0 / solution.scale) * np.sqrt(solution.weights)
        residual = system.y - system.w @ solution.solution
        factors = Factors.of(system.w * weights[:, None], residual * weights)
        low = float(np.mean(solution.weights < 0.5))
        return replace(
            first,
            solution=solution.solution,
            # That of least squares with known weights of the rows.
            covariance=covariance(system, settings, weights, residual, factors.inverse),
            residual=residual,
            weights=weights,
            factors=factors,
            converged=solution.converged,
            record={"loss": self.loss, "iterations": solution.iterations, "rows_below_half_weight": low},
        )


class Huber(Robust):
    """`Robust` with Huber's function."""


class Bisquare(Robust):
    """`Robust` with Tukey's bisquare."""

    def __init__(self, constant: float | None = None) -> None:
        super().__init__("bisquare", constant)
