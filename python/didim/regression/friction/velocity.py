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
from functools import cached_property

import numpy as np

from ..._tools.arrays import Array
from ...model.memory import direction, instantaneous, states
from ...robot.friction import FrictionTerm, Law
from ...robot.robot import Robot
from ...signal.filters import decimate, decimation_stages
from ...signal.processing import SignalProcessing
from ...signal.window import Window, at_place
from ...terms.model import Model
from ...terms.rows import LinearSystem
from ..descent import descend

Solve = Callable[[LinearSystem], tuple[Array, Array]]
"""Solution of a system: the estimate, (b,), and the weights of the rows, (r,)."""

Shape = Callable[[Robot, FrictionTerm, Array, Window], Array]
"""Columns of a law at velocities or widths (k,), along a segment: (n_samples, k)."""

CURVES: dict[Law, Law] = {"atan": "stribeck", "stribeck": "atan"}
"""Laws of speed that explain the same residual, each with the other."""
RANGE = {"revolute": (0.003, 2.0), "prismatic": (0.0005, 0.2)}
"""Velocities covered by the search (rad/s, m/s): below them a law is Coulomb friction, above them viscous friction."""
WIDTHS = {"revolute": (1e-4, 0.05), "prismatic": (1e-5, 0.005)}
"""Displacements of Dahl's memory covered by the search (rad, m): below them it is a sign, above them a spring between
reversals."""
WIDTH_CHANGE = 1e-4
"""Relative change of a displacement, both ways, in the finite difference of Dahl's state."""
LEAST_DEAD_ZONES = 2.0
"""Smallest velocity of a law, in dead zones of its joint: a slower law only corrects the torque at rest."""
GRID = 41
"""Number of grid velocities, equidistant in their logarithm: a factor of 1.18 apart."""
GRID_SWEEPS = 2
"""Number of sweeps of the grid over all joints; a joint's optimum hardly depends on the other joints' velocities."""
VELOCITY_STEPS = 12
"""Upper bound of the Gauss-Newton steps with one set of weights."""
VELOCITY_WEIGHTS = 2
"""Number of sets of weights: those of the first velocities, and those of the velocities estimated with them."""
LOAD_PASSES = 12
"""Upper bound of the fixed-point iterations for the load."""
SETTLED_VELOCITY = 1e-6
"""Relative change of velocities and parameters below which they have converged."""
SETTLED_DEVIATIONS = 1e-3
"""Step of a velocity, in its standard deviations, that is the last: the error after it is its square."""
FARTHEST = 4.0
"""Largest factor by which a velocity chosen on held-out blocks is refined; one that moves further has a flat profile."""
CLEAR_VELOCITY_GAIN = 4.0
"""Smallest reduction of the squared weighted residual by a law for its velocity to be identified: two standard deviations."""


@dataclass(frozen=True, kw_only=True)
class VelocityEstimate:
    """The velocity of one term, or the displacement of its memory.

    Attributes
    ----------
    parameter : str
        Parameter of its law, such as ``Fa3``.
    law : {"atan", "stribeck", "dahl"}
        Its law.
    velocity : float
        Estimate (rad/s or m/s); of ``dahl`` the displacement (rad or m).
    std : float
        Its standard deviation by (10) for white residuals, all other parameters estimated beside it.
    identified : bool
        False where the best velocity lies at the end of the range or the law gains nothing. The square root then replaces atan,
        and other laws keep it.
    """

    parameter: str
    law: Law
    velocity: float
    std: float
    identified: bool


@dataclass(frozen=True, kw_only=True)
class SettledFriction:
    """Quantities that stay constant while velocities and loads are searched.

    Attributes
    ----------
    model : Model
        With all velocities known.
    beta : ndarray, shape (b + e,)
        Unknowns that the loads of the last pass come from.
    system : LinearSystem
        The linear system (7) with these velocities and loads.
    velocities : tuple of VelocityEstimate
        One per estimated velocity.
    passes : int
        Passes of the fixed point of the load; zero without load friction.
    """

    model: Model
    beta: Array
    system: LinearSystem
    velocities: tuple[VelocityEstimate, ...] = ()
    passes: int = 0

    @property
    def robot(self) -> Robot:
        """The robot with all velocities known."""
        return self.model.own


@dataclass(frozen=True)
class _Along:
    """A robot along the segments of a log, with the system that was made of them."""

    robot: Robot
    parts: Sequence[Window]
    signal: SignalProcessing
    system: LinearSystem


