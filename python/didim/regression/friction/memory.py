r"""Dahl's memory: friction that depends on the way since the last reversals, exact in displacement.

The state z of a joint follows its position alone, with the sign s = +-1 of its motion and the displacement h,

    dz/dq = (s - z) s / h,        z(q) = s - (s - z_0) exp(-|q - q_0| / h)        between two reversals

so that a step along the log is exact whatever its length, and never stiff. What a start z_0 leaves is linear:
``z = z|_(z_0 = 0) + z_0 exp(-path / h)`` with the length of the path since the start.

Source: Dahl (1968), with the exponent one. Tested in ``tests/test_friction_memory.py``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..._tools.arrays import Array


def state(q: Array, width: ArrayLike) -> Array:
    """Compute the state of Dahl's memory along positions, from zero at the first sample.

    Parameters
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Joint positions (rad or m).
    width : float or ndarray, shape (n_dof,)
        Displacement h over which the memory fades by a factor of e (rad or m), above zero.

    Returns
    -------
    ndarray, shape (n_samples, n_dof)
        State between -1 and 1.

    Notes
    -----
    ``test_friction_memory.py`` compares with steps from sample to sample, and halves the steps.
    """
    widths = np.broadcast_to(np.asarray(width, dtype=np.float64), q.shape[1])
    out = np.zeros_like(q)
    for joint, h in enumerate(widths):
        moves = np.sign(np.diff(q[:, joint]))
        moving = np.flatnonzero(moves)
        if not moving.size:
            continue
        # Rest keeps the state: a stretch goes on until the next motion in the other direction.
        turns = moving[1:][moves[moving[1:]] != moves[moving[:-1]]]
        edges = [0, *turns.tolist(), len(q) - 1]
        signs = [moves[moving[0]], *moves[turns]]
        z = 0.0
        for start, stop, sign in zip(edges[:-1], edges[1:], signs, strict=True):
            way = np.abs(q[start + 1 : stop + 1, joint] - q[start, joint])
            out[start + 1 : stop + 1, joint] = sign - (sign - z) * np.exp(-way / h)
            z = out[stop, joint]
    return out


def start_column(q: Array, width: ArrayLike) -> Array:
    """Compute what a unit state at the first sample leaves along positions: ``exp(-path / h)``.

    Parameters
    ----------
    q : ndarray, shape (n_samples, n_dof)
        Joint positions (rad or m).
    width : float or ndarray, shape (n_dof,)
        Displacement h (rad or m).

    Returns
    -------
    ndarray, shape (n_samples, n_dof)
    """
    path = np.zeros_like(q)
    np.cumsum(np.abs(np.diff(q, axis=0)), axis=0, out=path[1:])
    return np.asarray(np.exp(-path / np.asarray(width, dtype=np.float64)))
