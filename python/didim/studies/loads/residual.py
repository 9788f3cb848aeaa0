"""External torques along a log, with an identified robot. Tested in ``tests/test_residual.py``.

    tau_ext = W beta - tau                 along the filtered motion, with intervals
    r                                      by the momentum observer, sample by sample, for the detection

External torques are positive if they push the joint forward.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..._tools.arrays import Array, rms
from ..._tools.notebook import Printed
from ..._tools.pickling import Pickled
from ..._tools.saved import plain
from ..._tools.settings import positive
from ...errors import DidimError, ExperimentError, FitError
from ...evidence.applied.load import clearly_loaded
from ...evidence.applied.log import AppliedLog, Errors, applied_findings
from ...evidence.products import BLOCKS
from ...experiment.experiment import Experiment
from ...log.recording import Recording
from ...loop.tuning import largest_coulomb
from ...methods.job import Delay
from ...methods.method import FitSettings
from ...result.finding import Finding
from ...result.identification import Identification
from ...result.table import table_lines
from ...result.uncertainty import student_factor
from ...result.verdict import Verdict
from ...robot.payload import NOTHING, Payload, ends, payload_columns
from ...signal.noise import stamp_noise
from ...signal.spikes import without_spikes
from ...signal.window import align, windows_of
from ...terms.model import Model
from ...terms.share import independent
from ..loaded import as_fitted, standard_in, unloaded
from ..prediction import Prediction, predict
from ..validation import same_robot
from .detection import Contact, PayloadChange, contacts, payload_change, shortest_s
from .observer import BANDWIDTH_HZ, low_pass, observe, stamp_gain
from .payload import UNNAMED, payload_in

CONTACT_THRESHOLD = 6.0
"""External torque, in standard deviations, from which the observer reports a contact."""
SLOW = 0.02
"""Speed, as a share of the joint's largest in the window, below which the sign of its friction is unknown."""
SETTLING = 5.0
"""Time after the start of a window that is ignored, in time constants of the observer."""
NORMAL = 1.4826
"""Ratio of standard deviation to median absolute deviation of normal noise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExternalTorque(Pickled):
    """External torques along one window.

    Attributes
    ----------
    recording : str
        Its name.
    t : (n_rows,) array
        Times of the filtered rows (s).
    torque, std : (n_rows, n_dof) arrays
        External torque (N.m or N), zero-phase filtered, and the standard deviation of the prediction.
    degrees_of_freedom : float
        Degrees of freedom of Student's distribution for its intervals.
    observer_t : (n_samples,) array
        Times of the samples (s).
    observed, limits : (n_samples, n_dof) arrays
        External torque of the observer, and the limits from which it is reported.
    contacts : tuple of Contact
        Intervals beyond the limits, except those explained by a payload change.
    payload_change : PayloadChange or None
        A payload that differs from the model from some time on.
    """

    recording: str
    t: Array
    torque: Array
    std: Array
    degrees_of_freedom: float
    observer_t: Array
    observed: Array
    limits: Array
    contacts: tuple[Contact, ...]
    payload_change: PayloadChange | None

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """Return both ends of the intervals of the external torque, (n_rows, n_dof) each."""
        half = student_factor(level, self.degrees_of_freedom) * self.std
        return self.torque - half, self.torque + half


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Residual(Pickled, Printed):
    """External torques along a log.

    Attributes
    ----------
    fit, log, robot : str
        Result, experiment and robot.
    windows : tuple of ExternalTorque
        One for each window.
    joint_names : tuple of str
        Names of the joints; empty where the robot has none.
    settings : mapping
        Bandwidth of the observer (Hz) and threshold (standard deviations).
    fit_error : (n_dof,) array
        Root mean square of the errors of the fit on its own log (N.m or N).
    evidence : tuple of Finding
        Findings against the log or the result, and notes: see `verdict`.
    """

    fit: str
    log: str
    robot: str
    windows: tuple[ExternalTorque, ...]
    joint_names: tuple[str, ...] = ()
    settings: Mapping[str, float] = field(default_factory=dict)
    fit_error: Array = field(default_factory=lambda: np.zeros(0))
    evidence: tuple[Finding, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Whether the log is one of the robot of the result, read as that of the fit was; contacts are no reason against it."""
        return Verdict.of(self.evidence)

    @property
    def quiet(self) -> bool:
        """Whether neither a contact nor a payload change was detected."""
        return not any(window.contacts or window.payload_change for window in self.windows)

    def __str__(self) -> str:
        lines = [f"external torques in {self.log}, with the robot {self.robot} of {self.fit} (N.m or N)"]
        for window in self.windows:
            n = window.torque.shape[1]
            rows = [
                ("", *(f"joint {joint + 1}" for joint in range(n))),
                ("rms along the motion", *(f"{value:.3f}" for value in rms(window.torque))),
                ("that of the fit", *(f"{value:.3f}" for value in self.fit_error)),
                ("sigma of the prediction", *(f"{value:.3f}" for value in rms(window.std))),
                ("rms of the observer", *(f"{value:.3f}" for value in rms(window.observed))),
                ("its limit, median", *(f"{value:.3f}" for value in np.median(window.limits, axis=0))),
            ]
            lines += ["", f"recording '{window.recording}', {window.t[0]:.3f} to {window.t[-1]:.3f} s"]
            lines += table_lines(rows)
            pushes = [str(contact) for contact in window.contacts]
            if window.payload_change is not None:
                pushes.insert(0, str(window.payload_change))
            lines += pushes or ["no external torque"]
        return "\n".join([*lines, "", str(self.verdict)])

    def to_dict(self) -> dict[str, Any]:
        """Return the detections, as plain lists and numbers, without the samples."""
        return {
            "fit": self.fit,
            "log": self.log,
            "robot": self.robot,
            "settings": dict(self.settings),
            "quiet": self.quiet,
            "fit_rms": self.fit_error.tolist(),
            "verdict": self.verdict.to_dict(),
            "windows": [
                {
                    "recording": window.recording,
                    "rms": rms(window.torque).tolist(),
                    "std": rms(window.std).tolist(),
                    "observer_rms": rms(window.observed).tolist(),
                    "observer_limit": np.median(window.limits, axis=0).tolist(),
                    "contacts": plain(window.contacts),
                    "payload_change": plain(window.payload_change),
                }
                for window in self.windows
            ],
        }

    def csv(self) -> str:
        """Return time, external torque and its standard deviation of all rows as CSV."""
        n = self.windows[0].torque.shape[1]
        head = [
            "recording",
            "t_s",
            *(f"external_{joint + 1}" for joint in range(n)),
            *(f"std_{joint + 1}" for joint in range(n)),
        ]
        lines = [",".join(head)]
        for window in self.windows:
            for t, torque, std in zip(window.t, window.torque, window.std, strict=True):
                numbers = ",".join(f"{value:.6g}" for value in (*torque, *std))
                lines.append(f"{window.recording},{t:.6f},{numbers}")
        return "\n".join(lines) + "\n"


