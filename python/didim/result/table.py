"""Printed tables of names, values and sigmas: aligned on the decimal point, uncertain parameters marked.

It only depends on numbers, not on results. Tested in ``tests/test_identification.py``.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .._tools.arrays import Array, relative_percent
from .._tools.saved import rows
from .._tools.words import counted, percent_text, series
from ..robot.placement import limbs

WELL_IDENTIFIED_PERCENT = 20.0
"""Largest relative standard deviation (%) of a parameter that the paper calls well identified."""

LARGEST_PERCENT = 999
"""Largest relative standard deviation (%) that is printed: beyond it nothing is known."""

PARAMETER_HEAD = ("parameter", "unit", "estimate", "sigma", "sigma %", "95 % low", "95 % high", "/ white", "")
"""Heading of the table of parameters; the last column is for remarks."""

MOST_PLACES = 9
"""Largest number of decimals of a number in fixed point."""
LARGEST_FIXED_POINT = 1e9
"""Size up to which numbers are printed in fixed point."""


class Estimates(NamedTuple):
    """Columns of a table of parameters.

    Attributes
    ----------
    names, units, roles : sequence of str
        One per parameter; only those with the role "estimated" have a sigma.
    values, stds : (b,) arrays
        Estimates and their standard deviations; unknown if all standard deviations are zero.
    whites : (b,) array
        Standard deviations (10); NaN if unknown.
    factor : float
        Half the width of the interval in standard deviations.
    """

    names: Sequence[str]
    units: Sequence[str]
    roles: Sequence[str]
    values: Array
    stds: Array
    whites: Array
    factor: float

    @property
    def interval(self) -> tuple[Array, Array]:
        """Both ends of the intervals, (b,); NaN without standard deviations, and the value itself where nothing is estimated."""
        half = self.factor * self.stds
        if not self.stds.any():
            half = np.where([role == "estimated" for role in self.roles], np.nan, 0.0)
        return self.values - half, self.values + half

    def value_rows(self) -> list[dict[str, Any]]:
        """Return a row of numbers for each parameter, as the JSON of a result has them."""
        low, high = self.interval
        return rows(
            name=self.names,
            unit=self.units,
            value=self.values,
            std=self.stds,
            relative_std_percent=relative_percent(self.stds, self.values),
            low=low,
            high=high,
            std_white=self.whites,
            role=self.roles,
        )


SOURCES = {"estimated": "log", "fixed": "file", "dropped": "none"}
"""Sources of the values of the roles."""


@dataclass(frozen=True)
class Row:
    """An unknown of a result.

    Attributes
    ----------
    name, unit : str
        ``ZZ1R``, of a log ``disc.MX``; SI units, joint side.
    value, std, low, high : float
        Estimate, standard deviation, and ends of the 95 % interval; NaN where they are not known.
    role : {"estimated", "fixed", "dropped"}
        Role in the fit.
    source : {"log", "file", "none"}
        Where the value comes from: the log, the settings, or nowhere, for it is taken as zero.
    group : {"robot", "payload", "offset", "friction", "gain"}
        What it belongs to.
    """

    name: str
    unit: str
    value: float
    std: float
    low: float
    high: float
    role: str
    source: str
    group: str

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Row:
        """Return the row of a result's `value_rows`; ``test_identification.py`` compares its numbers."""
        value, std, low, high = (
            float("nan") if row[key] is None else float(row[key]) for key in ("value", "std", "low", "high")
        )
        role = row["role"]
        return cls(row["name"], row["unit"], value, std, low, high, role, SOURCES[role], row["group"])


