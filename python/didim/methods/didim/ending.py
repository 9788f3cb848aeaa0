"""The end of a run of DIDIM: its result, and the sentences that a reader must know. Tested in ``tests/test_didim_endings.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...loop.outcome import LARGE_ERROR
from ...model.safe_step import thinned
from ...regression.suspicions import suspicions
from ...result.identification import Identification
from ...result.iteration import Iteration
from ...result.status import Status
from ..builder import fitted
from ..job import Job
from ..verdict.torques import following_reasons, torque_reasons
from .convergence import step_sentence, stuck_sentence
from .loops import Loops
from .settings import DIDIMSettings
from .windows import Point, Solved, motion_record, segments_of

RECORDED = ("tolerance", "sigma_fraction", "max_iterations", "gain_updating", "margin")
"""Settings in the record of a result, beside the start."""


def result_at(
    point: Point,
    solved: Solved,
    loops: Loops,
    *,
    status: Status,
    ending: str,
    history: Sequence[Iteration],
    first_error: float,
    stuck: Mapping[int, str],
    remarks: Sequence[str],
) -> Identification:
    """Put together the result at a point, with the errors of its parameters; without standard deviations unless converged.

    Parameters
    ----------
    point, solved
        Iterate, and the linear system along its motion or the motion before it, solved.
    loops
        Closed loops of the log.
    status, ending, history
        As in `Identification`.
    first_error
        Output error (12) with the initial parameters.
    stuck
        Parameters that a simulated motion did not identify, by iteration.
    remarks
        Sentences on the iteration.
    """
    job, method, system = loops.job, loops.method, solved.system
    beta = job.parameters.project(point.x)
    # Of a shortened step the parameters are not those of the solution: neither are their errors.
    fit = replace(solved.fit, residual=system.y - system.w @ beta[job.selection.estimated])
    if not status.converged:
        # (10) holds at the minimum: of any other point it says nothing.
        fit = replace(fit, covariance=np.zeros_like(fit.covariance))
    # With unknown gains the rows are those of the motors, and the sign of a gain is estimated.
    looked_at = suspicions(system, fit) if not job.parameters.n_gains else []
    found = looked_at if status.converged else loops.suspicions()
    evidence = [
        *torque_reasons(found),
        *following_reasons(point.simulated.error, updating=method.gain_updating != "never"),
    ]
    found = [*found, *loops.remarks, *remarks, *_sentences(point, loops, stuck, suspected=bool(found))]
    result = fitted(
        job,
        method,
        system,
        fit,
        status=status,
        history=history,
        delay=loops.delay,
        q=thinned(np.concatenate([motion[0] for motion in point.simulated.motions]), 2000),
        beta=beta,
        settings={
            **_record(method, job, loops),
            "simulated": motion_record(job, loops.windows, point.simulated),
        },
        remarks=found,
        evidence=evidence,
        n_simulations=loops.n_simulations,
        parts=segments_of(loops.windows, point.simulated) if not job.parameters.n_gains else (),
    )
    return replace(result, ending=ending, output_error=(first_error, point.simulated.error))


def _sentences(point: Point, loops: Loops, stuck: Mapping[int, str], *, suspected: bool) -> list[str]:
    """Sentences on stuck joints, the size of the output error, the steps in time, and the reference."""
    found = []
    if stuck:
        found.append(stuck_sentence(stuck))
    simulated = point.simulated
    fine, torque = loops.finer(point.x, simulated), simulated.motions[0][3]
    error, size = (np.sqrt(np.mean(values**2, axis=0)) for values in (fine - torque, fine))
    # With a wrong log no step is small enough.
    if not suspected and not np.all(error <= LARGE_ERROR * size):
        found.append(step_sentence(error, size))
    if getattr(loops.job.experiment.reference, "kind", "") == "measured":
        found.append(
            "the reference is the measured position: what the controller did to follow the real one is not in it, and "
            "the simulated robot follows the measured motion with an error of its own"
        )
    return found


def _record(method: DIDIMSettings, job: Job, loops: Loops) -> dict[str, Any]:
    """Return the settings of the method and of the closed loop, for the record of a result."""
    start = method.chosen_start if isinstance(method.chosen_start, str) else "given"
    loop = loops.windows[0].loop
    return {
        method.name.replace("-", "_"): {"start": start, **{key: getattr(method, key) for key in RECORDED}},
        "closed_loop": {
            "reference": getattr(job.experiment.reference, "settings", None),
            "controller": getattr(job.experiment.controller, "settings", None),
            "laws": loop.controller.laws.tolist(),
            "steps": loop.schedule.steps,
        },
    }