def residual_torques(
    fit: Identification,
    experiment: Experiment,
    *,
    bandwidth_hz: float = BANDWIDTH_HZ,
    threshold: float = CONTACT_THRESHOLD,
) -> Residual:
    """Find external torques along a log.

    The measured torques less those of (1).

    Parameters
    ----------
    fit : Identification
        Robot with its covariance; payloads of the log must be known, from the result or from the tables ``[payload]``.
    experiment : Experiment
        The log.
    bandwidth_hz : float
        Bandwidth of the momentum observer (Hz).
    threshold : float
        Standard deviations from which it reports a contact.

    Returns
    -------
    Residual
        External torques of each recording (N.m or N, joint side), contacts and changes of the payload.

    Raises
    ------
    FitError
        For another robot, an unknown payload, or a result without standard deviations.
    ExperimentError
        For a recording that is shorter than the observer takes to settle.
    DidimError
        As for a validation.

    Notes
    -----
    The noise of the observer is the larger of the fit's residual and its own median absolute deviation in the window, so a push
    that lasts most of the window raises the limits. ``test_residual.py`` pushes a simulated arm; ``benches/payloads.py``
    measures the latency, and clean logs.
    """
    positive("bandwidth_hz", bandwidth_hz, FitError)
    positive("threshold", threshold, FitError)
    experiment, taken = as_fitted(fit, experiment)
    same_robot(fit, experiment)
    predictions = predict(fit, experiment, role="all", motion="measured", as_fitted=False)
    loaded = standard_in(fit, experiment, experiment.robot)
    windows = iter(predictions)
    windows_seen: list[ExternalTorque] = []
    evidence = list(taken)
    for number, recording in enumerate(experiment.recordings):
        for window in range(len(recording.windows)):
            prediction = next(windows)
            if prediction.std is None:
                raise FitError(
                    f"the result '{fit.name}' has no standard deviations: they are needed for the limits"
                )
            windows_seen.append(
                _window(
                    fit,
                    experiment,
                    recording,
                    window,
                    (prediction.t, -prediction.residual, prediction.std, prediction.degrees_of_freedom),
                    loaded[number],
                    bandwidth_hz,
                    threshold,
                )
            )
            change = windows_seen[-1].payload_change
            evidence += _evidence(fit, experiment, recording, window, loaded[number], prediction, change)
    assert fit.uncertainty is not None  # the limits need standard deviations
    return Residual(
        fit=fit.name,
        log=experiment.name,
        robot=fit.robot,
        windows=tuple(windows_seen),
        joint_names=experiment.robot.joint_names,
        settings={"bandwidth_hz": bandwidth_hz, "threshold": threshold},
        fit_error=fit.uncertainty.joint_std,
        evidence=tuple(evidence),
    )


