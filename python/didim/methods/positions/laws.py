"""Search with unknowns held that the log does not identify, and with friction as a smooth sign or as MuJoCo has it.

Tested in ``tests/test_positions.py`` and ``tests/test_in_mujoco.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...experiment.experiment import Experiment
from ...result.finding import Finding, said
from ...result.status import Status
from ...signal.noise import encoder_noise
from .knowledge import Held, unidentified
from .problem import Problem, build
from .search import Search, begun, bounded_step, normal_of, search
from .stops import STRONGEST, Stop, pushed_stretches

if TYPE_CHECKING:
    from ..cloe.settings import CLOESettings

SOFTER = 0.98
"""Squared errors over those of a smooth sign, below which MuJoCo's friction is tried: a smaller gain does not justify a search."""
MOST_ROUNDS = 6
"""Largest number of searches without pushes: each shows weaker ones."""
ROUGH = 1e-2
"""Fall of the cost, as a share, at which the laws of friction are compared: an estimate is then within a deviation or so."""
OTHER_SOFTNESS = ((1.0, 0.4), (0.4, 1.0), (1.0, 0.65), (0.65, 1.0), (1.0, 1.4), (1.0, 2.0), (2.0, 1.0))
"""Factors of slope and rate of MuJoCo's friction that are tried where its defaults leave errors of the model."""
PROMISED = 0.65
"""Share of the squared errors, promised by another softness, below which the default one is contradicted. Simulated legs whose
friction has 0.6 to 2.5 times the default time constant have 0.01 to 0.4, with armatures changed without mj_setConst up to 0.62."""


def searched(
    problem: Problem, now: Search, held: list[Held], options: dict[str, Any]
) -> tuple[Search, list[Held]]:
    """Search; hold unknowns that the log turns out not to identify at their starts, and search again."""
    now.free[[item.column for item in held]] = False
    now = search(problem, now, **options)
    while now.status.converged:
        more = unidentified(problem, now)
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
    pushed = [item for item in problem.stops if item.pushed]
    rival = _built(experiment, method, soft=True, pushed=pushed)
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
        found, held_there = searched(rival, start, unidentified(rival, start, strict=True), options)
        problem.n_simulations = rival.n_simulations
        shift = np.where(found.free & now.free, found.theta - now.theta, 0.0)
        if found.cost < now.cost:
            return rival, found, held_there, shift
    return problem, *searched(problem, now, held, options), shift


def other_softness(problem: Problem, now: Search) -> tuple[Finding, ...]:
    """Return the finding that friction is soft as MuJoCo has it, but not by its defaults, from what other values promise to leave.

    Armatures and friction are then false without a sign in their intervals: all blocks share the error.
    """
    for slope, rate in OTHER_SOFTNESS if problem.inertia else ():
        rival = replace(problem, softness=(slope * problem.softness[0], rate * problem.softness[1]))
        try:
            start = begun(rival, now.theta, now.free.copy(), now)
        except FitError:
            continue
        problem.n_simulations = rival.n_simulations
        a, b = normal_of(rival, start.errors, start.blocks)
        step = bounded_step(rival, start, a, b, 0.0, sum(e.size for e in start.errors))
        share = (start.cost + float(2.0 * b @ step + step @ a @ step)) / now.cost
        if share < PROMISED:
            word = "softer" if slope * rate < 1.0 else "harder"
            return (
                said(
                    kind="softness",
                    sentence=f"friction is {word} than by MuJoCo's defaults, which are simulated: with {slope:g} times the slope "
                    f"and {rate:g} times the rate at most {100.0 * max(share, 0.0) ** 0.5:.0f} % of the errors would be left",
                    advice="Where a simulation made the log, leave solreffriction and solimpfriction at their defaults, and change "
                    "armatures before the file is compiled, or call mj_setConst",
                    value=share,
                ),
            )
    return ()


def without_pushes(
    experiment: Experiment, method: CLOESettings, problem: Problem, now: Search, options: dict[str, Any]
) -> tuple[Problem, Search]:
    """Search again without the stretches in which errors show that something pushes a joint, until there are no more."""
    for _ in range(MOST_ROUNDS):
        more = _pushed(problem, now.errors, STRONGEST) if now.status.converged else []
        before, pushed = problem, [*(item for item in problem.stops if item.pushed), *more]
        if more:
            problem, now = _without(experiment, method, problem, now, pushed, options)
        if problem is before:
            break
    return problem, now


def with_explained_stretches(
    experiment: Experiment, method: CLOESettings, problem: Problem, now: Search, options: dict[str, Any]
) -> tuple[Problem, Search]:
    """Search again with the stretches that the estimate explains after all.

    A push that is still fitted causes errors in other stretches too, which were left out for them.
    """
    pushed = [item for item in problem.stops if item.pushed]
    if not pushed or not now.status.converged:
        return problem, now
    whole = _built(experiment, method, soft=bool(problem.inertia))
    seen = _pushed(whole, whole.errors(now.theta), 0.0)
    problem.n_simulations += whole.n_simulations
    unexplained = [item for item in pushed if any(item.meets(other) for other in seen)]
    if len(unexplained) == len(pushed):
        return problem, now
    return _without(experiment, method, problem, now, unexplained, options)


def _without(
    experiment: Experiment,
    method: CLOESettings,
    problem: Problem,
    now: Search,
    pushed: Sequence[Stop],
    options: dict[str, Any],
) -> tuple[Problem, Search]:
    """Search again without stretches; the same problem and search if too little would be left."""
    try:
        rest = _built(experiment, method, soft=bool(problem.inertia), pushed=pushed)
    except FitError:
        return problem, now
    rest.n_simulations = problem.n_simulations
    options["reporter"].say(f"stretches left out because something pushes a joint: {len(pushed)}")
    return rest, search(rest, begun(rest, now.theta, now.free, now), **options)


def _built(
    experiment: Experiment, method: CLOESettings, *, soft: bool, pushed: Sequence[Stop] = ()
) -> Problem:
    """Return the problem of an experiment with the settings of a method."""
    return build(
        experiment, noise=method.noise, threads=method.threads, start=method.start, soft=soft, pushed=pushed
    )


def _pushed(problem: Problem, errors: Sequence[Array], strongest: float) -> list[Stop]:
    """Return the stretches in which errors of the rollouts show that something pushes a joint."""
    found = []
    for limb, part in enumerate(problem.limbs):
        at = [k for k, item in enumerate(problem.rollouts) if item.limb == limb and item.role == "fit"]
        items = [problem.rollouts[k] for k in at]
        for place, joint in enumerate(part.joints):
            own = [errors[k].reshape(-1, len(part.joints))[:, place] for k in at]
            ahead = [(item.loop.held.values - item.q)[item.first :, place] for item in items]
            noise = [float(encoder_noise(item.q[:, place : place + 1])[0]) for item in items]
            stretches = pushed_stretches(own, ahead, noise, [item.rate_hz for item in items], strongest)
            for item, pairs in zip(items, stretches, strict=True):
                begin = item.begin + item.first
                found += [Stop(joint, item.recording, begin + a, begin + b, None, True) for a, b in pairs]
    return found
