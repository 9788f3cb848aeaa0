"""Choice among columns by the error on held-out blocks, from products of columns alone.

With ``A`` the weighted columns, ``G = A^T A`` of the rows that a block is predicted from and ``G_o`` of the block itself, the
squared error of the block is ``y^T y - 2 b^T g_o + b^T G_o b`` at ``b = G^-1 g``, for any subset of the columns. A further
column c moves b along ``d = (-G^-1 G_c, 1)`` by ``(g_c - G_c^T b) / (G_cc - G_c^T G^-1 G_c)``: all candidates are tried at once.
Tested in ``tests/test_friction_choice.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array
from ...robot.friction import FrictionTerm
from ...terms.rows import LinearSystem
from .candidates import Candidate

HELD_OUT_BLOCKS = 5
"""Number of held-out blocks: contiguous parts of the log, all joints together."""
BLOCK_GAP_ROWS = 5
"""Number of rows beside a held-out block that are not fitted either: neighbouring residuals are correlated."""
LEAST_SIGNIFICANCE = 1.0
"""Smallest gain of a term, in its standard error between the blocks."""
CLEAR = 2.78
"""Gain of a law, in its standard error, from which the log decides for it, against none or another law: Student's 97.5 % quantile
for the four degrees of freedom of five blocks. Below it the parameters' standard deviations include the law's shift."""
SMALLEST_GAIN = 1e-3
"""Smallest gain of a term, as a share of the squared held-out error of all joints: less does not justify a parameter."""
SPRING_GAIN = 0.1
"""Smallest gain of a spring, as a share of the squared held-out error: a counterbalance carries much of gravity, and smaller
gains follow gravity's own columns. Chosen on the real TX40, where springs with a gain of 1 to 3 % move its parameters away from
Table II."""
WORSE = 5e-3
"""Largest share by which a term may raise the squared error of a recording predicted from the others."""
REFINEMENTS = 3
"""Upper bound of the sweeps that remove terms and refine velocities after the choice."""
RIDGE = 1e-12
"""Addition to products of unit columns, as a share of their diagonal: dependent columns then stay solvable."""


@dataclass(frozen=True)
class Move:
    """A term, the share that it takes off the squared held-out error without it, and that over its standard error."""

    term: FrictionTerm
    gain: float
    significance: float
    clear: bool


def significance(change: Array) -> Array:
    """Return the sum of changes of the blocks' errors, (n_blocks, ...), over its standard error, (...)."""
    error = change.std(axis=0, ddof=1) * np.sqrt(len(change))
    return np.asarray(change.sum(axis=0) / np.where(error > 0.0, error, np.finfo(float).tiny))


def clear(change: Array) -> NDArray[np.bool_]:
    """Whether changes of the blocks' errors, (n_blocks, ...), are clear of noise, (...): `CLEAR`, or of one sign in all blocks.

    Blocks of different motion gain differently, so a law that each of them needs may have a large standard error.
    """
    one_sign = np.abs(np.sign(change).sum(axis=0)) == len(change)
    return np.asarray(one_sign | (np.abs(significance(change)) >= CLEAR))


class Folds:
    """Rows that are held out together, in every joint, and those near them."""

    def __init__(self, system: LinearSystem) -> None:
        rows = system.joints[0].stop - system.joints[0].start
        self.blocks = list(pairwise(np.linspace(0, rows, HELD_OUT_BLOCKS + 1).round().astype(int).tolist()))
        self.near = [
            (max(0, start - BLOCK_GAP_ROWS), min(rows, stop + BLOCK_GAP_ROWS)) for start, stop in self.blocks
        ]
        self.recordings = _recordings(system)

    def squares(self, system: LinearSystem, residual: Array) -> Array:
        """Return the squared residual of each block and joint of a system of the same rows, (n_blocks, n_dof)."""
        return np.array(
            [
                [float(np.sum(np.square(residual[rows][start:stop]))) for rows in system.joints]
                for start, stop in self.blocks
            ]
        )

    def relative_error(self, system: LinearSystem, weights: Array) -> float:
        """Return the relative error of all held-out blocks of a system of the same rows, without weights."""
        w, y = system.w, system.y
        rows = system.joints[0].stop - system.joints[0].start
        time = np.concatenate([np.arange(rows)] * len(system.joints))
        squares = 0.0
        for (start, stop), (low, high) in zip(self.blocks, self.near, strict=True):
            inside, outside = (time < low) | (time >= high), (time >= start) & (time < stop)
            scale = weights[inside]
            beta = np.linalg.lstsq(w[inside] * scale[:, None], y[inside] * scale, rcond=None)[0]
            squares += float(np.sum((y[outside] - w[outside] @ beta) ** 2))
        return float(np.sqrt(squares) / np.linalg.norm(system.measured))


