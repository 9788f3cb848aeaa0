"""Findings on model errors: missing friction laws and late torques, graded by the shift of the parameters.

The columns of a law, or of the change of each torque in a sample, stand beside those of the model. With them the parameters move by

    (beta_h - beta) / sigma

and that, not significance, says whether the result can be used without. Tested in ``tests/test_evidence_causes.py``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .._tools.arrays import Array, quotient
from ..model.dynamics import rigid_torque
from ..regression.delay import DelayEstimate
from ..result.finding import Finding, Remedy
from ..result.identification import Identification
from .products import Judged
from .rows import LogRows
from .thresholds import (
    BLOCKS_BETTER,
    DELAY_DOUBTFUL,
    DELAY_WRONG,
    FRICTION_D,
    FRICTION_EFFECT,
    FRICTION_SHIFT,
    NAMED,
    SIZE_DOUBTFUL,
    SMALLEST_SAMPLES,
)

SPEEDS = (0.03, 0.1, 0.3)
"""Stribeck velocities that are tried, as shares of a joint's largest speed."""
FALLING = frozenset({"stribeck", "atan"})
"""Laws by which a model's friction falls with speed."""
HOLD = (0.3, 0.7)
"""Range of delays, in samples ahead of the motion, explained by the hold of a digital controller at the log's rate."""
SMALLEST_GAIN = 0.05
"""Smallest share of the residual that delays joint by joint must remove to be reported."""
ESTIMATE_DELAY = Remedy(
    file="experiment", table="[delay]", key="compensate_samples", action="set", value="estimate"
)
"""Edit that has delays estimated and compensated."""
CLEARLY = 0.97
"""Ratio of a joint's squared error with a further friction term to that without, below which the joint is named."""


def friction_findings(rows: LogRows, fit: Identification | None, *, chosen: bool) -> list[Finding]:
    """Return friction that the model lacks: the law of the score test, or one that differs by direction.

    Parameters
    ----------
    rows : LogRows
        The log.
    fit : Identification or None
        The result, with the score test of its residual (`didim.regression.friction.alarm`) where its method has one; else all laws
        are tried here.
    chosen : bool
        Whether friction terms were chosen already (``terms = "auto"``): then none is missed.
    """
    if chosen:
        return []
    alarm = None if fit is None or fit.uncertainty is None else fit.uncertainty.friction
    tested = alarm is not None and bool(alarm.tested)
    std = np.zeros(0) if fit is None else fit.std
    if tested and alarm is not None and alarm.raised and fit is not None and fit.uncertainty is not None:
        noise = fit.uncertainty.without_shift(fit.std)
        shift = quotient(alarm.shift[: len(noise)], noise)
        return _missing(
            alarm.law,
            [joint + 1 for joint in alarm.joints],
            float(shift.max(initial=0.0)),
            rows,
            included=fit.uncertainty.kind == "jackknife",
            laws={law: [joint + 1 for joint in joints] for law, joints in alarm.laws.items()},
        )
    trials = []
    for law, columns in laws(rows):
        if tested and law != "asymmetric":
            continue
        judged = rows.with_columns(columns).judged()
        d = judged.against(rows.declared)
        explained = rows.declared.unseen.sum(axis=1) - judged.unseen.sum(axis=1)
        seen = (explained > FRICTION_EFFECT**2 * np.sum(np.square(rows.y), axis=1)).any()
        if seen and d <= FRICTION_D and judged.better_blocks(rows.declared) >= BLOCKS_BETTER:
            trials.append((d, law, judged))
    if not trials:
        return []
    _, law, judged = min(trials, key=lambda trial: trial[0])
    ratio = judged.unseen.sum(axis=1) / rows.declared.unseen.sum(axis=1)
    joints = np.flatnonzero(ratio <= max(CLEARLY, float(ratio.min())))
    shift = shifts(rows, judged, std)
    return _missing(law, [int(j) + 1 for j in joints], float(shift.max()), rows, included=False)


def _missing(
    law: str,
    joints: list[int],
    shift: float,
    rows: LogRows,
    *,
    included: bool,
    laws: dict[str, list[int]] | None = None,
) -> list[Finding]:
    key, value = ("model", "asymmetric") if law == "asymmetric" else ("terms", "auto")
    return [
        Finding(
            code="friction",
            grade="doubtful" if shift > FRICTION_SHIFT else "note",
            joints=tuple(joints),
            effect=shift,
            remedy=Remedy(file="experiment", table="[friction]", key=key, action="set", value=value),
            facts={
                "law": law,
                "laws": laws or {law: joints},
                "smooth": rows.robot.friction.coulomb == "tanh",
                "included": included,
            },
        )
    ]


