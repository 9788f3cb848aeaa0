"""Least squares with one weight per joint, and what the residual says of the estimate: equations (7) to (11).

    Y = W beta + rho                       rows joint by joint                         (7)
    sigma^2 = |Y - W beta|^2 / (r - b)     or r - 1, as MATLAB's ``std`` divides       (9)
    C = sigma^2 (W^T W)^-1 = sigma^2 R^-1 R^-T       with W = Q R                     (10)

The torques of a shoulder and of a wrist have errors of different sizes. With ``weights="per-joint"`` the rows
of joint j are divided by the root mean square of its residuals, found by a first solution without weights,
and (7) to (10) are written for the divided rows. A factor common to all weights changes neither beta nor C.

Decimated noise is correlated: the filter lets pass only part of the band that is left, so that r rows tell less than
r independent ones. With ``decimation_corrected`` the covariance says so: for torque noise of size sigma_j that was white
before decimation, with the correlation T of its kept samples (``signals.noise_correlation``),

    C = P (sum_j sigma_j^2 W_j^T T W_j) P,   P = (W^T W)^-1,   sigma_j^2 = |rho_j|^2 / E_j

where E_j is the expectation of ``|rho_j|^2`` for unit noise, which takes the place of the rows less parameters of (9).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import FitError, RankError
from .covariance import correlated_covariance
from .linear_system import LinearSystem, check_size
from .settings import LeastSquaresSettings

# A joint whose residual is rounding noise would get an infinite weight; its rows are held at this share of
# its torque.
SMALLEST_RELATIVE_RESIDUAL = 1e-9


# A dependence is told without the coefficients that are rounding noise.
NEGLIGIBLE_COEFFICIENT = 1e-6


@dataclass(frozen=True, kw_only=True)
class WeightedFit:
    """Solution of a `LinearSystem`.

    Attributes
    ----------
    solution : ndarray, shape (b,)
        Estimate.
    covariance : ndarray, shape (b, b)
        Equation (10).
    residual : ndarray, shape (r,)
        ``Y - W beta`` in the units of Y, without weights.
    joint_sigma : ndarray, shape (n_dof,)
        What the rows of each joint were divided by in the last solution (ones without weights).
    condition_number : float
        Of W as it is, without weights.
    stopped : bool
        Whether the callback asked to stop.
    """

    solution: Array
    covariance: Array
    residual: Array
    joint_sigma: Array
    condition_number: float
    stopped: bool


def solve(
    system: LinearSystem,
    settings: LeastSquaresSettings,
    *,
    correlation: Array | None = None,
    progress: Callable[[int, Array, Array], bool] | None = None,
) -> WeightedFit:
    """Solve (7) by QR, with weights per joint estimated from the residuals, and its covariance (8) to (10).

    Parameters
    ----------
    system : LinearSystem
        Rows joint by joint.
    settings : LeastSquaresSettings
        Weights and variance.
    correlation : ndarray, shape (n_lags,), optional
        Of decimated white noise, from lag 0 on (`signals.noise_correlation`); None for white noise.
    progress : callable, optional
        Called with the number of the solution, beta and the residual after each one; True stops.

    Returns
    -------
    WeightedFit
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
    are as large as the covariance says, with and without decimation.
    """
    rows, columns = system.w.shape
    if columns == 0:
        raise FitError("no parameter is left to estimate: all are fixed or dropped")
    if rows <= columns:
        raise FitError(
            f"{counted(rows, 'row')} cannot determine {counted(columns, 'parameter')}; "
            "use a longer record or window, or decimate less"
        )
    check_size(system)
    sigma = np.ones(len(system.joints))
    residual = system.y
    condition_number = float("inf")
    # The last solution of the loop is the result; the first one has no weights.
    for number in range(1, settings.solutions + 1):
        if number > 1:
            sigma = _joint_sigma(system, residual)
        scale = _per_row(system, 1.0 / sigma)
        try:
            scaled = _core.least_squares(
                np.ascontiguousarray(system.w * scale[:, None]), np.ascontiguousarray(system.y * scale)
            )
        except ValueError as reason:
            raise FitError(str(reason)) from None
        if scaled.dependent:
            raise RankError(dependence_sentence(system.names, scaled.dependent))
        if number == 1:
            condition_number = _condition_number(np.asarray(scaled.singular_values))
        beta = np.asarray(scaled.solution)
        residual = system.y - system.w @ beta
        # Asked to stop after the last solution, there is nothing left to stop.
        stopped = progress is not None and progress(number, beta, residual) and number < settings.solutions
        if stopped:
            break
    inverse_r = np.asarray(scaled.inverse_r)
    with np.errstate(over="ignore", invalid="ignore"):  # told below
        if settings.decimation_corrected and correlation is not None:
            covariance = correlated_covariance(
                system, settings, scale, residual * scale, inverse_r, correlation
            )
        else:
            variance = float(np.sum((residual * scale) ** 2)) / _divisor(system, settings)
            covariance = variance * (inverse_r @ inverse_r.T)
    bad = np.flatnonzero(~(np.isfinite(beta) & np.isfinite(np.diag(covariance))))
    if bad.size:
        raise FitError(
            f"parameter {system.names[bad[0]]} and its standard deviation cannot be told in floating point; "
            "check the units of the log"
        )
    return WeightedFit(
        solution=beta,
        covariance=covariance,
        residual=residual,
        joint_sigma=sigma,
        condition_number=condition_number,
        stopped=stopped,
    )


def _condition_number(singular: Array) -> float:
    return float(singular.max() / singular.min()) if singular.min() > 0.0 else float("inf")


def row_weights(system: LinearSystem, fit: WeightedFit) -> Array:
    """Return what each row was multiplied by in the last solution, shape (r,)."""
    return _per_row(system, 1.0 / fit.joint_sigma)


def residual_std(system: LinearSystem, fit: WeightedFit, settings: LeastSquaresSettings) -> float:
    """Return the standard deviation of the torque error of all joints: the root of (9) without weights."""
    return float(np.linalg.norm(fit.residual)) / float(np.sqrt(_divisor(system, settings)))


def _divisor(system: LinearSystem, settings: LeastSquaresSettings) -> int:
    rows, columns = system.w.shape
    return int(rows - columns if settings.variance == "r-b" else rows - 1)


def _per_row(system: LinearSystem, per_joint: Array) -> Array:
    """Value of each row's joint, shape (r,)."""
    rows = np.empty(system.y.size)
    for joint, value in zip(system.joints, per_joint, strict=True):
        rows[joint] = value
    return rows


