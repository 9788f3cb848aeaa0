"""Which friction terms a log supports: ``friction = "auto"``.

Candidates are standstill, atan, load and forward viscous friction at every joint. Terms are added one after the other. Each time
the one is taken that lowers the error on held-out blocks most, as long as its gain exceeds its own standard error over the blocks.
Residuals are correlated, so the likelihood alone would keep every term. Each block is predicted from the others, with a gap
between them.
Tested in ``tests/test_friction_choice.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..._tools.arrays import Array
from ...robot.friction import START_VELOCITY, Friction, FrictionTerm
from ...robot.robot import Robot
from ...signal.processing import SignalProcessing
from ...signal.segments import Segment
from ..linear_system import LinearSystem, linear_system
from ..selection import select
from .velocity import VelocityEstimate, settled

HELD_OUT_BLOCKS = 5
"""Held-out blocks: contiguous parts of the log, all joints together."""
BLOCK_GAP_ROWS = 5
"""Rows beside a held-out block that are not fitted either: neighbouring residuals are correlated."""
ROUNDS = 2
"""Number of times that terms are chosen; the second time with the weights, velocities and loads of the first choice."""
SMALLEST_GAIN = 1e-3
"""Smallest gain of a term, as a share of the squared held-out error of all joints: less is not worth a parameter."""
LEAST_STANDSTILL = 0.01
"""Smallest share of the rows at standstill for a torque there to be a candidate."""


@dataclass(frozen=True, kw_only=True)
class TermGain:
    """What a chosen term contributed.

    Attributes
    ----------
    parameter : str
        Name of its parameter, such as ``Fa3``.
    gain : float
        By which share it lowered the squared weighted error on the held-out blocks when it was added.
    significance : float
        Mean gain of a block over its standard error.
    """

    parameter: str
    gain: float
    significance: float


@dataclass(frozen=True, kw_only=True)
class FrictionChoice:
    """The friction that held-out blocks support.

    Attributes
    ----------
    friction : Friction
        With the chosen terms.
    velocities : tuple of VelocityEstimate
        Velocities of the chosen atan terms.
    gains : tuple of TermGain
        In the order in which they were added.
    held_out_before, held_out_after : float
        Relative error of the held-out blocks without the terms and with them (1 = 100 %).
    """

    friction: Friction
    velocities: tuple[VelocityEstimate, ...]
    gains: tuple[TermGain, ...]
    held_out_before: float
    held_out_after: float


def choose_terms(
    robot: Robot,
    parts: Sequence[Segment],
    signal: SignalProcessing,
    chosen: tuple[dict[str, float], tuple[str, ...]],
    solve: Callable[[LinearSystem], tuple[Array, Array]],
) -> FrictionChoice:
    """Choose the friction terms that lower the error on held-out blocks.

    Parameters
    ----------
    robot : Robot
        Terms that its friction has already stay.
    parts, signal, chosen, solve
        As for `friction_velocity.settled`.

    Returns
    -------
    FrictionChoice

    Raises
    ------
    FitError
        As `linear_system` and the solver.
    """
    own = tuple(term for term in robot.friction.terms if term.law != "load")
    plain = replace(robot, friction=replace(robot.friction, terms=own))
    start = settled(plain, parts, signal, chosen, solve)
    before = _Blocks(start.system, solve(start.system)[1])
    plain = start.robot
    trial = start
    kept: list[str] = []
    gains: list[TermGain] = []
    for _ in range(ROUNDS):
        full, candidates = _with_candidates(plain, trial.robot, parts, signal, chosen, solve)
        beta = full.base_parameters.project(
            _on(full, trial.robot, trial.robot.base_parameters.lift(trial.beta))
        )
        selection = select(full, *chosen)
        system = linear_system(full, parts, signal, selection, beta)
        # The rows of both systems are the same; only columns were added.
        weights = solve(trial.system)[1]
        kept, gains = _forward(system, weights, [term.parameter for term in candidates])
        terms = tuple(
            replace(term, estimated=True) if term.law == "atan" else term
            for term in candidates
            if term.parameter in kept
        )
        trial = settled(
            replace(plain, friction=replace(plain.friction, terms=(*plain.friction.terms, *terms))),
            parts,
            signal,
            chosen,
            solve,
        )
    terms = _without_negative_load(trial.robot, trial.beta, trial.robot.friction.terms)
    after = _Blocks(trial.system, solve(trial.system)[1])
    added = {term.parameter for term in terms}
    friction = replace(robot.friction, terms=terms, auto=False)
    return FrictionChoice(
        friction=friction,
        velocities=(
            *start.velocities,
            *(item for item in trial.velocities if item.parameter in added),
        ),
        gains=tuple(gain for gain in gains if gain.parameter in added),
        held_out_before=before.relative_error(),
        held_out_after=after.relative_error(),
    )


def _without_negative_load(
    robot: Robot, beta: Array, terms: tuple[FrictionTerm, ...]
) -> tuple[FrictionTerm, ...]:
    """Leave out load friction below zero: it would drive the joint."""
    values = dict(zip(robot.base_parameters.names, beta, strict=True))
    return tuple(term for term in terms if term.law != "load" or values[term.parameter] > 0.0)


def _with_candidates(
    plain: Robot,
    trial: Robot,
    parts: Sequence[Segment],
    signal: SignalProcessing,
    chosen: tuple[dict[str, float], tuple[str, ...]],
    solve: Callable[[LinearSystem], tuple[Array, Array]],
) -> tuple[Robot, list[FrictionTerm]]:
    """Robot with all candidates beside its own terms; atan velocities are those that fit best when every joint has the law."""
    taken = {term.parameter for term in plain.friction.terms}
    known = {term.parameter: term.velocity for term in trial.friction.terms}
    still = _standstill(plain, parts)
    candidates: list[FrictionTerm] = []
    for joint, kind in enumerate(plain.joint_kinds):
        if still[joint] > LEAST_STANDSTILL:
            candidates.append(FrictionTerm(law="rest", joint=joint))
        candidates.append(
            FrictionTerm(law="atan", joint=joint, velocity=START_VELOCITY[kind], estimated=True)
        )
        candidates.append(FrictionTerm(law="load", joint=joint))
        if plain.friction.model == "symmetric":
            candidates.append(FrictionTerm(law="forward", joint=joint))
    candidates = [term for term in candidates if term.parameter not in taken]
    # Velocities with the torque at standstill beside them: it would bend them otherwise.
    searched = [term for term in candidates if term.law in ("rest", "atan")]
    friction = replace(plain.friction, terms=(*plain.friction.terms, *searched))
    found = settled(replace(plain, friction=friction), parts, signal, chosen, solve)
    velocities = {term.parameter: term.velocity for term in found.robot.friction.terms if term.law == "atan"}
    candidates = [_with_velocity(term, {**velocities, **known}) for term in candidates]
    friction = replace(plain.friction, terms=(*plain.friction.terms, *candidates))
    return replace(plain, friction=friction), candidates


def _with_velocity(term: FrictionTerm, velocities: Mapping[str, float]) -> FrictionTerm:
    """Give an atan term its velocity; the square root replaces one whose velocity the log does not identify."""
    if term.law != "atan":
        return term
    velocity = velocities.get(term.parameter)
    if not velocity:
        return FrictionTerm(law="root", joint=term.joint)
    return replace(term, estimated=False, velocity=velocity)


def _standstill(robot: Robot, parts: Sequence[Segment]) -> Array:
    """Share of the samples in the dead zone of each joint, (n_dof,)."""
    zone = np.asarray(robot.friction.dead_zone)
    total = sum(len(part.dq) for part in parts)
    inside = sum(np.sum((np.abs(part.dq) <= zone) & (zone > 0.0), axis=0) for part in parts)
    return np.asarray(inside / total)


def _on(robot: Robot, other: Robot, x: Array) -> Array:
    """Return standard parameters of one robot by name on another, zero where it has more."""
    values = dict(zip(other.parameter_names, x, strict=True))
    return np.array([values.get(name, 0.0) for name in robot.parameter_names])


class _Blocks:
    """Held-out blocks of a system: each is predicted from the rows further away than the gap."""

    def __init__(self, system: LinearSystem, weights: Array) -> None:
        self.system = system
        rows = system.joints[0].stop - system.joints[0].start
        edges = np.linspace(0, rows, HELD_OUT_BLOCKS + 1).round().astype(int)
        time = np.concatenate([np.arange(rows)] * len(system.joints))
        self.weights = weights
        self.outside = [(time >= lo) & (time < hi) for lo, hi in pairwise(edges)]
        self.inside = [
            (time < lo - BLOCK_GAP_ROWS) | (time >= hi + BLOCK_GAP_ROWS) for lo, hi in pairwise(edges)
        ]

    def relative_error(self) -> float:
        """Relative error of all held-out blocks, without weights."""
        w, y = self.system.w, self.system.y
        squares = 0.0
        for inside, outside in zip(self.inside, self.outside, strict=True):
            scale = self.weights[inside]
            beta = np.linalg.lstsq(w[inside] * scale[:, None], y[inside] * scale, rcond=None)[0]
            squares += float(np.sum((y[outside] - w[outside] @ beta) ** 2))
        return float(np.sqrt(squares) / np.linalg.norm(self.system.measured))


def _forward(
    system: LinearSystem, weights: Array, candidates: Sequence[str]
) -> tuple[list[str], list[TermGain]]:
    """Add candidates while held-out blocks support one; their names in the order in which they came, with their gains."""
    blocks = _Blocks(system, weights)
    a, y = system.w * weights[:, None], system.y * weights
    place = {name: system.names.index(name) for name in candidates if name in system.names}
    current = [k for k, name in enumerate(system.names) if name not in place]
    # All columns of the rows inside, once and for all blocks: subsets need only the triangle.
    triangles = []
    for inside in blocks.inside:
        triangle = np.asarray(np.linalg.qr(np.column_stack([a[inside], y[inside]]), mode="r"))
        triangles.append(triangle)
    open_names = list(place)
    kept: list[str] = []
    gains: list[TermGain] = []
    while open_names:
        others = [place[name] for name in open_names]
        drops = np.stack(
            [
                _drops(triangle, a[outside], y[outside], current, others)
                for triangle, outside in zip(triangles, blocks.outside, strict=True)
            ]
        )
        before = drops[:, 0].sum()
        change = drops[:, 1:]
        total = change.sum(axis=0)
        error = change.std(axis=0, ddof=1) * np.sqrt(HELD_OUT_BLOCKS)
        supported = (total > error) & (total > SMALLEST_GAIN * before)
        if not supported.any():
            break
        best = int(np.argmax(np.where(supported, total, -np.inf)))
        name = open_names.pop(best)
        kept.append(name)
        current.append(place[name])
        gains.append(
            TermGain(
                parameter=name,
                gain=float(total[best] / before),
                significance=float(total[best] / error[best]),
            )
        )
    return kept, gains


def _drops(triangle: Array, a: Array, y: Array, current: Sequence[int], others: Sequence[int]) -> Array:
    """Squared error of a block without any candidate, then by how much each alone lowers it."""
    q, r = np.linalg.qr(triangle[:, list(current)])
    target = triangle[:, -1]
    beta = np.linalg.solve(r, q.T @ target)
    residual = target - q @ (q.T @ target)
    error = y - a[:, list(current)] @ beta
    columns = triangle[:, list(others)]
    inside = q.T @ columns
    new = columns - q @ inside
    size = np.square(new).sum(axis=0)
    clear = size > 1e-16 * np.square(columns).sum(axis=0)
    amount = np.where(clear, new.T @ residual / np.where(clear, size, 1.0), 0.0)
    change = a[:, list(others)] - a[:, list(current)] @ np.linalg.solve(r, inside)
    after = np.square(error[:, None] - change * amount).sum(axis=0)
    base = float(error @ error)
    return np.concatenate([[base], base - after])
