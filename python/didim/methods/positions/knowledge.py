"""Unknowns that a log of positions identifies, from the derivatives of the simulated positions.

The loop ``M ddq + n + Ia ddq + Fv dq + Fc s(dq) = sat(kp (r(t - d) - q - b) - kv dq)`` stays the same when every torque takes
a factor, when kv and Fv exchange a part, and when slow commands exchange ``d`` and ``(Fv + kv) / kp``. With ``A = J^T J`` of unit
columns, ``f_k = sqrt((A^-1)_kk)`` says by how much the other unknowns widen the interval of unknown k: 1 where it stands alone,
without bound where a combination of the others moves the robot alike. Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array, unit_diagonal
from ..._tools.words import brief, series
from ...experiment.unknown import SOFT
from ...robot.robot import Robot
from .columns import Column
from .problem import Problem
from .search import Search

NULL_SHARE, NULL_M = 0.02, 1e-6
"""An unknown whose whole range moves the joints (rms) by less than this share of the errors, or by this (rad, m), has no effect."""
ALONE: Mapping[str, float] = {
    "delay_s": 20.0,
    "lag_s": 20.0,
    "bias_rad": math.inf,
    **dict.fromkeys(SOFT, math.inf),
}
"""Largest `f` at which an unknown of a drive is separated from the others, whatever the errors. On the Go2 log the delay has
12, with an error curve whose minimum is at zero; biases have their own sentence where gravity does not show them."""
USUALLY_ALONE = 3.0
"""Largest `f` at which any other unknown is separated."""
SHARE = {"kp": 0.5, "kv": 1.0, "saturation": 0.5, "acceleration": 0.5}
"""Change of an unknown, as a share, whose unique effect must exceed the errors; for delays and lags it is one sample of the
log. On the Go2 log, where kp is 20 N.m/rad and a free one ends between 17.5 and 19.7 with Fv at zero, half of kp has 0.04 to
0.24 of the errors; on a simulated hobby arm whose steps saturate, 1.7 to 13 times the errors."""
MOST_PLACES = 3
"""Largest number of joints that a sentence names one by one."""
LEAST_ERROR = 1e-4
"""Lower bound of the errors (rad or m): no robot has smaller ones, and all regular unknowns would count as identified."""
SINGULAR = 1e3
"""Smallest `f` of an unknown, of any kind, that is exchangeable with others."""
WEAK, MOST_WEAK = 5.0, 6
"""`f` from which a result says with what an unknown is exchanged, and the most sentences of that kind."""
SMALLEST = 1e-13
"""Smallest eigenvalue of the scaled matrix that is inverted; below it is rounding."""


RATIOS = "only (J + Ia)/kp, (Fv + kv)/kp, Fc/kp and Off/kp are known, as all torques may take a factor"
"""Sentence on a gain that is exchangeable with the torques of its joint, also where a search has taken all of them to zero."""
WITHOUT_EFFECT = {
    "kp": RATIOS,
    "bias_rad": "a bias has no effect where gravity does not turn with the joint, for the loop reads that encoder",
    "saturation": "the limit of the torque is never reached",
    "acceleration": "no command needs that acceleration",
}
"""Sentence on an unknown that moves nothing, by its kind; others have no effect on the motion."""
EXCHANGEABLE = {
    "kp": RATIOS,
    "kv": "only Fv + kv is known, for without saturation they are one parameter",
    "delay_s": "slow commands show only {kind} + (Fv + kv)/kp",
    "lag_s": "slow commands show only {kind} + (Fv + kv)/kp",
    "bias_rad": "a bias moves the robot as {others} does",
}
"""Sentence on an unknown that is exchangeable with others, by its kind; others move the robot as these do."""


def widening(a: Array, use: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return `f` of the columns `use`, and the correlations of their estimates."""
    values, vectors = np.linalg.eigh(unit_diagonal(a[np.ix_(use, use)])[0])
    correlation, f = unit_diagonal((vectors / np.maximum(values, SMALLEST)) @ vectors.T)
    return f, correlation


