"""Columns of the friction terms that a log may support, joint by joint, beside those of the plain model.

Where a joint holds its sign, the columns of Coulomb, Stribeck and load friction are others; both are in the pool.
Tested in ``tests/test_friction_choice.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array, true_ranges
from ...model.dynamics import rigid_torque
from ...model.memory import direction, held_sign, states
from ...robot.friction import OF_TEMPERATURE, START_WIDTH, FrictionTerm
from ...robot.robot import Robot
from ...signal.processing import SignalProcessing
from ...signal.window import Window
from ...terms.model import Model
from ...terms.rows import LinearSystem
from .alarm import joint_scales
from .velocity import decimated, slowest_law

ATAN = tuple(np.geomspace(0.01, 2.0, 10).tolist())
"""Velocities (rad/s) of atan among the candidates."""
STRIBECK = (0.02, 0.05, 0.12, 0.3)
"""Velocities (rad/s) of Stribeck's law among the candidates."""
DAHL = (3e-4, 6e-4, 1.2e-3, 2.5e-3, 5e-3, 1e-2, 2e-2)
"""Displacements (rad) of Dahl's memory among the candidates; on real arms wider ones fit the log but predict no other."""
LEAST_WARMING = 2.0
"""Smallest range (K) of a joint's temperature for a law of temperature: two steps of a usual sensor."""
LEAST_STANDSTILL = 0.01
"""Smallest share of samples at standstill for a standstill torque to be a candidate."""
LEAST_STEPS = 10.0
"""Least ratio of a displacement of memory to the error of a reversal: coarse encoders and slow logs look like memory themselves."""

SLOW = 0.005
"""Speed, as a share of the top speed, below which a joint stands still if this lasts for `LONG_S`."""
LONG_S = 0.1
"""Shortest standstill (s): a reversal takes less."""
LEAST_REST = 0.05
"""Share of a log at standstill from which it is reported: 17 % decided some friction parameters of a real log
(docs/published.md)."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A column that a term would have, in the rows of its joint.

    Attributes
    ----------
    term : FrictionTerm
        Term; of law ``hold`` for the column of Coulomb friction whose sign is kept.
    held : bool or None
        Whether it is the column at a joint that holds its sign; None where that makes no difference.
    column : ndarray, shape (n_rows,)
        Rows of its joint.
    """

    term: FrictionTerm
    held: bool | None
    column: Array


def pool_of(
    plain: Robot,
    trial: Model,
    beta: Array,
    parts: Sequence[Window],
    signal: SignalProcessing,
    system: LinearSystem,
    narrowest: Array,
) -> list[Candidate]:
    """Return the candidates.

    Parameters
    ----------
    plain : Robot
        Without the terms to choose.
    trial : Model
        With the terms of the last round, whose parameters give the load.
    beta : ndarray, shape (b + e,)
        Unknowns of `trial`.
    parts, signal
        Motion and decimation.
    system : LinearSystem
        The system (7) of `plain`.
    narrowest : ndarray, shape (n_dof,)
        See `narrowest_memory`.
    """
    x = trial.lift(beta)
    loads = [
        np.abs(rigid_torque(trial.own, part.q, part.dq, part.ddq, trial.standard(x, part.recording)))
        for part in parts
    ]
    now = [direction(plain, part.q, part.dq) for part in parts]
    pool: list[Candidate] = []
    taken = {term.parameter for term in plain.friction.terms}
    for joint, kind in enumerate(plain.joint_kinds):
        held = [
            held_sign(part.q[:, joint], sign[0, joint], kind)[:, None]
            for part, sign in zip(parts, now, strict=True)
        ]
        signs = [sign[:, [joint]] for sign in now]
        offers, values = _offers(plain, joint, parts, signs, held, loads, float(narrowest[joint]))
        rows = decimated(values, parts, signal)
        # A sign can be kept where Coulomb friction is one column that is estimated.
        can_hold = plain.friction.model == "symmetric" and f"Fc{joint + 1}" in system.names
        pool += [
            Candidate(term=term, held=at_hold, column=rows[:, k])
            for k, (term, at_hold) in enumerate(offers)
            if term.parameter not in taken and (can_hold or not at_hold)
        ]
    return pool


def narrowest_memory(parts: Sequence[Window], steps: Array | None) -> Array:
    """Compute the smallest displacement of memory that a log resolves, (n_dof,) (rad or m).

    Parameters
    ----------
    parts : sequence of Window
        Motion. Between two samples at a reversal a joint goes on by up to an eighth of the second difference of its positions.
    steps : ndarray, shape (n_dof,), optional
        Step of the encoder of each joint (rad or m).

    Notes
    -----
    ``test_friction_choice.py`` refuses coarse encoders and slow logs, and neither of fine ones.
    """
    moves = [np.diff(part.q, axis=0) for part in parts]
    missed = np.zeros(parts[0].q.shape[1]) if steps is None else np.array(steps, dtype=np.float64)
    for joint in range(missed.size):
        bends = [np.diff(move[:, joint])[move[1:, joint] * move[:-1, joint] < 0.0] for move in moves]
        turns = np.abs(np.concatenate(bends)) / 8.0
        missed[joint] = max(missed[joint], float(np.median(turns)) if turns.size else 0.0)
    return LEAST_STEPS * missed


