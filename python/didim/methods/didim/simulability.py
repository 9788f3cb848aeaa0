"""Rates of a simulated robot, the resulting time steps, and the conditions (B) that a log allows.

    lambda_max( M(q)^-1 diag(Fv + kv + Fc/v) ) <= max_j (Fv_j + kv_j + Fc_j/v_j) / Ia_j <= c/h     for every q      (C)

Tested in ``tests/test_consistent.py``.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...experiment.specs import SimulationSettings
from ...loop.closed_loop import FINE_STEP, STEP
from ...loop.controller import Controller
from ...model.drive_cones import Drives, Terms
from ...model.dynamics import inertia_matrix
from ...regression.consistent.problem import Simulability
from ...regression.consistent.solver import ConsistentSolver
from ...regression.fit import Fit
from ...regression.settings import LeastSquaresSettings
from ...robot.robot import Robot
from ...terms.rows import LinearSystem

RATE = 1.5
"""Largest product of the fastest rate and the time step; fourth-order Runge-Kutta is stable up to 2.78."""
LEAST_STEP = 2e-6
"""Smallest time step (s) that rates may require."""
COST = 5e-3
"""Largest increase of the weighted squares by the conditions (B), as a share; a stiffer robot needs smaller steps instead."""
HALVINGS = 4
"""Largest number of times the step of (B) is halved before the conditions are dropped."""


def damping_of(controller: Controller) -> Array:
    """Return the damping gain of a continuous controller per joint, joint side (N.m.s/rad or N.s/m); zeros for a digital one."""
    if controller.digital is not None:
        return np.zeros(controller.n_dof)
    return np.abs(controller.laws[:, 1] * controller.gain)


def simulable(
    free: ConsistentSolver, fit: Fit, system: LinearSystem, settings: LeastSquaresSettings, damping: Array
) -> tuple[ConsistentSolver, Fit, float | None]:
    """Return the solver with the conditions (B) of the largest admissible step, its solution and that step (s).

    Parameters
    ----------
    free, fit : ConsistentSolver and Fit
        Solver without the conditions, whose robot has smooth friction, and its solution.
    system : LinearSystem
        Rows along the measured motion.
    settings : LeastSquaresSettings
        Weights.
    damping : (n_dof,) array
        See `damping_of`.
    """
    smoothing = free.model.own.friction.smoothing
    if free.model.own.friction.coulomb != "tanh" or not all(smoothing):
        return free, fit, None
    cost = float(np.sum((fit.residual * fit.weights) ** 2))
    step = FINE_STEP
    for _ in range(HALVINGS):
        wanted = Simulability(step, RATE, tuple(damping.tolist()), tuple(smoothing))
        bound = replace(free, problem=free.on(system, wanted))
        try:
            other = bound(system, settings)
        except FitError:  # fixed or dropped rotors contradict (B)
            return free, fit, None
        if float(np.sum((other.residual * fit.weights) ** 2)) <= (1.0 + COST) * cost:
            return bound, other, step
        step *= 0.5
    return free, fit, None


def rates(robot: Robot, x: Array, q: Array, damping: Array) -> tuple[float, Array]:
    """Return the largest rate (1/s) without Coulomb friction, and that of each joint with it, at positions (n, n_dof)."""
    drives, v = Drives(robot), robot.friction.smoothing
    # M = L L^T: the rates of D are the eigenvalues of L^-1 D L^-T.
    roots = np.linalg.inv(np.linalg.cholesky(inertia_matrix(robot, q, x)))
    n = robot.n_dof
    smooth = np.diag(damping)
    for group in drives.groups:
        choices = (_sum(drives, x, drives.viscous(group, sides)) for sides in drives.choices(group))
        # The direction with more viscous friction.
        smooth[np.ix_(group, group)] += max(choices, key=np.trace)

    def rate(matrix: Array) -> float:
        return float(np.linalg.eigvalsh(roots @ matrix @ roots.transpose(0, 2, 1))[:, -1].max())

    slow, fast = rate(smooth), np.zeros(n)
    if robot.friction.coulomb != "tanh" or not all(v):
        return slow, np.full(n, slow)
    for group in drives.groups:
        motors = drives.motors(group)
        corners = itertools.product(
            drives.choices(group),
            itertools.product((1.0, 0.0) if motors else (1.0,), repeat=len(group)),
            itertools.product((1.0, 0.0), repeat=len(motors)),
        )
        largest = 0.0
        for sides, joints, shafts in corners:
            steep = smooth.copy()
            steep[np.ix_(group, group)] += _sum(drives, x, drives.slopes(group, sides, joints, shafts, v))
            largest = max(largest, rate(steep))
        fast[list(group)] = largest
    return slow, fast


def largest_rates(robot: Robot, each: Array, q: Array, damping: Array) -> tuple[float, Array]:
    """Return the largest of the `rates` of several robots, standard parameters (m, p), one per recording."""
    all_rates = [rates(robot, x, q, damping) for x in each]
    return max(slow for slow, _ in all_rates), np.asarray(np.max([fast for _, fast in all_rates], axis=0))


def _sum(drives: Drives, x: Array, terms: Terms) -> Array:
    return np.asarray(np.sum([x[drives.places[name]] * term for name, term in terms.items()], axis=0))


def chosen_steps(slow: float, fast: Array, settings: SimulationSettings) -> tuple[float, tuple[float, ...]]:
    """Return the steps (s) for rates: coarse, and fine per joint, at most those of the experiment.

    They are rounded down to quarter octaves, so similar iterates share a schedule.
    """

    def below(cap: float, rate: float) -> float:
        step = max(min(cap, RATE / rate if rate > 0.0 else cap), LEAST_STEP)
        return float(step if step == cap else 2.0 ** (np.floor(4.0 * np.log2(step)) / 4.0))

    coarse = below(STEP if settings.step_s is None else settings.step_s, slow)
    # Coulomb friction does not require a step; viscous friction does not either, but `slow` has it with all else that is smooth.
    if settings.integrator == "imex":
        fast = np.full(fast.shape, slow)
    default = coarse if settings.integrator == "imex" else FINE_STEP
    fine = default if settings.fine_step_s is None else settings.fine_step_s
    caps = np.broadcast_to(np.asarray(fine, dtype=np.float64), fast.shape)
    return coarse, tuple(below(min(float(cap), coarse), rate) for cap, rate in zip(caps, fast, strict=True))
