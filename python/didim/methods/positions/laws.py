"""Search with unknowns held that the log does not identify, and with friction as a smooth sign or as MuJoCo has it.

Tested in ``tests/test_positions.py`` and ``tests/test_in_mujoco.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..._tools.arrays import Array
from ...errors import FitError
from ...experiment.unknown import ACCELERATION, RANGES, SOFT, Shared, Unknown
from ...result.iteration import Status
from ...signal.noise import encoder_noise
from .intervals import LASTING, errors_over_noise
from .knowledge import unidentified
from .problem import Problem, may_be_soft
from .search import Search, begun, bounded_step, promised, search
from .stops import STRONGEST, Stop, pushed_stretches

SOFTER = 0.98
"""Squared errors over those of a smooth sign, below which MuJoCo's friction is tried: a smaller gain does not justify a search."""
MOST_ROUNDS = 6
"""Largest number of searches without pushes: each shows weaker ones."""
ROUGH = 1e-2
"""Fall of the cost, as a share, at which the laws of friction are compared: an estimate is then within a deviation or so."""
STUCK = 0.9
"""Squared errors over those of the other laws, below which friction that sticks is taken: a push makes it seem a little better, and
on a real hobby arm, which chose it, it leaves 0.77."""
HIGHER = 1.1
"""Squared errors with an unidentified unknown at its start, over those with it free, up to which the start explains a log as well:
1.02 for the true gains of the Go2 log, which chose it."""
OF_FRICTION = 0.5
"""Share of the squared errors of a stretch that other friction of its joint must explain, so that they are none of a push."""
HARD = dict(zip(SOFT, (5e-5, 2.5e-3), strict=True))
"""Creep and rest (s) from which those of friction that a smooth sign fits better are searched: a quarter or less of MuJoCo's."""
STILL = 1e-3
"""Smallest velocity (rad/s or m/s) of a smooth sign that is compared: a harder one needs shorter steps."""
LEAST_M = 1e-6
"""Noise (rad or m) that a log has at least where another softness of friction is looked for: the rounding of logs as text."""
SHARED: tuple[Shared, Shared] = ("joint", "robot")
"""Joints that share a creep and a rest: the first depends on the armature with which MuJoCo compiled a file."""
ACCELERATIONS = tuple(10.0 * 2.0**k for k in range(5))
"""Largest accelerations of set-points (rad/s^2) from which one is searched: that of a bus servo is 39, and a loop follows what is
faster than the last."""
STRETCHES = 12
"""Number of stretches of a rollout, of which one is left out."""
PROMISED = 0.65
"""Share of the squared errors, promised by another softness of friction, above which it is not searched. Simulated legs whose
friction has 0.6 to 2.5 times the default time constant have 0.01 to 0.4, with armatures changed without mj_setConst up to 0.62. A
limited acceleration of set-points is held to it too: the real arm that chose that trial leaves 0.24."""


def searched(now: Search, options: dict[str, Any]) -> Search:
    """Search; hold unknowns that the log turns out not to identify, and search again.

    They are held at their starts, or where they are if that leaves larger errors. Those of drives come first, because with a false
    gain the others may have no effect.
    """
    now = search(now, **options)
    while now.status.converged and (more := unidentified(now)):
        more = {k: known for k, known in more.items() if now.problem.columns[k].of_drive} or more
        try:
            rest = begun(now.problem, _at_starts(now, list(more)), now, kept=True)
        except FitError:
            rest = None
        if rest is not None:
            rest.held |= more
            rest = search(rest, **options)
        if rest is None or not rest.cost <= HIGHER * now.cost:
            now.held |= more
            if rest is not None:
                now.history = rest.history
                if rest.status is Status.STOPPED:
                    return replace(now, status=rest.status)
            rest = search(now, **options)
        now = rest
    return now


def _at_starts(now: Search, held: list[int]) -> Array:
    """Return the unknowns with some at their starts; torques of the joints of a gain that returns there keep their ratios to it."""
    columns, theta, start = now.problem.columns, now.theta.copy(), now.problem.start
    theta[held] = start[held]
    for k in held:
        if columns[k].kind == "kp" and now.theta[k] > 0.0:
            at = [
                j
                for j, column in enumerate(columns)
                if column.scales and j not in held and {*column.joints} <= {*columns[k].joints}
            ]
            theta[at] *= start[k] / now.theta[k]
    return np.clip(theta, *now.problem.bounds)