def settled(
    model: Model,
    parts: Sequence[Window],
    signal: SignalProcessing,
    solve: Solve,
    *,
    search: bool = True,
) -> SettledFriction:
    """Find velocities and loads with which the linear system (7) gives back the estimate that it was made of.

    Parameters
    ----------
    model : Model
        Some friction terms of its robot have unknown velocities, or depend on the load.
    parts : sequence of Window
        Filtered motion and torque.
    signal : SignalProcessing
        Decimation.
    solve : callable
        Solves a system: its estimate (b,) and its row weights (r,).
    search : bool
        Look for velocities on the whole grid first; without it they are refined from those of the terms.

    Returns
    -------
    SettledFriction

    Raises
    ------
    FitError
        As `Model.rows` and the solver.
    """
    estimates: tuple[VelocityEstimate, ...] = ()
    # Without load friction the system does not depend on the estimate.
    beta = _without_load(model, parts, signal, solve) if model.own.friction.has_load else None
    passes = 0
    while True:
        system = model.rows(parts, signal, beta)
        if model.own.friction.estimated:
            robot, found = _estimate_velocities(_Along(model.own, parts, signal, system), solve, search)
            model = model.with_robot(robot)
            system = model.rows(parts, signal, beta)
            again = {each.parameter: each for each in found}
            estimates = tuple(again.get(each.parameter, each) for each in estimates or found)
        solution, _ = solve(system)
        estimate = model.unknowns.expand(solution)
        if beta is None:
            break
        passes += 1
        change, beta = np.linalg.norm(estimate - beta), estimate
        if change <= SETTLED_VELOCITY * np.linalg.norm(estimate) or passes == LOAD_PASSES:
            system = model.rows(parts, signal, beta)
            break
        # Velocities that the log identifies follow the loads.
        terms = [
            replace(term, estimated=True, fitted=False) if term.fitted else term
            for term in model.own.friction.terms
        ]
        model, search = model.with_robot(model.own.with_terms(terms)), False
    return SettledFriction(model=model, beta=estimate, system=system, velocities=estimates, passes=passes)


def with_slopes(
    system: LinearSystem, robot: Robot, parts: Sequence[Window], signal: SignalProcessing
) -> LinearSystem:
    """Return a system with what the log leaves open of its friction laws: derivatives by estimated velocities, and other laws.

    Parameters
    ----------
    system : LinearSystem
        Made of `parts`.
    robot : Robot
        Its terms say which velocities were estimated, and what fits as well.
    parts : sequence of Window
        Motion along which the columns are.
    signal : SignalProcessing
        Decimation.
    """
    terms = [term for term in robot.friction.terms if term.parameter in system.names]
    rivals = [(term.parameter, other_curve(term)) for term in terms if term.rival]

    def column(term: FrictionTerm, shape: Shape) -> Array:
        log = _Along(robot, parts, signal, system)
        return _columns(log, term, np.array([term.velocity]), shape)[:, 0]

    return replace(
        system,
        slopes={term.parameter: column(term, _slope) for term in terms if term.fitted},
        alternatives=(
            *((term.parameter, np.zeros(system.y.size)) for term in terms if term.doubtful),
            *((name, column(other, _law)) for name, other in rivals),
        ),
    )


def other_curve(term: FrictionTerm) -> FrictionTerm:
    """Return the other of atan and Stribeck's law, at the velocity of the rival if there is one; other terms as they are."""
    law = CURVES.get(term.law)
    return term if law is None else replace(term, law=law, name="", velocity=term.rival or term.velocity)


def _without_load(
    model: Model,
    parts: Sequence[Window],
    signal: SignalProcessing,
    solve: Solve,
) -> Array:
    """Return the base parameters of a first fit that leaves load friction out."""
    loads = [term.parameter for term in model.own.friction.terms if term.law == "load"]
    fixed = {name: value for name, value in model.unknowns.given("fixed").items() if name not in loads}
    without = model.choosing(fixed, {*model.unknowns.given("dropped"), *loads})
    return without.unknowns.expand(solve(without.rows(parts, signal))[0])


