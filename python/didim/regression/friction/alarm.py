r"""Friction that the model lacks: a score test that sees it, and how far the parameters move with it.

A missing law repeats its error in every stretch of the log. Standard deviations from stretches left out cannot see it, and the
whiteness of decimated rows is that of their filter. The score of the law's column sees it. With ``A`` the weighted observation
matrix, ``rho`` the weighted residual and ``c`` the column of a law at one joint, weighted and freed of the columns of A:

    S_i = c_i^T rho_i           over block i,            t = sum_i S_i / sqrt(sum_i S_i^2)

Where the model is right, the sums of the blocks are as likely negative as positive, whatever the correlation within a block.
Flipping the signs of whole blocks, the same for all columns of a joint, gives the distribution of the largest ``|t|`` of its laws.
Blocks are taken in two ways, equal stretches of time and stretches between the reversals of the joint; both must alarm. Errors
of right models (`sampling`) have columns beside those of A for the scores. These columns are differences of the motion, so noise
of the positions is in them as it is in the residual. Low passes of them have hardly any of it, so an alarm is tried again with
these, and one law must alarm both times.

The shift of a family of laws is the change of the estimate with the columns of all joints beside A,

    b_h - b = -R^-1 Q^T C (C~^T C~)^-1 C~^T rho,        C~ = C - Q Q^T C,    A = Q R

After ``terms = "auto"`` the shift includes what the choice left open: a term whose gain on held-out blocks is not clear or that is
not chosen without one of them, and the other of atan and Stribeck's law where both fit. Their changes are independent: their
squares are added.

Sources: Liu (1988) and Cameron, Gelbach, Miller (2008) for flipped blocks; Schwarz (1978) for the choice among laws.
Tested in ``tests/test_friction_alarm.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ..._tools.arrays import Array
from ..._tools.saved import UNBOUNDED
from ...robot.robot import Robot
from ...signal.processing import SignalProcessing
from ...signal.window import Window
from ...terms.rows import LinearSystem, Rows, unit_columns
from ..fit import Fit
from ..jackknife import intervals
from .flips import joint_test
from .sampling import slow_errors
from .tested_laws import LawColumns, laws_to_test
from .velocity import decimated

TIME_BLOCKS = 20
"""Number of time stretches whose signs are flipped: long against the residual's correlation, many enough for a probability of 1
%."""
FEWEST_BLOCKS = 8
"""Number of blocks below which flips have too few patterns (2^7) for a probability of 1 %, and there is no test."""
LEVEL = 0.01
"""Largest false alarm rate of a test over all joints of a log: it is divided by the number of joints."""
FEWEST_ROWS = 3
"""Smallest number of rows of a stretch between two reversals; shorter ones join the next."""
ROUNDING = 1e-8
"""Norm of a column outside the span of A, as a share, below which the model already contains the column."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionAlarm:
    """Result of the score test for friction laws that the model lacks.

    Attributes
    ----------
    p_value : ndarray, shape (n_dof,)
        Probability of scores as large where the model is right, per joint, times the number of joints; the larger of the
        tests over stretches of time and between reversals, and of an alarm's two trials. One where a joint was not tested.
    law : str
        Family that explains the residual best: ``"stribeck"``, ``"atan"``, ``"load"`` or ``"dahl"``; empty without an alarm.
    tested : tuple of str
        Families that were tested.
    shift : ndarray, shape (b,)
        Largest change of each parameter, in its unit, on an alarm among the families, and always among the laws that fit the
        log as well as chosen ones; zero without either.
    visible : mapping of str to ndarray, shape (n_dof,)
        By family, the amplitude of its friction at each joint that the test would see (N.m or N), whichever of its
        velocities or widths it has: a score of `VISIBLE` deviations. Infinite where a joint was not tested.
    """

    p_value: Array
    law: str
    tested: tuple[str, ...]
    shift: Array
    visible: Mapping[str, Array] = field(metadata=UNBOUNDED)

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints, from 0, whose residual has the friction of a law that the model lacks."""
        return tuple(int(joint) for joint in np.flatnonzero(self.p_value < LEVEL))

    @property
    def raised(self) -> bool:
        """Whether the test alarms."""
        return bool(self.joints)


@dataclass(frozen=True, eq=False)
class _Limb:
    """Joints that share columns: their rows, joint by joint, and ``A = Q R`` of their scaled and weighted columns."""

    joints: tuple[int, ...]
    rows: Rows
    columns: Rows
    weights: Array
    rho: Array
    size: Array
    q: Array
    r: Array

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


def friction_alarm(
    system: LinearSystem,
    fit: Fit,
    robot: Robot,
    parts: Sequence[Window],
    signal: SignalProcessing,
    load: Sequence[Array],
    encoder_step: Array | None = None,
    sampling_errors: Sequence[Sequence[Array]] = (),
) -> FrictionAlarm:
    """Test a residual for friction laws that the model lacks.

    Parameters
    ----------
    system : LinearSystem
        The system (7), made of `parts`.
    fit : Fit
        Its solution, with residual and weights.
    robot : Robot
        Robot of the system; load friction that a joint has already is not tested there.
    parts : sequence of Window
        Motion along which the columns are.
    signal : SignalProcessing
        Decimation.
    load : sequence of ndarray, shape (n_samples, n_dof)
        Torques of links and rotors along each of the parts with the estimate (N.m or N, joint side).
    encoder_step : ndarray, shape (n_dof,), optional
        Step of the position encoder of each joint (rad or m), zero where it is not seen. A joint whose steps are coarser
        than `RESOLVED_STEPS` of `tested_laws` allows is not tested for memory.
    sampling_errors : sequence of sequence of ndarray, shape (n_samples, n_dof)
        Errors of the torques along each of the parts, of an amount at each joint that is not known (N.m or N, joint side):
        scores are freed of them as of the columns of A.

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
    n = robot.n_dof
    step = np.zeros(n) if encoder_step is None else encoder_step
    candidates = laws_to_test(robot, parts, signal, load, step)
    tested = tuple(dict.fromkeys(candidate.family for candidate in candidates))
    limbs = _limbs(system, fit)
    speeds = decimated([part.dq for part in parts], parts, signal)

    def tested_with(errors: Sequence[Sequence[Array]]) -> tuple[Array, Array]:
        every = [decimated(values, parts, signal) for values in errors]
        return _tested(system, limbs, candidates, every, speeds)

    probability, seen = tested_with(sampling_errors)
    if (probability < LEVEL).any() and (slow := slow_errors(sampling_errors, parts, signal)):
        probability, seen = np.maximum((probability, seen), tested_with(slow))
    p_value = np.min(probability, axis=0)
    families = np.array([candidate.family for candidate in candidates])
    visible = {family: np.max(seen[families == family], axis=0) for family in tested}
    moved: dict[str, tuple[float, Array]] = {}
    if (p_value < LEVEL).any():
        starts = [candidate.start(parts, signal) for candidate in candidates]
        moved = _shifts(candidates, starts, limbs, system)
    b = system.w.shape[1]
    changes = [np.abs(change[:b]) for _, change in moved.values()]
    return FrictionAlarm(
        p_value=p_value,
        law=min(moved, key=lambda family: moved[family][0], default=""),
        tested=tested,
        shift=np.max([_open_shift(system, fit), *changes], axis=0),
        visible={family: np.where(values > 0.0, values, np.inf) for family, values in visible.items()},
    )


