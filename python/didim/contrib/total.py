r"""Total least squares: noise in the observation matrix as well as in the torques.

    [A / c, Y / |Y|] = U S V^T,    x = -|Y| v_1:b / v_b+1 / c        v the last right singular vector

``A`` is the weighted matrix and ``c`` the norms of its columns. Total least squares assumes independent noise of equal size in
all scaled columns and in the torques. A robot's observation matrix has neither, so the estimate is included for comparison
only, as ``IDIMLS(solver="didim.contrib.total:Total")`` (docs/robust.md). Sources: Golub and Van Loan (1980); Van Huffel and
Vandewalle (1991).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._tools.arrays import Array
from ..errors import FitError
from ..regression.classical.solvers import with_weights
from ..regression.fit import Fit, Progress
from ..regression.least_squares import solve
from ..regression.linear_system import LinearSystem
from ..regression.settings import LeastSquaresSettings

SMALLEST_LAST = 1e-10
"""Smallest last component of the unit singular vector for which the problem has a solution."""


def total_least_squares(a: Array, y: Array) -> Array | None:
    """Solve ``A x = y`` with errors in both.

    Parameters
    ----------
    a, y : ndarray, shapes (r, b), (r,)
        Weighted observation matrix and torques.

    Returns
    -------
    ndarray, shape (b,), or None
        Estimate; None if there is no solution, because the last singular vector has no component along the torques.

    Notes
    -----
    ``test_robust.py`` meets the closed form of a line through points, and the eigenvector of the normal matrix.
    """
    size = np.linalg.norm(a, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    target = float(np.linalg.norm(y)) or 1.0
    # The triangle has the same right singular vectors as the tall matrix.
    triangle = np.linalg.qr(np.column_stack([a / size, y / target]), mode="r")
    last = np.linalg.svd(triangle)[2][-1]
    if abs(last[-1]) < SMALLEST_LAST:
        return None
    return np.asarray(-last[:-1] / last[-1] / size * target)


@dataclass(frozen=True)
class Total:
    """Total least squares on the weighted system, columns and torques scaled to unit norm."""

    name = "total"

    def __call__(
        self, system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
    ) -> Fit:
        """Solve a system.

        Raises
        ------
        FitError
            When total least squares has no solution.
        """
        first = solve(system, settings, progress)
        if first.stopped:
            return first
        found = total_least_squares(system.w * first.weights[:, None], system.y * first.weights)
        if found is None:
            raise FitError(
                "total least squares has no solution: the last singular vector has no component along the torques"
            )
        return with_weights(system, settings, first, found, first.weights)
