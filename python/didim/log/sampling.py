"""Tests of even sampling, and windows of a record. Faults are reported, never repaired.

Tested in ``tests/test_recording.py``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import Table
from .._tools.words import brief, counted
from ..errors import RecordingError
from .data_format import Windows

MINIMUM_SAMPLES = 3
"""Smallest number of samples of a log: central differences need three. Filters need more and raise their own error."""
STEP_TOLERANCE = 0.01
"""Largest deviation of a time step from the sampling period, as a share of the period."""
LATE_TOLERANCE, LATE_SHARE = 0.05, 0.01
"""Largest deviation of single time steps, as a share of the period, and the share of the steps that may have it: a stamp that is
written late moves its sample by a twentieth of a step, and such steps together change the rate by less than `RATE_TOLERANCE`."""
RATE_TOLERANCE = 1e-3
"""Largest relative difference between a declared sampling rate and that of the time stamps."""
GAP = 0.5
"""Excess of a time step over the sampling period, as a share of the period, that ends a rollout; smaller ones count as uneven
sampling."""


@dataclass(frozen=True, kw_only=True)
class TimeFault:
    """A fault of time stamps.

    Attributes
    ----------
    kind : {"order", "gap", "uneven", "rate"}
        Time does not increase; samples are missing; steps are uneven; the declared rate differs.
    file : str
        Name of the file.
    sentence : str
        Description with file and row.
    sample : int or None
        Last sample before the fault, from 0.
    rate_hz : float
        Rate of the time stamps outside gaps (Hz).
    """

    kind: Literal["order", "gap", "uneven", "rate"]
    file: str
    sentence: str
    sample: int | None
    rate_hz: float


def check_time(t: Array, rate_hz: float | None, file: str) -> float:
    """Check that time stamps are even and agree with a declared sampling rate.

    Parameters
    ----------
    t
        (n_samples,) time stamps in s.
    rate_hz
        Declared rate, or None.
    file
        File of the time stamps, for messages.

    Returns
    -------
    float
        The declared rate, or else the one of the time stamps.

    Raises
    ------
    RecordingError
        When a step differs by more than 1 % from the median step (single ones by more than 5 %), which names the row and how
        many samples are missing, or when the declared rate differs by more than 0.1 % from the time stamps.
    """
    for fault in time_faults(t, rate_hz, file):
        raise RecordingError(fault.sentence)
    return (len(t) - 1) / float(t[-1] - t[0]) if rate_hz is None else rate_hz


def time_faults(t: Array, rate_hz: float | None, file: str) -> Iterator[TimeFault]:
    """Find all faults that `check_time` refuses, in the order of the rows."""
    with np.errstate(over="ignore"):  # an infinite step is an uneven one
        steps = np.diff(t)
    period = float(np.median(steps))
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0)) + 1
        yield TimeFault(
            kind="order",
            file=file,
            sentence=f"{file}: time does not grow from row {row} ({t[row - 1]:.9g} s) to row {row + 1}",
            sample=row - 1,
            rate_hz=1.0 / period if period > 0.0 else float("nan"),
        )
        return
    apart = np.abs(steps - period)
    uneven = apart > STEP_TOLERANCE * period
    if np.mean(uneven) <= LATE_SHARE:
        uneven = apart > LATE_TOLERANCE * period
    # Samples that are missing count, so jitter, whose median step is not its mean, does not change the rate.
    finite = steps[np.isfinite(steps)]
    measured = float(np.rint(finite / period).sum() / finite.sum())
    for at in np.flatnonzero(uneven).tolist():
        row = at + 1
        step = float(steps[at])
        missing = round(step / period) - 1 if np.isfinite(step) else 0
        whole = missing > 0 and abs(step - (missing + 1) * period) <= STEP_TOLERANCE * period
        cause = (
            f"{missing} sample{'s are' if missing > 1 else ' is'} missing" if whole else "sampling is uneven"
        )
        yield TimeFault(
            kind="gap" if whole else "uneven",
            file=file,
            sentence=f"{file}: {cause} after row {row} (t = {t[row - 1]:.9g} s), where the time step is {step:.6g} s "
            f"instead of {period:.6g} s",
            sample=at,
            rate_hz=measured,
        )
    if rate_hz is not None and abs(rate_hz - measured) > RATE_TOLERANCE * measured:
        yield TimeFault(
            kind="rate",
            file=file,
            sentence=f"{file}: the time stamps give a sampling rate of {measured:.6g} Hz, "
            f"rate_hz says {rate_hz:.6g} Hz",
            sample=None,
            rate_hz=measured,
        )


def stretches(last: Sequence[int], n_samples: int) -> Windows:
    """Half-open sample slices between faults, given the last sample before each; none shorter than a tenth of the longest."""
    edges = [0, *(sample + 1 for sample in last), n_samples]
    longest = max(stop - start for start, stop in pairwise(edges))
    return tuple(
        (start, stop)
        for start, stop in pairwise(edges)
        if stop - start >= max(MINIMUM_SAMPLES, 0.1 * longest)
    )


def rollout_windows(n_samples: int, number: Array | None, t: Array | None) -> Windows:
    """Return the half-open sample slices of a record's rollouts that are long enough for differences.

    Parameters
    ----------
    n_samples
        Samples of the record.
    number
        (n_samples,) number of the rollout at each sample, such as the index of an episode; or None.
    t
        (n_samples,) time stamps in s; if `number` is None, a rollout ends at their gaps and backward steps.
    """
    if number is not None:
        ends = np.flatnonzero(np.diff(number) != 0.0)
    else:
        assert t is not None
        steps = np.diff(t)
        period = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
        ends = np.flatnonzero((steps <= 0.0) | (steps > (1.0 + GAP) * period))
    edges = [0, *(ends + 1).tolist(), n_samples]
    return tuple((start, stop) for start, stop in pairwise(edges) if stop - start >= MINIMUM_SAMPLES)


def slices(table: Table, windows_s: object, rate_hz: float, n_samples: int) -> Windows:
    """Turn windows in seconds from the first sample into half-open sample slices.

    Raises
    ------
    ExperimentError
        When `windows_s` is not a list of pairs, or a window leaves the record, is too short, or overlaps.
    """
    wanted = "windows_s must be a list of [start, stop] in seconds with start < stop"
    if not isinstance(windows_s, list):
        table.fail(f"{wanted}, got {brief(repr(windows_s))}")
    slices_of_windows: list[tuple[int, int]] = []
    for window in windows_s:
        if (
            not isinstance(window, list)
            or len(window) != 2
            or not all(type(edge) in (int, float) and abs(edge) <= sys.float_info.max for edge in window)
            or not window[0] < window[1]
        ):
            table.fail(f"{wanted}, got {brief(repr(window))}")
        # Compared before rounding, because a distant edge may be infinite in samples.
        if window[0] * rate_hz <= -0.5 or window[1] * rate_hz >= n_samples + 0.5:
            table.fail(f"the window {window} s leaves the record, which lasts {n_samples / rate_hz:.6g} s")
        start, stop = (round(edge * rate_hz) for edge in window)
        if stop - start < MINIMUM_SAMPLES:
            table.fail(
                f"the window {window} s has {counted(stop - start, 'sample')}, "
                f"at least {MINIMUM_SAMPLES} are needed"
            )
        slices_of_windows.append((start, stop))
    slices_of_windows.sort()
    for before, after in pairwise(slices_of_windows):
        if after[0] < before[1]:
            table.fail(f"the windows {windows_s} overlap")
    return tuple(slices_of_windows)
