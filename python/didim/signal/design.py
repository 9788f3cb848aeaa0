"""Design of low-pass filters: poles of Butterworth's and Chebyshev's, second-order sections, steady states.

The formulas and their order are SciPy's, so that the coefficients have its bits; loading ``scipy.signal`` takes longer than a whole
IDIM-LS. ``tests/test_like_scipy.py`` compares them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array

REAL = 100.0 * float(np.finfo(np.float64).eps)
"""Largest imaginary part of a pole that counts as real, as a share of its size."""


@dataclass(frozen=True)
class LowPass:
    """A digital low-pass filter: `poles` (order,), as many zeros at -1, and a gain of `gain`."""

    poles: NDArray[np.complex128]
    gain: float

    def sections(self) -> Array:
        """Return second-order sections ``[b0, b1, b2, 1, a1, a2]``, (n, 6); the poles next to the unit circle come last."""
        order = len(self.poles)
        # Poles and zeros of the first-order section, of which one of each is 0.
        odd = [0.0] * (order % 2)
        poles = [*_pairs(self.poles), *odd]
        zeros = [-1.0] * order + odd
        sections = np.zeros(((order + 1) // 2, 6))
        for section in sections[::-1]:
            first = poles.pop(_nearest_to_circle(poles))
            if first.imag == 0.0:
                second = poles.pop(
                    min(
                        (k for k, pole in enumerate(poles) if pole.imag == 0.0),
                        key=lambda k: abs(1.0 - abs(poles[k])),
                    )
                )
            else:
                second = first.conjugate()
            chosen = [zeros.pop(int(np.argsort(np.abs(np.array(zeros) - first))[0])) for _ in range(2)]
            section[:3], section[3:] = np.poly(chosen), np.poly([first, second]).real
        sections[0, :3] *= self.gain
        return sections

    def transfer_function(self) -> tuple[Array, Array]:
        """Return the coefficients of numerator and denominator, (order + 1,) each."""
        return np.asarray(self.gain * np.poly(-np.ones(len(self.poles)))), np.asarray(
            np.poly(self.poles).real
        )


def butterworth(order: int, share: float) -> LowPass:
    """Design a Butterworth filter, with its cut-off (-3 dB) at a share of the Nyquist frequency, between 0 and 1."""
    return _digital(-np.exp(1j * np.pi * _odd_numbers(order) / (2 * order)), 1.0, share)


def chebyshev(order: int, ripple_db: float, share: float) -> LowPass:
    """Design a Chebyshev filter of type I, whose gain varies by `ripple_db` up to a share of the Nyquist frequency, 0 to 1."""
    epsilon = math.sqrt(10 ** (0.1 * ripple_db) - 1.0)
    spread = 1.0 / order * math.asinh(1 / epsilon)
    poles = -np.sinh(spread + 1j * (np.pi * _odd_numbers(order) / (2 * order)))
    gain = float(np.real(np.prod(-poles)))
    return _digital(poles, gain / math.sqrt(1 + epsilon * epsilon) if order % 2 == 0 else gain, share)


def steady_state(numerator: Array, denominator: Array) -> Array:
    """Return the states of the transposed direct form II that a constant input of 1 leaves as they are, (order,)."""
    companion = np.zeros((len(denominator) - 1,) * 2)
    companion[0] = -denominator[1:]
    companion[1:, :-1] += np.eye(len(companion) - 1)
    return np.linalg.solve(
        np.eye(len(companion)) - companion.T, numerator[1:] - denominator[1:] * numerator[0]
    )


def steady_states(sections: Array) -> Array:
    """Return those of second-order sections one after the other, (n, 2), for a constant input of 1 of the first."""
    states = np.empty((len(sections), 2))
    gain = 1.0
    for state, section in zip(states, sections, strict=True):
        state[:] = gain * steady_state(section[:3], section[3:])
        gain *= section[:3].sum() / section[3:].sum()
    return states


def _odd_numbers(order: int) -> Array:
    return np.arange(-order + 1, order, 2, dtype=np.float64)


def _digital(poles: NDArray[np.complex128], gain: float, share: float) -> LowPass:
    """Shift the cut-off of an analogue low-pass filter from 1 rad/s, and take the bilinear transform at 2 Hz."""
    warped = 4.0 * np.tan(np.pi * share / 2.0)
    poles, gain = warped * poles, gain * warped ** len(poles)
    return LowPass((4.0 + poles) / (4.0 - poles), float(gain * np.real(1.0 / np.prod(4.0 - poles))))


def _pairs(poles: NDArray[np.complex128]) -> list[complex]:
    """One pole of each conjugate pair, by their real parts, then the real poles."""
    poles = poles[np.lexsort((np.abs(poles.imag), poles.real))]
    real = np.abs(poles.imag) <= REAL * np.abs(poles)
    upper, lower = poles[~real & (poles.imag > 0.0)], poles[~real & (poles.imag < 0.0)]
    return [*((upper + lower.conj()) / 2).tolist(), *poles[real].real.tolist()]


def _nearest_to_circle(poles: list[complex]) -> int:
    return int(np.argmin(np.abs(1.0 - np.abs(np.array(poles)))))