def search_of_either_friction(now: Search, options: dict[str, Any]) -> tuple[Search, Array]:
    """Search with friction as MuJoCo has it, where errors and derivatives promise less than a smooth sign leaves.

    Also return how far the estimate with the other law of friction is from the one that is taken, (n_columns,).
    """
    now = search(now, **{**options, "tolerance": ROUGH})
    shift = np.zeros(len(now.theta))
    if now.status is Status.STOPPED:
        return now, shift
    if (promise := _promised(replace(now.problem, soft=True, sticks=False), now, {})) is not None:
        start, shift, cost = promise
        if cost < SOFTER * now.cost:
            options["reporter"].say(
                "friction as MuJoCo has it promises smaller errors; the search goes on with it"
            )
            rival = _searched_anew(start, options)
            shift = np.where(rival.free & now.free, rival.theta - now.theta, 0.0)
            if rival.cost < now.cost:
                return _sticking(*_of_another_softness(rival, shift, options), options)
    return _sticking(*_of_another_softness(searched(now, options), shift, options), options)


def _sticking(now: Search, shift: Array, options: dict[str, Any]) -> tuple[Search, Array]:
    """Search with friction that sticks, where errors and derivatives promise less than the other laws leave.

    Joints of a smooth sign, and of MuJoCo's friction, creep at rest; those of geared servos stay where they are. Near a smooth sign
    are minima of friction that sticks, and rounding decides in which a search ends: where errors remain, it is searched from
    MuJoCo's friction too, and the lower cost is taken.
    """
    problem = now.problem
    if not now.status.converged or {*SOFT} & {*problem.experiment.unknown} or not _unexplained(now):
        return now, shift
    start = _promised(replace(problem, soft=False, sticks=True), now, {})
    if start is None or not start[2] < STUCK * now.cost:
        return now, shift
    options["reporter"].say("friction that sticks promises smaller errors; the search goes on with it")
    roughly = {**options, "tolerance": ROUGH}  # `without_pushes` goes on with it
    rival = _searched_anew(start[0], roughly)
    if (
        rival.status.converged
        and _unexplained(rival)
        and not problem.soft
        and may_be_soft(problem.experiment)
    ):
        other = now
        try:
            for law in (replace(problem, soft=True, sticks=False), start[0].problem):
                other = _searched_anew(begun(law, other.theta, other), roughly)
                if other.status is Status.STOPPED:
                    break
        except FitError:
            other = rival
        if other.problem.sticks and other.cost < rival.cost:
            rival = other
        elif other.status is Status.STOPPED:
            rival = replace(rival, status=other.status)
    if not rival.cost < STUCK * now.cost:
        return now, shift
    return rival, np.where(rival.free & now.free, rival.theta - now.theta, 0.0)


def of_planned_set_points(now: Search, options: dict[str, Any]) -> Search:
    """Search with a largest acceleration of the set-points, where errors and derivatives promise much smaller errors with it.

    A servo that plans the way to each command within an acceleration is late where commands need more, by more than its delay. The
    limit is kept if the errors are as much smaller without the stretch that gains most too.
    """
    problem, experiment = now.problem, now.problem.experiment
    asked = {ACCELERATION, "lag_s"} & {*experiment.unknown} or problem.values.drive["lag_s"].any()
    turning = all(kind == "revolute" for kind in problem.robot.joint_kinds)
    if asked or not turning or not now.status.converged or not _unexplained(now):
        return now
    low, high = RANGES[ACCELERATION]
    own = {ACCELERATION: Unknown(start=ACCELERATIONS[2], low=low, high=high, shared="robot")}
    rival = replace(problem, experiment=replace(experiment, unknown={**experiment.unknown, **own}))
    tried = [_promised(rival, now, {ACCELERATION: value}) for value in ACCELERATIONS]
    best = min((found for found in tried if found is not None), key=lambda found: found[2], default=None)
    if best is None or not best[2] < PROMISED * now.cost:
        return now
    options["reporter"].say(
        "a limited acceleration of set-points promises smaller errors; the search goes on with it"
    )
    # `without_pushes` goes on with friction that sticks.
    found = _searched_anew(best[0], {**options, "tolerance": ROUGH} if problem.sticks else options)
    squares = np.array(
        [[part @ part for e in one.errors for part in np.array_split(e, STRETCHES)] for one in (now, found)]
    )
    lasting = np.delete(squares, np.argmax(squares[0] - squares[1]), axis=1).sum(axis=1)
    if found.free[-1] and lasting[1] < PROMISED * lasting[0]:
        return found
    return replace(now, status=found.status) if found.status is Status.STOPPED else now


