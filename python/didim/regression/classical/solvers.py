"""Huber, bisquare and ridge as solvers: ``IDIMLS(solver="huber")``, ``DIDIM(solver="ridge")``.

Each starts from weighted least squares, and uses or replaces its weights per joint. docs/idim_ls.md compares them with least
squares. Tested in ``tests/test_robust.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import FitError
from ...terms.rows import LinearSystem
from ..covariance import Factors, covariance, intervals
from ..fit import Fit, Progress
from ..least_squares import per_row, solve
from ..settings import LeastSquaresSettings
from .ridge import chosen_strength, ridge
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


@dataclass(frozen=True)
class Ridge:
    """Ridge regression towards zero.

    Parameters
    ----------
    strength : float, optional
        ``k`` for unit columns; by default chosen by cross-validation over blocks of time.
    """

    strength: float | None = None

    name = "ridge"

    def __post_init__(self) -> None:
        if self.strength is not None and not 0.0 <= self.strength < np.inf:
            raise FitError(f"strength must be a finite number of at least 0, got {self.strength!r}")

    def __call__(
        self, system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
    ) -> Fit:
        """Solve a system."""
        first = solve(system, settings, progress)
        if first.stopped:
            return first
        a, y = system.w * first.weights[:, None], system.y * first.weights
        strength = self.strength
        if strength is None:
            strength, _ = chosen_strength(
                a, y, [part.rows for part in intervals(system.blocks, settings.blocks)]
            )
        solution = ridge(a, y, strength)
        residual = system.y - system.w @ solution
        # With (R^T R) = A^T A + k D^2 the deletions are those of the penalised problem.
        drawn = np.vstack([a, np.diag(np.sqrt(strength) * np.linalg.norm(a, axis=0))])
        inverse = np.linalg.inv(np.linalg.qr(drawn, mode="r"))
        q = a @ inverse
        variance = float(np.sum((residual * first.weights) ** 2)) / settings.divisor(*a.shape)
        gram = q.T @ q
        spread = variance * np.asarray(inverse @ gram @ inverse.T)
        return replace(
            first,
            solution=solution,
            covariance=spread,
            residual=residual,
            factors=Factors(q, q, inverse, residual * first.weights),
            record={"strength": strength},
        )
