"""Velocities of friction laws that are not linear in them, and load friction: what makes (7) nonlinear, solved around it.

    tau_f = ... + Fa atan(dq / va)                one velocity per joint                    separable least squares
    tau_f = ... + Fl |tau_r| s(dq)                tau_r from the last estimate              fixed point

For given velocities all else is linear (Golub and Pereyra 1973). A grid finds the valley joint by joint, Gauss-Newton steps
with the column ``d tau_f / d va`` its bottom. The torque ``tau_r`` of links and rotors comes from the estimate before; on the
TX40 each pass leaves a hundredth of the change before. Tested in ``tests/test_friction_terms.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array
from ...robot.friction import FrictionTerm
from ...robot.robot import Robot
from ...signal.decimation import decimate, decimation_stages
from ...signal.processing import SignalProcessing
from ...signal.segments import Segment, at_place
from ..linear_system import LinearSystem, linear_system
from ..selection import Selection, select

RANGE = {"revolute": (0.003, 2.0), "prismatic": (0.0005, 0.2)}
"""Velocities that the search covers (rad/s, m/s): below, a law is Coulomb friction, above, it is viscous friction."""
GRID = 41
"""Velocities of the grid, equidistant in their logarithm: a factor of 1.18 apart."""
GRID_SWEEPS = 2
"""Number of times that the grid goes through all joints; a joint's valley hardly moves with the velocities of the others."""
VELOCITY_STEPS = 12
"""Most Gauss-Newton steps."""
LOAD_PASSES = 12
"""Most passes of the fixed point of the load."""
SETTLED_VELOCITY = 1e-6
"""Relative change of velocities and parameters below which nothing moves any more."""
CLEAR_VELOCITY_GAIN = 4.0
"""Smallest gain of a law, in squared weighted residual, for its velocity to be identified: that of two standard deviations."""


@dataclass(frozen=True, kw_only=True)
class VelocityEstimate:
    """The velocity of one term.

    Attributes
    ----------
    parameter : str
        Parameter of its law, such as ``Fa3``.
    velocity : float
        Estimate (rad/s or m/s).
    std : float
        Its standard deviation by (10) for white residuals, all other parameters estimated beside it.
    identified : bool
        False where the best velocity lies at the end of the range or the law gains nothing. The square root then replaces atan.
    """

    parameter: str
    velocity: float
    std: float
    identified: bool


@dataclass(frozen=True, kw_only=True)
class SettledFriction:
    """What stands still once velocities and loads are found.

    Attributes
    ----------
    robot : Robot
        With all velocities known.
    selection : Selection
        The selection of the same names among its base parameters.
    beta : ndarray, shape (n_base,)
        Base parameters that the loads of the last pass come from.
    system : LinearSystem
        The linear system (7) with these velocities and loads.
    velocities : tuple of VelocityEstimate
        One per estimated velocity.
    passes : int
        Passes of the fixed point of the load; zero without load friction.
    """

    robot: Robot
    selection: Selection
    beta: Array
    system: LinearSystem
    velocities: tuple[VelocityEstimate, ...] = ()
    passes: int = 0


def settled(
    robot: Robot,
    parts: Sequence[Segment],
    signal: SignalProcessing,
    chosen: tuple[dict[str, float], tuple[str, ...]],
    solve: Callable[[LinearSystem], tuple[Array, Array]],
) -> SettledFriction:
    """Find velocities and loads with which the linear system (7) gives back the estimate that it was made of.

    Parameters
    ----------
    robot : Robot
        Some of its friction terms have unknown velocities, or depend on the load.
    parts : sequence of Segment
        Filtered motion and torque.
    signal : SignalProcessing
        Decimation.
    chosen : (dict, tuple)
        Fixed and dropped base parameters.
    solve : callable
        Solves a system: its estimate (b,) and its row weights (r,).

    Returns
    -------
    SettledFriction

    Raises
    ------
    FitError
        As `linear_system` and the solver.
    """
    estimates: tuple[VelocityEstimate, ...] = ()
    beta: Array | None = None
    if robot.friction.has_load:
        beta = _without_load(robot, parts, signal, chosen, solve)
    passes = 0
    while True:
        selection = select(robot, *chosen)
        system = linear_system(robot, parts, signal, selection, beta)
        if robot.friction.estimated:
            robot, estimates = _estimate_velocities(robot, parts, signal, system, solve)
            selection = select(robot, *chosen)
            system = linear_system(robot, parts, signal, selection, beta)
        solution, _ = solve(system)
        found = selection.expand(solution)
        if not robot.friction.has_load:
            return SettledFriction(
                robot=robot, selection=selection, beta=found, system=system, velocities=estimates
            )
        passes += 1
        change = np.linalg.norm(found - beta) if beta is not None else np.inf
        beta = found
        if change <= SETTLED_VELOCITY * np.linalg.norm(found) or passes == LOAD_PASSES:
            system = linear_system(robot, parts, signal, selection, beta)
            return SettledFriction(
                robot=robot,
                selection=selection,
                beta=beta,
                system=system,
                velocities=estimates,
                passes=passes,
            )


