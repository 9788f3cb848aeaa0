r"""Friction that the model lacks: a score test that sees it, the law of each joint, and how far the parameters move with it.

A missing law repeats its error in every stretch of the log. Standard deviations from stretches left out cannot see it, and the
whiteness of decimated rows is that of their filter. The score of the law's column sees it. With ``A`` the weighted observation
matrix, ``rho`` the weighted residual and ``c`` the column of a law at one joint, weighted and freed of the columns of A:

    S_i = c_i^T rho_i           over block i,            t = sum_i S_i / sqrt(sum_i S_i^2)

Where the model is right, the sums of the blocks are as likely negative as positive, whatever the correlation within a block.
Flipping the signs of whole blocks, the same for all columns of a joint, gives the distribution of the largest ``|t|`` of its laws.
Blocks are taken in two ways, equal stretches of time and stretches between the reversals of the joint; both must alarm. An error
that lasts hides a law among its slow waves, so the test is made a second time with whitened rows: those of a joint by an
autoregression of its residual, each window by itself. Either may alarm, at half the rate. Estimates and shifts are those of the
rows as they are. Errors of right models (`sampling`) have columns beside those of A for the scores. These columns are differences
of the motion, so noise of the positions is in them as it is in the residual. Low passes of them have hardly any of it, so an alarm
is tried again with these, and one law must alarm both times.

Where a joint alarms, it lacks a law, and the others of its limb may: that whose column explains most of blocks left out, with the
amplitude of the other blocks, if it explains any. The laws of all joints have their amplitudes together, and the estimate would
move with them by

    K a = -R^-1 Q^T C (C~^T C~)^-1 C~^T rho,        C~ = C - Q Q^T C,    A = Q R

with ``(R^T R + P)^-1 R^T`` in place of ``R^-1`` where a prior and constraints hold the estimate with a precision P.

This is a bias, not a deviation: which law the joint has is not known, so an interval holds for every bias up to it. With the
deviation s of noise its half width is that of noise times ``cv(|K a| / s) / cv(0)``, cv(x) being the 95 % quantile of
``|N(x, 1)|``. Friction at a speed v moves by ``h(v)^T K a + a c(v)``, where both parts nearly cancel.

After ``terms = "auto"`` the bias includes what the choice left open: a term whose gain on held-out blocks is not clear or that is
not chosen without one of them, and the other of atan and Stribeck's law where both fit. Their changes are independent: their
squares are added.

Sources: Cochrane and Orcutt (1949) for whitened rows; Liu (1988) and Cameron, Gelbach, Miller (2008) for flipped blocks; Schwarz
(1978) for the order of an autoregression; Armstrong and Kolesar (2018) for intervals that hold for every bias up to a bound.

A log has errors where its model is right too, and they look like friction. Central differences, `h` s apart, lose ``h^2 / 6`` of
the second derivative of a velocity and, taken twice, ``h^2 / 3`` of that of an acceleration. Where a joint reverses, its
acceleration jumps with Coulomb friction, so the velocity is wrong just where friction depends on it, at the jump by a quarter of
its second difference. Slow motion has its loss back, so what is left of a jump has the form of fourth and sixth differences. A
torque that a digital controller holds between samples, or that is recorded a part of a sample beside the positions, differs by
shares of its first and second differences, here of links and rotors, since those of Coulomb friction would hide other laws at
reversals. Friction of a ``sign`` turns within a small velocity that its model leaves open. Each error is known but for its amount
at each joint, so the test for missing friction frees its scores of them.

They are differences of the motion, so noise of the positions is in them as it is in the residual, and looks like friction; low
passes of them have hardly any of it. Tested in ``tests/test_friction_alarm.py``, the turn in ``tests/test_ur10e_page.py``.

Coulomb friction and a law of speed can be nearly the same column in a log, the velocity of the law is unknown, or a law is
missing: then parameters of friction are uncertain, but the friction at speeds inside the log is not. For a joint alone, in steady
sliding, half the difference between both directions is

    f(v) = g(v)^T beta,     s^2 = h(v)^T C h(v)

with the columns g at speed v and the derivatives h by the parameters and the estimated velocities, whose covariance by noise is C.
Tested in ``tests/test_friction_exchange.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim._core as _core

from ..._tools.arrays import Array, quotient
from ..._tools.saved import UNBOUNDED
from ...errors import SignalError
from ...model.dynamics import friction_places, inverse_dynamics
from ...model.memory import FADED, direction, instantaneous, start_column, state
from ...robot.friction import OF_PATH
from ...robot.parameters import friction_names
from ...robot.robot import Robot
from ...signal.filters import SLOW, low_pass
from ...signal.processing import SignalProcessing
from ...signal.window import Window
from ...terms.rows import LinearSystem, Rows, unit_columns
from ..covariance import intervals
from ..fit import Fit
from .velocity import decimated, slope_at

TIME_BLOCKS = 20
"""Number of time stretches whose signs are flipped: long against the residual's correlation, many enough for a probability of 1
%."""
FEWEST_BLOCKS = 8
"""Number of blocks below which flips have too few patterns (2^7) for a probability of 1 %, and there is no test."""
LASTING = 3.0
"""Correlation of neighbouring rows beyond that of their filter, in its standard deviation, from which the error lasts."""
LARGEST_ORDER = 3
"""Largest order of the autoregression that whitens rows."""
LEVEL = 0.01
"""Largest false alarm rate of a test over all joints of a log: it is divided by the number of joints."""
FEWEST_ROWS = 3
"""Smallest number of rows of a stretch between two reversals; shorter ones join the next."""
ONE_SIDED = 6.0
"""Bias, in deviations, from which one side of an interval alone misses it."""
ROUNDING = 1e-8
"""Norm of a column outside the span of A, as a share, below which the model already contains the column."""


def bounded(std: Array, bias: Array) -> Array:
    """Return deviations whose 95 % intervals hold with every bias up to a bound, of those of noise; both (k,), in one unit.

    It is ``std cv(bias / std) / cv(0)`` with the 95 % quantile cv(x) of ``|N(x, 1)|``; ``test_friction_alarm.py`` draws it.
    """
    from scipy.special import ndtr

    size = quotient(np.abs(bias), std)
    near = np.minimum(size, ONE_SIDED)
    half = near + 1.9600
    for _ in range(6):  # Newton's method: from this start it ends at rounding
        missed = ndtr(half - near) - ndtr(-half - near) - 0.95
        density = np.exp(-0.5 * (half - near) ** 2) + np.exp(-0.5 * (half + near) ** 2)
        half -= missed * np.sqrt(2.0 * np.pi) / density
    return np.asarray(np.where(size > 0.0, std * (half + size - near) / 1.959964, std))


@dataclass(frozen=True, kw_only=True)
class MissingLaw:
    """Friction law that the model lacks at a joint, or may lack where another joint of its limb alarms.

    Attributes
    ----------
    joint : int
        Joint, from 0.
    law : {"stribeck", "atan", "load", "dahl"}
        Its law.
    velocity : float
        Velocity, or displacement of memory (rad/s and rad, or m/s and m); zero of ``load``.
    amount : float
        Friction per unit of its column (N.m or N; of ``load`` without a unit).
    by_block : tuple of float
        Share of each block of time in the error of the amount, m of them: their squares add to its variance.
    """

    joint: int
    law: str
    velocity: float
    amount: float
    by_block: tuple[float, ...] = ()

    def steady(self, robot: Robot, speeds: Array, load: Array) -> Array:
        """Return a unit of its friction in steady sliding at speeds, (k,), beside the Coulomb friction that the fit has.

        `load` are the sizes of the torques of links and rotors, (n_dof,) in N.m or N.
        """
        if self.law == "dahl":  # its state is the sign
            return np.zeros(len(speeds))
        dq = np.zeros((len(speeds), robot.n_dof))
        dq[:, self.joint] = speeds
        sign = instantaneous(robot, dq)[:, self.joint]
        if self.law == "load":
            return np.asarray(load[self.joint] * sign)
        x = speeds / self.velocity
        return sign * np.exp(-np.square(x)) if self.law == "stribeck" else np.arctan(x) - 0.5 * np.pi * sign


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionAlarm:
    """Result of the score test for friction laws that the model lacks.

    Attributes
    ----------
    p_value : ndarray, shape (n_dof,)
        Probability of scores as large where the model is right, per joint, times the number of joints; the larger of the
        tests over stretches of time and between reversals, and of an alarm's two trials. Where the error lasts, times two, and
        the smaller of rows as they are and whitened ones, which are left out where the first raise an alarm. One where a joint
        was not tested.
    law : str
        Family that explains most of blocks left out: ``"stribeck"``, ``"atan"``, ``"load"`` or ``"dahl"``; empty without an alarm.
    tested : tuple of str
        Families that were tested.
    shift : ndarray, shape (b,)
        Size of the change of each parameter, in its unit, with the laws of `missing`, and always with the laws that fit the log
        as well as chosen ones; zero without either.
    visible : mapping of str to ndarray, shape (n_dof,)
        By family, the amplitude of its friction at each joint that the test would see (N.m or N), whichever of its
        velocities or widths it has: a score of `VISIBLE` deviations. Infinite where a joint was not tested.
    missing : tuple of MissingLaw
        On an alarm, the laws of the joints that alarm, and those that others of their limbs may lack.
    moved : ndarray, shape (b + v,)
        Change of the parameters, and of the estimated velocities of laws, with these; empty without any.
    by_block : ndarray, shape (m, b + v)
        Share of each block of time in the error of this change: their squares add to its variance.
    """

    p_value: Array
    law: str
    tested: tuple[str, ...]
    shift: Array
    visible: Mapping[str, Array] = field(metadata=UNBOUNDED)
    missing: tuple[MissingLaw, ...] = ()
    moved: Array = field(default_factory=lambda: np.zeros(0))
    by_block: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints, from 0, whose residual has the friction of a law that the model lacks."""
        return tuple(int(joint) for joint in np.flatnonzero(self.p_value < LEVEL))

    @property
    def laws(self) -> dict[str, tuple[int, ...]]:
        """Joints, from 0, that alarm, by the law that each lacks."""
        found: dict[str, tuple[int, ...]] = {}
        for each in self.missing:
            if each.joint in self.joints:
                found[each.law] = (*found.get(each.law, ()), each.joint)
        return found

    @property
    def raised(self) -> bool:
        """Whether the test alarms."""
        return bool(self.joints)


