"""Weights of the rows: the reciprocal of the size of each joint's residuals. Tested in ``tests/test_least_squares.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array
from ..terms.rows import LinearSystem

SMALLEST_RELATIVE_RESIDUAL = 1e-9
"""Lower bound of a joint's residual, as a share of its torque: weights stay finite on logs without noise."""


def joint_sigma(system: LinearSystem, residual: Array) -> Array:
    """Root mean square of each joint's residuals, never zero; shape (n_dof,)."""
    return positive_rms(system.norms(residual), system.norms(system.measured), system.counts)


def positive_rms(residual: Array, measured: Array, counts: Array | NDArray[np.intp] | float) -> Array:
    """Root mean square of residuals from their norms, those of the torques, (n_dof,) each, and the numbers of rows; never zero."""
    sigma, torque = residual / np.sqrt(counts), measured / np.sqrt(counts)
    # A joint without torque gets the size of the largest.
    floor = SMALLEST_RELATIVE_RESIDUAL * np.where(torque > 0.0, torque, torque.max(initial=0.0))
    sigma = np.maximum(sigma, floor)
    return cast(Array, np.where(sigma > 0.0, sigma, 1.0))


def per_row(system: LinearSystem, per_joint: Sequence[float] | Array) -> Array:
    """Value of each row's joint, shape (r,)."""
    return np.repeat(np.asarray(per_joint, dtype=np.float64), system.counts)
