"""IDIM-LS with currents: drive gains, robot and payloads together. Tested in ``tests/test_drive_gains.py``."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from ..regression.fit import Fit
from ..regression.gains.classical import classical_gains
from ..regression.gains.currents import Currents
from ..regression.gains.maximum_likelihood import drive_gains, expected_percent, expected_sentence
from ..result.identification import Identification
from ..result.iteration import Iteration, Reporter
from .builder import Run, fitted, solved_status
from .job import Job, ratio
from .method import Described

GainEstimate = Literal["maximum-likelihood", "ols", "tls"]
"""Estimator of the drive gains; "ols" and "tls" are biased and serve as comparison."""


def run_with_gains(
    job: Job,
    method: Described,
    kind: GainEstimate,
    reporter: Reporter,
) -> Identification:
    """Identify drive gains, robot and payloads of an experiment whose torques are currents.

    Raises
    ------
    FitError
        When no known quantity sets the scale, or the currents do not identify all parameters.
    """
    delay = job.delay()
    parts = job.parts("fit", delay)
    system = job.system(parts)
    reduction = job.reduction
    expected = expected_sentence(expected_percent(system, reduction))
    reporter.say(expected)
    estimate = drive_gains(system, reduction, job.settings)
    fit, solved, remarks = estimate.fit, estimate.system, [expected]
    if kind != "maximum-likelihood":
        gains, theta = classical_gains(system, reduction, kind)
        currents = Currents.of(system, reduction)
        torque = currents.columns @ theta + currents.known
        solution = np.concatenate([theta, gains])
        # Errors are shares of the torques computed with these gains.
        solved = replace(solved, y=gains[currents.motor] * currents.current, known=None)
        fit = Fit(
            solution=solution,
            covariance=np.zeros((solution.size, solution.size)),
            residual=solved.y - torque,
            weights=fit.weights,
            condition_number=fit.condition_number,
            record={"gains": kind},
        )
        remarks.append(
            f"drive gains by {kind.upper()} are biased, because the noisy currents are in the regressor: for comparison only"
        )
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
        remarks=remarks,
    )
    return fitted(run, solved, fit)
