"""Blocks: the rows of one joint in one window of a recording.

Weights, the variance (9), the covariance of decimated noise, the jackknife over windows, and parameters of single logs only
depend on blocks. Tested in ``tests/test_solver.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array

Rows = NDArray[np.intp]
"""Numbers of rows of a system."""


@dataclass(frozen=True)
class Block:
    """Rows of one joint in one window.

    Attributes
    ----------
    rows : slice
        Rows of the system, in the order of time.
    joint : int
        Joint, from 0.
    recording : int
        Recording, from 0, among those of the experiment.
    window : int
        Window of the recording, from 0.
    rate_hz : float
        Rate of the rows, after decimation.
    correlation : (n_lags,) array or None
        Autocorrelation on these rows of white noise in the log, from lag 0 (1) on; None if it stays white.
    """

    rows: slice
    joint: int
    recording: int = 0
    window: int = 0
    rate_hz: float = 1.0
    correlation: Array | None = field(default=None, compare=False, repr=False)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return len(self.numbers)

    @property
    def numbers(self) -> Rows:
        """Numbers of the rows in the system."""
        return np.arange(self.rows.start, self.rows.stop, self.rows.step or 1)


def stacked(
    n_joints: int,
    lengths: Sequence[int],
    *,
    places: Sequence[tuple[int, int]] | None = None,
    rates_hz: Sequence[float] | None = None,
    correlation: Array | None = None,
) -> tuple[Block, ...]:
    """Return the blocks of rows in the order of joints and, within a joint, of windows.

    Parameters
    ----------
    n_joints : int
        Number of joints.
    lengths : sequence of int
        Rows of each window, for each joint the same.
    places : sequence of (int, int), optional
        Recording and window of each; by default windows of one recording.
    rates_hz : sequence of float, optional
        Rate of each; 1 Hz by default.
    correlation : (n_lags,) array, optional
        See `Block`.
    """
    places = [(0, window) for window in range(len(lengths))] if places is None else places
    rates = [1.0] * len(lengths) if rates_hz is None else rates_hz
    blocks, start = [], 0
    for joint in range(n_joints):
        for length, (recording, window), rate in zip(lengths, places, rates, strict=True):
            rows = slice(start, start + length)
            blocks.append(Block(rows, joint, recording, window, rate, correlation))
            start += length
    return tuple(blocks)


def by_joint(blocks: Iterable[Block]) -> list[list[Block]]:
    """Return the blocks of each joint."""
    return _grouped(blocks, lambda block: block.joint)


def by_window(blocks: Iterable[Block]) -> list[list[Block]]:
    """Return the blocks of each window of each recording, which a jackknife leaves out together."""
    return _grouped(blocks, lambda block: (block.recording, block.window))


def _grouped(blocks: Iterable[Block], key: Callable[[Block], Any]) -> list[list[Block]]:
    return [list(group) for _, group in groupby(sorted(blocks, key=key), key)]
