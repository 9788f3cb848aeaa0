"""The text of a result: aligned on the decimal point, with what needs attention marked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from .schema import counted

if TYPE_CHECKING:
    from .identification import Identification

# The paper calls a parameter well identified below this relative standard deviation.
WELL_IDENTIFIED_PERCENT = 20.0

# Beyond it a relative sigma says no more than that nothing is known.
LARGEST_PERCENT = 999

# Decimals, and size, up to which numbers are printed in fixed point.
MOST_PLACES = 9
LARGEST_FIXED_POINT = 1e9


def render(fit: Identification) -> str:
    """Table of parameters, errors per joint, condition number, warnings and status.

    Parameters
    ----------
    fit : Identification
        Any result.

    Returns
    -------
    str
        Lines without a final line feed.
    """
    count = counted(len(fit.names), "base parameter")
    lines = [f"{fit.name}: {count} of robot {fit.robot} by {fit.method}", ""]
    lines += _parameter_lines(fit)
    lines += ["", *_error_lines(fit), ""]
    lines.append(
        f"condition number {fit.condition_number:.6g}, error norm {fit.error_norm:.7g}, "
        f"standard deviation of the error {fit.error_std:.5g}, {fit.n_rows} rows"
    )
    lines += _delay_lines(fit)
    if fit.output_error is not None:
        before, after = (_percent(100.0 * error) for error in fit.output_error)
        lines.append(
            f"simulated torques off by {after} % (initial parameters: {before} %), after {counted(fit.n_simulations, 'simulation')}"
        )
    if fit.remarks:
        lines += ["", "To know:", *(f"  {text}" for text in fit.remarks)]
    verdict = fit.status.value
    if fit.warnings:
        lines += ["", "Not physical as it stands:", *(f"  {text}" for text in fit.warnings)]
        # The last line is what is read: it must not sound like plain success.
        verdict += (
            f" But it is not physical as it stands: see the {counted(len(fit.warnings), 'finding')} above."
        )
    lines += ["", verdict]
    return "\n".join(lines)


def parameter_rows(fit: Identification) -> list[tuple[str, ...]]:
    """Heading, and per parameter its name, unit, estimate, sigma, sigma % and a remark: ``*`` where it is not well identified."""
    rows: list[tuple[str, ...]] = [("parameter", "unit", "estimate", "sigma", "sigma %", "")]
    values = zip(fit.names, fit.units, fit.roles, fit.beta, fit.std, fit.relative_std_percent, strict=True)
    for name, unit, role, value, std, percent in values:
        if role != "estimated":
            rows.append((name, unit, f"{value:g}" if role == "fixed" else "0", "", "", role))
            continue
        places = _decimal_places(std)
        known = bool(fit.std.any())
        uncertain = known and not percent <= WELL_IDENTIFIED_PERCENT
        rows.append(
            (
                name,
                unit,
                _number(value, places),
                # A search that gives no covariance says nothing on sigma.
                _number(std, places) if known else "-",
                _sigma_percent(percent) if known else "-",
                "*" if uncertain else "",
            )
        )
    return rows


def _parameter_lines(fit: Identification) -> list[str]:
    rows = parameter_rows(fit)
    marked = sum(row[-1] == "*" for row in rows)
    columns = list(zip(*rows, strict=True))
    cells = [
        _left(columns[0]),
        _left(columns[1]),
        *(aligned(column) for column in columns[2:5]),
        _left(columns[5]),
    ]
    lines = ["  ".join(row).rstrip() for row in zip(*cells, strict=True)]
    lines.insert(1, "-" * max(map(len, lines)))
    if marked:
        lines += [
            f"* not well identified, sigma above {WELL_IDENTIFIED_PERCENT:.0f} %: "
            f"{marked} of {counted(len(fit.names), 'parameter')}"
        ]
    return lines


def error_rows(fit: Identification) -> list[tuple[str, ...]]:
    """Heading, and relative errors in % per joint and of all: of the fit, then of the recordings held out."""
    n_dof = len(fit.relative_error)
    labels = [f"joint {joint + 1}" for joint in range(n_dof)]
    rows = [("relative error %", *labels, *(["all"] if n_dof > 1 else []))]
    sets = [("fit", tuple(fit.relative_error), fit.overall_relative_error)]
    sets += [
        (f"held out: {item.name}", item.relative_error, item.overall_relative_error) for item in fit.held_out
    ]
    for name, errors, overall in sets:
        shown = [_percent(100.0 * error) for error in errors]
        rows.append((name, *shown, *([_percent(100.0 * overall)] if n_dof > 1 else [])))
    return rows


def _error_lines(fit: Identification) -> list[str]:
    rows = error_rows(fit)
    columns = list(zip(*rows, strict=True))
    cells = [_left(columns[0]), *(aligned(column) for column in columns[1:])]
    return ["  ".join(row).rstrip() for row in zip(*cells, strict=True)]


def _delay_lines(fit: Identification) -> list[str]:
    lines = []
    if "estimated_samples" in fit.delay:
        lines.append(
            f"torque recorded {fit.delay['estimated_samples']:+.2f} samples "
            f"({1e3 * fit.delay['estimated_seconds']:+.3f} ms) after the motion, by estimate"
        )
    compensated = fit.delay.get("compensated_samples", 0.0)
    if compensated:
        lines.append(f"torque moved back by {compensated:g} samples")
    return lines


def _decimal_places(std: float) -> int:
    """Decimals that show three digits of sigma, and four decimals at least."""
    if not math.isfinite(std) or std <= 0.0:
        return 6
    return max(4, 2 - math.floor(math.log10(std)))


def _number(value: float, places: int) -> str:
    """Write in fixed point, or with a power of ten what would take a line of zeros."""
    fixed_point = places <= MOST_PLACES and abs(value) < LARGEST_FIXED_POINT
    return f"{value:.{places}f}" if fixed_point else f"{value:.4g}"


def _sigma_percent(percent: float) -> str:
    """Write a relative sigma: three digits, and four decimals below 10 %, as the EMPS is published."""
    if math.isnan(percent):
        return "-"
    if percent > LARGEST_PERCENT:
        return f">{LARGEST_PERCENT}"
    if percent < 10.0:
        return _number(percent, _decimal_places(percent) if percent > 0.0 else 4)
    return f"{percent:.{1 if percent < 99.95 else 0}f}"


def _percent(percent: float) -> str:
    """Percentage with fewer decimals the larger it is."""
    if not math.isfinite(percent):
        return "-"
    size = abs(percent)
    return f"{percent:.{4 if size < 10.0 else 2 if size < 100.0 else 0}f}"


def _left(cells: Sequence[str]) -> list[str]:
    width = max(map(len, cells))
    return [cell.ljust(width) for cell in cells]


def aligned(cells: Sequence[str]) -> list[str]:
    """Cells aligned on their decimal points; the first one, a heading, and empty ones are right-aligned."""
    split = [cell.partition(".") for cell in cells[1:]]
    before = max(len(whole) for whole, _, _ in split)
    after = max(len(point + part) for _, point, part in split)
    aligned = [whole.rjust(before) + (point + part).ljust(after) for whole, point, part in split]
    width = max(before + after, len(cells[0]))
    return [cell.rjust(width) for cell in (cells[0], *aligned)]
