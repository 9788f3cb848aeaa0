"""Covariance of the unknowns by leaving out rollouts or stretches of the log: a jackknife of the last linear problem.

With ``A = J^T J`` and ``g = J^T e`` of all blocks and ``A_b``, ``g_b`` of one, the estimate without block b is
``theta - (A - A_b)^-1 (g - g_b)``, within the bounds. Model errors of a robot last, for they depend on its speed and its pose:
stretches of two lengths are left out, and the wider intervals hold. Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array, quotient
from ..._tools.words import series
from ...regression.jackknife import deletion_covariance
from ...result.finding import Finding, worded
from ...result.uncertainty import student_factor
from ...signal.noise import encoder_step, white_noise
from .problem import Problem
from .search import Search, at_bound, bounded_step, normal_of

STRETCHES = (24, 8)
"""Numbers of stretches that a log without rollouts is divided into, in the order in which they are tried."""
LEAST_STRETCH_S = 1.0
"""Shortest stretch (s): errors of positions are correlated for about the duration of a move."""
LEAST_SIDE = 6
"""Fewest blocks before or after a change along the log."""
DIVISIONS = (1 / 3, 1 / 2, 2 / 3)
"""Shares of the log at which it is divided to look for a change."""
FEWEST = 4
"""Smallest number of blocks for a covariance."""

USUAL_STEP_S, HALF = 2e-3, 0.5
"""Step (s) of most simulators, and the share by which a velocity at its end is late."""
CHORDS = 10
"""Steps with derivatives that stay: with 31 unknowns of an arm each leaves three quarters."""
CHANGED, CHANGED_SHARE = 3.4, 0.15
"""Change of an estimate along a log, in standard deviations and as a share of its value, from which it is reported. Simulated arms
with 1.3 to 2 times the friction in half of the log (3.99 and 20 % at least) and without (2.8 and 4 % at most) chose both;
the Go2 log, the legs and the pendulums only counted."""
LASTING = 2.0
"""Errors over their white part from which an error of the model is larger than the noise: blocks left out share it."""
LEAST_NOISE = 1e-4
"""Noise (rad or m) that an encoder has at least: logs of simulations have less, and no robot is as exact as they are."""


@dataclass(frozen=True)
class Intervals:
    """Standard deviations and intervals of the unknowns.

    Attributes
    ----------
    std : (n_columns,) array
        Standard deviations; zero where a column is held, NaN where there are too few blocks.
    half : (n_columns,) array
        Half of the 95 % intervals.
    covariance : (n_columns, n_columns) array
        Of the shorter stretches, scaled to `std`.
    white : (n_columns,) array
        Standard deviations for errors without correlation.
    blocks : int
        Blocks of the narrower cut.
    kind : str
        "rollouts" or "stretches".
    drift : (2, n_columns) array
        Largest change of the unknowns along the log, and its ratio to its standard deviation.
    """

    std: Array
    half: Array
    covariance: Array
    white: Array
    blocks: int
    kind: str
    drift: Array


def intervals(problem: Problem, now: Search) -> Intervals:
    """Return the intervals at the end of a search."""
    a, _ = normal_of(problem, now.errors, now.blocks)
    prior = np.array([1.0 / column.sigma**2 for column in problem.columns])
    rows = max(1, sum(e.size for e in now.errors))
    variance = sum(float(e @ e) for e in now.errors) / rows
    use = np.flatnonzero(now.free & (np.diag(a) > 0.0))
    count = len(problem.columns)
    white = np.zeros(count)
    whole = (a + np.diag(prior * variance))[np.ix_(use, use)]
    white[use] = np.sqrt(
        np.maximum(np.diag(_inverse(whole)), 0.0) * variance * rows / max(1, rows - len(use))
    )
    cuts, kind = _cuts(problem)
    best = np.zeros((count, count))
    drift = np.zeros((2, count))
    std, half, blocks = np.full(count, np.nan), np.full(count, np.nan), 0
    std[~now.free] = half[~now.free] = 0.0
    for cut in cuts:
        number = max((int(part.max()) + 1 for part in cut if part.size), default=0)
        if number < FEWEST:
            continue
        parts = _normal_of_blocks(problem, now, cut, number)
        covariance = _jackknife(problem, now, *parts)[np.ix_(use, use)]
        deviation = np.sqrt(np.diag(covariance))
        wide = student_factor(0.95, number - 1) * deviation
        if not blocks:
            best[np.ix_(use, use)] = covariance
            std[use], half[use], blocks = deviation, wide, number
            drift = _drift(problem, now, *parts)
        else:
            std[use], half[use] = np.maximum(std[use], deviation), np.maximum(half[use], wide)
    if blocks:  # deviations that give these intervals with the shorter stretches' quantile
        std = half / student_factor(0.95, blocks - 1)
    known = np.sqrt(np.diag(best))
    scale = np.divide(std, known, out=np.ones(count), where=(known > 0.0) & np.isfinite(std))
    return Intervals(std, half, best * np.outer(scale, scale), white, blocks, kind, drift)


def _drift(problem: Problem, now: Search, a: Array, g: Array) -> Array:
    """Return the most significant change of the estimate along the log, and its ratio to its standard deviation, (2, n_columns).

    `a` and `g` are the normal matrices and gradients of the blocks. The log is divided at several places; each part has an estimate
    of its own with a deviation by leaving out its blocks.
    """
    largest = np.zeros((2, len(problem.columns)))
    n_rows = sum(e.size for e in now.errors)
    for share in DIVISIONS:
        k = round(share * len(a))
        if not LEAST_SIDE <= k <= len(a) - LEAST_SIDE:
            continue
        steps, variances = [], []
        for part in (slice(None, k), slice(k, None)):
            steps.append(bounded_step(problem, now, a[part].sum(axis=0), g[part].sum(axis=0), 0.0, n_rows))
            variances.append(np.diag(_jackknife(problem, now, a[part], g[part])))
        change, deviation = steps[1] - steps[0], np.sqrt(sum(variances))
        ratio = quotient(change, deviation)
        largest = np.where(np.abs(ratio) > np.abs(largest[1]), [change, ratio], largest)
    return largest


def errors_over_noise(problem: Problem, now: Search, least: float = LEAST_NOISE) -> Array:
    """Return the rms errors over their white part, (n_dof,): 1 where a model is exact, 0 of joints without a fit.

    The rounding of an encoder counts as white, because it is not an error of the model, even where a joint rests on one count. The
    white part is at least `least` (rad or m).
    """
    squares, noise, count = (np.zeros(problem.robot.n_dof) for _ in range(3))
    for rollout, weight, rows in zip(problem.rollouts, problem.weights, now.errors, strict=True):
        if rollout.role == "fit":
            at, e = list(problem.limbs[rollout.limb].joints), rows.reshape(-1, len(weight)) / weight
            own = np.maximum(white_noise(e), encoder_step(rollout.q) / np.sqrt(12.0))
            squares[at] += np.sum(e**2, axis=0)
            noise[at] += len(e) * np.maximum(own, least) ** 2
            count[at] += len(e)
    return np.sqrt(quotient(squares, noise))


def widened(spread: Intervals, shift: Array) -> Intervals:
    """Return intervals widened by shifts, (n_columns,): half widths and shifts are added in squares."""
    known = np.isfinite(spread.half) & (spread.half > 0.0)
    factor = np.ones(len(shift))
    factor[known] = np.hypot(spread.half, shift)[known] / spread.half[known]
    covariance = spread.covariance * np.outer(factor, factor)
    return replace(spread, std=spread.std * factor, half=spread.half * factor, covariance=covariance)


def per_step(problem: Problem, now: Search) -> Array:
    """Return the change of the unknowns with the step of a simulator that takes kv implicitly, (n_columns,), in units per second.

    Such a simulator adds ``h (Fv + kv) / 2`` to the inertia of a joint, but ``h Fv / 2`` while its servo saturates. The first holds
    for any log, and `didim.export.drives.for_step` corrects for it; the change is that by the second, along this log.
    """
    per_column = np.zeros(len(now.theta))
    a, _ = normal_of(problem, now.errors, now.blocks)
    use = np.flatnonzero(now.free & (np.diag(a) > 0.0) & ~at_bound(problem, now))
    inverse = _inverse(a[np.ix_(use, use)])
    for _ in range(CHORDS):  # with the derivatives at hand: those of the simulator differ little
        errors = problem.errors(now.theta + per_column, lead_s=-HALF * USUAL_STEP_S)
        apart = [other - e for other, e in zip(errors, now.errors, strict=True)]
        if not all(np.isfinite(e).all() for e in apart):
            return np.zeros(len(now.theta))
        if not any(e.any() for e in apart):
            break
        per_column[use] -= inverse @ normal_of(problem, apart, now.blocks)[1][use]
    return per_column / USUAL_STEP_S


def changes(problem: Problem, spread: Intervals, theta: Array) -> tuple[Finding, ...]:
    """Return the finding that armatures or friction are others in one part of a log than in the rest, `theta` (n_columns,)."""
    change, ratio = np.abs(spread.drift)
    share = change / np.maximum(np.abs(theta), np.finfo(float).tiny)
    changed = [
        k
        for k in np.argsort(-ratio)
        if problem.columns[k].kind in ("Ia", "Fv", "Fc") and ratio[k] > CHANGED and share[k] > CHANGED_SHARE
    ]
    if not changed:
        return ()
    worst = max(changed, key=lambda k: min(share[k], 1.0) * ratio[k])
    names = series([problem.columns[k].name for k in changed], 40)
    return (
        worded(
            kind="changes",
            sentence=f"one value for the whole log does not hold for {names}: {problem.columns[worst].name} changes by "
            f"{min(100.0 * share[worst], 999.0):.0f} % along it ({ratio[worst]:.0f} standard deviations)",
            advice="Fit its parts one by one: friction depends on temperature, and is another in slow than in fast motion",
            joints=tuple(sorted({joint + 1 for k in changed for joint in problem.columns[k].joints})),
            parameters=tuple(problem.columns[k].name for k in changed),
            value=float(share[worst]),
        ),
    )


def model_errors(over: Array, shift: Array) -> tuple[Finding, ...]:
    """Return the finding that errors are too large for noise, so that intervals lack what no block shows."""
    joints = np.flatnonzero(over > LASTING)
    if not joints.size:
        return ()
    return (
        Finding(
            code="model-error",
            grade="note",
            joints=tuple(int(joint) + 1 for joint in joints),
            value=float(over.max()),
            facts={"over_noise": over.tolist(), "widened": bool(shift.any())},
        ),
    )


def _inverse(matrix: Array) -> Array:
    size = np.sqrt(np.diag(matrix))
    return np.asarray(
        np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-13, hermitian=True) / np.outer(size, size)
    )


def _cuts(problem: Problem) -> tuple[list[list[NDArray[np.intp]]], str]:
    """Return cuts of the rows of each rollout into blocks, the number of the block of each sample."""
    fitted = [rollout for rollout in problem.rollouts if rollout.role == "fit"]
    windows = list(dict.fromkeys((rollout.recording, rollout.window) for rollout in fitted))
    if len(windows) >= STRETCHES[1]:
        return [
            [
                np.full(len(rollout.q) - rollout.first, windows.index((rollout.recording, rollout.window)))
                if rollout.role == "fit"
                else np.zeros(0, dtype=np.intp)
                for rollout in problem.rollouts
            ]
        ], "rollouts"
    spans: dict[tuple[int, int], tuple[int, int]] = {}  # all limbs' stretches of a window
    for rollout in fitted:
        key, stretch = (
            (rollout.recording, rollout.window),
            (rollout.begin + rollout.first, rollout.begin + len(rollout.q)),
        )
        low, high = spans.get(key, stretch)
        spans[key] = min(low, stretch[0]), max(high, stretch[1])
    rates = {(rollout.recording, rollout.window): rollout.rate_hz for rollout in fitted}
    lengths = {key: (high - low) / rates[key] for key, (low, high) in spans.items()}
    total = sum(lengths.values())
    cuts = []
    for asked in STRETCHES:
        each = max(total / asked, LEAST_STRETCH_S)
        first, begin = {}, 0
        for key in windows:
            first[key] = begin
            begin += max(1, round(lengths[key] / each))
        cut = []
        for rollout in problem.rollouts:
            size = len(rollout.q) - rollout.first
            if rollout.role != "fit":
                cut.append(np.zeros(0, dtype=np.intp))
                continue
            key = (rollout.recording, rollout.window)
            parts = max(1, round(lengths[key] / each))
            low, high = spans[key]
            cut.append(
                first[key] + (rollout.begin + rollout.first - low + np.arange(size)) * parts // (high - low)
            )
        cuts.append(cut)
    return cuts, "stretches"


def _normal_of_blocks(
    problem: Problem, now: Search, cut: list[NDArray[np.intp]], number: int
) -> tuple[Array, Array]:
    """Return normal matrices and gradients of the blocks, (number, n_columns, n_columns) and (number, n_columns)."""
    count = len(problem.columns)
    a, g = np.zeros((number, count, count)), np.zeros((number, count))
    for rollout, e, j, blocks in zip(problem.rollouts, now.errors, now.blocks, cut, strict=True):
        if not e.size:
            continue
        own = problem.own(rollout)
        rows = np.repeat(blocks, len(problem.limbs[rollout.limb].joints))
        for block in np.unique(blocks):
            at = rows == block
            a[block][np.ix_(own, own)] += j[at].T @ j[at]
            g[block][own] += j[at].T @ e[at]
    return a, g


def _jackknife(problem: Problem, now: Search, a: Array, g: Array) -> Array:
    """Return the covariance by leaving out each block; the estimate without one keeps to the bounds, as the estimate does."""
    whole, gradient, number = a.sum(axis=0), g.sum(axis=0), len(a)
    n_rows = sum(e.size for e in now.errors)
    moved = np.array(
        [bounded_step(problem, now, whole - a[b], gradient - g[b], 0.0, n_rows) for b in range(number)]
    )
    return deletion_covariance(moved)
