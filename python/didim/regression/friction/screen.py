"""Errors of blocks of a log that are left out, with the laws of its friction and without.

With ``A`` the weighted columns, ``G = A^T A`` of the rows that a block is predicted from and ``G_o`` of the block itself, the
squared error of the block is ``y^T y - 2 b^T g_o + b^T G_o b`` for any subset of the columns, whose parameters b solve

    min 1/2 b^T G b - b^T g + prior,    b of a robot that can exist

or plain least squares where no such robot is known. A further column c moves b along ``d = (-H^-1 G_c, 1)``, where H adds the
curvature of the prior to G: all candidates are ranked by it at once, and the best are solved. Errors are compared by their
likelihood, with a variance for each joint. Tested in ``tests/test_friction_choice.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array
from ...errors import FitError
from ...model.dynamics import rigid_torque
from ...robot.friction import FrictionTerm
from ...signal.window import Window
from ...terms.model import Model
from ...terms.rows import LinearSystem
from ..consistent.prior import Prior
from ..consistent.problem import ConstrainedProblem
from ..consistent.solver import CONSISTENT
from ..least_squares import joint_sigma, per_row
from .candidates import Candidate

BLOCKS = 10
"""Number of blocks that are left out in turn: contiguous parts of the log, all joints together."""
GAP_ROWS = 5
"""Number of rows beside a block that are not fitted either: neighbouring residuals are correlated."""
LEAST_SIGNIFICANCE = 2.26
"""Smallest gain of a law, in its standard error between the blocks: Student's 97.5 % quantile for the nine degrees of freedom of
ten blocks."""
SMALLEST_GAIN = 1e-3
"""Smallest gain of a law (nats) for each row of the log: half of 0.2 % of the squared error of all joints."""
LEAST_NATS = 3.0
"""Smallest gain of a law (nats) on a short log: white noise gains as much by one of the kinds of laws at a joint in thirty."""
SPRING_GAIN = 0.1
"""Smallest gain of a spring, as a share of the squared error of blocks left out: a counterbalance carries much of gravity, and
smaller gains follow gravity's own columns. Chosen on the real TX40, where springs with a gain of 1 to 3 % move its parameters
away from Table II."""
LARGEST_SHIFT = 0.03
"""Largest change of the torque of links and rotors by a law of friction, as a share of it, along motion of new combinations."""
SHUFFLED = 400
"""Number of samples of that motion."""
RIDGE = 1e-12
"""Addition to products of unit columns, as a share of their diagonal: dependent columns then stay solvable."""


class Worth(NamedTuple):
    """What a law takes off the errors of blocks left out.

    Attributes
    ----------
    nats : float
        Gain of the likelihood of all blocks.
    significance : float
        Gain over its standard error between the blocks.
    share : float
        Share of the squared weighted error.
    shift : float
        Share by which the law moves the torque of links and rotors along motion of new combinations.
    supported : bool
        Whether the blocks justify it.
    """

    nats: float
    significance: float
    share: float
    shift: float
    supported: bool


@dataclass(frozen=True)
class Move:
    """A law and its worth beside all others."""

    term: FrictionTerm
    worth: Worth


@dataclass(frozen=True)
class State:
    """Laws that are in the model: candidates by number, and joints whose sign is kept."""

    columns: tuple[int, ...] = ()
    holds: frozenset[int] = frozenset()


def significance(change: Array) -> Array:
    """Return the sum of changes of the blocks' errors, (n_blocks, ...), over its standard error, (...)."""
    error = change.std(axis=0, ddof=1) * np.sqrt(len(change))
    return np.asarray(change.sum(axis=0) / np.where(error > 0.0, error, np.finfo(float).tiny))


def gained(before: Array, after: Array, counts: Array) -> Array:
    """Return the gain of the likelihood (nats) of each block, (n_blocks,).

    `before` and `after` are the squared errors of the blocks, `counts` the numbers of rows, (n_blocks, n_dof) each; each joint has
    the variance of all its errors.
    """
    rows = counts.sum(axis=0)
    old, new = (np.maximum(one.sum(axis=0) / rows, np.finfo(float).tiny) for one in (before, after))
    return np.asarray(0.5 * (before / old - after / new + counts * np.log(old / new)).sum(axis=1))


def law_at(term: FrictionTerm) -> tuple[int, str]:
    """Return joint and family, of which the joint has one law at most: atan and Stribeck's law explain the same residual."""
    return term.joint, "curve" if term.law in ("atan", "stribeck") else term.law


