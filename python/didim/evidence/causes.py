"""The rule by which a cause is named: tried by the plain fit, decided by the consistent one, confirmed by blocks and other logs.

Every hypothesis is applied and fitted again, and judged by D, (1) of `didim.evidence.products`, on blocks that were left out. Those
that pass are fitted by parameters of a robot, which cannot swallow a wrong sign: D of that fit decides. The best of all is named,
with those that explain the log as well; if the best one is refused (it is an end of its search, another log contradicts it,
friction gets a sign that no robot has), none is. Tested in ``tests/test_evidence_causes.py``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .._tools.arrays import Array
from ..robot.parameters import friction_names
from ..terms.rows import LinearSystem
from .hypotheses.hypothesis import Hypothesis
from .hypotheses.positions import scales
from .hypotheses.table import OF_KNOWN, OF_READINGS, OF_ROBOT, OF_SIGNS, OF_TORQUES
from .hypotheses.torques import exchanges, signs
from .products import BLOCKS, Declared, Judged, Products
from .rows import Columns, LogRows
from .thresholds import (
    BLOCKS_BETTER,
    FRICTION_SIGMAS,
    FRICTION_SLACK,
    GROWN,
    HEALED,
    HINT,
    MARGIN,
    MOST_DECIDED,
    MOST_EXACT,
    NAMED,
    NEGATIVE_SIGMAS,
    OTHER_LOG,
    ROBOT,
    SCREEN,
    SIZE_DOUBTFUL,
    TORN,
    TURNED,
)


@dataclass(frozen=True, eq=False)
class Tried:
    """A hypothesis that was applied and fitted again.

    Attributes
    ----------
    hypothesis : Hypothesis
        What was changed.
    d, d_consistent : float
        D of the plain fit, on blocks left out, and of the consistent fit; NaN where this one was not asked.
    blocks : int
        Blocks that it predicts better, of those of `didim.evidence.products.BLOCKS`.
    friction : bool
        Whether the friction of its joint, which would drive it as declared, brakes.
    refused : str
        Why it is not named, or nothing.
    growth : float
        Error of blocks left out over that of the same blocks fitted.
    """

    hypothesis: Hypothesis
    d: float
    blocks: int = 0
    d_consistent: float = float("nan")
    friction: bool = False
    refused: str = ""
    growth: float = 1.0

    @property
    def decisive(self) -> float:
        """D that decides."""
        return self.d if np.isnan(self.d_consistent) else self.d_consistent


@dataclass(frozen=True, eq=False)
class Cause:
    """The cause that explains a log, with others that explain it equally well.

    Attributes
    ----------
    tried : tuple of Tried
        The best first.
    certain : bool
        Whether it is clear enough for a result to be wrong; else a hint.
    """

    tried: tuple[Tried, ...]
    certain: bool


class Search:
    """The search for a cause.

    Parameters
    ----------
    rows : LogRows
        The log.
    other : LogRows, optional
        Another log of the robot, such as one that was held out.
    readings : bool
        Whether units, sides, rates, gears, encoders and exchanged positions are tried too.
    """

    def __init__(self, rows: LogRows, other: LogRows | None = None, *, readings: bool = True) -> None:
        self.rows, self.other, self._readings = rows, other, readings
        self._columns: dict[Hypothesis, Columns | None] = {}

    def cause(self) -> Cause | None:
        """Return the cause that explains the log, or None."""
        rows = self.rows
        trials = [self._tried(hypothesis) for hypothesis in signs(rows)]
        if rows.hopeless and not self._torn and not any(trial.friction for trial in trials):
            return None
        for family in OF_TORQUES if rows.known is None else (*OF_TORQUES, *OF_KNOWN):
            trials += [self._tried(hypothesis) for hypothesis in family(rows)]
        trials += [self._tried(hypothesis) for hypothesis in self._promising()]
        trials = [trial for trial in trials if np.isfinite(trial.d)]
        near = [trial for trial in sorted(trials, key=lambda trial: trial.d) if trial.d <= SCREEN][
            :MOST_DECIDED
        ]
        doubted = (trial for trial in trials if trial.friction or self._turns_back(trial.hypothesis))
        near += [trial for trial in doubted if trial not in near]
        return self._named([self._decided(trial) for trial in near]) if near else None

    def _turns_back(self, hypothesis: Hypothesis) -> bool:
        """Whether it turns a joint whose torques only parameters of no robot explain."""
        return hypothesis.turns and hypothesis.joints[0] in self._torn

    def _promising(self) -> list[Hypothesis]:
        """Return the hypotheses with columns of their own that pass the screening, the best first."""
        rows = self.rows
        scored: list[tuple[float, Hypothesis]] = []
        known = rows.known is not None
        families = OF_SIGNS if known else (*OF_SIGNS, *OF_ROBOT)
        for family in (*families, *OF_READINGS) if self._readings else families:
            for hypothesis in family(rows):
                d = rows.rough(hypothesis) if family is not scales else self._fell(hypothesis)
                if self._turns_back(hypothesis):
                    d = min(d, SCREEN)
                if d <= SCREEN:
                    scored.append((d, hypothesis))
        scored.sort(key=lambda pair: pair[0])
        # One other robot: any may come near where one does, and would leave no room for other causes.
        other = next((own for _, own in scored if "robot" in own.facts), None)
        promising = [own for _, own in scored if own is other or "robot" not in own.facts]
        return promising[:MOST_EXACT]

    def _fell(self, hypothesis: Hypothesis) -> float:
        return float(np.sum(np.log(self.rows.seen(hypothesis) / self.rows.declared_seen)))

    @cached_property
    def _held(self) -> Array | None:
        """Squared errors of the joints with the parameters of a robot, (n,); None without that fit."""
        held = self.rows.consistent(self.rows.robot, self.rows.w, self.rows.y)
        return None if held is None else np.sum(held**2, axis=1)

    @cached_property
    def _torn(self) -> list[int]:
        """Joints, from 1, whose torques only parameters of no robot explain."""
        cost = 0.0 if self._held is None else np.log(self._held / self.rows.declared_seen)
        return (np.flatnonzero(cost > TORN) + 1).tolist()

    def _columns_of(self, hypothesis: Hypothesis) -> Columns | None:
        if hypothesis not in self._columns:
            self._columns[hypothesis] = self.rows.exact(hypothesis)
        return self._columns[hypothesis]

    def _tried(self, hypothesis: Hypothesis) -> Tried:
        columns = self._columns_of(hypothesis)
        if columns is None:
            return Tried(hypothesis, float("inf"))
        return tried(self.rows, hypothesis, columns.products, columns.names)

    def _decided(self, plain: Tried) -> Tried:
        """Return a trial with D of the consistent fit, and whether another log confirms it."""
        hypothesis = plain.hypothesis
        columns = self._columns_of(hypothesis)
        if columns is None or self._held is None:
            return plain
        mixing = hypothesis.mixing(self.rows.n)
        y: Array = np.linalg.inv(mixing) @ self.rows.y  # the torques of the joints, not of the channels
        held = self.rows.consistent(hypothesis.robot or self.rows.robot, columns.w, y)
        if held is None:
            return replace(plain, d_consistent=float("inf"))
        squares = np.sum((mixing @ held) ** 2, axis=1)
        d = float(np.sum(np.log(squares / self._held)))
        refused, seen = plain.refused, columns.products.seen(*hypothesis.channels)
        if not refused and d <= HINT and self._contradicted(hypothesis, columns.products):
            refused = "other-log"
        elif not refused:
            size = self.rows.products.y.sum(axis=1)
            before, after = torn(self._held, self.rows.declared_seen, size), torn(squares, seen, size)
            refused = "no-robot" if after > max(ROBOT, HEALED * before) else ""
        return replace(plain, d_consistent=d, refused=refused)

    def _contradicted(self, hypothesis: Hypothesis, products: Products) -> bool:
        """Whether another log of the robot is predicted no better."""
        if self.other is None or self.other.n != self.rows.n:
            return False
        columns = self.other.exact(hypothesis)
        if columns is None:
            return False
        beta = products.judged(*hypothesis.channels).beta
        after = columns.products.predicted(beta, *hypothesis.channels)
        before = self.other.products.predicted(self.rows.declared.beta)
        return float(np.sum(np.log(after / before))) > OTHER_LOG

    def _named(self, trials: Sequence[Tried]) -> Cause | None:
        """Return the cause by the rule, or None."""
        order = sorted(trials, key=lambda trial: trial.decisive)
        by_friction = [trial for trial in order if trial.friction and trial.decisive < FRICTION_SLACK]
        best = order[0]
        limit = min(best.decisive + MARGIN, HINT)
        ties = [trial for trial in order if trial.decisive <= limit and not trial.refused]
        if best.decisive <= HINT and not best.refused and any(confirmed(trial) for trial in ties):
            return Cause(tuple(_distinct(ties)), certain=best.decisive <= NAMED and best.growth <= GROWN)
        if by_friction and not (best.decisive <= HINT and best.refused):
            return Cause(tuple(_distinct(by_friction)), certain=True)
        return None


def tried(rows: Declared, hypothesis: Hypothesis, products: Products, names: Sequence[str]) -> Tried:
    """Return a hypothesis applied, fitted again and judged on blocks left out; `products` and `names` of its own columns."""
    judged, declared = products.judged(*hypothesis.channels), rows.declared
    d, refused, friction = judged.against(declared), "", False
    if hypothesis.at_end:
        refused = "at-end"
    elif hypothesis.turns:
        before = friction_sigmas(rows.names, declared, hypothesis.joints)
        after = friction_sigmas(names, judged, hypothesis.joints)
        friction = max(before) < -FRICTION_SIGMAS and min(after) > FRICTION_SIGMAS and d < FRICTION_SLACK
        refused = "friction" if min(after) < min(-NEGATIVE_SIGMAS, min(before)) else ""
    elif hypothesis.code == "swapped-torques":
        pair = [joint - 1 for joint in hypothesis.joints]
        both = judged.unseen[pair].sum(axis=1) < declared.unseen[pair].sum(axis=1)
        refused = "" if both.all() else "one-channel"
    growth = float(np.sqrt(judged.unseen.sum() / products.seen(*hypothesis.channels).sum()))
    return Tried(
        hypothesis, d, judged.better_blocks(declared), growth=growth, friction=friction, refused=refused
    )


def cause_of_torques(system: LinearSystem) -> tuple[Declared, Cause | None] | None:
    """Return the wrong sign or the exchange of torques that a system (7) shows by itself, on held-out blocks.

    The quick look of every method, before any other: a log like that spoils starts and steps too.
    """
    n = len(system.joints)
    if len(system.y) < BLOCKS * n:
        return None
    products = Products.of(system.w.reshape(n, -1, system.w.shape[1]), system.y.reshape(n, -1))
    if not (products.y.sum(axis=1) > 0.0).all():
        return None
    rows = Declared(system.names, products, products.judged())
    hypotheses = (*signs(rows), *exchanges(rows))
    best, *_ = order = sorted(
        (tried(rows, each, products, rows.names) for each in hypotheses), key=lambda trial: trial.d
    )
    if best.d <= NAMED and best.blocks >= BLOCKS_BETTER:
        ties = [trial for trial in order if trial.d <= best.d + MARGIN and not trial.refused]
    else:
        ties = [trial for trial in order if trial.friction]
    return rows, Cause(tuple(_distinct(ties)), certain=True) if ties else None


def torn(held: Array, plain: Array, size: Array) -> float:
    """Return the error of physical parameters relative to that of unconstrained ones.

    The sum of log(squared error held / plain), where an error below a share of the squared torques `size` counts as that.
    """
    least = SIZE_DOUBTFUL**2 * size
    return float(np.sum(np.log(np.maximum(np.maximum(held, least) / np.maximum(plain, least), 1.0))))


def confirmed(tried: Tried) -> bool:
    """Whether blocks that were left out confirm a trial, or the sign of friction where the plain fit is blind."""
    blind = tried.d < FRICTION_SLACK  # a plain fit that gets clearly worse is not blind, and contradicts
    if tried.hypothesis.turns and (tried.friction or (tried.d_consistent <= TURNED and blind)):
        return True
    return tried.d <= SCREEN and tried.blocks >= BLOCKS_BETTER


def friction_sigmas(names: Sequence[str], judged: Judged, joints: Sequence[int]) -> list[float]:
    """Return the viscous and Coulomb friction of joints, from 1, in their standard deviations; zero without such columns."""
    own = frozenset().union(*(friction_names(joint - 1) for joint in joints))
    columns = [index for index, name in enumerate(names) if name in own]
    std = np.maximum(judged.std[columns], 1e-9 * np.abs(judged.beta[columns]) + 1e-300)
    return (judged.beta[columns] / std).tolist() or [0.0]


def _distinct(tried: Iterable[Tried]) -> list[Tried]:
    """Return the best of each kind and joint, and each robot."""
    distinct: dict[tuple[object, ...], Tried] = {}
    for trial in tried:
        own = trial.hypothesis
        distinct.setdefault((own.code, own.joints, own.facts.get("robot")), trial)
    return list(distinct.values())
