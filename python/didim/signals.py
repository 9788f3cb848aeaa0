"""Zero-phase filters, central differences and decimation: from a logged position to the rows of (6).

Filters are designed by SciPy in second-order sections and applied by the core. A transfer function of order 8
with its cut-off at 0.008 of the Nyquist frequency, which a decimation by 100 would need, is numerically
unsound; its sections are not. Two conventions exist for the edges: MATLAB's ``filtfilt`` and ``decimate``,
and SciPy's ``sosfiltfilt`` and ``decimate``. They differ in the padding and in which samples are kept, and
published figures need the one they were made with.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from numbers import Integral, Real
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from didim import _core
from didim.arrays import real_array
from didim.errors import SignalError

Array = NDArray[np.float64]
Convention = Literal["scipy", "matlab"]
Form = Literal["sections", "transfer-function"]
Stage = tuple[Array, Array, int, int, int]
"""A filter of the core: sections (s, 6), their steady states (s, 2), padding, factor, first kept sample."""

# The Chebyshev I filter of both ``decimate``: order, ripple, cut-off over the new Nyquist frequency.
DECIMATION_ORDER = 8  # as in _squared_gain
DECIMATION_RIPPLE_DB = 0.05
DECIMATION_BAND = 0.8

_CIRCLE = 2048
"""Points of a spectrum at the last rate; half as many lags of a correlation."""

LARGEST_ORDER = 10
"""Of the Butterworth filter: above it nothing is gained but ringing and rounding."""

LARGEST_DECIMATION = 10_000
"""Of all factors together: the spectrum of decimated noise has 2048 times as many points."""

LARGEST_POLE_ERROR = 1e-5
"""How far rounding may move a pole, as a share of its distance from the unit circle."""


@dataclass(frozen=True, kw_only=True)
class SignalProcessing:
    """How a recording becomes the rows of the linear system.

    Attributes
    ----------
    cutoff_hz : float or None
        Cut-off of the zero-phase Butterworth filter of the positions; None does not filter.
    order : int
        Its order, of one of the two passes: 1 to 10.
    padding : {"scipy", "matlab"}
        Samples of odd extension at each end: SciPy's 3 (order + 1), or MATLAB's 3 order.
    form : {"sections", "transfer-function"}
        How the Butterworth filter is run. Second-order sections are the sound way. The transfer function is
        that of MATLAB's ``filtfilt(b, a, x)``: where a joint stands still, its rounding noise decides the
        sign of the velocity (docs/tx40.md), so that figures made with it need it.
    trim_start, trim_end : int
        Samples left out at the ends once positions are differentiated: there the filter has only the
        extension to go by.
    decimation : tuple of int
        Factors of the parallel filter (6), one stage after the other; empty keeps every sample.
    decimation_convention : {"scipy", "matlab"}
        Padding of the decimation filter, and the samples it keeps: SciPy keeps the first of the record,
        MATLAB the last.
    edge_rows : int
        Kept samples left out at each end of a decimated window. Padding turns a signal about its first and last
        samples, which pins the filter to their unfiltered noise: the first kept sample of white torque noise, decimated by 50,
        has 40 times the variance of the others (``test_signals.py``), which spoils estimates and sigmas.

    Raises
    ------
    SignalError
        When a value makes no sense.
    """

    cutoff_hz: float | None = None
    order: int = 4
    padding: Convention = "scipy"
    form: Form = "sections"
    trim_start: int = 0
    trim_end: int = 0
    decimation: tuple[int, ...] = ()
    decimation_convention: Convention = "scipy"
    edge_rows: int = 2

    @property
    def kept_rows(self) -> slice:
        """Rows of a decimated window that are used."""
        edge = self.edge_rows if self.decimation else 0
        return slice(edge, -edge if edge else None)

    def __post_init__(self) -> None:
        cutoff = self.cutoff_hz
        if cutoff is not None:
            if isinstance(cutoff, bool) or not isinstance(cutoff, Real) or not 0.0 < cutoff < np.inf:
                raise SignalError(f"cutoff_hz must be a positive frequency, got {cutoff!r}")
            object.__setattr__(self, "cutoff_hz", float(cutoff))
        for key in ("order", "trim_start", "trim_end", "edge_rows"):
            object.__setattr__(self, key, _whole(key, getattr(self, key)))
        _check_order(self.order)
        for key in ("trim_start", "trim_end", "edge_rows"):
            if getattr(self, key) < 0:
                raise SignalError(f"{key} must not be negative, got {getattr(self, key)}")
        if isinstance(self.decimation, str) or not isinstance(self.decimation, Sequence):
            raise SignalError(f"decimation must be a tuple of whole numbers, got {self.decimation!r}")
        factors = tuple(_whole("each decimation factor", factor) for factor in self.decimation)
        object.__setattr__(self, "decimation", factors)
        for factor in factors:
            if factor < 2:
                raise SignalError(f"each decimation factor must be at least 2, got {factor}")
        for key in ("padding", "decimation_convention"):
            if getattr(self, key) not in get_args(Convention):
                raise SignalError(f"{key} must be 'scipy' or 'matlab', got {getattr(self, key)!r}")
        if self.form not in get_args(Form):
            raise SignalError(f"form must be 'sections' or 'transfer-function', got {self.form!r}")


def zero_phase_butterworth(
    x: Array,
    rate_hz: float,
    cutoff_hz: float,
    order: int = 4,
    padding: Convention = "scipy",
    form: Form = "sections",
) -> Array:
    """Low-pass filter forward and backward, without delay.

    Parameters
    ----------
    x : ndarray, shape (n_samples, m)
        Signals, one per column, in any unit.
    rate_hz : float
        Sampling rate.
    cutoff_hz : float
        Cut-off (-3 dB) of one pass; both passes together have -6 dB there.
    order : int
        Order of one pass.
    padding : {"scipy", "matlab"}
        Length of the odd extension, see `SignalProcessing`.
    form : {"sections", "transfer-function"}
        How the filter is run, see `SignalProcessing`.

    Returns
    -------
    ndarray, shape (n_samples, m)
        Filtered signals.

    Raises
    ------
    SignalError
        When the cut-off is not below half the sampling rate or so close to it or to zero that rounding
        spoils the filter, the order is not 1 to 10, the record is no longer than the extension, or a sample
        is not a finite number.

    Notes
    -----
    ``test_signals.py`` compares it with ``scipy.signal.sosfiltfilt``, and with ``filtfilt`` of the transfer
    function.
    """
    from scipy.signal import butter, filtfilt, sosfilt_zi, zpk2sos, zpk2tf

    _check_order(order)
    if not 0.0 < cutoff_hz < rate_hz / 2.0:
        raise SignalError(
            f"the cut-off of {cutoff_hz:g} Hz must be below half the sampling rate, "
            f"{rate_hz / 2.0:g} Hz at {rate_hz:g} Hz"
        )
    x = _columns(x)
    padlen = _padding(order, padding)
    if x.shape[0] <= padlen:
        raise SignalError(
            f"the zero-phase filter of order {order} needs more than {padlen} samples, "
            f"the record has {x.shape[0]}"
        )
    share = cutoff_hz / (rate_hz / 2.0)
    transfer = form == "transfer-function"
    sound = 0.0 < share < 1.0  # the division may have rounded to either
    if sound:
        # Any, because scipy-stubs know real poles only.
        design: Any = butter(order, share, output="zpk")
        if transfer:
            b, a = zpk2tf(*design)
        else:
            sos = np.ascontiguousarray(zpk2sos(*design))
        sound = _poles_survive(design[1], [a] if transfer else sos[:, 3:])
    if not sound:
        raise SignalError(
            f"rounding spoils a filter of order {order} at {cutoff_hz:g} Hz, sampled at {rate_hz:g} Hz: move "
            "the cut-off away from zero and from half the sampling rate"
            + (", lower the order or use form 'sections'" if transfer else "")
        )
    if transfer:
        with np.errstate(over="ignore", invalid="ignore"):  # told by whoever takes it
            return np.asarray(filtfilt(b, a, x, axis=0, padlen=padlen))
    return _told(lambda: _core.filtfilt(x, sos, np.ascontiguousarray(sosfilt_zi(sos)), padlen))


def central_differences(x: Array, dt: float) -> Array:
    """Differentiate with central differences, one-sided at both ends.

    Parameters
    ----------
    x : ndarray, shape (n_samples, m)
        Signals, one per column.
    dt : float
        Sampling time in s.

    Returns
    -------
    ndarray, shape (n_samples, m)
        Derivatives, in the unit of `x` per s: ``(x[k+1] - x[k-1]) / (2 dt)``.

    Raises
    ------
    SignalError
        With fewer than two samples, a sample that is not a finite number, or derivatives beyond what a
        floating-point number holds.

    Notes
    -----
    ``test_signals.py`` checks that it is exact for parabolas between the ends.
    """
    x = _columns(x)
    if x.shape[0] < 2:
        raise SignalError(f"central differences need at least 2 samples, got {x.shape[0]}")
    dx = np.empty_like(x)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # told below
        dx[1:-1] = (x[2:] - x[:-2]) / (2.0 * dt)
        dx[0] = (x[1] - x[0]) / dt
        dx[-1] = (x[-1] - x[-2]) / dt
    if not np.isfinite(dx).all():
        raise SignalError(f"derivatives at a sampling time of {dt:g} s are too large for floating point")
    return dx


def differentiate(q: Array, rate_hz: float, signal: SignalProcessing) -> tuple[Array, Array, Array]:
    """Derive velocities and accelerations from logged positions.

    The positions are filtered once, then differentiated twice. Nothing is trimmed yet: the torque is aligned
    with them first.

    Parameters
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Logged positions, joint side, rad or m.
    rate_hz : float
        Sampling rate.
    signal : SignalProcessing
        Filter; without a cut-off the positions stay as they are.

    Returns
    -------
    q, dq, ddq : ndarray, shape (n_samples, n_dof)
        Joint side, SI units.

    Raises
    ------
    SignalError
        As `zero_phase_butterworth` and `central_differences`.

    Notes
    -----
    ``test_signals.py`` checks it on a sine whose derivatives are known.
    """
    q = _columns(q)
    if signal.cutoff_hz is not None:
        q = zero_phase_butterworth(q, rate_hz, signal.cutoff_hz, signal.order, signal.padding, signal.form)
    dq = central_differences(q, 1.0 / rate_hz)
    return q, dq, central_differences(dq, 1.0 / rate_hz)


def white_noise(values: Array) -> Array:
    """Estimate the white noise of a log from its fifth differences: motion hardly shows in them.

    Parameters
    ----------
    values : ndarray, shape (n_samples, n_dof)
        Positions or torques; more than five samples.

    Returns
    -------
    ndarray, shape (n_dof,)
        Standard deviations, in the unit of the values; never zero.

    Notes
    -----
    ``test_cloe.py`` checks it on the noise of a simulated log.
    """
    # The median does not see reversals, where friction jumps; 252 is the sum of the squared binomials.
    spread = np.median(np.abs(np.diff(values, 5, axis=0)), axis=0) / 0.6745 / math.sqrt(252.0)
    return np.asarray(np.maximum(spread, 1e-9 * np.maximum(np.ptp(values, axis=0), 1e-3)))


def decimation_stages(n_samples: int, signal: SignalProcessing) -> list[Stage]:
    """Design the filters of the parallel decimation (6) for a record of a given length.

    Parameters
    ----------
    n_samples : int
        Samples of the record; MATLAB's convention depends on it.
    signal : SignalProcessing
        Factors and convention.

    Returns
    -------
    list of Stage
        One per factor, as the core takes them; empty without decimation.

    Raises
    ------
    SignalError
        When a stage gets too few samples for its padding or its factor, or its factor is so large that
        rounding spoils the filter.

    Notes
    -----
    Chebyshev I of order 8, 0.05 dB, cut-off at 0.8 of the new Nyquist frequency, in both passes.
    ``test_signals.py`` compares with ``scipy.signal.decimate`` and, for MATLAB's convention, with its
    definition.
    """
    return list(_stages(n_samples, signal.decimation, signal.decimation_convention))


@lru_cache(maxsize=64)
def _stages(n_samples: int, factors: tuple[int, ...], convention: Convention) -> tuple[Stage, ...]:
    """Stages of `decimation_stages`; designing them takes longer than a small log takes to filter, and `check` filters often."""
    matlab = convention == "matlab"
    padlen = _padding(DECIMATION_ORDER, convention)
    stages: list[Stage] = []
    for factor in factors:
        stage = f"stage {len(stages) + 1} of {len(factors)} gets {n_samples}"
        needed = max(padlen, factor - 1)
        if n_samples <= needed:
            raise SignalError(f"decimation by {factor} needs more than {needed} samples, {stage}")
        sos, zi = _decimation_filter(factor)
        kept = -(-n_samples // factor)
        # MATLAB's grid ends on the last sample.
        first = n_samples - factor * (kept - 1) - 1 if matlab else 0
        stages.append((sos, zi, padlen, factor, first))
        n_samples = kept
    return tuple(stages)


@lru_cache(maxsize=64)
def _decimation_filter(factor: int) -> tuple[Array, Array]:
    """Sections of the filter before a decimation, (4, 6), and their steady states, (4, 2)."""
    from scipy.signal import cheby1, sosfilt_zi, zpk2sos

    share = DECIMATION_BAND / factor
    design: Any = cheby1(DECIMATION_ORDER, DECIMATION_RIPPLE_DB, share, output="zpk")  # likewise
    sos = np.ascontiguousarray(zpk2sos(*design))
    if not _poles_survive(design[1], sos[:, 3:]):
        raise SignalError(f"rounding spoils the filter of a decimation by {factor}: take several stages")
    return sos, np.ascontiguousarray(sosfilt_zi(sos))


def decimate(x: Array, stages: Sequence[Stage]) -> Array:
    """Filter and decimate signals as the columns of W are.

    Parameters
    ----------
    x : ndarray, shape (n_samples, m)
        Signals, one per column.
    stages : sequence of Stage
        From `decimation_stages` with the same number of samples.

    Returns
    -------
    ndarray, shape (n_kept, m)
        Kept samples; a copy of `x` without stages.

    Raises
    ------
    SignalError
        When a sample is not a finite number.

    Notes
    -----
    ``test_signals.py`` compares with ``scipy.signal.decimate(zero_phase=True)``.
    """
    x = _columns(x)
    return _told(lambda: _core.decimate(x, list(stages))) if stages else x.copy()


def noise_correlation(signal: SignalProcessing) -> Array | None:
    """Autocorrelation of white noise after the decimation, at the lags of the kept samples.

    Parameters
    ----------
    signal : SignalProcessing
        Decimation.

    Returns
    -------
    ndarray, shape (n_lags,), or None
        From lag 0, where it is 1; None without decimation, which leaves white noise white.

    Raises
    ------
    SignalError
        When all factors together are beyond 10 000.

    Notes
    -----
    The filters act forward and backward, so that the power of the noise is shaped by the fourth power of their
    gain, and each decimation folds what lies beyond the new band. ``test_signals.py`` compares with filtered noise.
    """
    if not signal.decimation:
        return None
    total = math.prod(signal.decimation)
    if total > LARGEST_DECIMATION:
        raise SignalError(f"a decimation by {total} in all is too large, {LARGEST_DECIMATION} is possible")
    power = np.ones(1)
    for factor in reversed(signal.decimation):
        # Spectra at the rate before this stage, on the circle; the later stages see it folded, and act alike on each fold.
        power = np.tile(power, factor) if power.size > 1 else np.ones(_CIRCLE * factor)
        gain = _squared_gain(factor, power.size)
        power *= gain * gain
    folded = power.reshape(total, -1).sum(axis=0)
    correlation = np.fft.ifft(folded).real[: folded.size // 2]
    return np.asarray(correlation / correlation[0])


def _squared_gain(factor: int, size: int) -> Array:
    """Squared gain of the filter before a decimation at ``size`` points of the circle, from DC on."""
    # Chebyshev I: 1 / (1 + e^2 T_8(x)^2), where x is the frequency over the cut-off as the bilinear transform warps both.
    x = np.arange(size // 2 + 1) * (np.pi / size)
    np.tan(x, out=x)  # in place: the circle is long, and memory is touched once
    x /= math.tan(0.5 * np.pi * DECIMATION_BAND / factor)
    with np.errstate(over="ignore"):  # towards half the rate, where the gain vanishes
        for _ in range(3):  # T_8(x) = T_2(T_2(T_2(x))), T_2(x) = 2 x^2 - 1
            x *= x
            x *= 2.0
            x -= 1.0
        x *= x
    x *= 10.0 ** (0.1 * DECIMATION_RIPPLE_DB) - 1.0
    gain = 1.0 / (1.0 + x)
    # The other half of the circle mirrors this one.
    return np.concatenate([gain, gain[-2 if size % 2 == 0 else -1 : 0 : -1]])


def _padding(order: int, convention: Convention) -> int:
    """Count the samples of odd extension at each end that SciPy or MATLAB would choose by themselves."""
    return 3 * order if convention == "matlab" else 3 * (order + 1)


def _whole(key: str, value: object) -> int:
    """Return a whole number, NumPy's too, as the int that JSON knows; 4.0 and True are none."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise SignalError(f"{key} must be a whole number, got {value!r}")
    return int(value)


