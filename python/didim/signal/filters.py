"""Zero-phase filters, central differences and decimation: from a logged position to the rows of (6).

Low-pass filters are designed here, as SciPy designs them (its module of filters takes a second to load), in second-order sections,
and the core applies them. A transfer function of order 8 with its cut-off at 0.008 of the Nyquist frequency, which a decimation by
100 would need, is numerically unsound; its sections are not. Two
conventions exist for the edges: MATLAB's ``filtfilt`` and ``decimate``, and SciPy's ``sosfiltfilt`` and ``decimate``. They
differ in the padding and in the samples that are retained. To reproduce a published figure, use its convention.

The parallel decimation of (6) has stages of Chebyshev filters, applied to the torques and to each column of W.

Tested in ``tests/test_signals.py``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import didim._core as _core

from .._tools.arrays import Array, real_array
from .._tools.threads import core_threads
from ..errors import CoreErrorsAs, SignalError
from .processing import Convention, Ends, Form, SignalProcessing, check_order

EXTENSION_PERIODS = 8.0
"""Length of an extension with continuous curvature, in periods of the cut-off: the response has then decayed to 1e-8."""
CURVATURE_DEGREE = 3
"""Degree of the polynomial fitted for the curvature."""
LOST = 5e-4
"""Share of a derivative that central differences may lose: twice of it in the acceleration, less than inertias are known to."""
SLOW = 4.0
"""Divisor of the cut-off, up to which derivatives are made good: motion is there, and noise beyond it."""
CURVATURE_PERIODS = 2.0
"""Length of the samples that the curvature at an end is estimated from, in periods of the cut-off: with fewer it is noisier
than the filtered accelerations, with many more a cubic does not follow the motion."""
LARGEST_POLE_ERROR = 1e-5
"""Largest shift of a pole by rounding, as a share of its distance from the unit circle."""


def zero_phase_butterworth(
    x: Array,
    rate_hz: float,
    cutoff_hz: float,
    order: int = 4,
    padding: Convention = "scipy",
    form: Form = "sections",
    curved: bool = False,
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
        Implementation of the filter, see `SignalProcessing`.
    curved : bool
        Extend the signals by `EXTENSION_PERIODS` with continuous curvature. An odd extension reverses the curvature at the
        ends, which makes the second derivative of the filtered signal zero there.

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
    function, and the ends of a curved extension with derivatives that are known.
    """
    check_order(order)
    if not 0.0 < cutoff_hz < rate_hz / 2.0:
        raise SignalError(
            f"the cut-off of {cutoff_hz:g} Hz must be below half the sampling rate, "
            f"{rate_hz / 2.0:g} Hz at {rate_hz:g} Hz"
        )
    x = checked_columns(x)
    padlen = padding_length(order, padding)
    if x.shape[0] <= padlen:
        raise SignalError(
            f"the zero-phase filter of order {order} needs more than {padlen} samples, "
            f"the record has {x.shape[0]}"
        )
    share = cutoff_hz / (rate_hz / 2.0)
    transfer = form == "transfer-function"
    sound = 0.0 < share < 1.0  # the division may have rounded to either
    if sound:
        design = butterworth(order, share)
        sos = design.transfer_function() if transfer else design.sections()
        sound = poles_survive(design.poles, sos[:, sos.shape[1] // 2 :])
    if not sound:
        raise SignalError(
            f"rounding spoils a filter of order {order} at {cutoff_hz:g} Hz, sampled at {rate_hz:g} Hz: move "
            "the cut-off away from zero and from half the sampling rate"
            + (", lower the order or use form 'sections'" if transfer else "")
        )
    added = 0
    if curved and x.shape[0] > CURVATURE_DEGREE + 2:
        x, added = _extended(x, rate_hz / cutoff_hz, padlen)
    inside = slice(added, x.shape[0] - added)
    with CoreErrorsAs(SignalError):
        filtered = _core.filtfilt(x, sos, steady_states(sos), padlen, core_threads())
    return np.ascontiguousarray(filtered[inside])


def _extended(x: Array, period: float, least: int) -> tuple[Array, int]:
    """Extend signals at both ends with continuous curvature, and return the number of samples added at each.

    ``x[-k] = 2 x[0] - x[k] + c k^2`` with ``c`` the second derivative at the end, from a cubic fitted to the samples there: the
    value and three derivatives are continuous.
    """
    n = len(x)
    added = int(min(max(np.ceil(EXTENSION_PERIODS * period), least), n - 1))
    count = int(min(max(np.ceil(CURVATURE_PERIODS * period) + 1, CURVATURE_DEGREE + 3), n))
    powers = np.vander(np.linspace(0.0, 1.0, count), CURVATURE_DEGREE + 1, increasing=True)
    second = 2.0 * np.linalg.pinv(powers)[2] / (count - 1.0) ** 2
    squares = np.arange(1, added + 1)[:, None] ** 2.0

    def beyond(ordered: Array) -> Array:
        """Return samples before the first one, the nearest first; exactly constant where the signal is."""
        curvature = np.tensordot(second, ordered[:count] - ordered[0], axes=1)
        return np.asarray(2.0 * ordered[0] - ordered[1 : added + 1] + curvature * squares)

    with np.errstate(over="ignore", invalid="ignore"):  # reported by the core
        return np.concatenate([beyond(x)[::-1], x, beyond(x[::-1])]), added


def central_differences(x: Array, dt: float, ends: Ends = "second-order") -> Array:
    """Differentiate with central differences, one-sided ones at both ends.

    Parameters
    ----------
    x : ndarray, shape (n_samples, m)
        Signals, one per column.
    dt : float
        Sampling time in s.
    ends : {"second-order", "first-order"}
        Differences at the ends, see `SignalProcessing`.

    Returns
    -------
    ndarray, shape (n_samples, m)
        Derivatives, in the unit of `x` per s: ``(x[k+1] - x[k-1]) / (2 dt)``, and ``(-3 x[0] + 4 x[1] - x[2]) / (2 dt)`` at the
        first sample, likewise at the last.

    Raises
    ------
    SignalError
        With fewer than three samples, a sample that is not a finite number, or derivatives beyond what a
        floating-point number holds.

    Notes
    -----
    ``test_signals.py`` checks that it is exact for parabolas, including the ends. First-order differences, applied twice, give
    half of the acceleration at the first sample and three quarters at the second.
    """
    x = checked_columns(x)
    least = 2 if ends == "first-order" else 3
    if x.shape[0] < least:
        raise SignalError(f"central differences need at least {least} samples, got {x.shape[0]}")
    dx = np.empty_like(x)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # reported below
        dx[1:-1] = (x[2:] - x[:-2]) / (2.0 * dt)
        if ends == "first-order":
            dx[0], dx[-1] = (x[1] - x[0]) / dt, (x[-1] - x[-2]) / dt
        else:
            dx[0] = (-3.0 * x[0] + 4.0 * x[1] - x[2]) / (2.0 * dt)
            dx[-1] = (3.0 * x[-1] - 4.0 * x[-2] + x[-3]) / (2.0 * dt)
    if not np.isfinite(dx).all():
        raise SignalError(f"derivatives at a sampling time of {dt:g} s are too large for floating point")
    return dx


def differentiate(
    q: Array, rate_hz: float, signal: SignalProcessing, dq: Array | None = None
) -> tuple[Array, Array, Array]:
    """Derive velocities and accelerations from logged positions.

    The positions are filtered once, then differentiated twice, by central differences and what these lose of a motion that is
    fast for its rate. Trimming comes later, after the alignment of the torque.

    Parameters
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Logged positions, joint side, rad or m.
    rate_hz : float
        Sampling rate.
    signal : SignalProcessing
        Filter; without a cut-off the positions are not filtered.
    dq : ndarray, shape (n_samples, n_dof), optional
        Measured velocities (rad/s or m/s), which are filtered too and replace differences of the positions.

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
    ``test_signals.py`` checks it on sines whose derivatives are known.
    """
    q = checked_columns(q)
    if signal.cutoff_hz is not None:
        q = low_pass(q, rate_hz, signal)
    if dq is not None and signal.cutoff_hz is not None:
        dq = low_pass(checked_columns(dq), rate_hz, signal)
    return derivatives(q, rate_hz, signal, dq)


def derivatives(
    q: Array, rate_hz: float, signal: SignalProcessing, dq: Array | None = None
) -> tuple[Array, Array, Array]:
    """Differentiate filtered positions as `differentiate` does, with its arguments, results and errors."""
    sharp = _sharpened(q, rate_hz, signal)
    fast = (sharp != q).any(axis=0)
    if dq is None:
        dq = central_differences(sharp, 1.0 / rate_hz, signal.ends)
    # The motion decides, since noise is a larger part of velocities.
    sharp = np.where(fast, _sharpened(dq, rate_hz, signal), dq) if fast.any() else dq
    return q, dq, central_differences(sharp, 1.0 / rate_hz, signal.ends)


def _sharpened(x: Array, rate_hz: float, signal: SignalProcessing) -> Array:
    r"""Return signals whose central differences lose nothing that matters of a motion that is fast for its rate.

    Of a sine with w rad per sample central differences keep ``sin(w) / w``, about ``1 - w^2 / 6``. Less a sixth of the second
    differences of the sine it is ``1 - w^4 / 30``. Only what lies below ``cutoff_hz / SLOW`` changes, and only where more than
    `LOST` of the derivative is missing. Without a cut-off, and with ends of first order, signals stay as they are.
    """
    if signal.cutoff_hz is None or signal.ends == "first-order":
        return x
    edge = signal.cutoff_hz / SLOW
    if (2.0 * np.pi * edge / rate_hz) ** 2 / 6.0 <= LOST:
        return x
    slow = zero_phase_butterworth(x, rate_hz, edge, signal.order, signal.padding, curved=True)
    with np.errstate(over="ignore", invalid="ignore"):  # reported with the derivatives
        lost = np.pad(np.diff(slow, 2, axis=0), ((1, 1), (0, 0)), "reflect", reflect_type="odd") / -6.0
        share = [np.linalg.norm(y[2:] - y[:-2], axis=0) for y in (lost, slow)]
        return np.where(share[0] > LOST * share[1], x + lost, x)


def low_pass(x: Array, rate_hz: float, signal: SignalProcessing) -> Array:
    """Filter positions or measured velocities according to settings with a cut-off."""
    assert signal.cutoff_hz is not None
    curved = signal.ends == "second-order" and signal.padding == "scipy"
    return zero_phase_butterworth(
        x, rate_hz, signal.cutoff_hz, signal.order, signal.padding, signal.form, curved
    )


def padding_length(order: int, convention: Convention) -> int:
    """Return the default number of samples of SciPy's or MATLAB's odd extension at each end."""
    return 3 * order if convention == "matlab" else 3 * (order + 1)


class LowPass(NamedTuple):
    """A digital low-pass filter whose zeros are all at -1.

    Attributes
    ----------
    poles : ndarray of complex, shape (order,)
        Its poles.
    gain : float
        Factor of its numerator.
    """

    poles: NDArray[np.complex128]
    gain: float

    @classmethod
    def of(cls, poles: NDArray[np.complex128], share: float, gain: float = 1.0) -> LowPass:
        """Return the bilinear transform of a filter ``gain prod(-p) / prod(s - p)`` with its cut-off at 1 rad/s.

        `share` is the cut-off as a share of the Nyquist frequency.
        """
        warped = np.tan(0.5 * np.pi * share) * poles
        return cls((1.0 + warped) / (1.0 - warped), gain * float(np.real(np.prod(-warped / (1.0 - warped)))))

    def sections(self) -> Array:
        """Return its sections of second order, (ceil(order / 2), 6): the poles nearest to the unit circle last.

        A single real pole has a section of its own, the first; that has the gain, too.
        """
        real = self.poles[np.abs(self.poles.imag) == 0.0].real
        above = self.poles[self.poles.imag > 0.0]
        above = above[np.argsort(np.abs(above))]
        sos = [[1.0, 1.0, 0.0, 1.0, -p, 0.0] for p in real]
        sos += [[1.0, 2.0, 1.0, 1.0, -2.0 * p.real, p.real**2 + p.imag**2] for p in above]
        sections = np.array(sos)
        sections[0, :3] *= self.gain
        return sections

    def transfer_function(self) -> Array:
        """Return the filter as one section, (1, 2 order + 2): products of its sections."""
        b, a = np.zeros((2, len(self.poles) + 1))
        b[0] = a[0] = 1.0
        for section in self.sections():
            for product, factors in ((b, section[:3]), (a, section[3:])):
                # Not a convolution, whose sums NumPy leaves to BLAS: published figures depend on their last bits.
                once, twice = np.roll(product, 1), np.roll(product, 2)
                product[:] = factors[0] * product + factors[1] * once + factors[2] * twice
        return np.concatenate([b, a])[None, :]


def butterworth(order: int, share: float) -> LowPass:
    """Design a Butterworth filter; `share` is its cut-off (-3 dB) as a share of the Nyquist frequency.

    ``test_signals.py`` compares designs with those of ``scipy.signal``.
    """
    return LowPass.of(-np.exp(0.5j * np.pi * np.arange(1 - order, order, 2) / order), share)


def chebyshev(order: int, ripple_db: float, share: float) -> LowPass:
    """Design a Chebyshev filter of type I; the ripple of its passband ends at `share` of the Nyquist frequency.

    ``test_signals.py`` compares designs with those of ``scipy.signal``.
    """
    epsilon = np.sqrt(10.0 ** (0.1 * ripple_db) - 1.0)
    angles = 0.5 * np.pi * np.arange(1 - order, order, 2) / order
    poles = -np.sinh(np.arcsinh(1.0 / epsilon) / order + 1j * angles)
    return LowPass.of(poles, share, 1.0 if order % 2 else 1.0 / np.sqrt(1.0 + epsilon**2))


def steady_states(sos: Array) -> Array:
    """Return the states of the sections, (s, order), with which the filter rests at an input of one (transposed direct form II)."""
    half = sos.shape[1] // 2
    b, a = sos[:, :half], sos[:, half:]
    rest = b.sum(axis=1) / a.sum(axis=1)
    # The states from the last one on: each adds what its coefficients leave of input and output.
    left = b[:, 1:] - a[:, 1:] * rest[:, None]
    states = np.cumsum(left[:, ::-1], axis=1)[:, ::-1]
    # Each section gets what those before it make of one.
    states[1:] *= np.cumprod(rest)[:-1, None]
    return np.ascontiguousarray(states)


def poles_survive(poles: Array | NDArray[np.complex128], denominators: Iterable[Array]) -> bool:
    """Whether the roots of the rounded coefficients still equal the designed poles."""
    margin = 1.0 - np.abs(poles)
    if not (margin > 0.0).all():
        return False
    roots = np.concatenate([np.roots(denominator) for denominator in denominators])
    moved = np.array([np.abs(roots - pole).min() for pole in poles]) + np.finfo(np.float64).eps
    return bool((moved <= LARGEST_POLE_ERROR * margin).all())


def checked_columns(x: Array) -> Array:
    """Return contiguous (n_samples, m) floats, or raise an error with the given shape."""
    x = np.ascontiguousarray(real_array("signals", x, SignalError))
    if x.ndim != 2:
        raise SignalError(f"signals must have shape (n_samples, m), got {x.shape}")
    if not np.isfinite(x).all():
        sample, signal = np.argwhere(~np.isfinite(x))[0]
        raise SignalError(f"sample {sample} of signal {signal} is not a finite number")
    return x


Stage = tuple[Array, Array, int, int, int]
"""A filter of the core: sections (s, 6), their steady states (s, 2), padding, factor, first kept sample."""

DECIMATION_ORDER = 8
"""Order of the Chebyshev I filter of both ``decimate``, as in `_squared_gain`."""
DECIMATION_RIPPLE_DB = 0.05
"""Passband ripple (dB) of the Chebyshev filter."""
DECIMATION_BAND = 0.8
"""Cut-off of the Chebyshev filter, as a share of the new Nyquist frequency."""


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
        One per factor, in the format of the core; empty without decimation.

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


def least_samples(signal: SignalProcessing) -> int:
    """Return the smallest number of samples for which `decimation_stages` leaves a row.

    Parameters
    ----------
    signal : SignalProcessing
        Factors, convention and rows dropped at the ends. Tested in ``tests/test_check_gaps.py``.
    """
    padlen = padding_length(DECIMATION_ORDER, signal.decimation_convention)
    least = 2 * signal.edge_rows + 1 if signal.decimation else 1
    for factor in reversed(signal.decimation):
        least = max(padlen + 1, factor, factor * (least - 1) + 1)
    return least


@lru_cache(maxsize=64)
def _stages(n_samples: int, factors: tuple[int, ...], convention: Convention) -> tuple[Stage, ...]:
    """Stages of `decimation_stages`, cached: their design takes longer than filtering a small log, and `check` filters often."""
    matlab = convention == "matlab"
    padlen = padding_length(DECIMATION_ORDER, convention)
    stages: list[Stage] = []
    for factor in factors:
        stage = f"stage {len(stages) + 1} of {len(factors)} gets {n_samples}"
        needed = max(padlen, factor - 1)
        if n_samples <= needed:
            raise SignalError(f"decimation by {factor} needs more than {needed} samples, {stage}")
        sos, zi = _decimation_filter(factor)
        left = -(-n_samples // factor)
        # MATLAB's grid ends at the last sample.
        first = n_samples - factor * (left - 1) - 1 if matlab else 0
        stages.append((sos, zi, padlen, factor, first))
        n_samples = left
    return tuple(stages)


@lru_cache(maxsize=64)
def _decimation_filter(factor: int) -> tuple[Array, Array]:
    """Sections of the filter before a decimation, (4, 6), and their steady states, (4, 2)."""
    design = chebyshev(DECIMATION_ORDER, DECIMATION_RIPPLE_DB, DECIMATION_BAND / factor)
    sos = design.sections()
    if not poles_survive(design.poles, sos[:, 3:]):
        raise SignalError(f"rounding spoils the filter of a decimation by {factor}: take several stages")
    return sos, steady_states(sos)


def decimate(x: Array, stages: Sequence[Stage]) -> Array:
    """Filter and decimate signals in the same way as the columns of W.

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
    x = checked_columns(x)
    with CoreErrorsAs(SignalError):
        return _core.decimate(x, list(stages), core_threads()) if stages else x.copy()


def row_values(values: Array, signal: SignalProcessing) -> Array:
    """Return signals at the rows of (7), (n_rows, n): decimated, without the rows at the ends; `values` are (n_samples, n)."""
    values = np.ascontiguousarray(values)
    return np.asarray(decimate(values, decimation_stages(len(values), signal))[signal.kept_rows])
