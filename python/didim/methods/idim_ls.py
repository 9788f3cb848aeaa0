"""IDIM-LS: the inverse dynamic model with measured motion, and least squares (section III of the paper)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted
from ..experiment.experiment import Experiment
from ..regression.least_squares import solve
from ..regression.linear_system import linear_system
from ..regression.suspicions import suspicions
from ..result.identification import Identification
from ..result.iteration import Iteration
from ..signal.noise import noise_correlation
from .method import FitSettings, ratio, solved_status


@dataclass(frozen=True, kw_only=True)
class IDIMLS(FitSettings):
    """Settings of IDIM-LS: those of `FitSettings`.

    Notes
    -----
    ``test_published.py`` meets the published figures of the EMPS, and those of a prototype for the TX40.
    """

    name: ClassVar[str] = "idim-ls"

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
            Told every iteration; True stops.
        say : callable
            Told in words what is going on.

        Returns
        -------
        Identification
            With ``elapsed`` still zero.

        Raises
        ------
        DidimError
            One of its kinds, for a log or a wish that allows no estimate.
        """
        job = self.job(experiment)
        delay = job.delay()
        if delay[1] is not None:
            say(f"torque {delay[1].samples:+.2f} samples ({1e3 * delay[1].seconds:+.3f} ms) after the motion")
        parts = job.parts("fit", delay[0])
        say(f"{counted(len(parts), 'window')} of {sum(part.q.shape[0] for part in parts)} samples")
        system = linear_system(job.robot, parts, job.signal, job.selection)
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

        correlation = noise_correlation(job.signal) if job.settings.decimation_corrected else None
        fit = solve(system, job.settings, correlation=correlation, progress=record)
        return job.result(
            system,
            fit,
            method=self.name,
            status=solved_status(fit),
            history=history,
            delay=delay,
            q=np.concatenate([part.q for part in parts]),
            remarks=suspicions(system, fit),
        )
