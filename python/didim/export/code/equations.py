"""The inverse dynamic model (1) and M(q) for any kind of scalar: recursive Newton-Euler in MDH frames.

The core has the fast kernels; here the same equations generate code and formulas. Rotors and friction follow
``rust/src/model/friction.rs``, with (22) to (24) for coupled motors. Tested against the core in ``tests/test_export_c.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ...errors import FitError
from ...robot.friction import OF_PATH, OF_POSITION, OF_TEMPERATURE, FrictionTerm
from ...robot.placement import carriers
from ...robot.robot import Robot


class Algebra(Protocol):
    """Functions of a kind of scalar, in addition to ``+ - *``."""

    def number(self, value: float) -> Any:
        """Return a constant."""

    def sin(self, value: Any) -> Any:
        """Return the sine."""

    def cos(self, value: Any) -> Any:
        """Return the cosine."""

    def sign(self, joint: int, speed: Any) -> Any:
        """Return the sign of the Coulomb friction of a joint, with its smoothing and dead zone."""

    def positive(self, value: Any) -> Any:
        """Return the value where it is above zero, else zero."""

    def magnitude(self, value: Any) -> Any:
        """Return the absolute value."""

    def inverse_root(self, value: Any) -> Any:
        """Return one over the square root."""

    def term(self, term: FrictionTerm, speed: Any, sign: Any) -> Any:
        """Return the column of a further friction term that only depends on speed."""


class Vector(tuple[Any, Any, Any]):
    """Three scalars."""

    __slots__ = ()

    def __new__(cls, x: Any, y: Any, z: Any) -> Vector:
        """Make a vector."""
        return super().__new__(cls, (x, y, z))

    def plus(self, other: Vector) -> Vector:
        """Return the sum."""
        return Vector(*(a + b for a, b in zip(self, other, strict=True)))

    def times(self, factor: Any) -> Vector:
        """Return a multiple."""
        return Vector(*(a * factor for a in self))

    def cross(self, other: Vector) -> Vector:
        """Return the vector product."""
        (a, b, c), (x, y, z) = self, other
        return Vector(b * z - c * y, c * x - a * z, a * y - b * x)

    def dot(self, other: Vector) -> Any:
        """Return the scalar product."""
        return self[0] * other[0] + self[1] * other[1] + self[2] * other[2]


Matrix = tuple[Vector, Vector, Vector]
"""Rows."""


def _transform(matrix: Matrix, v: Vector) -> Vector:
    """Return the product of a matrix and a vector."""
    return Vector(*(row.dot(v) for row in matrix))


def _transposed(matrix: Matrix) -> Matrix:
    a, b, c = (Vector(*column) for column in zip(*matrix, strict=True))
    return a, b, c


def _product(a: Matrix, b: Matrix) -> Matrix:
    x, y, z = (_transform(a, column) for column in _transposed(b))
    return _transposed((x, y, z))


@dataclass(frozen=True)
class Body:
    """Ten inertial parameters about the origin of a frame: inertia, first moments (``MX MY MZ``), mass."""

    inertia: Matrix
    first: Vector
    mass: Any

    def plus(self, other: Body) -> Body:
        """Return the sum of two bodies."""
        a, b, c = (x.plus(y) for x, y in zip(self.inertia, other.inertia, strict=True))
        return Body((a, b, c), self.first.plus(other.first), self.mass + other.mass)

    def moved(self, rotation: Matrix, shift: Vector) -> Body:
        """Return the same body in the preceding frame, in which this frame is rotated and shifted."""
        first = _transform(rotation, self.first)
        turned = _product(_product(rotation, self.inertia), _transposed(rotation))
        # J + (2 t.h + m t.t) 1 - t h' - h t' - m t t'
        along = 2 * shift.dot(first) + self.mass * shift.dot(shift)
        rows = []
        for i in range(3):
            row = []
            for k in range(3):
                entry = (
                    turned[i][k] - shift[i] * first[k] - first[i] * shift[k] - self.mass * shift[i] * shift[k]
                )
                row.append(entry + along if i == k else entry)
            rows.append(Vector(*row))
        return Body((rows[0], rows[1], rows[2]), first.plus(shift.times(self.mass)), self.mass)


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
        if robot.geometry.followers:
            raise FitError(
                f"robot {robot.name!r} has joints that follow others: C code and LaTeX are written for driven joints only"
            )
        self.parents = robot.geometry.parents
        self.robot, self.algebra, self.n, self.q = robot, algebra, robot.n_dof, q
        self.zero = algebra.number(0.0)
        self.value: Callable[[str], Any] = lambda name: values.get(name, self.zero)
        self.turns = [kind == "revolute" for kind in robot.geometry.kinds]
        self.axis = Vector(self.zero, self.zero, algebra.number(1.0))
        self.rotations, self.shifts = self._frames(q)
        self.bodies = [self._body(j + 1) for j in range(self.n)]

    def _frames(self, q: Sequence[Any]) -> tuple[list[Matrix], list[Vector]]:
        """Rotation and origin of each frame in that of its antecedent."""
        number, geometry = self.algebra.number, self.robot.geometry
        rotations: list[Matrix] = []
        shifts = []
        for j in range(self.n):
            ca, sa = (_clean(f(geometry.alpha[j])) for f in (math.cos, math.sin))
            angle, length = number(geometry.theta[j]), number(geometry.r[j])
            if self.turns[j]:
                angle = q[j] + angle
            else:
                length = q[j] + length
            c, s = self.algebra.cos(angle), self.algebra.sin(angle)
            rotation = (
                Vector(c, -s, self.zero),
                Vector(s * number(ca), c * number(ca), number(-sa)),
                Vector(s * number(sa), c * number(sa), number(ca)),
            )
            shift = Vector(number(geometry.d[j]), length * number(-sa), length * number(ca))
            if geometry.mounts:
                mount = geometry.mounts[j]
                cg, sg = (number(_clean(f(mount.gamma))) for f in (math.cos, math.sin))
                turn = (
                    Vector(cg, -sg, self.zero),
                    Vector(sg, cg, self.zero),
                    Vector(self.zero, self.zero, number(1.0)),
                )
                x, y, z = mount.shift
                rotation = _product(turn, rotation)
                shift = _transform(turn, shift).plus(Vector(number(x), number(y), number(z + mount.b)))
            rotations.append(rotation)
            shifts.append(shift)
        return rotations, shifts

    def _body(self, link: int) -> Body:
        xx, xy, xz, yy, yz, zz, mx, my, mz, m = (
            self.value(f"{key}{link}") for key in ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
        )
        inertia = (Vector(xx, xy, xz), Vector(xy, yy, yz), Vector(xz, yz, zz))
        return Body(inertia, Vector(mx, my, mz), m)

    def gravity(self) -> list[Any]:
        """Return the torques that hold the robot at rest, springs included, without friction (N.m or N)."""
        still = [self.zero] * self.n
        return self._sprung(self._links(still, still))

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
            return algebra.sin(q) if term.law == "sine" else algebra.cos(q)
        a, b, phi, rest = term.values
        angle, moment = q + algebra.number(phi), algebra.number(a * b)
        lever = moment * algebra.sin(angle)
        slope = lever * algebra.inverse_root(
            algebra.number(a * a + b * b) - moment * algebra.cos(angle) * algebra.number(2.0)
        )
        return slope if term.law == "cylinder" else lever - algebra.number(rest) * slope

    def torque(self, dq: Sequence[Any], ddq: Sequence[Any], z: Sequence[Any] = ()) -> list[Any]:
        """Return the torques of the inverse model (1), friction and offsets included (N.m or N).

        ``z`` has the states of the terms that remember, in the order of `remembering`.
        """
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
                friction[j] = friction[j] + parameter * signs[j] * self.algebra.magnitude(tau[j])
            else:
                friction[j] = friction[j] + parameter * self.algebra.term(term, dq[j], signs[j])
        return self._sprung([a + b for a, b in zip(tau, friction, strict=True)])

    def inertia(self) -> list[list[Any]]:
        """Return the inertia matrix M(q) with rotors, by composite bodies; its lower triangle is computed and mirrored."""
        matrix = [list(row) for row in self.rotors()]
        composites = list(self.bodies)
        for j in range(self.n - 1, -1, -1):
            composite, before = composites[j], self.parents[j]
            if before is not None:
                moved = composite.moved(self.rotations[j], self.shifts[j])
                composites[before] = composites[before].plus(moved)
            if self.turns[j]:  # torque for a unit acceleration of joint j
                force, moment = self.axis.cross(composite.first), _transform(composite.inertia, self.axis)
            else:
                force, moment = self.axis.times(composite.mass), composite.first.cross(self.axis)
            outer = j
            for i in reversed(carriers(self.parents, j)):
                if i < j:
                    force, moment = self._inwards(outer, force, moment)
                outer = i
                entry = matrix[j][i] + (moment if self.turns[i] else force)[2]
                matrix[j][i] = matrix[i][j] = entry
        return matrix

    def rotors(self) -> list[list[Any]]:
        """Return the contribution of rotors to M(q), (24)."""
        matrix = [[self.zero] * self.n for _ in range(self.n)]
        for j in range(self.n):
            matrix[j][j] = self.value(f"Ia{j + 1}")
        for m, row in self._coupled():
            rotor = self.value(f"Ia{m + 1}")
            for i in range(self.n):
                for k in range(self.n):
                    if i != k and row[i] * row[k]:
                        matrix[i][k] = matrix[i][k] + rotor * self.algebra.number(row[i] * row[k])
        return matrix

    def _coupled(self) -> list[tuple[int, list[float]]]:
        """Return the motors that turn with several joints, with the coefficients of the joint speeds."""
        coupling = np.array(self.robot.geometry.coupling)
        coupled = []
        for m, row in enumerate(coupling):
            if np.count_nonzero(row) > 1:
                coupled.append((m, (row / row[m]).tolist()))
        return coupled

    def _links(self, dq: Sequence[Any], ddq: Sequence[Any]) -> list[Any]:
        """Return the torques of the links; gravity is an acceleration of the base."""
        number = self.algebra.number
        omega = domega = Vector(self.zero, self.zero, self.zero)
        x, y, z = self.robot.geometry.gravity
        a = Vector(number(-x), number(-y), number(-z))
        base = (omega, domega, a)
        motions: list[tuple[Vector, Vector, Vector]] = []
        wrenches = []
        for j, parent in enumerate(self.parents):
            omega, domega, a = base if parent is None else motions[parent]
            back, t = _transposed(self.rotations[j]), self.shifts[j]
            a = _transform(back, a.plus(domega.cross(t)).plus(omega.cross(omega.cross(t))))
            omega, domega = _transform(back, omega), _transform(back, domega)
            speed, gain = self.axis.times(dq[j]), self.axis.times(ddq[j])
            if self.turns[j]:
                domega = domega.plus(omega.cross(speed)).plus(gain)
                omega = omega.plus(speed)
            else:
                a = a.plus(omega.cross(speed).times(number(2.0))).plus(gain)
            motions.append((omega, domega, a))
            body = self.bodies[j]
            force = (
                a.times(body.mass).plus(domega.cross(body.first)).plus(omega.cross(omega.cross(body.first)))
            )
            spin = omega.cross(_transform(body.inertia, omega))
            moment = _transform(body.inertia, domega).plus(spin).plus(body.first.cross(a))
            wrenches.append((force, moment))
        tau = [self.zero] * self.n
        for j in range(self.n - 1, -1, -1):
            force, moment = wrenches[j]
            tau[j] = (moment if self.turns[j] else force)[2]
            parent = self.parents[j]
            if parent is not None:
                force, moment = self._inwards(j, force, moment)
                wrenches[parent] = (wrenches[parent][0].plus(force), wrenches[parent][1].plus(moment))
        return tau

    def _inwards(self, j: int, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
        """Return a wrench of frame `j` in the frame of its antecedent."""
        force, moment = _transform(self.rotations[j], force), _transform(self.rotations[j], moment)
        return force, moment.plus(self.shifts[j].cross(force))

    def _friction(self, dq: Sequence[Any], signs: Sequence[Any], now: Sequence[Any]) -> list[Any]:
        """Return viscous and Coulomb friction; `signs` may be held at rest, `now` are instantaneous."""
        tau = []
        for j, (speed, sign) in enumerate(zip(dq, signs, strict=True)):
            name = f"{j + 1}"
            if self.robot.friction.model == "asymmetric":
                forward, onward = self.algebra.positive(speed), self.algebra.positive(sign)
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
            shaft = self.zero
            for factor, speed in zip(row, dq, strict=True):
                if factor:
                    shaft = shaft + speed * number(factor)
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


def remembering(robot: Robot) -> list[FrictionTerm]:
    """Return the friction terms with a state, in the order of the states."""
    return [term for term in robot.friction.terms if term.law in OF_PATH]


def _clean(value: float) -> float:
    """Return a cosine or sine, rounded to zero or one for right angles."""
    nearest = float(round(value))
    return nearest if abs(value - nearest) < 1e-15 else value