def _recordings(system: LinearSystem) -> list[list[tuple[int, int]]]:
    """Return the rows of each recording within a joint, as ranges; nothing where there is only one."""
    first = system.joints[0].start
    windows: dict[int, list[tuple[int, int]]] = {}
    for block in system.joint_blocks[0]:
        windows.setdefault(block.recording, []).append((block.rows.start - first, block.rows.stop - first))
    return list(windows.values()) if len(windows) > 1 else []


@dataclass
class _Fold:
    """Products of unit columns, torques last: of held-out rows, and of those that they are predicted from."""

    held: Array
    fitted: Array


@dataclass
class _State:
    """Columns that are in the model now."""

    base: list[int]
    columns: list[int] = field(default_factory=list)
    holds: set[int] = field(default_factory=set)

    def without(self, column: int) -> _State:
        """Return the same model without a column."""
        return replace(self, columns=[k for k in self.columns if k != column])


@dataclass(frozen=True)
class _Step:
    """A joint whose sign is kept, a column that is added, or both, and the share of the squared error that this takes away."""

    hold: int | None
    added: int | None
    gain: float


class Screen:
    """The columns of a plain system and of candidates, and which of them held-out blocks support.

    Parameters
    ----------
    system : LinearSystem
        The plain system (7).
    weights : ndarray, shape (r,)
        Weights of its rows.
    pool : sequence of Candidate
        Further columns.
    """

    def __init__(self, system: LinearSystem, weights: Array, pool: Sequence[Candidate]) -> None:
        self.pool = list(pool)
        self.memory = True
        self.n = len(system.names)
        self.held_coulomb = {
            one.term.joint: self.n + k for k, one in enumerate(self.pool) if one.term.law == "hold"
        }
        self.coulomb = {joint: system.names.index(f"Fc{joint + 1}") for joint in self.held_coulomb}
        self.springs = [self.n + k for k, one in enumerate(self.pool) if one.term.law == "spring"]
        folds = Folds(system)
        blocks, near = folds.blocks, folds.near
        parts = [[part] for part in blocks] + [[part] for part in near] + folds.recordings
        products = self._products(system, weights, parts)
        whole = sum(products[: len(blocks)], np.zeros_like(products[0]))
        size = np.sqrt(np.maximum(np.diag(whole), np.finfo(float).tiny))
        size[-1] = 1.0
        scale = np.outer(size, size)
        self.blocks = [
            _Fold(block / scale, (whole - around) / scale)
            for block, around in zip(products[: len(blocks)], products[len(blocks) :], strict=False)
        ]
        self.recordings = [_Fold(one / scale, (whole - one) / scale) for one in products[2 * len(blocks) :]]

    def _products(
        self, system: LinearSystem, weights: Array, parts: Sequence[Sequence[tuple[int, int]]]
    ) -> list[Array]:
        """Multiply all columns over parts of the rows; a candidate is zero in the rows of other joints."""
        n, total = self.n, self.n + len(self.pool) + 1
        products = [np.zeros((total, total)) for _ in parts]
        for joint, rows in enumerate(system.joints):
            own = [k for k, candidate in enumerate(self.pool) if candidate.term.joint == joint]
            columns = [system.w[rows], *(self.pool[k].column[:, None] for k in own), system.y[rows][:, None]]
            a = np.hstack(columns) * weights[rows][:, None]
            places = np.array([*range(n), *(n + k for k in own), total - 1])
            for product, ranges in zip(products, parts, strict=True):
                for start, stop in ranges:
                    product[np.ix_(places, places)] += a[start:stop].T @ a[start:stop]
        return products

    def chosen(self) -> list[Move]:
        """Choose terms one after the other; with what the blocks would lose without each, the largest loss first."""
        state = self._supported_state()
        moves = [
            self._worth(self.pool[self.held_coulomb[joint] - self.n].term, self._toggled(state, joint), state)
            for joint in sorted(state.holds)
        ]
        moves += [
            self._worth(self.pool[index - self.n].term, state.without(index), state)
            for index in state.columns
        ]
        return sorted(moves, key=lambda move: -move.gain)

    def recurring(self) -> set[tuple[int, str]]:
        """Return joint and family of the laws that are chosen whichever block the choice lacks, neither held out nor fitted."""
        choices = []
        for left_out in range(len(self.blocks)):
            held = [fold.held for k, fold in enumerate(self.blocks) if k != left_out]
            total = sum(held, np.zeros_like(held[0]))
            other = copy(self)
            other.blocks = [_Fold(block, total - block) for block in held]
            columns = other._supported_state().columns
            choices.append({law_at(self.pool[k - self.n].term) for k in columns})
        return set.intersection(*choices)

    def _supported_state(self) -> _State:
        """Return the columns that the blocks support, added one after the other and refined."""
        state = _State(base=list(range(self.n)))
        # Memory last, and beside a sign that is kept: in its place a state of little width predicts other motions worse.
        for self.memory in (False, True):
            while (step := self._best_step(state)) is not None:
                if step.hold is not None:
                    state = self._toggled(state, step.hold)
                if step.added is not None:
                    state.columns.append(step.added)
            state = self._refined(state)
        return state

    def _worth(self, term: FrictionTerm, without: _State, state: _State) -> Move:
        """Return what a term takes off the error that the blocks have without it."""
        before = self._errors(without)
        change = before - self._errors(state)
        return Move(
            term, float(change.sum() / before.sum()), float(significance(change)), bool(clear(change))
        )

    def _toggled(self, state: _State, joint: int) -> _State:
        """Return the same model with the sign of a joint kept, or no longer, and its columns those of that sign."""
        holds = state.holds ^ {joint}
        swap = {self.coulomb[joint]: self.held_coulomb[joint]}
        if joint in state.holds:
            swap = {b: a for a, b in swap.items()}
        base = [swap.get(k, k) for k in state.base]
        columns = [self._twin(k, joint, joint in holds) for k in state.columns]
        return _State(base, columns, holds)

    def _twin(self, index: int, joint: int, held: bool) -> int:
        """Return the column of the same term at a joint that holds its sign, or does not."""
        candidate = self.pool[index - self.n]
        if candidate.held is None or candidate.term.joint != joint:
            return index
        return next(
            self.n + k
            for k, other in enumerate(self.pool)
            if other.term == candidate.term and other.held == held
        )

    def _open(self, state: _State, joint: int | None = None) -> list[int]:
        """Return the columns that may be added: of a term that is not there yet, for the sign that its joint has."""
        there = {law_at(self.pool[k - self.n].term) for k in state.columns}
        return [
            self.n + k
            for k, candidate in enumerate(self.pool)
            if candidate.term.law != "hold"
            and (candidate.term.law != "dahl" or (self.memory and candidate.term.joint in state.holds))
            and (joint is None or candidate.term.joint == joint)
            and law_at(candidate.term) not in there
            and candidate.held in (None, candidate.term.joint in state.holds)
        ]

    def _best_step(self, state: _State) -> _Step | None:
        """Return the best step that the blocks support and no recording refuses; None without one."""
        places = self._open(state)
        before, drops = self._drops(state, places)
        steps = self._steps(before, before, drops, places, None)
        for joint in self.coulomb:
            if joint not in state.holds:
                other = self._toggled(state, joint)
                places = self._open(other, joint)
                base, drops = self._drops(other, places)
                steps += self._steps(before, base, drops, places, joint)
        steps.sort(key=lambda step: -step.gain)
        return next((step for step in steps if self._keeps_recordings(state, step)), None)

    def _steps(
        self, before: Array, base: Array, drops: Array, places: Sequence[int], joint: int | None
    ) -> list[_Step]:
        """Return the supported steps from one sign of the joints: each column, and the other sign by itself."""
        changes = (before - base)[:, None] + np.hstack([np.zeros((len(before), 1)), drops])
        return [
            _Step(joint, index, float(changes[:, k].sum() / before.sum()))
            for k, index in enumerate([None, *places])
            if (joint is not None or index is not None)
            and self._supported(changes[:, k], before)
            and not (index in self.springs and changes[:, k].sum() <= SPRING_GAIN * before.sum())
        ]

    @staticmethod
    def _supported(change: Array, before: Array) -> bool:
        """Whether a change of the blocks' errors exceeds its standard error, and is worth a parameter."""
        return bool(significance(change) > LEAST_SIGNIFICANCE and change.sum() > SMALLEST_GAIN * before.sum())

    def _keeps_recordings(self, state: _State, step: _Step) -> bool:
        """Whether no recording is predicted worse from the others with a step than without it."""
        after = state if step.hold is None else self._toggled(state, step.hold)
        columns = [*after.base, *after.columns, *([] if step.added is None else [step.added])]
        before = [*state.base, *state.columns]
        return all(_error(fold, columns) <= (1.0 + WORSE) * _error(fold, before) for fold in self.recordings)

    def _drops(self, state: _State, places: Sequence[int]) -> tuple[Array, Array]:
        """Return the squared error of each block (f,), and by how much each column lowers it (f, k); not where it drives."""
        current = [*state.base, *state.columns]
        pairs = [_drop(fold, current, list(places)) for fold in self.blocks]
        drops = np.stack([drop for _, drop, _ in pairs])
        amounts = np.stack([amount for _, _, amount in pairs])
        driving = np.array([self.pool[k - self.n].term.law in ("load", "dahl") for k in places], dtype=bool)
        drives = driving & (amounts <= 0.0).any(axis=0)
        return np.array([error for error, _, _ in pairs]), np.where(drives, 0.0, drops)

    def _refined(self, state: _State) -> _State:
        """Take terms away that gain nothing, and move velocities along their grid."""
        for _ in range(REFINEMENTS):
            last = (list(state.columns), set(state.holds))
            for index in last[0]:
                candidate = self.pool[index - self.n].term
                rest = state.without(index)
                family = [
                    self.n + k
                    for k, other in enumerate(self.pool)
                    if (other.term.joint, other.term.law) == (candidate.joint, candidate.law)
                    and other.held in (None, candidate.joint in rest.holds)
                ]
                base, drops = self._drops(rest, family)
                best = int(np.argmax(drops.sum(axis=0)))
                supported = [family[best]] if self._supported(drops[:, best], base) else []
                state = replace(rest, columns=[*rest.columns, *supported])
            for joint in sorted(last[1]):
                other = self._toggled(state, joint)
                without, with_it = self._errors(other), self._errors(state)
                # Beside memory a sign that is kept stays unless it does harm.
                if (
                    self._supported(with_it - without, with_it)
                    if self.memory
                    else not self._supported(without - with_it, without)
                ):
                    state = other
            if (sorted(state.columns), state.holds) == (sorted(last[0]), last[1]):
                break
        return state

    def _errors(self, state: _State) -> Array:
        return np.array([_error(fold, [*state.base, *state.columns]) for fold in self.blocks])


