"""The printed tables of CLOE with known links: values with intervals by limb and joint, errors in mrad.

Tested in ``tests/test_positions.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..._tools.words import columned, counted
from .record import PositionRecord

LIMB_COLUMNS = 6
"""Largest number of limbs printed side by side."""
ROUNDING = 1e-12
"""Half of an interval (SI) below which it is rounding: that of a value which stays at its bound whatever is left out."""


def position_lines(record: PositionRecord, name: str, robot: str) -> list[str]:
    """Return the tables as text: parameters by limb and joint, mirrored limbs side by side, then errors."""
    lines = [f"{name}: {counted(len(record.rows), 'parameter')} of robot {robot} from positions, links known"]
    shared = shared_rows(record)
    for rows in [*limb_tables(record), *([shared] if shared else []), error_table(record)]:
        lines += ["", *columned(rows)]
    lines.append("")
    lines.append(
        f"95 % intervals by leaving out {record.blocks} {record.kind}; * at a bound, (..) fixed, as this log does not identify it"
        if record.blocks
        else "too few rollouts and too short a log for intervals"
    )
    return lines


def _groups(record: PositionRecord) -> list[list[Mapping[str, Any]]]:
    """Return the limbs, grouped by equal joints."""
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for limb in record.limbs:
        groups.setdefault(tuple(limb["roles"]), []).append(limb)
    cut = []
    for group in groups.values():
        cut += [group[k : k + LIMB_COLUMNS] for k in range(0, len(group), LIMB_COLUMNS)]
    return cut


def limb_tables(record: PositionRecord) -> list[list[tuple[str, ...]]]:
    """Return heading and rows of the parameters of joints, limbs with the same joints side by side."""
    return [_side_by_side(record, group) for group in _groups(record)]


def shared_rows(record: PositionRecord) -> list[tuple[str, ...]]:
    """Return heading and rows of shared unknowns; empty without any."""
    shared = [row for row in record.rows if len(row["joints"]) != 1 or row["recording"] is not None]
    rows = [(row["name"], _cell(row), _number(row["before"]), row["unit"]) for row in shared]
    return [("in common", "value", "before", ""), *rows] if rows else []


def _side_by_side(record: PositionRecord, group: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [("", *(limb["name"] for limb in group), "before", "")]
    single = {
        (row["joints"][0], row["kind"]): row
        for row in record.rows
        if len(row["joints"]) == 1 and row["recording"] is None
    }
    kinds = list(dict.fromkeys(kind for _, kind in single))
    for index, role in enumerate(group[0]["roles"]):
        for kind in kinds:
            of_limbs = [single.get((limb["joints"][index], kind)) for limb in group]
            if not any(of_limbs):
                continue
            one = next(row for row in of_limbs if row is not None)
            before = list(dict.fromkeys(_number(row["before"]) for row in of_limbs if row is not None))
            cells = [_cell(row) if row is not None else "-" for row in of_limbs]
            rows.append((f"{role} {kind}", *cells, " ".join(before), one["unit"]))
    return rows


def error_table(record: PositionRecord) -> list[tuple[str, ...]]:
    """Return heading and rows of the rms errors: before, after, and on held-out recordings."""
    after, before, held_out = (record.errors.get(key) for key in ("after", "before", "held_out"))
    head = ("rms error (mrad, mm)", *(f"{limb['name']}" for limb in record.limbs))
    rows: list[tuple[str, ...]] = [head]
    for title, values in (("before", before), ("after", after), ("held out", held_out)):
        if values is not None:
            rows.append(
                (
                    title,
                    *(
                        "  ".join(milli(values[joint - 1]) for joint in limb["joints"])
                        for limb in record.limbs
                    ),
                )
            )
    return rows


def milli(value: float | None) -> str:
    """Return a value in thousandths; a dash for an unknown one."""
    return "-" if value is None or not math.isfinite(value) else f"{1e3 * value:.2f}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _cell(row: Mapping[str, Any]) -> str:
    if row["by"] == "held":
        return f"({_number(row['value'])})"
    half = None if row["high"] is None or row["low"] is None else 0.5 * (row["high"] - row["low"])
    mark = "*" if row["by"] == "bound" else ""
    return f"{_number(row['value'])}{mark}" + ("" if half is None or half < ROUNDING else f" +-{half:.2g}")
