"""Delay between motion and torque: its estimate from the residuals of least squares, joint by joint, with standard deviations.

Drives log the torque (a current reference) and the position at moments that may differ by a few samples. A torque recorded d
samples late belongs to the motion d samples earlier. First the best whole shift of the torque is found. Around the best of them the
model torque ``m = W beta`` of each joint is linearised in its own delay,

    y_j(t + s_j) = W_j beta - (d_j - s_j) m_j'(t) + rho_j

which adds a column per joint to (7): the torques are moved by the solution, a fraction of a sample by a cubic, and the system
is solved again until the delays converge. Standard deviations are those of the delete-block jackknife, since model error is
correlated in time. Joints that agree share one delay, and a delay that is not significant is zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array
from .._tools.words import counted, series
from ..errors import FitError
from ..signal.filters import row_values
from ..signal.processing import SignalProcessing
from ..signal.window import Shift, Window, align, hold_samples
from ..terms.rows import LinearSystem, unit_columns
from .covariance import Factors, intervals
from .descent import descend

SIGNIFICANT = 3.0
"""Difference of a delay from zero, or of a joint's delay from the others, in standard deviations, from which it is
significant."""
SMALLEST_DIFFERENCE = 0.1
"""Difference of delays, in samples, below which joints share one delay."""
REACH_MARGIN = 3
"""Number of samples beyond the largest delay that interpolation and the last whole shift need."""
FARTHEST_S = 0.1
"""Reach (s) of a second search, where residuals still fall at the end of the first: torques of another clock, or over a network."""
MOST_STEPS = 10
"""Upper bound of the number of linearisations; two or three suffice."""
SETTLED_SAMPLES = 0.005
"""Step, in samples, below which the delays have converged."""
MOST_BYTES = 64_000_000
"""Upper bound of the memory of decimated torques that are kept for other cut-offs (bytes)."""
Moved = dict[bytes, Array]
"""Decimated torques of a log by the shift of each joint, rows joint by joint."""
NO_MOTION = 1e-9
"""Share of a joint's torque below which its derivative does not identify a delay."""


@dataclass(frozen=True, kw_only=True)
class DelayEstimate:
    """Delay of the torque relative to the motion, without the hold of a digital controller.

    Attributes
    ----------
    samples : float
        Delay that the joints share, in samples of the recordings; positive: the torque was recorded late. Zero when it is not
        significant.
    seconds : float
        The same in seconds.
    std_samples : float
        Standard deviation of the shared delay, in samples, by the delete-block jackknife.
    joints, joints_std : tuple of float
        Delay of each joint for the compensation (the shared one unless the joint differs), and the standard deviation of its
        own estimate, infinite if the joint does not identify it.
    gain : float
        Share by which these delays reduce the weighted residual, compared with the declared ones.
    cutoff_hz : float or None
        Cut-off of the filter of the positions for this estimate.
    """

    samples: float
    seconds: float
    std_samples: float
    joints: tuple[float, ...]
    joints_std: tuple[float, ...]
    gain: float
    cutoff_hz: float | None

    def __str__(self) -> str:
        """Return the estimate in words."""
        if self.differs:
            joints = series((f"{value:+.2f}" for value in self.joints), 60)
            return f"torque recorded {joints} samples after the motion, joint by joint, by estimate"
        if self.samples == 0.0:
            return f"no delay of the torque is significant: 0 +- {self.std_samples:.2g} samples, by estimate"
        return (
            f"torque recorded {self.samples:+.2f} +- {self.std_samples:.2g} samples ({1e3 * self.seconds:+.3f} ms) "
            "after the motion, by estimate"
        )

    @property
    def differs(self) -> bool:
        """Whether the delays of the joints differ."""
        return len(set(self.joints)) > 1


@dataclass(frozen=True, eq=False)
class Observed:
    """The system (7) of segments, the weight of each row, (r,), and its solution, (b,)."""

    system: LinearSystem
    weights: Array
    solution: Array


