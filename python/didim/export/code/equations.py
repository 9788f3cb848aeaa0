"""The inverse dynamic model (1) and M(q) for any kind of scalar: recursive Newton-Euler in MDH frames.

The core has the fast kernels; here the same equations generate code and formulas. Rotors and friction follow
``rust/src/model/friction.rs``, with (22) to (24) for coupled motors. Tested against the core in ``tests/test_export_c.py``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...robot.friction import OF_PATH, OF_POSITION, OF_TEMPERATURE, FrictionTerm
from ...robot.placement import carriers
from ...robot.rigid_body import INERTIAL
from ...robot.robot import Robot


class Algebra(Protocol):
    """Functions of a kind of scalar, in addition to ``+ - *``."""

    def number(self, value: float, /) -> Any:
        """Return a constant."""

    def apply(self, function: str, value: Any, /) -> Any:
        """Return ``sin``, ``cos``, ``atan``, ``exp``, ``sqrt``, ``abs``, ``positive`` (zero below zero) or ``inverse_root``."""

    def sign(self, joint: int, speed: Any) -> Any:
        """Return the sign of the Coulomb friction of a joint, with its smoothing and dead zone."""

    def over(self, value: Any, divisor: float) -> Any:
        """Return a value over a constant."""

    def term(self, term: FrictionTerm, speed: Any) -> Any:
        """Return the column of a further friction term that only depends on speed, and is no formula of it."""


Scalars = NDArray[np.object_]
"""Vector (3,) or matrix (3, 3) of scalars of any kind."""


def _scalars(*entries: Any) -> Scalars:
    return np.array(entries, dtype=np.object_)


@dataclass(frozen=True, eq=False)
class Body:
    """Ten inertial parameters about the origin of a frame: inertia, first moments (``MX MY MZ``), mass."""

    inertia: Scalars
    first: Scalars
    mass: Any

    def __add__(self, other: Body) -> Body:
        return Body(self.inertia + other.inertia, self.first + other.first, self.mass + other.mass)

    def moved(self, rotation: Scalars, shift: Scalars) -> Body:
        """Return the same body in the preceding frame, in which this frame is rotated and shifted."""
        first = rotation @ self.first
        # J + (2 t.h + m t.t) 1 - t h' - h t' - m t t'
        inertia = rotation @ self.inertia @ rotation.T
        inertia = (
            inertia - np.outer(shift, first) - np.outer(first, shift) - np.outer(shift * self.mass, shift)
        )
        inertia[np.diag_indices(3)] += 2 * (shift @ first) + self.mass * (shift @ shift)
        return Body(inertia, first + shift * self.mass, self.mass)


class Equations:
    """The model of a robot over one kind of scalar.

    Parameters
    ----------
    robot : Robot
        The robot.
    values : mapping of str to scalar
        Standard parameters by name (SI units, joint side); all others are zero.
    algebra : Algebra
        Functions of the scalars.
    q : sequence of scalars
        Positions (rad or m).
    """

    def __init__(self, robot: Robot, values: Mapping[str, Any], algebra: Algebra, q: Sequence[Any]) -> None:
        self.parents, self.outwards = robot.geometry.parents, robot.geometry.outwards
        self.robot, self.algebra, self.n = robot, algebra, robot.n_joints
        self.zero = algebra.number(0.0)
        self.q = self._all(q, position=True)
        self.value: Callable[[str], Any] = lambda name: values.get(name, self.zero)
        self.turns = [kind == "revolute" for kind in robot.geometry.kinds]
        self.axis = _scalars(self.zero, self.zero, algebra.number(1.0))
        self.rotations, self.shifts = self._frames(self.q)
        self.bodies = [self._body(j + 1) for j in range(self.n)]

    def _all(self, driven: Sequence[Any], *, position: bool = False) -> list[Any]:
        """Return the motion of all joints of that of the driven ones; positions include offsets."""
        number = self.algebra.number
        motion = list(driven)
        for follower in self.robot.geometry.followers:
            parts = (driven[leader] * number(factor) for leader, factor in follower.leaders)
            motion.append(sum(parts, number(follower.offset) if position else self.zero))
        return motion

    def _driven(self, joints: Sequence[Any]) -> list[Any]:
        """Return torques of all joints, or rows of a matrix, as the driven ones feel them, ``G^T v``."""
        n, number = self.robot.n_dof, self.algebra.number
        driven = list(joints[:n])
        for follower, torque in zip(self.robot.geometry.followers, joints[n:], strict=True):
            for leader, factor in follower.leaders:
                driven[leader] = driven[leader] + torque * number(factor)
        return driven

    def _frames(self, q: Sequence[Any]) -> tuple[list[Scalars], list[Scalars]]:
        """Rotation and origin of each frame in that of its antecedent."""
        number, geometry = self.algebra.number, self.robot.geometry
        rotations, shifts = [], []
        for j in range(self.n):
            ca, sa = (_clean(f(geometry.alpha[j])) for f in (math.cos, math.sin))
            angle, length = number(geometry.theta[j]), number(geometry.r[j])
            if self.turns[j]:
                angle = q[j] + angle
            else:
                length = q[j] + length
            c, s = self.algebra.apply("cos", angle), self.algebra.apply("sin", angle)
            rotation = _scalars(
                [c, -s, self.zero],
                [s * number(ca), c * number(ca), number(-sa)],
                [s * number(sa), c * number(sa), number(ca)],
            )
            shift = _scalars(number(geometry.d[j]), length * number(-sa), length * number(ca))
            if geometry.mounts:
                mount = geometry.mounts[j]
                cg, sg = (number(_clean(f(mount.gamma))) for f in (math.cos, math.sin))
                turn = _scalars([cg, -sg, self.zero], [sg, cg, self.zero], self.axis)
                x, y, z = mount.shift
                rotation = turn @ rotation
                shift = turn @ shift + _scalars(number(x), number(y), number(z + mount.b))
            rotations.append(rotation)
            shifts.append(shift)
        return rotations, shifts

    def _body(self, link: int) -> Body:
        xx, xy, xz, yy, yz, zz, mx, my, mz, m = (self.value(f"{key}{link}") for key in INERTIAL)
        return Body(_scalars([xx, xy, xz], [xy, yy, yz], [xz, yz, zz]), _scalars(mx, my, mz), m)

    def gravity(self) -> list[Any]:
        """Return the torques that hold the robot at rest, springs included, without friction (N.m or N)."""
        still = [self.zero] * self.n
        return self._driven(self._sprung(self._links(still, still)))

    def _sprung(self, tau: list[Any]) -> list[Any]:
        """Add the torques of the springs."""
        for term in self.robot.friction.springs:
            tau[term.joint] = tau[term.joint] + self.value(term.parameter) * self._spring(term)
        return tau

    def _spring(self, term: FrictionTerm) -> Any:
        """Column of a spring."""
        q, algebra = self.q[term.joint], self.algebra
        if term.law == "spring":
            return q
        if term.law in ("sine", "cosine"):
            return algebra.apply(term.law[:3], q)
        a, b, phi, rest = term.values
        angle, moment = q + algebra.number(phi), algebra.number(a * b)
        lever = moment * algebra.apply("sin", angle)
        squared = algebra.number(a * a + b * b) - moment * algebra.apply("cos", angle) * algebra.number(2.0)
        slope = lever * algebra.apply("inverse_root", squared)
        return slope if term.law == "cylinder" else lever - algebra.number(rest) * slope

    def _law(self, term: FrictionTerm, speed: Any, sign: Any) -> Any:
        """Column of a further friction term that only depends on speed."""
        apply = self.algebra.apply
        if term.law == "root":
            return sign * apply("sqrt", apply("abs", speed))
        if term.law == "forward":
            return apply("positive", speed)
        if term.law not in ("atan", "stribeck"):
            return self.algebra.term(term, speed)
        ratio = self.algebra.over(speed, term.velocity)
        return apply("atan", ratio) if term.law == "atan" else sign * apply("exp", -(ratio * ratio))

    def torque(self, dq: Sequence[Any], ddq: Sequence[Any], z: Sequence[Any] = ()) -> list[Any]:
        """Return the torques of the inverse model (1), friction and offsets included (N.m or N).

        ``z`` has the states of the terms that remember, in the order of `remembering`.
        """
        dq, ddq = self._all(dq), self._all(ddq)
        tau = self._links(dq, ddq)
        for row, entries in enumerate(self.rotors()):
            for k, inertia in enumerate(entries):
                tau[row] = tau[row] + inertia * ddq[k]
        now = [self.algebra.sign(j, speed) for j, speed in enumerate(dq)]
        states = list(zip(remembering(self.robot), z, strict=True))
        held = {term.joint: state for term, state in states if term.law == "hold"}
        signs = [held.get(j, sign) for j, sign in enumerate(now)]
        friction = self._friction(dq, signs, now)
        for term, state in states:
            if term.law == "dahl":
                friction[term.joint] = friction[term.joint] + self.value(term.parameter) * state
        for term in self.robot.friction.terms:
            if term.law in OF_POSITION | OF_PATH | OF_TEMPERATURE:
                continue  # like gravity; those that remember; zero at the reference temperature
            j, parameter = term.joint, self.value(term.parameter)
            if term.law == "load":
                friction[j] = friction[j] + parameter * signs[j] * self.algebra.apply("abs", tau[j])
            else:
                friction[j] = friction[j] + parameter * self._law(term, dq[j], signs[j])
        return self._driven(self._sprung([a + b for a, b in zip(tau, friction, strict=True)]))

    def inertia(self) -> list[list[Any]]:
        """Return the inertia matrix M(q) with rotors, by composite bodies; its lower triangle is computed and mirrored."""
        matrix = [list(row) for row in self.rotors()]
        composites = list(self.bodies)
        for j in reversed(self.outwards):
            composite, before = composites[j], self.parents[j]
            if before is not None:
                composites[before] += composite.moved(self.rotations[j], self.shifts[j])
            if self.turns[j]:  # torque for a unit acceleration of joint j
                force, moment = np.cross(self.axis, composite.first), composite.inertia @ self.axis
            else:
                force, moment = self.axis * composite.mass, np.cross(composite.first, self.axis)
            outer = j
            for i in reversed(carriers(self.parents, j)):
                if i != j:
                    force, moment = self._inwards(outer, force, moment)
                outer = i
                entry = matrix[j][i] + (moment if self.turns[i] else force)[2]
                matrix[j][i] = matrix[i][j] = entry
        rows = (_scalars(*row) for row in self._driven([_scalars(*row) for row in matrix]))
        return [self._driven(row.tolist()) for row in rows]

    def rotors(self) -> list[list[Any]]:
        """Return the contribution of rotors to M(q), (24)."""
        matrix = [[self.zero] * self.n for _ in range(self.n)]
        for j in range(self.n):
            matrix[j][j] = self.value(f"Ia{j + 1}")
        for m, row in self._coupled():
            rotor = self.value(f"Ia{m + 1}")
            for i, k in itertools.permutations(range(self.n), 2):
                if row[i] * row[k]:
                    matrix[i][k] = matrix[i][k] + rotor * self.algebra.number(row[i] * row[k])
        return matrix

    def _coupled(self) -> list[tuple[int, list[float]]]:
        """Return the motors that turn with several joints, with the coefficients of the joint speeds."""
        rows = enumerate(np.array(self.robot.geometry.coupling))
        return [(m, (row / row[m]).tolist()) for m, row in rows if np.count_nonzero(row) > 1]

    def _links(self, dq: Sequence[Any], ddq: Sequence[Any]) -> list[Any]:
        """Return the torques of the links; gravity is an acceleration of the base."""
        number = self.algebra.number
        omega = domega = _scalars(self.zero, self.zero, self.zero)
        a = _scalars(*(number(-g) for g in self.robot.geometry.gravity))
        base = (omega, domega, a)
        motions: dict[int, tuple[Scalars, Scalars, Scalars]] = {}
        wrenches: dict[int, tuple[Scalars, Scalars]] = {}
        for j in self.outwards:
            parent = self.parents[j]
            omega, domega, a = base if parent is None else motions[parent]
            back, t = self.rotations[j].T, self.shifts[j]
            a = back @ (a + np.cross(domega, t) + np.cross(omega, np.cross(omega, t)))
            omega, domega = back @ omega, back @ domega
            speed, gain = self.axis * dq[j], self.axis * ddq[j]
            if self.turns[j]:
                domega = domega + np.cross(omega, speed) + gain
                omega = omega + speed
            else:
                a = a + np.cross(omega, speed) * number(2.0) + gain
            motions[j] = (omega, domega, a)
            body = self.bodies[j]
            first = body.first
            force = a * body.mass + np.cross(domega, first) + np.cross(omega, np.cross(omega, first))
            spin = np.cross(omega, body.inertia @ omega)
            moment = body.inertia @ domega + spin + np.cross(first, a)
            wrenches[j] = (force, moment)
        tau = [self.zero] * self.n
        for j in reversed(self.outwards):
            force, moment = wrenches[j]
            tau[j] = (moment if self.turns[j] else force)[2]
            parent = self.parents[j]
            if parent is not None:
                force, moment = self._inwards(j, force, moment)
                wrenches[parent] = (wrenches[parent][0] + force, wrenches[parent][1] + moment)
        return tau

    def _inwards(self, j: int, force: Scalars, moment: Scalars) -> tuple[Scalars, Scalars]:
        """Return a wrench of frame `j` in the frame of its antecedent."""
        force, moment = self.rotations[j] @ force, self.rotations[j] @ moment
        return force, moment + np.cross(self.shifts[j], force)

    def _friction(self, dq: Sequence[Any], signs: Sequence[Any], now: Sequence[Any]) -> list[Any]:
        """Return viscous and Coulomb friction; `signs` may be held at rest, `now` are instantaneous."""
        tau = []
        for j, (speed, sign) in enumerate(zip(dq, signs, strict=True)):
            name = f"{j + 1}"
            if self.robot.friction.model == "asymmetric":
                forward, onward = (self.algebra.apply("positive", value) for value in (speed, sign))
                backward = speed - forward  # what is below zero
                tau.append(
                    self.value(f"Fv{name}+") * forward
                    + self.value(f"Fc{name}+") * onward
                    + self.value(f"Fv{name}-") * backward
                    + self.value(f"Fc{name}-") * (sign - onward)
                )
            else:
                own = self.value(f"Fv{name}") * speed + self.value(f"Fc{name}") * sign
                tau.append(own + self.value(f"Off{name}"))
        number = self.algebra.number
        for m, row in self._coupled():
            parts = (speed * number(factor) for factor, speed in zip(row, dq, strict=True) if factor)
            shaft = sum(parts, self.zero)
            turning = self.algebra.sign(m, shaft)
            felt = turning if self.robot.friction.coupling == "shaft" else now[m]
            viscous, coulomb = self.value(f"Fvm{m + 1}"), self.value(f"Fcm{m + 1}")
            for i, factor in enumerate(row):
                if i == m:
                    tau[i] = tau[i] + viscous * (shaft - dq[i]) + coulomb * (turning - now[i])
                elif factor:
                    tau[i] = (
                        tau[i] + viscous * (shaft * factor - dq[i] * factor**2) + coulomb * (felt * factor)
                    )
        return tau


def of_all_joints(robot: Robot) -> Robot:
    """Return the robot with smoothing and dead zones of all joints: those that follow have their leaders', times the factors."""
    friction, followers = robot.friction, robot.geometry.followers

    def widths(own: tuple[float, ...]) -> tuple[float, ...]:
        more = (
            sum(abs(factor) * own[leader] for leader, factor in follower.leaders) for follower in followers
        )
        return (*own, *more)

    return replace(
        robot,
        friction=replace(
            friction, smoothing=widths(friction.smoothing), dead_zone=widths(friction.dead_zone)
        ),
    )


def remembering(robot: Robot) -> list[FrictionTerm]:
    """Return the friction terms with a state, in the order of the states."""
    return list(robot.friction.of(*OF_PATH))


def _clean(value: float) -> float:
    """Return a cosine or sine, rounded to zero or one for right angles."""
    nearest = float(round(value))
    return nearest if abs(value - nearest) < 1e-15 else value
