"""Torques read otherwise: a sign turned, another gain or unit, two exchanged. Tested in ``tests/test_evidence_causes.py``."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from ..._tools.arrays import Array
from ..products import Declared
from .hypothesis import Hypothesis, best_factor, diagonal

GAINS = (0.2, 0.35, 0.6, 0.8, 1.0, 1.25, 1.7, 2.9, 5.0)
"""Gains that are tried; the best is refined between its neighbours, and the first and last are not estimates."""
SMALLEST = 0.05
"""Logarithm of a factor below which a model error is as likely as a wrong gain, gear or encoder."""

UNITS = {
    "mN.m": 1e3,
    "N.cm": 1e2,
    "kgf.cm": 100.0 / 9.80665,
    "kgf.m": 1.0 / 9.80665,
    "lbf.ft": 0.737562,
    "lbf.in": 8.85075,
}
"""Units of torque that are no choice of a file: their number in one N.m."""
SAME_UNIT = 0.03
"""Logarithm of a factor over that of a unit, up to which the unit is named."""
LEAST_GEAR = 5.0
"""Smallest gear ratio by which all torques are those of motors: gears of arms have 30 to 160, direct drives 1."""
PASSES = 3
"""Number of estimates of the factors of all joints, each beside what is fitted with its predecessor."""


def signs(rows: Declared) -> Iterator[Hypothesis]:
    """Return each torque turned, and all of them, which only friction sees."""
    n = rows.n
    yield Hypothesis(code="torque-sign", joints=tuple(range(1, n + 1)), factors=-np.ones(n))
    for joint in range(n if n > 1 else 0):
        yield Hypothesis(code="torque-sign", joints=(joint + 1,), factors=diagonal(n, joint, -1.0))


def gains(rows: Declared) -> Iterator[Hypothesis]:
    """Return the gain of each torque that fits best; a single joint fits at any gain, unless parameters are known."""
    n = rows.n
    for joint in range(n if n > 1 or rows.products.given is not None else 0):

        def squares(factor: float, joint: int = joint) -> Array:
            return rows.products.seen(None, diagonal(n, joint, factor))

        # The valley of a gain that is far off need not reach to 1, and products make each trial cheap.
        best, at_end = best_factor(squares, GAINS, promising=np.inf)
        if abs(np.log(best)) > SMALLEST:
            yield Hypothesis(
                code="drive-gain",
                joints=(joint + 1,),
                factors=diagonal(n, joint, best),
                value=best,
                at_end=at_end,
            )


def exchanges(rows: Declared) -> Iterator[Hypothesis]:
    """Return each two torques exchanged whose errors and those beside them become smaller in all, in sample."""
    products = rows.products
    declared, part = products.seen(), products.parts[0]
    least = np.log(products.alone / declared)
    for i, j in combinations(range(rows.n), 2):
        others = [c for c in range(rows.n) if c not in (i, j) and part[c] in part[[i, j]]]
        if least[j, i] + least[i, j] + least[others, others].sum() > 0.0:
            continue  # whatever parameters they share
        order = list(range(rows.n))
        order[i], order[j] = j, i
        if np.sum(np.log(products.seen(order) / declared)) <= 0.0:
            yield Hypothesis(code="swapped-torques", joints=(i + 1, j + 1), order=tuple(order))


def scaled(rows: Declared) -> Iterator[Hypothesis]:
    """Return all torques in another unit, beside known parameters; without them a log fits in any unit."""
    factor = rows.products.factor()
    if not (factor > 0.0 and abs(np.log(factor)) > SMALLEST):
        return
    unit = min(UNITS, key=lambda name: abs(np.log(factor / UNITS[name])))
    known = abs(np.log(factor / UNITS[unit])) < SAME_UNIT
    value = UNITS[unit] if known else factor
    yield Hypothesis(
        code="torque-unit",
        factors=np.full(rows.n, value),
        value=value,
        facts={"unit": unit} if known else {},
    )


def of_motors(rows: Declared) -> Iterator[Hypothesis]:
    """Return the torques of motors whose ratios no file says, beside known parameters."""
    products = rows.products
    if products.given is None:
        return
    factors = np.ones(rows.n)
    for _ in range(PASSES):
        beta = products.judged(None, factors).beta * products.scale
        moment = products.h.sum(axis=2)[np.arange(rows.n), np.arange(rows.n)] @ beta
        square = np.einsum("p,jpq,q->j", beta, products.g.sum(axis=1), beta)
        factors = moment / np.maximum(square, np.finfo(float).tiny)
    if (np.abs(factors) < 1.0 / LEAST_GEAR).all() and factors.all():
        yield Hypothesis(
            code="side",
            factors=factors,
            facts={
                "keys": ["torque"],
                "declared": "joint",
                "side": "motor",
                "ratios": (1.0 / factors).tolist(),
            },
        )
