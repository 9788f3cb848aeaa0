"""Fourier series that start and end at rest, scaled to the limits of position, velocity, acceleration and jerk.

A joint follows ``q(t) = offset + sum_k a_k sin(k w t) + b_k cos(k w t)``. The amplitudes lie in the null space of position at
the offset, velocity zero and acceleration zero at ``t = 0``, hence also after each period. Each joint's shape is divided by its
largest relative use of the four limits, taken as a p-norm: every set of variables is a motion within its limits, and the
optimisation is unconstrained. Tested in ``tests/test_excitation.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .._tools.arrays import Array
from .limits import MotionLimits

POWERS = (64, 256)
"""Exponents of the norm that replaces a maximum, in succession; powers of two. With the first the norm is smooth and some per
cent above the maximum, with the second within 1 to 2 %."""
SAMPLES_PER_PERIOD = 20
"""Samples per period of the highest harmonic: the regressor contains products of positions and velocities, and friction."""


Motion = tuple[Array, Array, Array, Array]
"""Positions, velocities, accelerations and jerks, a row for each sample."""


@dataclass(frozen=True, kw_only=True)
class SeriesBasis:
    """Values of the admissible series and of their derivatives on a grid over one period.

    Attributes
    ----------
    period_s : float
        Period (s).
    harmonics : int
        Number of harmonics, at least 4.
    """

    period_s: float
    harmonics: int

    @property
    def samples(self) -> int:
        """Samples of the grid of the optimiser."""
        return SAMPLES_PER_PERIOD * self.harmonics

    @cached_property
    def free(self) -> Array:
        """Orthonormal basis of the admissible amplitudes (sines, then cosines), ``(2 harmonics, n_free)``."""
        k = np.arange(1.0, self.harmonics + 1.0)
        zero = np.zeros_like(k)
        rest = np.stack(
            [
                np.concatenate([zero, 1.0 / k]),
                np.concatenate([np.ones_like(k), zero]),
                np.concatenate([zero, k]),
            ]
        )
        # Weighted amplitudes `k a_k` have velocities of equal size, and the optimiser converges faster.
        rest /= np.linalg.norm(rest, axis=1)[:, None]
        weighted = np.linalg.svd(rest)[2][3:].T
        return np.asarray(weighted / np.concatenate([k, k])[:, None])

    def derivatives(self, samples: int) -> Motion:
        """Position to jerk of each admissible series at `samples` times of one period, ``(samples, n_free)`` each."""
        w = 2.0 * np.pi / self.period_s * np.arange(1.0, self.harmonics + 1.0)
        angle = np.outer(np.arange(samples) * (self.period_s / samples), w)
        s, c = np.sin(angle), np.cos(angle)
        return (
            np.hstack([s, c]) @ self.free,
            np.hstack([c * w, -s * w]) @ self.free,
            np.hstack([-s * w**2, -c * w**2]) @ self.free,
            np.hstack([-c * w**3, s * w**3]) @ self.free,
        )

    @cached_property
    def grid(self) -> Motion:
        """Derivatives on the grid of the optimiser."""
        return self.derivatives(self.samples)


@dataclass(frozen=True, kw_only=True)
class Series:
    """A motion: scaled amplitudes and offsets of all joints.

    Attributes
    ----------
    basis : SeriesBasis
        Period and harmonics.
    scaled : (n_free, n_dof) array
        Coefficients of the admissible series.
    offset : (n_dof,) array
        Position at the start and at the end of each period (rad or m).
    """

    basis: SeriesBasis
    scaled: Array
    offset: Array

    def motion(self, factor: int = 1) -> Motion:
        """Position, velocity, acceleration and jerk of one period, on a grid `factor` times finer than the optimiser's."""
        if factor == 1:
            q, dq, ddq, jerk = (basis @ self.scaled for basis in self.basis.grid)
        else:
            q, dq, ddq, jerk = self._transformed(factor * self.basis.samples)
        return q + self.offset, dq, ddq, jerk

    def _transformed(self, samples: int) -> tuple[Array, ...]:
        """Return position from the offset, to jerk, by Fourier transforms: 20 times as fast as sines and cosines on a fine grid."""
        sine, cosine = self.amplitudes()
        spectrum = 0.5 * samples * (cosine - 1j * sine)
        step = 2j * np.pi / self.basis.period_s * np.arange(1.0, self.basis.harmonics + 1.0)[:, None]
        rest = np.zeros((1, spectrum.shape[1]))
        return tuple(
            np.fft.irfft(np.concatenate([rest, spectrum * step**order]), samples, axis=0)
            for order in range(4)
        )

    def amplitudes(self) -> tuple[Array, Array]:
        """Sine and cosine amplitudes (rad or m), ``(harmonics, n_dof)`` each."""
        both = self.basis.free @ self.scaled
        return both[: self.basis.harmonics], both[self.basis.harmonics :]


def _norm(values: Array, power: int) -> tuple[Array, Array]:
    """p-norm of each column of non-negative values, and its derivative with respect to them; `power` is a power of two."""
    size = values.max(axis=0)
    relative = values / size
    # relative ** (power - 1) by squaring: a general power takes longer than all other computations of a motion.
    powers, square = relative.copy(), relative
    for _ in range(power.bit_length() - 2):
        square = square * square
        powers *= square
    total = np.asarray((powers * relative).sum(axis=0))
    norm = total ** (1.0 / power)
    return norm * size, powers / norm ** (power - 1)