def _evidence(
    fit: Identification,
    experiment: Experiment,
    recording: Recording,
    window: int,
    x: Array,
    prediction: Prediction,
    change: PayloadChange | None,
) -> list[Finding]:
    """Return what the errors of a window say; a push and a payload that changes, which are found beside, speak against nothing.

    The errors are those of the median stretch of time, so that a push is none.
    """
    cuts = np.array_split(np.arange(len(prediction.t)), BLOCKS)
    error = np.sqrt(np.median([np.mean(prediction.residual[cut] ** 2, axis=0) for cut in cuts], axis=0))
    errors = Errors.beside(fit, error, rms(prediction.measured))
    if not errors.larger:
        return []
    delay = FitSettings().job(unloaded(experiment)).delay()
    spans = recording.windows[window : window + 1]
    parts = windows_of(recording, experiment.signal, delay=delay.samples, hold_s=delay.hold_s, spans=spans)
    robot = experiment.robot
    logs = Model(robot)
    beta = robot.base_parameters.project(x)
    found = applied_findings(AppliedLog(robot, experiment.signal, logs, beta, parts, [recording]), errors)
    if change is None or any(
        finding.grade == "wrong" and finding.code != "undeclared-load" for finding in found
    ):
        return found
    # The change of the payload is the answer, and explains the errors.
    return [
        replace(each, grade="doubtful") for each in found if each.code == "undeclared-load" and change.whole
    ]


def _window(
    fit: Identification,
    experiment: Experiment,
    recording: Recording,
    window: int,
    rows: tuple[Array, Array, Array, float],
    x: Array,
    bandwidth_hz: float,
    threshold: float,
) -> ExternalTorque:
    """Run the observer along one window of a recording, and detect contacts and payload changes."""
    assert recording.tau is not None  # predict refuses others
    t, torque, std, freedom = rows
    start, stop = recording.windows[window]
    shift = Delay.recorded(fit.delay).samples
    (q, times), tau = align(
        [recording.q[start:stop], recording.t[start:stop, None]],
        without_spikes(recording.tau[start:stop], experiment.signal),
        shift,
    )
    rate = recording.rate_hz
    observer = observe(experiment.robot, x, q, tau, rate, bandwidth_hz=bandwidth_hz)
    observed = observer.torque
    when = times[:, 0]
    settling_s = SETTLING / (2.0 * np.pi * bandwidth_hz)
    settled = when - when[0] > settling_s
    if not settled.any():
        raise ExperimentError(
            f"recording '{recording.name}': an observer of {bandwidth_hz:g} Hz settles in {settling_s:.2g} s, and the recording "
            f"has {when[-1] - when[0]:.2g} s"
        )
    own = NORMAL * np.median(np.abs(observed[settled] - np.median(observed[settled], axis=0)), axis=0)
    predicted = np.stack([np.interp(when, t, column) for column in std.T], axis=1)
    # Errors of the time stamps are proportional to the momentum: they are largest at high speed.
    late = stamp_noise(q, rate) * stamp_gain(rate, bandwidth_hz) * np.abs(observer.momentum)
    limits = threshold * np.hypot(np.maximum(predicted, own), late)
    # The sign of a slow joint's Coulomb friction is unknown, so the observer reports it as an external torque.
    speed = np.abs(np.gradient(q, axis=0)) * rate
    slow = speed < SLOW * speed.max(axis=0)
    limits += low_pass(slow * 2.0 * largest_coulomb(experiment.robot, x), rate, bandwidth_hz)
    seen = np.where(settled[:, None], observed, 0.0)
    change = _payload_change(fit, experiment, recording, window, x)
    if change is not None:
        change = _weighed(fit, experiment, recording, window, x, change)
    shortest = shortest_s(observed[settled], limits[settled], rate, threshold)
    pushes = contacts(when, seen, limits, shortest)
    if change is not None:
        pushes = [contact for contact in pushes if contact.stop_s < change.start_s]
    return ExternalTorque(
        recording=recording.name,
        t=t,
        torque=torque,
        std=std,
        degrees_of_freedom=freedom,
        observer_t=when,
        observed=seen,
        limits=limits,
        contacts=tuple(pushes),
        payload_change=change,
    )


