"""Delay between motion and torque: its estimate from the residuals of least squares, and its compensation.

Drives log the torque (a current reference) and the position at moments that may differ by a few samples. A
torque recorded d samples late belongs to the motion d samples earlier: tau(t - d) of the model is compared
with tau(t). The squared residual norm of the fit, as a function of the shift, is smooth around its minimum,
so that a parabola through the three lowest whole shifts gives the fraction of a sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from . import signals
from .errors import FitError
from .schema import counted

if TYPE_CHECKING:
    from .least_squares import LinearSystem
    from .observations import Segment
    from .signals import SignalProcessing

Array = NDArray[np.float64]

# Neighbours of a sample that cubic interpolation takes: one before, two after.
CUBIC = (-1, 0, 1, 2)


@dataclass(frozen=True, kw_only=True)
class DelaySettings:
    """What to do about a delay of the torque.

    Parameters
    ----------
    compensate_samples : float or "estimate"
        Move the torque back by so many samples of its recording (a fraction is interpolated; positive: the
        torque was recorded late), or by what the estimate finds.

    Raises
    ------
    FitError
        For a value that is neither.
    """

    compensate_samples: float | Literal["estimate"] = 0.0

    def __post_init__(self) -> None:
        value = self.compensate_samples
        if value == "estimate":
            return
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise FitError(f"compensate_samples must be a number or 'estimate', got {value!r}")


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


def align(motion: Sequence[Array], tau: Array, delay_samples: float) -> tuple[tuple[Array, ...], Array]:
    """Move the torque back by its delay, and leave out the samples for which none is left.

    Parameters
    ----------
    motion : sequence of ndarray, shape (n_samples, n_dof)
        Position, velocity, acceleration.
    tau : ndarray, shape (n_samples, n_dof)
        Torque as recorded.
    delay_samples : float
        Positive when the torque was recorded late. Fractions are interpolated by a cubic through four
        samples.

    Returns
    -------
    motion : tuple of ndarray
        Shortened.
    tau : ndarray
        ``tau[k]`` belongs to ``motion[k]``.

    Raises
    ------
    FitError
        When the record is not longer than the delay.

    Notes
    -----
    ``test_delay.py`` moves a cubic exactly.
    """
    if delay_samples == 0.0:
        return tuple(motion), tau
    whole = math.floor(delay_samples)
    fraction = delay_samples - whole
    offsets = CUBIC if fraction else (0,)
    weights = _lagrange(fraction) if fraction else (1.0,)
    n_samples = tau.shape[0]
    # Motion samples k for which every tau[k + whole + offset] exists.
    first = max(0, -(whole + offsets[0]))
    last = min(n_samples, n_samples - (whole + offsets[-1]))
    if last <= first:
        raise FitError(
            f"a record of {counted(n_samples, 'sample')} is too short to compensate a delay of "
            f"{delay_samples:g} samples"
        )
    moved = np.zeros((last - first, *tau.shape[1:]))
    for offset, weight in zip(offsets, weights, strict=True):
        moved += weight * tau[first + whole + offset : last + whole + offset]
    return tuple(values[first:last] for values in motion), moved


def _lagrange(fraction: float) -> tuple[float, ...]:
    """Weights of the samples at -1, 0, 1, 2 for the value at ``fraction``."""
    return tuple(
        math.prod((fraction - other) / (node - other) for other in CUBIC if other != node) for node in CUBIC
    )


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
        found.append(signals.decimate(tau, signals.decimation_stages(n_inner, signal))[signal.kept_rows].T)
    return np.concatenate(found, axis=1).reshape(-1)
