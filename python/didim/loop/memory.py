"""Initial state of a controller: its integrators, delayed outputs, and measured positions.

A log rarely begins when its controller is switched on: integrators already balance gravity, and a digital controller has
delayed outputs. Tested in ``tests/test_controller_start.py`` and in ``rust/tests/closed_loop/memory.rs``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .._tools.arrays import Array, real_array
from .._tools.settings import one_of
from ..errors import SimulationError
from .controller import Controller
from .reference import Reference

MemoryStart = Literal["zero", "balance", "torque", "integrators"]

AVERAGED_S = 0.05
"""Time (s) over which the integrators of a log are averaged, so that the noise of a single sample does not set them."""
LEAST_AVERAGED = 5
"""Smallest number of averaged samples."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerMemory:
    """State of a controller at time 0, joint side, SI units.

    Tested in ``tests/test_controller_start.py``.

    Attributes
    ----------
    start : {"zero", "balance", "torque", "integrators"}
        Initial integrators: "zero"; "balance", with which the law without errors gives the torque of gravity and friction at
        the initial velocity (static balance at rest; with feed-forward also the inertial torque of the reference); "torque",
        with which the law gives the torques in `values`; or "integrators", the `values` themselves. Each candidate has its own
        balance.
    values : tuple of float
        Torques (N.m or N) for "torque"; integrators ``z`` for "integrators" (rad.s or m.s for a PID, rad or m for a cascade). One
        per joint.
    outputs : (delay_samples, n_dof) array or None
        Delayed outputs of a digital controller (N.m or N), the next first. By default the torque of `start`, or zero.
    positions : (n, n_dof) array or None
        Previously measured positions of a digital controller (rad or m), one row for each weight of its smoothing, the newest
        first. By default those of a motion at the initial velocity.

    Raises
    ------
    SimulationError
        For an unknown start, and for numbers that are not finite.
    """

    start: MemoryStart = "zero"
    values: tuple[float, ...] = ()
    outputs: ArrayLike | None = None
    positions: ArrayLike | None = None

    def __post_init__(self) -> None:
        one_of("start", self.start, ("zero", "balance", "torque", "integrators"), SimulationError)
        for key in ("values", "outputs", "positions"):
            given = getattr(self, key)
            if given is None:
                continue
            values = real_array(key, given, SimulationError)
            if not np.isfinite(values).all():
                raise SimulationError(f"{key} of a controller's memory must be finite, got {values.tolist()}")
            if key == "values" and values.ndim != 1:
                raise SimulationError(
                    f"values of a controller's memory must be a list, one per joint, got {given!r}"
                )
            if key != "values" and values.ndim != 2:
                raise SimulationError(
                    f"{key} of a controller's memory need one column per joint, got shape {values.shape}"
                )
            object.__setattr__(self, key, tuple(values.tolist()) if key == "values" else values)

    def checked(self, controller: Controller) -> ControllerMemory:
        """Return itself, if it fits a controller.

        Raises
        ------
        SimulationError
            For a wrong number of joints or of rows.
        """
        n, digital = controller.n_dof, controller.digital
        if self.start in ("torque", "integrators") and len(self.values) != n:
            raise SimulationError(
                f"values of a controller's memory need {n} numbers, one per joint, got {len(self.values)}"
            )
        rows = (0, 0) if digital is None else (digital.delay_samples, len(digital.smoothing))
        for key, count in zip(("outputs", "positions"), rows, strict=True):
            given = getattr(self, key)
            if given is not None and given.shape != (count, n):
                raise SimulationError(
                    f"{key} of this controller's memory need shape ({count}, {n}), got {given.shape}"
                )
        return self

    def of_joints(self, joints: Sequence[int]) -> ControllerMemory:
        """Return the memory of some joints, from 0."""
        at = list(joints)
        outputs, positions = (
            None if part is None else np.asarray(part)[:, at] for part in (self.outputs, self.positions)
        )
        values = tuple(self.values[joint] for joint in at) if self.values else ()
        return replace(self, values=values, outputs=outputs, positions=positions)

    @property
    def core(self) -> tuple[str, list[float], list[float] | None, list[float] | None]:
        """The memory in the format of the core."""
        outputs, positions = (
            None if part is None else np.asarray(part, dtype=np.float64).ravel().tolist()
            for part in (self.outputs, self.positions)
        )
        return self.start, list(self.values), outputs, positions


