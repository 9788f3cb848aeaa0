r"""How far noise and steps of the measured positions move an estimate along measured motion.

Both bias inertias and friction in every stretch of a log, so neither the jackknife nor the test for missing friction sees it. Noise
``n`` of the positions is in the columns, which shortens the estimate (errors in variables). With other noise of the same size

    D = W(q + n') - W(q),    b_n - b = -(W^T W)^-1 D^T D b

Rounded positions are followed by a log like the measured one, made along its smoothed motion with the estimate, once more rounded:

    q_s = low pass of q,    tau_s = W(q_s) b,    W_r = W(filtered round(q_s + noise)),    b_r - b = W_r^+ (tau_s - W_r b)

Tested in ``tests/test_position_errors.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from .._tools.arrays import Array
from ..model.dynamics import inverse_dynamics
from ..regression.fit import Fit
from ..signal.filters import derivatives, differentiate
from ..signal.noise import white_noise
from ..signal.steps import between_steps, smoothed
from ..signal.window import Window
from ..terms.rows import LinearSystem, unit_columns
from .job import Job


def position_shift(
    job: Job,
    system: LinearSystem,
    fit: Fit,
    parts: Sequence[Window],
    steps: Mapping[int, Array],
) -> Array:
    """Return the change of an estimate by noise and steps of the measured positions.

    Parameters
    ----------
    job : Job
        Experiment and settings of the run.
    system : LinearSystem
        Equations (7) along the measured motion.
    fit : Fit
        Its solution.
    parts : sequence of Window
        Windows of the fit.
    steps : mapping of int to ndarray, shape (n_dof,)
        By recording, the step of each encoder (rad or m), zero where it is not seen; empty along simulated motion.

    Returns
    -------
    ndarray, shape (n_estimated,)
        Change of each parameter, in its unit; zero along simulated motion.

    Notes
    -----
    ``test_position_errors.py`` compares it with the errors of logs whose truth is known.
    """
    if not steps:
        return np.zeros_like(fit.solution)
    return _by_noise(job, system, fit, parts, steps) + _by_steps(job, fit, parts, steps)


def _by_noise(
    job: Job, system: LinearSystem, fit: Fit, parts: Sequence[Window], steps: Mapping[int, Array]
) -> Array:
    """Return the change by the noise of positions that lie on no grid, and of measured velocities, (n_estimated,)."""
    change = np.zeros_like(fit.solution)
    if system.instruments is not None:  # these do not share the noise of the columns
        return change
    rng = np.random.default_rng(0)
    noisy = [_noisy(job, part, steps[part.recording], rng) for part in parts]
    base = job.model.unknowns.expand(fit.solution)[: job.model.n_base]
    other = job.model.rows(noisy, job.signal, base)
    for (rows, columns), w, shaken in zip(system.parts, system.matrices, other.matrices, strict=True):
        weights = fit.weights[rows, None]
        a, size = unit_columns(w * weights)
        difference = (shaken - w) * (weights / size)
        change[columns] = -_solved(a, difference.T @ (difference @ (fit.solution[columns] * size))) / size
    return change


def _noisy(job: Job, part: Window, step: Array, rng: np.random.Generator) -> Window:
    """Return a window with further noise of the same size and filter in its motion."""
    recording = job.experiment.recordings[part.recording]
    window = slice(*recording.windows[part.number])

    def noise(values: Array, known: Array) -> Array:
        size = np.where(known > 0.0, 0.0, white_noise(values))
        return np.asarray(size * rng.standard_normal(values.shape))

    position = noise(recording.measured_positions()[window], step)
    velocity = None if recording.dq is None else noise(recording.dq[window], np.zeros(len(step)))
    added = differentiate(position, recording.rate_hz, job.signal, velocity)
    start = (len(position) - len(part.q)) // 2  # far from the ends of the filter
    q, dq, ddq = (
        values + more[start : start + len(values)]
        for values, more in zip((part.q, part.dq, part.ddq), added, strict=True)
    )
    return replace(part, q=q, dq=dq, ddq=ddq)


def _by_steps(job: Job, fit: Fit, parts: Sequence[Window], steps: Mapping[int, Array]) -> Array:
    """Return the change by the steps of encoders, (n_estimated,); measured velocities have no steps of positions."""
    seen = {
        number
        for number, step in steps.items()
        if step.any() and job.experiment.recordings[number].dq is None
    }
    if not seen:
        return np.zeros_like(fit.solution)
    x, rounded = job.lift(fit.solution), []
    for part in parts:
        standard = job.model.standard(x, part.recording)
        if part.recording in seen:
            rounded.append(_rounded(job, part, standard, steps[part.recording]))
        else:
            tau = inverse_dynamics(
                job.robot, part.q, part.dq, part.ddq, standard, temperature=part.temperature
            )
            rounded.append(replace(part, tau=tau))
    base = job.model.unknowns.expand(fit.solution)[: job.model.n_base]
    system = job.model.rows(rounded, job.signal, base)
    error, change = system.residual(fit.solution) * fit.weights, np.zeros_like(fit.solution)
    for (rows, columns), matrix in zip(system.parts, system.matrices, strict=True):
        a, size = unit_columns(matrix * fit.weights[rows, None])
        change[columns] = _solved(a, a.T @ error[rows]) / size
    return change


def _solved(a: Array, moment: Array) -> Array:
    """Return the solution of the normal equations; a joint that moves by less than a step has no column, its parameters remain."""
    return np.asarray(np.linalg.lstsq(a.T @ a, moment, rcond=None)[0])


def _rounded(job: Job, part: Window, x: Array, step: Array) -> Window:
    """Return a window of the smoothed and rounded log, with the same samples as the measured one."""
    recording, signal = job.experiment.recordings[part.recording], job.signal
    rate = recording.rate_hz
    start, stop = recording.windows[part.number]
    along = smoothed(recording.measured_positions()[start:stop], rate, signal, step)
    smooth = derivatives(along.q, rate, signal)
    grid = np.where(step > 0.0, step, 1.0)
    noise = along.noise * np.random.default_rng(0).standard_normal(along.q.shape)
    q = np.where(step > 0.0, np.round((along.q + noise) / grid) * grid, along.q)
    warmth = None if recording.temperature is None else recording.temperature[start:stop]
    tau = inverse_dynamics(job.robot, *smooth, x, temperature=warmth)
    # The torque is that of its sample, so it is cut with the motion instead of being moved.
    motion = differentiate(between_steps(q, rate, signal, step), rate, signal)
    made = part.along([values[part.kept] for values in motion])
    return replace(made, tau=np.ascontiguousarray(tau[part.kept]), temperature=part.temperature)
