"""Stretches of a log in which something holds a joint: the end of its range, or a contact.

A joint that stays, while its servo pulls it with a multiple of the torque that moves it elsewhere in the log, is held by a force
that the model lacks: drive, gravity, inertia and friction do not explain it. Such stretches are left out, and the limb starts anew
after each. Tested in ``tests/test_stops.py``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..._tools.arrays import Array, true_ranges
from ...errors import FitError
from ...model.dynamics import gravity, inertia_matrix
from ...model.limbs import Limb
from ...result.finding import Finding
from ...signal.noise import encoder_step, white_noise
from .columns import Values

if TYPE_CHECKING:
    from ...experiment.experiment import Experiment

LASTS_S, PERIODS = 0.2, 0.5
"""Shortest time (s) that a joint is held, and the same in periods of the servo's oscillation: a free joint has followed by then."""
PULL = 2.5
"""Smallest torque of the drive that counts as a pull, as a multiple of the median one that moves the joint. Simulated arms, legs
and the Go2 log chose it; on joints that move freely nothing beyond 1.6 lasts."""
FOLLOWS = 0.25
"""Share of the distance, pull over kp, that a free joint covers at least in that time."""
AT_END = 0.4
"""Time and pull at the end of a joint's range that count, as shares of those elsewhere."""
NEAR = 0.03
"""Distance from the end of the range, as a share of the range, at which it is the end that holds a joint."""
PUSH_S, FEWEST_PUSH = 0.5, 16
"""Duration (s) of the blocks whose errors are compared, and the fewest blocks."""
PUSHED, MOST_PUSHED, STRONGEST = 3.5, 0.4, 0.7
"""Errors of a block over the median of a joint's blocks, from which something pushes the joint; the largest share of such blocks;
and those of a block over the largest, above which it is left out at once. The largest ratio to the median is 2.9 on the Go2 log and
1.9 on simulated arms without pushes; both chose 3.5."""
NOISY = 2.0
"""Smallest errors of a block, over the noise of the encoder, that are more than noise."""
PAD_S, LEAST_S = 0.06, 1.0
"""Time (s) left out on both sides, and the shortest stretch (s) that is used."""
LEAST_SHARE = 0.2
"""Smallest share of a limb's log that must be left: friction of a joint that mostly presses on something is not known."""


@dataclass(frozen=True, eq=False)
class Stop:
    """One joint that is held along a stretch of a recording.

    Attributes
    ----------
    joint, recording : int
        Which, from 0.
    begin, end : int
        Samples of the recording.
    limit : float or None
        End of the joint's range (rad or m) that holds it; None for a contact elsewhere.
    pushed : bool
        Whether the errors of a fit show it.
    """

    joint: int
    recording: int
    begin: int
    end: int
    limit: float | None
    pushed: bool = False

    def meets(self, other: Stop) -> bool:
        """Whether two stretches of a joint overlap."""
        same = (self.joint, self.recording) == (other.joint, other.recording)
        return same and self.begin < other.end and other.begin < self.end


def stops_of(experiment: Experiment, limbs: Sequence[Limb], values: Values) -> list[Stop]:
    """Return all stretches in which something holds a joint."""
    stops = []
    for number, recording in enumerate(experiment.recordings):
        if recording.q_ref is None:
            continue
        measured, rate = recording.measured_positions(), recording.rate_hz
        noise = np.maximum(3.0 * white_noise(measured), 2.0 * encoder_step(measured))
        for (begin, end), limb in itertools.product(recording.windows, limbs):
            at = list(limb.joints)
            q, r = measured[begin:end][:, at], recording.q_ref[begin:end][:, at]
            pull, lasts_s = _pull(limb, values.along(number), q, r, rate)
            for index, joint in enumerate(at):
                held = _held(
                    q[:, index],
                    r[:, index],
                    pull[:, index],
                    math.ceil(lasts_s[index] * rate),
                    float(noise[joint]),
                    experiment.robot.limits[joint].position,
                )
                stops += [Stop(joint, number, begin + a, begin + b, limit) for a, b, limit in held]
    return stops


