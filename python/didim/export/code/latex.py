"""The equations of a small robot as LaTeX, parameter by parameter. Needs SymPy: ``pip install didim[latex]``.

Tested in ``tests/test_export_latex.py`` against the core.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from ..._tools.plugins import optional
from ...errors import FitError
from ...robot.friction import FrictionTerm
from ...robot.robot import Robot
from .equations import Equations, of_all_joints

if TYPE_CHECKING:
    import sympy

MOST_JOINTS = 3
"""Largest number of joints whose equations are written: those of more joints fill pages."""


_REFUSED = {
    "load": "depends on the load",
    "rest": "acts at standstill only",
    "table": "is given by its values",
    "hold": "depends on the path",
    "dahl": "depends on the path",
    "warm_viscous": "depends on the temperature",
    "warm_coulomb": "depends on the temperature",
}
LARGEST_DENOMINATOR = 12
"""Largest denominator for which a number is written as a fraction."""


@dataclass(frozen=True)
class _Symbolic:
    """Algebra of SymPy."""

    sympy: Any
    robot: Robot
    gravity: Any

    def number(self, value: float) -> Any:
        x, y, z = self.robot.geometry.gravity
        size = abs(x) + abs(y) + abs(z)
        if size and abs(value) == size:  # gravity along an axis has a symbol
            return self.gravity if value > 0.0 else -self.gravity
        for unit, symbol in ((1.0, 1), (math.pi, self.sympy.pi)):
            near = Fraction(value / unit).limit_denominator(1000)
            if abs(float(near) * unit - value) < 1e-14 * max(1.0, abs(value)):
                return self.sympy.Rational(near.numerator, near.denominator) * symbol
        return self.sympy.Float(value)

    def apply(self, function: str, value: Any) -> Any:
        if function == "positive":
            return self.sympy.Max(value, 0)
        if function == "inverse_root":
            return 1 / self.sympy.sqrt(value)
        return getattr(self.sympy, function.replace("abs", "Abs"))(value)

    def over(self, value: Any, divisor: float) -> Any:
        return value / self.number(divisor)

    def sign(self, joint: int, speed: Any) -> Any:
        friction, zone = self.robot.friction, self.robot.friction.dead_zone[joint]
        if friction.coulomb == "tanh":
            signed = self.apply("tanh", self.over(speed, friction.smoothing[joint]))
        else:
            signed = self.apply("sign", speed)
        if not zone > 0.0:
            return signed
        # No friction in the dead zone: the unit step, theta in LaTeX.
        return signed * self.sympy.Heaviside(self.sympy.Abs(speed) - self.number(zone))

    def term(self, term: FrictionTerm, speed: Any) -> Any:
        raise AssertionError(f"{term.law} is in _REFUSED")


def symbolic_model(robot: Robot) -> list[list[tuple[str, sympy.Expr]]]:
    """Write the torque of each joint as base parameters times functions of the motion.

    Parameters
    ----------
    robot : Robot
        A robot of up to three joints.

    Returns
    -------
    list of list of (str, Expr)
        For each joint, the base parameters in its torque with their coefficients: SymPy expressions of the symbols ``q1``,
        ``dq1``, ``ddq1`` and so on (SI units, joint side), and of ``g`` if gravity is along an axis of the base.

    Raises
    ------
    FitError
        For a larger robot, a friction term that is not a formula of the speed, or without SymPy (``tests/test_export_latex.py``).
    """
    if robot.n_joints > MOST_JOINTS:
        raise FitError(
            f"the equations of {robot.n_joints} joints fill pages: LaTeX is written for up to {MOST_JOINTS}; C takes any robot"
        )
    for term in robot.friction.of(*_REFUSED):
        raise FitError(
            f"friction term {term.parameter} {_REFUSED[term.law]}: it has no place in a formula that is linear in parameters"
        )
    sympy = optional("sympy", FitError, "LaTeX of the model needs SymPy: pip install didim[latex]")
    joints = range(1, robot.n_dof + 1)
    q, dq, ddq = ([sympy.Symbol(f"{name}{j}", real=True) for j in joints] for name in ("q", "dq", "ddq"))
    base = robot.base_parameters
    symbols = {name: sympy.Symbol(name) for name in base.names}
    values = {
        robot.parameter_names[i]: symbols[name] for i, name in zip(base.indices, base.names, strict=True)
    }
    robot = of_all_joints(robot)
    algebra = _Symbolic(sympy, robot, sympy.Symbol("g", positive=True))
    model = []
    for torque in Equations(robot, values, algebra, q).torque(dq, ddq):
        coefficients = [(name, _short(sympy, sympy.diff(torque, symbol))) for name, symbol in symbols.items()]
        model.append([(name, value) for name, value in coefficients if value != 0])
    return model


def to_latex(robot: Robot) -> str:
    """Write the inverse dynamic model of a small robot as LaTeX.

    Parameters
    ----------
    robot : Robot
        A robot of up to three joints.

    Returns
    -------
    str
        An ``align`` environment of ``amsmath``: the torque of each joint, one base parameter a line. The theta of a dead zone is
        the unit step.

    Raises
    ------
    FitError
        As `symbolic_model` (``tests/test_export_latex.py``).
    """
    model = symbolic_model(robot)
    import sympy

    names = {"g": "g"}
    for j in range(1, robot.n_dof + 1):
        names |= {f"q{j}": f"q_{{{j}}}", f"dq{j}": rf"\dot q_{{{j}}}", f"ddq{j}": rf"\ddot q_{{{j}}}"}
    lines = []
    for j, terms in enumerate(model):
        for term, (name, value) in enumerate(terms):
            known = {symbol: names[symbol.name] for symbol in value.free_symbols}
            text = sympy.latex(value, symbol_names=known, full_prec=False)
            if isinstance(value, sympy.Add) or text.startswith("-"):
                text = rf"\left({text}\right)"
            product = _parameter(name) if value == 1 else rf"{_parameter(name)}\, {text}"
            lines.append(rf"\tau_{{{j + 1}}} &= {product}" if term == 0 else rf"&\quad + {product}")
    return "\\begin{align*}\n" + " \\\\\n".join(lines) + "\n\\end{align*}\n"


def _short(sympy: Any, value: Any) -> Any:
    """Simplify a coefficient: fewer sines and cosines, decimals instead of long fractions."""
    value = sympy.trigsimp(sympy.expand(value))
    return value.xreplace(
        {part: sympy.Float(part) for part in value.atoms(sympy.Rational) if part.q > LARGEST_DENOMINATOR}
    )


def _parameter(name: str) -> str:
    """Return the LaTeX name of a parameter: ``ZZ_{1R}`` for ``ZZ1R``."""
    letters, number, rest = re.fullmatch(r"(\D+)(\d+)(.*)", name).groups()  # type: ignore[union-attr]
    return rf"\mathit{{{letters}}}_{{{number}{rest}}}"