def parameter_rows(
    estimates: Estimates, remarks: Mapping[str, str], unstated: Collection[str] = ()
) -> list[tuple[str, ...]]:
    """Return the heading and the cells of the table of parameters.

    The cells are name, unit, estimate, sigma, sigma %, both ends of the 95 % interval, the ratio of sigma to that of (10), and a
    remark: ``*`` for a parameter that is not well identified.

    Parameters
    ----------
    estimates : Estimates
        Names and numbers.
    remarks : mapping of str to str
        Further remarks by name.
    unstated : collection of str
        Names of parameters without an interval, for which friction at speeds stands.
    """
    *columns, factor = estimates
    cells: list[tuple[str, ...]] = [PARAMETER_HEAD]
    known = bool(estimates.stds.any())
    percents = relative_percent(estimates.stds, estimates.values)
    for name, unit, role, value, std, white, percent in zip(*columns, percents, strict=True):
        if role != "estimated":
            cells.append((name, unit, f"{value:g}" if role == "fixed" else "0", "", "", "", "", "", role))
            continue
        places = _decimal_places(std)
        uncertain = known and not percent <= WELL_IDENTIFIED_PERCENT
        half = factor * std
        # A search without covariance has no sigma.
        sigmas = (
            (
                _number(std, places),
                _sigma_percent(percent),
                _number(value - half, places),
                _number(value + half, places),
                f"{std / white:.2f}" if white > 0.0 and math.isfinite(std) else "-",
            )
            if known and name not in unstated
            else ("-",) * 5
        )
        speeds = "see friction at speeds" if name in unstated else ""
        remark = " ".join(filter(None, ("*" if uncertain else "", remarks.get(name, ""), speeds)))
        cells.append((name, unit, _number(value, places), *sigmas, remark))
    return cells


def limb_headings(robot: Mapping[str, Any]) -> list[tuple[frozenset[int], str]]:
    """Return numbers of the joints of each limb of a tree, and the line that opens its parameters; nothing for a chain.

    Parameters
    ----------
    robot : mapping
        The record of a robot in a result: ``geometry`` and ``joint_names``.
    """
    mounts = robot.get("geometry", {}).get("mounts", ())
    groups, names = limbs([mount["parent"] for mount in mounts]), robot.get("joint_names", ())
    if len(groups) < 2:
        return []
    label = dict(enumerate(names))
    ends = [[label.get(joint, f"joint {joint + 1}") for joint in (limb[0], limb[-1])] for limb in groups]
    titles = [f"{first}:" if first == last else f"{first} to {last}:" for first, last in ends]
    return [
        (frozenset(joint + 1 for joint in limb), title) for limb, title in zip(groups, titles, strict=True)
    ]


def parameter_lines(
    rows: Sequence[tuple[str, ...]], headings: Sequence[tuple[frozenset[int], str]] = ()
) -> list[str]:
    """Return the lines of a table of `parameter_rows`, with a footnote if parameters are not well identified.

    Parameters
    ----------
    rows : sequence of tuple of str
        As `parameter_rows` returns them.
    headings : sequence of (set of int, str)
        Numbers of the joints of each limb of a tree, and the line that opens its parameters.
    """
    marked = sum(row[-1].startswith("*") for row in rows)
    shown = table_lines([row[:-1] for row in rows], 2)
    width = max(map(len, shown))
    lines = [f"{line:{width}}  {row[-1]}".rstrip() for line, row in zip(shown, rows, strict=True)]
    rule = "-" * max(map(len, lines))
    limb_of = {number: heading for numbers, heading in headings for number in numbers}
    titles = [limb_of.get(int("".join(filter(str.isdigit, row[0])) or 0), "") for row in rows]
    opened = [
        [title, line] if title and title != before else [line]
        for line, title, before in zip(lines, titles, ["", *titles], strict=False)
    ]
    lines = [lines[0], rule, *(line for group in opened[1:] for line in group)]
    if marked:
        lines += [
            f"* not well identified, sigma above {WELL_IDENTIFIED_PERCENT:.0f} %: "
            f"{marked} of {counted(len(rows) - 1, 'parameter')}"
        ]
    return lines