def _pull(limb: Limb, values: Values, q: Array, r: Array, rate: float) -> tuple[Array, Array]:
    """Return the torque of the drives less gravity, over kp (rad or m), (n_samples, n_joints), and the times (s) to follow."""
    at, q = list(limb.joints), np.ascontiguousarray(q)
    x = values.x[limb.indices]
    kp, kv, most = (values.drive[key][at] for key in ("kp", "kv", "saturation"))
    kp = np.maximum(kp, np.finfo(float).tiny)
    drive = np.clip(kp * (r - q) - kv * np.gradient(q, axis=0) * rate, -most, most)
    inertia = np.diag(inertia_matrix(limb.robot, q[:1], x)[0])
    lasts = np.maximum(2.0 * np.pi * PERIODS * np.sqrt(inertia / kp), 2.0 * kv / kp)
    return (drive - gravity(limb.robot, q, x)) / kp, np.maximum(lasts, LASTS_S)


def _held(
    q: Array, r: Array, pull: Array, count: int, noise: float, limits: tuple[float, float] | None
) -> list[tuple[int, int, float | None]]:
    """Return stretches of one joint, (begin, end, end of the range), by the pull of its drive over kp (rad or m).

    Only at an end of the range gravity alone may hold it; elsewhere the command `r` is ahead of it, for the mount may be wrong. A
    joint whose command rests stands by its own friction.
    """
    speed, ahead = np.gradient(q), r - q
    moving = np.abs(speed) > 0.5 * np.sqrt(np.mean(speed**2))
    if count >= len(q) or not moving.any():
        return []
    usual = max(float(np.median(np.abs(pull[moving]))), noise)
    if np.ptp(r) < PULL * usual:
        return []
    stretches = []
    for side in (-1.0, 1.0):
        held = _pulled(side * q, np.minimum(side * pull, side * ahead), count, PULL * usual)
        end = math.inf if limits is None else side * limits[0 if side < 0.0 else 1]
        near_end = math.inf if limits is None else end - NEAR * (limits[1] - limits[0])
        short = _pulled(side * q, side * pull, math.ceil(AT_END * count), AT_END * PULL * usual)
        held |= short & (side * q > end - noise)
        near = held & (side * q > near_end)
        if near.any():  # it does end there, so each touch of it counts
            held |= side * q > min(end, float(np.median(side * q[near]))) - noise
        last = 0
        for a, b in true_ranges(held):
            if b <= last:
                continue
            # It stays there before and after the pull too; what goes on beyond that place is free.
            low, high = (float(of(side * q[a:b])) for of in (np.min, np.max))
            stays = np.abs(side * q - (low + high) / 2.0) < (high - low) / 2.0 + noise
            a = max(last, a - int(np.argmin(np.append(stays[:a][::-1], False))))
            b += int(np.argmin(np.append(stays[b:], False)))
            at_end = bool(np.max(side * q[a:b]) > near_end)
            stretches.append((a, b, side * end if at_end else None))
            last = b
    return stretches


def _pulled(q: Array, pull: Array, count: int, least: float) -> NDArray[np.bool_]:
    """Return samples of the stretches of `count` steps along which a pull lasts and the joint does not follow it."""
    lasting = np.lib.stride_tricks.sliding_window_view(pull, count + 1).min(axis=1)
    held = np.zeros(len(q), dtype=bool)
    for k in np.flatnonzero((lasting > least) & (q[count:] - q[:-count] < FOLLOWS * lasting)):
        held[k : k + count + 1] = True
    return held


def pushed_stretches(
    errors: Sequence[Array],
    ahead: Sequence[Array],
    noise: Sequence[float],
    rates_hz: Sequence[float],
    strongest: float,
) -> list[list[tuple[int, int]]]:
    """Return stretches of one joint whose errors are far beyond those of the rest, (begin, end) of each rollout.

    Parameters
    ----------
    errors, ahead : sequence of (n_samples,) array
        Errors of simulated positions, and commands less measured positions (rad or m): a fast motion has larger ones of both.
    noise : sequence of float
        Noise of the encoders (rad or m): errors of its size do not show a push.
    rates_hz : sequence of float
        Samples per second of the rollouts.
    strongest : float
        Smallest errors of such a stretch, over the largest of all.
    """
    sizes = [math.ceil(PUSH_S * rate) for rate in rates_hz]
    e, a = ([_blocks(x, size) for x, size in zip(rows, sizes, strict=True)] for rows in (errors, ahead))
    usual = float(np.median(np.concatenate(a)))
    shares = [one / np.maximum(other, usual) for one, other in zip(e, a, strict=True)]
    for share in shares:  # the start of a rollout is a guess
        share[0] = 0.0
    every = np.concatenate([share[1:] for share in shares])
    if len(every) < FEWEST_PUSH:
        return [[] for _ in errors]
    limit = PUSHED * np.median(every)
    if not np.mean(every > limit) <= MOST_PUSHED:
        return [[] for _ in errors]
    # The strongest pushes are left out first, because they raise the errors of other blocks.
    limit = max(limit, strongest * np.max(every))
    stretches = []
    for share, one, quiet, size, rows in zip(shares, e, noise, sizes, errors, strict=True):
        share[one < NOISY * quiet] = 0.0
        # The blocks beside one have the ends of a push, and what it leaves.
        wide = np.convolve(share > limit, [1, 1, 1])[1:-1] > 0
        stretches.append(
            [(b * size, len(rows) if c == len(share) else c * size) for b, c in true_ranges(wide)]
        )
    return stretches


