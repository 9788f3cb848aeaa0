"""Windows of a recording: the one place where a log is cut, aligned, filtered, differentiated and trimmed.

Each window is treated by itself, so samples outside it (a stop, a tool change) have no influence. Tested in
``tests/test_identify.py`` and ``tests/test_windows.py``.

A digital controller holds each output for its sample time T. The motion responds to this staircase, which lags the logged
output by half a step: the model torque from differentiated positions is the mean of the steps before and after a sample. The
logged torque is therefore early by T/2 relative to measured motion, or by half a sample if the log is faster than the
controller. Simulated motion needs no such shift, because its accelerations result from the torque that starts at the sample.
Tested in ``tests/test_delay.py`` and ``tests/test_hold.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from .._tools.arrays import Array
from .._tools.settings import real_number
from .._tools.words import counted
from ..errors import FitError, SignalError
from ..log.recording import Recording
from ..loop.closed_loop import ClosedLoop
from .filters import differentiate
from .noise import encoder_step, white_noise
from .processing import SignalProcessing
from .spikes import without_spikes
from .steps import between_steps

Along = Literal["measured", "simulated", "outputs"]
"""Motion of a window: that of the log, filtered; that of its closed loop; or raw outputs, which need no torque."""
NOTHING: Array = np.zeros((0, 0))
"""Motion of a window along which nothing was simulated yet, and signals that were not measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Window:
    """A window of a log: what was logged in it, and the motion along which the model is written.

    Attributes
    ----------
    name : str
        Name of its recording.
    place : str
        Recording and window, for messages.
    recording, number : int
        Number of the recording, from 0, among those of the experiment, and of the window in it.
    rate_hz : float
        Rate of the recording.
    tau : ndarray, shape (n_samples, n_dof)
        Measured torque (N.m or N, joint side), moved back by its delay, not filtered; currents (A) where drive gains are unknown.
    q, dq, ddq : ndarray, shape (n_samples, n_dof)
        Position, velocity and acceleration of the joints beside `tau`, SI units.
    temperature : ndarray, shape (n_samples, n_dof), or None
        Temperature of the joints (degC), if recorded.
    begin : int
        First sample of the whole cut in the recording.
    kept : slice
        Samples of the whole cut that these are.
    measured, logged : ndarray, shape (n_cut, n_dof)
        Positions and torques of the whole cut as they were measured; empty where there are none.
    closed_loop : ClosedLoop or None
        Closed loop that simulates the whole cut.
    drives : ndarray, shape (n_dof, n_dof), or None
        Reduction matrix of the motors whose currents stand in place of the torques.
    """

    name: str
    place: str
    recording: int = 0
    number: int = 0
    rate_hz: float
    begin: int = 0
    tau: Array
    q: Array = field(default_factory=lambda: NOTHING)
    dq: Array = field(default_factory=lambda: NOTHING)
    ddq: Array = field(default_factory=lambda: NOTHING)
    temperature: Array | None = None
    kept: slice = field(default_factory=lambda: slice(None))
    measured: Array = field(default_factory=lambda: NOTHING)
    logged: Array = field(default_factory=lambda: NOTHING)
    closed_loop: ClosedLoop | None = None
    drives: Array | None = None

    def part(self, rows: slice) -> Window:
        """Return some of the samples; the whole cut is no longer known."""
        signals = {key: getattr(self, key) for key in ("q", "dq", "ddq", "tau", "temperature")}
        kept: dict[str, Any] = {
            key: np.ascontiguousarray(signal[rows]) for key, signal in signals.items() if signal is not None
        }
        return replace(self, **kept, kept=slice(None), measured=NOTHING, logged=NOTHING)

    def along(self, motion: Sequence[Array]) -> Window:
        """Return the window along another motion ``q dq ddq`` beside its torques, (n_samples, n_dof) each."""
        q, dq, ddq = (np.ascontiguousarray(values) for values in motion)
        return replace(self, q=q, dq=dq, ddq=ddq, temperature=None)

    def moved_back(self, delay: Shift, signal: SignalProcessing) -> Window:
        """Return the window with what was logged moved back by a delay (samples) and trimmed.

        Raises
        ------
        FitError
            When nothing is left of it.
        """
        with at_place(self.place):
            (index,), tau = align([np.arange(len(self.logged), dtype=np.float64)], self.logged, delay)
        start, stop = signal.trim_start, len(tau) - signal.trim_end
        if stop <= start:
            raise FitError(
                f"{self.place}: trimming {signal.trim_start} and {signal.trim_end} samples leaves nothing of "
                f"{counted(len(tau), 'sample')}"
            )
        first = int(index[0])
        kept = slice(first + start, first + stop)
        return replace(self, tau=np.ascontiguousarray(tau[start:stop]), kept=kept)

    @property
    def loop(self) -> ClosedLoop:
        """Closed loop of a window that can be simulated."""
        assert self.closed_loop is not None
        return self.closed_loop

    @cached_property
    def noise(self) -> Array:
        """White noise of the torques, (n_dof,), as `white_noise`."""
        return white_noise(self.tau)


