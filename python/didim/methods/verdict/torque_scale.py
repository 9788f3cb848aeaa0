"""Hypothesis: the torque of a joint has another gain, or the other sign. Tested in ``tests/test_verdict_faults.py``."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from .hypothesis import Hypothesis
from .rows import Rows

LOGS = np.log([0.4, 0.6, 0.8, 1.25, 1.7, 2.5])
"""Gains that are tried; the best one is refined between its neighbours."""
SMALLEST = 0.05
"""A gain nearer to 1 is an error of the model as likely as one of the gain."""


def torque_scales(rows: Rows) -> Iterator[Hypothesis]:
    """Return the gain that fits each joint best, and its turned sign."""
    n = rows.robot.n_dof
    if n < 2:  # a single joint fits at any scale
        return
    for joint in range(n):

        def at(value: float, joint: int = joint) -> float:
            gain = np.ones(n)
            gain[joint] = value
            # The error of a torque that was logged too large is too large by as much.
            weights = rows.weights.copy()
            weights[joint] /= min(value**2, 1.0) if value < 0.0 else 1.0
            return rows.declared.score(weights, gain)

        factor, score = _refined(at)
        name = f"joint {joint + 1}"
        if abs(np.log(factor)) > SMALLEST:
            yield Hypothesis(
                code="drive-gain",
                sentence=f"the torque of {name} looks {factor:.3g} times too large"
                if factor > 1.0
                else f"the torque of {name} looks too small: {factor:.3g} times what it is",
                advice=f"Divide gain under [recording.torque] by {factor:.3g} for this joint, or look at its gear ratio",
                joints=(joint + 1,),
                score=score,
                simplicity=1,
                value=factor,
            )
        yield Hypothesis(
            code="torque-sign",
            sentence=f"the torque of {name} looks as if its sign were wrong",
            advice="Turn the sign of the gain or of the column under [recording.torque]",
            joints=(joint + 1,),
            score=at(-1.0),
            simplicity=0,
        )


def _refined(at: Callable[[float], float]) -> tuple[float, float]:
    """Return the best factor and its score."""
    from scipy.optimize import minimize_scalar

    costs = [at(float(np.exp(value))) for value in LOGS]
    k = int(np.argmin(costs))
    low = LOGS[max(k - 1, 0)] - (0.5 if k == 0 else 0.0)
    high = LOGS[min(k + 1, len(LOGS) - 1)] + (0.5 if k == len(LOGS) - 1 else 0.0)
    found = minimize_scalar(
        lambda value: at(float(np.exp(value))),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 5e-3, "maxiter": 12},
    )
    return float(np.exp(found.x)), float(found.fun)
