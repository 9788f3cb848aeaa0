"""Criteria of a design as functions of the information matrix, with their derivatives.

The information on the base parameters is ``M = M_0 + sum W' Sigma^-1 W``. The optimum of its log determinant (D-optimality)
depends neither on units nor on the choice of base parameters. That of the condition number of W depends on both; it is included
for comparison (docs/excitation.md). Tested in ``tests/test_excitation.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from .._tools.arrays import Array

Name = Literal["information", "condition"]
Criterion = Callable[[Array], tuple[float, Array]]
"""Value to be maximised and its derivative ``P``, with ``d value = sum P : dM``, as functions of an information matrix M."""

FLOOR = 1e-13
"""Smallest eigenvalue of the scaled information matrix, as a share of the largest, that is not rounding."""
CLEAR_PIVOT = 1e-5
"""Smallest pivot of the scaled matrix's factor that proves M regular; below it the eigenvalues are computed. Its square is far
above `FLOOR`."""


def criterion(name: Name, wanted: Array | None = None) -> Criterion:
    """Return a criterion.

    Parameters
    ----------
    name : {"information", "condition"}
        Log determinant of the information, or the negative logarithm of the condition number of W.
    wanted : array of int, optional
        Columns of the parameters of interest (D_s-optimality): the information on them with all others unknown.
    """
    if name == "condition":
        return _condition
    if wanted is None:
        return log_determinant
    return lambda matrix: _of_some(matrix, wanted)


@np.errstate(over="ignore", invalid="ignore")  # the variance of a column that is nearly zero may be infinite
def log_determinant(matrix: Array) -> tuple[float, Array]:
    """Return log determinant and inverse of a symmetric positive definite matrix; eigenvalues below `FLOOR` are raised to it."""
    # With a unit diagonal the eigenvalues do not depend on units.
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    unit = matrix / np.outer(scale, scale)
    # Eigenvalues take ten times as long, on every thread of the linear algebra, so only for a nearly singular factor.
    factor, lost = dpotrf(unit, lower=1)
    if not lost and float(np.diag(factor).min()) > CLEAR_PIVOT:
        half, _ = dtrtri(factor, lower=1)
        inverse = half.T @ half
        value = 2.0 * float(np.log(np.diag(factor)).sum() + np.log(scale).sum())
        return value, np.asarray(inverse / np.outer(scale, scale))
    inverse, values = scaled_inverse(matrix, scale, FLOOR)
    return float(np.log(values).sum() + 2.0 * np.log(scale).sum()), inverse


def scaled_inverse(matrix: Array, scale: Array, floor: float) -> tuple[Array, Array]:
    """Return the inverse of a symmetric matrix, and its eigenvalues for rows and columns over `scale`.

    Eigenvalues below a share `floor` of the largest one are rounding, and raised to it.
    """
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    values = np.maximum(values, floor * values[-1])
    scaled = vectors / scale[:, None]
    return np.asarray((scaled / values) @ scaled.T), values


def _of_some(matrix: Array, wanted: Array) -> tuple[float, Array]:
    """Return the log determinant of the Schur complement, ``log det M - log det M_others``."""
    value, derivative = log_determinant(matrix)
    others = np.setdiff1d(np.arange(len(matrix)), wanted)
    if others.size:
        places = np.ix_(others, others)
        less, inverse = log_determinant(matrix[places])
        value -= less
        derivative[places] -= inverse
    return value, derivative


def _condition(matrix: Array) -> tuple[float, Array]:
    """Return the negative logarithm of the condition number of W, half that of W' W."""
    values, vectors = np.linalg.eigh(matrix)
    low = max(float(values[0]), FLOOR * float(values[-1]))
    value = 0.5 * float(np.log(low) - np.log(values[-1]))
    first, last = vectors[:, 0], vectors[:, -1]
    return value, 0.5 * (np.outer(first, first) / low - np.outer(last, last) / values[-1])


def condition_number(matrix: Array) -> float:
    """Return the condition number of W from ``W' W``."""
    values = np.linalg.eigvalsh(matrix)
    return float(np.sqrt(values[-1] / max(float(values[0]), np.finfo(float).tiny)))