def error_rows(sets: Sequence[tuple[str, Sequence[float], float]]) -> list[tuple[str, ...]]:
    """Return the heading, and relative errors in % per joint and of all.

    Parameters
    ----------
    sets : sequence of (str, sequence of float, float)
        Name, relative error of each joint and of all joints; 0.07 = 7 %.
    """
    n_dof = len(sets[0][1])
    labels = [f"joint {joint + 1}" for joint in range(n_dof)]
    rows = [("relative error %", *labels, *(["all"] if n_dof > 1 else []))]
    for name, errors, overall in sets:
        shown = [percent_text(100.0 * error) for error in errors]
        rows.append((name, *shown, *([percent_text(100.0 * overall)] if n_dof > 1 else [])))
    return rows


def table_lines(rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """Return the lines of a table: the first `left` columns flush left, the others aligned on the decimal point."""
    columns = list(zip(*rows, strict=True))
    cells = [*map(_left, columns[:left]), *map(aligned, columns[left:])]
    return ["  ".join(row).rstrip() for row in zip(*cells, strict=True)]


def _decimal_places(std: float) -> int:
    """Return the number of decimals for three digits of sigma, at least four."""
    if not math.isfinite(std) or std <= 0.0:
        return 6
    return max(4, 2 - math.floor(math.log10(std)))


def _number(value: float, places: int) -> str:
    """Write a number in fixed point, or with a power of ten if it would have many zeros."""
    fixed_point = places <= MOST_PLACES and abs(value) < LARGEST_FIXED_POINT
    return f"{value:.{places}f}" if fixed_point else f"{value:.4g}"


def _sigma_percent(percent: float) -> str:
    """Write a relative sigma with three digits, and four decimals below 10 %, as in the publication of the EMPS."""
    if math.isnan(percent):
        return "-"
    if percent > LARGEST_PERCENT:
        return f">{LARGEST_PERCENT}"
    if percent < 10.0:
        return _number(percent, _decimal_places(percent) if percent > 0.0 else 4)
    return f"{percent:.{1 if percent < 99.95 else 0}f}"


def _left(cells: Sequence[str]) -> list[str]:
    width = max(map(len, cells))
    return [cell.ljust(width) for cell in cells]


def aligned(cells: Sequence[str]) -> list[str]:
    """Return cells aligned on their decimal points; the heading and empty cells are right-aligned."""
    split = [cell.partition(".") for cell in cells[1:]]
    before = max(len(whole) for whole, _, _ in split)
    after = max(len(point + part) for _, point, part in split)
    aligned = [whole.rjust(before) + (point + part).ljust(after) for whole, point, part in split]
    width = max(before + after, len(cells[0]))
    return [cell.rjust(width) for cell in (cells[0], *aligned)]


def delay_lines(delay: Mapping[str, Any], *, measured: bool) -> list[str]:
    """Return the lines on the delay; `measured` for a fit along measured motion, for which a hold is compensated."""
    lines = []
    compensated = delay.get("compensated_samples", 0.0)
    shown = (
        series((f"{value:g}" for value in compensated), 60)
        if isinstance(compensated, list)
        else f"{compensated:g}"
    )
    if "estimated_samples" in delay:
        value, std = delay["estimated_samples"], delay.get("estimated_std_samples")
        error = "" if std is None else f" +- {std:.2g}"
        if isinstance(compensated, list):
            lines.append(f"torque recorded {shown} samples after the motion, joint by joint, by estimate")
        elif value == 0.0:
            lines.append(f"no delay of the torque is significant: 0{error} samples, by estimate")
        else:
            milliseconds = 1e3 * delay["estimated_seconds"]
            lines.append(
                f"torque recorded {value:+.2f}{error} samples ({milliseconds:+.3f} ms) after the motion, by estimate"
            )
    if compensated:
        lines.append(f"torque moved back by {shown} samples")
    if measured and delay.get("hold_s"):
        lines.append(
            f"hold of the digital controller, {1e3 * delay['hold_s']:g} ms: the torque is compared half of it later"
        )
    return lines
