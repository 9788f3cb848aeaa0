"""The parallel decimation of (6): stages of Chebyshev filters, applied to the torques and to each column of W.

Tested in ``tests/test_signals.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from .._tools.threads import core_threads
from ..errors import CoreErrorsAs, SignalError
from .filters import checked_columns, padding_length, poles_survive
from .processing import Convention, SignalProcessing

Stage = tuple[Array, Array, int, int, int]
"""A filter of the core: sections (s, 6), their steady states (s, 2), padding, factor, first kept sample."""

DECIMATION_ORDER = 8
"""Order of the Chebyshev I filter of both ``decimate``, as in `_squared_gain`."""
DECIMATION_RIPPLE_DB = 0.05
"""Passband ripple (dB) of the Chebyshev filter."""
DECIMATION_BAND = 0.8
"""Cut-off of the Chebyshev filter, as a share of the new Nyquist frequency."""


def decimation_stages(n_samples: int, signal: SignalProcessing) -> list[Stage]:
    """Design the filters of the parallel decimation (6) for a record of a given length.

    Parameters
    ----------
    n_samples : int
        Samples of the record; MATLAB's convention depends on it.
    signal : SignalProcessing
        Factors and convention.

    Returns
    -------
    list of Stage
        One per factor, in the format of the core; empty without decimation.

    Raises
    ------
    SignalError
        When a stage gets too few samples for its padding or its factor, or its factor is so large that
        rounding spoils the filter.

    Notes
    -----
    Chebyshev I of order 8, 0.05 dB, cut-off at 0.8 of the new Nyquist frequency, in both passes.
    ``test_signals.py`` compares with ``scipy.signal.decimate`` and, for MATLAB's convention, with its
    definition.
    """
    return list(_stages(n_samples, signal.decimation, signal.decimation_convention))


def least_samples(signal: SignalProcessing) -> int:
    """Return the smallest number of samples for which `decimation_stages` leaves a row.

    Parameters
    ----------
    signal : SignalProcessing
        Factors, convention and rows dropped at the ends. Tested in ``tests/test_check_gaps.py``.
    """
    padlen = padding_length(DECIMATION_ORDER, signal.decimation_convention)
    least = 2 * signal.edge_rows + 1 if signal.decimation else 1
    for factor in reversed(signal.decimation):
        least = max(padlen + 1, factor, factor * (least - 1) + 1)
    return least


@lru_cache(maxsize=64)
def _stages(n_samples: int, factors: tuple[int, ...], convention: Convention) -> tuple[Stage, ...]:
    """Stages of `decimation_stages`, cached: their design takes longer than filtering a small log, and `check` filters often."""
    matlab = convention == "matlab"
    padlen = padding_length(DECIMATION_ORDER, convention)
    stages: list[Stage] = []
    for factor in factors:
        stage = f"stage {len(stages) + 1} of {len(factors)} gets {n_samples}"
        needed = max(padlen, factor - 1)
        if n_samples <= needed:
            raise SignalError(f"decimation by {factor} needs more than {needed} samples, {stage}")
        sos, zi = _decimation_filter(factor)
        left = -(-n_samples // factor)
        # MATLAB's grid ends at the last sample.
        first = n_samples - factor * (left - 1) - 1 if matlab else 0
        stages.append((sos, zi, padlen, factor, first))
        n_samples = left
    return tuple(stages)


@lru_cache(maxsize=64)
def _decimation_filter(factor: int) -> tuple[Array, Array]:
    """Sections of the filter before a decimation, (4, 6), and their steady states, (4, 2)."""
    from scipy.signal import cheby1, sosfilt_zi, zpk2sos

    share = DECIMATION_BAND / factor
    design: Any = cheby1(DECIMATION_ORDER, DECIMATION_RIPPLE_DB, share, output="zpk")  # likewise
    sos = np.ascontiguousarray(zpk2sos(*design))
    if not poles_survive(design[1], sos[:, 3:]):
        raise SignalError(f"rounding spoils the filter of a decimation by {factor}: take several stages")
    return sos, np.ascontiguousarray(sosfilt_zi(sos))


def decimate(x: Array, stages: Sequence[Stage]) -> Array:
    """Filter and decimate signals in the same way as the columns of W.

    Parameters
    ----------
    x : ndarray, shape (n_samples, m)
        Signals, one per column.
    stages : sequence of Stage
        From `decimation_stages` with the same number of samples.

    Returns
    -------
    ndarray, shape (n_kept, m)
        Kept samples; a copy of `x` without stages.

    Raises
    ------
    SignalError
        When a sample is not a finite number.

    Notes
    -----
    ``test_signals.py`` compares with ``scipy.signal.decimate(zero_phase=True)``.
    """
    x = checked_columns(x)
    with CoreErrorsAs(SignalError):
        return _core.decimate(x, list(stages), core_threads()) if stages else x.copy()


def row_values(values: Array, signal: SignalProcessing) -> Array:
    """Return signals at the rows of (7), (n_rows, n): decimated, without the rows at the ends; `values` are (n_samples, n)."""
    values = np.ascontiguousarray(values)
    return np.asarray(decimate(values, decimation_stages(len(values), signal))[signal.kept_rows])
