"""Table of the methods, for the command line, comparisons, studies, reports and pages.

`identify`, `compare` and `study` accept any other method as "module:Class". ``tests/test_pages.py`` compares README.md,
docs/choose.md and docs/api.md with the table, ``tests/test_plugins.py`` runs a method from outside the package.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Any

from .._tools.plugins import named
from ..errors import FitError
from .method import Method


@dataclass(frozen=True, kw_only=True)
class Row:
    """Description of a method.

    Attributes
    ----------
    name : str
        Name on the command line and in results.
    title : str
        Name in tables and reports.
    line : str
        Sentence of `didim methods`.
    needs, gives : str
        Cells of the tables of README.md and docs/choose.md.
    location : str
        Class of its settings, as "module:Class".
    """

    name: str
    title: str
    line: str
    needs: str
    gives: str
    location: str


METHODS: dict[str, Row] = {
    row.name: row
    for row in (
        Row(
            name="idim-ls",
            title="IDIM-LS",
            line="least squares along the measured motion: needs positions and torques alone; the one to begin with",
            needs="positions and torques",
            gives="parameters with standard deviations, from one linear problem, in seconds",
            location="didim.methods.idim_ls:IDIMLS",
        ),
        Row(
            name="idim-iv",
            title="IDIM-IV",
            line="instrumental variables: rows of the measured motion, instruments of the simulated one; needs [controller]",
            needs="positions, torques, the reference and the controller",
            gives="IDIM-LS without the bias of noise in the positions, and contrasts that tell a wrong filter from a wrong "
            "controller",
            location="didim.methods.idim_iv:IDIMIV",
        ),
        Row(
            name="didim",
            title="DIDIM",
            line="least squares along the simulated motion, iterated: needs torques, [controller] and [reference], and no filter",
            needs="torques, the reference and the controller",
            gives="physically consistent parameters with standard deviations, from a few simulations, without bias by noisy or "
            "filtered positions",
            location="didim.methods.didim.didim:DIDIM",
        ),
        Row(
            name="cloe",
            title="CLOE",
            line="output error of the simulated closed loop, by search: needs [controller], [reference] and a start",
            needs="positions, the reference and the controller",
            gives="the smallest error of the simulated positions, with standard deviations, from hundreds of simulations",
            location="didim.methods.cloe.cloe:CLOE",
        ),
    )
}
"""Methods by name, in the order of the pages."""
VARIANTS = {
    "nelder-mead": "Nelder-Mead",
    "nelder-mead-literal": "literal",
    "nelder-mead-scaled": "scaled",
    "nelder-mead-adaptive": "adaptive",
    "levenberg-marquardt": "Levenberg-Marquardt",
}
"""Titles of the suffixes of method names in a comparison, where the title differs from the suffix."""


def method_class(name: str) -> Any:
    """Return the settings class of a method.

    Parameters
    ----------
    name : str
        A name of `METHODS`, or "module:Class" for a user-defined method.

    Raises
    ------
    FitError
        For an unknown name, with a list of the known ones, or an object that is not a method (``test_plugins.py``).
    """
    made = named(name, {row.name: row.location for row in METHODS.values()}, "method", FitError)
    if not (inspect.isclass(made) and callable(getattr(made, "run", None))):
        raise FitError(f"method '{name}' must be a class of settings with `name` and `run`, got {made!r}")
    return made


def method_of(method: object) -> Method:
    """Return a method, given by name, by class (with default settings) or as an object.

    Raises
    ------
    FitError
        For any other argument.
    """
    if isinstance(method, str):
        method = method_class(method)
    if inspect.isclass(method) and callable(getattr(method, "run", None)):
        method = method()
    if not (callable(getattr(method, "run", None)) and isinstance(getattr(method, "name", None), str)):
        raise FitError(
            f"a method is settings such as didim.DIDIM(), their class or a name such as 'didim', got {method!r}"
        )
    made: Method = method  # type: ignore[assignment]
    return made


def title_of(key: str) -> str:
    """Return the title of a method by its name, or by its key in a comparison, such as "didim-plain"."""
    for name in sorted(METHODS, key=len, reverse=True):
        variant = key.removeprefix(name).removeprefix("-")
        if key in (name, f"{name}-{variant}"):
            return (
                f"{METHODS[name].title}, {VARIANTS.get(variant, variant)}" if variant else METHODS[name].title
            )
    return key
