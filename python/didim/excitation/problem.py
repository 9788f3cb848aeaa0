"""The design as an unconstrained problem: a criterion of the information, less penalties on torques and clearances.

Tested in ``tests/test_excitation.py``: gradients against differences, values against the regressor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from ..model.dynamics import inverse_dynamics
from ..robot.robot import Robot
from .clearance import Clearance
from .criterion import Criterion
from .series import SAMPLES_PER_PERIOD, ScaledSeries, Series

FINE = 20
"""Ratio of the verification grid to the optimiser's grid: every limit is verified on this finer grid."""
CLEARANCE_SCALE = 0.1
"""Missing clearance (m) that weighs as much as a torque at twice its limit: a millimetre counts as 1 %."""
SMALLEST_MOTION_SCALE = 0.01
"""Scale of the amplitudes below which a motion identifies nothing."""


@dataclass(frozen=True, kw_only=True)
class Information:
    """Information of a motion on the base parameters.

    Attributes
    ----------
    robot : Robot
        Robot with the friction model of the criterion.
    sigma : (n_dof,) array
        Standard deviation of the torques' noise at each of the logged samples (N.m or N).
    samples : float
        Logged samples of the whole motion.
    prior : (n_base, n_base) array
        Information from earlier logs.
    """

    robot: Robot
    sigma: Array
    samples: float
    prior: Array

    @property
    def columns(self) -> list[int]:
        """Columns of the base parameters in the regressor."""
        return list(self.robot.base_parameters.indices)

    @property
    def plain(self) -> Information:
        """Information of a motion alone, ``W' W`` over the number of samples: without noise and without a prior."""
        n = self.robot.n_dof
        return Information(robot=self.robot, sigma=np.ones(n), samples=1.0, prior=np.zeros_like(self.prior))

    def matrix(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the information of a motion on any uniform grid, prior included."""
        return self.prior + self.own(q, dq, ddq, self.samples)

    def own(self, q: Array, dq: Array, ddq: Array, samples: float) -> Array:
        """Return the information of a motion on any uniform grid, logged with a number of samples, without the prior."""
        weights = samples / len(q) / self.sigma**2
        return _core.information(self.robot.core, q, dq, ddq, self.columns, weights)


class Problem:
    """Value and gradient of a design in the variables of its series.

    Parameters
    ----------
    series : ScaledSeries
        Variables and limits.
    information : Information
        Information of a motion.
    criterion : Criterion
        Function of the information, to be maximised.
    x : (n_parameters,) array or None
        Standard parameters for the torques; None where torques are not limited.
    clearance : Clearance
        Clearances.

    Attributes
    ----------
    thinning : int
        1 for the whole grid of the series; k for every k-th sample, a divisor of 20, in less time.
    """

    def __init__(
        self,
        series: ScaledSeries,
        information: Information,
        criterion: Criterion,
        x: Array | None,
        clearance: Clearance,
    ) -> None:
        self.series, self.information, self.criterion = series, information, criterion
        self.x, self.clearance = x, clearance
        # Tolerance of the penalties, reduced by `tighten` according to the fine grid.
        self.torque_share, self.extra_clearance = np.ones(series.n), 0.0
        # Every sample of the grid is used, or every k-th.
        self.thinning = 1

    def value(self, v: Array, weight: float) -> tuple[float, Array]:
        """Return the objective to be minimised and its gradient; `weight` is that of the penalties."""
        motion, chain = self.series.build(v)
        q, dq, ddq = (values[:: self.thinning] for values in motion.motion()[:3])
        information = self.information
        value, derivative = self.criterion(information.matrix(q, dq, ddq))
        weight *= self.thinning
        objective, torque_weights = -value, None
        torques = self.torques(q, dq, ddq)
        if torques is not None:
            largest = self.torque_share * self.series.limits.torque
            relative = torques / largest
            excess = np.maximum(np.abs(relative) - 1.0, 0.0)
            if excess.any():
                objective += weight * float((excess**2).sum())
                torque_weights = 2.0 * weight * excess * np.sign(relative) / largest
        gq, gdq, gddq = _core.information_gradient(
            information.robot.core,
            q,
            dq,
            ddq,
            information.columns,
            information.samples / len(q) / information.sigma**2,
            -derivative,
            torque_weights,
            None if torque_weights is None else self.x,
        )
        if not self.clearance.empty:
            short, slope = self.clearance.penalty(q, CLEARANCE_SCALE, self.extra_clearance)
            objective += weight * short
            gq = gq + weight * slope
        return objective, self.series.back(chain, *(self._whole(values) for values in (gq, gdq, gddq)))

    def _whole(self, values: Array) -> Array:
        """Return the gradient on the whole grid, zero at unused samples."""
        if self.thinning == 1:
            return values
        whole = np.zeros((self.series.basis.samples, self.series.n))
        whole[:: self.thinning] = values
        return whole

    def torques(self, q: Array, dq: Array, ddq: Array) -> Array | None:
        """Torques of a motion (N.m or N), ``(n_samples, n_dof)``; None where torques are not limited."""
        return None if self.x is None else inverse_dynamics(self.information.robot, q, dq, ddq, self.x)

    def excess(self, series: Series) -> tuple[Array, float]:
        """Return the excess over each torque limit (relative) and the missing clearance (m) of a motion, on the fine grid."""
        q, dq, ddq, _ = series.motion(FINE)
        torque, clearance = np.zeros(self.series.n), 0.0
        torques = self.torques(q, dq, ddq)
        if torques is not None:
            torque = np.maximum(np.abs(torques / self.series.limits.torque).max(axis=0) - 1.0, 0.0)
        if not self.clearance.empty:
            clearance = max(0.0, -float(self.clearance.distances(q).min()))
        return torque, clearance

    def keeps(self, series: Series) -> bool:
        """Whether a motion respects torque limits and clearances on the fine grid."""
        torque, clearance = self.excess(series)
        return clearance == 0.0 and not torque.any()

    def tighten(self, series: Series) -> bool:
        """Tighten the limits of the penalties by a motion's excess on the fine grid; False if it respects them."""
        torque, clearance = self.excess(self.exact(series))
        self.torque_share = self.torque_share * (1.0 - np.minimum(0.5, TIGHTER * torque))
        self.extra_clearance += TIGHTER * clearance
        return clearance > 0.0 or bool(torque.any())

    def feasible(self, series: Series) -> Series:
        """Scale a motion exactly to its limits on the fine grid.

        First each joint is scaled separately (`exact`). Then, if torques or clearances require it, all joints are scaled
        together about the offset. Gravity does not decrease with the motion, so the largest admissible scale is found by
        search.
        """
        exact = self.exact(series)
        factor = 1.0
        while factor > SMALLEST_MOTION_SCALE:
            if self.keeps(scaled(exact, factor)):
                return scaled(exact, factor)
            factor *= 0.995 if factor > 0.8 else 0.95
        return scaled(exact, 0.0)

    def exact(self, series: Series) -> Series:
        """Scale each joint to its kinematic limits on the fine grid, up to a limit if one was reached on the coarse grid."""
        coarse, fine = (self._use(series, factor) for factor in (1, FINE))
        # A joint reduced because of torques or walls is not enlarged, only reduced further if it exceeds a limit between the
        # samples.
        # Share of a limit, on the optimiser's grid, from which the limit counts as reached: the norm that replaces the maximum
        # leaves 1 to 2 %.
        full = np.where(coarse > 0.975, 1.0, coarse)
        return scaled(series, full / np.maximum(fine, np.finfo(float).tiny) * (1.0 - BETWEEN))

    def _use(self, series: Series, factor: int) -> Array:
        limits = self.series.limits
        q, dq, ddq, jerk = series.motion(factor)
        away = q - series.offset
        # A scale changes the distances from the offset.
        up, down = limits.highest - series.offset, series.offset - limits.lowest
        position = np.maximum((away / up).max(axis=0), (-away / down).max(axis=0))
        others = [
            np.abs(values / limit).max(axis=0)
            for values, limit in ((dq, limits.velocity), (ddq, limits.acceleration), (jerk, limits.jerk))
        ]
        return np.asarray(np.max([position, *others], axis=0))


BETWEEN = 1.0 - float(np.cos(np.pi / (FINE * SAMPLES_PER_PERIOD)))
"""Largest share by which a Fourier series can exceed, between the samples of the fine grid, its largest value on them (Ehlich
and Zeller). With this margin the kinematic limits hold at all times."""
TIGHTER = 1.3
"""Factor between an excess and the tightening of the penalty's limit; above 1, because the next descent may exceed it a little
again."""


def scaled(series: Series, factor: float | Array) -> Series:
    """Return the same motion with larger or smaller amplitudes about the same offset."""
    return Series(basis=series.basis, scaled=series.scaled * factor, offset=series.offset)
