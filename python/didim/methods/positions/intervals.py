"""Covariance of the unknowns by leaving out rollouts or stretches of the log: a jackknife of the last linear problem.

With ``A = J^T J`` and ``g = J^T e`` of all blocks and ``A_b``, ``g_b`` of one, the estimate without block b is
``theta - (A - A_b)^-1 (g - g_b)``, within the bounds. Model errors of a robot last, for they depend on its speed and its pose:
stretches of two lengths are left out, and the wider intervals hold. Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array, quotient, unit_diagonal
from ..._tools.words import series
from ...regression.covariance import deletion_covariance
from ...result.finding import Finding, worded
from ...result.uncertainty import student_factor
from ...signal.noise import encoder_step, white_noise
from .problem import Problem
from .search import Search, at_bound, bounded_step

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
INEXACT, INEXACT_SIGMAS = 0.05, 3.0
"""Excess of the errors over their white part from which a result is doubtful, and the same in deviations of a root mean square of
so many samples. On simulated hobby arms right models have at most 0.04; those that lack a law, or have a tenth more mass, 0.08."""
LEAST_NOISE = 2e-4
"""Noise (rad or m) that an encoder has at least: logs of simulations have less, whose steps leave errors of a fourth of it, and no
robot is as exact as they are."""


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
    runs : (n_columns,) array
        Standard deviations of the unknowns from log to log, beyond those of each log; zero for one log.
    """

    std: Array
    half: Array
    covariance: Array
    white: Array
    blocks: int
    kind: str
    drift: Array
    runs: Array


def intervals(now: Search) -> Intervals:
    """Return the intervals at the end of a search."""
    a, _ = now.normal()
    prior = np.array([1.0 / column.sigma**2 for column in now.problem.columns])
    rows, use, count = now.rows, now.used(a), len(prior)
    variance = now.squares / rows
    white = np.zeros(count)
    whole = _inverse((a + np.diag(prior * variance))[np.ix_(use, use)])
    white[use] = np.sqrt(np.maximum(np.diag(whole), 0.0) * variance * rows / max(1, rows - len(use)))
    # No block tells how far the centres of the priors are from the truth.
    centres = (whole * prior[use] * variance**2) @ whole
    cuts, kind = _cuts(now.problem)
    covariance, drift, blocks = np.zeros((count, count)), np.zeros((2, count)), 0
    half = np.where(now.free, np.nan, 0.0)
    for cut in cuts:
        number = 1 + max(int(part.max()) for part in cut)
        if number < FEWEST:
            continue
        parts = _normal_of_blocks(now, cut, number)
        of_cut = _jackknife(now, *parts)
        of_cut[np.ix_(use, use)] += centres
        if not blocks:
            covariance, drift, blocks = of_cut, _drift(now, *parts), number
        half[use] = np.fmax(half, student_factor(0.95, number - 1) * np.sqrt(np.diag(of_cut)))[use]
    # Deviations that give these intervals with the shorter stretches' quantile.
    std = half / student_factor(0.95, blocks - 1) if blocks else half
    known = np.sqrt(np.diag(covariance))
    scale = np.divide(std, known, out=np.ones(count), where=(known > 0.0) & np.isfinite(std))
    return Intervals(
        std, half, covariance * np.outer(scale, scale), white, blocks, kind, drift, _between_logs(now)
    )