def _estimate_velocities(
    log: _Along, solve: Solve, search: bool
) -> tuple[Robot, tuple[VelocityEstimate, ...]]:
    """Return the robot with the velocities that fit best, and how well the log identifies each."""
    robot, system = log.robot, log.system
    terms = robot.friction.estimated
    places = [system.names.index(term.parameter) for term in terms]
    velocities = np.array([term.velocity for term in terms])
    w = system.w.copy()
    inner = np.ones(len(terms), dtype=bool)
    for _ in range(GRID_SWEEPS if search else 0):
        _, weights = solve(replace(system, w=w))
        for k, term in enumerate(terms):
            grid = np.geomspace(*_range(robot, term), GRID)
            columns = _columns(log, term, grid)
            gain = _gains(w, places[k], columns, system.y, weights)
            best = int(np.argmax(gain))
            velocities[k] = grid[best]
            inner[k] = best not in (0, GRID - 1) and gain[best] > CLEAR_VELOCITY_GAIN
            w[:, places[k]] = columns[:, best]
    start = velocities
    velocities, std = _refined(replace(log, system=replace(system, w=w)), start, inner, solve)
    ranges = [_range(robot, term) for term in terms]
    inner &= [low < v < high for v, (low, high) in zip(velocities, ranges, strict=True)]
    if not search:
        inner &= np.maximum(velocities / start, start / velocities) < FARTHEST
        velocities = np.where(inner, velocities, start)
    estimates = tuple(
        VelocityEstimate(
            parameter=term.parameter, law=term.law, velocity=float(v), std=float(s), identified=bool(good)
        )
        for term, v, s, good in zip(terms, velocities, std, inner, strict=True)
    )
    found = iter(estimates)
    known: list[FrictionTerm] = []
    for term in robot.friction.terms:
        if term.estimated:
            own = next(found)
            good = own.identified
            if good or term.law != "atan" or not search:
                term = replace(term, velocity=own.velocity, estimated=False, fitted=good, refused=not good)
            else:
                term = FrictionTerm(law="root", joint=term.joint, refused=True)
        known.append(term)
    return robot.with_terms(known), estimates


def slowest_law(robot: Robot, joint: int) -> float:
    """Return the smallest velocity of a law at a joint: a slower one cannot be told from the sign near rest (rad/s or m/s)."""
    friction = robot.friction
    zone = friction.dead_zone if friction.coulomb == "sign" else friction.smoothing
    return LEAST_DEAD_ZONES * zone[joint]


def _range(robot: Robot, term: FrictionTerm) -> tuple[float, float]:
    """Return the velocities or widths that the search covers."""
    kind = robot.joint_kinds[term.joint]
    if term.law == "dahl":
        return WIDTHS[kind]
    low, high = RANGE[kind]
    return min(max(low, slowest_law(robot, term.joint)), 0.5 * high), high


def _law(robot: Robot, term: FrictionTerm, velocities: Array, part: Window) -> Array:
    """Return the columns of a law at velocities or widths (k,), along the motion of its joint: (n_samples, k)."""
    if term.law == "dahl":
        first = instantaneous(robot, part.dq[:1])[0, term.joint]
        return states(part.q[:, term.joint], velocities, first)
    dq = part.dq[:, [term.joint]]
    if term.law == "atan":
        return np.arctan(dq / velocities)
    sign = direction(robot, part.q, part.dq)[:, [term.joint]]
    return np.asarray(sign * np.exp(-np.square(dq / velocities)))


def _slope(robot: Robot, term: FrictionTerm, velocities: Array, part: Window) -> Array:
    """Return their derivatives by the velocity or width."""
    if term.law == "dahl":
        near = _law(robot, term, np.outer((1.0 + WIDTH_CHANGE, 1.0 - WIDTH_CHANGE), velocities).ravel(), part)
        return np.asarray(
            (near[:, : velocities.size] - near[:, velocities.size :]) / (2.0 * WIDTH_CHANGE * velocities)
        )
    sign = direction(robot, part.q, part.dq)[:, [term.joint]]
    return slope_at(term.law, part.dq[:, [term.joint]], sign, velocities)


def slope_at(law: str, dq: Array, sign: Array, velocities: Array | float) -> Array:
    """Return the derivative of ``atan`` or ``stribeck`` by its velocity, at joint velocities with their signs; zero of others."""
    if law == "atan":
        return np.asarray(-dq / (np.square(velocities) + np.square(dq)))
    if law != "stribeck":
        return np.zeros_like(dq)
    x = np.square(dq / velocities)
    return np.asarray(sign * np.exp(-x) * 2.0 * x / velocities)


def _columns(log: _Along, term: FrictionTerm, velocities: Array, shape: Shape = _law) -> Array:
    """Return columns of W of a law at velocities or widths (k,), (r, k): decimated, zero in the rows of the other joints."""
    columns = np.zeros((log.system.y.size, velocities.size))
    values = [shape(log.robot, term, velocities, part) for part in log.parts]
    columns[log.system.joints[term.joint]] = decimated(values, log.parts, log.signal)
    return columns


