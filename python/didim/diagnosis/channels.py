"""Columns of a log one by one, as they were written: stuck, jumping, clipped or coarse.

Values are brought back to the columns of the file, because a reduction mixes motors and hides what one of them does.
Tested in ``tests/test_check.py``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array, true_ranges
from .._tools.words import counted, joints_text, series
from ..evidence.torques import as_logged, is_constant
from ..log.recording import Recording
from ..result.finding import Finding, worded

ROUNDING = 1e-12
"""Largest difference of two equal samples, as a share of the largest value: converting back to the columns rounds."""
STUCK_SAMPLES = 8
"""Smallest number of equal samples in a row of a stuck channel: at a reversal an encoder's noise repeats a value a few
times."""
BREAK = 10.0
"""Second difference of a jump, as a multiple of the usual one (exceeded by 1 of 100 samples): a smooth motion with noise
reaches 4 to 5."""
CLIPPED_SAMPLES = 8
"""Smallest number of samples at the extreme value of a clipped channel."""
CLIPPED_RATIO = 3.0
"""Smallest ratio of the samples at the extreme value to those at the next one; a quantised parabola has 1 / (sqrt(2) - 1) =
2.4."""
FEWEST_LEVELS = 100
"""Smallest number of values over a channel's range: with fewer, a step exceeds 1 % of it, about the accuracy of torques."""


@dataclass(frozen=True)
class Channel:
    """One column of a log in the unit of the file.

    Attributes
    ----------
    what : {"position", "torque"}
        What it holds.
    number : int
        Joint, or motor where the log is on the motor side, from 1.
    side : {"joint", "motor"}
        Which of the two.
    recording : Recording
        Where it is from.
    file, column : str or None
        Data file, and its column; None for arrays.
    values : (n_samples,) array
        Samples.
    """

    what: Literal["position", "torque"]
    number: int
    side: str
    recording: Recording
    file: str | None
    column: str | None
    values: Array

    def __str__(self) -> str:
        where = f"the {self.what} of {self.side} {self.number}"
        if self.file is not None and self.column is not None:
            where += f" ({self.file}, column {self.column})"
        elif len(self.recording.name):
            where += f" (recording '{self.recording.name}')"
        return where

    def finding(self, **more: Any) -> Finding:
        """Make a finding on this channel."""
        return worded(
            recording=self.recording.name, file=self.file, column=self.column, joints=(self.number,), **more
        )


def channels(recording: Recording) -> list[Channel]:
    """Return the columns of positions and torques of a recording."""
    return [*_columns(recording, "position", recording.q), *_columns(recording, "torque", recording.tau)]


def _columns(
    recording: Recording, what: Literal["position", "torque"], values: Array | None
) -> Iterator[Channel]:
    if values is None:
        return
    origin = recording.origin.get(what, {})
    values, side = as_logged(recording, what, values)
    values = values / np.array(origin.get("factors_to_si", 1.0))
    names = origin.get("columns") or range(1, values.shape[1] + 1)
    for joint, name in enumerate(names):
        file = origin.get("file")
        yield Channel(what, joint + 1, side, recording, file, str(name) if file else None, values[:, joint])


def check_channels(recording: Recording) -> list[Finding]:
    """Look at each column by itself."""
    findings: list[Finding] = []
    jumps: list[tuple[Channel, int]] = []
    for channel in channels(recording):
        if channel.what == "position":
            stuck = _stuck(channel)
            findings += stuck
            if not stuck:
                jumps += [(channel, sample) for sample in _jumps(channel)]
        else:
            findings += [] if is_constant(channel.values) else _clipped(channel)
        findings += _coarse(channel)
    # Samples are missing where several channels jump at once; one alone has a glitch.
    starts = {start for start, _ in recording.windows}
    by_sample: dict[int, list[Channel]] = {}
    for channel, sample in jumps:
        if any(abs(sample - start) <= 2 for start in starts):
            continue  # a gap in the time stamps, reported already
        near = next((key for key in by_sample if abs(key - sample) <= 2), sample)
        by_sample.setdefault(near, []).append(channel)
    reported = []
    for sample, at in sorted(by_sample.items()):
        time = sample / recording.rate_hz
        if len(at) > 1:
            joints = tuple(channel.number for channel in at)
            jumping = joints_text(joint - 1 for joint in joints).replace("joint", at[0].side)
            reported.append(
                worded(
                    kind="gap",
                    sentence=f"the positions of {jumping} jump together behind sample "
                    f"{sample} ({time:.6g} s) of recording '{recording.name}': samples seem to be missing there",
                    advice="Recover the lost samples, or use the stretches before and after as two windows with windows_s",
                    recording=recording.name,
                    file=at[0].file,
                    joints=joints,
                    sample=sample,
                )
            )
        else:
            reported.append(
                at[0].finding(
                    kind="jump",
                    sentence=f"{at[0]} jumps behind sample {sample} ({time:.6g} s), the others do not",
                    advice="Look at encoder and logger; leave these samples out with windows_s",
                    sample=sample,
                )
            )
    return [*reported, *findings]


