"""Measured and predicted torques on the rows of a fit, for plots and reports.

IDIM-LS predicts along the filtered measured motion, DIDIM along the simulated motion of the closed loop with its parameters,
both filtered and decimated. CLOE compares the simulated torques directly. Tested in ``tests/test_plot.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from .._tools.arrays import Array, quotient, rms
from ..errors import FitError
from ..experiment.experiment import Experiment
from ..experiment.loop import closed_loop
from ..log.recording import Recording
from ..loop.simulation import Simulation
from ..methods.job import Delay
from ..methods.method import FitSettings, Motion
from ..regression.friction.velocity import with_slopes
from ..result.identification import Identification
from ..result.uncertainty import student_factor
from ..robot.robot import Robot
from ..signal.filters import decimation_stages
from ..signal.noise import noise_correlation
from ..signal.processing import SignalProcessing
from ..signal.window import Window, windows_of
from ..terms.model import Model
from ..terms.rows import LinearSystem
from .loaded import same_parameters, standard_in, unloaded, with_friction_of, with_gains_of


@dataclass(frozen=True, eq=False)
class Prediction:
    """Torques of one window of a recording, joint side.

    Attributes
    ----------
    recording : str
        Its name.
    role : str
        "fit" or "held-out".
    motion : {"measured", "simulated"}
        Motion along which the torques are predicted.
    t : (n_rows,) array
        Times in the recording (s).
    measured, predicted : (n_rows, n_dof) arrays
        Torques (N.m) or forces (N).
    noise_correlation : (n_lags,) array or None
        Autocorrelation of white noise on these rows after decimation; None if it stays white.
    std : (n_rows, n_dof) array or None
        Standard deviation of the prediction error, from the residual of the fit and the uncertainty of the parameters; None for
        results without standard deviations.
    degrees_of_freedom : float
        Of Student's distribution of the intervals.
    sizes : (n_dof, n_base) array or None
        Root mean square of each column of W over the rows of a joint: the torque of a unit parameter.
    """

    recording: str
    role: str
    motion: Motion
    t: Array
    measured: Array
    predicted: Array
    noise_correlation: Array | None = None
    std: Array | None = None
    degrees_of_freedom: float = float("inf")
    sizes: Array | None = None

    @property
    def residual(self) -> Array:
        """Measured less predicted, (n_rows, n_dof)."""
        return self.measured - self.predicted

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """Return both ends of the prediction intervals, ``predicted -+ t sqrt(s_j^2 + w C w^T)``, (n_rows, n_dof) each.

        They are valid for motion like that of the fit: on faster motion the model error exceeds the residual of the fit.

        Raises
        ------
        FitError
            For a result without standard deviations, or a level that is not between 0 and 1.
        """
        if self.std is None:
            raise FitError(
                f"recording '{self.recording}': the result has no standard deviations, and so no intervals"
            )
        half = student_factor(level, self.degrees_of_freedom) * self.std
        return self.predicted - half, self.predicted + half


def relative_errors(predictions: Sequence[Prediction]) -> Array:
    """Norm of the torque error over that of the torque, per joint and all windows together, (n_dof,)."""
    error, size = (
        np.linalg.norm(np.concatenate([getattr(prediction, key) for prediction in predictions]), axis=0)
        for key in ("residual", "measured")
    )
    return quotient(error, size, np.nan)


def explained(predictions: Sequence[Prediction]) -> Array:
    """Return the largest share of a joint's torque due to each base parameter, per unit of the parameter.

    Parameters
    ----------
    predictions : sequence of Prediction
        From `predict`.

    Returns
    -------
    (n_base,) array
        Root mean square of the column of W over that of the measured torque, per unit of the parameter.
    """
    rows = np.array([len(prediction.t) for prediction in predictions], dtype=np.float64)
    squares = np.array([prediction.sizes for prediction in predictions], dtype=np.float64) ** 2
    column = np.sqrt(np.tensordot(rows, squares, axes=1) / rows.sum())
    measured = np.concatenate([prediction.measured for prediction in predictions])
    torque = rms(measured)[:, None]
    return np.asarray(quotient(column, torque).max(axis=0))


def predict(
    fit: Identification,
    experiment: Experiment,
    *,
    role: str = "fit",
    motion: Motion | None = None,
    as_fitted: bool = True,
) -> list[Prediction]:
    """Predict the torques of an experiment's recordings with the parameters of a result.

    Parameters
    ----------
    fit : Identification
        Any result.
    experiment : Experiment
        Experiment of the fit, or another log of the same robot.
    role : str
        Recordings: "fit", "held-out", or "all".
    motion : {"measured", "simulated"}, optional
        Filtered measured motion, or motion of the simulated closed loop. By default that of the method: measured for IDIM-LS
        and for held-out recordings, simulated for DIDIM and CLOE.
    as_fitted : bool
        Use filters and delay of the fit; False for those of the experiment, as in `validate`.

    Returns
    -------
    list of Prediction
        One per window.

    Raises
    ------
    FitError
        For another robot, without recordings or torques, or when a simulation ends early.
    DidimError
        As for an identification.

    Notes
    -----
    The errors of IDIM-LS and CLOE are those of the result. DIDIM's are those of its last solution, along the motion of the
    preceding iterate. Here the motion is that of the final parameters; both errors agree to the extent that it has converged.
    """
    experiment = with_gains_of(fit, with_friction_of(fit, experiment))
    robot = experiment.simulated_robot
    same_parameters(fit, robot)
    recordings = [(k, log) for k, log in enumerate(experiment.recordings) if role in ("all", log.role)]
    if not recordings:
        what = "recording" if role == "all" else f"recording with role {role!r}"
        raise FitError(f"experiment '{experiment.name}' has no {what}")
    own_motion, compares_raw = motion_of(fit)
    if motion is None:
        motion = "measured" if role == "held-out" else own_motion
    if as_fitted:
        experiment, delay = fitted_experiment(fit, experiment)
    else:
        delay = FitSettings().job(unloaded(experiment)).delay()
    # CLOE compares simulated torques sample by sample.
    raw = motion == "simulated" and compares_raw
    predictions = []
    loaded = standard_in(fit, experiment, robot)
    for number, recording in recordings:
        if recording.tau is None:
            raise FitError(f"recording '{recording.name}' has no torques to compare with")
        # Simulated accelerations result from the torque that starts at the sample, so there is no hold delay.
        hold_s = delay.hold_s if motion == "measured" else 0.0
        parts = windows_of(recording, experiment.signal, along=motion, delay=delay.samples, hold_s=hold_s)
        if motion == "simulated":
            parts = [
                _simulated(loaded[number], experiment, recording, part, span)
                for part, span in zip(parts, recording.windows, strict=True)
            ]
        model = experiment.robot if motion == "measured" else robot
        signal = replace(experiment.signal, decimation=()) if raw else experiment.signal
        beta = model.base_parameters.project(loaded[number])
        for part, window in zip(parts, recording.windows, strict=True):
            samples = np.arange(part.kept.start, part.kept.stop)
            for _, _, _, factor, first in decimation_stages(len(samples), signal):
                samples = samples[first::factor]
            predictions.append(
                Prediction(
                    recording=recording.name,
                    role=recording.role,
                    motion=motion,
                    t=cast(Array, recording.t[window[0] + samples[signal.kept_rows]]),
                    noise_correlation=noise_correlation(signal),
                    **_torques(fit, model, part, signal, beta),
                )
            )
    return predictions


def simulate_window(
    x: Array, experiment: Experiment, recording: Recording, window: tuple[int, int]
) -> Simulation:
    """Simulate the closed loop of an experiment over a window of a recording.

    Parameters
    ----------
    x : (n_parameters,) array
        Standard parameters.
    experiment : Experiment
        Experiment with a reference and a controller.
    recording, window
        Recording and window that define rate and length; time 0 is the first sample of the window.

    Returns
    -------
    Simulation
        As from `simulate`; its outcome tells whether it completed.

    Raises
    ------
    ExperimentError
        Without a reference or a controller.
    """
    loop = closed_loop(experiment, recording, window)
    arrays, outcomes = loop.run(x[None])
    q, dq, ddq, tau = (values[0] for values in arrays)
    return Simulation(loop.t, q, dq, ddq, tau, outcomes, None, loop.n_steps)


def motion_of(fit: Identification) -> tuple[Motion, bool]:
    """Return the motion for a method's predictions, and whether it compares torques sample by sample."""
    known = fit.settings.get("prediction")
    if known is not None:
        return ("measured" if known["motion"] == "measured" else "simulated"), bool(known["raw"])
    # Results of version 0.1.0 do not record it; it had three methods.
    return "measured" if fit.method == "idim-ls" else "simulated", fit.method.startswith(("cloe", "clie"))


