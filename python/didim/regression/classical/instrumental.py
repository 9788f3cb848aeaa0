r"""Instrumental variables for the linear system, and their diagnosis: Janot, Vandanjon and Gautier (2014).

    beta = (Z^T O W)^-1 Z^T O Y                                               O = diag 1 / s_j^2
    C = (Z^T O W)^-1 Z^T O S O Z (W^T O Z)^-1                                  S_j = s_j^2 T
    strength of column i:  |V_i| / |W_i|,   V = (I - P_Z) W

``W`` comes from measured motion and contains its noise; the instruments ``Z`` come from simulated motion without it. Both have
the same weights: ``O^(-1/2) Z = Q R`` and ``Q^T O^(-1/2) W beta = Q^T O^(-1/2) Y``. The Durbin-Wu-Hausman test adds ``V`` to
the regression: if W contains noise, V explains a part of the residual.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import didim._core as _core

from ..._tools.arrays import Array, quotient
from ...errors import FitError, RankError
from ...terms.rows import LinearSystem, check_solvable, unit_columns
from ..covariance import Factors, covariance_of_columns
from ..fit import Fit, Progress
from ..least_squares import joint_sigma, per_row
from ..settings import LeastSquaresSettings

DEPENDENT_INSTRUMENT = 1e-9
"""Share of a column, or of the largest singular value, below which an instrument depends on the others."""
ROWS_AT_ONCE = 2000
"""Number of rows of the matrices that only the diagnosis needs: 2 MB with 120 columns."""


@dataclass(frozen=True, eq=False)
class Instrumented:
    """Factors of a weighted system with instruments.

    Attributes
    ----------
    left : ndarray, shape (r, b)
        ``Q`` of the weighted instruments.
    inverse : ndarray, shape (b, b)
        ``G^-1`` with ``G = Q^T A``, for the weighted observation matrix A.
    right : ndarray, shape (r, b)
        ``A G^-1``.
    solution : ndarray, shape (b,)
        Estimate.
    """

    left: Array
    inverse: Array
    right: Array
    solution: Array


def instrumented(a: Array, z: Array, y: Array, weights: Array) -> Instrumented | None:
    """Solve a weighted system with weighted instruments.

    Parameters
    ----------
    a, z : ndarray, shape (r, b)
        Observation matrix and instruments.
    y : ndarray, shape (r,)
        Torques.
    weights : ndarray, shape (r,)
        Factor of each row.

    Returns
    -------
    Instrumented or None
        None if the instruments are dependent, or do not identify a parameter: ``Q^T A`` is singular.

    Notes
    -----
    ``test_instrumental.py`` compares with the normal equations, and with least squares for Z = W.
    """
    # One matrix at a time, because they dominate the memory of a study's worker.
    left, triangle = np.linalg.qr(unit_columns(z * weights[:, None])[0])
    if np.abs(np.diag(triangle)).min() < DEPENDENT_INSTRUMENT:
        return None
    a = a * weights[:, None]
    unit, size = unit_columns(a)
    gram = left.T @ unit
    del unit
    if np.linalg.cond(gram) * np.finfo(np.float64).eps > DEPENDENT_INSTRUMENT:
        return None
    inverse = np.linalg.inv(gram) / size[:, None]
    return Instrumented(
        left=left, inverse=inverse, right=a @ inverse, solution=inverse @ (left.T @ (y * weights))
    )


def instrument_strength(a: Array, left: Array) -> Array:
    """Return the share of each weighted column that the instruments do not explain, ``|V_i| / |W_i|``, (b,).

    Parameters
    ----------
    a, left : ndarray, shape (r, b)
        Weighted observation matrix, and ``Q`` of the weighted instruments.

    Notes
    -----
    Near 0 the column contains hardly any noise, and the bias of least squares is negligible. Near 1 the instrument is weak.
    """
    size = np.linalg.norm(a, axis=0)
    rest = _rest_norms(a, left, left.T @ a)
    return quotient(rest, size)


def _rows_at_once(count: int) -> Iterator[slice]:
    """Return slices of rows, to avoid copies of W: workers of a study have little memory."""
    for first in range(0, count, ROWS_AT_ONCE):
        yield slice(first, first + ROWS_AT_ONCE)


def _rest_norms(a: Array, left: Array, projected: Array) -> Array:
    """Return the norms of the columns of V, the part of W that the instruments do not explain."""
    squares = np.zeros(a.shape[1])
    for rows in _rows_at_once(len(a)):
        squares += np.square(a[rows] - left[rows] @ projected).sum(axis=0)
    return np.asarray(np.sqrt(squares))


@dataclass(frozen=True)
class ExogeneityTest:
    """Durbin-Wu-Hausman test, augmented regression: whether the noise of W is correlated with the error of the torques.

    Attributes
    ----------
    statistic : float
        F of ``gamma = 0`` in ``Y = W beta + V gamma + e``.
    added : int
        Rank that V adds.
    remaining : int
        Rows less rank.
    p_value : float
        Probability for white errors. Model errors are correlated, so it is nearly always small on real logs; the contrast of
        two estimates (`didim.contrast`) is a robust alternative.
    """

    statistic: float
    added: int
    remaining: int
    p_value: float


def exogeneity_test(a: Array, left: Array, y: Array) -> ExogeneityTest | None:
    """Test whether least squares is biased by noise in the observation matrix.

    Parameters
    ----------
    a, left : ndarray, shape (r, b)
        Weighted observation matrix, and ``Q`` of the weighted instruments.
    y : ndarray, shape (r,)
        Weighted torques.

    Returns
    -------
    ExogeneityTest or None
        None if V adds nothing, or there are too few rows.
    """
    from scipy.special import fdtrc

    projected, size = left.T @ a, np.linalg.norm(a, axis=0)
    added = _rest_norms(a, left, projected)
    # For a column within the span of the instruments the difference is rounding.
    independent = added > DEPENDENT_INSTRUMENT * size
    scale = np.where(size > 0.0, size, 1.0)
    # R of [W, V, Y], a slice of rows at a time.
    triangle = np.zeros((0, a.shape[1] + int(independent.sum()) + 1))
    for rows in _rows_at_once(len(a)):
        rest = (a[rows] - left[rows] @ projected)[:, independent] / added[independent]
        part = np.column_stack([a[rows] / scale, rest, y[rows]])
        triangle = np.asarray(np.linalg.qr(np.vstack([triangle, part]), mode="r"))
    both, target = triangle[:, :-1], triangle[:, -1]
    left_of_both, values, _ = np.linalg.svd(both, full_matrices=False)
    rank = int(np.sum(values > DEPENDENT_INSTRUMENT * values[0]))
    basis = left_of_both[:, :rank]
    # The first columns of Q span W, so the residual of Y is below their rows.
    restricted, full = target[a.shape[1] :], target - basis @ (basis.T @ target)
    gained, remaining = rank - a.shape[1], y.size - rank
    if gained <= 0 or remaining <= 0 or not full @ full > 0.0:
        return None
    statistic = ((restricted @ restricted - full @ full) / gained) / (full @ full / remaining)
    return ExogeneityTest(float(statistic), gained, remaining, float(fdtrc(gained, remaining, statistic)))


def durbin_watson(residuals: Sequence[Array]) -> float:
    """Return Durbin and Watson's statistic of one joint's residual, windows pooled: 2 for white errors, towards 0 for slow ones."""
    changes = sum(float(np.sum(np.diff(part) ** 2)) for part in residuals)
    squares = sum(float(part @ part) for part in residuals)
    return changes / squares if squares > 0.0 else float("nan")


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Diagnosis of an observation matrix by instruments.

    Attributes
    ----------
    strength : ndarray, shape (b,)
        Share of each column that the instruments do not explain, see `instrument_strength`.
    test : ExogeneityTest or None
        Durbin-Wu-Hausman test.
    durbin_watson : ndarray, shape (n_dof,)
        Statistic of the residual of each joint.
    """

    strength: Array
    test: ExogeneityTest | None
    durbin_watson: Array