def windows_of(
    recording: Recording,
    signal: SignalProcessing,
    *,
    number: int = 0,
    along: Along = "measured",
    delay: Shift = 0.0,
    hold_s: float = 0.0,
    spans: Sequence[tuple[int, int]] | None = None,
    loop: Callable[[tuple[int, int]], ClosedLoop] | None = None,
) -> list[Window]:
    """Cut a recording, move its torques back, and filter, differentiate and trim each window by itself.

    Parameters
    ----------
    recording : Recording
        Must have torques, unless `along` is "outputs".
    signal : SignalProcessing
        Filter and trimming.
    number : int
        Number of the recording in the experiment, from 0.
    along : {"measured", "simulated", "outputs"}
        Whether the motion is filtered, or comes later from `loop`.
    delay : float or sequence of float
        Delay of the recorded torque (samples), by which it is moved back: of all joints, or of each.
    hold_s : float
        Sample time (s) of a digital controller whose hold is compensated (`hold_samples`).
    spans : sequence of (start, stop), optional
        Samples of the windows; those of the recording by default.
    loop : callable, optional
        Function that returns the closed loop of a span.

    Raises
    ------
    FitError
        Without torques, or when trimming leaves nothing of a window.
    SignalError
        When the filter cannot be applied; the message names recording and window.

    Notes
    -----
    ``test_identify.py`` filters windows each by itself, and reads the messages.
    """
    torque = recording.tau if along == "outputs" else recording.driving
    if torque is None and along != "outputs":
        raise FitError(f"recording '{recording.name}' has no torques, which this method needs")
    measured = (
        None if along == "simulated" and not recording.has_positions else recording.measured_positions()
    )
    hold = hold_samples(hold_s, recording.rate_hz)
    shift = tuple(each - hold for each in delay) if isinstance(delay, Sequence) else delay - hold
    step = (
        None
        if along != "measured" or recording.dq is not None or measured is None
        else encoder_step(measured)
    )
    made = []
    for count, span in enumerate(recording.windows if spans is None else spans):
        cut, where = slice(*span), f"recording '{recording.name}'"
        if tuple(span) != (0, len(recording.q)):
            where += f", window of samples {span[0]} to {span[1]}"
        with at_place(where):
            motion = motion_of(recording, span, signal, step) if along == "measured" else None
        logged = np.zeros(recording.q[cut].shape) if torque is None else without_spikes(torque[cut], signal)
        window = Window(
            name=recording.name,
            place=where,
            recording=number,
            number=count,
            rate_hz=recording.rate_hz,
            begin=span[0],
            tau=logged,
            measured=NOTHING if measured is None else np.ascontiguousarray(measured[cut]),
            logged=logged,
            drives=None if recording.drives is None else np.array(recording.drives),
            closed_loop=None if loop is None else loop(span),
        ).moved_back(shift, signal)
        if motion is not None:
            window = window.along([values[window.kept] for values in motion])
            if recording.temperature is not None:
                warmth = np.ascontiguousarray(recording.temperature[cut][window.kept])
                window = replace(window, temperature=warmth)
        made.append(window)
    return made


def motion_of(
    recording: Recording, window: tuple[int, int], signal: SignalProcessing, step: Array | None = None
) -> tuple[Array, Array, Array]:
    """Filter a window, and return ``q dq ddq``; measured velocities replace differences of the positions.

    Positions that lie on the grid of an encoder are first smoothed between its steps, `step` (n_dof,), by default those that the
    whole recording shows (`encoder_step`).

    Raises
    ------
    SignalError
        When the filter cannot be applied.
    """
    start, stop = window
    every, rate = recording.measured_positions(), recording.rate_hz
    if recording.dq is not None:
        return differentiate(every[start:stop], rate, signal, recording.dq[start:stop])
    grid = encoder_step(every) if step is None else step
    return differentiate(between_steps(every[start:stop], rate, signal, grid), rate, signal)


def stretches(parts: Sequence[Window], most_samples: int) -> list[Window]:
    """Return the parts of a log, or three evenly spaced stretches of each if it has more than `most_samples`.

    Parameters
    ----------
    parts : sequence of Window
        Windows of a log.
    most_samples : int
        Approximate number of samples of all stretches together.
    """
    total = sum(len(part.q) for part in parts)
    if total <= most_samples:
        return list(parts)
    chosen = []
    for part in parts:
        length = max(int(len(part.q) * most_samples / total / 3), 1)
        if 3 * length >= len(part.q):
            chosen.append(part)
            continue
        starts = np.linspace(0, len(part.q) - length, 3).astype(int).tolist()
        chosen += [part.part(slice(start, start + length)) for start in starts]
    return chosen


@contextmanager
def at_place(where: str) -> Iterator[None]:
    """Prefix the message of an error with recording and window."""
    try:
        yield
    except (SignalError, FitError) as error:
        raise type(error)(f"{where}: {error}") from None


