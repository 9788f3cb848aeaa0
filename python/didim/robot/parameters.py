"""Parameters of a robot: the standard ones (3), and the base parameters (7), their identifiable combinations."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import didim._core as _core

from .._tools.arrays import Array, real_array
from .._tools.notebook import page, pandas
from .._tools.pickling import Pickled
from .._tools.words import columned
from ..errors import ShapeError


class Parameter(NamedTuple):
    """A standard parameter.

    Tested in ``tests/test_base_parameters.py``.

    Attributes
    ----------
    kind : str
        Such as "XX", "Ia", "Fv", "Fcm" (friction of a coupled motor), or the name of a friction term.
    joint : int
        Joint whose link or drive it belongs to, from 0.
    side : {"", "+", "-"}
        Direction of motion that asymmetric friction is of.
    """

    kind: str
    joint: int
    side: str = ""

    @property
    def name(self) -> str:
        """Name as printed, such as ``Fc3+``."""
        return f"{self.kind}{self.joint + 1}{self.side}"

    @classmethod
    def of_core(cls, name: str) -> Parameter:
        """Return the parameter of a name of the core, whose kinds have no digits."""
        parts = re.fullmatch(r"(\D+)(\d+)([+-]?)", name)
        assert parts is not None
        return cls(parts[1], int(parts[2]) - 1, parts[3])


def friction_names(joint: int, kinds: Sequence[str] = ("Fv", "Fc")) -> frozenset[str]:
    """Return the names that friction of a joint, from 0, can have, symmetric or not: viscous and Coulomb friction by default."""
    return frozenset(Parameter(kind, joint, side).name for kind in kinds for side in ("", "+", "-"))


@dataclass(frozen=True, kw_only=True, eq=False)
class BaseParameters(Pickled):
    """The base parameters of a robot.

    The columns of the regressor are scanned in the order of the standard parameters, and a column that
    depends on the independent ones before it regroups into them: on the TX40 this gives the 60 names of Table II
    (``tests/test_base_parameters.py``).

    Attributes
    ----------
    names : tuple of str
        Names, joint by joint; an ``R`` marks those that others regroup into.
    units : tuple of str
        Units, joint side.
    indices : tuple of int
        Standard parameter that gives each base parameter its name.
    groupings : tuple of str
        One sum per base parameter, such as ``ZZ1R = ZZ1 + Ia1 + YY2``.
    unidentifiable : tuple of str
        Standard parameters without any effect on the torques.
    matrix : (n_base, n_parameters) array
        ``beta = matrix @ x``.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    indices: tuple[int, ...]
    groupings: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    matrix: Array

    @property
    def _title(self) -> str:
        return f"{len(self.names)} base parameters of {self.matrix.shape[1]} standard parameters"

    @property
    def _rows(self) -> list[tuple[str, str, str]]:
        return list(zip(self.names, self.units, self.groupings, strict=True))

    @property
    def _silent(self) -> str:
        names = ", ".join(self.unidentifiable)
        return f"Without effect on the torques: {names}" if names else ""

    def __str__(self) -> str:
        silent = ["", self._silent] if self._silent else []
        return "\n".join([self._title, "", *columned(self._rows, left=3), *silent])

    def __repr__(self) -> str:
        return f"<BaseParameters: {len(self.names)} of {self.matrix.shape[1]} standard parameters>"

    def _repr_html_(self) -> str:
        return page(self._title, [("name", "unit", "grouping"), *self._rows], self._silent)

    def to_dataframe(self) -> Any:
        """Return names, units and groupings as a pandas ``DataFrame``, by name.

        Raises
        ------
        DidimError
            Without pandas (``tests/test_notebook.py``).
        """
        columns = {"unit": self.units, "grouping": self.groupings}
        return pandas().DataFrame(columns, index=pandas().Index(self.names, name="parameter"))

    def lift(self, beta: ArrayLike) -> Array:
        """Return standard parameters with the same torques.

        Those of `indices` take the base values, the others zero.

        Parameters
        ----------
        beta : (n_base,) array
            Base parameters, SI units, joint side.

        Returns
        -------
        (n_parameters,) array
            Standard parameters in the order of ``robot.parameter_names``.

        Raises
        ------
        ShapeError
            When `beta` has another length.
        """
        values = self._checked("beta", beta, len(self.names))
        x = np.zeros(self.matrix.shape[1])
        x[list(self.indices)] = values
        return x

    def project(self, x: ArrayLike) -> Array:
        """Return the base parameters of a vector of standard parameters, ``matrix @ x``.

        Parameters
        ----------
        x : (n_parameters,) array
            Standard parameters, SI units, joint side.

        Returns
        -------
        (n_base,) array

        Raises
        ------
        ShapeError
            When `x` has another length.
        """
        return np.asarray(self.matrix @ self._checked("x", x, self.matrix.shape[1]))

    @staticmethod
    def _checked(what: str, values: ArrayLike, length: int) -> Array:
        array = real_array(what, values, ShapeError)
        if array.shape != (length,):
            raise ShapeError(f"{what} must have shape ({length},), got {array.shape}")
        return array


def base_parameters(core: _core.Robot) -> BaseParameters:
    """Find the base parameters of a robot (see `BaseParameters`)."""
    independent, terms, unidentifiable = _core.base_parameters(core)
    standard, units = core.parameter_names, core.parameter_units
    matrix = np.zeros((len(independent), len(standard)))
    names, groupings = [], []
    for row, (column, regrouped) in enumerate(zip(independent, terms, strict=True)):
        matrix[row, column] = 1.0
        for other, coefficient, _ in regrouped:
            matrix[row, other] = coefficient
        name = standard[column] + ("R" if regrouped else "")
        names.append(name)
        text = standard[column]
        for other, _, symbol in regrouped:
            negative = symbol.startswith("-")
            factor = symbol.removeprefix("-").strip()
            text += f" {'-' if negative else '+'} {factor}{' ' if factor else ''}{standard[other]}"
        groupings.append(f"{name} = {text}")
    matrix.setflags(write=False)
    return BaseParameters(
        names=tuple(names),
        units=tuple(units[column] for column in independent),
        indices=tuple(independent),
        groupings=tuple(groupings),
        unidentifiable=tuple(standard[column] for column in unidentifiable),
        matrix=matrix,
    )
