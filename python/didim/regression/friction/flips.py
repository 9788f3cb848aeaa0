"""Probabilities of scores by random signs of their blocks.

Where the model is right, the sums of the blocks are as likely negative as positive, whatever the correlation within a block.
Sources: as `alarm`. Tested in ``tests/test_friction_alarm.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array, quotient
from ...terms.rows import Rows

MOST_BLOCKS = 500
"""Number of blocks above which neighbouring ones are summed: their random signs take 4 000 numbers a block."""
FLIPS = 3999
"""Number of random sign patterns beside the observed one; the smallest probability is 1 in 4 000."""
MEMORY_SHARE = 0.25
"""Share of the false alarms allotted to memory laws; the other laws, tested separately, get the remainder."""
SEED = 20261
"""Seed of the patterns: the same log always gets the same probability."""
VISIBLE = 6.0
"""Score, in its standard deviation without the law, that makes a law detectable: with the law included in the deviation of 20
blocks it is 3.6."""


def joint_test(
    columns: Array, rho: Array, blocks: Sequence[Sequence[Rows]], memory: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return the probability of the scores of a joint's columns, (n_rows, k), and by how many units of each the test sees it.

    Columns of zeros are not tested: their probability is one, and they are never seen (zero units).
    """
    scores = [np.array([columns[rows].T @ rho[rows] for rows in some]) for some in blocks]
    probability = np.max([_flipped(part, memory) for part in scores], axis=0)
    spread = np.max([np.sqrt(np.sum(np.square(part), axis=0)) for part in scores], axis=0)
    size = np.sum(np.square(columns), axis=0)
    return probability, VISIBLE * quotient(spread, size)


def _flipped(scores: Array, memory: NDArray[np.bool_]) -> Array:
    """Return the probability of the scores of laws, (n_blocks, k), when the signs of blocks are flipped, (k,).

    The largest score counts, of laws of memory and of others, which share the false alarms.
    """
    if len(scores) > MOST_BLOCKS:
        scores = np.add.reduceat(scores, np.arange(MOST_BLOCKS) * len(scores) // MOST_BLOCKS, axis=0)
    spread = np.sqrt(np.sum(np.square(scores), axis=0))
    units = scores / np.where(spread > 0.0, spread, np.inf)
    # A pattern that is the observed one up to its sign counts, whatever the rounding.
    observed = np.abs(units.sum(axis=0)) * (1.0 - 1e-9)
    drawn, probability = np.abs(_signs(len(scores)) @ units), np.ones(len(observed))
    for group, share in ((~memory, 1.0 - MEMORY_SHARE), (memory, MEMORY_SHARE)):
        tested = np.flatnonzero(group & (spread > 0.0))
        if tested.size:
            largest = np.max(drawn[:, tested], axis=1)[:, None]
            count = np.sum(largest >= observed[tested], axis=0)
            probability[tested] = np.minimum(1.0, (1.0 + count) / (FLIPS + 1) / share)
    return probability


@lru_cache(maxsize=8)
def _signs(blocks: int) -> Array:
    """Return the random signs of blocks, (FLIPS, blocks)."""
    return np.asarray(np.random.default_rng(SEED).integers(0, 2, (FLIPS, blocks)) * 2.0 - 1.0)