Shift = float | Sequence[float]
"""Shift of the torques towards earlier samples, in samples: of all joints, or of each."""

CUBIC = (-1, 0, 1, 2)
"""Offsets of the samples that cubic interpolation uses: one before, two after."""


@dataclass(frozen=True, kw_only=True)
class DelaySettings:
    """Compensation of a torque delay.

    Parameters
    ----------
    compensate_samples : float, sequence of float, "hold" or "estimate"
        Delay in samples of the recording, of all joints or of each, by which the torque is moved back (fractions are
        interpolated; positive: the torque was recorded late). "hold", the default, compensates for the hold of the experiment's
        digital controller along measured motion, if there is one. "estimate" adds an estimated delay.

    Raises
    ------
    FitError
        For a value that is none of these.
    """

    compensate_samples: float | Sequence[float] | Literal["hold", "estimate"] = "hold"

    def __post_init__(self) -> None:
        value = self.compensate_samples
        if isinstance(value, str) and value in ("hold", "estimate"):
            return
        values: Any = value if isinstance(value, Sequence | np.ndarray) else (value,)
        numbers = tuple(map(real_number, values))
        if not numbers or not all(map(math.isfinite, numbers)):
            raise FitError(
                f"compensate_samples must be a number, one per joint, 'hold' or 'estimate', got {value!r}"
            )
        if values is value:
            object.__setattr__(self, "compensate_samples", numbers)


def hold_samples(sample_time_s: float, rate_hz: float) -> float:
    """Return the lead of a held torque relative to measured motion, in samples of the log.

    Parameters
    ----------
    sample_time_s : float
        Sample time of the digital controller (s); zero for a continuous one.
    rate_hz : float
        Rate of the log.

    Returns
    -------
    float
        Half the sample time, or half a sample if the log is faster than the controller.

    Notes
    -----
    ``test_hold.py`` fits logs slower and faster than the controller.
    """
    return 0.5 * min(sample_time_s * rate_hz, 1.0)


def align(motion: Sequence[Array], tau: Array, delay_samples: Shift) -> tuple[tuple[Array, ...], Array]:
    """Move the torque back by its delay, and drop the samples that then lack a torque.

    Parameters
    ----------
    motion : sequence of ndarray, shape (n_samples, ...)
        Position, velocity, acceleration.
    tau : ndarray, shape (n_samples, n_dof)
        Torque as recorded.
    delay_samples : float or sequence of float
        Positive when the torque was recorded late; one for all joints, or one for each. Fractions are interpolated by a
        cubic through four samples.

    Returns
    -------
    motion : tuple of ndarray
        Shortened.
    tau : ndarray
        ``tau[k]`` belongs to ``motion[k]``.

    Raises
    ------
    FitError
        When the record is not longer than the delay, or the number of delays is not that of the joints.

    Notes
    -----
    ``test_delay.py`` moves a cubic exactly, joints by different delays too.
    """
    delays = tuple(delay_samples) if isinstance(delay_samples, Sequence) else (delay_samples,) * tau.shape[1]
    if len(delays) != tau.shape[1]:
        raise FitError(f"compensate_samples has {counted(len(delays), 'number')} for {tau.shape[1]} joints")
    if not any(delays):
        return tuple(motion), tau
    moves = [_move(delay) for delay in delays]
    n_samples = tau.shape[0]
    # Motion samples k for which every tau[k + whole + offset] exists.
    first = max(0, *(-(whole + offsets[0]) for whole, offsets, _ in moves))
    last = min(n_samples, *(n_samples - (whole + offsets[-1]) for whole, offsets, _ in moves))
    if last <= first:
        raise FitError(
            f"a record of {counted(n_samples, 'sample')} is too short to compensate a delay of "
            f"{max(delays, key=abs):g} samples"
        )
    moved = np.zeros((last - first, *tau.shape[1:]))
    common = len(set(delays)) == 1
    for joint, (whole, offsets, weights) in enumerate(moves[:1] if common else moves):
        columns = slice(None) if common else joint
        for offset, weight in zip(offsets, weights, strict=True):
            moved[:, columns] += weight * tau[first + whole + offset : last + whole + offset, columns]
    return tuple(values[first:last] for values in motion), moved


def _move(delay: float) -> tuple[int, tuple[int, ...], tuple[float, ...]]:
    """Return the whole samples of a delay, and offsets and weights for the interpolation of its fraction."""
    whole = math.floor(delay)
    fraction = delay - whole
    return (whole, CUBIC, _lagrange(fraction)) if fraction else (whole, (0,), (1.0,))


def _lagrange(fraction: float) -> tuple[float, ...]:
    """Return the weights of the samples at -1, 0, 1, 2 for the value at ``fraction``."""
    return tuple(
        math.prod((fraction - other) / (node - other) for other in CUBIC if other != node) for node in CUBIC
    )
