"""End of a DIDIM run: its stopping rule, and its distance from the fixed point.

The iteration ``x <- F(x)`` contracts: near its end each step is ``rate`` times the preceding one, and the remaining distance is
``rate / (1 - rate)`` times the last step. With a slack control loop it contracts slowly: the residual is steady while the
parameters still change. Distances are measured in standard deviations. Tested in ``tests/test_didim_endings.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ..._tools.arrays import Array, quotient
from ..._tools.words import counted
from ...evidence.loop.simulated import Piece, compare_motions
from ...signal.processing import SignalProcessing
from ...signal.window import Window
from .problem import Simulated

MOST_STEPS = 8
"""Number of last steps that the contraction rate is estimated from; earlier ones are far from the limit."""
SLOW = 0.3
"""Remaining distance, in standard deviations, beyond which the result reports slow contraction."""
LARGEST_RATE = 0.95
"""Upper bound of a contraction rate that is expected to rise, so that the remaining distance stays finite."""
SAFETY = 1.5
"""Safety factor on the remaining distance: the slowest direction shows late in the ratio of the steps."""


@dataclass(frozen=True)
class Contraction:
    """Contraction of the iteration towards its fixed point.

    Attributes
    ----------
    rate : float
        Ratio of the norms of successive steps, in standard deviations; below 1 for a converging iteration.
    remaining_rms, remaining_largest : float
        Estimated distance from the fixed point in standard deviations: root mean square of all parameters, and upper bound of
        the largest; infinite if the steps do not shrink.
    """

    rate: float
    remaining_rms: float
    remaining_largest: float


@dataclass
class Path:
    """Steps of an iteration, each (b,); a shortened step restarts the list."""

    steps: list[Array] = field(default_factory=list)

    def add(self, step: Array, *, full: bool) -> None:
        """Add the change of the base parameters in one iteration, and whether it was the full step."""
        self.steps = [*self.steps[-(MOST_STEPS - 1) :], step] if full else []

    def contraction(self, std: Array) -> Contraction | None:
        """Return the contraction in units of `std`, (b,), zero for ignored parameters; None before two full steps."""
        counted_in = std > 0.0
        if len(self.steps) < 2 or not counted_in.any():
            return None
        return contraction_of([step[counted_in] / std[counted_in] for step in self.steps])


def contraction_of(steps: Sequence[Array]) -> Contraction:
    """Estimate the contraction from two or more steps in standard deviations, the last one last.

    Notes
    -----
    The rate is the larger of the last two ratios of norms. The distance is the larger of a geometric series and of an
    extrapolation with two directions of contraction. If the ratios still rise, because the slowest direction does not yet
    dominate, the rate of the series is raised once more.
    """
    norms = [float(np.linalg.norm(step)) for step in steps]
    ratios = [after / before for before, after in pairwise(norms) if before > 0.0]
    if not ratios:
        return Contraction(0.0, 0.0, 0.0)
    rate = max(ratios[-2:])
    last = np.abs(steps[-1])
    if not rate < 1.0:
        return Contraction(rate, float("inf"), float("inf"))
    # A single jump, as in the first steps, is not a contraction along the slowest direction.
    rising = max(0.0, min(ratios[-1] - ratios[-2], ratios[-2] - ratios[-3])) if len(ratios) > 2 else 0.0
    expected = max(rate, min(rate + rising, LARGEST_RATE))
    left = SAFETY * expected / (1.0 - expected)
    rms, largest = left * float(np.sqrt(np.mean(last**2))), left * float(last.max())
    ahead = _extrapolated(steps)
    if ahead is not None:
        rms = max(rms, float(np.sqrt(np.mean(ahead**2))))
        largest = max(largest, float(np.abs(ahead).max()))
    return Contraction(rate, rms, largest)


def _extrapolated(steps: Sequence[Array]) -> Array | None:
    """Return the distance to the fixed point by minimal polynomial extrapolation with two modes, or None."""
    if len(steps) < 4:
        return None
    # s_{k+2} + a s_{k+1} + b s_k = 0 for two modes; the sum of all steps to come follows from a and b.
    older, middle, newer = (np.concatenate(steps[first : len(steps) - 2 + first]) for first in range(3))
    (a, b), *_ = np.linalg.lstsq(np.column_stack([middle, older]), -newer, rcond=None)
    if not 1.0 + a + b > 1e-6:
        return None
    rates = np.roots([1.0, a, b])
    if np.abs(rates).max() >= 1.0:
        return None
    # With s_{n+1} = -a s_n - b s_{n-1}, the sum of s_{n+1}, s_{n+2}, ... is -((a + b) s_n + b s_{n-1}) / (1 + a + b).
    return np.asarray(-((a + b) * steps[-1] + b * steps[-2]) / (1.0 + a + b))


def rule_sentence(
    largest_change: float, sigma_fraction: float, residual_change: float, tolerance: float, *, exact: bool
) -> str:
    """Name the stopping rule that fired.

    Parameters
    ----------
    largest_change, sigma_fraction : float
        Largest change of a parameter in the last step, in standard deviations, and its limit.
    residual_change, tolerance : float
        Relative change of the residual in the last step, and its limit.
    exact : bool
        Whether the residual is rounding.
    """
    if exact:
        return "Stopped because the residual is rounding."
    parameters = f"the last step changed no parameter by more than {largest_change:.2g} sigma (limit {sigma_fraction:g})"
    residual = f"the residual changed by {100.0 * residual_change:.2g} % (limit {100.0 * tolerance:g} %)"
    if largest_change <= sigma_fraction and residual_change <= tolerance:
        return f"Stopped by both rules: {parameters}, and {residual}."
    if largest_change <= sigma_fraction:
        return f"Stopped by the rule on the parameters: {parameters}."
    return f"Stopped by the rule on the residual: {residual}, but the last step changed a parameter by {largest_change:.2g} sigma."


def slow_sentence(contraction: Contraction, n_iterations: int) -> str:
    """Return the sentence on slow contraction and the remaining distance."""
    if not np.isfinite(contraction.remaining_largest):
        return (
            f"the steps do not shrink (factor {contraction.rate:.2g} per iteration): the distance from the fixed point is "
            f"unknown after {counted(n_iterations, 'iteration')}"
        )
    return (
        f"slow contraction: each step is {contraction.rate:.2g} times the last, so the fixed point may be "
        f"{contraction.remaining_largest:.2g} sigma away ({contraction.remaining_rms:.2g} rms); a stiffer controller helps, "
        "or tolerance = 0 with more iterations"
    )


def best_sentence(iteration: int, n_iterations: int, error: float) -> str:
    """Return the sentence on the point returned by a run that did not converge."""
    which = "the start" if iteration == 0 else f"iteration {iteration}"
    return (
        f"The result is the best of the start and {counted(n_iterations, 'iteration')}, {which}, with simulated torques off by "
        f"{100.0 * error:.3g} %; it has no standard deviations."
    )


def lost_sentence(n_iterations: int, error: float) -> str:
    """Return the sentence on a run that gave up."""
    return (
        f"gave up after {n_iterations} iterations in a row with simulated torques {100.0 * error:.3g} % off: no robot in this loop "
        "explains the log; check torque signs, controller and reference"
    )


def stuck_sentence(stuck: Mapping[int, str]) -> str:
    """Return the sentence on parameters left unchanged because simulated joints stuck; `stuck` has their names by iteration."""
    first = min(stuck)
    where = "the start" if first == 0 else f"iteration {first}"
    more = f" (likewise {counted(len(stuck) - 1, 'later iteration')})" if len(stuck) > 1 else ""
    return (
        f"the motion simulated with {where} does not identify {stuck[first]}{more}: a simulated joint sticks or moves one way "
        "only, so their values are kept"
    )


def step_sentence(error: Array, size: Array) -> str:
    """Return the sentence on too large time steps; error and size of the torques are (n_dof,), rms (N.m or N)."""
    if not np.isfinite(error).all():
        return "the integration step is too large: with half of it the simulation ends early; reduce step_s and fine_step_s"
    joint = int(np.argmax(quotient(error, size, np.inf)))
    return (
        f"the integration step is too large: halving it changes the torque of joint {joint + 1} by {error[joint]:.2g} rms of "
        f"{size[joint]:.2g}; reduce step_s and fine_step_s in [simulation]"
    )


def motion_record(
    signal: SignalProcessing, windows: Sequence[Window], motion: Simulated
) -> dict[str, list[float]]:
    """Return the comparison of simulated and measured motion of all windows, for the record of a result."""
    pieces: list[Piece] = [
        (each.measured[each.kept] if each.measured.size else None, q, each.tau, tau)
        for each, (q, _, _, tau) in zip(windows, motion.motions, strict=True)
    ]
    return compare_motions(signal, pieces).record()
