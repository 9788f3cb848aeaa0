r"""Recursive least squares: the triangle R of each joint, updated by the rows of every new chunk.

    [R_j z_j]  <-  triangle of [ f [R_j z_j] ; W_new Y_new ]          f = 1, or the root of a forgetting factor
    min sum_j |R_j x - z_j|^2 / s_j^2                                 the weighted solution (7) of all rows so far

The triangles contain all information for the solution, its residuals per joint and (10), in constant memory, so the weights can
be estimated at any time. The estimate equals that of all rows at once, for any chunks.
"""

from __future__ import annotations

import numpy as np

from .._tools.arrays import Array


class Triangles:
    """The triangles ``[R_j z_j]`` of the joints of a linear system.

    Parameters
    ----------
    n_joints, n_columns : int
        Joints, and columns of the observation matrix.
    forgetting : float
        Factor of the squared residuals of a row with every later row of its joint: in (0, 1]; 1 for no forgetting.

    Attributes
    ----------
    rows : float
        Rows of each joint so far; with forgetting the sum of their factors.
    """

    def __init__(self, n_joints: int, n_columns: int, forgetting: float = 1.0) -> None:
        self.n_columns, self.forgetting = n_columns, forgetting
        self.rows = 0.0
        # A joint does not depend on preceding links: its triangle only has nonzero columns, and the torques.
        self._columns = [np.zeros(0, dtype=np.intp) for _ in range(n_joints)]
        self._triangles: list[Array] = [np.zeros((0, 1)) for _ in range(n_joints)]

    def fold(self, w: Array, y: Array) -> None:
        """Fold rows into the triangles.

        Parameters
        ----------
        w : ndarray, shape (n, n_joints, n_columns)
            Rows of each joint, in the order of time.
        y : ndarray, shape (n, n_joints)
            Torques.
        """
        n = len(y)
        if n == 0:
            return
        factors: Array | None = None
        if self.forgetting < 1.0:
            factors = np.asarray(self.forgetting ** (0.5 * np.arange(n - 1, -1, -1)), dtype=np.float64)
        for joint in range(len(self._columns)):
            self._fold_one(joint, w[:, joint], y[:, joint], factors)
        memory = self.forgetting**n
        self.rows = memory * self.rows + (n if factors is None else float(np.sum(factors**2)))

    def merge(self, other: Triangles) -> None:
        """Fold the rows of another object, like new rows."""
        for joint, (rows, target) in enumerate(other.system()):
            self._fold_one(joint, rows, target, None)
        self.rows += other.rows

    def _fold_one(self, joint: int, w: Array, y: Array, factors: Array | None) -> None:
        """Fold rows (n, n_columns) and torques (n,) of a joint; forgetting multiplies each new row by its factor."""
        columns, triangle = self._columns[joint], self._triangles[joint]
        seen = np.asarray(w.any(axis=0))
        seen[columns] = True
        now = np.flatnonzero(seen)
        old = len(triangle)
        stacked = np.zeros((old + len(y), now.size + 1))
        stacked[:old, np.searchsorted(now, columns)] = triangle[:, :-1]
        stacked[:old, -1] = triangle[:, -1]
        stacked[old:, :-1] = w[:, now]
        stacked[old:, -1] = y
        if factors is not None:
            stacked[:old] *= self.forgetting ** (0.5 * len(y))
            stacked[old:] *= factors[:, None]
        few = len(stacked) <= now.size + 1
        self._columns[joint] = now
        self._triangles[joint] = stacked if few else np.asarray(np.linalg.qr(stacked, mode="r"))

    def system(self) -> list[tuple[Array, Array]]:
        """Return ``R_j`` over all columns, (k_j, n_columns), and ``z_j``, (k_j,), of each joint."""
        systems = []
        for columns, triangle in zip(self._columns, self._triangles, strict=True):
            rows = np.zeros((len(triangle), self.n_columns))
            rows[:, columns] = triangle[:, :-1]
            systems.append((rows, triangle[:, -1].copy()))
        return systems
