"""Classification of unnamed columns by their values: stamps grow, and velocities are differences of positions.

Tested in ``tests/test_init_logs.py``.
"""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array
from .draft_columns import Column

ALIKE = 0.9
"""Correlation with the differences of another column from which a column is taken for its velocity."""
MOST_BLOCKS = 40
"""Largest number of blocks that are compared pair by pair: the log of one robot has some ten signals."""
SAME = 0.999
"""Correlation of two columns from which they are taken for reference and position of one joint."""


def layout(values: Array, n_dof: int) -> list[Column]:
    """Classify the unnamed columns of a log.

    The first column is the time if it grows. The others must be blocks of one column per joint. A block is a position if
    another one is its velocity; of two blocks, the smoother one is. A single remaining block is a torque. Several remain an
    open question, because currents and the torques of a controller's model look alike.

    Parameters
    ----------
    values : (n_samples, n) array
        All columns.
    n_dof : int
        Number of joints.
    """
    width = values.shape[1]
    timed = bool((np.diff(values[:, 0]) > 0.0).all()) and (width % n_dof != 0 or n_dof == 1) and width > n_dof
    first = int(timed)
    t = values[:, 0] if timed else np.arange(len(values), dtype=np.float64)
    count, rest = divmod(width - first, n_dof)
    kinds = ["other"] * (width - first)
    if not rest and 2 <= count <= MOST_BLOCKS and len(values) >= 8:
        blocks = np.split(values[:, first:], count, axis=1)
        kinds = [kind for kind in kinds_of_blocks(blocks, t) for _ in range(n_dof)]
    time = [Column(1, "time", stem="time")] * first
    return time + [
        Column(first + k + 1, kind, k % n_dof + 1, stem=f"{kind}{k // n_dof}") for k, kind in enumerate(kinds)
    ]


def kinds_of_blocks(blocks: list[Array], t: Array) -> list[str]:
    """Return the kind of each block of one column per joint.

    Parameters
    ----------
    blocks : list of (n_samples, n_dof) array
        Signals.
    t : (n_samples,) array
        Time, in any unit.
    """
    kinds = ["other"] * len(blocks)
    rates = [np.gradient(block, t, axis=0) for block in blocks]
    pairs = [
        (_alike(rates[k], block), k, other)
        for k in range(len(blocks))
        for other, block in enumerate(blocks)
        if other != k
    ]
    score, position, velocity = max(pairs)
    if score > ALIKE:
        # An acceleration is related to the velocity as the velocity to the position, so the first block of the chain is the
        # position.
        before = [(s, k) for s, k, other in pairs if other == position and s > ALIKE]
        if before:
            position, velocity = max(before)[1], position
        kinds[position], kinds[velocity] = "position", "velocity"
        follows = [(s, other) for s, k, other in pairs if k == velocity and s > ALIKE]
        if follows:
            kinds[max(follows)[1]] = "acceleration"
        for k, block in enumerate(blocks):
            if kinds[k] == "other" and _alike(block, blocks[position]) > SAME:
                kinds[k] = "reference"
    elif len(blocks) == 2:
        position = int(np.argmin([_roughness(block) for block in blocks]))
        kinds[position] = "position"
    left = [k for k, kind in enumerate(kinds) if kind == "other"]
    if len(left) == 1 and "position" in kinds:
        kinds[left[0]] = "torque"
    return kinds


def _alike(a: Array, b: Array) -> float:
    """Return the median correlation of the moving columns of two blocks; 0 if none move."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    sizes = np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
    moving = sizes > 0.0
    if not moving.any():
        return 0.0
    return float(np.median(np.sum(a[:, moving] * b[:, moving], axis=0) / sizes[moving]))


def _roughness(block: Array) -> float:
    """Return the rms of second differences over that of the values about their mean: torques are rougher than motions."""
    size = np.linalg.norm(block - block.mean(axis=0))
    return float(np.linalg.norm(np.diff(block, n=2, axis=0)) / size) if size > 0.0 else np.inf
