"""Expressions recorded during a computation: the same Python code produces numbers, C or formulas.

Equal expressions are one node, and constants are folded: zeros and ones of a robot's geometry vanish.
Tested in ``tests/test_export_c.py``.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass, field

Node = tuple[str, tuple[object, ...]]
"""Operation and its operands: numbers of other nodes, or the content of a leaf."""

FUNCTIONS: dict[str, Callable[[float], float]] = {
    "sin": math.sin,
    "cos": math.cos,
    "tanh": math.tanh,
    "atan": math.atan,
    "exp": math.exp,
    "sqrt": math.sqrt,
    "abs": abs,
}
"""Functions by name, which have a value for constants."""

_FOLD: dict[str, Callable[..., float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "neg": operator.neg,
    **FUNCTIONS,
}


@dataclass
class Graph:
    """Nodes of expressions in the order in which they can be computed.

    Attributes
    ----------
    nodes : list of Node
        Operands of a node precede it.
    """

    nodes: list[Node] = field(default_factory=list)
    _known: dict[Node, int] = field(default_factory=dict, repr=False)

    def leaf(self, name: str) -> Expression:
        """Return an input with this name."""
        return self._node("leaf", name)

    def number(self, value: float) -> Expression:
        """Return a constant."""
        return self._node("number", value + 0.0)  # zero has no sign

    def apply(self, name: str, *operands: Expression, extra: tuple[object, ...] = ()) -> Expression:
        """Return a function of expressions; one of constants alone is a constant."""
        values = [self.value(one) for one in operands]
        if name in _FOLD and all(value is not None for value in values):
            return self.number(_FOLD[name](*values))
        return self._node(name, *(one.index for one in operands), *extra)

    def value(self, one: Expression) -> float | None:
        """Return the value of a constant, None for any other node."""
        name, operands = self.nodes[one.index]
        return operands[0] if name == "number" else None  # type: ignore[return-value]

    def _node(self, name: str, *operands: object) -> Expression:
        node = (name, operands)
        if node not in self._known:
            self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return Expression(self, self._known[node])


@dataclass(frozen=True)
class Expression:
    """A node of a graph, with arithmetic."""

    graph: Graph
    index: int

    def __add__(self, other: Expression | float) -> Expression:
        other = self._expression(other)
        if self._is(0.0):
            return other
        if other._is(0.0):
            return self
        if other._negated is not None:
            return self - other._negated
        if self._negated is not None:
            return other - self._negated
        first, second = sorted((self, other), key=lambda one: one.index)
        return self.graph.apply("+", first, second)

    def __sub__(self, other: Expression | float) -> Expression:
        other = self._expression(other)
        if other._is(0.0):
            return self
        if self._is(0.0):
            return -other
        if self.index == other.index:
            return self.graph.number(0.0)
        if other._negated is not None:
            return self + other._negated
        return self.graph.apply("-", self, other)

    def __mul__(self, other: Expression | float) -> Expression:
        other = self._expression(other)
        for factor, cofactor in ((self, other), (other, self)):
            if factor._is(0.0):
                return factor
            if factor._is(1.0):
                return cofactor
            if factor._is(-1.0):
                return -cofactor
            if factor._negated is not None:
                return -(factor._negated * cofactor)
        first, second = sorted((self, other), key=lambda one: one.index)
        return self.graph.apply("*", first, second)

    def __neg__(self) -> Expression:
        return self._negated or self.graph.apply("neg", self)

    def __rmul__(self, other: float) -> Expression:
        return self._expression(other) * self

    @property
    def _negated(self) -> Expression | None:
        """Return the operand of a negation, or None."""
        name, operands = self.graph.nodes[self.index]
        return Expression(self.graph, operands[0]) if name == "neg" else None  # type: ignore[arg-type]

    def _is(self, value: float) -> bool:
        return self.graph.value(self) == value

    def _expression(self, other: Expression | float) -> Expression:
        return other if isinstance(other, Expression) else self.graph.number(other)
