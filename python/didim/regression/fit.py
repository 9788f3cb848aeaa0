"""The solution of a linear system (7), common to all solvers. Tested in ``tests/test_solver.py``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .._tools.arrays import Array
from .covariance import Branches, Factors

Progress = Callable[[int, Array, Array], bool]
"""Callback with the number of a solution (from 1), its estimate and its residual; True stops the solver."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Solution of a `LinearSystem`.

    Attributes
    ----------
    solution : ndarray, shape (b,)
        Estimate.
    covariance : ndarray, shape (b, b)
        Its covariance, (10) or that of the solver; zero if unknown.
    residual : ndarray, shape (r,)
        ``Y - W beta`` in the units of Y, without weights.
    weights : ndarray, shape (r,)
        Factor of each row in the last solution; ones without weights.
    condition_number : float
        Condition number of W without weights.
    stopped : bool
        Whether the callback asked to stop.
    converged : bool
        False for iterations that ended before convergence.
    factors : Factors, Branches or None
        Weighted factors for the jackknife's deletions; None for those of least squares with `weights`.
    precision : ndarray, shape (b, b), or None
        What a prior and constraints add to the information ``A^T A`` of the weighted rows, with which the deletions are held; None
        without any.
    standard : ndarray, shape (p,), or None
        Standard parameters of a physically consistent solution; None if the solver only has base parameters.
    remarks : tuple of str
        Sentences for the result.
    record : mapping
        Numbers and settings of the solver as JSON data, for the settings of the result.
    """

    solution: Array
    covariance: Array
    residual: Array
    weights: Array
    condition_number: float
    stopped: bool = False
    converged: bool = True
    factors: Factors | Branches | None = None
    precision: Array | None = None
    standard: Array | None = None
    remarks: tuple[str, ...] = ()
    record: Mapping[str, Any] = field(default_factory=dict)

    @property
    def std(self) -> Array:
        """Standard deviations, shape (b,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))
