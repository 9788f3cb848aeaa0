"""Choice of the friction terms that a log supports: ``terms = "auto"`` under ``[friction]``.

Candidates at every joint are a sign that is kept through rest (``hold``), torque at standstill, atan or Stribeck at several
velocities, load and forward viscous friction, Dahl's memory of several displacements, and a spring. Terms are added one by one,
``hold`` alone or with another term of its joint. Each time what lowers the error on held-out blocks most is taken, as long as its
gain exceeds its own standard error over the blocks. Then terms that no longer gain are taken away, and velocities move along their
grid while that gains. Last, both velocities of atan and Stribeck's law are refined, and the law that fits its joint better stays.
Residuals are correlated, so the likelihood alone would keep every term. Each block is predicted from the others, with a gap
between them; of several recordings each is predicted from the others too, and no term may make one worse.

All of it needs only products of columns: those of a block, and those of the rows that it is predicted from, ``screen.py``.
Tested in ``tests/test_friction_choice.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ..._tools.arrays import Array
from ...robot.friction import Friction, FrictionTerm
from ...signal.processing import SignalProcessing
from ...signal.window import Window
from ...terms.model import Model
from ...terms.rows import LinearSystem
from .candidates import joints_without_memory, narrowest_memory, pool_of
from .screen import Folds, Screen, clear, law_at
from .velocity import SettledFriction, Solve, VelocityEstimate, other_curve, settled

LARGEST_MISFIT = 0.3
"""Relative error of held-out blocks above which no terms are chosen: it is more than friction."""
LARGEST_EXTRAPOLATION = 2.5
"""Error of held-out blocks over that of the fit above which no terms are chosen: blocks then judge what the motion leaves
undetermined. Chosen on run A of the KR300 (4.0; its terms of B made A worse by 13 %); its run B (3.2) and the whole logs of the
other arms of docs/friction.md (1.01 to 1.27) only counted."""

Refusal = Literal["", "misfit", "extrapolation"]


@dataclass(frozen=True, kw_only=True)
class TermGain:
    """Contribution of a chosen term.

    Attributes
    ----------
    parameter : str
        Name of its parameter, such as ``Fa3``.
    gain : float
        Share of the squared weighted error on the held-out blocks that it takes away, beside all others.
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
        The largest gain first.
    held_out_before, held_out_after : float
        Relative error of the held-out blocks without the terms and with them (1 = 100 %).
    refused : {"", "misfit", "extrapolation"}
        Why nothing was tried: blocks are missed by more than friction, or the rest of the log does not determine them.
    without_memory : dict
        Joints, from 0, at which memory of small displacements is not a candidate, since encoder or rate are too coarse for it, and
        the smallest displacement that is (rad or m).
    """

    friction: Friction
    velocities: tuple[VelocityEstimate, ...]
    gains: tuple[TermGain, ...] = ()
    held_out_before: float
    held_out_after: float
    refused: Refusal = ""
    without_memory: dict[int, float] = field(default_factory=dict)


def choose_terms(
    model: Model,
    parts: Sequence[Window],
    signal: SignalProcessing,
    solve: Solve,
    resolved: Array | None = None,
) -> FrictionChoice:
    """Choose the friction terms that lower the error on held-out blocks.

    Parameters
    ----------
    model : Model
        Terms that the friction of its robot has already stay.
    parts, signal, solve
        As for `friction_velocity.settled`.
    resolved : ndarray, shape (n_dof,), optional
        Step of the encoder of each joint (rad or m).

    Returns
    -------
    FrictionChoice

    Raises
    ------
    FitError
        As `Model.rows` and the solver.
    """
    robot = model.own
    own = tuple(term for term in robot.friction.terms if term.law != "load")
    start = settled(model.with_robot(robot.with_terms(own)), parts, signal, solve)
    plain = start.robot
    folds = Folds(start.system)
    before, refused = _judged(start.system, folds, *solve(start.system))
    if refused:
        return FrictionChoice(
            friction=plain.friction,
            velocities=start.velocities,
            held_out_before=before,
            held_out_after=before,
            refused=refused,
        )

    def settle(terms: Sequence[FrictionTerm]) -> SettledFriction:
        return settled(model.with_robot(plain.with_terms((*own, *terms))), parts, signal, solve, search=False)

    trial = start
    narrowest = narrowest_memory(parts, resolved)
    # The second choice has the weights and loads of the first.
    for last in (False, True):
        pool = pool_of(plain, trial.model, trial.beta, parts, signal, start.system, narrowest)
        screen = Screen(start.system, solve(trial.system)[1], pool)
        moves = screen.chosen()
        # Those of the grid serve its weights and loads; velocities are refined once.
        terms = [move.term if last else replace(move.term, estimated=False) for move in moves]
        trial = settle(terms)
    terms, trial, rivals = _compared(settle, trial, terms, folds, solve)
    moves = [replace(move, term=term) for move, term in zip(moves, terms, strict=True)]
    recurring = screen.recurring()
    doubtful = {move.term.parameter for move in moves if not move.clear or law_at(move.term) not in recurring}
    chosen_terms = tuple(
        replace(term, doubtful=term.parameter in doubtful, rival=rivals.get(term.parameter, 0.0))
        for term in _without_driving(trial.model, trial.beta)
    )
    added = {term.parameter for term in chosen_terms}
    return FrictionChoice(
        friction=replace(robot.friction, terms=chosen_terms, auto=False),
        velocities=(
            *start.velocities,
            *(velocity for velocity in trial.velocities if velocity.parameter in added),
        ),
        gains=tuple(
            TermGain(parameter=move.term.parameter, gain=move.gain, significance=move.significance)
            for move in moves
            if move.term.parameter in added
        ),
        held_out_before=before,
        held_out_after=folds.relative_error(trial.system, solve(trial.system)[1]),
        without_memory=joints_without_memory(plain, narrowest.tolist()),
    )


def _judged(system: LinearSystem, folds: Folds, beta: Array, weights: Array) -> tuple[float, Refusal]:
    """Return the relative error of held-out blocks without further terms, and why they cannot judge any."""
    error = folds.relative_error(system, weights)
    fitted = float(np.linalg.norm(system.residual(beta)) / np.linalg.norm(system.measured))
    if error > LARGEST_EXTRAPOLATION * fitted:
        return error, "extrapolation"
    return error, "misfit" if error > LARGEST_MISFIT else ""


def _compared(
    settle: Callable[[Sequence[FrictionTerm]], SettledFriction],
    trial: SettledFriction,
    terms: list[FrictionTerm],
    folds: Folds,
    solve: Solve,
) -> tuple[list[FrictionTerm], SettledFriction, dict[str, float]]:
    """Choose atan or Stribeck's law at each joint, with refined velocities: return terms, their fit, and rivals' velocities.

    Where both fit, the other law is a rival, by parameter.
    """
    swapped = [other_curve(term) if term.estimated else term for term in terms]
    if swapped == terms:
        return terms, trial, {}
    other = settle(swapped)
    own, others = (
        folds.squares(one.system, one.system.residual(solve(one.system)[0])) for one in (trial, other)
    )
    change = own - others
    better, certain = change.sum(axis=0) > 0.0, clear(change)
    velocity = {term.parameter: term.velocity for fit in (trial, other) for term in fit.robot.friction.terms}
    chosen = [two if better[one.joint] else one for one, two in zip(terms, swapped, strict=True)]
    rivals = {
        one.parameter: velocity[two.parameter]
        for one in chosen
        if one.estimated and not certain[one.joint] and (two := other_curve(one)) != one
    }
    return chosen, settle(chosen) if better.any() else trial, rivals


def _without_driving(model: Model, beta: Array) -> tuple[FrictionTerm, ...]:
    """Leave out load friction, memory and stiffness below zero: they would drive the joint."""
    values = dict(zip(model.unknowns.names, beta, strict=True))
    return tuple(
        term
        for term in model.own.friction.terms
        if term.law not in ("load", "dahl", "spring") or values[term.parameter] > 0.0
    )
