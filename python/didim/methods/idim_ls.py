"""IDIM-LS: the inverse dynamic model along measured motion, by least squares (section III of the paper)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .._tools.arrays import Array, ratio
from .._tools.words import counted
from ..experiment.experiment import Experiment
from ..regression.gains.maximum_likelihood import drive_gains, expected_percent, expected_sentence
from ..result.identification import Identification
from ..result.iteration import Iteration, Reporter
from .builder import Run, fitted, solved_status
from .job import Delay, MeasuredRows
from .method import FitSettings, MethodSettings


@dataclass(frozen=True, kw_only=True)
class IDIMLS(FitSettings):
    """Settings of IDIM-LS: those of `FitSettings`.

    It solves the linear system (7), with the weights (11) and the covariance (8) to (10).

    Notes
    -----
    ``test_published.py`` reproduces the published figures of the EMPS, and those of a prototype for the TX40.
    """

    name: ClassVar[str] = "idim-ls"
    estimates_gains: ClassVar[bool] = True

    def run(self, experiment: Experiment, reporter: Reporter) -> Identification:
        """Identify the parameters of an experiment's robot, as `Method.run`."""
        job = self.job(experiment)
        delay = job.delay()
        if delay.estimate is not None:
            reporter.say(str(delay.estimate))
        parts = job.parts("fit", delay)
        reporter.say(f"{counted(len(parts), 'window')} of {sum(part.q.shape[0] for part in parts)} samples")
        system = job.system(parts)
        reporter.measured(MeasuredRows(job, delay, parts, system))
        reporter.say(f"observation matrix of {system.w.shape[0]} rows and {system.w.shape[1]} columns")

        history: list[Iteration] = []
        last = np.zeros(system.w.shape[1])

        def record(number: int, solution: Array, residual: Array) -> bool:
            nonlocal last
            change, last = np.linalg.norm(solution - last), solution
            history.append(
                Iteration(
                    iteration=number,
                    relative_error=system.relative_error(residual),
                    step=ratio(change, np.linalg.norm(solution)),
                )
            )
            return reporter.progress(history[-1])

        remarks: list[str] = []
        if job.model.n_gains:
            remarks = [expected_sentence(expected_percent(system, job.reduction))]
            reporter.say(remarks[0])
            estimate = drive_gains(system, job.reduction, job.settings)
            fit, system = estimate.fit, estimate.system
            last = fit.solution
            record(estimate.iterations, fit.solution, fit.residual)
        else:
            fit = job.solve(system, record)
            if not history:  # a direct solver does not report iterations
                record(1, fit.solution, fit.residual)
        run = Run(
            job=job,
            method=self,
            status=solved_status(fit),
            history=history,
            delay=delay,
            q=np.concatenate([part.q for part in parts]),
            remarks=remarks,
        )
        return fitted(run, system, fit, parts=() if job.model.n_gains else parts)


def direct_estimate(
    method: MethodSettings,
    experiment: Experiment,
    reporter: Reporter,
    compensate_samples: Delay | None = None,
) -> Identification:
    """Return the IDIM-LS estimate with the settings of another method, for its start or its gains.

    `compensate_samples` is the delay of the other run.
    """
    settings = {**method.shared, **{key: getattr(method, key, None) for key in ("weights", "reweightings")}}
    if compensate_samples is not None:
        settings["compensate_samples"] = compensate_samples
    direct = IDIMLS(solver=method.chosen_solver(), **settings)
    return direct.run(experiment, reporter.without_iterations)
