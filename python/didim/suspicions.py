"""What a log may have wrong, seen in a linear system (7): a torque of the wrong sign, torques of two joints exchanged.

Parameters belong to several joints, so that torques that contradict each other leave a large residual. If turning one joint's
sign, or exchanging two, takes most of it away, that is what happened. Tested in ``tests/test_suspicions.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from .least_squares import LinearSystem

Array = NDArray[np.float64]

CLEAR = 0.5
"""Share of the residual that must be left at most for a suspicion."""


def suspicions(system: LinearSystem) -> list[str]:
    """Sentences on torques that look turned or exchanged; empty for a sound log.

    Parameters
    ----------
    system : LinearSystem
        Rows joint by joint, along measured or simulated motion.
    """
    n = len(system.joints)
    sizes = system.norms(system.y)
    if n < 2 or not (sizes > 0.0).all():
        return []
    # Joints count alike, whatever their torques are.
    scale = np.empty(system.y.size)
    for rows, size in zip(system.joints, sizes, strict=True):
        scale[rows] = 1.0 / size
    w = system.w * scale[:, None]
    w /= np.linalg.norm(w, axis=0)
    length = system.joints[0].stop - system.joints[0].start
    y = (system.y * scale).reshape(n, length)
    # What of each joint's torque, put in each joint's rows, the columns see: every combination below is a sum of these.
    seen = np.einsum("jrb,ir->ijb", w.reshape(n, length, -1), y)
    try:
        factor = np.linalg.cholesky(w.T @ w)
    except np.linalg.LinAlgError:
        return []

    def residual(order: Sequence[int], signs: Array) -> float:
        told = np.einsum("j,jb->b", signs, seen[list(order), range(n)])
        return float(np.sqrt(max(0.0, n - np.sum(np.linalg.solve(factor, told) ** 2))))

    places, ones = list(range(n)), np.ones(n)
    as_logged = residual(places, ones)
    found: list[tuple[float, str]] = []
    for joint in range(n):
        signs = ones.copy()
        signs[joint] = -1.0
        found.append(
            (residual(places, signs), f"the torque of joint {joint + 1} looks as if its sign were wrong")
        )
    for i, j in combinations(range(n), 2):
        order = places.copy()
        order[i], order[j] = j, i
        sentence = f"the torques of joints {i + 1} and {j + 1} look as if they were exchanged"
        found.append((residual(order, ones), sentence))
    best, sentence = min(found)
    if best < CLEAR * as_logged:
        return [
            f"{sentence}: without that the residual falls from {100.0 * as_logged / np.sqrt(n):.3g} % of the torques to "
            f"{100.0 * best / np.sqrt(n):.3g} %"
        ]
    return []