def estimate_delay(
    parts: Sequence[Window],
    signal: SignalProcessing,
    observe: Callable[[Sequence[Window]], Observed],
    torque: Callable[[Window, Array], Array],
    rows_by_shift: Moved | None = None,
    *,
    hold_s: float = 0.0,
    declared: Shift = 0.0,
    reach_s: float = 0.02,
) -> tuple[DelayEstimate, float]:
    """Find the torque shift of each joint with the best fit.

    Parameters
    ----------
    parts : sequence of Window
        Aligned without compensation, of one rate.
    signal : SignalProcessing
        Filter and decimation.
    observe : callable
        Function that returns the weighted system of segments.
    torque : callable
        Function that returns the model torques of a segment for a solution, (n_samples, n_dof).
    rows_by_shift : dict, optional
        Decimated torques by their shift, to be shared by searches in the same torques along differently filtered motion.
    hold_s : float
        Sample time of a digital controller, whose hold does not count as delay; zero for none.
    declared : float or sequence of float
        Delays in the settings, in samples, without the hold; reference for the gain.
    reach_s : float
        Largest delay of the search, in seconds, of either sign; `FARTHEST_S` where residuals still fall there.

    Returns
    -------
    DelayEstimate
        Delays with standard deviations.
    float
        ``sum_j n_j log |rho_j|``: the smaller, the better this filter explains the log.

    Raises
    ------
    FitError
        When recordings differ in rate, a segment is too short, or the best shift is beyond the reach.

    Notes
    -----
    ``test_delay.py`` recovers whole and fractional delays, common and of single joints, and zero without a delay.
    """
    rates = {part.rate_hz for part in parts}
    if len(rates) > 1:
        shown = series((f"{rate:g}" for rate in sorted(rates)), 60)
        raise FitError(f"a delay in samples needs recordings of one rate, got {shown} Hz")
    rate = rates.pop()
    reach = max(2, round(reach_s * rate))
    shortest = min(part.q.shape[0] for part in parts)
    if shortest <= 4 * (reach + REACH_MARGIN):
        raise FitError(
            f"a segment of {counted(shortest, 'sample')} is too short to look for delays of up to {reach} samples"
        )
    hold = hold_samples(hold_s, rate)
    search = _Search(
        parts, signal, reach + REACH_MARGIN, observe, {} if rows_by_shift is None else rows_by_shift
    )
    whole = search.best(reach + 1)
    farther = max(2, round(FARTHEST_S * rate))
    if abs(whole) > reach and reach < farther and shortest > 4 * (farther + REACH_MARGIN):
        return estimate_delay(
            parts, signal, observe, torque, hold_s=hold_s, declared=declared, reach_s=FARTHEST_S
        )
    if abs(whole) > reach:
        raise FitError(
            f"no delay within {reach} samples ({1e3 * reach / rate:.3g} ms) fits best, residuals still fall "
            "at the limit; give compensate_samples a number"
        )
    own, covariance = search.refine(float(whole), torque)
    common, joints = _shared(own + hold, covariance)
    std = np.sqrt(np.diag(covariance))
    before = search.residual_norm(np.broadcast_to(declared, own.shape) - hold)
    gain = 1.0 - search.residual_norm(np.array(joints) - hold) / before if before > 0.0 else 0.0
    estimate = DelayEstimate(
        samples=common[0],
        seconds=common[0] / rate,
        std_samples=common[1],
        joints=joints,
        joints_std=tuple(std.tolist()),
        gain=gain,
        cutoff_hz=signal.cutoff_hz,
    )
    return estimate, search.misfit


