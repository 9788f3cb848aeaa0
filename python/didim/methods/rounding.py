r"""How far the steps of the encoders move an estimate along measured motion.

Rounded positions bias velocities and accelerations in every stretch of a log, so neither the jackknife nor the test for missing
friction sees it. A log like the measured one does, made along its smoothed motion with the estimate, once more rounded:

    q_s = low pass of q,    tau_s = W(q_s) b,    W_r = W(filtered round(q_s + noise)),    b_r - b = W_r^+ (tau_s - W_r b)

Tested in ``tests/test_rounding.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from .._tools.arrays import Array
from ..model.dynamics import inverse_dynamics
from ..regression.fit import Fit
from ..regression.linear_system import linear_system, unit_columns
from ..signal.align import align
from ..signal.filters import derivatives, differentiate
from ..signal.segments import Segment, trimmed
from ..signal.steps import between_steps, smoothed
from .job import Delay, Job, shift


def rounding_shift(
    job: Job, fit: Fit, parts: Sequence[Segment], delay: Delay, steps: Mapping[int, Array]
) -> Array:
    """Return the change of an estimate by the steps of the encoders.

    Parameters
    ----------
    job : Job
        Experiment and settings of the run.
    fit : Fit
        Solution of (7) along the measured motion.
    parts : sequence of Segment
        Windows of the fit.
    delay : Delay
        Compensated delay, which determines the samples of a window.
    steps : mapping of int to ndarray, shape (n_dof,)
        By recording, the step of each encoder (rad or m), zero where it is not seen.

    Returns
    -------
    ndarray, shape (n_estimated,)
        Change of each parameter, in its unit; zero without steps. Measured velocities have no steps of positions.

    Notes
    -----
    ``test_rounding.py`` compares it with the errors of logs whose truth is known.
    """
    seen = {
        number
        for number, step in steps.items()
        if step.any() and job.experiment.recordings[number].dq is None
    }
    if not seen:
        return np.zeros_like(fit.solution)
    beta = job.selection.expand(fit.solution)
    x = job.parameters.lift(beta)
    rounded = []
    for part in parts:
        standard = job.parameters.standard(x, part.recording)
        if part.recording in seen:
            rounded.append(_rounded(job, part, standard, delay, steps[part.recording]))
        else:
            tau = inverse_dynamics(
                job.robot, part.q, part.dq, part.ddq, standard, temperature=part.temperature
            )
            rounded.append(replace(part, tau=tau))
    base = beta[: job.parameters.n_base]
    system = linear_system(job.robot, rounded, job.signal, job.selection, base, job.parameters)
    error, change = system.residual(fit.solution) * fit.weights, np.zeros_like(fit.solution)
    for (rows, columns), matrix in zip(system.parts, system.matrices, strict=True):
        a, size = unit_columns(matrix * fit.weights[rows, None])
        # A joint that moves by less than a step has no column; its parameters remain.
        change[columns] = np.linalg.lstsq(a.T @ a, a.T @ error[rows], rcond=None)[0] / size
    return change


def _rounded(job: Job, part: Segment, x: Array, delay: Delay, step: Array) -> Segment:
    """Return a window of the smoothed and rounded log, with the same samples as the measured one."""
    recording, signal = job.experiment.recordings[part.recording], job.signal
    rate = recording.rate_hz
    start, stop = recording.windows[part.window]
    along = smoothed(recording.measured_positions()[start:stop], rate, signal, step)
    smooth = derivatives(along.q, rate, signal)
    grid = np.where(step > 0.0, step, 1.0)
    noise = along.noise * np.random.default_rng(0).standard_normal(along.q.shape)
    q = np.where(step > 0.0, np.round((along.q + noise) / grid) * grid, along.q)
    warmth = () if recording.temperature is None else (recording.temperature[start:stop],)
    tau = inverse_dynamics(job.robot, *smooth, x, temperature=warmth[0] if warmth else None)
    # The torque is that of its sample, so it is cut with the motion instead of being moved.
    (*motion, torque), _ = align(
        (*differentiate(between_steps(q, rate, signal, step), rate, signal), *warmth, tau),
        tau,
        shift(delay, rate),
    )
    made = trimmed(recording, part.place, signal, motion, torque)
    return replace(made, recording=part.recording, window=part.window)