def fitted_experiment(fit: Identification, experiment: Experiment) -> tuple[Experiment, Delay]:
    """Return the experiment with the filters of a fit, and its delay."""
    return replace(experiment, signal=fit.recorded_signal or experiment.signal), Delay.recorded(fit.delay)


def _simulated(
    x: Array, experiment: Experiment, recording: Recording, part: Window, span: tuple[int, int]
) -> Window:
    """Return a window along its simulated motion, as in DIDIM."""
    simulation = simulate_window(x, experiment, recording, span)
    if not simulation.outcomes[0].completed:
        raise FitError(f"recording '{recording.name}': the simulation {simulation.outcomes[0]}")
    return part.along([values[part.kept] for values in (simulation.q, simulation.dq, simulation.ddq)])


def _torques(
    fit: Identification, robot: Robot, part: Window, signal: SignalProcessing, beta: Array
) -> dict[str, Any]:
    """Return measured and predicted torques of a window, with the sizes of the columns and standard deviations."""
    n = robot.n_dof
    system = with_slopes(Model(robot).rows([part], signal, beta), robot, [part], signal)
    return {
        "measured": system.y.reshape(n, -1).T.copy(),
        "predicted": (system.w @ beta).reshape(n, -1).T.copy(),
        "sizes": np.sqrt(np.mean(system.w.reshape(n, -1, system.w.shape[1]) ** 2, axis=1)),
        **_spread(fit, system, beta, n),
    }