class _Search:
    """The systems of one log with its torques moved."""

    def __init__(
        self,
        parts: Sequence[Window],
        signal: SignalProcessing,
        margin: int,
        observe: Callable[[Sequence[Window]], Observed],
        rows_by_shift: Moved,
    ) -> None:
        self.parts, self.signal, self.margin, self.rows_by_shift = parts, signal, margin, rows_by_shift
        self.inner = [part.part(slice(margin, part.q.shape[0] - margin)) for part in parts]
        observed = observe(self.inner)
        self.system, self.weights, self.solution = observed.system, observed.weights, observed.solution
        self.known = 0.0 if self.system.known is None else self.system.known
        self.w = self.system.w * self.weights[:, None]
        # One factorisation for all shifts, and for the columns of the delays beside these.
        unit, self.size = unit_columns(self.w)
        self.basis, self.triangle = np.linalg.qr(unit)
        self.misfit = float("inf")

    def best(self, reach: int) -> int:
        """Return the whole shift with the smallest residual."""
        # A grid of at most 21 shifts, then finer ones around the lowest, down to single samples.
        centre, half = 0, reach

        @cache
        def norm(shift: int) -> float:
            return self.residual_norm(np.full(len(self.system.joints), float(shift)))

        while True:
            step = max(1, half // 10)
            grid = range(max(-reach, centre - half), min(reach, centre + half) + 1, step)
            centre = min(grid, key=norm)
            if step == 1:
                return centre
            half = 2 * step

    def residual_norm(self, shift: Array) -> float:
        """Return the norm of the weighted residual with the torque of each joint moved back by its shift, (n_dof,)."""
        y = self._torques(shift)
        return float(np.linalg.norm(y - self.basis @ (self.basis.T @ y)))

    def _torques(self, shift: Array) -> Array:
        """Return the weighted Y of the inner segments, with each joint's torque moved back by its shift, rows joint by joint."""
        # Larger delays are clipped, because there are no torques beyond the margin.
        shift = np.clip(shift, 2.0 - self.margin, self.margin - 2.0)
        key = shift.tobytes()
        if key not in self.rows_by_shift:
            rows = self._moved(shift)
            if (len(self.rows_by_shift) + 1) * rows.nbytes > MOST_BYTES:
                self.rows_by_shift.clear()
            self.rows_by_shift[key] = rows
        return np.asarray(self.weights * (self.rows_by_shift[key] - self.known))

    def _moved(self, shift: Array) -> Array:
        """Return the decimated torques of the inner segments, moved back, rows joint by joint."""
        windows = []
        for part in self.parts:
            n = part.q.shape[0]
            (index,), moved = align([np.arange(n, dtype=np.float64)], part.tau, tuple(shift.tolist()))
            first = self.margin - int(index[0])
            windows.append(row_values(moved[first : first + n - 2 * self.margin], self.signal).T)
        return np.concatenate(windows, axis=1).reshape(-1)

    def _derivative(self, solution: Array, torque: Callable[[Window, Array], Array]) -> Array:
        """Return the weighted columns ``-m_j'`` of the delays, per sample, shape (r, n_dof)."""
        changes = (np.gradient(torque(part, solution), axis=0) for part in self.inner)
        slopes = np.concatenate([row_values(change, self.signal).T for change in changes], axis=1)
        columns = np.zeros((self.system.y.size, len(slopes)))
        for joint, rows in enumerate(self.system.joints):
            columns[rows, joint] = -slopes[joint]
        return np.asarray(columns * self.weights[:, None])

    def refine(self, whole: float, torque: Callable[[Window, Array], Array]) -> tuple[Array, Array]:
        """Return the delay of each joint, (n_dof,), and their covariance, (n_dof, n_dof), infinite where a joint has none."""
        n, b = len(self.system.joints), self.w.shape[1]
        start = _Point(self, torque, whole, np.full(n, whole), self.solution, np.zeros(n, dtype=bool))
        point, _, _ = descend(start, MOST_STEPS)
        last = point.before or point
        if last.linear is None:
            return last.shift, np.full((n, n), np.inf)
        q, inverse, residual, _ = last.linear
        norms = self.system.norms(residual / self.weights)
        self.misfit = float(self.system.counts @ np.log(np.maximum(norms, 1e-300)))
        blocks = [interval.rows for interval in intervals(self.system.blocks)]
        spread = Factors(q, q, inverse, residual).jackknife(blocks).covariance[b:, b:]
        covariance = np.diag(np.full(n, np.inf))
        covariance[np.ix_(last.moving, last.moving)] = spread
        for joint in np.flatnonzero(point.lost):
            covariance[joint, joint] = np.inf
        return point.shift, covariance


@dataclass(frozen=True, eq=False)
class _Point:
    """Delays, and the parameters whose torques they are linearised about.

    A joint that is `lost` does not show its delay. The point before is the one that the last step was made at.
    """

    search: _Search
    torque: Callable[[Window, Array], Array]
    whole: float
    shift: Array
    solution: Array
    lost: NDArray[np.bool_]
    before: _Point | None = None

    @property
    def cost(self) -> float:
        """The same everywhere: interpolation lowers the noise between samples, so residuals of two shifts do not compare."""
        return 0.0

    @cached_property
    def _columns(self) -> Array:
        return self.search._derivative(self.solution, self.torque)

    @cached_property
    def moving(self) -> NDArray[np.intp]:
        """Joints whose torques show their delay."""
        search = self.search
        sizes = search.system.norms(search.weights * search.system.measured)
        still = np.linalg.norm(self._columns, axis=0) <= NO_MOTION * sizes
        return np.flatnonzero(~(self.lost | still))

    @cached_property
    def linear(self) -> tuple[Array, Array, Array, Array] | None:
        """Orthonormal columns, the inverse of their triangle, residual and solution; None where the log shows no delay."""
        search = self.search
        unit, size = unit_columns(self._columns[:, self.moving])
        q, r = extended(search.basis, search.triangle, unit)
        if len(q) <= q.shape[1] or np.min(np.abs(np.diag(r))) < 1e-10:
            return None
        y = search._torques(self.shift)
        inverse = np.linalg.inv(r) / np.concatenate([search.size, size])[:, None]
        seen = q.T @ y
        return q, inverse, y - q @ seen, inverse @ seen

    @property
    def _step(self) -> Array:
        """Step of the delays of the joints that move, at most a sample each."""
        if self.linear is None:
            return np.zeros(0)
        return np.clip(self.linear[3][self.search.w.shape[1] :], -1.0, 1.0)

    def moved(self, share: float) -> _Point:
        if self.linear is None:
            return self
        shift, lost, search = self.shift.copy(), np.ones(len(self.shift), dtype=bool), self.search
        shift[self.moving] += share * self._step
        lost[self.moving] = False
        # A joint beyond the search range has no minimum: it keeps its value, and gets the delay of the others.
        away = np.abs(shift - self.whole) > search.margin
        away |= np.abs(shift) > search.margin + max(abs(self.whole), search.margin) - REACH_MARGIN
        shift[away] = self.whole
        solution = self.linear[3][: search.w.shape[1]]
        return replace(self, shift=shift, solution=solution, lost=lost | away, before=self)

    def rests(self, share: float) -> bool:
        step = share * self._step
        if not step.size:
            return True
        # A joint that is lost now changes the problem.
        changed = self.moved(share).lost[self.moving].any()
        return bool(np.max(np.abs(step)) < SETTLED_SAMPLES and not changed)


def extended(q: Array, r: Array, columns: Array) -> tuple[Array, Array]:
    """Return ``Q R`` of a matrix, of which it is known, with further columns, (rows, k)."""
    seen = q.T @ columns
    free = columns - q @ seen
    again = q.T @ free  # twice, so that columns of rounding are orthogonal too
    more, corner = np.linalg.qr(free - q @ again)
    b, k = len(r), columns.shape[1]
    whole = np.zeros((b + k, b + k))
    whole[:b, :b], whole[:b, b:], whole[b:, b:] = r, seen + again, corner
    return np.hstack([q, more]), whole


def _shared(own: Array, covariance: Array) -> tuple[tuple[float, float], tuple[float, ...]]:
    """Return the shared delay with its standard deviation, and the delay to compensate of each joint."""
    std = np.sqrt(np.diag(covariance))
    known = np.isfinite(std)
    if not known.any():
        return (0.0, math.inf), (0.0,) * len(own)
    alike = known.copy()
    while True:
        common, error = _mean(own, covariance, alike)
        if alike.sum() == 1:
            break
        apart = np.zeros(len(own))
        for joint in np.flatnonzero(alike):
            others = alike.copy()
            others[joint] = False
            value, spread = _mean(own, covariance, others)
            distance = abs(own[joint] - value)
            if distance > SMALLEST_DIFFERENCE:
                apart[joint] = distance / math.hypot(std[joint], spread)
        worst = int(np.argmax(apart))
        if apart[worst] <= SIGNIFICANT:
            break
        alike[worst] = False
    common = common if abs(common) > SIGNIFICANT * error else 0.0
    joints = np.full(len(own), common)
    for joint in np.flatnonzero(known & ~alike):
        joints[joint] = own[joint] if abs(own[joint]) > SIGNIFICANT * std[joint] else 0.0
    return (float(common), float(error)), tuple(joints.tolist())


def _mean(own: Array, covariance: Array, chosen: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the mean of some delays, weighted by inverse variances, and its standard deviation."""
    some = np.flatnonzero(chosen)
    variances = np.maximum(np.diag(covariance)[some], 1e-300)
    weights = 1.0 / variances / np.sum(1.0 / variances)
    variance = float(weights @ covariance[np.ix_(some, some)] @ weights)
    return float(weights @ own[some]), math.sqrt(max(variance, 0.0))
