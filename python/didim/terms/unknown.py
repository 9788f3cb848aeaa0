"""The vector of unknowns: names, units, roles and values, and the only file that knows their places.

Tested in ``tests/test_unknowns.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from .._tools.arrays import Array

Role = Literal["estimated", "fixed", "dropped"]


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """One entry of the vector of unknowns.

    Attributes
    ----------
    name : str
        Name, with its owner before it if it has one: ``disc.MX``.
    unit : str
        Unit, joint side.
    role : {"estimated", "fixed", "dropped"}
        Whether the log is asked for it.
    value : float
        Value of a fixed one, otherwise zero.
    """

    name: str
    unit: str
    role: Role = "estimated"
    value: float = 0.0


@dataclass(frozen=True)
class Unknowns:
    """All unknowns of a model, in the order of its vector.

    Attributes
    ----------
    entries : tuple of Unknown
        One per entry of the vector, of n; m of them are estimated.
    """

    entries: tuple[Unknown, ...]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names, n of them."""
        return tuple(each.name for each in self.entries)

    @cached_property
    def roles(self) -> tuple[Role, ...]:
        """Roles, n of them."""
        return tuple(each.role for each in self.entries)

    @cached_property
    def values(self) -> Array:
        """Values of the fixed ones, zero elsewhere, (n,)."""
        return np.array([each.value for each in self.entries])

    @cached_property
    def estimated(self) -> list[int]:
        """Indices of the estimated ones, m of them."""
        return [index for index, role in enumerate(self.roles) if role == "estimated"]

    def given(self, role: Role) -> dict[str, float]:
        """Return names and values of the unknowns with a role."""
        return {each.name: each.value for each in self.entries if each.role == role}

    def with_roles(self, roles: Mapping[str, tuple[Role, float]]) -> Unknowns:
        """Return the unknowns with other roles and values, by name."""
        return Unknowns(
            tuple(
                replace(each, role=roles[each.name][0], value=roles[each.name][1])
                if each.name in roles
                else each
                for each in self.entries
            )
        )

    def expand(self, estimate: Array) -> Array:
        """Return the vector of all, (n,), from that of the estimated ones, (m,)."""
        return self.values + self.among_all(estimate)

    def among_all(self, values: Array) -> Array:
        """Return values of the estimated ones among those of all, (..., n): zero for the others."""
        full = np.zeros((*values.shape[:-1], len(self.entries)))
        full[..., self.estimated] = values
        return full

    def expand_covariance(self, covariance: Array) -> Array:
        """Return the covariance of all, (n, n): zero for those that are not estimated."""
        full = np.zeros((len(self.entries), len(self.entries)))
        full[np.ix_(self.estimated, self.estimated)] = covariance
        return full