class ScaledSeries:
    """Variables of the optimiser, the motion that they define, and backpropagation of gradients.

    Parameters
    ----------
    basis : SeriesBasis
        Period and harmonics.
    limits : MotionLimits
        Largest positions, velocities, accelerations and jerks.
    start : (n_dof,) array or None
        Fixed offset; None if the optimiser chooses it.
    shrinks : bool
        Whether amplitudes may be smaller than the kinematic limits allow, because torques or the workspace bound the motion too.
    """

    def __init__(self, basis: SeriesBasis, limits: MotionLimits, start: Array | None, shrinks: bool) -> None:
        self.basis, self.limits, self.start, self.shrinks = basis, limits, start, shrinks
        self.power = POWERS[0]
        self.n = len(limits.lowest)
        self.free = int(basis.free.shape[1])

    @property
    def size(self) -> int:
        """Number of variables."""
        return self.n * (self.free + (self.start is None) + self.shrinks)

    def pack(self, shape: Array, center: Array | None = None) -> Array:
        """Return the variables of a shape ``(n_free, n_dof)`` and of free offsets, 0 being the middle of their range."""
        parts = [shape.ravel()]
        if self.start is None:
            parts.append(np.zeros(self.n) if center is None else center)
        if self.shrinks:
            parts.append(np.full(self.n, 0.3))
        return np.concatenate(parts)

    def perturbed(self, v: Array, size: float, rng: np.random.Generator) -> Array:
        """Return the variables with a random change of each joint's shape, of relative length `size`; offsets do not change."""
        count = self.free * self.n
        shape = v[:count].reshape(self.free, self.n)
        change = rng.standard_normal(shape.shape)
        change *= size * np.linalg.norm(shape, axis=0) / np.linalg.norm(change, axis=0)
        return np.concatenate([(shape + change).ravel(), v[count:]])

    def build(self, v: Array) -> tuple[Series, _Way]:
        """Return the motion of the variables, and the intermediate values for `back`."""
        limits, n = self.limits, self.n
        shape = v[: self.free * n].reshape(self.free, n)
        rest = v[self.free * n :]
        shrink = rest[-n:] if self.shrinks else np.zeros(n)
        kappa = 1.0 / (1.0 + shrink**2)
        values = [basis @ shape for basis in self.basis.grid]
        uses, slopes = [], []
        for value, limit in zip(values[1:], (limits.velocity, limits.acceleration, limits.jerk), strict=True):
            use, slope = _norm(np.abs(value), self.power)
            uses.append(use / limit)
            slopes.append(np.sign(value) * slope / limit)
        up, down = np.maximum(values[0], 0.0), np.maximum(-values[0], 0.0)
        (above, d_above), (below, d_below) = _norm(up, self.power), _norm(down, self.power)
        if self.start is None:
            width = limits.highest - limits.lowest
            position, slope = (above + below) / width, (d_above - d_below) / width
        else:
            room_up, room_down = limits.highest - self.start, self.start - limits.lowest
            relative = np.maximum(up / room_up, down / room_down)
            position, slope = _norm(relative, self.power)
            slope = slope * np.where(values[0] > 0.0, 1.0 / room_up, -1.0 / room_down)
        together = np.stack([position, *uses])
        use, weight = _norm(together, self.power)
        change = sum(
            basis.T @ (part * share)
            for basis, part, share in zip(self.basis.grid, [slope, *slopes], weight, strict=True)
        )
        scale = kappa / use
        offset, extent = self.start, None
        if self.start is None:
            with np.errstate(over="ignore"):  # the share vanishes far outside
                share = 1.0 / (1.0 + np.exp(-rest[:n]))
            room = width - scale * (above + below)
            offset = limits.lowest + scale * below + share * room
            grid = self.basis.grid[0].T
            extent = (share, above, below, grid @ d_above, -grid @ d_below)
        series = Series(basis=self.basis, scaled=scale * shape, offset=np.asarray(offset))
        return series, _Way(shape, -2.0 * shrink * kappa**2, use, np.asarray(change), scale, extent)

    def back(self, chain: _Way, gq: Array, gdq: Array, gddq: Array) -> Array:
        """Return the gradient with respect to the variables from gradients with respect to the motion on the grid."""
        position, velocity, acceleration, _ = self.basis.grid
        scaled = position.T @ gq + velocity.T @ gdq + acceleration.T @ gddq
        shape, scale = chain.shape, chain.scale
        grad_shape = scaled * scale
        grad_scale = (scaled * shape).sum(axis=0)
        parts = []
        if chain.extent is not None:
            share, above, below, d_above, d_below = chain.extent
            to_offset = gq.sum(axis=0)
            # offset = lowest + (1 - share) scale below + share (width - scale above)
            grad_scale = grad_scale + to_offset * ((1.0 - share) * below - share * above)
            grad_shape = grad_shape + to_offset * scale * ((1.0 - share) * d_below - share * d_above)
            width = self.limits.highest - self.limits.lowest
            room = width - scale * (above + below)
            parts.append(to_offset * room * share * (1.0 - share))
        grad_shape = grad_shape - grad_scale * (scale / chain.use) * chain.change
        if self.shrinks:
            parts.append(grad_scale / chain.use * chain.bend)
        return np.concatenate([grad_shape.ravel(), *parts])


@dataclass(frozen=True)
class _Way:
    """Intermediate values of `ScaledSeries.build`."""

    shape: Array
    bend: Array
    """Derivative of the part of the amplitudes that the optimiser leaves."""
    use: Array
    change: Array
    scale: Array
    extent: tuple[Array, Array, Array, Array, Array] | None