def with_slopes(
    system: LinearSystem, robot: Robot, parts: Sequence[Segment], signal: SignalProcessing
) -> LinearSystem:
    """Return a system with the derivatives of its columns by the velocities that were estimated from the log.

    Parameters
    ----------
    system : LinearSystem
        Made of `parts`.
    robot : Robot
        Its terms say which velocities were estimated.
    parts : sequence of Segment
        Motion along which the columns are.
    signal : SignalProcessing
        Decimation.
    """
    fitted = [term for term in robot.friction.terms if term.fitted and term.parameter in system.names]
    return replace(
        system,
        slopes={
            term.parameter: _column(term, term.velocity, parts, signal, system, _slope) for term in fitted
        },
    )


def _without_load(
    robot: Robot,
    parts: Sequence[Segment],
    signal: SignalProcessing,
    chosen: tuple[dict[str, float], tuple[str, ...]],
    solve: Callable[[LinearSystem], tuple[Array, Array]],
) -> Array:
    """Return the base parameters of a first fit that leaves load friction out."""
    fixed, dropped = chosen
    loads = [term.parameter for term in robot.friction.terms if term.law == "load"]
    fixed = {name: value for name, value in fixed.items() if name not in loads}
    selection = select(robot, fixed, tuple(dict.fromkeys((*dropped, *loads))))
    system = linear_system(robot, parts, signal, selection)
    return selection.expand(solve(system)[0])


def _estimate_velocities(
    robot: Robot,
    parts: Sequence[Segment],
    signal: SignalProcessing,
    system: LinearSystem,
    solve: Callable[[LinearSystem], tuple[Array, Array]],
) -> tuple[Robot, tuple[VelocityEstimate, ...]]:
    """Return the robot with the velocities that fit best, and how well the log identifies each."""
    terms = robot.friction.estimated
    places = [system.names.index(term.parameter) for term in terms]
    velocities = np.array([term.velocity for term in terms])
    w = system.w.copy()
    gains = np.zeros(len(terms))
    at_end = np.zeros(len(terms), dtype=bool)
    for _ in range(GRID_SWEEPS):
        _, weights = solve(replace(system, w=w))
        for k, term in enumerate(terms):
            grid = np.geomspace(*RANGE[robot.joint_kinds[term.joint]], GRID)
            columns = np.stack([_column(term, v, parts, signal, system) for v in grid], axis=1)
            gain = _gains(w, places[k], columns, system.y, weights)
            best = int(np.argmax(gain))
            velocities[k], gains[k] = grid[best], gain[best]
            at_end[k] = best in (0, GRID - 1)
            w[:, places[k]] = columns[:, best]
    inner = ~at_end & (gains > CLEAR_VELOCITY_GAIN)
    velocities, std = _refined(terms, velocities, inner, parts, signal, replace(system, w=w), places, solve)
    estimates = tuple(
        VelocityEstimate(parameter=term.parameter, velocity=float(v), std=float(s), identified=bool(good))
        for term, v, s, good in zip(terms, velocities, std, inner, strict=True)
    )
    found = iter(zip(velocities, inner, strict=True))
    known: list[FrictionTerm] = []
    for term in robot.friction.terms:
        if not term.estimated:
            known.append(term)
            continue
        velocity, good = next(found)
        if good or term.law == "stribeck":
            known.append(replace(term, velocity=float(velocity), estimated=False, fitted=True))
        else:
            known.append(FrictionTerm(law="root", joint=term.joint))
    return replace(robot, friction=replace(robot.friction, terms=tuple(known))), estimates