def _spread(fit: Identification, system: LinearSystem, beta: Array, n_dof: int) -> dict[str, Any]:
    """Return standard deviation and degrees of freedom of predictions along the rows of a system, by noise alone.

    Biases of parameters by missing friction nearly cancel in a torque; what they leave is in the residuals of the joints.
    """
    uncertainty = fit.uncertainty
    if uncertainty is None or not fit.std.any() or len(uncertainty.joint_std) != n_dof:
        return {}
    covariance, w = uncertainty.noise_covariance(fit.covariance, fit.std), system.w
    if uncertainty.velocities:
        velocities = dict.fromkeys(uncertainty.velocities, np.zeros(system.y.size))
        velocities |= {name: beta[system.names.index(name)] * slope for name, slope in system.slopes.items()}
        w = np.column_stack([w, *(velocities[name] for name in uncertainty.velocities)])
    of_parameters = np.einsum("ra,ab,rb->r", w, covariance, w, optimize=True)
    variance = np.maximum(of_parameters.reshape(n_dof, -1).T, 0.0) + uncertainty.joint_std**2
    return {"std": np.sqrt(variance), "degrees_of_freedom": uncertainty.degrees_of_freedom}


def autocorrelation(parts: Sequence[Array], n_lags: int) -> Array:
    """Return the autocorrelation of residuals at lags 0 to n_lags, windows pooled.

    Parameters
    ----------
    parts : sequence of (n_rows,) arrays
        Residual of a joint in each window.
    n_lags : int
        Largest lag.

    Returns
    -------
    (n_lags + 1,) array
        1 at lag 0; NaN for residuals that do not vary.
    """
    mean = np.concatenate(parts).mean()
    sums = np.zeros(n_lags + 1)
    for part in parts:
        e = part - mean
        for lag in range(min(n_lags + 1, e.size)):
            sums[lag] += e[: e.size - lag] @ e[lag:]
    return np.asarray(sums / sums[0] if sums[0] > 0.0 else np.full_like(sums, np.nan))
