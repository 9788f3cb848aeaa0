"""Windows of a recording: the one place where a log is cut, aligned, filtered, differentiated and trimmed.

Each window is treated by itself, so samples outside it (a stop, a tool change) have no influence. Tested in
``tests/test_identify.py`` and ``tests/test_windows.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import FitError, SignalError
from ..log.recording import Recording
from ..loop.closed_loop import ClosedLoop
from .align import Shift, align, hold_samples
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