class Elsewhere:
    """Motion of new combinations: positions, velocities and accelerations of each joint at independent times of a log."""

    def __init__(self, parts: Sequence[Window], seed: int = 0) -> None:
        signals = [np.concatenate([getattr(part, key) for part in parts]) for key in ("q", "dq", "ddq")]
        samples, joints = signals[0].shape
        times = np.random.default_rng(seed).integers(0, samples, (SHUFFLED, joints))
        self.motion = [np.ascontiguousarray(each[times, np.arange(joints)]) for each in signals]
        self.recording = parts[0].recording

    def torque(self, model: Model, x: Array) -> Array:
        """Return the torque of links and rotors, (n_samples, n_dof), of extended standard parameters."""
        q, dq, ddq = self.motion
        return rigid_torque(model.own, q, dq, ddq, model.standard(x, self.recording))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Solutions of a state.

    Columns by number; parameters without each block, (n_blocks, m), and what they leave of it, (n_blocks, n_dof); curvature of
    the prior, (m, m); and with all blocks the torque of links and rotors elsewhere, (n_samples, n_dof).
    """

    columns: list[int]
    solutions: Array
    squares: Array
    prior: Array
    torque: Array


class Screen:
    """The columns of a plain system and of candidates, and which of them blocks left out support.

    Parameters
    ----------
    model : Model
        The plain model.
    system : LinearSystem
        Its system (7).
    residual : ndarray, shape (r,)
        Errors of the torques, which give the joints their weights.
    pool : sequence of Candidate
        Further columns.
    elsewhere : Elsewhere
        Motion along which links and rotors may not change.
    """

    def __init__(
        self,
        model: Model,
        system: LinearSystem,
        residual: Array,
        pool: Sequence[Candidate],
        elsewhere: Elsewhere,
    ) -> None:
        self.model, self.system, self.pool, self.elsewhere = model, system, list(pool), elsewhere
        self.n = len(system.names)
        self.held_coulomb = {
            one.term.joint: self.n + k for k, one in enumerate(self.pool) if one.term.law == "hold"
        }
        self.sigma = joint_sigma(system, residual)
        self._multiply(system)
        self._problems: dict[tuple[str, ...], tuple[Model, ConstrainedProblem | None]] = {}
        self._fits: dict[State, _Fit | None] = {}
        self.consistent: tuple[Prior, float] | None = None
        try:
            problem = CONSISTENT.for_model(model).on(system)
            self.consistent = problem.prior, problem.gamma
            self.fit(State())
        except FitError:  # no robot explains what is fixed: plain least squares
            self.consistent = None
            self._problems.clear()

    def _multiply(self, system: LinearSystem) -> None:
        """Multiply all columns over the rows of each block, joint by joint; a candidate is zero in the rows of other joints."""
        total = self.n + len(self.pool) + 1
        rows = system.joints[0].stop - system.joints[0].start
        blocks = list(pairwise(np.linspace(0, rows, BLOCKS + 1).round().astype(int).tolist()))
        near = np.zeros((BLOCKS, total, total))
        self.held: list[list[Array]] = [[] for _ in blocks]
        self.places: list[NDArray[np.intp]] = []
        weights = per_row(system, 1.0 / self.sigma)
        for joint, own in enumerate(system.joints):
            mine = [k for k, candidate in enumerate(self.pool) if candidate.term.joint == joint]
            columns = [system.w[own], *(self.pool[k].column[:, None] for k in mine), system.y[own][:, None]]
            a = np.hstack(columns) * weights[own][:, None]
            places = np.array([*range(self.n), *(self.n + k for k in mine), total - 1])
            self.places.append(places)
            for k, (start, stop) in enumerate(blocks):
                low, high = max(0, start - GAP_ROWS), min(rows, stop + GAP_ROWS)
                product = a[start:stop].T @ a[start:stop]
                self.held[k].append(product)
                around = product + a[low:start].T @ a[low:start] + a[stop:high].T @ a[stop:high]
                near[k][np.ix_(places, places)] += around
        whole = np.zeros((total, total))
        for products in self.held:
            for places, product in zip(self.places, products, strict=True):
                whole[np.ix_(places, places)] += product
        self.size = np.sqrt(np.maximum(np.diag(whole), np.finfo(float).tiny))
        self.size[-1] = 1.0
        scale = np.outer(self.size, self.size)
        self.whole, self.kept = whole / scale, (whole - near) / scale
        for products in self.held:
            for places, product in zip(self.places, products, strict=True):
                product /= scale[np.ix_(places, places)]
        self.counts = np.array(
            [[stop - start] * len(system.joints) for start, stop in blocks], dtype=np.float64
        )

    @property
    def needed(self) -> float:
        """Smallest gain of a law (nats)."""
        return max(LEAST_NATS, SMALLEST_GAIN * float(self.counts.sum()))

    def error(self, state: State) -> float:
        """Return the relative error of all blocks left out, without weights."""
        squares = float(self.fit(state).squares.sum(axis=0) @ np.square(self.sigma))
        return float(np.sqrt(squares) / np.linalg.norm(self.system.measured))

    def terms(self, state: State) -> list[FrictionTerm]:
        """Return the terms of a state."""
        holds = [self.pool[self.held_coulomb[joint] - self.n].term for joint in sorted(state.holds)]
        return [*holds, *(self.pool[k].term for k in state.columns)]

    def fit(self, state: State) -> _Fit:
        """Return the solutions of a state, without each block and with all.

        Raises
        ------
        FitError
            For laws whose columns depend on others.
        """
        if state not in self._fits:
            try:
                self._fits[state] = self._fitted(state)
            except FitError:
                if not state.columns and not state.holds:
                    raise
                self._fits[state] = None
        fit = self._fits[state]
        if fit is None:
            raise FitError("the columns of the laws depend on others")
        return fit

    def _fitted(self, state: State) -> _Fit:
        terms = self.terms(state)
        model, problem = self._problem(terms)
        column = {name: k for k, name in enumerate(self.system.names)}
        column |= {self.pool[k].term.parameter: self.n + k for k in state.columns}
        column |= {f"Fc{joint + 1}": self.held_coulomb[joint] for joint in state.holds}
        names = [model.unknowns.names[k] for k in model.unknowns.estimated]
        if len(names) != self.n + len(state.columns) or not set(names) <= set(column):
            raise FitError("the columns of the laws depend on others")
        columns = [column[name] for name in names]
        products = np.concatenate([self.kept, self.whole[None]])
        solved = [self._solved(product, columns, problem) for product in products]
        solutions = np.array([b for b, _ in solved[:-1]])
        b, x = solved[-1]
        size, prior = self.size[columns], np.zeros((len(columns), len(columns)))
        if problem is not None and x is not None:
            prior = problem.precision(x) / np.outer(size, size)
        else:
            x = model.lift(model.unknowns.expand(b / size))
        squares = np.array([self._squares(k, columns, each) for k, each in enumerate(solutions)])
        return _Fit(columns, solutions, squares, prior, self.elsewhere.torque(model, x))

    def _problem(self, terms: Sequence[FrictionTerm]) -> tuple[Model, ConstrainedProblem | None]:
        key = tuple(term.parameter for term in terms)
        if key not in self._problems:
            own = self.model.own
            model = self.model.with_robot(own.with_terms((*own.friction.terms, *terms)))
            problem = None if self.consistent is None else ConstrainedProblem(model, *self.consistent)
            self._problems[key] = model, problem
        return self._problems[key]

    def _solved(
        self, product: Array, columns: Sequence[int], problem: ConstrainedProblem | None
    ) -> tuple[Array, Array | None]:
        """Return the parameters of unit columns, (m,), and extended standard parameters of a robot that can exist."""
        g, size = product[columns, -1], self.size[columns]
        ridged = product[np.ix_(columns, columns)] + RIDGE * np.eye(len(columns))
        if problem is None:
            return np.asarray(np.linalg.solve(ridged, g)), None
        try:
            lower = np.linalg.cholesky(ridged)
        except np.linalg.LinAlgError:
            raise FitError("the columns depend on each other") from None
        x = problem.solve(np.ascontiguousarray(lower.T * size), np.linalg.solve(lower, g)).x
        return np.asarray(problem.matrix @ x) * size, x

    def _squares(self, block: int, columns: Sequence[int], b: Array) -> Array:
        """Return the squared error of a block left out, joint by joint, (n_dof,)."""
        squares = []
        for places, product in zip(self.places, self.held[block], strict=True):
            own = np.searchsorted(places, columns)
            there = places[np.minimum(own, len(places) - 1)] == columns
            values, own = b[there], own[there]
            inner = product[np.ix_(own, own)] @ values
            squares.append(product[-1, -1] - 2.0 * values @ product[own, -1] + values @ inner)
        return np.maximum(squares, 0.0)

    def gains(self, one: State, other: State) -> Array:
        """Return the gain of the likelihood (nats) of each block by one state in place of another, (n_blocks,)."""
        return gained(self.fit(one).squares, self.fit(other).squares, self.counts)

    def worth(self, without: State, state: State) -> Worth:
        """Return what the laws of a state beyond those of another take off the errors of the blocks."""
        return self._worth(self.fit(without), self.fit(state))

    def beside(self, other: Screen) -> Worth:
        """Return what another system of the same log takes off the errors of the blocks, both without candidates."""
        own, its = self.fit(State()), other.fit(State())
        # Windows with a delay may have some rows less.
        scale = np.square(other.sigma / self.sigma) * self.counts / np.maximum(other.counts, 1.0)
        return self._worth(own, replace(its, squares=its.squares * scale))

    def _worth(self, before: _Fit, after: _Fit) -> Worth:
        gain = gained(before.squares, after.squares, self.counts)
        moved = np.linalg.norm(after.torque - before.torque) / max(
            np.linalg.norm(before.torque), np.finfo(float).tiny
        )
        share = 1.0 - after.squares.sum() / before.squares.sum()
        return Worth(
            float(gain.sum()), float(significance(gain)), float(share), float(moved), self.supported(gain)
        )

    def supported(self, gain: Array) -> bool:
        """Whether gains of the blocks, (n_blocks,), justify a law."""
        return bool(
            significance(gain) > LEAST_SIGNIFICANCE
            and gain.sum() > self.needed
            and all(part.sum() > 0.0 for part in np.array_split(gain, 3))
        )

    def told(self, worth: Worth, term: FrictionTerm) -> bool:
        """Whether the log tells a law from links and rotors.

        A spring carries gravity, and is judged by its gain. A sign that is kept has no parameter that could take from theirs.
        """
        if term.law == "spring":
            return worth.share > SPRING_GAIN
        return term.law == "hold" or worth.shift <= LARGEST_SHIFT

    def toggled(self, state: State, joint: int) -> State:
        """Return the same laws with the sign of a joint kept, or no longer, and their columns those of that sign."""
        holds = state.holds ^ {joint}
        return State(tuple(self._twin(k, joint, joint in holds) for k in state.columns), holds)

    def _twin(self, index: int, joint: int, held: bool) -> int:
        """Return the candidate of the same term at a joint that holds its sign, or does not."""
        candidate = self.pool[index]
        if candidate.held is None or candidate.term.joint != joint:
            return index
        return next(
            k for k, other in enumerate(self.pool) if other.term == candidate.term and other.held == held
        )

    def best(
        self, state: State, joint: int, barred: set[tuple[int, str]], law: str = ""
    ) -> tuple[float, int] | None:
        """Return the candidate of a joint with the largest gain (nats), about, and the gain: of those supported, or of one law."""
        there = {law_at(self.pool[k].term) for k in state.columns} | barred
        places = [
            k
            for k, candidate in enumerate(self.pool)
            if candidate.term.joint == joint
            and candidate.term.law != "hold"
            and law in ("", candidate.term.law)
            and law_at(candidate.term) not in there
            and candidate.held in (None, joint in state.holds)
            # Memory beside a sign that is kept: in its place a state of little width predicts other motions worse.
            and (candidate.term.law != "dahl" or joint in state.holds | self.model.own.friction.held)
        ]
        if not places:
            return None
        before, after = self.fit(state).squares, self._with(state, joint, [self.n + k for k in places])
        gains = [gained(before, each, self.counts) for each in after]
        seen = [
            (float(gain.sum()), k)
            for k, gain in zip(places, gains, strict=True)
            if law or self.supported(gain)
        ]
        return max(seen, default=None)

    def _with(self, state: State, joint: int, places: Sequence[int]) -> Array:
        """Return the squared errors of the blocks with each further column of a joint, about: (k, n_blocks, n_dof)."""
        fit = self.fit(state)
        squares = np.tile(fit.squares, (len(places), 1, 1))
        current = fit.columns
        for k, b in enumerate(fit.solutions):
            kept = self.kept[k]
            inner = kept[np.ix_(current, current)] + fit.prior + RIDGE * np.eye(len(current))
            across = kept[np.ix_(current, places)]
            moves = np.linalg.solve(inner, across)
            own = kept[places, places]
            size = own - np.sum(across * moves, axis=0)
            clear = size > 1e-9 * own
            amount = np.where(clear, (kept[places, -1] - across.T @ b) / np.where(clear, size, 1.0), 0.0)
            for other, (columns, held) in enumerate(zip(self.places, self.held[k], strict=True)):
                mine = np.searchsorted(columns, current)
                there = columns[np.minimum(mine, len(columns) - 1)] == current
                mine, values, along = mine[there], b[there], moves[there]
                inside = held[np.ix_(mine, mine)]
                linear = -along.T @ (held[mine, -1] - inside @ values)
                square = np.sum(along * (inside @ along), axis=0)
                if other == joint:
                    new = np.searchsorted(columns, places)
                    linear = linear + held[new, -1] - held[np.ix_(new, mine)] @ values
                    square = square + held[new, new] - 2.0 * np.sum(along * held[np.ix_(mine, new)], axis=0)
                squares[:, k, other] -= 2.0 * amount * linear - np.square(amount) * square
        return np.maximum(squares, 0.0)
