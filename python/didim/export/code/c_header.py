"""The model of a robot as a C99 header: torques, inertia matrix and gravity, without loops or allocation.

Tested in ``tests/test_export_c.py``: compiled with every warning an error, and equal to the core.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..._tools.settings import positive
from ...errors import FitError
from ...model.dynamics import standard_vector
from ...robot.friction import HOLD_WIDTH, FrictionTerm
from ...robot.robot import Robot
from .equations import Equations, of_all_joints, remembering
from .expression import FUNCTIONS, Expression, Graph

_LONGEST = 90
"""Largest number of characters of an expression without a variable of its own."""


@dataclass(kw_only=True)
class _Written(Graph):
    """Expressions of C code, and the robot whose friction they have."""

    robot: Robot

    def over(self, value: Expression, divisor: float) -> Expression:
        return value * (1.0 / divisor)

    def sign(self, joint: int, speed: Expression) -> Expression:
        friction = self.robot.friction
        zone = self.number(friction.dead_zone[joint])
        if friction.coulomb != "tanh":
            return self.apply("sign", speed, zone)
        smooth = self.apply("tanh", self.over(speed, friction.smoothing[joint]))
        return self.apply("outside", speed, zone, smooth) if friction.dead_zone[joint] > 0.0 else smooth

    def term(self, term: FrictionTerm, speed: Expression) -> Expression:
        if term.law == "table":
            return self.apply("table", speed, extra=(term.parameter,))
        zone, one = self.robot.friction.dead_zone[term.joint], self.number(1.0)
        outside = self.apply("outside", speed, self.number(zone), one) if zone > 0.0 else one
        return one - outside  # a term of rest


def to_c(robot: Robot, x: ArrayLike, *, prefix: str | None = None, smoothing: float | None = None) -> str:
    """Write the model of a robot as a C99 header.

    Parameters
    ----------
    robot : Robot
        The robot, with all details of its friction (sign or tanh, dead zones, further terms).
    x : (n_parameters,) array
        Standard parameters in the order of ``robot.parameter_names``, SI units, joint side. Parameters with the same torques
        give the same functions: the code contains the base parameters, or all parameters if friction depends on the load or joints
        follow others.
    prefix : str, optional
        Prefix of the names in the header, with or without a last underscore; by default the name of the robot.
    smoothing : float, optional
        Velocity (rad/s or m/s) of a tanh in the place of the sign of Coulomb friction, which jumps at rest.

    Returns
    -------
    str
        The header: ``PREFIX_tau(q, dq, ddq, tau)``, ``PREFIX_inertia(q, M)`` (row by row) and ``PREFIX_gravity(q, tau)``, joint
        side, SI units. They only need ``math.h`` and do not allocate. If friction has memory (``hold``, ``dahl``),
        ``PREFIX_tau(q, dq, ddq, z, tau)`` takes its states, and ``PREFIX_remember(dx, z)`` updates them for a step of the
        positions.

    Raises
    ------
    FitError
        When the prefix is not a C identifier, or the smoothing not positive (``tests/test_export_c.py``).
    ShapeError
        When `x` has another length, or a NaN.
    """
    if prefix is None:
        prefix = re.sub(r"\W+", "_", robot.name, flags=re.ASCII).lower()
        prefix = f"_{prefix}".lstrip("_") if not prefix[:1].isdigit() else f"robot_{prefix}"
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix):
        raise FitError(f"names in C begin with a letter and have letters, digits and _, got {prefix!r}")
    prefix = prefix.rstrip("_")  # names with two underscores are the compiler's
    if smoothing is not None:
        positive("smoothing", smoothing, FitError)
        smooth = replace(robot.friction, coulomb="tanh", smoothing=(float(smoothing),) * robot.n_dof)
        robot = replace(robot, friction=smooth)
    x = standard_vector(robot, x)
    base = robot.base_parameters
    beta = base.project(x)
    # Gravity has no offset in it, although both are one parameter where joints that slide follow others, and load friction too.
    together = robot.friction.has_load or robot.geometry.followers
    written = x if together else base.lift(beta)
    values = {name: float(value) for name, value in zip(robot.parameter_names, written, strict=True)}
    memory = remembering(robot)
    functions = [
        _function(of_all_joints(robot), values, prefix, one) for one in _functions(robot.n_dof, len(memory))
    ]
    if memory:
        functions.append(_remember(robot, memory, prefix))
    body = "\n".join(functions)
    guard = f"{prefix.upper()}_DYNAMICS_H"
    names = robot.all_joint_names or ("",) * robot.n_joints
    kinds = ", ".join(
        f"{j + 1} {_comment(name)} ({kind})" if name else f"{j + 1} {kind}"
        for j, (name, kind) in enumerate(zip(names, robot.geometry.kinds, strict=True))
    )
    lines = [
        f"/* Inverse dynamics of {_comment(robot.name)}: tau = M(q) ddq + N(q, dq).",
        " *",
        " * SI units, joint side: rad, N.m for revolute joints, m, N for prismatic ones. Joints: "
        + kinds
        + "."
        + (f" Motions and torques are those of the first {robot.n_dof}." if robot.geometry.followers else ""),
        " * Nothing is allocated, nothing is kept between calls."
        if not memory
        else f" * Nothing is allocated. Friction that remembers has its states z in your hands: {prefix}_remember.",
        " *",
        " * Base parameters:",
        *(
            f" *   {name:8} {value!r} {unit}"
            for name, value, unit in zip(base.names, beta.tolist(), base.units, strict=True)
        ),
        " */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        "#include <math.h>",
        "",
        f"#define {prefix.upper()}_DOF {robot.n_dof}",
        *([f"#define {prefix.upper()}_STATES {len(memory)}"] if memory else []),
        "",
        *_helpers(robot, prefix, body),
        body,
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _remember(robot: Robot, memory: Sequence[FrictionTerm], prefix: str) -> str:
    """Write the function that updates the states of friction for a step of the positions, exact for any length."""
    widths = [
        HOLD_WIDTH[robot.joint_kinds[term.joint]] if term.law == "hold" else term.velocity for term in memory
    ]
    count = len(memory)
    return "\n".join(
        [
            "/* Take the states z of friction along a step dx = q - q_before of the positions. They begin at the sign of the",
            " * velocity, at rest at zero. */",
            f"static inline void {prefix}_remember(const double dx[{robot.n_dof}], double z[{count}])",
            "{",
            f"    static const int joint[{count}] = {{{', '.join(str(term.joint) for term in memory)}}};",
            f"    static const double width[{count}] = {{{', '.join(map(repr, widths))}}};",
            "    int k;",
            f"    for (k = 0; k < {count}; ++k) {{",
            "        const double way = dx[joint[k]];",
            "        if (way > 0.0 || way < 0.0) {",
            "            const double s = way > 0.0 ? 1.0 : -1.0;",
            "            z[k] = s - (s - z[k]) * exp(-fabs(way) / width[k]);",
            "        }",
            "    }",
            "}",
            "",
        ]
    )


@dataclass(frozen=True)
class _Function:
    """A function of the header: its name, inputs with their sizes, and results from the model and all inputs but q."""

    name: str
    purpose: str
    inputs: Mapping[str, int]
    output: str
    results: Callable[..., list[Expression]]


def _functions(n: int, states: int) -> list[_Function]:
    """Return the functions for so many joints and states of friction."""
    words, memory = (", states z of friction", {"z": states}) if states else ("", {})
    return [
        _Function(
            "tau",
            f"Torques of the inverse model at positions q, velocities dq, accelerations ddq{words}, friction included.",
            {"q": n, "dq": n, "ddq": n, **memory},
            "tau",
            Equations.torque,
        ),
        _Function(
            "inertia",
            f"Inertia matrix M(q) with rotors, row by row: M[{n} * i + j].",
            {"q": n},
            "M",
            lambda model: [entry for row in model.inertia() for entry in row],
        ),
        _Function(
            "gravity",
            "Torques that hold the robot against gravity, without friction and offsets.",
            {"q": n},
            "tau",
            Equations.gravity,
        ),
    ]


def _function(robot: Robot, values: Mapping[str, float], prefix: str, function: _Function) -> str:
    """Write a function that computes results in sequence, common subexpressions once."""
    graph = _Written(robot=robot)
    named = {name: graph.number(value) for name, value in values.items()}
    inputs = ([graph.leaf(f"{name}[{k}]") for k in range(size)] for name, size in function.inputs.items())
    model = Equations(robot, named, graph, next(inputs))
    results = function.results(model, *inputs)
    needed, uses = _needed(graph, [one.index for one in results])
    texts: dict[int, str] = {}
    lines = []
    for index in needed:
        name, operands = graph.nodes[index]
        text = _text(name, operands, texts, prefix)
        if name not in ("leaf", "number") and (uses[index] > 1 or len(text) > _LONGEST):
            lines.append(f"    const double t{index} = {_bare(text)};")
            text = f"t{index}"
        texts[index] = text
    written = " ".join(lines)
    outputs = [f"    {function.output}[{k}] = {_bare(texts[one.index])};" for k, one in enumerate(results)]
    code = written + " ".join(outputs)
    unused = [f"    (void){name};" for name in function.inputs if not re.search(rf"\b{name}\[", code)]
    arguments = [f"const double {name}[{size}]" for name, size in function.inputs.items()]
    arguments.append(f"double {function.output}[{len(results)}]")
    head = f"static inline void {prefix}_{function.name}({', '.join(arguments)})"
    return "\n".join([f"/* {function.purpose} */", head, "{", *unused, *lines, *outputs, "}", ""])


def _needed(graph: Graph, ends: Sequence[int]) -> tuple[list[int], dict[int, int]]:
    """Return the nodes that results depend on, in order, with their number of uses."""
    uses: dict[int, int] = {}
    open_ = list(ends)
    for index in open_:
        uses[index] = uses.get(index, 0) + 1
        if uses[index] == 1:
            name, operands = graph.nodes[index]
            if name not in ("leaf", "number"):
                open_ += [one for one in operands if isinstance(one, int)]
    return sorted(uses), uses


def _text(name: str, operands: Sequence[object], texts: dict[int, str], prefix: str) -> str:
    if name == "leaf":
        return str(operands[0])
    if name == "number":
        text = repr(operands[0])
        return f"({text})" if text.startswith("-") else text
    parts = [texts[one] for one in operands if isinstance(one, int)]
    if name in ("+", "-", "*"):
        if name != "*":  # products bind first, and sums go from left to right
            parts = [_bare(part) if _joined_by(part) == {"*"} else part for part in parts]
            parts[0] = _bare(parts[0]) if _joined_by(parts[0]) else parts[0]
        return f"({parts[0]} {name} {parts[1]})"
    if name == "neg":
        return f"(-{parts[0]})"
    if name in FUNCTIONS:
        return f"{'fabs' if name == 'abs' else name}({_bare(parts[0])})"
    own = operands[-1] if name == "table" else name
    return f"{prefix}_{own}({', '.join(map(_bare, parts))})"


def _joined_by(text: str) -> set[str]:
    """Return the signs that join the operands within the outer brackets; none without brackets."""
    inside = _bare(text)
    depth, signs = 0, set()
    for word in inside.split(" ") if inside != text else ():
        if depth == 0 and word in ("+", "-", "*"):
            signs.add(word)
        depth += word.count("(") - word.count(")")
    return signs


def _bare(text: str) -> str:
    """Remove brackets around the whole expression."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for column, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return text[1:-1] if column == len(text) - 1 else text
    return text