def _between_logs(now: Search) -> Array:
    """Return the standard deviations of the unknowns from log to log, (n_columns,), beyond those of each log.

    Each log has an estimate and, by leaving out its stretches, a variance v. The excess of the squares of the estimates, weighed by
    1 / v, over what v explains is the variance between logs (DerSimonian and Laird).
    """
    logs = sorted({rollout.recording for rollout in now.problem.rollouts})
    number, cut = STRETCHES[1], []
    if len(logs) == 1:
        return np.zeros(len(now.theta))
    for rollout in now.problem.rollouts:
        at = np.arange(len(rollout.q) - rollout.first)
        cut.append(logs.index(rollout.recording) * number + at * number // len(at))
    a, g = _normal_of_blocks(now, cut, number * len(logs))
    steps, variances = [], []
    for part in (slice(k, k + number) for k in range(0, number * len(logs), number)):
        steps.append(bounded_step(now, a[part].sum(axis=0), g[part].sum(axis=0)))
        variances.append(np.diag(_jackknife(now, a[part], g[part])))
    weight = quotient(np.ones((len(logs), len(now.theta))), np.array(variances))
    total = weight.sum(axis=0)
    centre = quotient((weight * steps).sum(axis=0), total)
    freedom = np.maximum(np.count_nonzero(weight, axis=0) - 1, 0)
    excess = (weight * (steps - centre) ** 2).sum(axis=0) - freedom
    spare = total - quotient((weight**2).sum(axis=0), total)
    between = np.maximum(quotient(excess, np.where(freedom > 0, spare, 0.0)), 0.0)
    return np.where(now.free & ~at_bound(now), np.sqrt(between), 0.0)


def _drift(now: Search, a: Array, g: Array) -> Array:
    """Return the most significant change of the estimate along the log, and its ratio to its standard deviation, (2, n_columns).

    `a` and `g` are the normal matrices and gradients of the blocks. The log is divided at several places; each part has an estimate
    of its own with a deviation by leaving out its blocks.
    """
    largest = np.zeros((2, len(now.theta)))
    for share in DIVISIONS:
        k = round(share * len(a))
        if not LEAST_SIDE <= k <= len(a) - LEAST_SIDE:
            continue
        steps, variances = [], []
        for part in (slice(None, k), slice(k, None)):
            steps.append(bounded_step(now, a[part].sum(axis=0), g[part].sum(axis=0)))
            variances.append(np.diag(_jackknife(now, a[part], g[part])))
        change, deviation = steps[1] - steps[0], np.sqrt(sum(variances))
        ratio = quotient(change, deviation)
        largest = np.where(np.abs(ratio) > np.abs(largest[1]), [change, ratio], largest)
    return largest


def errors_over_noise(now: Search, least: float = LEAST_NOISE) -> Array:
    """Return the rms errors over their white part, (n_dof,): 1 where a model is exact, 0 of joints without a fit.

    The rounding of an encoder counts as white, because it is not an error of the model, even where a joint rests on one count. The
    white part is at least `least` (rad or m).
    """
    squares, noise = (np.zeros(now.problem.robot.n_dof) for _ in range(2))
    for rollout, rows in zip(now.problem.rollouts, now.errors, strict=True):
        e = rollout.by_joint(rows)
        own = np.maximum(white_noise(e), encoder_step(rollout.q) / np.sqrt(12.0))
        squares[rollout.joints] += np.sum(e**2, axis=0)
        noise[rollout.joints] += len(e) * np.maximum(own, least) ** 2
    return np.sqrt(quotient(squares, noise))


def widened(spread: Intervals, shift: Array) -> Intervals:
    """Return intervals widened by shifts, (n_columns,): half widths and shifts are added in squares."""
    known = np.isfinite(spread.half) & (spread.half > 0.0)
    factor = np.ones(len(shift))
    factor[known] = np.hypot(spread.half, shift)[known] / spread.half[known]
    covariance = spread.covariance * np.outer(factor, factor)
    return replace(spread, std=spread.std * factor, half=spread.half * factor, covariance=covariance)


def per_step(now: Search) -> Array:
    """Return the change of the unknowns with the step of a simulator that takes kv implicitly, (n_columns,), in units per second.

    Such a simulator adds ``h (Fv + kv) / 2`` to the inertia of a joint, but ``h Fv / 2`` while its servo saturates. The first holds
    for any log, and `didim.export.drives.for_step` corrects for it; the change is that by the second, along this log.
    """
    per_column = np.zeros(len(now.theta))
    a, _ = now.normal()
    use = np.flatnonzero(now.free & (np.diag(a) > 0.0) & ~at_bound(now))
    inverse = _inverse(a[np.ix_(use, use)])
    for _ in range(CHORDS):  # with the derivatives at hand: those of the simulator differ little
        errors = now.problem.errors(now.theta + per_column, lead_s=-HALF * USUAL_STEP_S)
        apart = [other - e for other, e in zip(errors, now.errors, strict=True)]
        if not all(np.isfinite(e).all() for e in apart):
            return np.zeros(len(now.theta))
        if not any(e.any() for e in apart):
            break
        per_column[use] -= inverse @ now.normal(apart)[1][use]
    return per_column / USUAL_STEP_S


def changes(now: Search, drift: Array) -> list[Finding]:
    """Return the finding that armatures or friction are others in one part of a log than in the rest, `drift` (2, n_columns)."""
    columns, (change, ratio) = now.problem.columns, np.abs(drift)
    share = quotient(change, np.abs(now.theta), np.inf)
    changed = [
        k
        for k in np.argsort(-ratio)
        if columns[k].kind in ("Ia", "Fv", "Fc") and ratio[k] > CHANGED and share[k] > CHANGED_SHARE
    ]
    if not changed:
        return []
    worst = max(changed, key=lambda k: min(share[k], 1.0) * ratio[k])
    names = series([columns[k].name for k in changed], 40)
    return [
        worded(
            kind="changes",
            sentence=f"one value for the whole log does not hold for {names}: {columns[worst].name} changes by "
            f"{min(100.0 * share[worst], 999.0):.0f} % along it ({ratio[worst]:.0f} standard deviations)",
            advice="Fit its parts one by one: friction depends on temperature, and is another in slow than in fast motion",
            joints=tuple(sorted({joint + 1 for k in changed for joint in columns[k].joints})),
            parameters=tuple(columns[k].name for k in changed),
            value=float(share[worst]),
        )
    ]


def model_errors(over: Array, shift: Array, count: float) -> list[Finding]:
    """Return the finding that errors of `count` samples a joint are too large for noise: intervals lack what no block shows."""
    joints = np.flatnonzero(over > 1.0 + max(INEXACT, INEXACT_SIGMAS / np.sqrt(2.0 * max(count, 1.0))))
    if not joints.size:
        return []
    return [
        Finding(
            code="model-error",
            grade="doubtful",
            joints=tuple(int(joint) + 1 for joint in joints),
            value=float(over.max()),
            facts={"over_noise": over.tolist(), "widened": bool(shift.any())},
        )
    ]


def _inverse(matrix: Array) -> Array:
    scaled, size = unit_diagonal(matrix)
    return np.asarray(np.linalg.pinv(scaled, rcond=1e-13, hermitian=True) / np.outer(size, size))


def _cuts(problem: Problem) -> tuple[list[list[NDArray[np.intp]]], str]:
    """Return cuts of the rows of each rollout into blocks, the number of the block of each sample."""
    keys = [(rollout.recording, rollout.window.number) for rollout in problem.rollouts]
    samples = [
        rollout.window.begin + np.arange(rollout.first, len(rollout.q)) for rollout in problem.rollouts
    ]
    windows = list(dict.fromkeys(keys))
    if len(windows) >= STRETCHES[1]:
        cut = [np.full(len(at), windows.index(key)) for at, key in zip(samples, keys, strict=True)]
        return [cut], "rollouts"
    rates = dict(zip(keys, (rollout.rate_hz for rollout in problem.rollouts), strict=True))
    spans, lengths = {}, {}
    for window in windows:  # all limbs' stretches of it
        whole = np.concatenate([at for at, key in zip(samples, keys, strict=True) if key == window])
        spans[window] = whole.min(), whole.max() + 1 - whole.min()
        lengths[window] = spans[window][1] / rates[window]
    cuts = []
    for asked in STRETCHES:
        each = max(sum(lengths.values()) / asked, LEAST_STRETCH_S)
        parts = {window: max(1, round(lengths[window] / each)) for window in windows}
        first = dict(zip(windows, accumulate(parts.values(), initial=0), strict=False))
        cuts.append(
            [
                first[key] + (at - spans[key][0]) * parts[key] // spans[key][1]
                for at, key in zip(samples, keys, strict=True)
            ]
        )
    return cuts, "stretches"


def _normal_of_blocks(now: Search, cut: list[NDArray[np.intp]], number: int) -> tuple[Array, Array]:
    """Return normal matrices and gradients of the blocks, (number, n_columns, n_columns) and (number, n_columns)."""
    count = len(now.theta)
    a, g = np.zeros((number, count, count)), np.zeros((number, count))
    for rollout, e, j, blocks in zip(now.problem.rollouts, now.errors, now.blocks, cut, strict=True):
        own = now.problem.own(rollout)
        rows = np.repeat(blocks, len(rollout.joints))
        for block in np.unique(blocks):
            at = rows == block
            a[block][np.ix_(own, own)] += j[at].T @ j[at]
            g[block][own] += j[at].T @ e[at]
    return a, g


def _jackknife(now: Search, a: Array, g: Array) -> Array:
    """Return the covariance by leaving out each block; the estimate without one keeps to the bounds, as the estimate does."""
    whole, gradient = a.sum(axis=0), g.sum(axis=0)
    moved = [bounded_step(now, whole - own, gradient - slope) for own, slope in zip(a, g, strict=True)]
    return deletion_covariance(np.array(moved))
