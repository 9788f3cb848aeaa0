"""Pinocchio: recursions of the TX40's links, rotors in `aba` alone. Its regressor and `crba` have no batch.

Those two are called from Python sample by sample, and their times include the calls.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim

from .task import SAMPLES, Task
from .timing import Contestant, MissingError, per_unit

Array = NDArray[np.float64]

FEW = 512
"""Samples of what is called from Python sample by sample."""
CHECKED = 10
"""States where both are compared."""


def versions() -> dict[str, str]:
    """Pinocchio's version."""
    import pinocchio as pin

    return {"pinocchio": pin.__version__}


def contestants(task: Task, rounds: int) -> list[Contestant]:
    """Batches on one thread and on two, and what has no batch, after a check against ours."""
    try:
        import pinocchio as pin
    except ImportError:
        raise MissingError("Pinocchio is not installed (pip install pin).") from None
    model = twin(task)
    _check(pin, task, model)
    data = model.createData()
    columns = [np.asfortranarray(values.T) for values in (task.q, task.dq, task.ddq, task.tau)]
    out = np.zeros((6, SAMPLES), order="F")

    def each(function: Callable[..., object], *arrays: Array) -> Callable[[], None]:
        def run() -> None:
            for row in zip(*(values[:FEW] for values in arrays), strict=True):
                function(model, data, *row)

        return run

    runs: dict[str, tuple[Callable[[], object], int]] = {}
    for threads in (1, 2):
        pool = pin.ModelPool(model, threads)
        words = "1 thread" if threads == 1 else f"{threads} threads"
        runs[f"Pinocchio abaInParallel, {words}"] = (
            partial(pin.abaInParallel, threads, pool, columns[0], columns[1], columns[3], out),
            SAMPLES,
        )
        runs[f"Pinocchio rneaInParallel, {words}"] = (
            partial(pin.rneaInParallel, threads, pool, *columns[:3], out),
            SAMPLES,
        )
    runs["Pinocchio aba, called from Python"] = (each(pin.aba, task.q, task.dq, task.tau), FEW)
    runs["Pinocchio computeJointTorqueRegressor, called from Python"] = (
        each(pin.computeJointTorqueRegressor, task.q, task.dq, task.ddq),
        FEW,
    )
    runs["Pinocchio crba, called from Python"] = (each(pin.crba, task.q), FEW)
    return [
        Contestant(name=name, measure=per_unit(run, units), unit="us", rounds=rounds)
        for name, (run, units) in runs.items()
    ]


def twin(task: Task, *, rotors: bool = True) -> Any:
    """The same robot in Pinocchio."""
    tests = str(Path(__file__).resolve().parent.parent.parent / "tests")
    if tests not in sys.path:
        sys.path.insert(0, tests)
    from twins import pinocchio_model

    model = pinocchio_model(task.plain, task.free)
    if rotors:
        model.armature = task.rotors
    return model


def _check(pin: Any, task: Task, model: Any) -> None:
    from twins import PINOCCHIO_ORDER

    data = model.createData()
    q, dq, ddq = task.q[:CHECKED], task.dq[:CHECKED], task.ddq[:CHECKED]
    tau = np.array([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])
    task.check(
        "Pinocchio", "the inverse dynamics", tau, didim.inverse_dynamics(task.plain, q, dq, ddq, task.free)
    )
    back = np.array([pin.aba(model, data, *row) for row in zip(q, dq, tau, strict=True)])
    task.check(
        "Pinocchio", "the forward dynamics", back, didim.direct_dynamics(task.plain, q, dq, tau, task.free)
    )
    columns = [14 * j + place for j in range(6) for place in PINOCCHIO_ORDER]
    W = np.array([pin.computeJointTorqueRegressor(model, data, *row) for row in zip(q, dq, ddq, strict=True)])
    task.check("Pinocchio", "the regressor", W, didim.regressor(task.plain, q, dq, ddq)[:, :, columns])
    upper = np.triu_indices(6)
    M = np.array([pin.crba(model, data, row)[upper] for row in q])
    task.check("Pinocchio", "M(q)", M, didim.inertia_matrix(task.plain, q, task.free)[:, *upper])