def _of_another_softness(now: Search, shift: Array, options: dict[str, Any]) -> tuple[Search, Array]:
    """Search with the softness of friction unknown, where errors exceed the noise and another one promises much smaller ones.

    Friction is then softer or harder than by the file, or its armatures were changed after MuJoCo had computed the softness: with
    the wrong one armatures and friction are false, and no block of the log shows it.
    """
    if not now.status.converged or not _unexplained(now):
        return now, shift
    problem = now.problem
    experiment = problem.experiment
    own = {
        kind: Unknown(low=RANGES[kind][0], high=RANGES[kind][1], shared=shared)
        for kind, shared in zip(SOFT, SHARED, strict=True)
        if kind not in experiment.unknown
    }
    experiment = replace(experiment, unknown={**experiment.unknown, **own})
    unknown = replace(problem, soft=True, sticks=False, experiment=experiment)
    promise = _promised(unknown, now, {} if problem.soft else HARD)
    if promise is None:
        return now, shift
    start, step, cost = promise
    if cost < PROMISED * now.cost:
        options["reporter"].say(
            "another softness of friction promises smaller errors; the search goes on with it"
        )
        rival = _searched_anew(start, options)
        if rival.cost < PROMISED * now.cost:
            return rival, _as_smooth_sign(rival)
    return now, np.where(np.abs(step) > np.abs(shift), step, shift)


def _unexplained(now: Search) -> bool:
    return bool(errors_over_noise(now, LEAST_M).max() > LASTING)


def _as_smooth_sign(now: Search) -> Array:
    """Return the step of the unknowns to friction as a smooth sign of the same slope at velocity zero, (n_columns,).

    Zero where MuJoCo's friction explains the log.
    """
    problem, nothing = now.problem, np.zeros(len(now.theta))
    if not _unexplained(now):
        return nothing
    robot = problem.robot.with_smoothing(np.maximum(problem.creeping(now.theta), STILL).tolist())
    simulation = replace(problem.experiment.simulation, smoothing=None)
    smooth = replace(problem.experiment, robot=robot, simulation=simulation)
    try:
        start = begun(replace(problem, soft=False, experiment=smooth), now.theta, now)
    except FitError:
        return nothing
    return bounded_step(start, *start.normal())


def _searched_anew(start: Search, options: dict[str, Any]) -> Search:
    """Search with all unknowns from a point that was only screened; it stays there if it cannot be simulated step by step."""
    start.problem.every_jump = True
    try:
        now = begun(start.problem, start.theta, start, kept=True)
    except FitError:
        return start
    now.held = {}
    now.held = unidentified(now, strict=True)
    return searched(now, options)


def _promised(rival: Problem, now: Search, others: Mapping[str, float]) -> tuple[Search, Array, float] | None:
    """Return a search of another law from an estimate, the step of the unknowns of both, and the cost that it promises.

    `others` are starts of the kinds that only the other law has. None if it cannot be simulated there.
    """
    count = len(now.theta)
    theta = np.append(now.theta, rival.start[count:])
    for k, column in enumerate(rival.columns[count:], count):
        theta[k] = others.get(column.kind, theta[k])
    try:
        start = begun(rival, theta, now, screening=True)
    except FitError:
        return None
    a, b = start.normal()
    step = bounded_step(start, a, b)
    return start, step[:count], start.cost + promised(a, b, step)