def delay_findings(rows: LogRows, std: Array, *, obeyed: bool) -> list[Finding]:
    """Return torques of all joints late by as much as fits best, if the parameters move with it; none once it was estimated."""
    if obeyed:
        return []
    judged = rows.with_columns(_slopes(rows)[:, :, None]).judged()
    late = -float(judged.beta[-1])
    d = judged.against(rows.declared)
    effect = float(np.sqrt(np.mean(shifts(rows, judged, std) ** 2)))
    better = d <= FRICTION_D and judged.better_blocks(rows.declared) >= BLOCKS_BETTER
    if abs(late) < SMALLEST_SAMPLES or not better or effect < DELAY_DOUBTFUL:
        return []
    # A real delay that moves parameters little of what they are is no reason to call a small error wrong.
    large = rows.declared_seen.sum() > SIZE_DOUBTFUL**2 * np.sum(np.square(rows.y))
    return [
        Finding(
            code="delay",
            grade="wrong" if effect > DELAY_WRONG and d <= NAMED and large else "doubtful",
            value=late,
            deviation=float(judged.std[-1]),
            effect=effect,
            remedy=ESTIMATE_DELAY,
            facts={
                "seconds": abs(late) / rows.parts[0].rate_hz,
                "held": -HOLD[1] < late < -HOLD[0],
            },
        )
    ]


def joint_delay_findings(estimate: DelayEstimate, declared: Array, rate_hz: float) -> list[Finding]:
    """Return the torques of some joints, or of all, that are late by an estimate joint by joint.

    This finds delays of several samples, and of single joints, which `delay_findings` does not.

    Parameters
    ----------
    estimate : DelayEstimate
        Delays of the log.
    declared : (n,) array
        Delays (samples) that the experiment compensates.
    rate_hz : float
        Samples per second.
    """
    late = np.array(estimate.joints) - declared
    worst = float(late[np.argmax(np.abs(late))])
    if abs(worst) < SMALLEST_SAMPLES or estimate.gain < SMALLEST_GAIN:
        return []
    alike = np.flatnonzero(np.abs(late - worst) < SMALLEST_SAMPLES)
    return [
        Finding(
            code="delay",
            grade="doubtful",
            joints=() if len(alike) == len(late) else tuple(int(joint) + 1 for joint in alike),
            value=worst,
            remedy=ESTIMATE_DELAY,
            facts={
                "seconds": abs(worst) / rate_hz,
                "gain": estimate.gain,
                "samples": [round(value, 2) for value in estimate.joints],
            },
        )
    ]


def shifts(rows: LogRows, judged: Judged, std: Array) -> Array:
    """Return by how many standard deviations each base parameter moves, (b,)."""
    b = len(rows.beta)
    own = rows.declared.std[:b]
    size = np.maximum(np.where(std > 0.0, std, own) if len(std) == b else own, np.finfo(float).tiny)
    return np.asarray(np.abs(judged.beta[:b] - rows.beta) / size)


def laws(rows: LogRows) -> Iterator[tuple[str, Array]]:
    """Return the laws of friction that the model lacks, with their columns, (n, n_rows, n)."""
    n, friction = rows.n, rows.robot.friction
    dq = [part.dq for part in rows.parts]
    top = np.maximum(np.max([np.abs(values).max(axis=0) for values in dq], axis=0), 1e-9)
    sign = [np.tanh(values / _smoothing(rows, top)) for values in dq]
    laws_tested: list[tuple[str, list[Array]]] = []
    if friction.model != "asymmetric":
        laws_tested.append(("asymmetric", [np.maximum(v, 0.0) for v in dq]))
    if not any(term.law in FALLING for term in friction.terms):
        for share in SPEEDS:
            falls = [s * np.exp(-((v / (share * top)) ** 2)) for v, s in zip(dq, sign, strict=True)]
            laws_tested.append(("stribeck", falls))
    for law, signals in laws_tested:
        values = rows.reduced(signals)
        columns = np.zeros((n, values.shape[1], n))
        columns[np.arange(n), :, np.arange(n)] = values
        yield law, columns


def _smoothing(rows: LogRows, top: Array) -> Array:
    friction = rows.robot.friction
    own = np.asarray(friction.smoothing) if friction.coulomb == "tanh" else np.zeros(len(top))
    return np.maximum(own if own.shape == top.shape else 0.0, 1e-3 * top)


def _slopes(rows: LogRows) -> Array:
    """Return the change of each joint's torque in a sample, by the declared model without friction, (n, n_rows)."""
    x = rows.robot.base_parameters.lift(rows.beta)
    return rows.reduced(
        [np.gradient(rigid_torque(rows.robot, p.q, p.dq, p.ddq, x), axis=0) for p in rows.parts]
    )
