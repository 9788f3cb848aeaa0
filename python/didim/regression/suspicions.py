"""What a log may have wrong, seen in a linear system (7): a torque of the wrong sign, torques of two joints exchanged.

Most parameters belong to several joints, so that torques that contradict each other leave a large residual. If turning one
joint's sign, or exchanging two, takes most of it away, that is what happened. Where the parameters can swallow a wrong sign,
as with the errors of a real log, friction cannot: it would drive the joint. Tested in ``tests/test_suspicions.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import combinations

import numpy as np

from .._tools.arrays import Array
from .fit import Fit
from .linear_system import LinearSystem

SUSPICION_RESIDUAL = 0.5
"""Largest share of the residual that reversed or exchanged torques may leave for a suspicion."""
DRIVING_SIGMA = 5.0
"""Standard deviations by which viscous friction must be negative for a suspicion."""


def suspicions(system: LinearSystem, fit: Fit) -> list[str]:
    """Sentences on torques that look turned or exchanged; empty for a sound log.

    Parameters
    ----------
    system : LinearSystem
        Rows joint by joint, along measured or simulated motion.
    fit : Fit
        Its solution.
    """
    found = _contradiction(system)
    driving = None if found else driving_friction(system, fit)
    return found if driving is None else [driving[1]]


def _contradiction(system: LinearSystem) -> list[str]:
    """Return the change of one sign, or the exchange of two joints, that takes most of the residual away."""
    from scipy.linalg import solve_triangular

    n = len(system.joints)
    sizes = system.norms(system.y)
    if n < 2 or not (sizes > 0.0).all():
        return []
    length = system.joints[0].stop - system.joints[0].start
    w = (system.w / np.linalg.norm(system.w, axis=0)).reshape(n, length, -1)
    y = system.y.reshape(n, length)
    grams = w.transpose(0, 2, 1) @ w
    # What of each joint's torque, put in each joint's rows, the columns see: every combination below is a sum of these.
    seen = (y @ w).transpose(1, 0, 2)

    @cache
    def factored(order: tuple[int, ...]) -> Array | None:
        """Cholesky factor of the normal equations, the same whatever the signs are."""
        try:
            return np.linalg.cholesky(np.tensordot(sizes[list(order)] ** -2.0, grams, 1))
        except np.linalg.LinAlgError:
            return None

    def solved(order: Sequence[int], signs: Array) -> tuple[float, Array]:
        """Residual and solution with the torque of joint ``order[j]`` in the rows of joint j; joints count alike."""
        told = (signs * sizes[list(order)] ** -2.0) @ seen[list(order), range(n)]
        factor = factored(tuple(order))
        if factor is None:
            return float("inf"), np.zeros_like(told)
        half = solve_triangular(factor, told, lower=True, check_finite=False)
        solution = solve_triangular(factor, half, lower=True, trans="T", check_finite=False)
        return float(np.sqrt(max(0.0, n - float(half @ half)))), solution

    places, ones = list(range(n)), np.ones(n)
    as_logged, _ = solved(places, ones)
    viscous = [index for index, name in enumerate(system.names) if name.startswith("Fv")]
    found: list[tuple[float, str]] = []
    for joint in range(n):
        signs = ones.copy()
        signs[joint] = -1.0
        left, solution = solved(places, signs)
        # To turn all the others leaves as much, with all parameters turned: friction tells which of the two it is.
        if np.sum(np.sign(solution[viscous])) < 0.0:
            signs = -signs
        found.append((left, _turned(np.flatnonzero(signs < 0.0).tolist())))
    for i, j in combinations(range(n), 2):
        order = places.copy()
        order[i], order[j] = j, i
        sentence = f"the torques of joints {i + 1} and {j + 1} look as if they were exchanged"
        found.append((solved(order, ones)[0], sentence))
    best, sentence = min(found)
    if not best < SUSPICION_RESIDUAL * as_logged < np.inf:
        return []
    percent = 100.0 / np.sqrt(n)
    return [
        f"{sentence}: without that the residual falls from {percent * as_logged:.3g} % of the torques to "
        f"{percent * best:.3g} %"
    ]


def driving_friction(system: LinearSystem, fit: Fit) -> tuple[list[int], str] | None:
    """Return the joints, from 0, whose friction would drive them, and a sentence on it; None for a sound log."""
    std = np.sqrt(np.diag(fit.covariance))
    values = dict(zip(system.names, zip(fit.solution, std, strict=True), strict=True))
    turned, told = [], []
    for joint in range(len(system.joints)):
        # With asymmetric friction each direction has its own.
        viscous = [values[name] for name in _of(values, f"Fv{joint + 1}")]
        names = [*_of(values, f"Fv{joint + 1}"), *_of(values, f"Fc{joint + 1}")]
        driving = all(value < -DRIVING_SIGMA * sigma for value, sigma in viscous)
        if viscous and driving and all(values[name][0] < 0.0 for name in names):
            turned.append(joint)
            told += [f"{name} = {values[name][0]:.3g}" for name in names]
    if not turned:
        return None
    return turned, f"{_turned(turned)}: friction would drive the robot ({', '.join(told)})"


def _of(values: dict[str, tuple[float, float]], name: str) -> list[str]:
    return [key for key in values if key.rstrip("+-") == name]


def _turned(joints: Sequence[int]) -> str:
    if len(joints) == 1:
        return f"the torque of joint {joints[0] + 1} looks as if its sign were wrong"
    *first, last = (str(joint + 1) for joint in joints)
    return f"the torques of joints {', '.join(first)} and {last} look as if their signs were wrong"