@dataclass(frozen=True, eq=False)
class _Limb:
    """Joints that share columns: their rows, joint by joint, and ``A = Q R`` of their weighted columns.

    `held` is the precision P with which a prior and constraints hold the estimate, for the scaled columns; zero without any.
    """

    joints: tuple[int, ...]
    rows: Rows
    columns: Rows
    weights: Array
    rho: Array
    size: Array
    q: Array
    r: Array
    held: Array

    def moved(self, columns: Array) -> Array:
        """Return the change of the unknowns with a unit of weighted columns: ``-R^-1 Q^T C``, or as the precision holds them."""
        along = self.q.T @ columns
        held = self.r.T @ self.r + self.held
        moved = np.linalg.solve(held, self.r.T @ along) if self.held.any() else np.linalg.solve(self.r, along)
        return np.asarray(-moved / self.size[:, None])

    def weighted(self, columns: Array) -> Array:
        """Return one weighted column of W per joint, zero in the rows of the other joints."""
        weighted = np.zeros((len(self.joints), len(columns), len(self.joints)))
        for index, joint in enumerate(self.joints):
            weighted[index, :, index] = columns[:, joint]
        return weighted.reshape(-1, len(self.joints)) * self.weights[:, None]

    def freed_of(self, errors: Sequence[Array]) -> Array:
        """Return Q with one more column for each joint of each error of the torques, decimated, (n_rows, n_dof)."""
        if not errors:
            return self.q
        columns = np.hstack([self.weighted(error) for error in errors])
        free = _freed(self.q, columns)
        return np.hstack([self.q, np.linalg.qr(free[:, free.any(axis=0)])[0]])

    def own(self, blocks: Sequence[Rows]) -> list[Rows]:
        """Return the rows of blocks of the system that are the limb's, as numbers from its first."""
        columns = []
        for rows in blocks:
            places = np.searchsorted(self.rows, rows)
            there = self.rows[np.minimum(places, len(self.rows) - 1)] == rows
            columns.append(places[there])
        return columns


