"""Contacts and payload changes, detected in the residual torques. Tested in ``tests/test_residual.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array, true_ranges
from ..._tools.words import series
from ...evidence.applied.load import CLEAR_SIGMA
from ...robot.rigid_body import INERTIAL

SHORTEST_S = 0.004
"""Shortest contact (s), whatever the noise."""
CLEAR_SHARE = 0.3
"""Share of the squared residual after the change that it must explain."""
SOKAL = 5.0
"""Number of lags, in correlation times, over which an autocorrelation is summed (Sokal, 1997): further lags only add noise."""
APART_S = 0.15
"""Gap (s) below which two events are one."""
HIGH = 1.5
"""Torque, as a multiple of its limit, from which it is a contact of any duration: at 6 sigma, noise exceeds the limit by a few
percent."""
CHANGE_TIMES = 400
"""Number of candidate times of a payload change."""
CLEAR_PAYLOAD_GAIN = 60.0
"""Reduction of the squared weighted residual by a payload change, which has ten parameters, from which it is reported."""


@dataclass(frozen=True)
class Contact:
    """An interval with an external torque.

    Attributes
    ----------
    start_s, stop_s : float
        Times in the recording (s).
    joints : tuple of int
        Joints with the torque, from 1, the most significant first.
    peak : tuple of float
        Largest torque of each of them (N.m or N).
    """

    start_s: float
    stop_s: float
    joints: tuple[int, ...]
    peak: tuple[float, ...]

    def __str__(self) -> str:
        felt = series(
            f"joint {joint} {peak:+.3g}" for joint, peak in zip(self.joints, self.peak, strict=True)
        )
        return f"external torque from {self.start_s:.3f} to {self.stop_s:.3f} s: {felt} N.m or N"


@dataclass(frozen=True)
class PayloadChange:
    """A payload that changes at a time.

    Attributes
    ----------
    start_s : float
        Time (s).
    whole : bool
        Whether the payload differs from the model in the whole window.
    change : tuple of 10 float
        Change of ``XX XY XZ YY YZ ZZ MX MY MZ M`` about the flange; zero for unidentifiable ones.
    std : tuple of 10 float
        Standard deviations.
    gain : float
        Squared residual (standard deviations) that it explains.
    link : str or None
        Joint whose link carries it, as `didim.Payload` has it; None for the last of joints in a line.
    """

    start_s: float
    whole: bool
    change: tuple[float, ...]
    std: tuple[float, ...]
    gain: float
    link: str | None = None

    def __str__(self) -> str:
        mass, sigma = self.change[9], self.std[9]
        when = "in the whole window" if self.whole else f"at {self.start_s:.2f} s"
        shown = f"mass {mass:+.3g} +- {sigma:.2g} kg, " if sigma > 0.0 else ""
        moments = ", ".join(f"{value:+.3g}" for value in self.change[6:9])
        where = "" if self.link is None else f" of joint {self.link}"
        return f"the payload{where} differs from the model {when}: {shown}first moments {moments} kg.m"


def shortest_s(torque: Array, limits: Array, rate_hz: float, threshold: float) -> Array:
    """Return the shortest time (s) beyond its limit that a joint's noise does not explain, (n_dof,).

    Noise with a correlation time T that exceeds ``threshold`` standard deviations does so for about
    ``sqrt(2 pi) T / threshold`` (Rice's formula for a Gaussian process). T is the integral of the autocorrelation, in
    Sokal's window: 0.04 s for white noise in an observer of 8 Hz, some tenths of a second for the errors of a model. A push of
    duration D in an otherwise quiet residual has T <= D, so it stays detectable.
    """
    values = np.clip(torque, -limits, limits)
    values = values - values.mean(axis=0)
    lengths = np.zeros(values.shape[1])
    for joint, column in enumerate(values.T):
        spectrum = np.abs(np.fft.rfft(column, 2 * len(column))) ** 2
        correlation = np.fft.irfft(spectrum)[: len(column)]
        if correlation[0] > 0.0:
            times = 2.0 * np.cumsum(correlation) / correlation[0] - 1.0
            wide = np.flatnonzero(np.arange(len(times)) >= SOKAL * times)
            lengths[joint] = times[wide[0]] if wide.size else times[-1]
    return np.asarray(np.sqrt(2.0 * np.pi) * lengths / rate_hz / threshold)


def contacts(t: Array, torque: Array, limits: Array, shortest: Array | float = SHORTEST_S) -> list[Contact]:
    """Find intervals in which torques exceed their limits for longer than noise does, or by far.

    Parameters
    ----------
    t : (n_samples,) array
        Times (s).
    torque, limits : (n_samples, n_dof) arrays
        External torques, and their limits (N.m or N).
    shortest : float or (n_dof,) array
        Shortest time (s) of a joint slightly beyond its limit.
    """
    step = float(np.median(np.diff(t)))
    over = np.abs(torque) > limits
    merged: list[tuple[int, int]] = []
    for start, stop in true_ranges(np.asarray(over.any(axis=1))):
        if merged and t[start] - t[merged[-1][1] - 1] < APART_S:
            merged[-1] = (merged[-1][0], stop)
        else:
            merged.append((start, stop))
    touched = []
    for start, stop in merged:
        if t[stop - 1] - t[start] < SHORTEST_S:
            continue
        clear = np.max(np.abs(torque[start:stop]) / limits[start:stop], axis=0)
        lasting = over[start:stop].sum(axis=0) * step >= np.maximum(shortest, SHORTEST_S)
        if not (lasting | (clear >= HIGH)).any():
            continue
        joints = [int(joint) for joint in np.argsort(-clear) if clear[joint] > 1.0]
        places = [start + int(np.argmax(np.abs(torque[start:stop, joint]))) for joint in joints]
        touched.append(
            Contact(
                start_s=float(t[start]),
                stop_s=float(t[stop - 1]),
                joints=tuple(joint + 1 for joint in joints),
                peak=tuple(float(torque[k, joint]) for k, joint in zip(places, joints, strict=True)),
            )
        )
    return touched


def payload_change(
    t: Array, residual: Array, columns: Array, weights: Array, names: Sequence[int]
) -> PayloadChange | None:
    """Find the time from which another payload explains the residual, or None.

    Parameters
    ----------
    t : (n_rows,) array
        Times (s).
    residual : (n_rows, n_dof) array
        Measured less predicted torque (N.m or N).
    columns : (n_rows, n_dof, k) array
        Torques per unit of each parameter of a payload.
    weights : (n_dof,) array
        Reciprocal size of each joint's residual with a correct model.
    names : sequence of int
        Indices of the k parameters among the ten.
    """
    rows = len(t)
    a = columns * weights[None, :, None]
    r = residual * weights
    size = np.sqrt(np.einsum("tjk,tjk->k", a, a))
    if not size.any():  # so large a residual hides every parameter of a load
        return None
    a = a / np.where(size > 0.0, size, 1.0)
    grams = np.cumsum(np.einsum("tjk,tjl->tkl", a, a)[::-1], axis=0)[::-1]
    scores = np.cumsum(np.einsum("tjk,tj->tk", a, r)[::-1], axis=0)[::-1]
    squares = np.cumsum(np.sum(r**2, axis=1)[::-1])[::-1]
    # Ten parameters for only the last rows would fit anything.
    last = rows - max(20, rows // 20)
    places = np.unique(np.linspace(0, max(0, last), CHANGE_TIMES).astype(int))
    ridge = 1e-9 * np.trace(grams[0]) / grams.shape[1] * np.eye(grams.shape[1])
    solutions = np.linalg.solve(grams[places] + ridge, scores[places][:, :, None])[:, :, 0]
    gains = np.einsum("ck,ck->c", solutions, scores[places])
    best = int(np.argmax(gains))
    column, theta = int(places[best]), solutions[best]
    noise = max((squares[column] - gains[best]) / max(1, (rows - column) * residual.shape[1]), 1.0)
    std = np.sqrt(noise * np.diag(np.linalg.inv(grams[column] + ridge)))
    clear = np.abs(theta) > CLEAR_SIGMA * std
    # A payload stays while a contact ends: the later half of the rows after the change must support it too.
    half = column + (rows - column) // 2
    later = 2.0 * theta @ scores[half] - theta @ grams[half] @ theta
    known = [k for k, index in enumerate(names) if INERTIAL[index] in ("M", "MX", "MY", "MZ")]
    if (
        gains[best] < CLEAR_PAYLOAD_GAIN * noise
        or gains[best] < CLEAR_SHARE * squares[column]
        or later < CLEAR_SHARE * squares[half]
        or not clear[known].any()
    ):
        return None
    change, spread = np.zeros(10), np.zeros(10)
    scale = np.where(size > 0.0, size, np.inf)
    change[list(names)], spread[list(names)] = theta / scale, std / scale
    return PayloadChange(
        start_s=float(t[column]),
        whole=column <= rows // 50,
        change=tuple(change.tolist()),
        std=tuple(spread.tolist()),
        gain=float(gains[best]),
    )
