"""Standard deviations of a result: by the jackknife for every method, or from the solver.

Tested in ``tests/test_uncertainty.py``.

Noise and steps of the measured positions move an estimate along measured motion. Both bias inertias and friction in every stretch
of a log, so neither the jackknife nor the test for missing friction sees it. Noise ``n`` of the positions is in the columns, which
shortens the estimate (errors in variables). With other noise of the same size

    D = W(q + n') - W(q),    b_n - b = -(W^T W)^-1 D^T D b

Rounded positions are followed by a log like the measured one, made along its smoothed motion with the estimate, once more rounded:

    q_s = low pass of q,    tau_s = W(q_s) b,    W_r = W(filtered round(q_s + noise)),    b_r - b = W_r^+ (tau_s - W_r b)

Tested in ``tests/test_position_errors.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array, quotient, rms
from .._tools.words import counted
from ..model.dynamics import inverse_dynamics
from ..regression.covariance import Branches, Factors, covariance, independent, intervals, rescaled
from ..regression.fit import Fit
from ..regression.friction.alarm import Along, FrictionAlarm, Sliding, bounded
from ..regression.friction.screen import BLOCKS
from ..regression.settings import LeastSquaresSettings
from ..result.uncertainty import Kind, TimeBlock, Uncertainty
from ..signal.filters import derivatives, differentiate
from ..signal.noise import white_noise
from ..signal.steps import between_steps, smoothed
from ..signal.window import Window
from ..terms.model import Model
from ..terms.rows import Block, LinearSystem, unit_columns
from ..terms.unknown import Unknowns
from .job import Job

FEW_ROWS = 3.0
"""Rows per parameter, without one block, below which the intervals are reported as rough."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariance of the estimated parameters, and its source.

    Attributes
    ----------
    covariance : (n_estimated, n_estimated) array
        Covariance of the result.
    uncertainty : Uncertainty or None
        Uncertainty of all base parameters; None if the solver has no covariance.
    remarks : tuple of str
        Sentences for the result.
    wide : (n_estimated + n_velocities, n_estimated + n_velocities) array
        Covariance of the parameters and of the estimated velocities of friction laws, without shifts; empty if not known.
    velocities : tuple of str
        Parameters of the laws with an estimated velocity.
    """

    covariance: Array
    uncertainty: Uncertainty | None
    remarks: tuple[str, ...] = ()
    wide: Array = field(default_factory=lambda: np.zeros((0, 0)))
    velocities: tuple[str, ...] = ()


def spread_of_fit(
    system: LinearSystem, fit: Fit, settings: LeastSquaresSettings, selection: Unknowns
) -> Spread:
    """Return the spread of the solution of a linear system.

    Parameters
    ----------
    system : LinearSystem
        The system.
    fit : Fit
        Its solution, with `Fit.factors` if the solver's deletions differ from those of weighted least squares.
    settings : LeastSquaresSettings
        Kind of uncertainty, number of blocks, and the divisor of (9).
    selection : Unknowns
        Indices of the estimated base parameters.
    """
    if not fit.covariance.any():
        return Spread(fit.covariance, None)
    if system.w.shape[0] < system.w.shape[1]:  # physical constraints still yield a solution
        sentence = (
            "there are fewer rows than parameters, so the noise cannot be estimated: no standard deviations"
        )
        return Spread(np.zeros_like(fit.covariance), None, (sentence,))
    factors: Factors | Branches | None = fit.factors
    noise = fit.covariance
    velocities: tuple[str, ...] = ()
    if factors is None:
        wider = system.with_velocities(fit.solution)
        factors = (
            Branches.of(wider, fit.weights, fit.residual)
            if fit.precision is None
            else Factors.held(wider.w * fit.weights[:, None], fit.residual * fit.weights, fit.precision)
        )
        velocities = wider.names[len(system.names) :]
        if velocities:
            noise = covariance(wider, settings, fit.weights, fit.residual, factors.inverse)
    coloured = any(block.correlation is not None for block in system.blocks)
    known: Kind = "decimated" if coloured and settings.uncertainty != "white" else "white"
    spread = spread_of_factors(factors, noise, known, system.blocks, settings, selection, system.names)
    if fit.precision is not None and isinstance(factors, Factors) and spread.uncertainty is not None:
        # Blocks that plain least squares could not do without are told by the prior and the constraints.
        errors = factors.left_out([part.rows for part in intervals(system.blocks, BLOCKS)])
        own, unseen = (
            np.array([rms(values[rows]) for rows in system.joints]) for values in (factors.residual, errors)
        )
        growth = np.maximum(quotient(unseen, own, 1.0), 1.0)
        spread = replace(spread, uncertainty=replace(spread.uncertainty, unseen=growth))
    return replace(spread, velocities=velocities)


def spread_of_factors(
    factors: Factors | Branches,
    covariance: Array,
    known: Kind,
    blocks: Sequence[Block],
    settings: LeastSquaresSettings,
    selection: Unknowns,
    names: Sequence[str],
) -> Spread:
    """Return the spread of an estimate with known factors.

    Parameters
    ----------
    factors : Factors or Branches
        Weighted system of the deletions; columns beyond those of `names` are velocities.
    covariance : (n, n) array, or larger
        Covariance without the jackknife, of the columns or of the parameters alone; its correlations are retained.
    known : {"decimated", "white", "correlated"}
        Kind of `covariance`.
    blocks : sequence of Block
        Rows of each joint in each window.
    settings : LeastSquaresSettings
        Kind of uncertainty, number of blocks, and the divisor of (9).
    selection : Unknowns
        Indices of the estimated base parameters.
    names : sequence of str
        Estimated parameters.
    """
    rows, columns = len(factors.residual), len(factors.inverse)
    variance = float(factors.residual @ factors.residual) / max(1, settings.divisor(rows, columns))
    n = len(names)
    wide, covariance = covariance, covariance[:n, :n]
    white = selection.among_all(np.sqrt(variance * np.sum(factors.inverse[:n] ** 2, axis=1)))
    parts = intervals(blocks, settings.blocks) if settings.uncertainty == "jackknife" else []
    if len(parts) < 2:
        plain = Uncertainty(
            kind=known,
            degrees_of_freedom=float(max(1, rows - columns)),
            std_white=white,
        )
        short = settings.uncertainty == "jackknife"
        remark = (
            ("too few rows for a jackknife: sigma takes the errors of the model for noise",) if short else ()
        )
        return Spread(covariance, plain, remark, wide)
    left_out = [part.rows for part in parts]
    every = factors.jackknife(left_out)
    chosen = replace(every, deletions=every.deletions[:, :n], information=every.information[:, :n])
    decisive = chosen.decisive
    longer = independent(factors, blocks, parts, every)
    several = _with_single_blocks(np.diag(longer.covariance), np.diag(every.covariance), longer.decisive)
    variances = _with_single_blocks(several[:n], np.diag(covariance), decisive)
    fewer = len(longer.deletions)
    every_column = (
        rescaled(wide, np.concatenate([variances, several[n:]])) if len(wide) == len(several) else wide
    )
    return Spread(
        rescaled(covariance, variances),
        Uncertainty(
            kind="jackknife",
            degrees_of_freedom=fewer - 1.0,
            std_white=white,
            blocks=tuple(TimeBlock(part.recording, part.window, part.start_s, part.stop_s) for part in parts),
            deletions=selection.among_all(chosen.deletions),
            single_block={
                name: int(block) for name, block in zip(names, decisive, strict=True) if block >= 0
            },
        ),
        tuple(_remarks(rows, columns, settings.blocks, len(parts), fewer)),
        every_column,
    )


def _remarks(rows: int, columns: int, wanted: int, m: int, fewer: int) -> Iterator[str]:
    """Yield what the jackknife says of itself: of m blocks where so many were wanted, and of fewer that are independent."""
    if fewer < m:
        yield f"neighbouring blocks of time err alike: the jackknife takes {fewer} blocks instead of {m}"
    if m < wanted:
        yield f"the log has {counted(rows, 'row')}: the jackknife takes {m} blocks of time instead of {wanted}"
    if rows * (m - 1) / m < FEW_ROWS * columns:
        yield (
            f"{counted(rows, 'row')} for {counted(columns, 'parameter')} are few: the standard deviations are rough"
        )


def _with_single_blocks(several: Array, other: Array, decisive: NDArray[np.intp]) -> Array:
    """Return variances of several blocks, (b,), and where one block decides other variances times the median ratio of both."""
    known = (decisive < 0) & (other > 0.0)
    usual = max(1.0, float(np.median(several[known] / other[known]))) if known.any() else 1.0
    return np.where(decisive < 0, several, usual * other)


def with_model_errors(
    spread: Spread, alarm: FrictionAlarm, positions: Array, along: Along, model: Model, names: Sequence[str]
) -> Spread:
    """Return a spread that includes missing friction, what a choice of laws left open, and errors of positions.

    Noise of variance ``s^2 = s_jackknife^2 + positions^2``, and that of the bias, has intervals that hold with every bias up to
    ``alarm.shift`` (see `bounded`), with unchanged correlations. Other kinds of uncertainty were requested explicitly and do not
    change. Joints whose parameters of friction do not say their friction have it at speeds (`Sliding.where_open`).

    Parameters
    ----------
    spread : Spread
        Spread by noise.
    alarm : FrictionAlarm
        Friction that the model lacks.
    positions : ndarray, shape (n_estimated,)
        Changes of the estimated parameters by errors of positions.
    along : Along
        Motion of the fit.
    model : Model
        Its model.
    names : sequence of str
        Estimated unknowns.
    """
    if spread.uncertainty is None:
        return spread
    unknowns, n, b = model.unknowns, len(names), model.n_base
    # Solvers with factors of their own have no columns of velocities.
    known = n + len(spread.velocities)
    alarm = replace(alarm, moved=alarm.moved[:known], by_block=alarm.by_block[:, :known])
    noise = np.sqrt(np.diag(spread.covariance))
    of_all = unknowns.among_all(np.stack([alarm.shift, positions, noise]))
    wide = len(spread.wide) == known

    def of_robot(rows: Array) -> Array:
        """Return rows of the estimated unknowns and the velocities for the b base parameters and the velocities."""
        return np.hstack([unknowns.among_all(rows[:, :n])[:, :b], rows[:, n:]])

    uncertainty = replace(
        spread.uncertainty,
        friction=replace(
            alarm,
            shift=of_all[0],
            moved=of_robot(alarm.moved[None])[0] if alarm.missing else alarm.moved,
            by_block=of_robot(alarm.by_block) if alarm.missing else alarm.by_block,
        ),
        positions=of_all[1],
        noise=of_all[2],
        load=along.typical_load,
        velocities=spread.velocities if wide else (),
        crossed=of_robot(spread.wide[n:]) if wide and spread.velocities else np.zeros((0, 0)),
    )
    if wide:
        sliding = Sliding(
            robot=along.robot,
            x=along.x,
            load=along.typical_load,
            names=names,
            velocities=spread.velocities,
            covariance=spread.wide,
            factor=uncertainty.factor(0.95),
            alarm=alarm,
        )
        uncertainty = replace(uncertainty, at_speeds=sliding.where_open(along.parts))
    if uncertainty.kind != "jackknife" or not of_all[:2].any():
        return replace(spread, uncertainty=uncertainty)
    # The bias has an error of its own, that of the laws' amounts.
    errors = np.sqrt(np.sum(np.square(alarm.by_block[:, :n]), axis=0)) if alarm.missing else 0.0
    deviations = bounded(np.sqrt(noise**2 + positions**2 + errors**2), alarm.shift)
    return replace(
        spread, uncertainty=uncertainty, covariance=rescaled(spread.covariance, np.square(deviations))
    )


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
    other = job.model.rows(noisy, job.signal, job.model.unknowns.expand(fit.solution))
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
    system = job.model.rows(rounded, job.signal, job.model.unknowns.expand(fit.solution))
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
