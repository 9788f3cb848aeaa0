"""IDIM-LS: the inverse dynamic model with measured motion, and least squares (section III of the paper)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted
from ..experiment.experiment import Experiment
from ..regression.suspicions import suspicions
from ..result.identification import Identification
from ..result.iteration import Iteration
from .builder import fitted, solved_status
from .job import ratio
from .method import FitSettings
from .verdict.torques import torque_reasons


@dataclass(frozen=True, kw_only=True)
class IDIMLS(FitSettings):
    """Settings of IDIM-LS: those of `FitSettings`.

    Notes
    -----
    ``test_published.py`` meets the published figures of the EMPS, and those of a prototype for the TX40.
    """

    name: ClassVar[str] = "idim-ls"
    summary: ClassVar[str] = (
        "least squares along the measured motion: needs positions and torques alone; the one to begin with"
    )

    def run(
        self,
        experiment: Experiment,
        progress: Callable[[Iteration], bool],
        say: Callable[[str], None],
    ) -> Identification:
        """Identify the parameters of an experiment's robot.

        Parameters
        ----------
        experiment : Experiment
            Robot, recordings and settings.
        progress : callable
            Called with every iteration; True stops.
        say : callable
            Called with sentences on the progress.

        Returns
        -------
        Identification
            With ``elapsed`` still zero.

        Raises
        ------
        DidimError
            One of its kinds, for a log or settings that allow no estimate.
        """
        job = self.job(experiment)
        delay = job.delay()
        if delay.estimate is not None:
            say(str(delay.estimate))
        parts = job.parts("fit", delay)
        say(f"{counted(len(parts), 'window')} of {sum(part.q.shape[0] for part in parts)} samples")
        system = job.system(parts)
        say(f"observation matrix of {system.w.shape[0]} rows and {system.w.shape[1]} columns")

        history: list[Iteration] = []
        last = np.zeros(system.w.shape[1])

        def record(number: int, solution: Array, residual: Array) -> bool:
            nonlocal last
            change, last = np.linalg.norm(solution - last), solution
            history.append(
                Iteration(
                    iteration=number,
                    relative_error=ratio(np.linalg.norm(residual), np.linalg.norm(system.measured)),
                    step=ratio(change, np.linalg.norm(solution)),
                )
            )
            return progress(history[-1])

        fit = job.solve(system, record)
        if not history:  # the solver reported no solution of its own
            record(1, fit.solution, fit.residual)
        found = suspicions(system, fit)
        return fitted(
            job,
            self,
            system,
            fit,
            status=solved_status(fit),
            history=history,
            delay=delay,
            q=np.concatenate([part.q for part in parts]),
            remarks=found,
            evidence=torque_reasons(found),
        )