def without_pushes(now: Search, options: dict[str, Any]) -> Search:
    """Search again without the stretches in which errors show that something pushes a joint, until there are no more."""
    exact, roughly = not now.problem.sticks, {**options, "tolerance": ROUGH, "exact": False}
    for _ in range(MOST_ROUNDS):
        if now.status is Status.STOPPED:
            return now
        more = _pushed(now.problem, now.errors, STRONGEST) if now.status.converged else []
        more = [stop for stop in more if not _of_friction(now, stop)]
        rest = _without(now, [*now.problem.pushed, *more], roughly) if more else now
        if rest is not now:
            now, exact = rest, False
        elif exact:
            return now
        else:  # weaker pushes show at the estimate itself
            now, exact = search(now, **options), True
    return now if exact or now.status is Status.STOPPED else search(now, **options)


def _of_friction(now: Search, stop: Stop) -> bool:
    """Whether other friction of the joint explains most of the errors of a stretch, and a constant torque explains less."""
    names = [column.name for column in now.problem.columns]
    explained = []
    for kinds in (("Fv", "Fc"), ("Off",)):
        squares = np.zeros(2)
        for rollout, errors, blocks in zip(now.problem.rollouts, now.errors, now.blocks, strict=True):
            begin = rollout.window.begin + rollout.first
            rows = slice(max(stop.begin - begin, 0), max(stop.end - begin, 0))
            if rollout.recording != stop.recording or stop.joint not in rollout.joints:
                continue
            count, index = len(rollout.joints), rollout.joints.index(stop.joint)
            e = errors.reshape(-1, count)[rows, index]
            own = now.problem.own(rollout).tolist()
            asked = [names.index(name) for kind in kinds if (name := f"{kind}{stop.joint + 1}") in names]
            left = e
            if e.size and asked:
                j = blocks[:, [own.index(k) for k in asked]].reshape(-1, count, len(asked))[rows, index]
                left = e - j @ np.linalg.lstsq(j, e)[0]
            squares += e @ e, left @ left
        explained.append(1.0 - squares[1] / max(squares[0], np.finfo(float).tiny))
    return bool(explained[0] > max(explained[1], OF_FRICTION))


def with_explained_stretches(now: Search, options: dict[str, Any]) -> Search:
    """Search again with the stretches that the estimate explains after all.

    A push that is still fitted causes errors in other stretches too, which were left out for them.
    """
    pushed = now.problem.pushed
    if not pushed or not now.status.converged:
        return now
    whole = replace(now.problem, pushed=())
    seen = _pushed(whole, whole.errors(now.theta), 0.0)
    unexplained = [stop for stop in pushed if any(stop.meets(other) for other in seen)]
    return now if len(unexplained) == len(pushed) else _without(now, unexplained, options)


def _without(now: Search, pushed: Sequence[Stop], options: dict[str, Any]) -> Search:
    """Search again without stretches; the same search if too little would be left, or cannot be simulated."""
    try:
        rest = begun(replace(now.problem, pushed=pushed), now.theta, now, kept=True)
    except FitError:
        return now
    options["reporter"].say(f"stretches left out because something pushes a joint: {len(pushed)}")
    return search(rest, **options)


def _pushed(problem: Problem, errors: Sequence[Array], strongest: float) -> list[Stop]:
    """Return the stretches in which errors of the rollouts show that something pushes a joint."""
    stops = []
    for limb in problem.limbs:
        own = [
            (rollout, rows.reshape(-1, len(limb.joints)))
            for rollout, rows in zip(problem.rollouts, errors, strict=True)
            if rollout.limb is limb
        ]
        rollouts = [rollout for rollout, _ in own]
        for index, joint in enumerate(limb.joints):
            stretches = pushed_stretches(
                [rows[:, index] for _, rows in own],
                [(item.loop.held.values - item.q)[item.first :, index] for item in rollouts],
                [float(encoder_noise(item.q[:, index : index + 1])[0]) for item in rollouts],
                [item.rate_hz for item in rollouts],
                strongest,
            )
            for rollout, pairs in zip(rollouts, stretches, strict=True):
                begin = rollout.window.begin + rollout.first
                stops += [Stop(joint, rollout.recording, begin + a, begin + b, None, True) for a, b in pairs]
    return stops