@dataclass(frozen=True, kw_only=True, eq=False)
class Along:
    """Motion of a log, and what an estimate makes of it.

    Attributes
    ----------
    robot : Robot
        Robot of the system; load friction that a joint has already is not tested there.
    x : ndarray, shape (n_parameters,)
        Estimated standard parameters of the robot.
    parts : sequence of Window
        Motion along which the columns are.
    signal : SignalProcessing
        Decimation.
    load : sequence of ndarray, shape (n_samples, n_dof)
        Torques of links and rotors along each of the parts with the estimate (N.m or N, joint side).
    encoder_step : ndarray, shape (n_dof,), or None
        Step of the position encoder of each joint (rad or m), zero where it is not seen. A joint whose steps are coarser
        than `RESOLVED_STEPS` allows is not tested for memory.
    errors : sequence of sequence of ndarray, shape (n_samples, n_dof)
        Errors of the torques along each of the parts, of an amount at each joint that is not known (N.m or N, joint side):
        scores are freed of them as of the columns of A.
    """

    robot: Robot
    x: Array
    parts: Sequence[Window]
    signal: SignalProcessing
    load: Sequence[Array]
    encoder_step: Array | None = None
    errors: Sequence[Sequence[Array]] = ()

    @cached_property
    def typical_load(self) -> Array:
        """Median size of the torque of links and rotors, (n_dof,)."""
        return np.asarray(np.median(np.abs(np.concatenate(self.load)), axis=0))


def friction_alarm(system: LinearSystem, fit: Fit, along: Along) -> FrictionAlarm:
    """Test a residual for friction laws that the model lacks.

    Parameters
    ----------
    system : LinearSystem
        The system (7), made of the parts of `along`.
    fit : Fit
        Its solution, with residual and weights.
    along : Along
        Motion of the system.

    Returns
    -------
    FrictionAlarm

    Raises
    ------
    SignalError
        When the decimation cannot be applied.

    Notes
    -----
    ``test_friction_alarm.py`` counts false alarms on right models and alarms on each missing law.
    """
    robot, parts, signal = along.robot, along.parts, along.signal
    n = robot.n_dof
    candidates = laws_to_test(along, frozenset(system.slopes))
    tested = tuple(dict.fromkeys(candidate.family for candidate in candidates))
    limbs = _limbs(system, fit)
    speeds = decimated([part.dq for part in parts], parts, signal)
    white = _Whitening.of(system, fit.residual)
    ways = [replace(white, laws=[np.zeros(0)] * n), *([white] if any(map(len, white.laws)) else [])]

    def tested_with(
        way: _Whitening, some: Sequence[_Limb], errors: Sequence[Sequence[Array]]
    ) -> tuple[Array, Array]:
        laws = [replace(law, columns=way.columns(law.columns)) for law in candidates]
        known = [way.columns(decimated(values, parts, signal)) for values in errors]
        return _tested(system, some, laws, known, speeds, len(ways))

    probability, seen = np.ones((len(candidates), n)), np.zeros((len(candidates), n))
    for way in ways:
        if (probability < LEVEL).any():
            break
        some = limbs
        if way is white:
            some = _limbs(white.system(system), replace(fit, residual=white.rows(fit.residual)))
            # The rest of whitened rows is that of their own solution.
            some = [replace(limb, rho=_freed(limb.q, limb.rho[:, None])[:, 0]) for limb in some]
        found, least = tested_with(way, some, along.errors)
        if (found < LEVEL).any() and (slow := slow_errors(along.errors, parts, signal)):
            found, least = np.maximum((found, least), tested_with(way, some, slow))
        probability = np.minimum(probability, found)
        seen = np.where((seen > 0.0) & (least > 0.0), np.minimum(seen, least), np.maximum(seen, least))
    p_value = np.min(probability, axis=0)
    families = np.array([candidate.family for candidate in candidates])
    visible = {family: np.max(seen[families == family], axis=0) for family in tested}
    missing: tuple[MissingLaw, ...] = ()
    moved, by_block, law = np.zeros(0), np.zeros((0, 0)), ""
    if (p_value < LEVEL).any():
        missing, changes, law = _missing_laws(candidates, limbs, system, along, p_value < LEVEL)
        moved, *errors = _with_velocities_of(system, fit.solution, changes)
        by_block = np.array(errors)
    open_ = _open_shift(system, fit)
    return FrictionAlarm(
        p_value=p_value,
        law=law,
        tested=tested,
        shift=np.hypot(open_, moved[: len(open_)] if moved.size else 0.0),
        visible={family: np.where(values > 0.0, values, np.inf) for family, values in visible.items()},
        missing=missing,
        moved=moved,
        by_block=by_block,
    )


def _with_velocities_of(system: LinearSystem, solution: Array, changes: Array) -> Array:
    """Return changes of parameters and velocities, (k, b + v), of those of the columns of W and of the slopes."""
    wider = system.with_velocities(solution)
    b, slopes = len(system.names), list(system.slopes)
    velocities = [
        changes[:, b + slopes.index(name)] / solution[system.names.index(name)] for name in wider.names[b:]
    ]
    return np.column_stack([changes[:, :b], *velocities])


