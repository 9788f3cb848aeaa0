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
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from . import _core
from .errors import FitError, RankError
from .schema import counted

Array = NDArray[np.float64]
Weights = Literal["none", "per-joint"]
Variance = Literal["r-b", "r-1"]

# A joint whose residual is rounding noise would get an infinite weight; its rows are held at this share of
# its torque.
SMALLEST_RELATIVE_RESIDUAL = 1e-9

# The weights settle within a few solutions.
MOST_REWEIGHTINGS = 1000

# A joint with fewer expected squares than this share of its rows takes the variance of all joints.
SMALLEST_SHARE = 0.05

# A dependence is told without the coefficients that are rounding noise.
NEGLIGIBLE_COEFFICIENT = 1e-6


@dataclass(frozen=True, kw_only=True)
class LeastSquaresSettings:
    """How (7) is solved and its covariance is scaled.

    Parameters
    ----------
    weights : {"per-joint", "none"}
        Divide the rows of each joint by the size of its residuals, or solve once as they are.
    reweightings : int
        How often the weights are estimated and the system is solved again (used with "per-joint").
    variance : {"r-b", "r-1"}
        Divisor of (9): unbiased, or that of the published EMPS results.
    decimation_corrected : bool
        Covariance for noise that decimation has correlated, with a variance per joint where the weights are; `variance` is
        then only that of the printed standard deviation of the error.

    Raises
    ------
    FitError
        For a value that is none of these.
    """

    weights: Weights = "per-joint"
    reweightings: int = 1
    variance: Variance = "r-b"
    decimation_corrected: bool = True

    def __post_init__(self) -> None:
        if self.weights not in ("none", "per-joint"):
            raise FitError(f"weights must be 'none' or 'per-joint', got {self.weights!r}")
        if self.variance not in ("r-b", "r-1"):
            raise FitError(f"variance must be 'r-b' or 'r-1', got {self.variance!r}")
        if (
            isinstance(self.reweightings, bool)
            or not isinstance(self.reweightings, int)
            or not 0 <= self.reweightings <= MOST_REWEIGHTINGS
        ):
            raise FitError(
                f"reweightings must be a whole number from 0 to {MOST_REWEIGHTINGS}, got {self.reweightings!r}"
            )
        if not isinstance(self.decimation_corrected, bool):
            raise FitError(f"decimation_corrected must be true or false, got {self.decimation_corrected!r}")

    @property
    def solutions(self) -> int:
        """Number of systems to solve."""
        return 1 + self.reweightings if self.weights == "per-joint" else 1


@dataclass(frozen=True, kw_only=True)
class LinearSystem:
    """The system (7): rows joint by joint, a column per parameter to estimate.

    Parameters
    ----------
    w : ndarray, shape (r, b)
        Observation matrix.
    y : ndarray, shape (r,)
        Measured torques, N.m or N, joint side.
    joints : tuple of slice
        Rows of each joint.
    names : tuple of str
        Names of the columns.
    known : ndarray, shape (r,), optional
        Torques of the parameters that are fixed, already taken out of ``y``.
    windows : tuple of int
        Rows of each window within a joint's; one window by default.
    """

    w: Array
    y: Array
    joints: tuple[slice, ...]
    names: tuple[str, ...]
    known: Array | None = None
    windows: tuple[int, ...] = ()

    @property
    def measured(self) -> Array:
        """Measured torques, shape (r,): those of fixed parameters included."""
        return self.y if self.known is None else self.y + self.known

    def norms(self, rows: Array) -> Array:
        """2-norm of each joint's part of a vector of r rows, shape (n_dof,)."""
        return np.array([np.linalg.norm(rows[joint]) for joint in self.joints])


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
            raise RankError(_dependence(system.names, scaled.dependent))
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
            covariance = _correlated_covariance(
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


def _correlated_covariance(
    system: LinearSystem,
    settings: LeastSquaresSettings,
    scale: Array,
    residual: Array,
    inverse_r: Array,
    correlation: Array,
) -> Array:
    """Covariance for noise with a correlation in each window of each joint; rows and residual are divided by the weights."""
    b = inverse_r.shape[0]
    colored, plain = np.empty((len(system.joints), b, b)), np.empty((len(system.joints), b, b))
    for joint, rows in enumerate(system.joints):
        # In the orthonormal columns Q = W R^-1: in those of a nearly dependent W rounding would make variances negative.
        q = (system.w[rows] * scale[rows, None]) @ inverse_r
        plain[joint] = q.T @ q
        colored[joint] = q.T @ _apply_correlation(q, system.windows or (len(q),), correlation)
    squares = np.array([residual[rows] @ residual[rows] for rows in system.joints])
    sizes = np.array([rows.stop - rows.start for rows in system.joints], dtype=np.float64)
    # What is left of unit noise: the trace of (1 - H) T (1 - H) within the rows of the joint, H = Q Q^T.
    traces = np.trace(colored, axis1=1, axis2=2)
    expected = sizes - 2.0 * traces + np.einsum("jab,ab->j", plain, colored.sum(axis=0))
    if settings.weights == "none":
        variances = np.full(len(squares), squares.sum() / expected.sum())
    else:
        # A joint whose rows hardly outnumber its own parameters cannot tell its noise: all joints together can.
        pooled = squares.sum() / expected.sum()
        told_by_itself = expected > SMALLEST_SHARE * sizes
        variances = np.where(told_by_itself, squares / np.where(told_by_itself, expected, 1.0), pooled)
    return np.asarray(inverse_r @ np.einsum("j,jab->ab", variances, colored) @ inverse_r.T)


def _apply_correlation(w: Array, windows: Sequence[int], correlation: Array) -> Array:
    """``T w`` with a symmetric Toeplitz matrix in each window of rows."""
    out = np.empty_like(w)
    start = 0
    for length in windows:
        lags = np.zeros(length)
        known = min(length, correlation.size)
        lags[:known] = correlation[:known]
        # The matrix is a corner of a circulant one, which the Fourier transform makes diagonal.
        circle = np.concatenate([lags, [0.0], lags[:0:-1]])
        spectrum = np.fft.rfft(circle)[:, None] * np.fft.rfft(w[start : start + length], circle.size, axis=0)
        out[start : start + length] = np.fft.irfft(spectrum, circle.size, axis=0)[:length]
        start += length
    return out


def check_size(system: LinearSystem) -> None:
    """Refuse torques and columns whose sum of squares no floating-point number holds.

    Raises
    ------
    FitError
        Naming the joint or the parameter (``test_least_squares.py``).
    """
    with np.errstate(over="ignore", invalid="ignore"):
        torques, columns = system.norms(system.measured), np.linalg.norm(system.w, axis=0)
        rest = system.norms(system.y)
    cure = "check their unit, the drive gain and the values of fixed parameters"
    for joint, rows in enumerate(system.joints):
        if not np.isfinite(torques[joint] + rest[joint]):
            raise FitError(f"the torques of joint {joint + 1} are too large to be squared; {cure}")
        if torques[joint] == 0.0 and system.measured[rows].any():
            raise FitError(f"the torques of joint {joint + 1} are too small to be squared; {cure}")
    for column in np.flatnonzero(~np.isfinite(columns)):
        name = system.names[column]
        raise FitError(f"the column of {name} is too large to be squared; check the unit of the positions")


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


def _dependence(names: Sequence[str], dependent: Sequence[tuple[int, Sequence[tuple[int, float]]]]) -> str:
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
