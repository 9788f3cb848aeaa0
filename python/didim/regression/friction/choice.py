"""Choice of the friction terms that a log supports: ``terms = "auto"`` under ``[friction]``, and those that ``didim init`` writes.

Candidates at every joint are a sign that is kept through rest (``hold``), torque at standstill, atan or Stribeck at several
velocities, load and forward viscous friction, Dahl's memory of several displacements, and a spring. Ten blocks of the log are left
out in turn, and each is predicted from the others by a robot that can exist (``screen.py``). A round takes the best law of every
joint, ``hold`` alone or with another law; at the end each is judged by leaving it out, and velocities are refined. Then the laws
that were refused are tried again beside all of these.

Blocks left out repeat the combinations of the log. A law that moves the torque of links and rotors along new combinations of the
same positions, velocities and accelerations cannot be separated from them, whatever it gains, and is refused. Tested in
``tests/test_friction_choice.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...model.dynamics import inverse_dynamics
from ...robot.friction import Friction, FrictionTerm, Law
from ...signal.processing import SignalProcessing
from ...signal.window import Window
from ...terms.model import Model
from ..delay import Observed, estimate_delay
from .alarm import joint_scales
from .candidates import LEAST_REST, at_rest, joints_without_memory, narrowest_memory, pool_of
from .screen import LEAST_SIGNIFICANCE, Elsewhere, Move, Screen, State, Worth, law_at, significance
from .velocity import CURVES, SettledFriction, Solve, VelocityEstimate, settled

LARGEST_MISFIT = 0.3
"""Relative error of blocks left out above which no terms are chosen: it is more than friction."""
LARGEST_EXTRAPOLATION = 1.5
"""Error of blocks left out over that of the fit above which no terms are chosen: blocks then judge what the motion leaves
undetermined. Chosen on run A of the KR300 where it moves (1.65; its terms made B worse by 5 %); its run B (1.75), both whole (1.61,
1.66), and wholes and parts of the other arms of docs/friction.md (1.05 to 1.42) only counted."""
DELAY_SIGNIFICANCE = 3.0
"""Smallest gain of a delay, in its standard error between the blocks."""
DELAY_GAIN = 10.0
"""Smallest gain of a delay, in gains that a law needs: obeyed below it, delays of six real logs made other logs worse."""
NEAR_REST = (0.005, 0.01, 0.02, 0.05)
"""Speeds (rad/s) of a smooth sign, or of a dead zone, that are tried where the robot's sign has neither."""
AS_GOOD = 1.01
"""Ratio of errors of blocks left out up to which friction near rest is preferred to laws: it has no parameters."""
REFUSED = {
    "misfit": "which is more than friction",
    "extrapolation": "far more than the fit: the rest of the log does not determine them",
}
"""Why no terms were tried."""
ROUNDS = 8
"""Upper bound of the rounds, each of which adds up to two laws to every joint."""


@dataclass(frozen=True, kw_only=True)
class TermGain:
    """What a term takes off the errors of blocks left out.

    Attributes
    ----------
    parameter : str
        Name of its parameter, such as ``Fa3``.
    gain : float
        Share of the squared weighted error on the blocks that it takes away, beside all others.
    significance : float
        Gain of the blocks' likelihood over its standard error.
    shift : float
        Share by which it moves the torque of links and rotors along motion of new combinations.
    """

    parameter: str
    gain: float
    significance: float
    shift: float = 0.0

    @classmethod
    def of(cls, parameter: str, worth: Worth) -> TermGain:
        """Return the record of a worth."""
        return cls(parameter=parameter, gain=worth.share, significance=worth.significance, shift=worth.shift)