def _tested(
    system: LinearSystem,
    limbs: Sequence[_Limb],
    candidates: Sequence[LawColumns],
    errors: Sequence[Array],
    speeds: Array,
    tests: int,
) -> tuple[Array, Array]:
    """Return the probability of the scores, freed of errors of the torques, and the visible friction, by law and joint, (k, n)."""
    n = len(system.joints)
    p_value = np.ones((len(candidates), n))
    visible = np.zeros((len(candidates), n))
    memory = np.array([candidate.family == "dahl" for candidate in candidates])
    time = [part.rows for part in intervals(system.blocks, TIME_BLOCKS)]
    for limb in limbs:
        known = limb.freed_of(errors)
        free = [_freed(known, limb.weighted(candidate.columns)) for candidate in candidates]
        stretches = limb.own(time)
        for index, joint in enumerate(limb.joints):
            blocks = (stretches, limb.own(_between_reversals(system, speeds, joint)))
            if min(map(len, blocks)) < FEWEST_BLOCKS:
                continue
            columns = np.stack([column[:, index] for column in free], axis=1)
            probability, units = joint_test(columns, limb.rho, blocks, memory, tests)
            p_value[:, joint] = np.minimum(1.0, n * probability)
            visible[:, joint] = units * np.array([candidate.amplitude[joint] for candidate in candidates])
    return p_value, visible


def _open_shift(system: LinearSystem, fit: Fit) -> Array:
    """Return the root of the sum of squared changes of the estimate with the alternatives of a system, (b,).

    A law's own parameter does not change.
    """
    if not system.alternatives:
        return np.zeros(len(system.names))
    names = [*system.names, *system.slopes]
    b, n = len(system.names), len(names)
    others = [column for _, column in system.alternatives]
    every = np.column_stack([system.w, *system.slopes.values(), *others])
    a, size = unit_columns(every * fit.weights[:, None])
    products, torques = a.T @ a, a.T @ (system.y * fit.weights)
    # At the estimate all velocities are the best: their columns have no share of the torque.
    best = np.zeros(n)
    best[:b] = np.linalg.lstsq(products[:b, :b], torques[:b], rcond=None)[0]
    squares = np.zeros(b)
    for k, (name, column) in enumerate(system.alternatives):
        used = np.array(
            [index for index, key in enumerate(names) if key != name] + ([n + k] if column.any() else [])
        )
        solution = np.linalg.lstsq(products[np.ix_(used, used)], torques[used], rcond=None)[0]
        shared = used < n
        changed = best.copy()
        changed[used[shared]] = solution[shared]
        squares += np.square((changed - best) / size[:n])[:b]
    return np.sqrt(squares)


@dataclass(frozen=True, eq=False)
class _Whitening:
    """Autoregression of each joint's residual, by which rows of a system become white.

    Attributes
    ----------
    laws : list of (p,) array
        Coefficients of each joint, for the rows before; none where the residual is white.
    blocks : list of list of slice
        Rows of each joint in each window.
    """

    laws: list[Array]
    blocks: list[list[slice]]

    @classmethod
    def of(cls, system: LinearSystem, residual: Array) -> _Whitening:
        """Return the whitening by a residual, (r,)."""
        blocks = [[block.rows for block in blocks] for blocks in system.joint_blocks]
        laws = []
        for joint, some in zip(system.joint_blocks, blocks, strict=True):
            known = joint[0].correlation  # that of white noise in the log, by the filter of the rows
            of_filter = 0.0 if known is None or len(known) < 2 else float(known[1])
            laws.append(autoregression([residual[rows] for rows in some], of_filter))
        return cls(laws, blocks)

    def rows(self, values: Array) -> Array:
        """Return whitened rows, (r,) or (r, k); the first ones of each window are zero."""
        if not any(map(len, self.laws)):
            return values
        made = values.copy()
        for law, blocks in zip(self.laws, self.blocks, strict=True):
            for rows in blocks:
                for lag, factor in enumerate(law, start=1):
                    made[rows][lag:] -= factor * values[rows][:-lag]
                made[rows][: len(law)] = 0.0
        return made

    def columns(self, values: Array) -> Array:
        """Return whitened signals of the joints, (n_rows, n_dof)."""
        return self.rows(values.T.reshape(-1)).reshape(values.T.shape).T

    def system(self, system: LinearSystem) -> LinearSystem:
        """Return a system with whitened columns."""
        slopes = {name: self.rows(slope) for name, slope in system.slopes.items()}
        return replace(system, w=self.rows(system.w), slopes=slopes)


def autoregression(pieces: Sequence[Array], of_filter: float = 0.0) -> Array:
    """Return the autoregression of a signal in pieces, (p,): Yule and Walker's, of the order that Schwarz's criterion takes.

    None where the correlation of neighbours is no larger than that of a filter, but for chance.
    """
    r = np.zeros(LARGEST_ORDER + 1)
    for piece in pieces:
        for lag in range(min(len(r), len(piece))):
            r[lag] += piece[lag:] @ piece[: len(piece) - lag]
    n, best = sum(map(len, pieces)), 0.0
    chosen = np.zeros(0)
    if not r[0] > 0.0 or r[1] / r[0] - of_filter <= LASTING / np.sqrt(n):
        return chosen
    r /= r[0]
    for order in range(1, LARGEST_ORDER + 1):
        lags = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
        law = np.linalg.solve(r[lags], r[1 : order + 1])
        left = max(1.0 - float(law @ r[1 : order + 1]), np.finfo(float).eps)
        criterion = n * float(np.log(left)) + order * float(np.log(n))
        if criterion < best:
            best, chosen = criterion, np.array(law)
    return chosen


def _limbs(system: LinearSystem, fit: Fit) -> list[_Limb]:
    """Return the independent parts of a system: the joints of different legs of one trunk share no column."""
    limbs = []
    starts = [rows.start for rows in system.joints]
    for (rows, columns), matrix in zip(system.parts, system.matrices, strict=True):
        # Fitted velocities of laws are unknowns of the model as well; their columns need no scale of their own.
        slopes = {k: slope[rows] for k, slope in enumerate(system.slopes.values()) if slope[rows].any()}
        w = np.column_stack([matrix, *slopes.values()]) * fit.weights[rows, None]
        unit, size = unit_columns(w)
        q, r = np.linalg.qr(unit)
        held, k = np.zeros((len(size), len(size))), len(columns)
        if fit.precision is not None:
            held[:k, :k] = fit.precision[np.ix_(columns, columns)] / np.outer(size[:k], size[:k])
        limbs.append(
            _Limb(
                joints=tuple(int(joint) for joint in np.flatnonzero(np.isin(starts, rows))),
                rows=rows,
                columns=np.array([*columns, *(system.w.shape[1] + k for k in slopes)], dtype=np.intp),
                weights=fit.weights[rows],
                rho=fit.residual[rows] * fit.weights[rows],
                size=size,
                q=q,
                r=r,
                held=held,
            )
        )
    return limbs


