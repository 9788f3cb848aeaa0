"""Least squares with one weight per joint, and the covariance of the estimate: equations (7) to (11).

    Y = W beta + rho                       rows joint by joint                         (7)
    sigma^2 = |Y - W beta|^2 / (r - b)     or r - 1, as MATLAB's ``std`` divides       (9)
    C = sigma^2 (W^T W)^-1 = sigma^2 R^-1 R^-T       with W = Q R                     (10)

The torques of a shoulder and of a wrist have errors of different sizes. With ``weights="per-joint"`` the rows
of joint j are divided by the root mean square of its residuals, computed from a first solution without weights,
and (7) to (10) are written for the divided rows. A factor common to all weights changes neither beta nor C.

Decimated noise is correlated, because the filter passes only a part of the remaining band: r rows contain less information than
r independent ones. Unless ``uncertainty`` is "white" the covariance includes this (``covariance.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

import didim._core as _core

from .._tools.arrays import Array
from .._tools.words import brief, series
from ..errors import CoreErrorsAs, FitError, RankError
from ..terms.rows import LinearSystem, check_solvable
from .covariance import covariance
from .fit import Fit, Progress
from .settings import LeastSquaresSettings

NEGLIGIBLE_COEFFICIENT = 1e-6
"""Coefficient of a linear dependence below which it is rounding and omitted from the sentence."""


def solve(
    system: LinearSystem,
    settings: LeastSquaresSettings,
    progress: Progress | None = None,
) -> Fit:
    """Solve (7) by QR, with weights per joint estimated from the residuals, and its covariance (8) to (10).

    Parameters
    ----------
    system : LinearSystem
        Rows joint by joint.
    settings : LeastSquaresSettings
        Weights and variance.
    progress : callable, optional
        Callback with the number of the solution, beta and the residual; True stops.

    Returns
    -------
    Fit
        Estimate, covariance and residual.

    Raises
    ------
    FitError
        When there are not more rows than columns, no column at all, or numbers whose squares are too large
        for floating point.
    RankError
        When a column depends on others; the message names them.

    Notes
    -----
    ``test_least_squares.py`` compares with `numpy.linalg.lstsq` and checks over many seeds that the errors
    agree with the covariance, with and without decimation.
    """
    check_solvable(system)
    scale = np.ones(system.y.size)
    residual = system.y
    # The last solution of the loop is the result; the first one has no weights.
    for number in range(1, settings.solutions + 1):
        if number > 1:
            scale = per_row(system, 1.0 / joint_sigma(system, residual))
        with CoreErrorsAs(FitError):
            scaled = factored(system, scale)
        if scaled.dependent:
            columns = tuple(index for index, _ in scaled.dependent)
            raise RankError(dependence_sentence(system.names, scaled.dependent), columns)
        if number == 1:
            low, high = scaled.singular_values.min(), scaled.singular_values.max()
            condition_number = float(high / low) if low > 0.0 else float("inf")
        beta = scaled.solution
        residual = system.residual(beta)
        # Asked to stop after the last solution, there is nothing left to stop.
        stopped = progress is not None and progress(number, beta, residual) and number < settings.solutions
        if stopped:
            break
    inverse_r = scaled.inverse_r
    with np.errstate(over="ignore", invalid="ignore"):  # reported below
        spread = covariance(system, settings, scale, residual, inverse_r)
    bad = np.flatnonzero(~(np.isfinite(beta) & np.isfinite(np.diag(spread))))
    if bad.size:
        raise FitError(
            f"parameter {system.names[bad[0]]} and its standard deviation cannot be computed in floating point; "
            "check the units of the log"
        )
    return Fit(
        solution=beta,
        covariance=spread,
        residual=residual,
        weights=scale,
        condition_number=condition_number,
        stopped=stopped,
    )


def estimated(system: LinearSystem, settings: LeastSquaresSettings | None = None) -> tuple[Array, Array]:
    """Return the estimate of a system (7), (b,), and the weights of its rows, (r,), as of `solve`."""
    fit = solve(system, replace(settings or LeastSquaresSettings(), uncertainty="white"))
    return fit.solution, fit.weights


@dataclass(frozen=True, eq=False)
class Factored:
    """Least squares by QR, for all parts of a system.

    Attributes
    ----------
    solution : (b,) array
        Estimate; meaningless for dependent columns.
    inverse_r : (b, b) array
        Inverse of the triangle R.
    singular_values : (b,) array
        Of the weighted W.
    dependent : list of (int, list of (int, float))
        Columns that depend on earlier ones, with their coefficients.
    """

    solution: Array
    inverse_r: Array
    singular_values: Array
    dependent: list[tuple[int, list[tuple[int, float]]]]


def factored(system: LinearSystem, scale: Array) -> Factored:
    """Solve (7) with weighted rows, separately for independent branches such as the legs of a quadruped.

    Parameters
    ----------
    system : LinearSystem
        Rows joint by joint.
    scale : (r,) array
        Factor of each row.

    Raises
    ------
    ValueError
        When there are not more rows than columns, or numbers that are too large.
    """
    b = len(system.names)
    combined = Factored(np.zeros(b), np.zeros((b, b)), np.zeros(0), [])
    singular_values = []
    for (rows, columns), matrix in zip(system.parts, system.matrices, strict=True):
        if not columns.size and b:
            continue  # joints without unknowns, because all columns are dropped or fixed
        weight = scale[rows]
        part = _core.least_squares(np.ascontiguousarray(matrix * weight[:, None]), system.y[rows] * weight)
        combined.dependent.extend(
            (int(columns[index]), [(int(columns[other]), value) for other, value in coefficients])
            for index, coefficients in part.dependent
        )
        singular_values.append(np.asarray(part.singular_values))
        if not part.dependent:
            combined.solution[columns] = part.solution
            combined.inverse_r[np.ix_(columns, columns)] = part.inverse_r
    return replace(combined, singular_values=np.concatenate(singular_values))


def solve_partly(
    system: LinearSystem,
    solver: Callable[[LinearSystem], Fit],
    values: Array,
    dependent: Sequence[int],
) -> tuple[Fit, tuple[int, ...]]:
    """Solve (7) for the identifiable columns; the others keep their values.

    Parameters
    ----------
    system : LinearSystem
        Rows joint by joint.
    solver : callable
        Solver of the smaller system.
    values : ndarray, shape (b,)
        Values of the parameters that are not estimated.
    dependent : sequence of int
        Columns that depend on others, from `RankError.columns`.

    Returns
    -------
    Fit
        Solution for all columns; those not estimated have a variance of zero.
    tuple of int
        Columns not estimated.

    Raises
    ------
    FitError
        As `solve`; RankError if the other columns are dependent with the weights of the second solution.

    Notes
    -----
    ``test_didim_endings.py`` has a start whose motion does not separate an offset from friction.
    """
    columns = len(system.names)
    free, held = [column for column in range(columns) if column not in set(dependent)], sorted(dependent)
    smaller = replace(
        system,
        w=np.ascontiguousarray(system.w[:, free]),
        y=system.y - system.w[:, held] @ values[held],
        known=None,
        names=tuple(system.names[column] for column in free),
        instruments=None if system.instruments is None else system.instruments[:, free],
    )
    fit = solver(smaller)
    solution, covariance = values.copy(), np.zeros((columns, columns))
    solution[free] = fit.solution
    covariance[np.ix_(free, free)] = fit.covariance
    return replace(fit, solution=solution, covariance=covariance), tuple(held)


def dependence_sentence(
    names: Sequence[str], dependent: Sequence[tuple[int, Sequence[tuple[int, float]]]]
) -> str:
    """Return the sentence on columns that the log does not separate."""
    texts = []
    for index, coefficients in dependent:
        terms = [
            f"{coefficient:+.3g} {names[column]}"
            for column, coefficient in coefficients
            if abs(coefficient) > NEGLIGIBLE_COEFFICIENT
        ]
        texts.append(f"{names[index]} = {brief(' '.join(terms).lstrip('+') or '0', 34)}")
    shown = series(texts, 50)
    return (
        f"the log does not separate {len(dependent)} of {len(names)} parameters (columns of W: {shown}); excite them, or fix or "
        "drop them under [parameters]"
    )


SMALLEST_RELATIVE_RESIDUAL = 1e-9
"""Lower bound of a joint's residual, as a share of its torque: weights stay finite on logs without noise."""


def joint_sigma(system: LinearSystem, residual: Array) -> Array:
    """Root mean square of each joint's residuals, never zero; shape (n_dof,)."""
    return positive_rms(system.norms(residual), system.norms(system.measured), system.counts)


def positive_rms(residual: Array, measured: Array, counts: Array | NDArray[np.intp] | float) -> Array:
    """Root mean square of residuals from their norms, those of the torques, (n_dof,) each, and the numbers of rows; never zero."""
    sigma, torque = residual / np.sqrt(counts), measured / np.sqrt(counts)
    # A joint without torque gets the size of the largest.
    floor = SMALLEST_RELATIVE_RESIDUAL * np.where(torque > 0.0, torque, torque.max(initial=0.0))
    sigma = np.maximum(sigma, floor)
    return cast(Array, np.where(sigma > 0.0, sigma, 1.0))


def per_row(system: LinearSystem, per_joint: Sequence[float] | Array) -> Array:
    """Value of each row's joint, shape (r,)."""
    return np.repeat(np.asarray(per_joint, dtype=np.float64), system.counts)