def decimated(values: Sequence[Array], parts: Sequence[Window], signal: SignalProcessing) -> Array:
    """Return signals of the segments, (n_samples, k) each, on the rows of the system, (n_rows, k)."""
    rows = []
    for part, value in zip(parts, values, strict=True):
        with at_place(part.place):
            stages = decimation_stages(part.q.shape[0], signal)
            rows.append(decimate(np.ascontiguousarray(value), stages)[signal.kept_rows])
    return np.concatenate(rows)


def _gains(w: Array, index: int, columns: Array, y: Array, weights: Array) -> Array:
    """By how much each candidate in the place of a column lowers the squared weighted residual."""
    rest = np.delete(w, index, axis=1) * weights[:, None]
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


def _refined(log: _Along, velocities: Array, inner: np.ndarray, solve: Solve) -> tuple[Array, Array]:
    """Gauss-Newton steps on the velocities that the grid found inside the range; those and their standard deviations.

    All other columns are eliminated once for each set of weights, so that a step is a fit of two columns a velocity.
    """
    moving = np.flatnonzero(inner)
    std, velocities = np.full(len(velocities), np.nan), velocities.copy()
    if not moving.size:
        return velocities, std
    system = log.system
    terms = [log.robot.friction.estimated[k] for k in moving]
    own = [system.names.index(term.parameter) for term in terms]
    w = system.w.copy()
    for _ in range(VELOCITY_WEIGHTS):
        _, weights = solve(replace(system, w=w))
        others, _ = np.linalg.qr(np.delete(w, own, axis=1) * weights[:, None])
        y = _beyond(others, system.y[:, None] * weights[:, None])[:, 0]
        start = _Point(log, terms, others, weights, y, velocities[moving])
        point, _, _ = descend(start, VELOCITY_STEPS)
        velocities[moving], std[moving], w[:, own] = point.velocities, point.std, point.columns(_law)
    return velocities, std


@dataclass(frozen=True, eq=False)
class _Point:
    """Velocities of laws, beside orthonormal columns of all others."""

    log: _Along
    terms: Sequence[FrictionTerm]
    others: Array
    weights: Array
    y: Array
    velocities: Array

    def columns(self, shape: Shape) -> Array:
        """Columns of the laws, or their derivatives, (r, k)."""
        pairs = zip(self.terms, self.velocities, strict=True)
        return np.hstack([_columns(self.log, term, np.array([value]), shape) for term, value in pairs])

    @cached_property
    def _fit(self) -> tuple[Array, Array, Array]:
        """Laws beyond the other columns, their coefficients, and what they leave."""
        laws = _beyond(self.others, self.columns(_law) * self.weights[:, None])
        beta = np.asarray(np.linalg.lstsq(laws, self.y, rcond=None)[0], dtype=np.float64)
        return laws, beta, self.y - laws @ beta

    @property
    def cost(self) -> float:
        """Squared weighted residual."""
        rest = self._fit[2]
        return float(rest @ rest)

    @cached_property
    def _step(self) -> tuple[Array, Array]:
        """Relative change of the velocities by a Gauss-Newton step, and their standard deviations."""
        laws, beta, _ = self._fit
        slopes = _beyond(self.others, self.columns(_slope) * self.weights[:, None])
        both, count = np.hstack([laws, slopes * beta]), len(beta)
        q, r = np.linalg.qr(both)
        solution = np.linalg.solve(r, q.T @ self.y)
        inverse = np.linalg.solve(r, np.eye(2 * count))
        rest = self.y - both @ solution
        variance = float(rest @ rest) / max(1, rest.size - self.log.system.w.shape[1] - count)
        std = np.sqrt(variance * np.square(inverse[count:]).sum(axis=1))
        # A velocity is above zero and is known as a factor: steps are bounded in its logarithm.
        return np.clip(solution[count:] / self.velocities, -0.5, 1.0), np.asarray(std)

    @property
    def std(self) -> Array:
        """Standard deviations of the velocities, (k,)."""
        return self._step[1]

    @property
    def _ends(self) -> tuple[Array, Array]:
        low, high = np.array([_range(self.log.robot, term) for term in self.terms]).T
        return low, high

    def moved(self, share: float) -> _Point:
        there = np.clip(self.velocities * (1.0 + share * self._step[0]), *self._ends)
        return replace(self, velocities=there)

    def rests(self, share: float) -> bool:
        there, (low, high) = self.moved(share).velocities, self._ends
        small = np.maximum(SETTLED_VELOCITY, SETTLED_DEVIATIONS * self.std / there)
        inside = (low < there) & (there < high)
        return bool((np.abs(share * self._step[0]) <= small)[inside].all())


def _beyond(q: Array, columns: Array) -> Array:
    """Return what orthonormal columns leave of others, (r, k)."""
    return np.asarray(columns - q @ (q.T @ columns))
