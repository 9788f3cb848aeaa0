"""Figures of merit of a method on a scenario, each with a confidence interval over the runs.

A method is judged by medians, quantiles and coverage over the runs, and by the number of failures. The figure of the published
study, the error of the mean estimate, is included. Tested in ``tests/test_study_figures.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._tools.arrays import Array, quotient
from ..result.iteration import Status
from ..result.uncertainty import student_factor
from .worker import ERROR, FAILED, LOST

LEVEL = 0.95
"""Confidence level of the intervals of parameters and of the figures of merit."""
TAILS = ((1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0)
"""Quantiles at the ends of an interval."""
NAN = math.nan
RESAMPLES = 400
"""Number of bootstrap resamples of the runs for the interval of a figure."""


@dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % interval over the runs, or NaN."""

    value: float
    low: float = NAN
    high: float = NAN


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Figures of merit of a method on a scenario.

    Attributes
    ----------
    scenario, method : str
        Names.
    runs, failed, not_converged : int
        Number of runs; of those without an estimate, because of an error or a lost worker; and of those that did not converge,
        whose estimates are included below.
    bias : Estimate
        Mean error of a parameter in reported standard deviations, root mean square over the parameters, less the scatter of the
        mean over the runs.
    rms : Estimate
        Error of a parameter in reported standard deviations, root mean square over parameters and runs: 1 for correct standard
        deviations.
    coverage : Estimate
        Share of the parameters within their 95 % intervals.
    torque_error : Estimate
        Median over the runs of the relative torque error on the other motion.
    torque_error_q95 : float
        Its 95 % quantile.
    parameter_error : Estimate
        Median of ``|beta - truth| / |truth|``.
    mean_error : float
        The same for the mean estimate over the runs, as tabulated in the published study; averaging conceals scatter.
    simulations, seconds : float
        Medians.
    """

    scenario: str
    method: str
    runs: int
    failed: int
    not_converged: int
    bias: Estimate
    rms: Estimate
    coverage: Estimate
    torque_error: Estimate
    torque_error_q95: float
    parameter_error: Estimate
    mean_error: float
    simulations: float
    seconds: float


# Numbers of a damaged file may have infinite squares; the figures are then infinite too.
@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def figures_of(
    scenario: str,
    method: str,
    rows: Sequence[Mapping[str, Any]],
    truth: Sequence[float | None],
    seconds: Sequence[float],
) -> Figures:
    """Return the figures of a method on a scenario.

    Parameters
    ----------
    scenario, method : str
        Names.
    rows : sequence
        Its rows.
    truth : sequence
        True base parameters; None for one that the simulated robot does not have.
    seconds : sequence of float
        Times of the runs, where known.
    """
    fits = [row for row in rows if row["status"] not in (FAILED, ERROR, LOST)]
    known = np.array(truth, dtype=np.float64)  # NaN for None
    # A method with its own keys may have other parameters than the scenario; then only its torques are judged.
    alike = [row for row in fits if len(row["beta"]) == len(known)]
    beta, std = (
        np.array([row[key] for row in alike], dtype=np.float64).reshape(len(alike), len(known))
        for key in ("beta", "std")
    )
    factor = np.array([row["factor"] for row in alike], dtype=np.float64)[:, None]
    # A parameter without standard deviation or true value is not judged (z is NaN).
    z = quotient(beta - known, std, np.nan)
    judged = np.isfinite(z)
    z = z[judged.any(axis=1)][:, judged.any(axis=0)]
    within = np.where(np.isfinite(z), np.abs(z) <= factor[judged.any(axis=1)], np.nan)
    off = np.linalg.norm(np.nan_to_num(beta - known), axis=1) / np.linalg.norm(np.nan_to_num(known))
    torque = np.array([row["torque_error"] for row in fits], dtype=np.float64)
    return Figures(
        scenario=scenario,
        method=method,
        runs=len(rows),
        failed=len(rows) - len(fits),
        not_converged=sum(not Status[row["status"]].converged for row in fits),
        bias=_bias(z),
        rms=_rms(z),
        coverage=_mean(within),
        torque_error=_median(torque),
        torque_error_q95=_quantile(torque, LEVEL),
        parameter_error=_median(off),
        mean_error=_error_of_mean(beta, known),
        simulations=_quantile(np.array([row["simulations"] for row in fits], dtype=np.float64), 0.5),
        seconds=_quantile(np.array(seconds, dtype=np.float64), 0.5),
    )


def _error_of_mean(beta: Array, known: Array) -> float:
    size = np.linalg.norm(np.nan_to_num(known))
    if not len(beta) or size == 0.0:
        return NAN
    return float(np.linalg.norm(np.nan_to_num(beta.mean(axis=0) - known)) / size)


def _bias(z: Array) -> Estimate:
    """Return the root mean square over parameters of the mean of z over runs, less the scatter of that mean."""
    if not len(z):
        return Estimate(NAN)
    whole = np.ones((1, len(z))) / len(z)
    raw, value = (float(squares[0]) for squares in _squared_bias(z, whole))
    if len(z) < 2:
        return Estimate(math.sqrt(max(0.0, value)))
    # A resampled mean scatters around the uncorrected mean of these runs.
    off = _squared_bias(z, _resampled(len(z)))[1] - raw
    low, high = value + np.quantile(off, TAILS)
    return Estimate(*(math.sqrt(max(0.0, square)) for square in (value, float(low), float(high))))


def _squared_bias(z: Array, weights: Array) -> tuple[Array, Array]:
    """Return the mean square over parameters of the mean of z, with and without the scatter of that mean, (resamples,) each.

    Parameters without any value in a resample are ignored there.
    """
    known = np.isfinite(z)
    share = weights @ known
    values = np.where(known, z, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        means, squares = weights @ values / share, weights @ values**2 / share
    runs = np.maximum(known.sum(axis=0), 2)
    return (np.nanmean(means**2, axis=1), np.nanmean(means**2 - (squares - means**2) / (runs - 1), axis=1))


def _rms(z: Array) -> Estimate:
    """Return the root mean square of z over parameters and runs."""
    if not len(z):
        return Estimate(NAN)
    known = np.isfinite(z)
    squares, counts = np.where(known, z**2, 0.0).sum(axis=1), known.sum(axis=1)
    value = math.sqrt(float(squares.sum() / counts.sum()))
    if len(z) < 2:
        return Estimate(value)
    weights = _resampled(len(z))
    root = np.sqrt(weights @ squares / (weights @ counts))
    return Estimate(value, *np.quantile(root, TAILS).tolist())


def _resampled(runs: int) -> Array:
    """Return the weights of the runs in bootstrap resamples, (resamples, runs), reproducible for the same rows."""
    chosen = np.random.default_rng(runs).integers(0, runs, (RESAMPLES, runs))
    return np.stack([np.bincount(row, minlength=runs) for row in chosen]) / runs


def _mean(shares: Array) -> Estimate:
    """Return the mean over runs of the share of parameters: runs are independent, but the parameters of one run are not."""
    if not shares.size:
        return Estimate(NAN)
    per_run = np.nanmean(shares, axis=1)
    value = float(per_run.mean())
    if len(per_run) < 2:
        return Estimate(value)
    half = student_factor(LEVEL, len(per_run) - 1.0) * float(per_run.std(ddof=1)) / math.sqrt(len(per_run))
    return Estimate(value, max(0.0, value - half), min(1.0, value + half))


def _median(values: Array) -> Estimate:
    """Return the median with the interval between order statistics, valid for any distribution."""
    values = np.sort(values[np.isfinite(values)])
    median, rank = _quantile(values, 0.5), _rank(len(values))
    return (
        Estimate(median) if rank is None else Estimate(median, float(values[rank]), float(values[-1 - rank]))
    )


def _rank(n: int) -> int | None:
    """Return the largest k with the median between order statistics k and n - 1 - k (from 0) in 95 % of samples, or None."""
    total, rank = 0.0, None
    for k in range(n // 2):
        total += math.comb(n, k) * 0.5**n
        if 2.0 * total > 1.0 - LEVEL:
            break
        rank = k
    return rank


def _quantile(values: Array, share: float) -> float:
    values = values[np.isfinite(values)]
    return float(np.quantile(values, share)) if len(values) else NAN