@dataclass(frozen=True, kw_only=True)
class FrictionChoice:
    """The friction that blocks left out support.

    Attributes
    ----------
    friction : Friction
        With the chosen terms.
    velocities : tuple of VelocityEstimate
        Velocities of the chosen atan terms.
    gains : tuple of TermGain
        The largest gain first.
    untold : tuple of TermGain
        Terms that blocks support, and that the log does not tell from links and rotors: refused.
    held_out_before, held_out_after : float
        Relative error of the blocks without the terms and with them (1 = 100 %).
    refused : {"", "misfit", "extrapolation"}
        Why nothing was tried: blocks are missed by more than friction, or the rest of the log does not determine them.
    without_memory : dict
        Joints, from 0, at which memory of small displacements is not a candidate, since encoder or rate are too coarse for it, and
        the smallest displacement that is (rad or m).
    """

    friction: Friction
    velocities: tuple[VelocityEstimate, ...]
    gains: tuple[TermGain, ...] = ()
    untold: tuple[TermGain, ...] = ()
    held_out_before: float
    held_out_after: float
    refused: Literal["", "misfit", "extrapolation"] = ""
    without_memory: dict[int, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class FirstFit:
    """The friction and the delay that a log supports.

    Attributes
    ----------
    choice : FrictionChoice
        Friction, with the delay compensated.
    samples : float
        Delay of the torques (samples); zero for none.
    delay : TermGain or None
        What it takes off the errors of blocks left out; None where the log has none.
    rest : TermGain or None
        What the ``smoothing`` or the ``dead_zone`` of the friction takes off them; None for that of the robot.
    """

    choice: FrictionChoice
    rest: TermGain | None = None
    samples: float = 0.0
    delay: TermGain | None = None


def first_fit(  # many parameters: those of choose_terms
    model: Model,
    windows: Callable[[float], Sequence[Window]],
    signal: SignalProcessing,
    solve: Solve,
    resolved: Array | None,
    say: Callable[[str], None],
) -> FirstFit:
    """Choose friction, then a delay, then friction again: missing friction looks like a delay.

    Parameters
    ----------
    model, signal, solve, resolved
        As for `choose_terms`.
    windows : callable
        Return the windows of the log with a compensated delay (samples).
    say : callable
        Receiver of sentences on the progress.

    Returns
    -------
    FirstFit

    Raises
    ------
    FitError
        As `choose_terms` (``test_init_friction.py``).
    """
    say("choosing friction laws by blocks left out")
    parts, rest = windows(0.0), None
    choice = choose_terms(model, parts, signal, solve, resolved)
    if choice.refused:  # what this log lacks is not friction
        return FirstFit(choice=choice)
    # The noise of the velocity decides a plain sign there.
    at = at_rest(model.own.with_terms(choice.friction.terms), parts)
    resting = np.flatnonzero(np.mean(np.concatenate(at), axis=0) > LEAST_REST).tolist()
    if resting or not choice.friction.held:
        say("choosing friction near rest")
        smooth, found = _near_rest(model, parts, signal, solve, resting if choice.friction.held else ())
        other = choose_terms(smooth, parts, signal, solve, resolved) if found else choice
        if found and other.held_out_after <= AS_GOOD * choice.held_out_after:
            model, choice, rest = smooth, other, found
    say("looking for a delay of the torques beside this friction")
    samples, worth = _delayed(model, choice, windows, signal, solve, 0.0)
    if worth is None:
        return FirstFit(choice=choice, rest=rest)
    say("choosing friction laws again, with the delay compensated")
    choice = choose_terms(model, windows(samples), signal, solve, resolved)
    later, still = _delayed(model, choice, windows, signal, solve, samples)
    samples = samples if still is None else later
    return FirstFit(choice=choice, rest=rest, samples=samples, delay=worth)


def _near_rest(
    model: Model, parts: Sequence[Window], signal: SignalProcessing, solve: Solve, resting: Sequence[int]
) -> tuple[Model, TermGain | None]:
    """Return the model with the smoothing or the dead zone that blocks left out support most; that of its robot without any.

    For `resting` joints alone it is the best dead zone, supported or not: a sign that noise decides has no other reason.
    """
    robot, elsewhere = model.own, Elsewhere(parts)
    friction = robot.friction
    if friction.coulomb != "sign" or any(friction.dead_zone):
        return model, None

    def screened(one: Model) -> Screen:
        fit = settled(one, parts, signal, solve, search=False)
        return Screen(fit.model, fit.system, fit.system.residual(fit.beta), (), elsewhere)

    before = screened(model)
    best: tuple[float, Model, TermGain | None] = (-np.inf if resting else 0.0, model, None)
    for speed in NEAR_REST:
        at = speed * joint_scales(robot)
        zones = at * (np.isin(np.arange(robot.n_dof), resting) if resting else 1.0)
        ways = [("dead_zone", replace(robot, friction=replace(friction, dead_zone=tuple(zones.tolist()))))]
        if not resting:
            ways.insert(0, ("smoothing", robot.with_smoothing(at.tolist())))
        for name, other in ways:
            changed = model.with_robot(other)
            worth = before.beside(screened(changed))
            if worth.nats > best[0] and (worth.supported or resting):
                best = worth.nats, changed, TermGain.of(name, worth)
    return best[1:]


def _delayed(
    model: Model,
    choice: FrictionChoice,
    windows: Callable[[float], Sequence[Window]],
    signal: SignalProcessing,
    solve: Solve,
    declared: float,
) -> tuple[float, TermGain | None]:
    """Return the delay beside a chosen friction (samples), and its gain; none where blocks do not support it."""
    with_laws = model.with_robot(model.own.with_terms(choice.friction.terms))
    parts = windows(declared)
    fit = settled(with_laws, parts, signal, solve, search=False)

    def observe(some: Sequence[Window]) -> Observed:
        system = fit.model.rows(some, signal, fit.beta)
        solution, weights = solve(system)
        return Observed(system, weights, solution)

    def torque(part: Window, solution: Array) -> Array:
        x = fit.model.standard(fit.model.lift(fit.model.unknowns.expand(solution)), part.recording)
        return inverse_dynamics(fit.robot, part.q, part.dq, part.ddq, x, temperature=part.temperature)

    try:
        samples = declared + estimate_delay(parts, signal, observe, torque)[0].samples
    except FitError:  # windows too short, or no best delay within the reach: `check` says so
        return declared, None
    if samples == declared:
        return declared, None
    moved = windows(samples)
    late = settled(with_laws, moved, signal, solve, search=False)
    before, after = (
        Screen(one.model, one.system, one.system.residual(one.beta), (), Elsewhere(own))
        for one, own in ((fit, parts), (late, moved))
    )
    worth = before.beside(after)
    clear = worth.significance > DELAY_SIGNIFICANCE and worth.nats > DELAY_GAIN * before.needed
    return samples, TermGain.of("delay", worth) if worth.supported and clear else None


def choose_terms(  # long: three searches, each with what the one before found
    model: Model,
    parts: Sequence[Window],
    signal: SignalProcessing,
    solve: Solve,
    resolved: Array | None = None,
) -> FrictionChoice:
    """Choose the friction terms that lower the error on blocks left out.

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
    plain, elsewhere, narrowest = start.robot, Elsewhere(parts), narrowest_memory(parts, resolved)

    def search(trial: SettledFriction) -> _Search:
        pool = pool_of(plain, trial.model, trial.beta, parts, signal, start.system, narrowest)
        residual = trial.system.residual(solve(trial.system)[0])
        return _Search(Screen(start.model, start.system, residual, pool, elsewhere))

    def settle(terms: Sequence[FrictionTerm]) -> SettledFriction:
        return settled(model.with_robot(plain.with_terms((*own, *terms))), parts, signal, solve, search=False)

    first = search(start)
    before = first.screen.error(State())
    fitted = start.system.relative_error(start.system.residual(start.beta))
    if before > min(LARGEST_MISFIT, LARGEST_EXTRAPOLATION * fitted):
        return FrictionChoice(
            friction=plain.friction,
            velocities=start.velocities,
            held_out_before=before,
            held_out_after=before,
            refused="misfit" if before > LARGEST_MISFIT else "extrapolation",
        )
    state = first.chosen(State())
    # The second choice has the weights and loads of the first, beside velocities of the grid.
    last = search(settle([replace(term, estimated=False) for term in first.screen.terms(state)]))
    state, rivals = last.compared(last.needed(last.chosen(state)))
    moves = last.moves(state)
    trial = settle([move.term for move in moves])
    # What a search refuses early may be supported beside all laws, their velocities refined.
    further, found = _beside(trial.model, parts, signal, solve, narrowest, range(robot.n_dof))
    after = further.screen.error(found)
    if found != State():
        found, others = further.compared(found)
        rivals |= others
        moves = sorted([*moves, *further.moves(found)], key=lambda move: -move.worth.nats)
        trial = settle([move.term for move in moves])
    refused = {**last.refused, **further.refused}
    values = dict(zip(trial.model.unknowns.names, trial.beta, strict=True))
    # Load friction, memory and stiffness below zero would drive the joint.
    chosen = tuple(
        replace(term, rival=rivals.get(term.parameter, 0.0))
        for term in trial.robot.friction.terms
        if term.law not in ("load", "dahl", "spring") or values[term.parameter] > 0.0
    )
    added = {term.parameter for term in chosen}
    return FrictionChoice(
        friction=replace(robot.friction, terms=chosen, auto=False),
        velocities=tuple(
            {
                one.parameter: one for one in (*start.velocities, *trial.velocities) if one.parameter in added
            }.values()
        ),
        gains=tuple(
            TermGain.of(move.term.parameter, move.worth) for move in moves if move.term.parameter in added
        ),
        untold=tuple(
            TermGain.of(move.term.parameter, move.worth)
            for family, move in refused.items()
            if family not in {law_at(term) for term in chosen}
        ),
        held_out_before=before,
        held_out_after=after,
        without_memory=joints_without_memory(plain, narrowest.tolist()),
    )


def further_laws(
    model: Model,
    parts: Sequence[Window],
    signal: SignalProcessing,
    solve: Solve,
    resolved: Array | None,
    joints: Sequence[int],
) -> dict[int, tuple[Law, ...]]:
    """Choose what blocks left out support at some joints beside the laws that the robot has, which stay as they are.

    Parameters
    ----------
    model, parts, signal, solve, resolved
        As for `choose_terms`.
    joints : sequence of int
        Joints, from 0.

    Returns
    -------
    dict of int to tuple of str
        Laws by joint, from 0; joints without any are left out.

    Raises
    ------
    FitError
        As `choose_terms` (``test_friction_choice.py``).
    """
    search, state = _beside(model, parts, signal, solve, narrowest_memory(parts, resolved), joints)
    found = search.screen.terms(state)
    return {
        joint: laws for joint in joints if (laws := tuple(term.law for term in found if term.joint == joint))
    }


def _beside(  # many parameters: those of further_laws
    model: Model,
    parts: Sequence[Window],
    signal: SignalProcessing,
    solve: Solve,
    narrowest: Array,
    joints: Sequence[int],
) -> tuple[_Search, State]:
    """Return the search for further laws at some joints, and what it finds; `narrowest` are the least widths of memory."""
    own = [replace(term, estimated=False) for term in model.own.friction.terms]
    start = settled(model.with_robot(model.own.with_terms(own)), parts, signal, solve, search=False)
    pool = pool_of(start.robot, start.model, start.beta, parts, signal, start.system, narrowest)
    residual, some = start.system.residual(start.beta), [one for one in pool if one.term.joint in joints]
    search = _Search(Screen(start.model, start.system, residual, some, Elsewhere(parts)))
    search.barred.update(law_at(term) for term in own)
    return search, search.needed(search.chosen(State()))


class _Change(NamedTuple):
    """A joint whose sign is kept from now on, a candidate that is added to it, or both."""

    joint: int
    hold: bool
    candidate: int | None


class _Search:
    """Search for the laws that the blocks of a screen support."""

    def __init__(self, screen: Screen) -> None:
        self.screen = screen
        self.barred: set[tuple[int, str]] = set()
        self.refused: dict[tuple[int, str], Move] = {}

    def chosen(self, state: State) -> State:
        """Return the laws that the blocks support, added round by round to those of a state and judged at the end."""
        for _ in range(ROUNDS):
            picks = [
                pick for joint in range(self.screen.model.own.n_dof) if (pick := self._pick(state, joint))
            ]
            before = state
            for _, change in sorted(picks, key=lambda pick: -pick[0]):
                state = self._added(state, change)
            if state == before and not picks:
                break
        return state

    def moves(self, state: State) -> list[Move]:
        """Return the laws of a state, each with its worth beside all others, the largest first."""
        moves = [Move(term, self.screen.worth(without, state)) for term, without in self._one_less(state)]
        return sorted(moves, key=lambda move: -move.worth.nats)

    def _one_less(self, state: State) -> list[tuple[FrictionTerm, State]]:
        """Return each law of a state and the state without it; a sign that is kept goes with the memory beside it."""
        screen = self.screen

        def less(gone: set[int]) -> State:
            return replace(state, columns=tuple(k for k in state.columns if k not in gone))

        memory = [
            {k for k in state.columns if law_at(screen.pool[k].term) == (joint, "dahl")}
            for joint in sorted(state.holds)
        ]
        without = [
            screen.toggled(less(gone), joint) for joint, gone in zip(sorted(state.holds), memory, strict=True)
        ]
        return list(zip(screen.terms(state), [*without, *(less({k}) for k in state.columns)], strict=True))

    def _pick(self, state: State, joint: int) -> tuple[float, _Change] | None:
        """Return the change of a joint with the largest gain, about, and the gain."""
        screen, picks = self.screen, []
        if best := screen.best(state, joint, self.barred):
            picks.append((best[0], _Change(joint, False, best[1])))
        able = joint in screen.held_coulomb and joint not in state.holds
        if able and (joint, "hold") not in self.barred:
            held = screen.toggled(state, joint)
            alone = screen.worth(state, held)
            if alone.supported:
                picks.append((alone.nats, _Change(joint, True, None)))
            if best := screen.best(held, joint, self.barred):
                picks.append((alone.nats + best[0], _Change(joint, True, best[1])))
        return max(picks, key=lambda pick: pick[0], default=None)

    def _added(self, state: State, change: _Change) -> State:
        """Return the state with a change, if blocks support it beside those of this round and the log tells it."""
        screen = self.screen
        place = screen.held_coulomb[change.joint] - screen.n if change.candidate is None else change.candidate
        term = screen.pool[place].term
        after = screen.toggled(state, change.joint) if change.hold else state
        if change.candidate is not None:
            after = replace(after, columns=(*after.columns, change.candidate))
        try:
            worth = screen.worth(state, after)
        except FitError:
            worth = None
        if worth is not None and worth.supported and screen.told(worth, term):
            return after
        # What is refused now is not tried again.
        self.barred.add(law_at(term))
        if worth is not None and worth.supported:
            self.refused[law_at(term)] = Move(term, worth)
        return state

    def needed(self, state: State) -> State:
        """Return the state without laws that the blocks do not need beside all others, the least first."""
        kept: set[str] = set()
        last = state
        while True:
            idle: list[tuple[float, Move, State]] = []
            for term, without in self._one_less(state):
                if (
                    term.parameter in kept
                ):  # most gain more without another law, so all are judged again at the end
                    continue
                worth = self.screen.worth(without, state)
                # A sign that is kept adds no parameter, so it stays unless it does harm.
                keeps = worth.nats > 0.0 if term.law == "hold" else worth.supported
                if keeps and self.screen.told(worth, term):
                    kept.add(term.parameter)
                else:
                    idle.append((worth.nats, Move(term, worth), without))
            if idle:
                _, move, state = min(idle, key=lambda one: one[0])
                if move.worth.supported:
                    self.refused[law_at(move.term)] = move
            elif state == last:
                return state
            else:
                kept, last = set(), state

    def compared(self, state: State) -> tuple[State, dict[str, float]]:
        """Return a state with the better of atan and Stribeck's law at each joint, and rivals' velocities by parameter.

        Where the blocks do not decide between them, the other law is a rival.
        """
        screen, rivals = self.screen, {}
        for own in state.columns:
            term = screen.pool[own].term
            law = CURVES.get(term.law)
            if law is None:
                continue
            without = replace(state, columns=tuple(k for k in state.columns if k != own))
            best = screen.best(without, term.joint, self.barred, law)
            if best is None:
                continue
            other = replace(state, columns=tuple(best[1] if k == own else k for k in state.columns))
            gain = screen.gains(state, other)
            if gain.sum() > 0.0:
                state, own, best = other, best[1], (0.0, own)
            if abs(significance(gain)) < LEAST_SIGNIFICANCE:
                rivals[screen.pool[own].term.parameter] = screen.pool[best[1]].term.velocity
        return state, rivals
