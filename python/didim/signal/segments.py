"""Windows of a recording, each filtered, differentiated and trimmed separately.

Samples outside a window (a stop, a tool change) have no influence. Tested in ``tests/test_identify.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import FitError, SignalError
from ..log.recording import Recording
from .align import Shift, align
from .filters import differentiate
from .noise import encoder_step, white_noise
from .processing import SignalProcessing
from .spikes import without_spikes
from .steps import between_steps


@dataclass(frozen=True, kw_only=True)
class Segment:
    """Motion and torque of one window, filtered and trimmed, at the rate of the recording.

    Attributes
    ----------
    name : str
        Name of its recording.
    place : str
        Recording and window, for messages.
    rate_hz : float
        Rate of the recording.
    recording, window : int
        Number of the recording, from 0, among those of the experiment, and of the window in it.
    q, dq, ddq : ndarray, shape (n_samples, n_dof)
        Joint position, velocity and acceleration, SI units.
    tau : ndarray, shape (n_samples, n_dof)
        Measured torque, N.m or N, joint side; not filtered.
    temperature : ndarray, shape (n_samples, n_dof), or None
        Temperature of the joints (degC), if recorded.
    """

    name: str
    place: str
    rate_hz: float
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    recording: int = 0
    window: int = 0
    temperature: Array | None = None

    def cut(self, rows: slice) -> Segment:
        """Return some of the samples."""
        signals = {key: getattr(self, key) for key in ("q", "dq", "ddq", "tau", "temperature")}
        kept: dict[str, Any] = {
            key: np.ascontiguousarray(signal[rows]) for key, signal in signals.items() if signal is not None
        }
        return replace(self, **kept)

    @cached_property
    def noise(self) -> Array:
        """White noise of the torques, (n_dof,), as `white_noise`."""
        return white_noise(self.tau)


def segments(
    recording: Recording, signal: SignalProcessing, delay_samples: Shift = 0.0, *, number: int = 0
) -> list[Segment]:
    """Filter, differentiate and trim each window of a recording.

    Parameters
    ----------
    recording : Recording
        Must have torques.
    signal : SignalProcessing
        Filter and trimming.
    delay_samples : float
        Delay of the recorded torque, by which it is moved back.
    number : int
        Number of the recording in the experiment, from 0.

    Returns
    -------
    list of Segment
        One per window.

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
    torque = recording.driving
    if torque is None:
        raise FitError(f"recording '{recording.name}' has no torques, which this method needs")
    step = None if recording.dq is not None else encoder_step(recording.measured_positions())
    parts = []
    for window, (start, stop) in enumerate(recording.windows):
        where = place_of(recording, (start, stop))
        with at_place(where):
            measured: tuple[Array, ...] = motion_of(recording, (start, stop), signal, step)
            if recording.temperature is not None:
                measured = (*measured, recording.temperature[start:stop])
            motion, tau = align(measured, without_spikes(torque[start:stop], signal), delay_samples)
        part = trimmed(recording, where, signal, motion, tau)
        parts.append(replace(part, recording=number, window=window))
    return parts


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


def trimmed(
    recording: Recording, where: str, signal: SignalProcessing, motion: Sequence[Array], tau: Array
) -> Segment:
    """Return the segment of aligned motion and torque, trimmed at its ends.

    Parameters
    ----------
    recording : Recording
        Recording with name and rate.
    where : str
        Recording and window, for messages.
    signal : SignalProcessing
        Trimming.
    motion : sequence of (n, n_dof) arrays
        ``q dq ddq``, joint side, and the temperature if recorded.
    tau : (n, n_dof) array
        Joint torques (N.m or N).

    Raises
    ------
    FitError
        When trimming leaves nothing.
    """
    inside = kept_samples(tau.shape[0], where, signal)
    q, dq, ddq, *warmth = motion
    return Segment(
        name=recording.name,
        place=where,
        rate_hz=recording.rate_hz,
        q=q,
        dq=dq,
        ddq=ddq,
        tau=tau,
        temperature=warmth[0] if warmth else None,
    ).cut(inside)


def kept_samples(n_samples: int, where: str, signal: SignalProcessing) -> slice:
    """Return the samples of a window after trimming.

    Raises
    ------
    FitError
        When none remain; the sentence begins with `where`.
    """
    inside = slice(signal.trim_start, n_samples - signal.trim_end)
    if inside.stop <= inside.start:
        raise FitError(
            f"{where}: trimming {signal.trim_start} and {signal.trim_end} samples leaves nothing of "
            f"{counted(n_samples, 'sample')}"
        )
    return inside


def place_of(recording: Recording, window: tuple[int, int]) -> str:
    """Return recording and window as the prefix of messages."""
    where = f"recording '{recording.name}'"
    if window != (0, len(recording.q)):
        where += f", window of samples {window[0]} to {window[1]}"
    return where


def stretches(parts: Sequence[Segment], most_samples: int) -> list[Segment]:
    """Return the parts of a log, or three evenly spaced stretches of each if it has more than `most_samples`.

    Parameters
    ----------
    parts : sequence of Segment
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
        chosen += [part.cut(slice(start, start + length)) for start in starts]
    return chosen


@contextmanager
def at_place(where: str) -> Iterator[None]:
    """Prefix the message of an error with recording and window."""
    try:
        yield
    except (SignalError, FitError) as error:
        raise type(error)(f"{where}: {error}") from None
