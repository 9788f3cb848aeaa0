"""Conditions on the drives: rotors, friction that only dissipates, and rates that a simulation can follow.

Joints that share motors form a group; any other joint is a group of one. In a group the rotors, the viscous friction and
the slope of the Coulomb friction are matrices that are linear in the parameters, as ``friction.rs`` writes them:

    R = diag(Ia) + sum_m Ia_m N_m,    V = diag(Fv) + sum_m Fvm_m N_m,    N_m = c_m c_m^T - diag(c_m^2),

with ``c_m`` the row of a coupled motor in ``C``. Tested in ``tests/test_consistent.py``.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from .._tools.arrays import Array
from ..errors import RobotError
from ..robot.friction import OF_POSITION, OF_TEMPERATURE, STIFF
from ..robot.placement import joined
from ..robot.robot import Robot
from .consistency import Cone, cone, places_of

EXACT = 1e-12
"""Upper bound of speeds and coefficients that are zero but for rounding."""
FREE = frozenset(("rest", "table", "hold")) | OF_TEMPERATURE | (OF_POSITION - STIFF)
"""Terms of either sign: they dissipate nothing, are a user's own law, change with the temperature, or push like a weight or a
cylinder."""
BESIDE = {"atan": "Fv", "stribeck": "Fc", "forward": "Fv"}
"""Friction parameter that a law's negative term may reduce."""
LARGEST_GROUP = 6
"""Largest number of joints that share motors: rows of the core's largest matrix."""

SHARE = 1e-3
"""Prior size of rotor, friction and offset of joints that follow others (kg.m^2, N.m and so on)."""

Terms = dict[str, Array]