ZERO = ControllerMemory()
"""Memory of a controller that is switched on at time 0."""
BALANCE = ControllerMemory(start="balance")
"""Memory of a controller that already held the robot at time 0."""


def memory_of_log(
    controller: Controller,
    reference: Reference,
    rate_hz: float,
    q: Array,
    tau: Array,
    start: tuple[ArrayLike, ArrayLike] | None = None,
) -> ControllerMemory:
    """Return the memory with which a controller reproduces the measured torques.

    Each sample of the log gives the integrator ``z = (tau - the law without integral) / gain``. Less the integral of the errors
    since time 0, it is an estimate for time 0; the mean over the first `AVERAGED_S` is used. Samples at the limit of the drive
    contain no information on the integrator and are ignored.

    Parameters
    ----------
    controller : Controller
        Controller with its laws.
    reference : Reference
        Reference with time 0 at the first sample.
    rate_hz : float
        Samples per second.
    q, tau : (n_samples, n_dof) arrays
        Measured positions (rad or m) and torques of the drives (N.m or N), joint side.
    start : (q, dq), optional
        Initial state of the simulation; that of the reference by default.

    Returns
    -------
    ControllerMemory
        Memory with the first torque of each law, and the delayed outputs.
    """
    digital = controller.digital
    period = 1.0 / rate_hz if digital is None else digital.sample_time_s
    delay = 0 if digital is None else digital.delay_samples
    possible = math.floor((len(q) - 1) / rate_hz / period + 1e-9) + 1 - delay
    count = max(1, min(max(LEAST_AVERAGED, math.ceil(AVERAGED_S / period)), possible))
    times: Array = np.arange(count, dtype=np.float64) * period
    q_ref, dq_ref, ddq_ref = reference.at(times)
    here, velocity, _ = Reference.sampled(q, rate_hz=rate_hz).at(np.minimum(times, (len(q) - 1) / rate_hz))
    begin_q, begin_dq = (
        (q_ref[0], dq_ref[0]) if start is None else (np.asarray(part, dtype=np.float64) for part in start)
    )
    first_dq = begin_dq
    if digital is not None:
        weights = np.asarray(digital.smoothing)
        differences = np.diff(np.concatenate([[0.0], weights, [0.0]])) / period
        # As in the core, the default is a motion at the initial velocity.
        back = -period * np.arange(len(weights), 0, -1)[:, None] * begin_dq
        seen = np.concatenate([here[0] + back, here])
        lags = [seen[len(weights) - lag :][:count] for lag in range(len(differences))]
        velocity = np.tensordot(differences, lags, axes=1)
        first_dq = differences[0] * begin_q + differences[1:] @ (begin_q + back)[::-1]
    p, d, i, a, w, by_position, by_velocity = controller.laws.T
    gain = controller.gain
    fed = controller.fed_forward(times) / gain
    e, v = q_ref - here, w * dq_ref - velocity
    growth = by_position * e + by_velocity * v
    added = period * (growth[:-1] if digital is not None else 0.5 * (growth[1:] + growth[:-1]))
    grown = np.concatenate([np.zeros((1, len(p))), np.cumsum(added, axis=0)])
    # The torque of a controller sample is in the first record at or after its time.
    records = np.ceil(np.arange(count + delay) * period * rate_hz - 1e-6).astype(int).clip(0, len(tau) - 1)
    wanted = tau[records[delay:]] / gain
    free = p * e + d * v + a * ddq_ref + fed
    integrating = i != 0.0
    begun = np.where(integrating, wanted - free, 0.0) / np.where(integrating, i, 1.0) - grown
    inside = np.abs(wanted) < controller.saturation * (1.0 - 1e-9)
    inside[:, ~inside.any(axis=0)] = True  # a joint that is always at its limit starts at the limit
    z = np.sum(np.where(inside, begun, 0.0), axis=0) / inside.sum(axis=0)
    first = p * (q_ref[0] - begin_q) + d * (w * dq_ref[0] - first_dq) + i * z + a * ddq_ref[0] + fed[0]
    return ControllerMemory(
        start="torque",
        values=tuple((gain * first).tolist()),
        outputs=tau[records[:delay]] if delay else None,
    )


def remembers(controller: Controller) -> bool:
    """Return whether a controller has an initial state: an integrator, or delayed outputs."""
    late = controller.digital is not None and controller.digital.delay_samples > 0
    return late or bool(np.any(controller.laws[:, 2] != 0.0))
