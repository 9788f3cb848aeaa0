"""Hypotheses on errors that last: friction that the model lacks, and torques that come late.

Tested in ``tests/test_verdict_faults.py``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...._tools.arrays import Array
from ...._tools.words import joints_text
from ....model.dynamics import inverse_dynamics
from .hypothesis import Hypothesis
from .products import Products
from .rows import Rows

SPEEDS = (0.03, 0.1, 0.3)
"""Stribeck velocities that are tried, as shares of the largest speed of a joint."""
SMALLEST_SAMPLES = 0.2
"""Delays below it are differences of filters, in samples."""
CLEARLY = 0.97
"""Share of a joint's squared error that a further friction term must not exceed there for the joint to be named."""


def frictions(rows: Rows) -> Iterator[Hypothesis]:
    """Return friction that differs by direction, and friction that falls with speed."""
    for number, (what, term, columns) in enumerate(laws(rows)):
        products = rows.with_columns(columns)
        joints = _better(rows, products)
        if len(joints):
            yield Hypothesis(
                code="friction",
                sentence=f"the friction of {joints_text(joints)} {what}, which no term of the model has",
                advice=f"Write {term}",
                joints=tuple(joint + 1 for joint in joints),
                score=products.score(rows.weights),
                simplicity=6 if number == 0 else 7,
                severity="doubtful",
            )


def laws(rows: Rows) -> Iterator[tuple[str, str, Array]]:
    """Return laws of friction: what they say, how they are declared, and their columns, (n_dof, n_rows, n_dof)."""
    n = rows.robot.n_dof
    dq = [part.dq for part in rows.parts]
    top = np.maximum(np.max([np.abs(values).max(axis=0) for values in dq], axis=0), 1e-9)
    sign = [np.tanh(values / _smoothing(rows, top)) for values in dq]
    found = []
    if rows.robot.friction.model != "asymmetric":
        one_way = [np.maximum(v, 0.0) for v in dq]
        found.append(("differs by direction", 'model = "asymmetric" under [friction]', one_way))
    for share in SPEEDS:
        falls = [s * np.exp(-((v / (share * top)) ** 2)) for v, s in zip(dq, sign, strict=True)]
        found.append(("falls with speed (Stribeck)", _falling(rows), falls))
    for what, term, signals in found:
        values = rows.reduced(signals)
        columns = np.zeros((n, values.shape[1], n))
        columns[np.arange(n), :, np.arange(n)] = values
        yield what, term, columns


def _falling(rows: Rows) -> str:
    """Return what to write for friction that falls with speed: in simulators it is often a sign that is smooth."""
    smooth = "" if rows.robot.friction.coulomb == "tanh" else '; coulomb = "tanh" if a simulator made the log'
    return f'stribeck = true or terms = "auto" under [friction]{smooth}'


def _smoothing(rows: Rows, top: Array) -> Array:
    friction = rows.robot.friction
    own = np.asarray(friction.smoothing) if friction.coulomb == "tanh" else np.zeros(len(top))
    return np.maximum(own if own.shape == top.shape else 0.0, 1e-3 * top)


def _better(rows: Rows, products: Products) -> list[int]:
    """Return the joints that further columns explain better on stretches not fitted."""
    weights, ones = rows.weights[None], np.ones((1, rows.robot.n_dof))
    squares = [item.unseen(weights, ones)[0] for item in (rows.declared, products)]
    return [int(joint) for joint in np.flatnonzero(squares[1] < CLEARLY * squares[0])]


def lasting_columns(rows: Rows) -> Array:
    """Return the columns of a delay and of all friction laws together, (n_dof, n_rows, m)."""
    return np.concatenate([_slopes(rows)[:, :, None], *(columns for _, _, columns in laws(rows))], axis=2)


def _slopes(rows: Rows) -> Array:
    """Return the change of each joint's torque in a sample, by the declared model, (n_dof, n_rows)."""
    beta = (rows.x / rows.declared.scale)[: rows.w.shape[2]]
    x = rows.robot.base_parameters.lift(beta)
    return rows.reduced(
        [np.gradient(inverse_dynamics(rows.robot, p.q, p.dq, p.ddq, x), axis=0) for p in rows.parts]
    )


def delays(rows: Rows, rate_hz: float) -> Iterator[Hypothesis]:
    """Return the torques of all joints late by as much as fits best."""
    values = _slopes(rows)
    products = rows.with_columns(values[:, :, None])
    place = rows.w.shape[2]
    late = -float((products.solution(rows.weights) / products.scale)[place])
    if abs(late) < SMALLEST_SAMPLES:
        return
    yield Hypothesis(
        code="delay",
        sentence=f"the torques look {abs(late):.2g} samples ({1e3 * abs(late) / rate_hz:.2g} ms) "
        f"{'behind' if late > 0.0 else 'ahead of'} the motion",
        advice='Write compensate_samples = "estimate" under [delay]',
        score=products.score(rows.weights),
        simplicity=1,
        value=late,
    )
