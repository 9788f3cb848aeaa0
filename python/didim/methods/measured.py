"""Measured motion of a log as evidence, for any method. Tested in ``tests/test_verdict_faults.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .._tools.arrays import Array
from ..errors import DidimError
from ..evidence.judge import Measured
from ..evidence.loop.law import declared_loop
from ..evidence.loop.law_rows import with_law_torques
from ..experiment.experiment import Experiment
from ..result.identification import Identification
from .idim_ls import IDIMLS
from .job import Delay, Job, MeasuredRows
from .method import Method, MethodSettings


def measured_along(
    fit: Identification, experiment: Experiment, method: Method, made: Sequence[MeasuredRows] = ()
) -> Measured | None:
    """Return the measured motion and torques of a log with the filters of a method and the delay of its result.

    The last of the rows that the run has `made` are not computed again where they are the same.
    None without positions, torques or drive gains, and for settings other than those of IDIM-LS.
    """
    asked = method.shared if isinstance(method, MethodSettings) else {}
    same = {key: asked.get(key) for key in ("signal", "fixed", "dropped")}
    try:
        job = IDIMLS(**same, compensate_samples=Delay.recorded(fit.delay)).job(experiment)
        if job.model.n_gains:
            return None
        delay = job.declared_delay
        rows = made[-1] if made and made[-1].along(job, delay) else None
        return Measured(
            robot=job.robot,
            signal=job.signal,
            logs=job.model,
            parts=job.parts("fit", delay) if rows is None else rows.parts,
            system=None if rows is None else rows.every_column(job),
            outside=job.parts("held-out", delay),
            least=lambda: least_errors(job),
        )
    except DidimError:
        return None


def law_along(fit: Identification, experiment: Experiment, method: Method) -> Measured | None:
    """Return the measured motion with the torques of the declared controller; None where none follows a reference.

    The friction is that of the simulation, which the method fits: smooth friction at reversals is no Stribeck friction.
    """
    try:
        if not declared_loop(experiment):
            return None
        by_law = replace(with_law_torques(experiment), robot=experiment.simulated_robot)
        return measured_along(fit, by_law, method)
    except (DidimError, IndexError):  # no recording of a fit
        return None


def least_errors(job: Job) -> Array:
    """Return the torque errors of plain IDIM-LS, (n_dof,) (N.m or N, root mean squares on its rows).

    Raises
    ------
    DidimError
        For a log without a solution.
    """
    system = job.system(job.parts("fit", job.declared_delay))
    sizes = [max(1, rows.stop - rows.start) for rows in system.joints]
    return np.asarray(system.norms(job.solve(system).residual) / np.sqrt(sizes))
