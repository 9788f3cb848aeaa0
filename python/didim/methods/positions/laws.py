"""Search with what the log does not identify held, and with friction as a smooth sign or as MuJoCo has it.

Tested in ``tests/test_positions.py`` and ``tests/test_in_mujoco.py``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...experiment.experiment import Experiment
from ...result.status import Status
from .knowledge import Held, untold
from .problem import Problem, build
from .search import Search, begun, bounded_step, normal_of, search

if TYPE_CHECKING:
    from ..cloe.settings import CLOESettings

SOFTER = 0.98
"""Squared errors over those of a smooth sign, below which MuJoCo's friction is tried: less is no reason for another simulation."""
ROUGH = 1e-2
"""Fall of the cost, as a share, at which the laws of friction are compared: an estimate is then within a deviation or so."""


def searched(
    problem: Problem, now: Search, held: list[Held], options: dict[str, Any]
) -> tuple[Search, list[Held]]:
    """Search; hold what the log turns out not to tell, at its start, and search on."""
    now.free[[item.column for item in held]] = False
    now = search(problem, now, **options)
    while now.status.converged:
        more = untold(problem, now)
        if not more:
            break
        held = [*held, *more]
        theta, free = now.theta.copy(), now.free.copy()
        for item in more:
            free[item.column] = False
            theta[item.column] = problem.columns[item.column].start
        now = search(problem, begun(problem, theta, free, now), **options)
    return now, held


def search_of_either_friction(
    experiment: Experiment,
    method: CLOESettings,
    problem: Problem,
    now: Search,
    held: list[Held],
    options: dict[str, Any],
) -> tuple[Problem, Search, list[Held], Array]:
    """Search with friction as MuJoCo has it, where errors and derivatives promise less than a smooth sign leaves.

    Also return how far the estimate with the other law of friction is from the one that is taken, (n_columns,).
    """
    now.free[[item.column for item in held]] = False
    now = search(problem, now, **{**options, "tolerance": ROUGH})
    shift = np.zeros(len(now.theta))
    if now.status is Status.STOPPED:
        return problem, now, held, shift
    rival = build(experiment, noise=method.noise, threads=method.threads, start=method.start, soft=True)
    rival.n_simulations = problem.n_simulations
    try:
        start = begun(rival, now.theta, now.free.copy(), now)
    except FitError:
        return problem, *searched(problem, now, held, options), shift
    problem.n_simulations = rival.n_simulations
    a, b = normal_of(rival, start.errors, start.blocks)
    shift = bounded_step(rival, start, a, b, 0.0, sum(e.size for e in start.errors))
    if start.cost + float(2.0 * b @ shift + shift @ a @ shift) < SOFTER * now.cost:
        options["reporter"].say(
            "friction as MuJoCo has it promises smaller errors; the search goes on with it"
        )
        start.free[:] = True
        found, held_there = searched(rival, start, untold(rival, start, strict=True), options)
        problem.n_simulations = rival.n_simulations
        shift = np.where(found.free & now.free, found.theta - now.theta, 0.0)
        if found.cost < now.cost:
            return rival, found, held_there, shift
    return problem, *searched(problem, now, held, options), shift
