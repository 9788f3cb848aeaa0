"""What a log may have been declared wrongly as: signs, exchanged columns, units, sides, rates, gears.

A wrong declaration contradicts itself, because most parameters belong to several joints. So each other reading of the same
columns (`Reading`) is tried, and the one that takes the contradiction away is what happened. Two measures decide:

* gross: the other reading leaves less than half of what the declared one leaves (`CLEAR`). On real logs,
  whose errors are those of the model, no other reading of a sound log comes near that;
* fine: the other reading explains the log nearly down to the noise of its torques, and the declared one does not. This finds a gear
  that is wrong by a few percent, and says nothing on logs with larger errors than their noise.

Tested in ``tests/test_check.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from .._tools.arrays import Array
from ..log.recording import Recording
from ..robot.robot import Robot
from .finding import Finding, Kind
from .probe import Probe, Reading

FACTORS = (0.6, 0.85, 0.96, 1.0, 1.0 / 0.96, 1.0 / 0.85, 1.0 / 0.6)
"""Factors of rates, gears and gains that are tried; the best few are refined between their neighbours."""
REFINED = 5
"""Number of the best factors that are refined: a coarse grid does not separate a gear from an encoder."""
SHORTLIST = 8
"""Best readings of a part of the log that are tried on all of it."""
SMALLEST_FACTOR = 0.03
"""A factor nearer to 1 is not worth a sentence: filters and differences alone move it by 1 or 2 %."""
NEAR = 1.05
"""Readings whose residual is within this factor of the smallest count as equal: the simplest of them is reported, and where it is a
factor of a joint, the same factor of other joints beside it."""
FINE = 60.0
"""Fall of chi^2 for a fine finding, in units of what is left per row: nearly eight standard deviations, because thirty readings
are tried and decimated noise is correlated."""
FINE_SHARE = 0.25
"""And as a share of what is left, because that is not all noise: Coulomb friction that is smooth in the log and a sign in the model
leaves 0.14 to a wrong factor (a simulated UR5e), a gear that is 10 % off 0.56."""
EXPLAINED = 10.0
"""Chi^2 per row at most, for a log explained nearly down to its noise. Simulated logs have 1 to 5, by the filter of the positions;
real ones hundreds, by friction that no model has, where a gear error of a few percent does not show."""
KNOWN_LEFT = 0.1
"""And so much of the torques at most: where more is left, the parameters are not those of the log, and a factor hides that."""
MOST_ROUNDS = 3
"""Wrong declarations reported in one run; each is looked for with those before it corrected."""
CLEAR = 0.5
"""Share of the residual that another reading must leave at most to be reported."""
KNOWN_CLEAR = 0.7
"""With known parameters the factor of a joint may leave more: their own error (friction, temperature) stays."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Another reading, and what to say when it is the right one."""

    kind: Kind
    joints: tuple[int, ...]
    reading: Reading
    sentence: str
    advice: str
    factor: float | None = None
    # Friction must be positive under the right reading; this separates turned torques from all the others.
    turned: bool = False


def as_declared(n_dof: int) -> Reading:
    """Return the reading that changes nothing."""
    return Reading(np.eye(n_dof), np.eye(n_dof))


def candidates(robot: Robot, recording: Recording) -> Iterator[Candidate]:
    """All readings but those with a factor."""
    n = robot.n_dof
    one = np.eye(n)
    yield from _units(robot, recording, one)
    yield from _sides(robot, recording, one)
    for joint in range(n):
        flip = one.copy()
        flip[joint, joint] = -1.0
        name = f"joint {joint + 1}"
        yield Candidate(
            "torque-sign",
            (joint + 1,),
            Reading(one, flip),
            f"the torque of {name} looks as if its sign were wrong",
            "Turn the sign of its gain or of its column",
            turned=True,
        )
        yield Candidate(
            "position-sign",
            (joint + 1,),
            Reading(flip, one),
            f"the position of {name} looks as if its sign were wrong",
            "Turn the sign of its column, or of the axis in the robot file",
        )
        yield Candidate(
            "joint-sign",
            (joint + 1,),
            Reading(flip, flip),
            f"position and torque of {name} look as if both their signs were wrong",
            "Turn the sign of its row under [transmission], or of the axis in the robot file",
        )
    for i, j in combinations(range(n), 2):
        swap = one.copy()
        swap[[i, j]] = swap[[j, i]]
        pair, joints = f"joints {i + 1} and {j + 1}", (i + 1, j + 1)
        yield Candidate(
            "swapped-torques",
            joints,
            Reading(one, swap),
            f"the torques of {pair} look as if they were exchanged",
            "Exchange their columns under [recording.torque]",
        )
        yield Candidate(
            "swapped-positions",
            joints,
            Reading(swap, one),
            f"the positions of {pair} look as if they were exchanged",
            "Exchange their columns under [recording.position]",
        )
        yield Candidate(
            "swapped-joints",
            joints,
            Reading(swap, swap),
            f"positions and torques of {pair} look as if they were exchanged",
            "Exchange their columns under [recording.position] and [recording.torque]",
        )


