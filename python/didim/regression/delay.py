"""Delay between motion and torque: its estimate from the residuals of least squares, and its compensation.

Drives log the torque (a current reference) and the position at moments that may differ by a few samples. A
torque recorded d samples late belongs to the motion d samples earlier: tau(t - d) of the model is compared
with tau(t). The squared residual norm of the fit, as a function of the shift, is smooth around its minimum,
so that a parabola through the three lowest whole shifts gives the fraction of a sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import FitError
from ..signal.decimation import decimate, decimation_stages
from ..signal.processing import SignalProcessing
from ..signal.segments import Segment
from .linear_system import LinearSystem


@dataclass(frozen=True, kw_only=True)
class DelayEstimate:
    """Delay of the torque after the motion.

    Attributes
    ----------
    samples : float
        In samples of the recordings; positive: the torque was recorded late.
    seconds : float
        The same in seconds.
    shifts : tuple of int
        Shifts tried, in samples.
    residual_norms : tuple of float
        Norm of the weighted residual at each of them.
    """

    samples: float
    seconds: float
    shifts: tuple[int, ...]
    residual_norms: tuple[float, ...]


def estimate_delay(
    parts: Sequence[Segment],
    signal: SignalProcessing,
    observe: Callable[[Sequence[Segment]], tuple[LinearSystem, Array]],
    *,
    reach_s: float = 0.02,
) -> DelayEstimate:
    """Find the shift of the torque at which the fit is best.

    Parameters
    ----------
    parts : sequence of Segment
        Aligned without compensation, of one rate.
    signal : SignalProcessing
        Decimation, the same as in the fit.
    observe : callable
        Gives the system (7) of segments and the weight of each of its rows, shape (r,).
    reach_s : float
        Largest delay looked for, in seconds, before or after.

    Returns
    -------
    DelayEstimate
        The minimum of a parabola through the squared norms at whole shifts.

    Raises
    ------
    FitError
        When recordings differ in rate, a segment is too short, or the best shift is at the end of the reach.

    Notes
    -----
    ``test_delay.py`` recovers whole and fractional delays.
    """
    rates = {part.rate_hz for part in parts}
    if len(rates) > 1:
        shown = ", ".join(f"{rate:g}" for rate in sorted(rates))
        raise FitError(f"a delay in samples needs recordings of one rate, got {shown} Hz")
    rate = rates.pop()
    reach = max(2, round(reach_s * rate))
    shortest = min(part.q.shape[0] for part in parts)
    if shortest <= 4 * reach:
        raise FitError(
            f"a segment of {counted(shortest, 'sample')} is too short to look for delays of up to {reach} "
            "samples"
        )
    inner = [_inner(part, reach) for part in parts]
    system, row_weights = observe(inner)
    # Projection on the columns: one factorisation serves every shift.
    basis = np.linalg.qr(system.w * row_weights[:, None])[0]
    known = np.zeros_like(system.y) if system.known is None else system.known

    norms: dict[int, float] = {}

    def norm(shift: int) -> float:
        if shift not in norms:
            y = row_weights * (_shifted(parts, signal, reach, shift) - known)
            norms[shift] = float(np.linalg.norm(y - basis @ (basis.T @ y)))
        return norms[shift]

    # A grid of at most 21 shifts, then finer ones around the lowest, down to single samples.
    centre, half = 0, reach
    while True:
        step = max(1, half // 10)
        grid = range(max(-reach, centre - half), min(reach, centre + half) + 1, step)
        centre = min(grid, key=norm)
        if step == 1:
            break
        half = 2 * step
    if abs(centre) == reach:
        raise FitError(
            f"no delay within {reach} samples ({1e3 * reach / rate:.3g} ms) fits best, residuals still fall "
            "at the limit; give compensate_samples a number"
        )
    left, middle, right = (norm(centre + side) ** 2 for side in (-1, 0, 1))
    curvature = left - 2.0 * middle + right
    samples = centre + (0.5 * (left - right) / curvature if curvature > 0.0 else 0.0)
    shifts = tuple(sorted(norms))
    return DelayEstimate(
        samples=samples,
        seconds=samples / rate,
        shifts=shifts,
        residual_norms=tuple(norms[shift] for shift in shifts),
    )


def _inner(part: Segment, reach: int) -> Segment:
    """Segment without the first and last ``reach`` samples, so that every shift of the torque has a value."""
    kept = slice(reach, part.q.shape[0] - reach)
    return replace(
        part,
        q=np.ascontiguousarray(part.q[kept]),
        dq=np.ascontiguousarray(part.dq[kept]),
        ddq=np.ascontiguousarray(part.ddq[kept]),
        tau=np.ascontiguousarray(part.tau[kept]),
    )


def _shifted(parts: Sequence[Segment], signal: SignalProcessing, reach: int, shift: int) -> Array:
    """Y of the inner segments with the torque moved back by ``shift``, rows joint by joint."""
    found = []
    for part in parts:
        n_inner = part.q.shape[0] - 2 * reach
        tau = np.ascontiguousarray(part.tau[reach + shift : reach + shift + n_inner])
        found.append(decimate(tau, decimation_stages(n_inner, signal))[signal.kept_rows].T)
    return np.concatenate(found, axis=1).reshape(-1)
