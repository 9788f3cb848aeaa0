"""Roles of the base parameters: estimated, fixed to a value, or dropped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Literal

import numpy as np

from .._tools.arrays import Array
from .._tools.words import did_you_mean, series
from ..errors import FitError
from ..robot.robot import Robot

Role = Literal["estimated", "fixed", "dropped"]


@dataclass(frozen=True, kw_only=True)
class Selection:
    """Roles of the base parameters of a robot.

    Attributes
    ----------
    roles : tuple of {"estimated", "fixed", "dropped"}
        One per base parameter.
    values : ndarray, shape (b,)
        Value of a fixed parameter, zero elsewhere.
    """

    roles: tuple[Role, ...]
    values: Array

    @property
    def estimated(self) -> list[int]:
        """Indices of the estimated base parameters."""
        return [index for index, role in enumerate(self.roles) if role == "estimated"]

    def expand(self, estimate: Array) -> Array:
        """Vector of all base parameters, shape (b,), from that of the estimated ones."""
        return self.values + self.among_all(estimate)

    def among_all(self, values: Array) -> Array:
        """Values of the estimated base parameters among those of all, shape (..., b): zero for the others."""
        full = np.zeros((*values.shape[:-1], len(self.roles)))
        full[..., self.estimated] = values
        return full

    def expand_covariance(self, covariance: Array) -> Array:
        """Covariance of all base parameters, shape (b, b): zero for those that are not estimated."""
        full = np.zeros((len(self.roles), len(self.roles)))
        full[np.ix_(self.estimated, self.estimated)] = covariance
        return full


def dropped_names(dropped: Iterable[str]) -> tuple[str, ...]:
    """Check names of parameters to drop.

    Raises
    ------
    FitError
        For a single text, which would be taken letter by letter, and for values that are not text
        (``test_identify.py``).
    """
    names = None if isinstance(dropped, str) or not isinstance(dropped, Iterable) else tuple(dropped)
    if names is None or not all(isinstance(name, str) for name in names):
        raise FitError(f"dropped must be a list of parameter names, got {dropped!r}")
    return names


def select(robot: Robot, fixed: Mapping[str, float], dropped: Iterable[str]) -> Selection:
    """Find the base parameters that are named in an experiment.

    Parameters
    ----------
    robot : Robot
        Robot with the base parameters.
    fixed : mapping of str to float
        Values of known base parameters, SI units, joint side.
    dropped : iterable of str
        Base parameters taken as zero.

    Returns
    -------
    Selection
        A role for every base parameter.

    Raises
    ------
    FitError
        For a name that is not a base parameter (the message says which one a standard parameter regroups into),
        for a value that is not finite, and for a name that is both fixed and dropped.

    Notes
    -----
    ``test_identify.py`` fixes and drops parameters of a simulated log.
    """
    names = robot.base_parameters.names
    roles: list[Role] = ["estimated"] * len(names)
    values = np.zeros(len(names))
    for name, value in fixed.items():
        index = _index(robot, name)
        if isinstance(value, bool) or not isinstance(value, Real) or not np.isfinite(value):
            raise FitError(f"fixed parameter {name} must have a finite value, got {value!r}")
        roles[index], values[index] = "fixed", value
    for name in dropped:
        index = _index(robot, name)
        if roles[index] == "fixed":
            raise FitError(f"parameter {name} is both fixed and dropped; choose one")
        roles[index] = "dropped"
    return Selection(roles=tuple(roles), values=values)


def _index(robot: Robot, name: str) -> int:
    base = robot.base_parameters
    if name in base.names:
        return base.names.index(name)
    if name in base.unidentifiable:
        raise FitError(
            f"parameter {name} of robot '{robot.name}' has no effect on the torques: it needs no value"
        )
    if name in robot.parameter_names:
        column = base.matrix[:, robot.parameter_names.index(name)]
        into = [base.names[row] for row in np.flatnonzero(column)]
        raise FitError(
            f"{name} is a standard parameter of robot '{robot.name}' that regroups into {series(into, 40)}: "
            "fix or drop base parameters"
        )
    hint = did_you_mean(name, base.names) or f"; `didim base {robot.name}` lists them"
    raise FitError(f"robot '{robot.name}' has no base parameter {name}{hint}")
