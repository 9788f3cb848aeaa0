"""Drive gains by maximum likelihood: Gauss-Newton on (log K, theta), with the current as the noisy output.

    min sum_m n_m log s_m,    s_m^2 = |i_m - (W_m theta + t_m) / K_m|^2 / n_m

The noisy currents are the output, because estimates with currents in the regressor are biased (`classical.py`). The sign of a
gain is the one with which friction brakes. Tested in ``tests/test_drive_gains.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import joints_text, series
from ...errors import FitError, RankError
from ...terms.rows import LinearSystem, unit_columns
from ..covariance import covariance
from ..descent import descend
from ..fit import Fit
from ..settings import LeastSquaresSettings
from .currents import Currents

GAIN_STEPS = 100
"""Upper bound of the Gauss-Newton steps."""
SETTLED_LOG_GAIN = 1e-10
"""Change of log K below which the iteration has converged."""
LARGEST_STEP = 0.5
"""Largest change of log K in a step."""
SINGULAR = 1e-11
"""Smallest singular value of the scaled Jacobian, as a share of the largest, for the log to determine the gains."""
WEAK_GAIN_PERCENT = 20.0
"""Expected standard deviation of a gain (%) from which the known load hardly acts on its joint."""


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains and parameters, with the problem linearised there.

    Attributes
    ----------
    gains : (n,) array
        Drive gains (N.m/A or N/A), on the side of the reduction.
    system : LinearSystem
        The problem linearised there, in units of motor torque: a column for every parameter, gains last.
    fit : Fit
        Solution, covariance and residual in these units.
    iterations : int
        Gauss-Newton steps.
    """

    gains: Array
    system: LinearSystem
    fit: Fit
    iterations: int


def drive_gains(
    system: LinearSystem, reduction: Array, settings: LeastSquaresSettings, start: Array | None = None
) -> Gains:
    """Estimate drive gains and parameters together.

    Parameters
    ----------
    system : LinearSystem
        System as for `Currents`.
    reduction : (n, n) array
        Reduction matrix R of the currents; the identity for currents of the joints.
    settings : LeastSquaresSettings
        Settings of the covariance.
    start : (n,) array, optional
        Initial gains with the right signs; by default one gain for all motors, from a linear solution.

    Returns
    -------
    Gains

    Raises
    ------
    FitError
        Without known parameters, and when the currents do not identify gains or parameters.
    """
    currents = Currents.of(system, reduction)
    gains = first_gains(currents) if start is None else np.array(start, dtype=np.float64)
    there, number, converged = descend(_Point(currents, gains, currents.parameters(gains)), GAIN_STEPS)
    return _result(there, settings, converged, number)


@dataclass(frozen=True, eq=False)
class _Point:
    """Gains and parameters, with the errors of the currents there."""

    currents: Currents
    gains: Array
    theta: Array

    @cached_property
    def errors(self) -> Array:
        currents = self.currents
        torque = currents.columns @ self.theta + currents.known
        return np.asarray(currents.current - torque / self.gains[currents.motor])

    @cached_property
    def cost(self) -> float:
        """Negative log-likelihood up to constants."""
        return float(np.bincount(self.currents.motor) @ np.log(self.currents.spread(self.errors)))

    @cached_property
    def step(self) -> Array:
        """Gauss-Newton step of the parameters and of log K."""
        weights = 1.0 / self.currents.spread(self.errors)[self.currents.motor]
        jacobian, size = _jacobian(self.currents, self.gains, self.theta, weights)
        return np.asarray(np.linalg.lstsq(jacobian, self.errors * weights, rcond=SINGULAR)[0] / size)

    def length(self, share: float) -> float:
        """Share of the step with which no gain changes by more than `LARGEST_STEP`."""
        largest = float(np.abs(self.step[-self.currents.n_motors :]).max())
        return min(1.0, LARGEST_STEP / max(largest, 1e-300)) * share

    def moved(self, share: float) -> _Point:
        n, length = self.currents.n_motors, self.length(share)
        gains = self.gains * np.exp(length * self.step[-n:])
        return replace(self, gains=gains, theta=self.theta + length * self.step[:-n])

    def rests(self, share: float) -> bool:
        change = self.length(share) * self.step[-self.currents.n_motors :]
        return bool(np.abs(change).max() < SETTLED_LOG_GAIN)


