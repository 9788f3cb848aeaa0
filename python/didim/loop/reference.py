"""References of a closed loop: sampled positions, Fourier series, moves from point to point.

Every kind becomes pieces of fifth degree in the core, with positions, velocities and accelerations at any time. Tested in
``tests/test_reference.py`` and in the core against closed forms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import didim._core as _core

from .._tools.arrays import Array, real_array
from .._tools.notebook import Brief
from ..errors import CoreErrorsAs, ReferenceError

KNOTS_PER_PERIOD = 100
"""Polynomial pieces per period of the highest harmonic of a Fourier series: the error is rounding."""
MOST_STORED = 10_000_000
"""Upper bound of the pieces of all stored joints: with 48 bytes each, half a gigabyte."""


@dataclass(frozen=True, repr=False)
class Reference(Brief):
    """A reference motion, joint side, SI units. Made by one of the class methods.

    Tested in ``tests/test_reference.py``.

    Attributes
    ----------
    core
        The reference of the numerical core.
    kind : str
        "sampled", "fourier" or "point-to-point".
    made_from : (str, tuple)
        Function of the core that made it, and its arguments, for `pickle` and `copy`.
    """

    core: _core.Reference
    kind: str
    made_from: tuple[str, tuple[Any, ...]] = field(compare=False, repr=False)

    def __reduce__(self) -> tuple[Callable[..., Reference], tuple[Any, ...]]:
        """Pickle the arguments; unpickling makes the object of the core again."""
        return _made, (self.kind, *self.made_from)

    @property
    def n_dof(self) -> int:
        """Number of joints."""
        return self.core.n_dof

    @property
    def duration(self) -> float:
        """Length of the motion (s); it starts at time 0."""
        return self.core.span[1]

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations at times.

        Parameters
        ----------
        t : (n_times,) array
            Times (s).

        Returns
        -------
        q, dq, ddq : (n_times, n_dof) arrays
            Joint side, rad or m and per s, per s^2.
        """
        times = np.atleast_1d(real_array("t", t, ReferenceError))
        if times.ndim != 1:
            raise ReferenceError(f"t must have shape (n_times,), got {times.shape}")
        return self.core.at(times)

    @property
    def divisible(self) -> bool:
        """Whether joints have motions of their own: not where accelerations jump, as in moves whose joints arrive together."""
        return not self.core.breaks

    def of_joints(self, joints: Sequence[int]) -> Reference:
        """Return the motion of some joints, from 0, of one that is `divisible`."""
        maker, (first, *arguments) = self.made_from
        at = list(joints)
        if maker == "fourier":
            offset, sine, cosine, *rest = arguments
            arguments = [[offset[joint] for joint in at], sine[:, at].copy(), cosine[:, at].copy(), *rest]
        else:
            arguments = [values[:, at].copy() for values in arguments]
        return _made(self.kind, maker, (first, *arguments))

    @classmethod
    def sampled(cls, q: ArrayLike, *, rate_hz: float) -> Reference:
        """Interpolate samples at a constant rate.

        Parameters
        ----------
        q : (n_samples, n_dof) array
            Positions (rad or m), the first at time 0. At least five.
        rate_hz : float
            Samples per second.

        Raises
        ------
        ReferenceError
            For too few samples, a wrong shape, a NaN, or a rate that is not positive.
        """
        positions = _matrix("q", q)
        if not (np.isfinite(rate_hz) and rate_hz > 0.0):
            raise ReferenceError(f"rate_hz must be positive, got {rate_hz}")
        return _made("sampled", "sampled", (float(rate_hz), positions.copy()))

    @classmethod
    def through(cls, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, *, rate_hz: float) -> Reference:
        """Interpolate samples of a motion at a constant rate by quintics.

        Parameters
        ----------
        q, dq, ddq : (n_samples, n_dof) arrays
            Motion (rad or m, and per s, s^2), the first sample at time 0. At least two.
        rate_hz : float
            Samples per second.

        Raises
        ------
        ReferenceError
            For too few samples, different shapes, a NaN, or a rate that is not positive.
        """
        values = [_matrix(name, value) for name, value in (("q", q), ("dq", dq), ("ddq", ddq))]
        if not (np.isfinite(rate_hz) and rate_hz > 0.0):
            raise ReferenceError(f"rate_hz must be positive, got {rate_hz}")
        times = np.arange(len(values[0])) / rate_hz
        return _made("sampled", "from_knots", (times, *(value.copy() for value in values)))

    @classmethod
    def fourier(
        cls,
        sine: ArrayLike,
        cosine: ArrayLike,
        *,
        period_s: float,
        offset: ArrayLike = 0.0,
        duration_s: float | None = None,
    ) -> Reference:
        """Make a Fourier series, with ``w = 2 pi / period``.

        ``q = offset + sum_k sine_k sin(k w t) + cosine_k cos(k w t)``.

        Parameters
        ----------
        sine, cosine : (n_harmonics, n_dof) arrays
            Amplitudes (rad or m).
        period_s : float
            Period of the first harmonic (s).
        offset : (n_dof,) array or float
            Mean positions.
        duration_s : float, optional
            Length of the motion; one period by default.

        Raises
        ------
        ReferenceError
            For wrong shapes or numbers.
        """
        s, c = _matrix("sine", sine), _matrix("cosine", cosine)
        if s.shape != c.shape or 0 in s.shape:
            raise ReferenceError(
                f"sine and cosine must have one shape (n_harmonics, n_dof), got {s.shape} and {c.shape}"
            )
        duration = period_s if duration_s is None else duration_s
        if not (period_s > 0.0 and duration > 0.0 and np.isfinite(period_s) and np.isfinite(duration)):
            raise ReferenceError(f"period and duration must be positive, got {period_s} and {duration} s")
        knots = KNOTS_PER_PERIOD * len(s) * (duration / period_s)
        stored = 4 * -(-s.shape[1] // 4)  # the core has the coefficients of four joints together
        if knots * stored > MOST_STORED or knots * len(s) > 100_000_000:
            raise ReferenceError(f"{duration:g} s with {len(s)} harmonics in {period_s:g} s is too long")
        count = max(2, round(knots))
        mean = real_array("offset", offset, ReferenceError)
        if mean.shape not in ((), (1,), s.shape[1:]):
            raise ReferenceError(
                f"offset needs {s.shape[1]} numbers, one per joint, got an array of shape {mean.shape}"
            )
        places = np.broadcast_to(mean, s.shape[1:]).tolist()
        return _made(
            "fourier", "fourier", (float(period_s), places, s.copy(), c.copy(), float(duration), count)
        )

    @classmethod
    def random_fourier(
        cls,
        *,
        harmonics: int,
        period_s: float,
        max_position: ArrayLike,
        max_velocity: ArrayLike,
        max_acceleration: ArrayLike,
        offset: ArrayLike = 0.0,
        duration_s: float | None = None,
        seed: int = 0,
    ) -> Reference:
        """Make a random Fourier series that starts at rest.

        Each joint is scaled to the first of its limits.

        Amplitudes are normal and decrease with the harmonic, which excites position, velocity and acceleration. A correction
        sets position ``offset``, zero velocity and zero acceleration at the start of each period.

        Parameters
        ----------
        harmonics : int
            At least 4.
        period_s : float
            Period (s).
        max_position, max_velocity, max_acceleration : (n_dof,) arrays
            Largest distance from `offset` (rad or m), speed and acceleration of each joint.
        offset : (n_dof,) array or float
            Position at the start.
        duration_s : float, optional
            Length; one period by default.
        seed : int
            Seed of NumPy's default generator: the same motion on every machine.

        Raises
        ------
        ReferenceError
            For wrong shapes or numbers.
        """
        asked = {
            "max_position": max_position,
            "max_velocity": max_velocity,
            "max_acceleration": max_acceleration,
        }
        limits = {
            name: np.atleast_1d(real_array(name, value, ReferenceError)) for name, value in asked.items()
        }
        n = max(limit.size for limit in limits.values())
        for name, limit in limits.items():
            if limit.shape not in ((n,), (1,)):
                raise ReferenceError(f"{name} needs {n} numbers, one per joint, got {limit.size}")
            if not (limit > 0.0).all():
                raise ReferenceError(f"{name} must be positive, got {limit.tolist()}")
        if harmonics < 4:
            raise ReferenceError(f"a series that starts at rest needs at least 4 harmonics, got {harmonics}")
        if seed < 0:
            raise ReferenceError(f"seed must not be negative, got {seed}")
        rng = np.random.default_rng(seed)
        k = np.arange(1, harmonics + 1)[:, None]
        sine, cosine = rng.standard_normal((2, harmonics, n)) / k
        # Position, velocity and acceleration at time 0 are sums over harmonics: the least change makes them 0.
        sine -= _least_change(k[:, 0].astype(float)[None], sine)
        cosine -= _least_change(np.stack([np.ones(harmonics), k[:, 0] ** 2.0]), cosine)
        shape = cls.fourier(sine, cosine, period_s=period_s)
        t = np.linspace(0.0, period_s, 200 * harmonics, endpoint=False)
        peaks = [np.abs(values).max(axis=0) for values in shape.at(t)]
        with np.errstate(
            divide="ignore", over="ignore"
        ):  # with a very long period only the positions are scaled
            scale = np.min([limit / peak for limit, peak in zip(limits.values(), peaks, strict=True)], axis=0)
        return cls.fourier(
            sine * scale, cosine * scale, period_s=period_s, offset=offset, duration_s=duration_s
        )

    @classmethod
    def point_to_point(
        cls,
        points: ArrayLike,
        *,
        max_velocity: ArrayLike,
        max_acceleration: ArrayLike,
        dwell_s: float = 0.0,
    ) -> Reference:
        """Move between points with trapezoidal velocity.

        All joints of a move start and arrive together.

        Parameters
        ----------
        points : (n_points, n_dof) array
            Positions (rad or m), the first at time 0.
        max_velocity, max_acceleration : (n_dof,) arrays
            Limits of each joint; in each move one joint reaches a limit.
        dwell_s : float
            Rest at each point, the first and the last too.

        Raises
        ------
        ReferenceError
            For wrong shapes or limits, or points that are all the same without a rest.
        """
        places = _matrix("points", points)
        n = places.shape[1]
        limits = []
        for name, value in (("max_velocity", max_velocity), ("max_acceleration", max_acceleration)):
            values = real_array(name, value, ReferenceError)
            if values.shape not in ((), (n,)) or not np.isfinite(values).all():
                raise ReferenceError(f"{name} needs {n} finite numbers, one per joint, got {value!r}")
            limits.append(np.broadcast_to(values, (n,)).tolist())
        if not (np.isfinite(dwell_s) and dwell_s >= 0.0):
            raise ReferenceError(f"dwell_s must not be negative, got {dwell_s}")
        return _made(
            "point-to-point", "point_to_point", (places.copy(), limits[0], limits[1], float(dwell_s))
        )


def _least_change(rows: Array, amplitudes: Array) -> Array:
    """Return the smallest change of amplitudes, weighted by harmonic, that makes `rows @ amplitudes` zero."""
    weight = 1.0 / np.arange(1, rows.shape[1] + 1) ** 2
    gram = (rows * weight) @ rows.T
    return np.asarray(weight[:, None] * (rows.T @ np.linalg.solve(gram, rows @ amplitudes)))


def _matrix(name: str, value: ArrayLike) -> Array:
    array = real_array(name, value, ReferenceError)
    if array.ndim != 2:
        raise ReferenceError(f"{name} must have shape (rows, n_dof), got {array.shape}")
    return array


def _made(kind: str, maker: str, arguments: tuple[Any, ...]) -> Reference:
    """Make a reference by a function of the core."""
    with CoreErrorsAs(ReferenceError):
        core = getattr(_core.Reference, maker)(*arguments)
    return Reference(core, kind, (maker, arguments))