def _joint_sigma(system: LinearSystem, residual: Array) -> Array:
    """Root mean square of each joint's residuals, never zero; shape (n_dof,)."""
    counts = np.array([joint.stop - joint.start for joint in system.joints])
    sigma = system.norms(residual) / np.sqrt(counts)
    torque = system.norms(system.y) / np.sqrt(counts)
    # A joint without torque has no size of its own: it takes that of the largest.
    floor = SMALLEST_RELATIVE_RESIDUAL * np.where(torque > 0.0, torque, torque.max(initial=0.0))
    sigma = np.maximum(sigma, floor)
    return cast(Array, np.where(sigma > 0.0, sigma, 1.0))


def dependence_sentence(
    names: Sequence[str], dependent: Sequence[tuple[int, Sequence[tuple[int, float]]]]
) -> str:
    """One sentence that says which columns the log cannot tell apart."""
    texts = []
    for index, coefficients in dependent:
        terms = [
            f"{coefficient:+.3g} {names[column]}"
            for column, coefficient in coefficients
            if abs(coefficient) > NEGLIGIBLE_COEFFICIENT
        ]
        texts.append(f"{names[index]} = {' '.join(terms).lstrip('+')}" if terms else f"{names[index]} = 0")
    shown = "; ".join(texts[:5]) + (f"; and {len(texts) - 5} more" if len(texts) > 5 else "")
    return (
        f"the log cannot tell {len(dependent)} of {len(names)} parameters from the others "
        f"(columns of W: {shown}); "
        "excite them, or fix or drop them under [parameters]"
    )
