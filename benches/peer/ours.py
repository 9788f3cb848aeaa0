"""Ours: batches of the models and the closed loop, of the TX40 with friction, rotors and coupled wrist."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import didim
from didim.loop.closed_loop import ClosedLoop

from .task import SAMPLES, STEPS, Task
from .timing import Contestant, per_unit

Array = NDArray[np.float64]

CACHED = 64
"""Samples of a regressor that stays in the second-level cache: 264 kB."""
LANES = 4
MANY = 16
"""Candidates of a batch."""
WHOLE_STEPS, WHOLE_MANY = 4000, 64
"""Steps and candidates of a batch as CLOE has them: the motion of a log, and a direction for each parameter."""


def contestants(task: Task, rounds: int) -> list[Contestant]:
    """Everything of ours that takes microseconds."""
    robot, x = task.robot, task.x
    q, dq, ddq, tau = task.q, task.dq, task.ddq, task.tau
    few = [np.ascontiguousarray(values[:CACHED]) for values in (q, dq, ddq)]
    # Memory that is used again, as a loop over a log would.
    memory, all_memory = didim.regressor(robot, *few), didim.regressor(robot, q, dq, ddq)
    runs: dict[str, tuple[Callable[[], object], int]] = {
        "direct_dynamics": (lambda: didim.direct_dynamics(robot, q, dq, tau, x), SAMPLES),
        "inverse_dynamics": (lambda: didim.inverse_dynamics(robot, q, dq, ddq, x), SAMPLES),
        f"regressor, {CACHED} samples a call": (
            lambda: _repeat(lambda: didim.regressor(robot, few[0], few[1], few[2], out=memory)),
            SAMPLES,
        ),
        f"regressor, {SAMPLES} samples a call": (
            lambda: didim.regressor(robot, q, dq, ddq, out=all_memory),
            SAMPLES,
        ),
        "inertia_matrix": (lambda: didim.inertia_matrix(robot, q, x), SAMPLES),
    }
    for candidates, threads in ((1, 1), (LANES, 1), (MANY, 1), (MANY, 2)):
        name = f"RK4 step and candidate, {_count(candidates, 'candidate')}, {_count(threads, 'thread')}"
        runs[name] = (_costs(task, task.loop, candidates, threads), STEPS * candidates)
    whole = task.longer(WHOLE_STEPS)
    for threads in (1, 2):
        name = f"RK4 step and candidate, {WHOLE_MANY} candidates of {WHOLE_STEPS} steps, {_count(threads, 'thread')}"
        runs[name] = (_costs(task, whole, WHOLE_MANY, threads), WHOLE_STEPS * WHOLE_MANY)
    return [
        Contestant(name=name, measure=per_unit(run, units), unit="us", rounds=rounds)
        for name, (run, units) in runs.items()
    ]


def _repeat(run: Callable[[], object]) -> None:
    for _ in range(SAMPLES // CACHED):
        run()


def _costs(task: Task, loop: ClosedLoop, candidates: int, threads: int) -> Callable[[], None]:
    """Return simulations of the closed loop that leave a cost each."""
    xs, one = np.tile(task.x, (candidates, 1)), np.ones(6)
    target = loop.reference.at(loop.t)[0]
    torque = np.zeros_like(target)

    def run() -> None:
        found, _ = loop.costs(xs, target, torque, weight_q=one, weight_tau=one, threads=threads)
        if not np.isfinite(found).all():
            raise SystemExit("the closed loop did not run to its end")

    return run


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
