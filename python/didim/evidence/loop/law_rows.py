"""Torques of the declared controller, from the measured motion and its reference. Tested in ``tests/test_verdict_faults.py``.

Along a log the law of a controller (`didim.loop.controller`) can be evaluated without a robot,

    L = g (P e + D v + I z + A ddq_ref) + tau_ff,     e = q_ref - q,     v = w dq_ref - dq,

and what it gives is the measured torque, but for noise, if controller and reference are declared as they were. All signals are
decimated alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._tools.arrays import Array
from ...experiment.experiment import Experiment
from ...experiment.loop import closed_loop
from ...log.recording import Recording
from ...loop.closed_loop import ClosedLoop
from ...signal.filters import differentiate, row_values
from ...signal.noise import row_noise, white_noise
from ...signal.processing import SignalProcessing
from ...signal.spikes import without_lone

LARGEST_LAG = 12
"""Number of samples dropped at the ends of a window, because signals are shifted against each other."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A window of a log with its closed loop.

    Attributes
    ----------
    loop : ClosedLoop
        As declared.
    t : (n,) array
        Times in the window (s).
    q, dq, tau : (n, n_dof) arrays
        Measured positions, their filtered velocities, and measured torques.
    """

    loop: ClosedLoop
    t: Array
    q: Array
    dq: Array
    tau: Array


def stretches_of(experiment: Experiment) -> list[Stretch]:
    """Return the windows of the recordings of a fit, with torques."""
    stretches = []
    for recording in experiment.recordings:
        if recording.role != "fit" or recording.tau is None:
            continue
        stretches += [_stretch(experiment, recording, window) for window in recording.windows]
    return stretches


def _stretch(experiment: Experiment, recording: Recording, window: tuple[int, int]) -> Stretch:
    loop = closed_loop(experiment, recording, window)
    samples = slice(*window)
    q = recording.measured_positions()[samples]
    assert recording.tau is not None
    _, dq, _ = differentiate(q, recording.rate_hz, experiment.signal)
    return Stretch(loop, loop.t[: len(q)], q, dq, without_lone(recording.tau[samples]))


class LawRows:
    """Rows of the law: what it makes of each term, and the measured torque, decimated alike.

    Parameters
    ----------
    experiment : Experiment
        With recordings, a reference and a controller.

    Attributes
    ----------
    measured : (n_rows, n_dof) array
        Measured torques.
    size : (n_dof,) array
        Their norms.
    names : tuple of str
        Terms of the law that are not zero.
    forward : list of (n, n_dof) array
        Torque that the declared controller feeds forward along each stretch.
    """

    def __init__(self, experiment: Experiment) -> None:
        self.experiment, self.signal = experiment, experiment.signal
        self.stretches = stretches_of(experiment)
        self.controller = self.stretches[0].loop.controller
        self.rate_hz = self.stretches[0].loop.rate_hz
        self.measured = self.reduced([stretch.tau for stretch in self.stretches])
        self.size = np.maximum(np.linalg.norm(self.measured, axis=0), np.finfo(float).tiny)
        laws = self.controller.laws
        names = ("kp", "kv", "ki", "acceleration")
        self.names = tuple(name for k, name in enumerate(names) if laws[:, k].any())
        self._columns = [k for k in range(4) if laws[:, k].any()]
        self.forward = [self.controller.fed_forward(stretch.t) for stretch in self.stretches]

    @property
    def declared_lag_s(self) -> float:
        """Delay of a digital controller as records at the log's rate show it (s)."""
        digital = self.controller.digital
        if digital is None:
            return 0.0
        # Between two outputs a record shows the last one; at the log's own rate it shows each as it begins.
        held = 0.5 * max(0.0, digital.sample_time_s - 1.0 / self.rate_hz)
        return digital.sample_time_s * digital.delay_samples + held

    @property
    def declared_velocity_lag_s(self) -> float:
        """Lag of the velocity that a digital controller makes of differences of positions (s)."""
        digital = self.controller.digital
        if digital is None:
            return 0.0
        weights = np.array(digital.smoothing)
        taps = float(weights @ np.arange(len(weights)) / weights.sum()) if weights.sum() else 0.0
        return digital.sample_time_s * (0.5 + taps)

    def terms(self, lag_s: float = 0.0, lead_s: float = 0.0, *, differences: bool = False) -> list[Array]:
        """Torques of each term of each stretch, (n_terms, n, n_dof): law late by `lag_s`, reference earlier by `lead_s`.

        With `differences` the velocity is that of a digital controller at the log's rate, half a sample late.
        """
        late_velocity = 0.5 / self.rate_hz if differences else self.declared_velocity_lag_s
        terms_of_law = []
        g, laws = self.controller.gain, self.controller.laws
        for stretch in self.stretches:
            q_ref, dq_ref, ddq_ref = stretch.loop.reference.at(stretch.t + lead_s)
            dq = (
                stretch.dq
                if late_velocity == 0.0
                else _shifted(stretch.dq[None], stretch.t, late_velocity)[0]
            )
            e, v = q_ref - stretch.q, laws[:, 4] * dq_ref - dq
            z = np.cumsum(laws[:, 5] * e + laws[:, 6] * v, axis=0) * (stretch.t[1] - stretch.t[0])
            every = np.stack([laws[:, k] * s for k, s in enumerate((e, v, z, ddq_ref))])
            terms = g * every[self._columns]
            late = lag_s + self.declared_lag_s
            terms_of_law.append(terms if late == 0.0 else _shifted(terms, stretch.t, late))
        return terms_of_law

    def law(self, terms: Sequence[Array] | None = None, limit: Array | None = None) -> Array:
        """Torque of the law on the rows, (n_rows, n_dof), see `torques`."""
        return self.reduced(self.torques(terms, limit))

    def torques(self, terms: Sequence[Array] | None = None, limit: Array | None = None) -> list[Array]:
        """Torque of the law along each stretch, (n, n_dof), at most a limit, (n_dof,); of the declared terms by default."""
        largest = np.abs(self.controller.gain) * self.controller.saturation
        if limit is not None:
            largest = np.minimum(largest, limit)
        return [
            np.clip(parts.sum(axis=0) + forward, -largest, largest)
            for parts, forward in zip(self.terms() if terms is None else terms, self.forward, strict=True)
        ]

    def columns(self, lag_s: float = 0.0) -> Array:
        """Torque of each term on the rows, late by `lag_s`, (n_terms, n_rows, n_dof)."""
        terms = self.terms(lag_s)
        return np.stack([self.reduced([term[k] for term in terms]) for k in range(len(self._columns))])

    def reduced(self, signals: Sequence[Array]) -> Array:
        """Return signals on the rows, (n_rows, n_dof): ends left out, and decimated as the log is."""
        return np.concatenate(list(_decimated(signals, self.signal)))

    @property
    def noise(self) -> Array:
        """Share of each joint's torque that white noise of torques and encoders leaves on the rows, (n_dof,).

        The law has the noise of the positions times its gains: the real controller has had none of it, or its own.
        """
        of_torque, of_speed = row_noise(self.signal, self.rate_hz)
        spread, encoder = (
            np.median([white_noise(getattr(stretch, key)) for stretch in self.stretches], axis=0)
            for key in ("tau", "q")
        )
        gain, laws = np.abs(self.controller.gain), np.abs(self.controller.laws)
        law = gain * encoder * np.hypot(of_torque * laws[:, 0], of_speed * laws[:, 1])
        size = np.std(self.measured, axis=0)
        return np.asarray(np.hypot(of_torque * spread, law) / np.maximum(size, np.finfo(float).tiny))

    def error(self, torque: Array) -> Array:
        """Measured torque less another one, each joint's mean left out, (n_rows, n_dof)."""
        error = self.measured - torque
        # A constant is an integrator's start, or an offset of the drive: neither gain nor delay.
        return np.asarray(error - error.mean(axis=0))