def first_gains(currents: Currents) -> Array:
    """Return one gain for all motors, with their signs, (n,).

    Raises
    ------
    FitError
        Without a known torque: the currents then only determine ratios of parameters to gains.
    """
    if not np.abs(currents.known).max(initial=0.0) > 0.0:
        raise FitError(
            "currents identify only ratios of parameters to drive gains: add a recording with a payload of known mass (mass_kg "
            "in its table [payload]), or give the gains"
        )
    signs = currents.signs()
    turned = replace(currents, current=currents.current * signs[currents.motor])
    inverse = turned.inverse_gain()
    return signs / inverse if inverse > 0.0 else signs


def expected_percent(system: LinearSystem, reduction: Array) -> Array:
    """Return the expected standard deviations of a log's gains (%), (n,); infinite for those it does not identify.

    The information is evaluated at a linear estimate with one gain for all motors, and is accurate if the gains are similar;
    the noise is the residual of a separate linear fit per motor.
    """
    currents = Currents.of(system, reduction)
    gains = first_gains(currents)
    theta = currents.parameters(gains)
    errors = _Point(currents, gains, theta).errors
    # With one gain for all, the residual contains the gains' errors; separate ratios leave the noise.
    for motor in range(currents.n_motors):
        rows = currents.motor == motor
        a = np.column_stack([currents.columns[rows] / currents.scale, currents.known[rows]])
        errors[rows] = currents.current[rows] - a @ np.linalg.lstsq(a, currents.current[rows], rcond=1e-8)[0]
    weights = 1.0 / currents.spread(errors)[currents.motor]
    jacobian, size = _jacobian(currents, gains, theta, weights)
    _, singular, right = np.linalg.svd(jacobian, full_matrices=False)
    share = singular / singular[0]
    identified = share > SINGULAR
    n = currents.n_motors
    variances = np.sum((right[identified][:, -n:] / singular[identified, None]) ** 2, axis=0)
    lost = np.sum(right[np.logical_not(identified)][:, -n:] ** 2, axis=0) > 1e-6
    return np.where(lost, np.inf, 100.0 * np.sqrt(variances) / size[-n:])


def expected_sentence(percent: Array) -> str:
    """Return the sentence on the expected accuracy of the gains."""
    shown = series((f"{value:.2g}" if np.isfinite(value) else "-" for value in percent), 36)
    weak = [joint for joint, value in enumerate(percent) if not value < WEAK_GAIN_PERCENT]
    hardly = f"; the known load hardly reaches {joints_text(weak)}" if weak else ""
    return f"expected standard deviations of the drive gains, for white noise: {shown} %{hardly}"


def _jacobian(currents: Currents, gains: Array, theta: Array, weights: Array) -> tuple[Array, Array]:
    """Return the weighted derivatives of the modelled currents by (theta, log K) as unit columns, and their lengths."""
    own = gains[currents.motor]
    torque = currents.columns @ theta + currents.known
    jacobian = np.hstack([currents.columns / own[:, None], currents.motors * (-torque / own)[:, None]])
    return unit_columns(jacobian * weights[:, None])


def _result(point: _Point, settings: LeastSquaresSettings, converged: bool, number: int) -> Gains:
    """Linearise at the solution, in units of motor torque, and compute its covariance."""
    currents, gains, theta, errors = point.currents, point.gains, point.theta, point.errors
    own = gains[currents.motor]
    system = currents.linearised(theta, gains)
    columns = system.w
    weights = 1.0 / np.abs(own * currents.spread(errors)[currents.motor])
    weighted = columns * weights[:, None]
    size = np.linalg.norm(weighted, axis=0)
    names = currents.system.names
    if not (size > 0.0).all():
        raise RankError(f"no motion shows {names[int(np.argmin(size))]}", (int(np.argmin(size)),))
    _, triangle = np.linalg.qr(weighted / size)
    left, singular, right = np.linalg.svd(triangle)
    if singular[-1] < SINGULAR * singular[0]:
        lost = [names[k] for k in np.flatnonzero(np.abs(right[-1]) > 0.1)]
        raise RankError(
            f"the currents do not separate {series(lost)}: the known payloads have no effect on them",
            tuple(int(k) for k in np.flatnonzero(np.abs(right[-1]) > 0.1)),
        )
    inverse_r = (right.T / singular) @ left.T / size[:, None]
    residual = own * errors
    return Gains(
        gains=gains,
        system=system,
        fit=Fit(
            solution=np.concatenate([theta, gains]),
            covariance=covariance(system, settings, weights, residual, inverse_r),
            residual=residual,
            weights=weights,
            condition_number=float(singular[0] / singular[-1]),
            converged=converged,
            record={"gains": "maximum-likelihood", "iterations": number},
        ),
        iterations=number,
    )