def _tested(
    system: LinearSystem,
    limbs: Sequence[_Limb],
    candidates: Sequence[LawColumns],
    errors: Sequence[Array],
    speeds: Array,
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
            probability, units = joint_test(columns, limb.rho, blocks, memory)
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


def _shifts(
    candidates: Sequence[LawColumns],
    starts: Sequence[Array | None],
    limbs: Sequence[_Limb],
    system: LinearSystem,
) -> dict[str, tuple[float, Array]]:
    """Return for each family its best criterion of Schwarz and the change of the estimate and the velocities with it."""
    best: dict[str, tuple[float, Array]] = {}
    n_rows = system.y.size / len(system.joints)
    for candidate, start in zip(candidates, starts, strict=True):
        criterion, count = 0.0, 0
        change = np.zeros(system.w.shape[1] + len(system.slopes))
        for limb in limbs:
            used = limb.weighted(candidate.columns)
            if start is not None:
                used = np.hstack([used, limb.weighted(start)])
            seen = limb.q.T @ used
            free = used - limb.q @ seen
            size = np.linalg.norm(free, axis=0)
            independent = size > ROUNDING * np.linalg.norm(used, axis=0)
            left = limb.rho
            if independent.any():
                unit = free[:, independent] / size[independent]
                # Products of unit columns: as many as columns, where the rows are thousands.
                amount = np.linalg.lstsq(unit.T @ unit, unit.T @ limb.rho, rcond=None)[0]
                left = left - unit @ amount
                amount /= size[independent]
                change[limb.columns] = -np.linalg.solve(limb.r, seen[:, independent] @ amount) / limb.size
            squares = np.sum(np.square(left.reshape(len(limb.joints), -1)), axis=1)
            criterion += n_rows * float(np.sum(np.log(squares))) + int(independent.sum()) * np.log(n_rows)
            count += int(independent.sum())
        if count and (candidate.family not in best or criterion < best[candidate.family][0]):
            best[candidate.family] = (criterion, change)
    return best
