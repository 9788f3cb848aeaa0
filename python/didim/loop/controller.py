"""Controllers of the closed loop: PD, PID and cascades on joints, continuous or digital.

With ``e = q_ref - q`` and ``v = w dq_ref - dq`` each joint has

    ``u = P e + D v + I z + A ddq_ref + tau_ff / g``,  ``dz/dt = a e + b v``,  ``tau = g sat(u)``.

Tested in ``tests/test_control.py`` and in the core against closed forms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

import didim._core as _core

from .._tools.arrays import Array, real_array
from .._tools.notebook import Brief
from .._tools.pickling import Pickled
from ..errors import ControllerError, CoreErrorsAs


@dataclass(frozen=True, kw_only=True)
class Digital:
    """Sampling of a digital controller.

    Tested in ``tests/test_control.py``.

    Attributes
    ----------
    sample_time_s : float
        Time between two outputs (s), each held in between.
    delay_samples : int
        Whole samples from a measurement to the resulting output.
    smoothing : tuple of float
        Weights of the newest, second newest, ... position in the smoothed position, whose difference is the velocity.
    resolution : tuple of float
        Encoder step of the controller, per joint (rad or m); 0 for an exact one, empty if all are exact.
    """

    sample_time_s: float
    delay_samples: int = 0
    smoothing: tuple[float, ...] = (1.0,)
    resolution: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.delay_samples, bool) or not isinstance(self.delay_samples, int):
            raise ControllerError(f"delay_samples must be an integer, got {self.delay_samples!r}")
        if not 0 <= self.delay_samples <= 1000:
            raise ControllerError(f"delay_samples must be 0 to 1000, got {self.delay_samples}")
        if not (math.isfinite(self.sample_time_s) and self.sample_time_s > 0.0):
            raise ControllerError(f"sample_time_s must be positive, got {self.sample_time_s}")
        for name in ("smoothing", "resolution"):
            values = real_array(name, getattr(self, name), ControllerError)
            if values.ndim != 1:
                raise ControllerError(f"{name} must be a list of numbers, got {getattr(self, name)!r}")
            object.__setattr__(self, name, tuple(values.tolist()))
        if not self.smoothing or not np.isfinite(self.smoothing).all():
            raise ControllerError("smoothing needs one or more finite weights")
        if any(not math.isfinite(step) or step < 0.0 for step in self.resolution):
            raise ControllerError(f"resolution must be finite and not negative, got {list(self.resolution)}")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Controller(Pickled, Brief):
    """The laws of all joints, joint side. Made by `pd`, `pid` or `cascade`.

    Tested in ``tests/test_control.py``.

    Attributes
    ----------
    kind : str
        "pd", "pid" or "cascade".
    laws : (n_dof, 7) array
        ``P D I A w a b`` of each joint.
    gain : (n_dof,) array
        Drive gain ``g``: torque (N.m) or force (N) per unit of ``u``.
    saturation : (n_dof,) array
        Largest ``|u|``; infinite without one.
    digital : Digital or None
        None for a continuous controller, which is evaluated at every stage of the integration.
    feedforward : (rate_hz, (n_samples, n_dof) array) or None
        Torque (N.m, N) fed forward, straight lines between samples.
    """

    kind: str
    laws: Array
    gain: Array
    saturation: Array
    digital: Digital | None = None
    feedforward: tuple[float, Array] | None = None

    @property
    def n_dof(self) -> int:
        """Number of joints."""
        return len(self.laws)

    @classmethod
    def pd(
        cls,
        kp: ArrayLike,
        kv: ArrayLike,
        *,
        reference_velocity: ArrayLike = 1.0,
        acceleration: ArrayLike = 0.0,
        gain: ArrayLike = 1.0,
        saturation: ArrayLike = math.inf,
        digital: Digital | None = None,
    ) -> Controller:
        """Make a PD: ``u = kp e + kv (w dq_ref - dq) + acceleration ddq_ref``.

        Parameters
        ----------
        kp, kv : (n_dof,) arrays
            Gains (units of ``u`` per rad or m, and per rad/s or m/s).
        reference_velocity : float or (n_dof,) array
            ``w``: 1 with velocity feed-forward, 0 for damping of the motion itself.
        acceleration : float or (n_dof,) array
            Feed-forward of the reference acceleration: an inertia over the drive gain.
        gain, saturation : float or (n_dof,) array
            Drive gain, and largest ``|u|``.
        digital : Digital, optional
            For a sampled controller.

        Raises
        ------
        ControllerError
            For wrong lengths or numbers.
        """
        made = cls.pid(
            kp,
            kv,
            0.0,
            reference_velocity=reference_velocity,
            acceleration=acceleration,
            gain=gain,
            saturation=saturation,
            digital=digital,
        )
        return replace(made, kind="pd")

    @classmethod
    def pid(
        cls,
        kp: ArrayLike,
        kv: ArrayLike,
        ki: ArrayLike,
        *,
        reference_velocity: ArrayLike = 1.0,
        acceleration: ArrayLike = 0.0,
        gain: ArrayLike = 1.0,
        saturation: ArrayLike = math.inf,
        digital: Digital | None = None,
    ) -> Controller:
        """Make a PID: `pd` with ``ki`` times the integral of the position error.

        The integral is stopped while it would drive a saturated output further (anti-windup).
        """
        p, d, i, a, w = _columns(
            kp=kp, kv=kv, ki=ki, acceleration=acceleration, reference_velocity=reference_velocity
        )
        one = np.ones(len(p))
        return cls._checked("pid", [p, d, i, a, w, one, 0.0 * one], gain, saturation, digital)

    @classmethod
    def cascade(
        cls,
        kp: ArrayLike,
        kv: ArrayLike,
        *,
        integral_time_s: ArrayLike = math.inf,
        reference_velocity: ArrayLike = 0.0,
        acceleration: ArrayLike = 0.0,
        gain: ArrayLike = 1.0,
        saturation: ArrayLike = math.inf,
        digital: Digital | None = None,
    ) -> Controller:
        """Make a cascade of a position and a velocity loop.

        ``u = kv (v + 1/Ti integral of v)`` with ``v = kp e + w dq_ref - dq``.

        Parameters
        ----------
        kp : (n_dof,) array
            Gain of the position loop (1/s).
        kv : (n_dof,) array
            Gain of the velocity loop (units of ``u`` per rad/s or m/s).
        integral_time_s : float or (n_dof,) array
            ``Ti`` of the velocity loop (s); infinite for a proportional one.
        reference_velocity, acceleration, gain, saturation, digital
            As for `pd`.

        Raises
        ------
        ControllerError
            For wrong lengths or numbers.
        """
        p, d, ti, a, w = _columns(
            kp=kp,
            kv=kv,
            integral_time_s=integral_time_s,
            acceleration=acceleration,
            reference_velocity=reference_velocity,
            infinite=("integral_time_s",),
        )
        if not (ti > 0.0).all():
            raise ControllerError(f"integral_time_s must be positive, got {ti.tolist()}")
        return cls._checked(
            "cascade", [p * d, d, d / ti, a, w, p, np.ones(len(p))], gain, saturation, digital
        )

    @classmethod
    def tuned(
        cls,
        natural_frequency_hz: ArrayLike,
        damping: ArrayLike,
        inertia: ArrayLike,
        **options: object,
    ) -> Controller:
        """Make a PD with a natural frequency and damping, ``J e'' + kv e' + kp e = 0``.

        Parameters
        ----------
        natural_frequency_hz : (n_dof,) array
            Natural frequency of each joint (Hz).
        damping : float or (n_dof,) array
            Damping ratio.
        inertia : (n_dof,) array
            Inertia at each joint (kg.m^2 or kg), such as the mean of ``diag M(q)`` along the reference.
        **options
            As for `pd`.

        Raises
        ------
        ControllerError
            For wrong lengths or numbers.
        """
        frequency, ratio, j = _columns(
            natural_frequency_hz=natural_frequency_hz, damping=damping, inertia=inertia
        )
        for name, values in (("natural_frequency_hz", frequency), ("damping", ratio), ("inertia", j)):
            if not (values > 0.0).all():
                raise ControllerError(f"{name} must be positive, got {values.tolist()}")
        (gain,) = _columns(gain=options.get("gain", 1.0), n=len(j))  # type: ignore[arg-type]
        if not gain.all():
            raise ControllerError(f"gain must not be zero, got {gain.tolist()}")
        with np.errstate(over="ignore", invalid="ignore"):  # reported by pd
            omega = 2.0 * np.pi * frequency
            kp, kv = j * omega**2 / gain, 2.0 * ratio * omega * j / gain
        return cls.pd(kp, kv, **options)  # type: ignore[arg-type]

    def with_feedforward(self, tau: ArrayLike, *, rate_hz: float) -> Controller:
        """Return the same controller with a torque fed forward.

        Parameters
        ----------
        tau : (n_samples, n_dof) array
            Torque (N.m or N), joint side, the first sample at time 0.
        rate_hz : float
            Samples per second.

        Raises
        ------
        ControllerError
            For a wrong shape or rate, or a NaN.
        """
        values = real_array("tau", tau, ControllerError)
        if values.ndim != 2 or values.shape[1] != self.n_dof or not len(values):
            raise ControllerError(f"tau must have shape (n_samples, {self.n_dof}), got {values.shape}")
        made = replace(self, feedforward=(float(rate_hz), values))
        made.core  # noqa: B018 - a wrong one must fail here
        return made

    def fed_forward(self, times: Array) -> Array:
        """Return the feed-forward torque at times, (n_times, n_dof); zero without one."""
        if self.feedforward is None:
            return np.zeros((len(times), self.n_dof))
        rate, values = self.feedforward
        clock = np.arange(len(values)) / rate
        return np.column_stack([np.interp(times, clock, column) for column in values.T])

    def of_joints(self, joints: Sequence[int]) -> Controller:
        """Return the laws of some joints, from 0."""
        at, digital, forward = list(joints), self.digital, self.feedforward
        if digital is not None and len(digital.resolution) > 1:
            digital = replace(digital, resolution=tuple(digital.resolution[joint] for joint in at))
        return replace(
            self,
            laws=self.laws[at],
            gain=self.gain[at],
            saturation=self.saturation[at],
            digital=digital,
            feedforward=None if forward is None else (forward[0], forward[1][:, at]),
        )

    @cached_property
    def core(self) -> _core.Controller:
        """The controller of the numerical core."""
        rows = np.column_stack([self.laws, self.saturation, self.gain]).tolist()
        digital = None
        if self.digital is not None:
            d = self.digital
            resolution = d.resolution or (0.0,) * self.n_dof
            if len(resolution) not in (1, self.n_dof):
                raise ControllerError(
                    f"resolution needs {self.n_dof} entries, one per joint, got {len(resolution)}"
                )
            resolution = resolution * (self.n_dof if len(resolution) == 1 else 1)
            digital = (d.sample_time_s, d.delay_samples, d.smoothing, resolution)
        with CoreErrorsAs(ControllerError):
            return _core.Controller(rows, digital, self.feedforward)

    @classmethod
    def _checked(
        cls,
        kind: str,
        columns: list[Array],
        gain: ArrayLike,
        saturation: ArrayLike,
        digital: Digital | None,
    ) -> Controller:
        laws = np.column_stack(columns)
        g, limit = _columns(gain=gain, saturation=saturation, n=len(laws), infinite=("saturation",))
        made = cls(kind=kind, laws=laws, gain=g, saturation=limit, digital=digital)
        made.core  # noqa: B018 - a wrong one must fail here
        return made


def _columns(*, n: int | None = None, infinite: tuple[str, ...] = (), **values: ArrayLike) -> list[Array]:
    """Return one column per joint of each value; a number is for all joints."""
    arrays = {name: real_array(name, value, ControllerError) for name, value in values.items()}
    for name, array in arrays.items():
        if array.ndim > 1:
            raise ControllerError(f"{name} needs one number per joint, got an array of shape {array.shape}")
        if np.isnan(array).any() or (name not in infinite and np.isinf(array).any()):
            raise ControllerError(f"{name} must be finite, got {array.tolist()}")
    n = n or max(array.size for array in arrays.values())
    for name, array in arrays.items():
        if array.size not in (1, n):
            raise ControllerError(f"{name} needs {n} numbers, one per joint, got {array.size}")
    return [np.broadcast_to(array.reshape(-1), (n,)).astype(np.float64) for array in arrays.values()]