def at_rest(robot: Robot, parts: Sequence[Window]) -> list[Array]:
    """Return 1 where a joint with a plain sign, no dead zone, stands still for long, (n_samples, n_dof) of each part."""
    found = [np.zeros_like(part.dq) for part in parts]
    if robot.friction.coulomb != "sign":
        return found
    held = [term.joint for term in robot.friction.terms if term.law == "hold"]
    for joint in range(robot.n_dof):
        if robot.friction.dead_zone[joint] > 0.0 or joint in held:
            continue
        top = max(float(np.abs(part.dq[:, joint]).max()) for part in parts)
        for part, own in zip(parts, found, strict=True):
            slow = np.abs(part.dq[:, joint]) < SLOW * top
            for start, stop in true_ranges(slow, math.ceil(LONG_S * part.rate_hz)):
                own[start:stop, joint] = 1.0
    return found


def warming(parts: Sequence[Window], joint: int) -> tuple[float, list[Array]]:
    """Return the mean temperature of a joint, rounded (degC), and the temperature above it along each part, (n_samples, 1).

    There are no parts where the temperature is not recorded, or varies by less than `LEAST_WARMING`.
    """
    recorded = [part.temperature[:, [joint]] for part in parts if part.temperature is not None]
    if len(recorded) < len(parts) or np.ptp(np.concatenate(recorded)) < LEAST_WARMING:
        return 0.0, []
    mean = float(np.round(np.mean(np.concatenate(recorded))))
    return mean, [values - mean for values in recorded]


def joints_without_memory(robot: Robot, narrowest: Sequence[float]) -> dict[int, float]:
    """Return the joints, from 0, without candidates of a usual displacement of memory, and the smallest that is one (rad or m)."""
    usual = [START_WIDTH[kind] for kind in robot.joint_kinds]
    return {joint: value for joint, value in enumerate(narrowest) if value > usual[joint]}


def _offers(
    robot: Robot,
    joint: int,
    parts: Sequence[Window],
    now: Sequence[Array],
    held: Sequence[Array],
    loads: Sequence[Array],
    narrowest: float,
) -> tuple[list[tuple[FrictionTerm, bool | None]], list[Array]]:
    """Return the terms of a joint, each with whether it holds, and their columns at all samples, (n_samples, k) of each part."""
    friction = robot.friction
    unit = float(joint_scales(robot)[joint])
    slowest = slowest_law(robot, joint)
    dq = [part.dq[:, [joint]] for part in parts]
    offers: list[tuple[FrictionTerm, bool | None]] = []
    columns: list[list[Array]] = []

    reference, warm = warming(parts, joint)

    def offer(law: str, values: Sequence[Array], held: bool | None = None, velocity: float = 0.0) -> None:
        term = FrictionTerm(law=law, joint=joint, velocity=velocity, estimated=velocity > 0.0)  # type: ignore[arg-type]
        offers.append((replace(term, values=(reference,)) if law in OF_TEMPERATURE else term, held))
        columns.append(list(values))

    offer("hold", held, True)
    if friction.coulomb == "sign" and friction.dead_zone[joint] > 0.0:
        rest = [(np.abs(speed) <= friction.dead_zone[joint]).astype(np.float64) for speed in dq]
        if np.mean(np.concatenate(rest)) > LEAST_STANDSTILL:
            offer("rest", rest)
    if friction.model == "symmetric":
        offer("forward", [np.maximum(speed, 0.0) for speed in dq])
    if warm:
        offer("warm_viscous", [part * speed for part, speed in zip(warm, dq, strict=True)])
    offer("spring", [part.q[:, [joint]] for part in parts])
    for at_hold, signs in ((False, now), (True, held)):
        loaded = zip(signs, loads, strict=True)
        offer("load", [sign * load[:, [joint]] for sign, load in loaded], at_hold)
        if warm:
            offer("warm_coulomb", [part * sign for part, sign in zip(warm, signs, strict=True)], at_hold)
        for v in STRIBECK:
            if v * unit >= slowest:
                falling = [
                    sign * np.exp(-np.square(speed / (v * unit)))
                    for sign, speed in zip(signs, dq, strict=True)
                ]
                offer("stribeck", falling, at_hold, v * unit)
    for v in ATAN:
        if v * unit >= slowest:
            offer("atan", [np.arctan(speed / (v * unit)) for speed in dq], None, v * unit)
    widths = np.array([h * unit for h in DAHL if h * unit >= narrowest])
    if widths.size:
        remembered = [
            states(part.q[:, joint], widths, sign[0, 0]) for part, sign in zip(parts, now, strict=True)
        ]
        for k, width in enumerate(widths):
            offer("dahl", [state[:, [k]] for state in remembered], None, float(width))
    return offers, [np.hstack([column[k] for column in columns]) for k in range(len(parts))]