def _freed(q: Array, columns: Array) -> Array:
    """Return columns without their part in the space of Q, (r, n); zero where nothing but rounding is left."""
    free = columns - q @ (q.T @ columns)
    clear = np.linalg.norm(free, axis=0) > ROUNDING * np.linalg.norm(columns, axis=0)
    return np.asarray(free * clear)


def _between_reversals(system: LinearSystem, speeds: Array, joint: int) -> list[Rows]:
    """Return the rows of a joint between the reversals of its velocity, window by window."""
    stretches: list[Rows] = []
    first = system.joints[joint].start
    for block in system.joint_blocks[joint]:
        start, stop = block.rows.start, block.rows.stop
        moving = np.sign(speeds[start - first : stop - first, joint])
        edges = [0]
        for cut in [*(np.flatnonzero(np.diff(moving)) + 1).tolist(), stop - start]:
            if cut - edges[-1] >= FEWEST_ROWS or cut == stop - start:
                edges.append(cut)
        stretches += [np.arange(start + a, start + b) for a, b in pairwise(edges) if b > a]
    return stretches


@dataclass(frozen=True, eq=False)
class _Tried:
    """A law at the joints of a limb, with a column for each, and further ones of the unknown state at the start of memory.

    Attributes
    ----------
    law : LawColumns
        The law.
    free : (n_rows, k) array
        Weighted columns without their part in the span of A, and zero where nothing is left; those of joint i are i and, of a
        start, i plus the number of joints.
    change : (n_columns, k) array
        Change of the limb's unknowns with a unit of each.
    gain : (m, n_joints) array
        By how much the squared residual of the rows of a block and a joint falls with the amounts of all other blocks.
    """

    law: LawColumns
    free: Array
    change: Array
    gain: Array

    @classmethod
    def of(cls, limb: _Limb, law: LawColumns, start: Array | None, stretches: Sequence[Rows]) -> _Tried:
        """Return a law at all joints of a limb."""
        used = limb.weighted(law.columns)
        if start is not None:
            used = np.hstack([used, limb.weighted(start)])
        free = _freed(limb.q, used)
        unit, _ = unit_columns(free)
        products = np.array([unit[rows].T @ unit[rows] for rows in stretches])
        moments = np.array([unit[rows].T @ limb.rho[rows] for rows in stretches])
        inverse = np.linalg.pinv(products.sum(axis=0) - products, rcond=ROUNDING, hermitian=True)
        others = np.einsum("mab,mb->ma", inverse, moments.sum(axis=0) - moments)
        count = len(limb.rows) // len(limb.joints)
        gain = np.zeros((len(stretches), len(limb.joints)))
        for block, rows in enumerate(stretches):
            predicted = unit[rows] @ others[block]
            fallen = predicted * (2.0 * limb.rho[rows] - predicted)
            gain[block] = np.bincount(rows // count, fallen, len(limb.joints))
        # A column of which nothing is left has an amount of zero.
        return cls(law, free, limb.moved(used), gain)

    def of_joint(self, index: int) -> list[int]:
        """Return the numbers of a joint's columns: of the law, and of its start."""
        return list(range(index, self.free.shape[1], self.gain.shape[1]))


def _missing_laws(
    candidates: Sequence[LawColumns],
    limbs: Sequence[_Limb],
    system: LinearSystem,
    along: Along,
    alarmed: NDArray[np.bool_],
) -> tuple[tuple[MissingLaw, ...], Array, str]:
    """Return the law of each joint that may lack one, the change of the unknowns with all, and the family that gains most.

    The first row of the changes, (1 + m, b + v), is that of the amounts, the others the share of each block in its error.
    """
    starts = [candidate.start(along.parts, along.signal) for candidate in candidates]
    time = [part.rows for part in intervals(system.blocks, TIME_BLOCKS)]
    changes = np.zeros((1 + len(time), system.w.shape[1] + len(system.slopes)))
    missing: list[MissingLaw] = []
    gains: dict[str, float] = {}
    for limb in limbs:
        if not alarmed[list(limb.joints)].any():
            continue
        stretches = limb.own(time)
        tried = [_Tried.of(limb, *pair, stretches) for pair in zip(candidates, starts, strict=True)]
        chosen: list[tuple[int, _Tried, list[int]]] = []
        for index, joint in enumerate(limb.joints):
            best = max(tried, key=lambda each: float(each.gain[:, index].sum()))
            if best.free[:, index].any() and (alarmed[joint] or best.gain[:, index].sum() > 0.0):
                chosen.append((index, best, best.of_joint(index)))
        free = np.hstack([each.free[:, own] for _, each, own in chosen])
        change = np.hstack([each.change[:, own] for _, each, own in chosen])
        unit, size = unit_columns(free)
        inverse = np.linalg.pinv(unit.T @ unit, rcond=ROUNDING, hermitian=True)
        solution = inverse @ (unit.T @ limb.rho)
        left = limb.rho - unit @ solution
        # Errors of blocks are independent, those within a block may be alike: `m / (m - 1)` as in the jackknife.
        scores = np.array([unit[rows].T @ left[rows] for rows in stretches])
        errors = scores @ inverse * np.sqrt(len(stretches) / (len(stretches) - 1.0))
        amounts = np.vstack([solution, errors]) / size
        changes[:, limb.columns] = amounts @ change.T
        first = 0
        for index, each, own in chosen:
            family = each.law.family
            if alarmed[limb.joints[index]]:
                gains[family] = gains.get(family, 0.0) + float(each.gain[:, index].sum())
            missing.append(each.law.at(limb.joints[index], amounts[:, first]))
            first += len(own)
    return tuple(missing), changes, max(gains, key=lambda key: gains[key], default="")


STRIBECK = (0.05, 0.1, 0.2, 0.4)
"""Stribeck velocities (rad/s) of the hypotheses; a factor of two changes the column clearly."""
ATAN = (0.05, 0.2, 0.8)
"""Velocities (rad/s) of the arctangents among the hypotheses."""
WIDTHS = (0.003, 0.01, 0.03, 0.1)
"""Displacements (rad) of Dahl's memory among the hypotheses."""
PRISMATIC = 0.1
"""Ratio of velocities and displacements of a prismatic joint (m/s, m) to those of a revolute one (rad/s, rad)."""
RESOLVED_STEPS = 20.0
"""Smallest number of encoder steps within the smallest of `WIDTHS`: quantisation by coarser steps looks like memory of any
width."""


@dataclass(frozen=True, eq=False)
class LawColumns:
    """Law at one velocity or width.

    Attributes
    ----------
    family : {"stribeck", "atan", "load", "dahl"}
        The law.
    columns : ndarray, shape (n_rows, n_dof)
        Decimated column of each joint, zero where the joint does not test it.
    amplitude : ndarray, shape (n_dof,)
        Largest friction along the log per unit of the column.
    velocity : ndarray, shape (n_dof,)
        Velocities of the law (rad/s or m/s), or displacements of memory (rad or m): zero where it has none or is not tested.
    """

    family: str
    columns: Array
    amplitude: Array
    velocity: Array

    def at(self, joint: int, amounts: Array) -> MissingLaw:
        """Return the law at a joint, with an amount per unit of its column and the shares of the blocks in its error."""
        amount, *errors = amounts.tolist()
        return MissingLaw(
            joint=joint,
            law=self.family,
            velocity=float(self.velocity[joint]),
            amount=amount,
            by_block=tuple(errors),
        )

    def start(self, parts: Sequence[Window], signal: SignalProcessing) -> Array | None:
        """Return the columns of the unknown state at the first sample, (n_rows, n_dof); None for a law without memory."""
        if self.family != "dahl":
            return None
        joints = np.flatnonzero(self.velocity)
        values = [start_column(part.q[:, joints], self.velocity[joints]) for part in parts]
        columns = np.zeros_like(self.columns)
        columns[:, joints] = decimated(values, parts, signal)
        return columns


def joint_scales(robot: Robot) -> Array:
    """Return the factors of velocities and displacements of the laws, (n_dof,): 1 of revolute joints, `PRISMATIC` of others."""
    return np.array([1.0 if kind == "revolute" else PRISMATIC for kind in robot.joint_kinds])


def laws_to_test(along: Along, refined: frozenset[str] = frozenset()) -> list[LawColumns]:
    """Return the laws that are tested, with their decimated columns.

    `refined` are the parameters whose velocities are estimated: no second law of the kind is told from a change of these.
    """
    robot, parts, signal, load = along.robot, along.parts, along.signal, along.load
    n = robot.n_dof
    encoder_step = np.zeros(n) if along.encoder_step is None else along.encoder_step
    unit = joint_scales(robot)
    known = {(term.law, term.joint) for term in robot.friction.terms}
    fitted = {(term.law, term.joint) for term in robot.friction.terms if term.parameter in refined}
    # A curve of speed may bend at more than one velocity.
    free = {
        law: np.array([(law, joint) not in fitted for joint in range(n)])
        for law in ("stribeck", "atan", "dahl")
    }
    loaded = np.array([("load", joint) not in known for joint in range(n)])
    signs = [direction(robot, part.q, part.dq) for part in parts]
    laws: list[LawColumns] = []

    def add(family: str, values: Sequence[Array], joints: NDArray[np.bool_], velocity: float = 0.0) -> None:
        if joints.any():
            own = values if joints.all() else [value * joints for value in values]
            rows = decimated(own, parts, signal)
            # Transposed first, because numpy reduces rows of few columns slowly.
            largest = np.max([np.abs(value.T, order="C").max(axis=1) for value in values], axis=0)
            laws.append(LawColumns(family, rows, largest, velocity * unit * joints))

    for velocity in STRIBECK:
        values = [
            sign * np.exp(-np.minimum(np.square(part.dq / (velocity * unit)), FADED))
            for part, sign in zip(parts, signs, strict=True)
        ]
        add("stribeck", values, free["stribeck"], velocity)
    for velocity in ATAN:
        values = [
            np.arctan(part.dq / (velocity * unit)) - 0.5 * np.pi * sign
            for part, sign in zip(parts, signs, strict=True)
        ]
        add("atan", values, free["atan"], velocity)
    add("load", [np.abs(torque) * sign for torque, sign in zip(load, signs, strict=True)], loaded)
    resolved = (WIDTHS[0] * unit >= RESOLVED_STEPS * encoder_step) & free["dahl"]
    if resolved.any():
        memories = [state(part.q, np.outer(WIDTHS, unit)) for part in parts]
        for k, width in enumerate(WIDTHS):
            values = [memory[k] - sign for memory, sign in zip(memories, signs, strict=True)]
            add("dahl", values, resolved, width)
    return laws


MOST_BLOCKS = 500
"""Number of blocks above which neighbouring ones are summed: their random signs take 4 000 numbers a block."""
FLIPS = 3999
"""Number of random sign patterns beside the observed one; the smallest probability is 1 in 4 000."""
MEMORY_SHARE = 0.25
"""Share of the false alarms allotted to memory laws; the other laws, tested separately, get the remainder."""
SEED = 20261
"""Seed of the patterns: the same log always gets the same probability."""
VISIBLE = 6.0
"""Score, in its standard deviation without the law, that makes a law detectable: with the law included in the deviation of 20
blocks it is 3.6."""


def joint_test(
    columns: Array,
    rho: Array,
    blocks: Sequence[Sequence[Rows]],
    memory: NDArray[np.bool_],
    tests: int = 1,
) -> tuple[Array, Array]:
    """Return the probability of the scores of a joint's columns, (n_rows, k), and by how many units of each the test sees it.

    Columns of zeros are not tested: their probability is one, and they are never seen (zero units).
    """
    scores = [np.array([columns[rows].T @ rho[rows] for rows in some]) for some in blocks]
    probability = tests * np.max([_flipped(part, memory, tests) for part in scores], axis=0)
    spread = np.max([np.sqrt(np.sum(np.square(part), axis=0)) for part in scores], axis=0)
    size = np.sum(np.square(columns), axis=0)
    return probability, VISIBLE * quotient(spread, size)


def _flipped(scores: Array, memory: NDArray[np.bool_], tests: int = 1) -> Array:
    """Return the probability of the scores of laws, (n_blocks, k), when the signs of blocks are flipped, (k,).

    The largest score counts, of laws of memory and of others, which share the false alarms. So do several tests, each of which
    has as many times the patterns.
    """
    if len(scores) > MOST_BLOCKS:
        scores = np.add.reduceat(scores, np.arange(MOST_BLOCKS) * len(scores) // MOST_BLOCKS, axis=0)
    spread = np.sqrt(np.sum(np.square(scores), axis=0))
    units = scores / np.where(spread > 0.0, spread, np.inf)
    # A pattern that is the observed one up to its sign counts, whatever the rounding.
    observed = np.abs(units.sum(axis=0)) * (1.0 - 1e-9)
    signs = _signs(len(scores), (FLIPS + 1) * tests - 1)
    drawn, probability = np.abs(signs @ units), np.ones(len(observed))
    for group, share in ((~memory, 1.0 - MEMORY_SHARE), (memory, MEMORY_SHARE)):
        tested = np.flatnonzero(group & (spread > 0.0))
        if tested.size:
            largest = np.max(drawn[:, tested], axis=1)[:, None]
            count = np.sum(largest >= observed[tested], axis=0)
            probability[tested] = np.minimum(1.0, (1.0 + count) / (len(signs) + 1) / share)
    return probability


@lru_cache(maxsize=8)
def _signs(blocks: int, count: int) -> Array:
    """Return the random signs of blocks, (count, blocks)."""
    return np.asarray(np.random.default_rng(SEED).integers(0, 2, (count, blocks)) * 2.0 - 1.0)


TURN = 0.01
"""Velocity (rad/s, times `PRISMATIC` for m/s) within which friction of a ``sign`` may turn smoothly: a fifth of the smallest
Stribeck velocity that is tested, so the laws remain visible. Chosen on the UR10e example, whose friction is a tanh of it."""


def sampling_errors(
    robot: Robot, parts: Sequence[Window], parameters: Sequence[Array], load: Sequence[Array]
) -> list[list[Array]]:
    """Return the errors of the torques along each part.

    Parameters
    ----------
    robot : Robot
        The model.
    parts : sequence of Window
        Motion with derivatives by central differences.
    parameters : sequence of ndarray, shape (n_parameters,)
        Standard parameters along each of the parts.
    load : sequence of ndarray, shape (n_samples, n_dof)
        Torques of links and rotors along each of the parts (N.m or N, joint side).

    Returns
    -------
    list of list of ndarray, shape (n_samples, n_dof)
        By error and part (N.m or N, joint side): of velocities, of accelerations and velocities at a jump, twice of fast
        velocities, of time, of holding, and, without a unit, of the turn of a ``sign``.
    """
    errors = [_errors(robot, *along) for along in zip(parts, parameters, load, strict=True)]
    return [list(error) for error in zip(*errors, strict=True)]


def slow_errors(
    errors: Sequence[Sequence[Array]], parts: Sequence[Window], signal: SignalProcessing
) -> list[list[Array]]:
    """Return the errors of `sampling_errors` through a low pass; none without a cut-off, or where they cannot be filtered."""
    if not errors or signal.cutoff_hz is None:
        return []
    slow = replace(signal, cutoff_hz=signal.cutoff_hz / SLOW, form="sections")
    try:
        passed = [
            low_pass(np.hstack([error[k] for error in errors]), part.rate_hz, slow)
            for k, part in enumerate(parts)
        ]
    except SignalError:  # the record is too short for so low a filter, or rounding spoils it
        return []
    return [list(error) for error in zip(*(np.split(one, len(errors), 1) for one in passed), strict=True)]


def _errors(robot: Robot, part: Window, x: Array, rigid: Array) -> list[Array]:
    """Return the errors along one part."""
    q, dq, ddq = part.q, part.dq, part.ddq
    torque, bend = inverse_dynamics(robot, q, dq, ddq, x), _curvature(dq)
    sharper = _curvature(bend)
    errors = [
        inverse_dynamics(robot, q, dq - bend / 6.0, ddq, x) - torque,
        inverse_dynamics(robot, q, dq - bend / 4.0, ddq - _curvature(ddq) / 3.0, x) - torque,
        *(
            inverse_dynamics(robot, q, dq - faster / 6.0, ddq, x) - torque
            for faster in (sharper, _curvature(sharper))
        ),
        np.gradient(rigid, axis=0),
        _curvature(rigid),
    ]
    if robot.friction.coulomb == "sign":
        errors.append(np.tanh(dq / (TURN * joint_scales(robot))) - instantaneous(robot, dq))
    return errors


def _curvature(values: Array) -> Array:
    """Return the second differences of signals, zero at both ends."""
    curvature = np.zeros_like(values)
    curvature[1:-1] = values[2:] - 2.0 * values[1:-1] + values[:-2]
    return curvature


EXCHANGED = 0.95
"""Size of the correlation of two friction parameters from which they exchange: the variance inflation factor of two columns is then
10, the usual limit of collinearity."""
SHARES = (10.0, 50.0, 90.0)
"""Percentiles of a joint's speeds in the log, above its dead zone, at which its friction is stated."""
CURVED = frozenset(("atan", "stribeck", "root"))
"""Laws of speed that can exchange with viscous and Coulomb friction."""


@dataclass(frozen=True, kw_only=True)
class FrictionAtSpeeds:
    """Friction of a joint that moves alone, in steady sliding, at speeds.

    Attributes
    ----------
    joint : int
        Joint, from 0.
    kind : {"revolute", "prismatic"}
        Its kind.
    speeds : tuple of float
        Speeds (rad/s or m/s).
    torques, low, high : tuple of float
        Friction at these speeds (N.m or N), half the difference between both directions at the median load, and both ends of its
        95 % interval.
    law : str
        Law that the model may lack at the joint, or empty.
    seen : bool
        Whether the residual of the joint shows that a law is missing; that of another joint does otherwise.
    parameters : tuple of str
        The parameter of a law of speed, and that of viscous or Coulomb friction with which it is most correlated, where they
        exchange; else empty.
    correlation : float
        Their correlation.
    refused : bool
        Whether the log does not identify the velocity of the law.
    """

    joint: int
    kind: str
    speeds: tuple[float, ...]
    torques: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    law: str = ""
    seen: bool = False
    parameters: tuple[str, ...] = ()
    correlation: float = 0.0
    refused: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Sliding:
    """What an estimate knows of friction in steady sliding.

    Attributes
    ----------
    robot : Robot
        Robot with known velocities of its laws.
    x : ndarray, shape (n_parameters,)
        Estimated standard parameters.
    load : ndarray, shape (n_dof,)
        Size of the torque of links and rotors (N.m or N).
    names, velocities : sequence of str
        Estimated base parameters, and parameters of the laws with an estimated velocity.
    covariance : ndarray, shape (n_names + n_velocities,) * 2
        Their covariance by noise.
    factor : float
        Half the width of a 95 % interval in standard deviations.
    alarm : FrictionAlarm or None
        Laws that are missing, and how the estimate moves with them.
    """

    robot: Robot
    x: Array
    load: Array
    names: Sequence[str]
    velocities: Sequence[str]
    covariance: Array
    factor: float
    alarm: FrictionAlarm | None = None

    def at(self, joint: int, speeds: Array) -> FrictionAtSpeeds:
        """Return friction of a joint at speeds above zero, (k,) in rad/s or m/s."""
        columns = _columns(self.robot, joint, speeds, self.load)
        values = dict(zip(self.robot.parameter_names, self.x, strict=True))
        nothing = np.zeros_like(speeds)
        slopes = [columns.get(name, nothing) for name in self.names]
        terms = {term.parameter: term for term in self.robot.friction.terms}
        one = np.ones_like(speeds)
        for term in (terms[name] for name in self.velocities):
            own = values[term.parameter] * slope_at(term.law, speeds, one, term.velocity)
            slopes.append(own if term.joint == joint else nothing)
        h = np.array(slopes)
        torques = np.sum([values[name] * column for name, column in columns.items()], axis=0)
        variance = np.maximum(np.einsum("as,ab,bs->s", h, self.covariance, h), 0.0)
        bias, here = nothing, [law for law in self.missing if law.joint == joint]
        if self.alarm is not None and self.missing:
            bias, errors = self.alarm.moved @ h, self.alarm.by_block @ h
            for law in here:
                unit = law.steady(self.robot, speeds, self.load)
                bias, errors = bias + law.amount * unit, errors + np.outer(law.by_block, unit)
            variance = variance + np.sum(np.square(errors), axis=0)
        half = self.factor * bounded(np.sqrt(variance), bias)
        return FrictionAtSpeeds(
            joint=joint,
            kind=self.robot.joint_kinds[joint],
            speeds=tuple(speeds.tolist()),
            torques=tuple(torques.tolist()),
            low=tuple((torques - half).tolist()),
            high=tuple((torques + half).tolist()),
            law=here[0].law if here else "",
            seen=self.alarm is not None and joint in self.alarm.joints,
        )

    @property
    def missing(self) -> tuple[MissingLaw, ...]:
        """Laws that are missing."""
        return () if self.alarm is None else self.alarm.missing

    def where_open(self, parts: Sequence[Window]) -> tuple[FrictionAtSpeeds, ...]:
        """Return friction at speeds of a log, of joints whose parameters of friction do not say it.

        These are joints at which a law of speed exchanges with viscous or Coulomb friction, has no velocity, or is missing.
        """
        found: dict[int, dict[str, Any]] = {law.joint: {} for law in self.missing}
        std = np.sqrt(np.diag(self.covariance))
        for term in self.robot.friction.terms:
            if term.law not in CURVED or term.parameter not in self.names:
                continue
            own = self.names.index(term.parameter)
            beside = [index for index, name in enumerate(self.names) if name in friction_names(term.joint)]
            if not beside or not std[[own, *beside]].all():
                continue
            correlations = self.covariance[own, beside] / (std[own] * std[beside])
            most = int(np.argmax(np.abs(correlations)))
            if term.refused or abs(correlations[most]) >= EXCHANGED:
                found[term.joint] = {
                    "parameters": (term.parameter, self.names[beside[most]]),
                    "correlation": float(correlations[most]),
                    "refused": term.refused,
                }
        speeds = {joint: _speeds(self.robot, joint, parts) for joint in sorted(found)}
        return tuple(
            replace(self.at(joint, some), **found[joint]) for joint, some in speeds.items() if some.size
        )


def _speeds(robot: Robot, joint: int, parts: Sequence[Window]) -> Array:
    """Return speeds inside the log (rad/s or m/s); none for a joint that rests."""
    sizes = [np.abs(part.dq[instantaneous(robot, part.dq)[:, joint] != 0.0, joint]) for part in parts]
    moving = np.concatenate(sizes)
    return np.percentile(moving, SHARES) if moving.any() else np.zeros(0)


def _columns(robot: Robot, joint: int, speeds: Array, load: Array) -> dict[str, Array]:
    """Return the friction columns of a joint that moves alone in steady sliding, half the difference of both directions."""
    plain = robot.with_terms([term for term in robot.friction.terms if term.law not in OF_PATH])
    dq = np.zeros((2 * len(speeds), robot.n_dof))
    dq[:, joint] = np.concatenate([speeds, -speeds])
    still = np.zeros_like(dq)
    w = _core.regressor(plain.core, still, dq, still, None, np.tile(load, (len(dq), 1)))[:, joint]
    half = 0.5 * (w[: len(speeds)] - w[len(speeds) :])
    columns = {plain.parameter_names[index]: half[:, index] for index in friction_places(plain)}
    for term in robot.friction.terms:
        if term.law == "dahl" and term.joint == joint:  # its state is the sign
            columns[term.parameter] = instantaneous(plain, dq[: len(speeds)])[:, joint]
    return columns
