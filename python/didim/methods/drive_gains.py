"""IDIM-LS with currents: drive gains, robot and payloads together. Tested in ``tests/test_drive_gains.py``."""

from __future__ import annotations

import numpy as np

from ..regression.gains.maximum_likelihood import drive_gains, expected_percent, expected_sentence
from ..result.identification import Identification
from ..result.iteration import Iteration, Reporter
from .builder import Run, fitted, solved_status
from .job import Job, ratio
from .method import Described


def run_with_gains(job: Job, method: Described, reporter: Reporter) -> Identification:
    """Identify drive gains, robot and payloads of an experiment whose torques are currents.

    Raises
    ------
    FitError
        When no known quantity sets the scale, or the currents do not identify all parameters.
    """
    delay = job.delay()
    parts = job.parts("fit", delay)
    system = job.system(parts)
    expected = expected_sentence(expected_percent(system, job.reduction))
    reporter.say(expected)
    estimate = drive_gains(system, job.reduction, job.settings)
    fit, solved = estimate.fit, estimate.system
    entry = Iteration(
        iteration=estimate.iterations,
        relative_error=ratio(np.linalg.norm(fit.residual), np.linalg.norm(solved.y)),
        step=0.0,
    )
    reporter.progress(entry)
    run = Run(
        job=job,
        method=method,
        status=solved_status(fit),
        history=[entry],
        delay=delay,
        q=np.concatenate([part.q for part in parts]),
        remarks=[expected],
    )
    return fitted(run, solved, fit)
