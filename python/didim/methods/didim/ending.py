"""The end of a run of DIDIM: its result, and sentences on it. Tested in ``tests/test_didim_endings.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..._tools.arrays import rms
from ...loop.outcome import LARGE_ERROR
from ...model.safe_step import thinned
from ...result.identification import Identification
from ...result.iteration import Iteration
from ...result.status import Status
from ..builder import Run, fitted
from .convergence import step_sentence, stuck_sentence
from .problem import Problem
from .windows import Iterate, Solved, motion_record


def result_at(
    point: Iterate,
    solved: Solved,
    problem: Problem,
    *,
    status: Status,
    ending: str,
    history: Sequence[Iteration],
    first_error: float,
    remarks: Sequence[str],
) -> Identification:
    """Build the result at a point, with the errors of its parameters; without standard deviations unless converged.

    Parameters
    ----------
    point, solved
        Iterate, and the solved linear system along its motion or the preceding one.
    problem
        Problem, with the closed loops of the log.
    status, ending, history
        As in `Identification`.
    first_error
        Output error (12) with the initial parameters.
    remarks
        Sentences on the iteration.
    """
    job, simulator, system = problem.job, problem.simulator, solved.system
    beta = job.parameters.project(point.x)
    estimate = beta[job.selection.estimated]
    # After a shortened step the iterate is not the solution, so the residual is computed again.
    fit = replace(solved.fit, solution=estimate, residual=system.y - system.w @ estimate)
    if fit.standard is not None:
        fit = replace(fit, standard=point.x)
    if not status.converged:
        # (10) is only valid at the minimum.
        fit = replace(fit, covariance=np.zeros_like(fit.covariance))
    suspected = problem.suspected(system, fit, converged=status.converged)
    run = Run(
        job=job,
        method=problem.method,
        status=status,
        history=history,
        delay=simulator.delay,
        q=thinned(np.concatenate([motion[0] for motion in point.simulated.motions]), 2000),
        settings={
            **problem.record(),
            "simulated": motion_record(job, simulator.windows, point.simulated),
        },
        remarks=[*problem.remarks, *remarks, *_sentences(point, problem, suspected=bool(suspected))],
        evidence=problem.evidence(suspected, point.simulated.error),
    )
    parts = simulator.segments(point.simulated) if not job.parameters.n_gains else ()
    result = fitted(run, system, fit, beta=beta, parts=parts)
    return replace(
        result,
        ending=ending,
        output_error=(first_error, point.simulated.error),
        n_simulations=simulator.n_simulations,
    )


def _sentences(point: Iterate, problem: Problem, *, suspected: bool) -> list[str]:
    """Return sentences on stuck joints, time steps and the reference."""
    sentences, simulator = [], problem.simulator
    if problem.stuck:
        sentences.append(stuck_sentence(problem.stuck))
    if not simulator.steps_follow_rates:
        simulated = point.simulated
        fine, torque = simulator.finer(point.x, simulated), simulated.motions[0][3]
        error, size = rms(fine - torque), rms(fine)
        # With a wrong log no time step is small enough.
        if not suspected and not np.all(error <= LARGE_ERROR * size):
            sentences.append(step_sentence(error, size))
    if getattr(simulator.experiment.reference, "kind", "") == "measured":
        sentences.append(
            "the reference is the measured position, not the commanded one: the simulated robot follows it with an error that "
            "the real one did not have"
        )
    return sentences
