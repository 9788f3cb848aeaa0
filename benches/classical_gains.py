"""Drive gains with the currents in the regressor: ordinary and total least squares, for comparison.

    [diag(i) -W] [K; theta] = t,     rows divided by the noise of their motor

The noisy currents are columns, so ordinary least squares is biased towards small gains: on a simulated UR5e by up to a factor
of ten (docs/several_logs.md). Total least squares (Gautier and Briot 2011, 2014) assumes the same noise in every column, but W has
none, and its estimates have an unbounded spread. Neither has meaningful standard deviations. Tested in
``tests/test_drive_gains.py``.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from didim.regression.gains.currents import Currents
from didim.terms.rows import LinearSystem

Array = NDArray[np.float64]

Classical = Literal["ols", "tls"]


def classical_gains(
    system: LinearSystem, reduction: Array, kind: Classical, noise: Array | None = None
) -> tuple[Array, Array]:
    """Estimate drive gains with the currents in the regressor.

    Parameters
    ----------
    system : LinearSystem
        System as for `Currents`.
    reduction : (n, n) array
        Reduction matrix R of the currents.
    kind : {"ols", "tls"}
        Ordinary or total least squares.
    noise : (n,) array, optional
        Standard deviation of the currents of each motor (A); by default the residual of a linear fit per motor.

    Returns
    -------
    gains : (n,) array
        N.m/A or N/A.
    theta : (q,) array
        Parameters.
    """
    currents = Currents.of(system, reduction)
    n = currents.n_motors
    if noise is None:
        errors = np.empty_like(currents.current)
        for motor in range(n):
            rows = currents.motor == motor
            a = np.column_stack([currents.columns[rows] / currents.scale, currents.known[rows]])
            errors[rows] = (
                currents.current[rows] - a @ np.linalg.lstsq(a, currents.current[rows], rcond=1e-8)[0]
            )
        noise = currents.spread(errors)
    weights = 1.0 / noise[currents.motor]
    a = np.hstack([currents.motors * currents.current[:, None], -currents.columns]) * weights[:, None]
    right = currents.known * weights
    if kind == "ols":
        size = np.linalg.norm(a, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        solution = np.linalg.lstsq(a / size, right, rcond=None)[0] / size
    else:
        last = np.linalg.svd(np.column_stack([a, -right]), full_matrices=False)[2][-1]
        solution = last[:-1] / last[-1]
    return solution[:n], solution[n:]
