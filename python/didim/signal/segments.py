"""Windows of a recording, each filtered, differentiated and trimmed by itself.

Nothing outside a window (a stop, a tool change) leaks in. Tested in ``tests/test_identify.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import FitError, SignalError
from ..log.recording import Recording
from .align import align
from .filters import differentiate
from .processing import SignalProcessing
from .spikes import without_spikes


@dataclass(frozen=True, kw_only=True)
class Segment:
    """Motion and torque of one window, filtered and trimmed, at the rate of the recording.

    Attributes
    ----------
    name : str
        Recording that it is part of.
    place : str
        Recording and window, as messages open.
    rate_hz : float
        Its rate.
    q, dq, ddq : ndarray, shape (n_samples, n_dof)
        Joint position, velocity and acceleration, SI units.
    tau : ndarray, shape (n_samples, n_dof)
        Measured torque, N.m or N, joint side; not filtered.
    """

    name: str
    place: str
    rate_hz: float
    q: Array
    dq: Array
    ddq: Array
    tau: Array


def segments(recording: Recording, signal: SignalProcessing, delay_samples: float = 0.0) -> list[Segment]:
    """Filter, differentiate and trim each window of a recording.

    Parameters
    ----------
    recording : Recording
        Must have torques.
    signal : SignalProcessing
        Filter and trimming.
    delay_samples : float
        How late the torque was recorded; it is moved back by as much.

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
    if recording.tau is None:
        raise FitError(f"recording '{recording.name}' has no torques, which this method needs")
    found = []
    for start, stop in recording.windows:
        place = f"recording '{recording.name}'"
        if (start, stop) != (0, len(recording.q)):
            place += f", window of samples {start} to {stop}"
        with at_place(place):
            found_motion = differentiate(recording.q[start:stop], recording.rate_hz, signal)
            motion, tau = align(
                found_motion, without_spikes(recording.tau[start:stop], signal), delay_samples
            )
        found.append(trimmed(recording, place, signal, motion, tau))
    return found


def trimmed(
    recording: Recording, place: str, signal: SignalProcessing, motion: Sequence[Array], tau: Array
) -> Segment:
    """Return the segment of aligned motion and torque, without the samples that trimming takes off its ends.

    Parameters
    ----------
    recording : Recording
        Gives name and rate.
    place : str
        Recording and window, for messages.
    signal : SignalProcessing
        Trimming.
    motion : sequence of (n, n_dof) arrays
        ``q dq ddq``, joint side.
    tau : (n, n_dof) array
        Joint torques (N.m or N).

    Raises
    ------
    FitError
        When trimming leaves nothing.
    """
    kept = slice(signal.trim_start, tau.shape[0] - signal.trim_end)
    if kept.stop <= kept.start:
        raise FitError(
            f"{place}: trimming {signal.trim_start} and {signal.trim_end} samples leaves nothing of "
            f"{counted(tau.shape[0], 'sample')}"
        )
    q, dq, ddq, torque = (np.ascontiguousarray(values[kept]) for values in (*motion, tau))
    return Segment(
        name=recording.name, place=place, rate_hz=recording.rate_hz, q=q, dq=dq, ddq=ddq, tau=torque
    )


@contextmanager
def at_place(place: str) -> Iterator[None]:
    """Open the message of an error with the recording and window that it is about."""
    try:
        yield
    except (SignalError, FitError) as error:
        raise type(error)(f"{place}: {error}") from None