def _blocks(values: Array, size: int) -> Array:
    """Return root mean squares of blocks of so many samples, the last with the rest."""
    begins = np.arange(max(1, len(values) // size)) * size
    counts = np.diff([*begins, len(values)])
    return np.asarray(np.sqrt(np.add.reduceat(values**2, begins) / counts))


def free_stretches(
    stops: Sequence[Stop], limb: Limb, recording: int, window: tuple[int, int], rate_hz: float
) -> list[tuple[int, int]]:
    """Return the stretches of a window in which nothing holds a joint of a limb; the window itself without stops."""
    begin, end = window
    free, pad = np.ones(end - begin, dtype=bool), math.ceil(PAD_S * rate_hz)
    for stop in stops:
        if stop.recording == recording and stop.joint in limb.joints:
            free[max(stop.begin - pad - begin, 0) : max(stop.end + pad - begin, 0)] = False
    if free.all():
        return [window]
    return [(begin + a, begin + b) for a, b in true_ranges(free) if b - a >= LEAST_S * rate_hz]


def refuse_little(experiment: Experiment, stops: Sequence[Stop], limb: Limb, used: int, whole: int) -> None:
    """Refuse a limb of which too few samples are left.

    Raises
    ------
    FitError
        It names the joint that is held for most of the time.
    """
    if used >= LEAST_SHARE * whole:
        return
    own_stops = [stop for stop in stops if stop.joint in limb.joints]
    times = {
        joint: sum(stop.end - stop.begin for stop in own_stops if stop.joint == joint)
        for joint in limb.joints
    }
    worst = max(times, key=lambda joint: times[joint])
    rate = experiment.recordings[own_stops[0].recording].rate_hz
    raise FitError(
        f"{experiment.name}: {experiment.robot.joint_label(worst)} is held by the end of its range or a contact for "
        f"{times[worst] / rate:.3g} s, and too little is left: log it moving freely, or lock it (--lock)"
    )


def findings_of(experiment: Experiment, stops: Sequence[Stop]) -> list[Finding]:
    """Return a finding for each joint that something holds."""
    findings, several = [], len(experiment.recordings) > 1
    for joint, pushed in sorted({(stop.joint, stop.pushed) for stop in stops}):
        own_stops = [stop for stop in stops if (stop.joint, stop.pushed) == (joint, pushed)]
        own_stops.sort(key=lambda stop: (stop.recording, stop.begin))
        rates = [experiment.recordings[s.recording].rate_hz for s in own_stops]
        names = tuple(dict.fromkeys(experiment.recordings[s.recording].name for s in own_stops))
        findings.append(
            Finding(
                code="held",
                grade="note",
                joints=(joint + 1,),
                recordings=names,
                value=sum((s.end - s.begin) / rate for s, rate in zip(own_stops, rates, strict=True)),
                facts={
                    "name": experiment.robot.joint_label(joint),
                    "limits": sorted({s.limit for s in own_stops if s.limit is not None}),
                    "pushed": pushed,
                    "contact": any(s.limit is None for s in own_stops),
                    "times": [
                        [s.begin / rate, s.end / rate] for s, rate in zip(own_stops, rates, strict=True)
                    ],
                    "of": [experiment.recordings[s.recording].name for s in own_stops] if several else [],
                },
            )
        )
    return findings
