"""The simulated robot beside the measured one: positions, torques, and IDIM-LS. Tested in ``tests/test_verdict_simulated.py``.

From the last simulation of a method follow, of each joint,

    p = |q_s - q| / |q - mean q|,    s = tau_s^T tau / |tau_s|^2,    r = |tau - tau_s| / |tau - W beta_LS|

where q and tau are measured, s are simulated, and the torques are decimated as the log is, their means left out. With the right
model p is that of encoder noise, s is 1, and r is 1, since IDIM-LS explains what any model of the same robot can.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..._tools.arrays import Array, rms
from ...errors import DidimError
from ...experiment.experiment import Experiment
from ...result.finding import Finding, Grade
from ...signal.filters import row_values
from ...signal.noise import white_noise
from ...signal.processing import SignalProcessing
from ..gain_check import INTERVALS
from ..thresholds import NEGLIGIBLE
from .law import declared_loop, made_up

POSITION = 0.005
"""Largest error of the simulated motion, as a share of the joint's motion: correct loops have up to 0.01 %, or 0.1 % with a
tight filter, and wrong ones 0.3 to 60 %."""
ASTRAY = 0.1
"""Error of the simulated motion, as a share of the joint's motion, from which the result is wrong."""
SLOPE = 0.005
"""Smallest deviation of the slope from 1 that is reported: correct results of CLOE reach 0.0026, gains that are 1 % off cause
0.01."""
SLOPE_SIGMAS = 6.0
"""Smallest deviation of the slope that is reported, in standard deviations over intervals of time."""
WORSE = 1.5
"""Ratio of the error to that of IDIM-LS from which it is reported: correct results reach 1.06, and a gain 10 % off 1.9."""


@dataclass(frozen=True, eq=False)
class MotionComparison:
    """Comparison of the simulated with the measured motion.

    Attributes
    ----------
    position : (n_dof,) array
        p, the share of a joint's motion that the simulated one misses; zero without measured positions.
    slope, sigma : (n_dof,) arrays
        s and its standard deviation.
    error, torque : (n_dof,) arrays
        Root mean squares of ``tau - tau_s`` and of the measured torque (N.m or N), on the rows of the fit.
    """

    position: Array
    slope: Array
    sigma: Array
    error: Array
    torque: Array

    def record(self) -> dict[str, list[float]]:
        """Return all fields, as JSON knows them; for the settings of a result."""
        return {key: values.tolist() for key, values in vars(self).items()}

    @classmethod
    def of_record(cls, record: Mapping[str, Sequence[float]]) -> MotionComparison:
        """Return what `record` wrote."""
        return cls(**{key: np.array(values, dtype=np.float64) for key, values in record.items()})


Piece = tuple[Array | None, Array, Array, Array]
"""Positions, measured (None where there are none) and simulated, and torques, measured and simulated, of a window, (n, n_dof)."""


def compare_motions(signal: SignalProcessing, pieces: Sequence[Piece]) -> MotionComparison:
    """Compare the simulated with the measured motion.

    Parameters
    ----------
    signal : SignalProcessing
        Whose decimation the torques get.
    pieces : sequence of Piece
        Of each window, on the samples that are kept.
    """
    tau = np.concatenate([row_values(torque, signal) for _, _, torque, _ in pieces])
    tau_s = np.concatenate([row_values(torque, signal) for _, _, _, torque in pieces])
    n = tau.shape[1]
    missed, moved = np.zeros(n), np.zeros(n)
    for q, q_s, _, _ in pieces:
        if q is not None:
            # The simulated robot need not follow the noise of the encoder.
            noise = white_noise(q) if len(q) > 5 else np.zeros(n)
            missed += np.maximum(np.sum((q_s - q) ** 2, axis=0) - len(q) * noise**2, 0.0)
            moved += np.sum((q - q.mean(axis=0)) ** 2, axis=0)
    position = np.sqrt(missed / np.maximum(moved, np.finfo(float).tiny))
    slope, sigma = _slope(tau_s, tau)
    return MotionComparison(position, slope, sigma, rms(tau - tau_s), rms(tau))


def _slope(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the slope of y on x of each column, and its standard deviation over intervals of time."""
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    size = np.maximum(np.sum(x**2, axis=0), np.finfo(float).tiny)
    slope = np.sum(x * y, axis=0) / size
    scores = [part.sum(axis=0) for part in np.array_split(x * (y - slope * x), INTERVALS)]
    m = len(scores)
    return slope, np.asarray(np.sqrt(m / (m - 1) * np.sum(np.square(scores), axis=0)) / size)


def simulated_findings(
    experiment: Experiment, comparison: MotionComparison, least: Callable[[], Array], *, doubted: bool
) -> list[Finding]:
    """Return what the simulated robot of a converged result says against it.

    Parameters
    ----------
    experiment : Experiment
        Experiment of the result.
    comparison : MotionComparison
        Simulated and measured motion.
    least : callable
        Returns the errors of IDIM-LS.
    doubted : bool
        Whether other evidence is against it: IDIM-LS is run then, and after any finding.
    """
    findings = [*motion_findings(experiment, comparison), *slope_findings(comparison)]
    if findings or doubted:
        try:
            findings += worse_findings(comparison, least())
        except DidimError:  # a log that IDIM-LS cannot solve
            return findings
    return findings


def motion_findings(experiment: Experiment, comparison: MotionComparison) -> list[Finding]:
    """Return a finding where the simulated motion is not the measured one."""
    joints = np.flatnonzero(comparison.position > POSITION)
    if not len(joints):
        return []
    worst = float(comparison.position.max())
    real = declared_loop(experiment)
    grade: Grade = "wrong" if worst > ASTRAY and real else "doubtful"
    return [
        Finding(
            code="simulated-motion",
            grade=grade,
            joints=tuple(int(joint) + 1 for joint in joints),
            value=worst,
            effect=worst,
            facts={
                "missed": comparison.position[joints].tolist(),
                "loop": "declared" if real else "made-up" if made_up(experiment) else "measured",
            },
        )
    ]


def slope_findings(comparison: MotionComparison) -> list[Finding]:
    """Return a finding where measured torques are not those of the simulated robot, but for a factor."""
    off = comparison.slope - 1.0
    joints = np.flatnonzero(np.abs(off) > np.maximum(SLOPE, SLOPE_SIGMAS * comparison.sigma))
    if not len(joints):
        return []
    worst = int(joints[np.argmax(np.abs(off[joints]))])
    return [
        Finding(
            code="torque-slope",
            grade="doubtful",
            joints=tuple(int(joint) + 1 for joint in joints),
            value=float(comparison.slope[worst]),
            deviation=float(comparison.sigma[worst]),
            effect=float(abs(off[worst])),
            facts={"slopes": comparison.slope[joints].tolist()},
        )
    ]


def worse_findings(comparison: MotionComparison, least: Array) -> list[Finding]:
    """Return a finding where IDIM-LS explains the log better; `least` are its errors, (n_dof,) (N.m or N, root mean squares)."""
    ratio = comparison.error / np.maximum(least, np.finfo(float).tiny)
    joints = np.flatnonzero((ratio > WORSE) & (comparison.error - least > NEGLIGIBLE * comparison.torque))
    if not len(joints):
        return []
    own, other = (errors[joints] / comparison.torque[joints] for errors in (comparison.error, least))
    return [
        Finding(
            code="worse-than-idim-ls",
            grade="doubtful",
            joints=tuple(int(joint) + 1 for joint in joints),
            value=float(ratio[joints].max()),
            effect=float(own.max()),
            facts={"own": own.tolist(), "least": other.tolist()},
        )
    ]