def _law(term: FrictionTerm, velocity: float, dq: Array) -> Array:
    """Column of a law at a velocity, at the speeds of its joint."""
    if term.law == "atan":
        return np.arctan(dq / velocity)
    return np.asarray(np.sign(dq) * np.exp(-np.square(dq / velocity)))


def _slope(term: FrictionTerm, velocity: float, dq: Array) -> Array:
    """Its derivative by the velocity."""
    if term.law == "atan":
        return np.asarray(-dq / (velocity**2 + dq**2))
    return np.asarray(_law(term, velocity, dq) * 2.0 * dq**2 / velocity**3)


def _column(
    term: FrictionTerm,
    velocity: float,
    parts: Sequence[Segment],
    signal: SignalProcessing,
    system: LinearSystem,
    shape: Callable[[FrictionTerm, float, Array], Array] = _law,
) -> Array:
    """Column of W of a law, (r,): decimated as all others, zero in the rows of the other joints."""
    column = np.zeros(system.y.size)
    rows = []
    for part in parts:
        with at_place(part.place):
            stages = decimation_stages(part.q.shape[0], signal)
            values = shape(term, velocity, part.dq[:, term.joint])[:, None]
            rows.append(decimate(np.ascontiguousarray(values), stages)[signal.kept_rows, 0])
    column[system.joints[term.joint]] = np.concatenate(rows)
    return column


def _gains(w: Array, place: int, columns: Array, y: Array, weights: Array) -> Array:
    """By how much each candidate in the place of a column lowers the squared weighted residual."""
    rest = np.delete(w, place, axis=1) * weights[:, None]
    q, _ = np.linalg.qr(rest)
    target = y * weights
    residual = target - q @ (q.T @ target)
    candidates = columns * weights[:, None]
    size = np.linalg.norm(candidates, axis=0)
    candidates = candidates - q @ (q.T @ candidates)
    new = np.linalg.norm(candidates, axis=0)
    shares = candidates.T @ residual
    # A candidate that the other columns have already gains nothing.
    return np.asarray(np.where(new > 1e-8 * size, (shares / np.where(new > 0.0, new, 1.0)) ** 2, 0.0))


def _refined(
    terms: Sequence[FrictionTerm],
    velocities: Array,
    inner: np.ndarray,
    parts: Sequence[Segment],
    signal: SignalProcessing,
    system: LinearSystem,
    places: Sequence[int],
    solve: Callable[[LinearSystem], tuple[Array, Array]],
) -> tuple[Array, Array]:
    """Gauss-Newton steps on the velocities that the grid found inside the range; those and their standard deviations."""
    moving = [int(k) for k in np.flatnonzero(inner)]
    std = np.full(len(terms), np.nan)
    velocities = velocities.copy()
    if not moving:
        return velocities, std
    w = system.w.copy()
    for _ in range(VELOCITY_STEPS):
        beta, weights = solve(replace(system, w=w))
        slopes = np.stack(
            [
                beta[places[k]] * _column(terms[k], velocities[k], parts, signal, system, _slope)
                for k in moving
            ],
            axis=1,
        )
        both = np.hstack([w, slopes]) * weights[:, None]
        q, r = np.linalg.qr(both)
        solution = np.linalg.solve(r, q.T @ (system.y * weights))
        step = solution[w.shape[1] :]
        inverse = np.linalg.solve(r, np.eye(r.shape[0]))
        rest = system.y * weights - both @ solution
        variance = float(rest @ rest) / max(1, rest.size - r.shape[0])
        std[moving] = np.sqrt(variance * np.square(inverse[w.shape[1] :]).sum(axis=1))
        # A velocity is above zero and is known as a factor: steps are bounded in its logarithm.
        relative = np.clip(step / velocities[moving], -0.5, 1.0)
        velocities[moving] *= 1.0 + relative
        for k in moving:
            w[:, places[k]] = _column(terms[k], velocities[k], parts, signal, system)
        if np.abs(relative).max() <= SETTLED_VELOCITY:
            break
    return velocities, std