def _units(robot: Robot, recording: Recording, one: Array) -> Iterator[Candidate]:
    declared = recording.origin.get("position", {}).get("unit")
    declared = set(declared if isinstance(declared, list) else [declared])
    for kind, unit, other, factor in (
        ("revolute", "rad", "deg", np.pi / 180.0),
        ("revolute", "deg", "rad", 180.0 / np.pi),
        ("prismatic", "m", "mm", 1e-3),
        ("prismatic", "mm", "m", 1e3),
    ):
        joints = tuple(k + 1 for k, other_kind in enumerate(robot.joint_kinds) if other_kind == kind)
        if not joints or (declared != {None} and unit not in declared):
            continue
        scale = np.diag([factor if k + 1 in joints else 1.0 for k in range(len(one))])
        yield Candidate(
            "unit",
            joints,
            Reading(scale, one),
            f"the positions look as if they were in {other}, not in {unit}",
            f'Write unit = "{other}" under [recording.position]',
        )


def _sides(robot: Robot, recording: Recording, one: Array) -> Iterator[Candidate]:
    reduction = recording.origin.get("reduction", robot.reduction)
    if reduction is None:
        return
    r = np.array(reduction)
    if np.array_equal(r, one):
        return
    sides = {key: recording.origin.get(key, {}).get("side", "joint") for key in ("position", "torque")}
    # What takes the declared side to the other one, for q' = A q and tau' = T tau.
    to_other = {
        "position": np.linalg.inv(r) if sides["position"] == "joint" else r,
        "torque": r.T if sides["torque"] == "joint" else np.linalg.inv(r.T),
    }
    for keys in (("position", "torque"), ("position",), ("torque",)):
        other = "motor" if sides[keys[0]] == "joint" else "joint"
        what = " and ".join(f"{key}s" for key in keys)
        tables = " and ".join(f"[recording.{key}]" for key in keys)
        yield Candidate(
            "side",
            (),
            Reading(
                to_other["position"] if "position" in keys else one,
                to_other["torque"] if "torque" in keys else one,
            ),
            f"the {what} look as if they were those of the {other}s, not of the {sides[keys[0]]}s",
            f'Write side = "{other}" under {tables}',
        )


def scaled(n_dof: int, what: str, joint: int, factor: float) -> Candidate:
    """Return the reading in which a rate, a gear, a gain or an encoder is another by a factor."""
    one = np.eye(n_dof)
    scale, inverse = one.copy(), one.copy()
    scale[joint, joint], inverse[joint, joint] = factor, 1.0 / factor
    name, percent = f"joint {joint + 1}", f"{factor:.3g} times"
    if what == "rate":
        return Candidate(
            "rate",
            (),
            Reading(one, one, factor),
            f"motion and torques fit together at {percent} the declared rate_hz",
            "Look at rate_hz, or log time stamps",
            factor,
        )
    if what == "gear":
        return Candidate(
            "gear-ratio",
            (joint + 1,),
            Reading(scale, inverse),
            f"position and torque of {name} fit the others with {1.0 / factor:.3g} times the gear ratio",
            f"Look at the row of motor {joint + 1} of reduction under [transmission]",
            1.0 / factor,
        )
    if what == "gain":
        return Candidate(
            "drive-gain",
            (joint + 1,),
            Reading(one, scale),
            f"the torque of {name} fits the others when it is multiplied by {factor:.3g}",
            "Look at gain and unit under [recording.torque], and at the gear ratio",
            factor,
        )
    return Candidate(
        "position-scale",
        (joint + 1,),
        Reading(scale, one),
        f"the position of {name} fits the others when it is multiplied by {factor:.3g}",
        "Look at unit and counts_per_rev under [recording.position], and at the gear ratio",
        factor,
    )


