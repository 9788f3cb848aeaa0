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
from ...experiment.unknown import RANGES, SOFT, Shared, Unknown
from ...result.status import Status
from ...signal.noise import encoder_noise
from .intervals import LASTING, errors_over_noise
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
HARD = 5e-5, 2.5e-3
"""Creep and rest (s) from which those of friction that a smooth sign fits better are searched: a quarter or less of MuJoCo's."""
STILL = 1e-3
"""Smallest velocity (rad/s or m/s) of a smooth sign that is compared: a harder one needs shorter steps."""
LEAST_M = 1e-6
"""Noise (rad or m) that a log has at least where another softness of friction is looked for: the rounding of logs as text."""
SHARED: tuple[Shared, Shared] = ("joint", "robot")
"""Joints that share a creep and a rest: the first depends on the armature with which MuJoCo compiled a file."""
PROMISED = 0.65
"""Share of the squared errors, promised by another softness of friction, above which it is not searched. Simulated legs whose
friction has 0.6 to 2.5 times the default time constant have 0.01 to 0.4, with armatures changed without mj_setConst up to 0.62."""


def searched(
    problem: Problem, now: Search, held: list[Held], options: dict[str, Any]
) -> tuple[Search, list[Held]]:
    """Search; hold unknowns that the log turns out not to identify at their starts, and search again."""
    now.free[[each.column for each in held]] = False
    now = search(problem, now, **options)
    while now.status.converged:
        more = unidentified(problem, now)
        if not more:
            break
        held = [*held, *more]
        theta, free = now.theta.copy(), now.free.copy()
        for each in more:
            free[each.column] = False
            theta[each.column] = problem.columns[each.column].start
        now = search(problem, begun(problem, theta, free, now), **options)
    return now, held


def search_of_either_friction(
    method: CLOESettings, problem: Problem, now: Search, held: list[Held], options: dict[str, Any]
) -> tuple[Problem, Search, list[Held], Array]:
    """Search with friction as MuJoCo has it, where errors and derivatives promise less than a smooth sign leaves.

    Also return how far the estimate with the other law of friction is from the one that is taken, (n_columns,).
    """
    now.free[[each.column for each in held]] = False
    now = search(problem, now, **{**options, "tolerance": ROUGH})
    shift = np.zeros(len(now.theta))
    if now.status is Status.STOPPED:
        return problem, now, held, shift
    rival = _built(method, problem, soft=True)
    if (promise := _promised(problem, rival, now)) is not None:
        start, shift, cost = promise
        if cost < SOFTER * now.cost:
            options["reporter"].say(
                "friction as MuJoCo has it promises smaller errors; the search goes on with it"
            )
            rival_search, held_there = _searched_anew(rival, start, options)
            problem.n_simulations = rival.n_simulations
            shift = np.where(rival_search.free & now.free, rival_search.theta - now.theta, 0.0)
            if rival_search.cost < now.cost:
                return _of_another_softness(method, rival, rival_search, held_there, shift, options)
    now, held = searched(problem, now, held, options)
    return _of_another_softness(method, problem, now, held, shift, options)


def with_softness(experiment: Experiment) -> Experiment:
    """Return an experiment whose softness of friction is unknown."""
    own = {
        kind: Unknown(low=RANGES[kind][0], high=RANGES[kind][1], shared=shared)
        for kind, shared in zip(SOFT, SHARED, strict=True)
    }
    return replace(experiment, unknown={**own, **experiment.unknown})


def _of_another_softness(
    method: CLOESettings,
    problem: Problem,
    now: Search,
    held: list[Held],
    shift: Array,
    options: dict[str, Any],
) -> tuple[Problem, Search, list[Held], Array]:
    """Search with the softness of friction unknown, where errors exceed the noise and another one promises much smaller ones.

    Friction is then softer or harder than by the file, or its armatures were changed after MuJoCo had computed the softness: with
    the wrong one armatures and friction are false, and no block of the log shows it.
    """
    if not now.status.converged or not _unexplained(problem, now):
        return problem, now, held, shift
    rival = _built(method, problem, soft=True, experiment=with_softness(problem.experiment))
    promise = _promised(problem, rival, now, () if problem.inertia else HARD)
    if promise is None:
        return problem, now, held, shift
    start, step, cost = promise
    if cost < PROMISED * now.cost:
        options["reporter"].say(
            "another softness of friction promises smaller errors; the search goes on with it"
        )
        rival_search, held_there = _searched_anew(rival, start, options)
        problem.n_simulations = rival.n_simulations
        if rival_search.cost < PROMISED * now.cost:
            return rival, rival_search, held_there, _as_smooth_sign(method, rival, rival_search)
    return problem, now, held, np.where(np.abs(step) > np.abs(shift), step, shift)


def _unexplained(problem: Problem, now: Search) -> bool:
    return bool(errors_over_noise(problem, now, LEAST_M).max() > LASTING)


def _as_smooth_sign(method: CLOESettings, problem: Problem, now: Search) -> Array:
    """Return the step of the unknowns to friction as a smooth sign of the same slope at velocity zero, (n_columns,).

    Zero where MuJoCo's friction explains the log.
    """
    nothing = np.zeros(len(now.theta))
    if not _unexplained(problem, now):
        return nothing
    robot = problem.robot.with_smoothing(np.maximum(problem.creeping(now.theta), STILL).tolist())
    smooth = replace(
        problem.experiment, robot=robot, simulation=replace(problem.experiment.simulation, smoothing=None)
    )
    rival = _built(method, problem, soft=False, experiment=smooth)
    rival.n_simulations = problem.n_simulations
    try:
        start = begun(rival, now.theta, now.free, now)
    except FitError:
        return nothing
    problem.n_simulations = rival.n_simulations
    a, b = normal_of(rival, start.errors, start.blocks)
    return bounded_step(rival, start, a, b, 0.0, sum(e.size for e in start.errors))


