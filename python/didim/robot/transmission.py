"""The reduction matrix between motors and joints. Tested in ``tests/test_recording.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._tools.toml import Table


def reduction_matrix(table: Table, n_dof: int) -> NDArray[np.float64]:
    """Read the reduction matrix R, (n_dof, n_dof), rows motors, columns joints: ``q_motor = R q``.

    Parameters
    ----------
    table
        ``[transmission]`` of a robot or an experiment file.
    n_dof
        Number of joints.

    Raises
    ------
    DidimError
        Of the table's class, when the matrix is singular.
    """
    reduction = np.array(table.matrix("reduction", n_dof, n_dof))
    for row in range(n_dof):
        if np.linalg.matrix_rank(reduction[: row + 1]) <= row:
            what = "zero" if not reduction[row].any() else "a combination of the rows before it"
            table.fail(f"reduction is singular: the row of motor {row + 1} is {what}")
    return reduction