class Reader:
    """Finds the reading that takes the contradictions of a log away.

    Parameters
    ----------
    probe, quick : Probe
        The log, and a part of it that all readings are tried on first.
    robot, recording : Robot, Recording
        For units and sides.
    timed : bool
        Whether time stamps say that the rate is right.
    noise : (n_dof,) array
        Standard deviation of the noise of the decimated torques; zero where it is not known.
    known : bool
        Whether the parameters are known.

    Attributes
    ----------
    left : float
        Share of the residual that the readings of `gross` leave; 1 without any.
    """

    def __init__(
        self,
        probe: Probe,
        quick: Probe,
        robot: Robot,
        recording: Recording,
        *,
        timed: bool,
        noise: Array,
        known: bool,
    ) -> None:
        self._probe, self._quick, self._known = probe, quick, known
        self._n = robot.n_dof
        self._timed = timed
        self._noise = noise
        self._list = list(candidates(robot, recording))
        self.left = 1.0

    def gross(self) -> list[Finding]:
        """Return the declarations that contradict the log grossly, gravest first."""
        found: list[Finding] = []
        reading = as_declared(self._n)
        for _ in range(MOST_ROUNDS):
            result = self._gross(reading)
            if result is None:
                break
            found.append(_finding(*result))
            self.left *= result[2] / result[1]
            reading = result[0].reading.after(reading)
        return found

    def fine(self) -> list[Finding]:
        """Return a factor that brings a log without gross contradictions down to its noise."""
        result = self._fine(as_declared(self._n))
        return [] if result is None else [_finding(*result)]

    def _gross(self, reading: Reading) -> tuple[Candidate, float, float] | None:
        declared, _ = self._probe.relative(reading)
        if not np.isfinite(declared):
            return None
        listed = sorted(self._list, key=lambda item: self._quick.relative(item.reading.after(reading))[0])
        left: list[tuple[float, Candidate]] = []
        for candidate in listed[:SHORTLIST]:
            value, solution = self._probe.relative(candidate.reading.after(reading))
            friction = np.sum(np.sign(solution[self._probe.viscous]))
            if friction < 0.0 and not self._known:
                # The same with all torques turned: no robot for any other reading, the other joints for this one.
                if not candidate.turned or self._n == 1:
                    continue
                candidate = self._complement(candidate)
            left.append((value, candidate))
        factors = self._factors(reading, lambda probe, other: probe.relative(other)[0] ** 2)
        left += [(float(np.sqrt(square)), candidate) for square, candidate in factors]
        if not left:
            return None
        best = min(value for value, _ in left)
        value, candidate = next((v, c) for v, c in left if v <= NEAR * best)
        factor = candidate.factor is not None
        clear = KNOWN_CLEAR if factor and self._known and value < KNOWN_LEFT else CLEAR
        if not value < clear * declared or (factor and self._small(candidate)):
            return None
        return self._with_equals(candidate, [other for v, other in left if v <= NEAR * best]), declared, value

    def _with_equals(self, candidate: Candidate, equals: Sequence[Candidate]) -> Candidate:
        """Name the other joints whose factor explains the log as well: the gears of a wrist may stand for each other."""
        if candidate.factor is None:
            return candidate
        others = [
            other
            for other in equals
            if other.kind == candidate.kind and other.joints != candidate.joints and not self._small(other)
        ]
        if not others:
            return candidate
        advices = dict.fromkeys(item.advice for item in (candidate, *others))
        first, *rest = advices
        return replace(
            candidate,
            joints=tuple(sorted({joint for item in (candidate, *others) for joint in item.joints})),
            sentence=f"{', or '.join(item.sentence for item in (candidate, *others))} "
            "(this log does not tell which)",
            advice=", or ".join([first, *(f"{text[0].lower()}{text[1:]}" for text in rest)]),
        )

    def _complement(self, candidate: Candidate) -> Candidate:
        joints = tuple(k + 1 for k in range(self._n) if k + 1 not in candidate.joints)
        names = "joint " + str(joints[0]) if len(joints) == 1 else "joints " + ", ".join(map(str, joints))
        s = ("", "its sign") if len(joints) == 1 else ("s", "their signs")
        return Candidate(
            "torque-sign",
            joints,
            Reading(candidate.reading.position, -candidate.reading.torque),
            f"the torque{s[0]} of {names} look{'s' if len(joints) == 1 else ''} as if {s[1]} were wrong",
            "Turn the sign of the gains or of the columns",
            turned=True,
        )

    def _small(self, candidate: Candidate) -> bool:
        return candidate.factor is not None and abs(np.log(candidate.factor)) < SMALLEST_FACTOR

    def _scales(self) -> list[tuple[str, int]]:
        # A single joint fits at any scale: only known parameters decide.
        if self._n == 1 and not self._known:
            return []
        joints = [(what, joint) for joint in range(self._n) for what in ("gain", "gear", "encoder")]
        return joints if self._timed else [*joints, ("rate", 0)]

    def _fine(self, reading: Reading) -> tuple[Candidate, float, float] | None:
        """Find a factor that brings the log down to its noise."""
        if self._known or not (self._noise > 0.0).all():
            return None

        def chi2(probe: Probe, other: Reading) -> float:
            # The noise is multiplied with the torques.
            return probe.solve(other, 1.0 / (other.torque**2 @ self._noise**2))[0]

        rows = self._n * self._probe.n_rows - len(self._probe.names)
        declared = chi2(self._probe, reading)
        found = self._factors(reading, chi2)
        if rows <= 0 or not found:
            return None
        value, candidate = found[0]
        if (
            self._small(candidate)
            or value > EXPLAINED * rows
            or declared - value < max(FINE * value / rows, FINE_SHARE * value)
        ):
            return None
        equals = [other for cost, other in found if cost <= NEAR**2 * value]
        return (
            self._with_equals(candidate, equals),
            self._probe.relative(reading)[0],
            self._probe.relative(candidate.reading.after(reading))[0],
        )

    def _factors(
        self, reading: Reading, cost: Callable[[Probe, Reading], float]
    ) -> list[tuple[float, Candidate]]:
        """Find the best factors on a part of the log, and return their costs, sums of squares, on all of it, the least first."""
        from scipy.optimize import minimize_scalar

        logs = np.log(FACTORS)
        found = []
        for what, joint in self._scales():

            def at(value: float, what: str = what, joint: int = joint) -> float:
                return cost(
                    self._quick, scaled(self._n, what, joint, float(np.exp(value))).reading.after(reading)
                )

            costs = [at(value) for value in logs]
            k = int(np.argmin(costs))
            found.append((*_bottom(logs, costs, k), what, joint, k, at))
        found.sort(key=lambda item: item[0])
        refined = []
        for _, place, what, joint, k, at in found[:REFINED]:
            # Next to the declared factor the parabola says well enough how near, and a factor as near is not reported.
            if not (logs[k] == 0.0 and abs(place) < SMALLEST_FACTOR):
                low = logs[k - 1] if k > 0 else logs[0] + logs[0]
                high = logs[k + 1] if k + 1 < len(logs) else logs[-1] + logs[-1]
                best = minimize_scalar(
                    at, bounds=(low, high), method="bounded", options={"xatol": 2e-3, "maxiter": 15}
                )
                place = float(best.x)
            candidate = scaled(self._n, what, joint, float(np.exp(place)))
            refined.append((cost(self._probe, candidate.reading.after(reading)), candidate))
        return sorted(refined, key=lambda item: item[0])


def _bottom(x: Array, costs: Sequence[float], k: int) -> tuple[float, float]:
    """Cost and place of the bottom of the parabola through the lowest of a grid and its neighbours: a factor may lie between."""
    if not 0 < k < len(costs) - 1 or not np.isfinite(costs[k - 1 : k + 2]).all():
        return costs[k], float("inf")
    a, b, c = np.polyfit(x[k - 1 : k + 2] - x[k], costs[k - 1 : k + 2], 2)
    if not a > 0.0:
        return costs[k], float("inf")
    # The cost is not quadratic here. The extrapolation only ranks the candidates, and is limited to half of the cost.
    return max(float(c - b * b / (4.0 * a)), 0.5 * costs[k]), float(x[k] - b / (2.0 * a))


def _finding(candidate: Candidate, before: float, after: float) -> Finding:
    return Finding(
        kind=candidate.kind,
        joints=candidate.joints,
        sentence=f"{candidate.sentence}: what is left of the torques falls from {100.0 * before:.3g} % "
        f"to {100.0 * after:.3g} %",
        advice=candidate.advice,
        value=candidate.factor,
    )