def _searched_anew(problem: Problem, start: Search, options: dict[str, Any]) -> tuple[Search, list[Held]]:
    """Search with all unknowns from a point that was only screened."""
    problem.every_jump = True
    now = begun(problem, start.theta, np.ones(len(start.theta), dtype=bool), start)
    return searched(problem, now, unidentified(problem, now, strict=True), options)


def _promised(
    problem: Problem, rival: Problem, now: Search, others: Sequence[float] = ()
) -> tuple[Search, Array, float] | None:
    """Return a search of another law from an estimate, the step of the unknowns of both, and the cost that it promises.

    `others` are starts of the kinds that only the other law has. None if it cannot be simulated there.
    """
    count = len(now.theta)
    theta = np.append(now.theta, rival.start[count:])
    for kind, value in zip(SOFT, others, strict=False):
        theta[count:][[column.kind == kind for column in rival.columns[count:]]] = value
    rival.n_simulations = problem.n_simulations
    free = np.append(now.free, np.ones(len(theta) - count, dtype=bool))
    try:
        start = begun(rival, theta, free, now, screening=True)
    except FitError:
        return None
    problem.n_simulations = rival.n_simulations
    a, b = normal_of(rival, start.errors, start.blocks)
    step = bounded_step(rival, start, a, b, 0.0, sum(e.size for e in start.errors))
    return start, step[:count], start.cost + float(2.0 * b @ step + step @ a @ step)


def without_pushes(
    method: CLOESettings, problem: Problem, now: Search, options: dict[str, Any]
) -> tuple[Problem, Search]:
    """Search again without the stretches in which errors show that something pushes a joint, until there are no more."""
    for _ in range(MOST_ROUNDS):
        more = _pushed(problem, now.errors, STRONGEST) if now.status.converged else []
        before, pushed = problem, [*(stop for stop in problem.stops if stop.pushed), *more]
        if more:
            problem, now = _without(method, problem, now, pushed, options)
        if problem is before:
            break
    return problem, now


def with_explained_stretches(
    method: CLOESettings, problem: Problem, now: Search, options: dict[str, Any]
) -> tuple[Problem, Search]:
    """Search again with the stretches that the estimate explains after all.

    A push that is still fitted causes errors in other stretches too, which were left out for them.
    """
    pushed = [stop for stop in problem.stops if stop.pushed]
    if not pushed or not now.status.converged:
        return problem, now
    whole = _built(method, problem, soft=bool(problem.inertia), pushed=())
    seen = _pushed(whole, whole.errors(now.theta), 0.0)
    problem.n_simulations += whole.n_simulations
    unexplained = [stop for stop in pushed if any(stop.meets(other) for other in seen)]
    if len(unexplained) == len(pushed):
        return problem, now
    return _without(method, problem, now, unexplained, options)


def _without(
    method: CLOESettings,
    problem: Problem,
    now: Search,
    pushed: Sequence[Stop],
    options: dict[str, Any],
) -> tuple[Problem, Search]:
    """Search again without stretches; the same problem and search if too little would be left."""
    try:
        rest = _built(method, problem, soft=bool(problem.inertia), pushed=pushed)
    except FitError:
        return problem, now
    rest.n_simulations = problem.n_simulations
    options["reporter"].say(f"stretches left out because something pushes a joint: {len(pushed)}")
    return rest, search(rest, begun(rest, now.theta, now.free, now), **options)


def _built(
    method: CLOESettings,
    problem: Problem,
    *,
    soft: bool,
    pushed: Sequence[Stop] | None = None,
    experiment: Experiment | None = None,
) -> Problem:
    """Return a problem with another law of friction, other stretches that are left out, or other unknowns."""
    if pushed is None:
        pushed = [stop for stop in problem.stops if stop.pushed]
    return build(
        experiment or problem.experiment,
        noise=method.noise,
        threads=method.threads,
        start=method.start,
        soft=soft,
        pushed=pushed,
    )


def _pushed(problem: Problem, errors: Sequence[Array], strongest: float) -> list[Stop]:
    """Return the stretches in which errors of the rollouts show that something pushes a joint."""
    stops = []
    for limb, part in enumerate(problem.limbs):
        at = [
            k for k, rollout in enumerate(problem.rollouts) if rollout.limb == limb and rollout.role == "fit"
        ]
        rollouts = [problem.rollouts[k] for k in at]
        for index, joint in enumerate(part.joints):
            own = [errors[k].reshape(-1, len(part.joints))[:, index] for k in at]
            ahead = [(rollout.loop.held.values - rollout.q)[rollout.first :, index] for rollout in rollouts]
            noise = [float(encoder_noise(rollout.q[:, index : index + 1])[0]) for rollout in rollouts]
            stretches = pushed_stretches(
                own, ahead, noise, [rollout.rate_hz for rollout in rollouts], strongest
            )
            for rollout, pairs in zip(rollouts, stretches, strict=True):
                begin = rollout.begin + rollout.first
                stops += [Stop(joint, rollout.recording, begin + a, begin + b, None, True) for a, b in pairs]
    return stops
