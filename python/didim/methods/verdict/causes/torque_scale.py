r"""Hypothesis: the torque of a joint has another gain, or the other sign. Tested in ``tests/test_verdict_faults.py``.

The gain of joint j is checked by the parameters that its torque shares with other joints. With ``p_j`` its modelled torque, on its
own rows, and ``M`` the projection beside all columns W, both weighted by the noise, the log of the gain has the information

    I_j = |M p_j|^2,    sigma_j^2 = m/(m - 1) sum_i (M p_j)_i^T rho_i)^2 / I_j^2

over m intervals of time, where rho is the residual: errors of the model that are correlated in time count as what they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ...._tools.arrays import Array
from ...._tools.words import joints_text
from ....result.verdict import Reason
from .hypothesis import Hypothesis
from .rows import Rows

LOGS = np.log([0.4, 0.6, 0.8, 1.25, 1.7, 2.5])
"""Gains that are tried; the best one is refined between its neighbours."""
SMALLEST = 0.05
"""A gain nearer to 1 is an error of the model as likely as one of the gain."""


UNCHECKED_SIGMA = 0.3
"""Standard deviation of the log of a gain from which a log does not check it: a doubled gain is 2.3 of these."""
INDEPENDENT = 1e-6
"""Singular values of columns with norm 1, against the largest: below it a combination of columns is rounding."""
INTERVALS = 20
"""Intervals of time m, as those of the jackknife."""


def unchecked(rows: Rows) -> Reason | None:
    """Return a note on the joints whose gain the log does not check; None where it checks all."""
    sigma, share = gain_information(rows)
    joints = [int(joint) for joint in np.flatnonzero(np.logical_not(sigma < UNCHECKED_SIGMA))]
    if rows.robot.n_dof < 2 or not joints:
        return None
    shares = ", ".join(f"{100.0 * share[joint]:.2g}" for joint in joints)
    one = len(joints) == 1
    return Reason(
        code="gain-unchecked",
        severity="note",
        sentence=f"the drive gain{'' if one else 's'} of {joints_text(joints)} cannot be checked by this log: only {shares} % of "
        f"the torque there depends on parameters that other joints determine",
        joints=tuple(joint + 1 for joint in joints),
        value=float(sigma[joints].max()),
    )


def gain_information(rows: Rows) -> tuple[Array, Array]:
    """Return the standard deviation of the log of each joint's gain, and the share of its torque that checks it, (n_dof,) each."""
    root = np.sqrt(rows.weights)
    n, n_rows, b = rows.w.shape
    columns = (rows.w * root[:, None, None] / rows.declared.scale[:b]).reshape(n * n_rows, b)
    left, triangle = np.linalg.qr(columns)
    inner, values, _ = np.linalg.svd(triangle)
    left = left @ inner[:, values > INDEPENDENT * values[0]]
    y = (rows.y * root[:, None]).reshape(-1)
    model = left @ (left.T @ y)
    residual = (y - model).reshape(n, n_rows)
    sigma, share = np.full(n, np.inf), np.zeros(n)
    intervals = np.arange(n_rows) * INTERVALS // n_rows
    for joint in range(n):
        own = np.zeros((n, n_rows))
        own[joint] = model.reshape(n, n_rows)[joint]
        beside = own.reshape(-1) - left @ (left.T @ own.reshape(-1))
        information = float(beside @ beside)
        if not information > 0.0:
            continue
        scores = np.bincount(intervals, np.sum(beside.reshape(n, n_rows) * residual, axis=0), INTERVALS)
        sigma[joint] = np.sqrt(INTERVALS / (INTERVALS - 1) * float(scores @ scores)) / information
        share[joint] = information / float(own[joint] @ own[joint])
    return sigma, share


def torque_scales(rows: Rows) -> Iterator[Hypothesis]:
    """Return the gain that fits each joint best, and its turned sign."""
    n = rows.robot.n_dof
    if n < 2:  # a single joint fits at any scale
        return
    for joint in range(n):

        def at(values: Array, joint: int = joint) -> Array:
            gains, weights = np.ones((len(values), n)), np.tile(rows.weights, (len(values), 1))
            gains[:, joint] = values
            # The error of a torque that was logged too large is too large by as much.
            weights[:, joint] /= np.where(values < 0.0, np.minimum(values**2, 1.0), 1.0)
            return rows.declared.scores(weights, gains)

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
            score=float(at(np.array([-1.0]))[0]),
            simplicity=0,
        )


def _refined(at: Callable[[Array], Array]) -> tuple[float, float]:
    """Return the best factor and its score."""
    from scipy.optimize import minimize_scalar

    k = int(np.argmin(at(np.exp(LOGS))))
    low = LOGS[max(k - 1, 0)] - (0.5 if k == 0 else 0.0)
    high = LOGS[min(k + 1, len(LOGS) - 1)] + (0.5 if k == len(LOGS) - 1 else 0.0)
    found = minimize_scalar(
        lambda value: float(at(np.exp([value]))[0]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 5e-3, "maxiter": 12},
    )
    return float(np.exp(found.x)), float(found.fun)