def with_law_torques(experiment: Experiment) -> Experiment:
    """Return the recordings of a fit with the torques of the declared law along their measured motion in place of measured ones.

    Their residual is the error of the simulated positions, as torques.
    """
    fitted = [recording for recording in experiment.recordings if recording.role == "fit"]
    blank = [replace(recording, tau=np.zeros_like(recording.measured_positions())) for recording in fitted]
    torques = iter(LawRows(replace(experiment, recordings=tuple(blank))).torques())
    made = []
    for recording in blank:
        tau = np.zeros_like(recording.measured_positions())
        for start, stop in recording.windows:
            tau[start:stop] = next(torques)
        made.append(replace(recording, tau=tau))
    return replace(experiment, recordings=tuple(made))


def _decimated(signals: Sequence[Array], signal: SignalProcessing) -> Iterator[Array]:
    for values in signals:
        start, end = max(signal.trim_start, LARGEST_LAG), max(signal.trim_end, LARGEST_LAG)
        yield row_values(values[start : len(values) - end], signal)


def _shifted(terms: Array, t: Array, late_s: float) -> Array:
    """Return signals (n_terms, n, n_dof) late by so many seconds, by straight lines between samples."""
    moved = np.empty_like(terms)
    for k in range(terms.shape[0]):
        for j in range(terms.shape[2]):
            moved[k, :, j] = np.interp(t - late_s, t, terms[k, :, j])
    return moved