def _payload_change(
    fit: Identification, experiment: Experiment, recording: Recording, window: int, x: Array
) -> PayloadChange | None:
    """Detect a payload change in the rows of a window."""
    robot = experiment.robot
    shift = Delay.recorded(fit.delay).samples
    (part,) = windows_of(
        recording, experiment.signal, delay=shift, spans=recording.windows[window : window + 1]
    )
    beta = robot.base_parameters.project(x)
    system = Model(robot).rows([part], experiment.signal, beta)
    n = robot.n_dof
    rows = system.y.size // n
    residual = (system.y - system.w @ beta).reshape(n, rows).T
    assert fit.uncertainty is not None  # predictions have standard deviations here
    size = np.maximum(fit.uncertainty.joint_std, 1e-9 * np.abs(system.y).max())
    t = np.arange(rows) / rows * (len(part.q) / part.rate_hz)
    first = recording.t[recording.windows[window][0]] + experiment.signal.trim_start / part.rate_hz
    names_of_joints = robot.all_joint_names or tuple(str(joint + 1) for joint in range(n))
    changes = []
    for joint in ends(robot):
        link = None if robot.geometry.in_line else names_of_joints[joint]
        payload = Payload(name=UNNAMED, link=link)
        base = robot.base_parameters.matrix @ payload_columns(robot, payload, experiment.flange)
        names = independent(list(base.T))
        columns = (system.w @ base[:, names]).reshape(n, rows, len(names)).transpose(1, 0, 2)
        change = payload_change(first + t, residual, columns, 1.0 / size, names)
        if change is not None:
            changes.append(replace(change, link=link))
    return max(changes, key=lambda change: change.gain, default=None)


def _weighed(
    fit: Identification,
    experiment: Experiment,
    recording: Recording,
    window: int,
    x: Array,
    change: PayloadChange,
) -> PayloadChange | None:
    """Return a payload change with estimate and standard deviations of `payload_in`; None if it is not significant.

    These include the correlation of the residual and the uncertainty of the robot, which the search ignores.
    """
    start, stop = recording.windows[window]
    first = start + int(np.searchsorted(recording.t[start:stop], change.start_s))
    rest = replace(
        recording, role="fit", payload=NOTHING, own=(), windows=((start if change.whole else first, stop),)
    )
    # With the parameters of this recording, payload included, the estimate is the change.
    here = replace(fit, parameters=x, beta=experiment.robot.base_parameters.project(x), further=None)
    try:
        payload_fit = payload_in(here, replace(experiment, recordings=(rest,)), change.link)
    except DidimError:  # too few rows after the change to estimate it
        return replace(change, std=(0.0,) * len(change.std))
    if not clearly_loaded(payload_fit.ten, payload_fit.std):
        return None
    return replace(change, change=tuple(payload_fit.ten.tolist()), std=tuple(payload_fit.std.tolist()))
