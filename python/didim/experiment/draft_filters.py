"""Filters for a log: the bandwidth of its motion, and the best of three cut-offs on held-out blocks.

The bandwidth is that of the reference, or without one that of the positions, up to the frequency at which their velocity
disappears in the noise by time stamps and encoder. Three cut-offs around it are then compared by the torques that IDIM-LS
predicts for every other block of time, each joint relative to its own torques. The error of the fit is that of a result, of all
joints together. Tested in ``tests/test_init_filters.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted, percent_text, series
from ..errors import DidimError
from ..log.recording import Recording
from ..log.units import POSITION, motor_ratios
from ..regression.least_squares import solve
from ..regression.settings import LeastSquaresSettings
from ..robot.robot import Robot
from ..signal.processing import SignalProcessing
from ..signal.spectrum import contiguous_band, motion_band
from ..signal.window import Window, windows_of
from ..terms.model import Model

APART = 3.0
"""Ratio between neighbouring ones of the three cut-offs."""
HIGHEST_SHARE, LOWEST_SHARE = 0.35, 0.004
"""Bounds of a cut-off, as shares of the sampling rate."""
AS_GOOD = 1.01
"""Ratio to the smallest held-out error within which errors count as equal; the cut-off nearest to the middle one is then
chosen."""

MOTOR_BETTER = 0.5
"""Share of the relative error in degrees that the motor side must leave, for degrees to be given up: chance leaves 0.9."""
USUAL_ERROR = 0.2
"""Relative error up to which a log is as usual: the worst log of an industrial arm has 16 %."""

REST_S = 0.5
"""Shortest rest (s) before or after the motion that is cut off."""
SHORT = 0.1
"""Share of the stretch of motion beside it below which the first or last one is an approach or a way home."""
CUTOFF_TIMES = 20.0
"""Middle cut-off as a multiple of the velocity bandwidth: reversals under friction reach far beyond that bandwidth."""
LEAST_COMPARED_SAMPLES = 400
"""Smallest number of samples for a comparison of cut-offs."""
ROWS_TIMES = 6.0
"""Highest frequency of the rows as a multiple of the velocity bandwidth: enough to identify inertia, gravity and friction."""
LEAST_DECIMATED_ROWS = 200
"""Smallest number of rows per joint after decimation."""
COMPARED_BLOCKS = 20
"""Number of blocks of time; every other one is held out."""
AT_REST = 0.02
"""Share of the largest speed below which the arm is at rest."""


@dataclass(frozen=True)
class Filters:
    """Settings of ``[signal]`` for a log, with the reason.

    Attributes
    ----------
    signal : SignalProcessing
        Cut-off of the positions, equal trimming at both ends, and stages of the parallel filter.
    reason : str
        One sentence.
    errors : tuple of (float, float)
        Cut-offs (Hz) that were compared, with their held-out errors.
    """

    signal: SignalProcessing
    reason: str
    errors: tuple[tuple[float, float], ...] = ()
    error: float | None = None
    """Relative error of IDIM-LS on the whole log with these filters, that of the result of ``identify``; None where unknown."""


def choose_filters(robot: Robot, recordings: Sequence[Recording], *, comparable: bool) -> Filters:
    """Choose the filters of a log.

    Parameters
    ----------
    robot : Robot
        Robot of the log.
    recordings : sequence of Recording
        At least one, joint side.
    comparable : bool
        Whether the torques are in N.m or N, which permits a comparison of cut-offs by predicted torques.
    """
    rate = min(recording.rate_hz for recording in recordings)
    samples = min(stop - start for recording in recordings for start, stop in recording.windows)
    band, source = _band(recordings)
    middle = CUTOFF_TIMES * band if band > 0.0 else 0.04 * rate
    middle = min(max(middle, LOWEST_SHARE * APART * rate), HIGHEST_SHARE * rate / APART)
    cutoffs = [float(f"{middle * factor:.2g}") for factor in (1.0 / APART, 1.0, APART)]
    moves = (
        f"{source} {band:.3g} Hz" if band > 0.0 else "the log is too short to detect the end of the motion"
    )
    stages = _stages(band, cutoffs[1], rate, samples)

    def signal(cutoff: float, slowest: float) -> SignalProcessing:
        trim = int(min(round(2.0 * rate / slowest), samples // 20))
        return SignalProcessing(cutoff_hz=cutoff, trim_start=trim, trim_end=trim, decimation=stages)

    plain = signal(cutoffs[1], cutoffs[1])
    if not comparable or samples < LEAST_COMPARED_SAMPLES:
        return Filters(plain, f"{moves}; cut-offs were not compared")
    # All cut-offs are compared on the same rows: trimmed for the lowest, with equal decimation.
    compared = [
        (cutoff, _held_out_error(robot, recordings, signal(cutoff, min(cutoffs)))) for cutoff in cutoffs
    ]
    errors = tuple((cutoff, error) for cutoff, error in compared if error is not None)
    if not errors:
        return Filters(plain, f"{moves}; cut-offs could not be compared")
    best = min(error for _, error in errors)
    good = [cutoff for cutoff, error in errors if error <= AS_GOOD * best]
    cutoff = min(good, key=lambda value: abs(np.log(value / middle)))
    tried = _row([f"{value:g}" for value, _ in errors])
    left = _row([f"{100.0 * error:.3g}" for _, error in errors])
    reason = f"{moves}; held-out torque error, rms over joints, {left} % at {tried} Hz"
    chosen = signal(cutoff, cutoff)
    return Filters(chosen, reason, errors, relative_error(robot, recordings, chosen))


def motor_ratio(
    robot: Robot, recordings: Sequence[Recording], signal: SignalProcessing, error: float
) -> float | None:
    """Return the gear ratio, common to all joints, that explains positions of motors which are read in degrees.

    None where no ratio leaves less than `MOTOR_BETTER` of the relative error `error` of degrees. A fit scales torques as it likes,
    so the ratio is that of the sines of gravity and of the coupling between joints.
    """
    from scipy.optimize import minimize_scalar

    try:
        parts = [part for recording in recordings for part in windows_of(recording, signal)]
    except DidimError:
        return None

    def left(ratio: float) -> float:
        factor = 1.0 / (POSITION["deg"] * ratio)
        moved = [
            replace(part, q=factor * part.q, dq=factor * part.dq, ddq=factor * part.ddq) for part in parts
        ]
        found = _relative_error(robot, moved, signal)
        return math.inf if found is None else found

    grid = motor_ratios()
    best = int(np.argmin([left(ratio) for ratio in grid]))
    if not 0 < best < len(grid) - 1:
        return None
    bounds = (grid[best - 1], grid[best + 1])
    optimum = minimize_scalar(left, bounds=bounds, method="bounded", options={"xatol": 1e-3 * grid[best]})
    if not optimum.fun < MOTOR_BETTER * error:
        return None
    ratio = float(f"{optimum.x:.3g}")
    whole = float(round(ratio))
    return whole if abs(whole - ratio) < 0.01 * ratio else ratio


def _row(numbers: Sequence[str]) -> str:
    return f"{series(numbers[:-1], 20)} and {numbers[-1]}" if len(numbers) > 1 else numbers[0]


def _stages(band: float, cutoff: float, rate: float, samples: int) -> tuple[int, ...]:
    """Return the stages of the parallel filter, down to a few bandwidths, which averages friction missing in the model."""
    wanted = 0.5 * rate / (ROWS_TIMES * band) if band > 0.0 else 0.5 * rate / cutoff
    factor = int(min(wanted, samples / LEAST_DECIMATED_ROWS))
    stages: list[int] = []
    # Stages of at most 10, because a single filter for more would be unsound.
    while factor >= 2:
        stage = min(factor, 10)
        stages.append(stage)
        factor //= stage
    return tuple(stages)


def _band(recordings: Sequence[Recording]) -> tuple[float, str]:
    """Return the bandwidth of the motion (Hz) and its source, as the beginning of a sentence."""
    if all(recording.q_ref is not None for recording in recordings):
        references = [replace(log, q=log.q_ref, dq=None) for log in recordings if log.q_ref is not None]
        # A reference may be jittered and rounded too, which spoils its spectrum in long pieces.
        band = max(min(motion_band(log), contiguous_band(log) or math.inf) for log in references)
        if band > 0.0:
            return band, "the reference moves below"
    measured = max(contiguous_band(recording) for recording in recordings)
    if measured > 0.0:
        return measured, "the motion stands out of the noise below"
    return max(motion_band(recording) for recording in recordings), "the motion ends near"


def relative_error(robot: Robot, recordings: Sequence[Recording], signal: SignalProcessing) -> float | None:
    """Return the relative error of IDIM-LS on recordings, that of its result; None where there is none."""
    try:
        parts = [part for recording in recordings for part in windows_of(recording, signal)]
    except DidimError:
        return None
    return _relative_error(robot, parts, signal)


def _relative_error(robot: Robot, parts: Sequence[Window], signal: SignalProcessing) -> float | None:
    try:
        system = Model(robot).rows(parts, signal)
        fit = solve(system, LeastSquaresSettings(uncertainty="white"))  # the errors alone are used
    except DidimError:
        return None
    error = system.relative_error(fit.residual)
    return error if math.isfinite(error) else None


def _held_out_error(robot: Robot, recordings: Sequence[Recording], signal: SignalProcessing) -> float | None:
    """Return the torque error on every other block, by IDIM-LS on the blocks between, or None.

    It is the root mean square of the joints' relative errors: large joints alone would choose a cut-off that wrists cannot use.
    """
    try:
        parts = [part for recording in recordings for part in windows_of(recording, signal)]
        system = Model(robot).rows(parts, signal)
    except DidimError:
        return None
    held = np.zeros(len(system.y), dtype=bool)
    for block in system.blocks:
        rows = block.rows.stop - block.rows.start
        held[block.rows] = (COMPARED_BLOCKS * np.arange(rows)) // max(rows, 1) % 2 == 1
    # Least squares with normalised rows per joint; unidentifiable parameters stay small.
    weights = np.zeros(len(system.y))
    for joint, size in zip(system.joints, system.norms(np.where(held, 0.0, system.y)), strict=True):
        weights[joint] = ~held[joint] / max(size, np.finfo(float).tiny)
    w = system.w * weights[:, None]
    columns = np.maximum(np.linalg.norm(w, axis=0), np.finfo(float).tiny)
    beta = np.linalg.lstsq(w / columns, system.y * weights, rcond=1e-6)[0]
    residual = system.y - system.w @ (beta / columns)
    error, size = (system.norms(np.where(held, values, 0.0)) for values in (residual, system.y))
    shares = error / np.maximum(size, np.finfo(float).tiny)
    return float(np.sqrt(np.mean(shares**2))) if np.isfinite(shares).all() else None


def sentence_of(filters: Filters) -> str:
    """Return the sentence of ``didim init`` on the choice and its reason."""
    signal = filters.signal
    stages = f", decimation by {math.prod(signal.decimation)}" if signal.decimation else ""
    return f"cut-off {signal.cutoff_hz:g} Hz{stages}, {counted(signal.trim_start, 'sample')} trimmed: {filters.reason}"


def error_sentence(error: float, name: str) -> str:
    """Return the sentence on the relative error that `identify` will print for the experiment file `name`."""
    text = f"relative error of the fit (idim-ls): {percent_text(100.0 * error)} %"
    if error <= USUAL_ERROR:
        return text
    return f"{text}, which is not usual (below {100.0 * USUAL_ERROR:.0f} %): `didim check {name}` looks for the cause"


def moving_window(q: Array, times: Array, rate_hz: float) -> tuple[float, float] | None:
    """Return begin and end (s) of all motion, to tenths of a second inside it, or None if the arm rests neither before nor after.

    Rests between motions stay: whether a step or a wave follows one, it is part of the log. The approach to the start of a long
    motion and the way home after it are left out.

    Parameters
    ----------
    q : (n_samples, n_dof) array
        Positions, in any unit.
    times : (n_samples,) array
        Time of each sample from the first (s).
    rate_hz : float
        Samples per second.
    """
    span = max(1, round(0.1 * rate_hz))
    if len(q) < 4 * span:
        return None
    speed = np.abs(q[span:] - q[:-span])
    scale = speed.max(axis=0)
    moving = np.any(speed > AT_REST * np.where(scale > 0.0, scale, np.inf), axis=1)
    places = np.flatnonzero(moving)
    if not places.size:
        return None
    breaks = np.flatnonzero(np.diff(places) > round(REST_S * rate_hz))
    starts, stops = places[np.r_[0, breaks + 1]], places[np.r_[breaks, len(places) - 1]]
    lengths = stops - starts
    # Steps beside steps are no approach.
    approach = len(lengths) > 1 and lengths[0] < SHORT * lengths[1]
    home = len(lengths) > 1 and lengths[-1] < SHORT * lengths[-2]
    first, last = int(starts[int(approach)]), int(stops[-1 - int(home)])
    start, stop = float(times[first]), float(times[min(last + span, len(times) - 1)])
    before, after = start, float(times[-1]) - stop
    if max(before, after) < REST_S:
        return None
    start = math.ceil(10.0 * start) / 10.0 if before >= REST_S else 0.0
    stop = math.floor(10.0 * stop) / 10.0 if after >= REST_S else math.floor(1e3 * times[-1]) / 1e3
    return start, stop