def _same(values: Array) -> NDArray[np.bool_]:
    """Whether each sample equals the next, (n_samples - 1,)."""
    return np.asarray(np.abs(np.diff(values)) <= ROUNDING * np.abs(values).max())


def _usual(bends: Array) -> float:
    """Size of the second differences that 1 of 100 samples exceeds."""
    return float(np.quantile(bends, 0.99)) if bends.size else 0.0


def _stuck(channel: Channel) -> list[Finding]:
    """Find an encoder that stands still in full motion: a joint stops gradually, a dead encoder at once."""
    values = channel.values
    bends = np.abs(np.diff(values, 2))
    runs = true_ranges(_same(values), STUCK_SAMPLES - 1)
    # The edges of the runs themselves must not decide what is usual, nor rest.
    moving = np.ones(bends.size, dtype=bool)
    for start, stop in runs:
        moving[max(0, start - 1) : stop + 1] = False
    usual = _usual(bends[moving])
    if usual == 0.0:
        return []
    rate = channel.recording.rate_hz
    return [
        channel.finding(
            kind="stuck",
            sentence=f"{channel} is stuck from sample {start} to sample {stop} "
            f"({start / rate:.6g} s to {stop / rate:.6g} s): it stops or starts in full motion",
            advice="Look at encoder and logger; leave these samples out with windows_s",
            sample=start,
            last_sample=stop,
        )
        for start, stop in runs
        # Samples start to stop are equal; bends[k] is the one at sample k + 1.
        if max((bends[k] for k in (start - 1, stop - 1) if 0 <= k < bends.size), default=0.0) > BREAK * usual
    ]


def _jumps(channel: Channel) -> list[int]:
    """Find samples behind which a position jumps, and stays or comes back."""
    bends = np.abs(np.diff(channel.values, 2))
    usual = _usual(bends)
    if usual == 0.0:
        return []
    places = np.flatnonzero(bends > BREAK * usual)
    # Breaks in 1 of 100 samples are not accidents: the signal itself is noisy or stepped.
    if not places.size or places.size > 0.01 * bends.size:
        return []
    first = np.concatenate([[True], np.diff(places) > 3])
    return [int(row) + 1 for row in places[first]]


def _clipped(channel: Channel) -> list[Finding]:
    """Find torques that stay at an extreme value."""
    findings = []
    values = channel.values
    room = ROUNDING * np.abs(values).max()
    for sign in (1.0, -1.0):
        top = (sign * values).max()
        at_top = sign * values >= top - room
        rest = (sign * values)[~at_top]
        count = int(at_top.sum())
        if count < CLIPPED_SAMPLES or not rest.size:
            continue
        below = int(np.sum(rest >= rest.max() - room))
        if count > CLIPPED_RATIO * below:
            findings.append((sign * top, count, int(np.argmax(at_top))))
    if not findings:
        return []
    limits = series((f"{value:.6g}" for value, _, _ in findings), 30)
    total = sum(count for _, count, _ in findings)
    first = min(sample for _, _, sample in findings)
    return [
        channel.finding(
            kind="clipped",
            sentence=f"{channel} is clipped at {limits} in {counted(total, 'sample')}, first in sample {first}",
            advice="Move more slowly or raise the limit of the drive or of the logger; until then exclude these times "
            "with windows_s, because the torque there is wrong",
            sample=first,
            value=findings[0][0],
        )
    ]


def _coarse(channel: Channel) -> list[Finding]:
    """Find a channel of few values."""
    levels = len(np.unique((channel.values / (np.abs(channel.values).max() or 1.0)).round(12)))
    if levels >= FEWEST_LEVELS or levels == 1:
        return []
    moved = np.mean(~_same(channel.values))
    # A channel that hardly ever changes is at rest, not coarse.
    if moved < 0.01:
        return []
    return [
        channel.finding(
            kind="quantised",
            sentence=f"{channel} has {levels} different values only, so one step is "
            f"{100.0 / (levels - 1):.2g} % of its range",
            advice="Log it with more digits, or in the unit of the drive",
            value=float(levels),
        )
    ]