def _check_order(order: int) -> None:
    if not 1 <= order <= LARGEST_ORDER:
        raise SignalError(f"order must be 1 to {LARGEST_ORDER}, got {order}")


def _poles_survive(poles: Array | NDArray[np.complex128], denominators: Iterable[Array]) -> bool:
    """Whether the roots of the coefficients are still the poles that these were made of."""
    margin = 1.0 - np.abs(poles)
    if not (margin > 0.0).all():
        return False
    roots = np.concatenate([np.roots(denominator) for denominator in denominators])
    moved = np.array([np.abs(roots - pole).min() for pole in poles]) + np.finfo(np.float64).eps
    return bool((moved <= LARGEST_POLE_ERROR * margin).all())


def _told(run: Callable[[], Array]) -> Array:
    """Run a function of the core, whose error is a sentence already."""
    try:
        return run()
    except ValueError as reason:
        raise SignalError(str(reason)) from None


def _columns(x: Array) -> Array:
    """Make contiguous (n_samples, m) floats, or raise the error that says what came instead."""
    x = np.ascontiguousarray(real_array("signals", x, SignalError))
    if x.ndim != 2:
        raise SignalError(f"signals must have shape (n_samples, m), got {x.shape}")
    if not np.isfinite(x).all():
        sample, signal = np.argwhere(~np.isfinite(x))[0]
        raise SignalError(f"sample {sample} of signal {signal} is not a finite number")
    return x
