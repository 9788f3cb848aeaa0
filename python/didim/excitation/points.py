"""Motions from point to point for controllers that cannot play a table: the points are chosen by exchange.

The information of such a motion is the sum over its moves, so the exchange of a point changes two summands. Each point in turn
is replaced by the random candidate with the largest criterion (Fedorov's exchange). Tested in ``tests/test_excitation.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .._tools.arrays import Array
from ..errors import ExcitationError
from ..loop.reference import Reference
from .problem import FINE, Problem
from .settings import sample_count
from .task import Task

MOVE_RATE_HZ = 100.0
"""Sampling rate (Hz) of a move while points are exchanged."""
WITHIN = 0.999
"""Share of the torque limits that moves respect on the fine grid: accelerations jump at corners, which lie between its
samples."""
POINT_PASSES = 3
"""Number of passes over all points: a fourth gained less than 1 % of the first's gain."""
POINTS_TRIED = 25
"""Number of random candidates for each point in a pass."""
TRIES = 400
"""Largest number of random points drawn until one is reachable within all limits."""


@dataclass(frozen=True)
class _Move:
    """A move from one point to the next: its information, its duration (s), and whether it respects the limits."""

    matrix: Array
    duration: float
    feasible: bool


class PointDesign:
    """Points of one design.

    Parameters
    ----------
    task : Task
        Settings, limits, and the first and last point, if it is given.
    problem : Problem
        Criterion and information.
    """

    def __init__(self, task: Task, problem: Problem) -> None:
        self.problem, self.limits, self.rate, self.first = problem, task.limits, task.rate, task.start
        self.settings = task.settings

    def reference(self, points: Array) -> Reference:
        """Return the motion through points."""
        return Reference.point_to_point(
            points,
            max_velocity=self.limits.velocity,
            max_acceleration=self.limits.acceleration,
            dwell_s=self.settings.dwell_s,
        )

    def move(self, a: Array, b: Array) -> _Move:
        """Return the information of a move with its rests, and whether it respects the limits on the coarse grid."""
        reference = self.reference(np.stack([a, b]))
        motion = _sampled(reference, MOVE_RATE_HZ)
        matrix = self.problem.information.own(*motion, reference.duration * self.rate)
        return _Move(matrix, reference.duration, self.keeps(*motion))

    def verified(self, a: Array, b: Array) -> bool:
        """Whether torques and clearances of a move are within limits on the fine grid too."""
        return self.keeps(*_sampled(self.reference(np.stack([a, b])), FINE * MOVE_RATE_HZ), WITHIN)

    def keeps(self, q: Array, dq: Array, ddq: Array, share: float = 1.0) -> bool:
        """Whether a motion respects a share of the torque limits, and the clearances."""
        torques = self.problem.torques(q, dq, ddq)
        if torques is not None and (np.abs(torques) > share * self.limits.torque).any():
            return False
        clearance = self.problem.clearance
        return clearance.empty or float(clearance.distances(q).min()) >= 0.0

    def search(self, seed: int) -> tuple[Array, Array, bool]:
        """Return the best points, the random ones at the start of the exchange, and whether Ctrl-C ended it.

        Points have the shape ``(count, n_dof)``. After Ctrl-C they are the best so far.

        Raises
        ------
        ExcitationError
            When no random point can be reached within the limits.
        """
        rng = np.random.default_rng(seed)
        points = self._random(rng)
        random, interrupted = points.copy(), False
        try:
            self._exchange(points, rng)
        except KeyboardInterrupt:
            interrupted = True
        return points, random, interrupted

    def _exchange(self, points: Array, rng: np.random.Generator) -> None:
        """Exchange points, in place, for random ones with more information."""
        moves = [self.move(a, b) for a, b in pairwise(points)]
        best = self.value(moves)
        given = int(self.first is not None)
        for _ in range(POINT_PASSES):
            for k in range(given, len(points) - given):
                around = [j for j in (k - 1, k) if 0 <= j < len(moves)]
                for candidate in self._draw(rng, POINTS_TRIED):
                    tried = list(moves)
                    ends = {
                        j: (points[j], candidate) if j < k else (candidate, points[j + 1]) for j in around
                    }
                    for j in around:
                        tried[j] = self.move(*ends[j])
                    if not all(tried[j].feasible for j in around):
                        continue
                    value = self.value(tried)
                    if value > best and all(self.verified(*ends[j]) for j in around):
                        best, moves = value, tried
                        points[k] = candidate

    def value(self, moves: Sequence[_Move]) -> float:
        """Return the criterion of moves repeated for the duration of the design, which favours quick moves."""
        seconds = sum(move.duration for move in moves)
        matrix = np.sum([move.matrix for move in moves], axis=0)
        return self.problem.criterion(
            self.problem.information.prior + self.settings.duration_s / seconds * matrix
        )[0]

    def _draw(self, rng: np.random.Generator, count: int) -> Array:
        low, high = self.limits.lowest, self.limits.highest
        # The ends of the range give most information, so candidates are drawn more densely there.
        share = 0.5 - 0.5 * np.cos(np.pi * rng.random((count, len(low))))
        return np.asarray(low + share * (high - low))

    def _random(self, rng: np.random.Generator) -> Array:
        first, count = self.first, self.settings.points
        points = [] if first is None else [first]

        def passable(a: Array, b: Array) -> bool:
            return self.move(a, b).feasible and self.verified(a, b)

        def reachable(candidate: Array) -> bool:
            if not points:
                rest = np.zeros((1, len(candidate)))
                return self.keeps(candidate[None], rest, rest)
            return passable(points[-1], candidate) and (
                first is None or len(points) < count - 2 or passable(candidate, first)
            )

        while len(points) < count - (first is not None):
            for shrink in np.linspace(1.0, 0.2, TRIES):
                # Candidates approach the previous point until one is reachable.
                at = points[-1] if points else self.limits.middle
                candidate = at + shrink * (self._draw(rng, 1)[0] - at)
                if reachable(candidate):
                    break
            else:
                raise ExcitationError(
                    "no random motion keeps the torque limits and the clearances: the limits leave no room"
                )
            points.append(candidate)
        return np.array(points if first is None else [*points, first])


def _sampled(reference: Reference, rate_hz: float) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations in the middle of equal parts, away from corners of the velocity."""
    count = max(8, sample_count(reference.duration, rate_hz))
    return reference.at((np.arange(count) + 0.5) * (reference.duration / count))
