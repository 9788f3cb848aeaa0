"""A recording: logged motion and torque of one run, joint side, SI units. Tested in ``tests/test_recording.py``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from operator import index
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import LARGEST_POSITION, Array, real_array
from .._tools.notebook import Brief
from .._tools.pickling import Pickled
from .._tools.settings import one_of, positive
from ..errors import RecordingError
from .data_format import Windows
from .sampling import MINIMUM_SAMPLES, check_time

Role = Literal["fit", "held-out"]
ROLES: tuple[Role, ...] = ("fit", "held-out")
"""Roles of a recording: fitted, or held out for validation."""
OWN = ("offsets", "friction")
"""Groups of parameters that a recording may have for itself."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Recording(Pickled, Brief):
    """Motion and torque of one run.

    Tested in ``tests/test_recording.py``.

    Attributes
    ----------
    name
        Name in messages and tables.
    t
        (n_samples,) time stamps in s.
    q
        (n_samples, n_dof) joint positions in rad or m; NaN throughout without measured ones.
    dq
        (n_samples, n_dof) measured joint velocities in rad/s or m/s, or None; they replace differences of the positions.
    tau
        (n_samples, n_dof) joint torques in N.m or forces in N, or None.
    external
        (n_samples, n_dof) external torques (N.m) or forces (N) on the joints, or None: the model explains their sum with `tau`.
    rate_hz
        Sampling rate.
    temperature
        (n_samples, n_dof) temperatures of the joints in degC, or None; one column stands for all joints.
    q_ref
        (n_samples, n_dof) reference positions in rad or m, or None.
    role
        "fit", or "held-out" for a recording used for validation only.
    windows
        (start, stop) sample slices that are used, in order and without overlap; the whole record by default.
    has_positions
        Whether positions were measured. A log without them needs reference positions and can only be identified by DIDIM.
    digests
        SHA-256 of each file read, by file name.
    notes
        Sentences on changes made while reading, such as resampled time stamps.
    payload
        Name of the payload on the flange; "none" for none.
    own
        Parameters that only this recording has: "offsets", "friction".
    kp
        Gains of the position servos in this recording, one per joint (N.m/rad or N/m); None for those of the controller.
    drives
        (n_dof, n_dof) reduction matrix R of a recording whose drive gains are unknown: `tau` then is ``R^T i`` of the motor
        currents i in A, joint side; None where `tau` is a torque.
    origin
        Source of the recording for a result: the tables of the experiment file with the factors to SI, and the reduction matrix
        of a log on the motor side; empty for arrays.

    Raises
    ------
    RecordingError
        On arrays of the wrong shape or length, transposed, too short, or not finite, on time stamps that are
        uneven or contradict the rate (`didim.log.sampling.check_time`), and on wrong windows.
    """

    name: str = "recording"
    t: Array
    q: Array
    dq: Array | None = None
    tau: Array | None = None
    external: Array | None = None
    temperature: Array | None = None
    rate_hz: float
    q_ref: Array | None = None
    role: Role = "fit"
    windows: Windows = ()
    has_positions: bool = True
    digests: Mapping[str, str] = field(default_factory=dict)
    origin: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    payload: str = "none"
    own: tuple[str, ...] = ()
    kp: tuple[float, ...] | None = None
    drives: tuple[tuple[float, ...], ...] | None = None

    def __post_init__(self) -> None:
        one_of(f"{self.name}: role", self.role, ROLES, RecordingError)
        object.__setattr__(self, "own", tuple(self.own))
        for block in self.own:
            one_of(f"{self.name}: own", block, OWN, RecordingError)
        object.__setattr__(self, "rate_hz", positive(f"{self.name}: rate_hz", self.rate_hz, RecordingError))
        if self.has_positions:
            q = self._matrix("q", self.q)
        elif self.q_ref is None:
            raise RecordingError(f"{self.name}: without measured positions there must be reference positions")
        else:
            q = np.full_like(self._matrix("q_ref", self.q_ref), np.nan)
        if (np.abs(q) > LARGEST_POSITION).any():
            sample, joint = np.argwhere(np.abs(q) > LARGEST_POSITION)[0]
            raise RecordingError(
                f"{self.name}: q of joint {joint + 1} is {q[sample, joint]:g} at sample {sample}, where a position is at most "
                f"{LARGEST_POSITION:g} rad or m; check its unit"
            )
        n_samples = len(q)
        if n_samples < MINIMUM_SAMPLES:
            raise RecordingError(
                f"{self.name}: at least {MINIMUM_SAMPLES} samples are needed, got {n_samples}"
            )
        t = np.array(real_array(f"{self.name}: t", self.t, RecordingError))
        if t.shape != (n_samples,):
            raise RecordingError(f"{self.name}: t must have shape ({n_samples},) as q has, got {t.shape}")
        bad = np.flatnonzero(~np.isfinite(t))
        if bad.size:
            raise RecordingError(f"{self.name}: t is {t[bad[0]]} at sample {bad[0]}")
        check_time(t, self.rate_hz, self.name)
        for key, value in (("t", t), ("q", q)):
            self._set(key, value)
        for key in ("dq", "tau", "external", "temperature", "q_ref"):
            value = getattr(self, key)
            if value is None:
                continue
            if key == "temperature" and np.size(value) == n_samples:
                value = np.tile(np.reshape(value, (n_samples, 1)), q.shape[1])
            value = self._matrix(key, value)
            if value.shape != q.shape:
                raise RecordingError(f"{self.name}: {key} and q differ in shape, {value.shape} and {q.shape}")
            self._set(key, value)
        object.__setattr__(self, "windows", self._windows(n_samples))
        if self.drives is not None:
            if self.external is not None:
                raise RecordingError(
                    f"{self.name}: external torques need torques, and these are currents with unknown gains"
                )
            drives = tuple(tuple(float(value) for value in row) for row in self.drives)
            n = q.shape[1]
            if np.shape(drives) != (n, n) or not abs(np.linalg.det(drives)) > 0.0:
                raise RecordingError(f"{self.name}: drives must be a regular matrix of {n} rows and columns")
            object.__setattr__(self, "drives", drives)
        object.__setattr__(self, "digests", dict(self.digests))
        object.__setattr__(self, "origin", dict(self.origin))

    def measured_positions(self) -> Array:
        """Return the measured positions, (n_samples, n_dof).

        Raises
        ------
        RecordingError
            Without any.
        """
        if not self.has_positions:
            raise RecordingError(
                f"recording '{self.name}' has no measured positions ([recording.position]): only DIDIM with a recorded "
                "reference does without"
            )
        return self.q

    @classmethod
    def from_arrays(
        cls,
        q: ArrayLike | None,
        tau: ArrayLike | None = None,
        *,
        rate_hz: float,
        name: str = "recording",
        q_ref: ArrayLike | None = None,
        role: Role = "fit",
    ) -> Recording:
        """Make a recording from arrays: joint side, SI, (n_samples, n_dof).

        `q` is None for a log with reference positions only.
        """
        rate = positive(f"{name}: rate_hz", rate_hz, RecordingError)
        if q is None:
            if q_ref is None:
                raise RecordingError(f"{name}: give q, or q_ref for a log without measured positions")
            positions = np.full(np.shape(q_ref), np.nan)
        else:
            positions = real_array(f"{name}: q", q, RecordingError)
        return cls(
            name=name,
            t=clock(len(np.atleast_1d(positions)), rate),
            q=positions,
            tau=None if tau is None else real_array(f"{name}: tau", tau, RecordingError),
            rate_hz=rate,
            q_ref=None if q_ref is None else real_array(f"{name}: q_ref", q_ref, RecordingError),
            role=role,
            has_positions=q is not None,
        )

    @property
    def driving(self) -> Array | None:
        """Torques that drive the robot (N.m or N): those of the motors, and external ones where they were measured."""
        return self.tau if self.tau is None or self.external is None else self.tau + self.external

    def with_gains(self, gains: Array) -> Recording:
        """Return the recording with torques in place of currents, by gains (n_dof,).

        A recording with torques is returned itself.
        """
        if self.drives is None or self.tau is None:
            return self
        reduction = np.array(self.drives)
        currents = self.tau @ np.linalg.inv(reduction)
        return replace(self, tau=(currents * gains) @ reduction, drives=None)

    def _windows(self, n_samples: int) -> Windows:
        try:
            windows = tuple((index(start), index(stop)) for start, stop in self.windows)
        except (TypeError, ValueError):
            raise RecordingError(
                f"{self.name}: windows must be pairs of sample numbers (start, stop), got {self.windows!r}"
            ) from None
        end = 0
        for start, stop in windows:
            if not end <= start < stop <= n_samples:
                raise RecordingError(
                    f"{self.name}: the window of samples {start} to {stop} is empty, overlaps another one or "
                    f"leaves the record of {n_samples} samples"
                )
            end = stop
        return windows or ((0, n_samples),)

    def _set(self, key: str, value: Array) -> None:
        value.flags.writeable = False
        object.__setattr__(self, key, value)

    def _matrix(self, key: str, value: Array) -> Array:
        # A copy, so the caller's array stays writable.
        matrix = np.array(real_array(f"{self.name}: {key}", value, RecordingError), order="C")
        if matrix.ndim != 2:
            raise RecordingError(f"{self.name}: {key} must have shape (n_samples, n_dof), got {matrix.shape}")
        if matrix.shape[1] > max(matrix.shape[0], 12):
            raise RecordingError(
                f"{self.name}: {key} must have shape (n_samples, n_dof), got {matrix.shape}; transpose it?"
            )
        if not np.isfinite(matrix).all():
            sample, joint = np.argwhere(~np.isfinite(matrix))[0]
            raise RecordingError(
                f"{self.name}: {key} of joint {joint + 1} is {matrix[sample, joint]} at sample {sample}"
            )
        return matrix


def clock(n_samples: int, rate_hz: float) -> Array:
    """Time stamps from zero, in s."""
    with np.errstate(over="ignore"):  # reported by Recording
        return np.arange(n_samples) / rate_hz