class Drives:
    """Rotors and friction of a robot as matrices per group of joints.

    Raises
    ------
    RobotError
        When more joints share motors than the solver's largest matrix has rows.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        coupling = np.array(robot.geometry.coupling, dtype=np.float64)
        self.coupling = coupling / np.diag(coupling)[:, None]
        self.shaft_friction = robot.friction.coupling == "shaft"
        self.sides = ("+", "-") if robot.friction.model == "asymmetric" else ("",)
        self.terms = robot.friction.terms
        self.places = places_of(robot)
        self.coupled = [m for m in range(robot.n_dof) if np.count_nonzero(self.coupling[m]) > 1]
        self.groups = joined(robot.n_dof, np.argwhere(coupling).tolist())
        for group in self.groups:
            if len(group) > LARGEST_GROUP:
                raise RobotError(
                    f"robot {robot.name!r}: {len(group)} joints share motors, and physical conditions are written for at most "
                    f"{LARGEST_GROUP}"
                )

    def motors(self, group: Sequence[int]) -> list[int]:
        """Return the coupled motors of a group."""
        return [m for m in self.coupled if m in group]

    def row(self, motor: int, group: Sequence[int]) -> Array:
        """Return the row of a motor in ``C``, on the joints of its group."""
        return np.asarray(self.coupling[motor, list(group)])

    def choices(self, group: Sequence[int]) -> list[tuple[str, ...]]:
        """Return every choice of a direction per joint, with asymmetric friction."""
        return list(itertools.product(self.sides, repeat=len(group)))

    def rotors(self, group: Sequence[int]) -> Terms:
        """Return ``R`` by parameter."""
        terms = {f"Ia{j + 1}": unit for j, unit in zip(group, _units(group), strict=True)}
        for m in self.motors(group):
            terms[f"Ia{m + 1}"] = terms[f"Ia{m + 1}"] + _beside(self.row(m, group))
        return terms

    def viscous(self, group: Sequence[int], sides: Sequence[str]) -> Terms:
        """Return ``V`` by parameter."""
        terms = {f"Fv{j + 1}{side}": unit for j, side, unit in zip(group, sides, _units(group), strict=True)}
        terms |= {f"Fvm{m + 1}": _beside(self.row(m, group)) for m in self.motors(group)}
        return terms

    def slopes(
        self,
        group: Sequence[int],
        sides: Sequence[str],
        joints: Sequence[float],
        shafts: Sequence[float],
        v: Sequence[float],
    ) -> Terms:
        """Return the slope of the Coulomb friction by parameter, where joints and shafts turn slowly (1) or fast (0)."""
        units = _units(group)
        terms = {
            f"Fc{j + 1}{side}": slow / v[j] * unit
            for j, side, slow, unit in zip(group, sides, joints, units, strict=True)
        }
        for m, slow in zip(self.motors(group), shafts, strict=True):
            row, own = self.row(m, group), list(group).index(m)
            unit = np.eye(len(group))[own]
            along = row if self.shaft_friction else unit
            slope = slow * np.outer(along, row) - joints[own] * units[own]
            if not self.shaft_friction:
                slope = slope + joints[own] * np.outer(row - unit, unit)
            terms[f"Fcm{m + 1}"] = 0.5 * (slope + slope.T) / v[m]
        return terms

    def cone(self, label: str, group: Sequence[int], terms: Terms, constant: Array | float = 0.0) -> Cone:
        """Return the condition on a sum of terms."""
        joints = "-".join(str(j + 1) for j in group)
        return cone(self.places, f"{label}{joints}", terms, constant)


def _of_followers(robot: Robot) -> list[Cone]:
    """Return the conditions that rotors and friction of coupled joints are small and not negative.

    A log-det term draws each to `SHARE`: the log cannot separate it from the parameter of its leader.
    """
    places = places_of(robot)
    cones = []
    for number in range(robot.n_dof + 1, robot.n_joints + 1):
        names = [f"{key}{number}{side}" for key in ("Fv", "Fc") for side in ("", "+", "-")]
        cones += [
            cone(places, name, {name: 1.0 / SHARE}) for name in (f"Ia{number}", *names) if name in places
        ]
        offset = f"Off{number}"
        if offset in places:
            cones += [cone(places, offset, {offset: direction / SHARE}, 1.0) for direction in (1.0, -1.0)]
    return cones


def rotor_cones(drives: Drives) -> list[Cone]:
    """Return ``Ja >= 0``: each ``Ia`` less the coupled motors that it contains."""
    cones = []
    for group in drives.groups:
        motors = drives.motors(group)
        if any(drives.coupling[m, k] != 0.0 for m in motors for k in motors if k != m):
            # Motors coupled both ways: the condition is on the whole matrix.
            cones.append(drives.cone("Ia", group, drives.rotors(group)))
            continue
        for j in group:
            terms = {f"Ia{j + 1}": np.ones((1, 1))}
            terms |= {f"Ia{m + 1}": np.full((1, 1), -(drives.coupling[m, j] ** 2)) for m in motors if m != j}
            cones.append(drives.cone("Ia", [j], terms))
    return cones


def simulable_cones(
    drives: Drives, step_s: float, rate: float, damping: Sequence[float], v: Sequence[float]
) -> list[Cone]:
    """Return the conditions (B): the rates of rotors alone stay below ``rate / step_s``, whatever the speeds.

    ``M(q) = sum of links + R >= R`` then bounds those of the robot: (C), for every q.

    Parameters
    ----------
    drives : Drives
        Drives of the robot.
    step_s : float
        Step of the integration (s).
    rate : float
        Largest product of rate and step.
    damping : sequence of float
        Damping gain of a continuous controller per joint (N.m.s/rad or N.s/m), joint side.
    v : sequence of float
        Smoothing velocity of the friction per joint.
    """
    cones: dict[tuple[tuple[int, ...], bytes], Cone] = {}
    factor = step_s / rate
    for group in drives.groups:
        motors = drives.motors(group)
        gains = -factor * np.diag([damping[j] for j in group])
        # With a coupled motor, slow joints may lower the rate that a slow shaft raises, so every corner is a condition.
        corners = (1.0, 0.0) if motors else (1.0,)
        slow_joints = itertools.product(corners, repeat=len(group))
        slow_shafts = itertools.product((1.0, 0.0), repeat=len(motors))
        for sides, joints, shafts in itertools.product(drives.choices(group), slow_joints, slow_shafts):
            terms = drives.rotors(group)
            for more in (drives.viscous(group, sides), drives.slopes(group, sides, joints, shafts, v)):
                for name, term in more.items():
                    terms[name] = terms.get(name, 0.0) - factor * term
            condition = drives.cone("Ia", group, terms, gains)
            cones.setdefault((condition.indices, condition.basis.tobytes()), condition)
    return list(cones.values())


def friction_cones(drives: Drives) -> list[Cone]:
    """Return the conditions under which friction only dissipates."""
    cones = []
    for group in drives.groups:
        if not drives.motors(group):
            names = (f"{kind}{group[0] + 1}{side}" for kind in ("Fv", "Fc") for side in drives.sides)
            cones += [cone(drives.places, name, {name: 1.0}) for name in names]
            continue
        cones += [drives.cone("Fv", group, drives.viscous(group, sides)) for sides in drives.choices(group)]
        cones += _coulomb_cones(drives, group)
    return [*cones, *further_cones(drives), *_of_followers(drives.robot)]


def further_cones(drives: Drives) -> list[Cone]:
    """Return the conditions on the terms beyond viscous and Coulomb friction, so that the sum still dissipates at every speed.

    At a joint with its own motor, negative atan terms and forward friction share the dissipation of ``Fv``:
    ``Fv + sum Fa/v + Ff >= 0`` for every choice of them, since ``atan(x) <= x``; Stribeck terms share ``Fc``:
    ``Fc + sum Fs >= 0``. With ``Fv, Fc >= 0`` that is sufficient. Load friction, roots, and all terms of joints that share
    motors must not be negative themselves, nor must the stiffness of a spring. A torque at standstill has no power;
    user-defined laws and forces that depend on the position have no condition.
    """
    shared = {j for group in drives.groups if drives.motors(group) for j in group}
    laws = [term for term in drives.terms if term.law not in FREE]
    cones: dict[tuple[tuple[str, float], ...], Cone] = {}

    def add(shares: dict[str, float], label: str) -> None:
        cones.setdefault(tuple(shares.items()), cone(drives.places, label, shares))

    for term in laws:
        if term.joint in shared or term.law not in BESIDE:
            add({term.parameter: 1.0}, term.parameter)
    for joint in sorted({term.joint for term in laws} - shared):
        for side, beside in itertools.product(drives.sides, ("Fv", "Fc")):
            terms = [term for term in laws if term.joint == joint and BESIDE.get(term.law) == beside]
            if side == "-":
                terms = [term for term in terms if term.law != "forward"]
            for count in range(1, len(terms) + 1):
                for chosen in itertools.combinations(terms, count):
                    shares = {
                        term.parameter: 1.0 / term.velocity if term.law == "atan" else 1.0 for term in chosen
                    }
                    # Scaled to entries of order one.
                    size = max(shares.values())
                    shares[f"{beside}{joint + 1}{side}"] = 1.0
                    add(
                        {name: share / size for name, share in shares.items()},
                        " + ".join(term.parameter for term in chosen),
                    )
    return list(cones.values())


def _coulomb_cones(drives: Drives, group: Sequence[int]) -> list[Cone]:
    """Return the rays along which the Coulomb friction of a group must not generate power.

    The power is linear between the planes of resting joints or shafts, so the rays suffice.
    """
    n, motors = len(group), drives.motors(group)
    planes = np.vstack([np.eye(n), *(drives.row(m, group)[None] for m in motors)])
    cones: dict[tuple[tuple[str, float], ...], Cone] = {}
    for chosen in itertools.combinations(range(len(planes)), n - 1):
        if n > 1 and np.linalg.matrix_rank(planes[list(chosen)]) < n - 1:
            continue
        ray = np.linalg.svd(planes[list(chosen)])[2][-1]
        ray = ray / np.abs(ray).max()
        for speed in (ray, -ray):
            turning = planes @ speed
            resting = np.flatnonzero(np.abs(turning) < EXACT)
            for signs in itertools.product((1.0, -1.0), repeat=len(resting)):
                sign = np.sign(turning)
                sign[resting] = signs
                power = _power(drives, group, np.where(np.abs(speed) < EXACT, 0.0, speed), sign)
                terms = {name: np.full((1, 1), value) for name, value in power.items() if abs(value) > EXACT}
                if terms:
                    key = tuple(sorted((name, round(float(term[0, 0]), 9)) for name, term in terms.items()))
                    cones.setdefault(key, drives.cone("Fc", group, terms))
    return list(cones.values())


def _power(drives: Drives, group: Sequence[int], speed: Array, sign: Array) -> dict[str, float]:
    """Return the power of the Coulomb friction by parameter, for signs of joints and shafts."""
    power = {}
    for index, j in enumerate(group):
        side = "" if drives.sides == ("",) else ("+" if sign[index] > 0.0 else "-")
        power[f"Fc{j + 1}{side}"] = float(sign[index] * speed[index])
    for number, m in enumerate(drives.motors(group)):
        row, own = drives.row(m, group), list(group).index(m)
        unit = np.eye(len(group))[own]
        shaft, joint = sign[len(group) + number], sign[own]
        torque = shaft * row if drives.shaft_friction else shaft * unit + joint * (row - unit)
        power[f"Fcm{m + 1}"] = float(torque @ speed - joint * speed[own])
    return power


def _units(group: Sequence[int]) -> list[Array]:
    return [np.diag(unit) for unit in np.eye(len(group))]


def _beside(row: Array) -> Array:
    return np.asarray(np.outer(row, row) - np.diag(row**2))