def unidentified(now: Search, *, strict: bool = False, error: float | None = None) -> dict[int, str]:
    """Return unknowns that the log does not identify, and what is known in their place (`Search.held`).

    Parameters
    ----------
    now : Search
        Errors and derivatives at an estimate.
    strict : bool
        Return only those beyond doubt: before a search the derivatives are those of other parameters.
    error : float, optional
        Error (rad or m, rms) that an effect is compared with; that of the search by default.
    """
    problem, rows = now.problem, now.rows
    a, _ = now.normal()
    if error is None:
        error = math.sqrt(now.squares / rows)
    free = now.free & ~np.isfinite([column.sigma for column in problem.columns])
    held = {}
    for k in np.flatnonzero(free).tolist():
        column = problem.columns[k]
        if math.sqrt(a[k, k] / rows) * _range(column) < max(0.0 if strict else NULL_SHARE * error, NULL_M):
            known = WITHOUT_EFFECT.get(column.kind, "{kind} has no effect on the motion of this log")
            held[k] = known.format(kind=column.kind)
            free[k] = False
    while True:
        use = np.flatnonzero(free & (np.diag(a) > 0.0))
        if not use.size:
            return held
        f, correlation = widening(a, use)
        excess = np.array(
            [
                _excess(problem, problem.columns[k], f[p], a[k, k], rows, error, strict)
                for p, k in enumerate(use.tolist())
            ]
        )
        # Of exchangeable unknowns the one of the drive is held, for the file or the reader knows it best.
        of_drive = np.array([problem.columns[k].of_drive for k in use])
        if (excess[of_drive] > 1.0).any():
            excess[~of_drive] = 0.0
        worst = int(np.argmax(excess))
        if excess[worst] <= 1.0:
            return held
        k = int(use[worst])
        sizes = np.abs(correlation[worst])
        sizes[worst] = 0.0
        partners = [problem.columns[use[p]].kind for p in np.argsort(-sizes)[:3] if sizes[p] > 0.5]
        others = brief(" and ".join(dict.fromkeys(partners)), 40) or "the others"
        column = problem.columns[k]
        known = EXCHANGEABLE.get(column.kind, "{kind} moves the robot as {others} do")
        held[k] = known.format(kind=column.kind, others=others)
        if column.kind == "bias_rad":
            held[k] += ", and Off has what there is"
        free[k] = False


def _excess(
    problem: Problem, column: Column, f: float, square: float, rows: int, error: float, strict: bool
) -> float:
    """Return how far an unknown is beyond the limits of identifiable ones: above 1 it is held."""
    if strict or not column.of_drive or f < ALONE.get(column.kind, USUALLY_ALONE):
        return float(f / SINGULAR)
    change = (
        1.0 / problem.rollouts[0].rate_hz
        if column.kind in ("delay_s", "lag_s")
        else SHARE[column.kind] * abs(column.start)
    )
    limbs = {k for k, limb in enumerate(problem.limbs) if {*column.joints} & {*limb.joints}}
    own = rows * len(limbs) / len(problem.limbs)
    unique = change * math.sqrt(square / own) / f
    return max(max(error, LEAST_ERROR) / max(unique, 1e-300), float(f / SINGULAR))


def _range(column: Column) -> float:
    span = column.high - column.low
    return span if math.isfinite(span) else max(abs(column.start), 1e3 * column.step)


def weak_pairs(now: Search, a: Array) -> list[str]:
    """Return sentences on unknowns that are identified well only in combination with another, by the normal matrix."""
    use, problem = now.used(a), now.problem
    if use.size < 2:
        return []
    f, correlation = widening(a, use)
    widths = f / np.sqrt(np.diag(a)[use])
    pairs: dict[frozenset[int], str] = {}
    for index in np.argsort(-f).tolist():
        if f[index] < WEAK or len(pairs) == MOST_WEAK:
            break
        row = correlation[index].copy()
        row[index] = 0.0
        other = int(np.argmax(np.abs(row)))
        pair = frozenset((index, other))
        if abs(row[other]) < 0.9 or pair in pairs:
            continue
        one, two = problem.columns[use[index]], problem.columns[use[other]]
        ratio = -row[other] * widths[index] / widths[other]
        pairs[pair] = (
            f"{where_of(problem.robot, one)}: {one.name} {'+' if ratio > 0 else '-'} {abs(ratio):.2g} {two.name} is known better "
            f"(correlation {row[other]:.2f}); {_advice(one, two)}"
        )
    return list(pairs.values())


def _advice(one: Column, two: Column) -> str:
    kinds = {one.kind, two.kind}
    if kinds & {"delay_s", "lag_s", "Ia"}:
        return "steps, or a chirp up to the loop's bandwidth, separate them"
    if kinds & {"kp", "kv", "saturation"}:
        return "steps that reach the limit of the torque separate them"
    return "other speeds and poses separate them"


def where_of(robot: Robot, column: Column) -> str:
    """Return the joints of a column as text."""
    if len(column.joints) == 1:
        joint = column.joints[0]
        return robot.joint_names[joint] if robot.joint_names else f"joint {joint + 1}"
    return "all joints" if len(column.joints) == robot.n_dof else column.name


def held_at(now: Search, k: int) -> str:
    """Return what is known in the place of an unknown, and the value that it is held at."""
    column = now.problem.columns[k]
    return f"{now.held[k]}; {column.kind} is held at {now.theta[k]:.6g} {column.unit}"


def by_sentence(now: Search) -> dict[str, list[Column]]:
    """Return unknowns that are held by sentence, with joints of equal sentences together."""
    groups: dict[str, list[Column]] = {}
    problem = now.problem
    for k in sorted(now.held):
        groups.setdefault(held_at(now, k), []).append(problem.columns[k])
    columns_by_sentence = {}
    for known, columns in groups.items():
        places = [where_of(problem.robot, column) for column in columns]
        title = series(places, 60) if len(places) <= MOST_PLACES else f"{places[0]} to {places[-1]}"
        columns_by_sentence[f"{title}: {known}"] = columns
    return columns_by_sentence