def law_at(term: FrictionTerm) -> tuple[int, str]:
    """Return joint and family, of which the joint has one law at most: atan and Stribeck's law explain the same residual."""
    return term.joint, "curve" if term.law in ("atan", "stribeck") else term.law


def _solved(fold: _Fold, current: Sequence[int], right: Array) -> Array:
    """Solve the products of the fitted rows."""
    matrix = fold.fitted[np.ix_(current, current)]
    return np.asarray(np.linalg.solve(matrix + RIDGE * np.eye(len(current)), right))


def _error(fold: _Fold, current: Sequence[int]) -> float:
    """Return the squared error of the held-out rows."""
    return _drop(fold, current, [])[0]


def _drop(fold: _Fold, current: Sequence[int], places: Sequence[int]) -> tuple[float, Array, Array]:
    """Return the squared error of the held-out rows; by how much each further column lowers it; the amount of the column."""
    fitted, held = fold.fitted, fold.held
    across = fitted[np.ix_(current, places)]
    solved = _solved(fold, current, np.column_stack([fitted[current, -1], across]))
    beta, moves = solved[:, 0], solved[:, 1:]
    own, own_held = fitted[places, places], held[places, places]
    size = own - np.sum(across * moves, axis=0)
    clear = size > 1e-9 * own
    amount = np.where(clear, (fitted[places, -1] - across.T @ beta) / np.where(clear, size, 1.0), 0.0)
    inner = held[np.ix_(current, current)]
    across_held = held[np.ix_(current, places)]
    rest = held[current, -1] - inner @ beta
    error = float(held[-1, -1] - 2.0 * beta @ held[current, -1] + beta @ inner @ beta)
    along = held[places, -1] - across_held.T @ beta - moves.T @ rest
    square = own_held - 2.0 * np.sum(moves * across_held, axis=0) + np.sum(moves * (inner @ moves), axis=0)
    return error, 2.0 * amount * along - np.square(amount) * square, amount