def solve_with_instruments(
    system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
) -> Fit:
    """Solve (7) with the instruments of the system, with weights per joint estimated from the residuals.

    Parameters
    ----------
    system : LinearSystem
        Torques, the observation matrix along the measured motion, and that of the simulated one as instruments.
    settings : LeastSquaresSettings
        Weights and variance.
    progress : callable, optional
        As for every solver; it is not called, because solutions are few.

    Returns
    -------
    Fit
        Estimate with its covariance, for white or for decimated noise.

    Raises
    ------
    FitError
        With too few rows.
    RankError
        When the instruments do not determine the parameters.
    """
    check_solvable(system)
    weights = np.ones(system.y.size)
    solution = _determined(system, weights)
    residual = system.y - system.w @ solution.solution
    for _ in range(1, settings.solutions):
        weights = per_row(system, 1.0 / joint_sigma(system, residual))
        del solution  # it is as large as both matrices
        solution = _determined(system, weights)
        residual = system.y - system.w @ solution.solution
    weighted = residual * weights
    return Fit(
        solution=solution.solution,
        covariance=covariance_of_columns(system, settings, solution.left, weighted, solution.inverse),
        residual=residual,
        weights=weights,
        condition_number=float(np.linalg.cond(system.w)),
        factors=Factors(solution.left, solution.right, solution.inverse, weighted),
    )


def instrument_diagnosis(system: LinearSystem, fit: Fit) -> Diagnosis:
    """Return the diagnosis of the observation matrix; `fit` is that of `solve_with_instruments`."""
    assert isinstance(fit.factors, Factors)
    left, rows = fit.factors.left, system.w * fit.weights[:, None]
    return Diagnosis(
        strength=instrument_strength(rows, left),
        test=exogeneity_test(rows, left, system.y * fit.weights),
        durbin_watson=np.array(
            [durbin_watson([fit.residual[block.rows] for block in blocks]) for blocks in system.joint_blocks]
        ),
    )


def _determined(system: LinearSystem, weights: Array) -> Instrumented:
    """Solve with weighted instruments, or raise the error on dependent instruments."""
    z = system.instruments
    if z is None:
        raise FitError("the linear system has no instruments")
    solution = instrumented(system.w, z, system.y, weights)
    if solution is None:
        dependent = _core.least_squares(
            np.ascontiguousarray(z * weights[:, None]), system.y * weights
        ).dependent
        raise RankError(
            "the simulated motion identifies fewer parameters than the measured one: joints stick in friction, or the simulated "
            "loop is not that of the log; check the controller and the reference",
            tuple(column for column, _ in dependent),
        )
    return solution
