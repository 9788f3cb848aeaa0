"""Torques read otherwise: a sign turned, another gain, two exchanged. Tested in ``tests/test_evidence_causes.py``."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from ..products import Declared
from .hypothesis import Hypothesis

GAINS = np.log([0.2, 0.35, 0.6, 0.8, 1.0, 1.25, 1.7, 2.9, 5.0])
"""Logarithms of the gains that are tried; the best one is refined between its neighbours, and an end of the list is no estimate."""
SMALLEST = 0.05
"""Logarithm of a gain below which an error of the model is as likely as one of the gain."""


def signs(rows: Declared) -> Iterator[Hypothesis]:
    """Return each torque turned, and all of them, which only friction sees."""
    n = rows.n
    yield Hypothesis(code="torque-sign", joints=tuple(range(1, n + 1)), factors=-np.ones(n))
    for joint in range(n if n > 1 else 0):
        factors = np.ones(n)
        factors[joint] = -1.0
        yield Hypothesis(code="torque-sign", joints=(joint + 1,), factors=factors)


def gains(rows: Declared) -> Iterator[Hypothesis]:
    """Return the gain of each torque that fits best; a single joint fits at any gain."""
    from scipy.optimize import minimize_scalar

    n = rows.n
    for joint in range(n if n > 1 else 0):

        def cost(value: float, joint: int = joint) -> float:
            return float(np.sum(np.log(rows.products.seen(None, _factors(n, joint, value)))))

        costs = [cost(value) for value in GAINS]
        k = int(np.argmin(costs))
        at_end = k in (0, len(GAINS) - 1)
        best = float(GAINS[k])
        if not at_end:
            best = float(
                minimize_scalar(
                    cost,
                    bounds=(GAINS[k - 1], GAINS[k + 1]),
                    method="bounded",
                    options={"xatol": 5e-3, "maxiter": 10},
                ).x
            )
        if abs(best) > SMALLEST:
            yield Hypothesis(
                code="drive-gain",
                joints=(joint + 1,),
                factors=_factors(n, joint, best),
                value=float(np.exp(best)),
                at_end=at_end,
            )


def exchanges(rows: Declared) -> Iterator[Hypothesis]:
    """Return each two torques exchanged."""
    for i, j in combinations(range(rows.n), 2):
        order = list(range(rows.n))
        order[i], order[j] = j, i
        yield Hypothesis(code="swapped-torques", joints=(i + 1, j + 1), order=tuple(order))


def _factors(n: int, joint: int, log_gain: float) -> np.ndarray:
    factors = np.ones(n)
    factors[joint] = np.exp(log_gain)
    return factors