def _helpers(robot: Robot, prefix: str, body: str) -> list[str]:
    """Return the helper functions that the body uses."""
    lines = []
    for name, head, value in (
        ("sign", "double speed, double zone", "speed > zone ? 1.0 : (speed < -zone ? -1.0 : 0.0)"),
        ("outside", "double speed, double zone, double value", "fabs(speed) > zone ? value : 0.0"),
        ("positive", "double value", "value > 0.0 ? value : 0.0"),
        ("inverse_root", "double value", "1.0 / sqrt(value)"),
    ):
        if f"{prefix}_{name}(" in body:
            lines += [f"static inline double {prefix}_{name}({head})", "{", f"    return {value};", "}", ""]
    for term in robot.friction.of("table"):
        if f"{prefix}_{term.parameter}(" in body:
            lines += _table(term, prefix)
    return lines


def _table(term: FrictionTerm, prefix: str) -> list[str]:
    """Write a tabulated law: cubics between neighbours, straight lines beyond the ends."""
    values = np.array(term.values)
    slopes = np.gradient(values, edge_order=2)  # times the step: parabola through three neighbours
    last = len(values) - 1
    return [
        f"static inline double {prefix}_{term.parameter}(double speed)",
        "{",
        f"    static const double values[{last + 1}] = {{{', '.join(map(repr, values.tolist()))}}};",
        f"    static const double slopes[{last + 1}] = {{{', '.join(map(repr, slopes.tolist()))}}};",
        f"    const double place = (speed - ({term.first!r})) / {term.step!r};",
        "    if (!(place > 0.0)) {",
        "        return values[0] + slopes[0] * place;",
        "    }",
        f"    if (place >= {float(last)!r}) {{",
        f"        return values[{last}] + slopes[{last}] * (place - {float(last)!r});",
        "    }",
        "    {",
        "        const int k = (int)place;",
        "        const double u = place - k, v = 1.0 - u;",
        "        return values[k] * ((1.0 + 2.0 * u) * v * v) + values[k + 1] * (u * u * (3.0 - 2.0 * u))",
        "               + u * v * (slopes[k] * v - slopes[k + 1] * u);",
        "    }",
        "}",
        "",
    ]


def _comment(text: str) -> str:
    """Escape a text for use in a comment."""
    return text.replace("*/", "* /")
