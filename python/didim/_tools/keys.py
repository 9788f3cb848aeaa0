"""Keys of TOML files, each declared once as a row of ``packaged/schema/*.toml``.

Readers take types, bounds, choices and defaults from the rows; so do the pages of keys and the JSON schemas of `didim.cli.schema`.
Tested in ``tests/test_reference_pages.py``.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

SCHEMA = Path(__file__).parents[1] / "packaged" / "schema"
"""Folder of the declarations."""

NAME = "NAME"
"""Last part of the path of tables whose names are free, such as ``payload.NAME``."""

UNITS = {
    "rad_s3": "rad/s^3", "m_s3": "m/s^3", "rad_s2": "rad/s^2", "deg_s2": "deg/s^2", "mm_s2": "mm/s^2", "m_s2": "m/s^2",
    "rad_s": "rad/s", "deg_s": "deg/s", "mm_s": "mm/s", "m_s": "m/s", "kg_m2": "kg.m^2", "n_m": "N.m",
    "hz": "Hz", "rad": "rad", "deg": "deg", "mm": "mm", "kg": "kg", "m": "m", "s": "s", "n": "N", "v": "V", "a": "A",
}  # fmt: skip
"""Units by the ending of a key, longest endings first."""


@dataclass(frozen=True, kw_only=True)
class Key:
    """Declaration of a key.

    Attributes
    ----------
    name : str
        Key; its unit is the end of its name.
    type : str
        Type of the value in words, such as "number, or list of numbers".
    meaning : str
        One sentence.
    required : bool or str
        Whether every table has it, or the condition under which it is required.
    default
        Value without the key; None if there is none, or if it depends on other keys.
    choices : list of str
        Allowed texts.
    minimum, maximum, above : int, float or None
        Bounds of a number.
    example
        A value for the page; by default `default` or the first of the choices.
    """

    name: str
    type: str
    meaning: str
    required: bool | str = False
    default: Any = None
    choices: list[str] = field(default_factory=list)
    minimum: Any = None
    maximum: Any = None
    above: Any = None
    example: Any = None

    @property
    def unit(self) -> str:
        """Unit, from the end of the name; empty without one."""
        return next((unit for end, unit in UNITS.items() if self.name.endswith(f"_{end}")), "")


@dataclass(frozen=True)
class Keys:
    """Declared keys of a file, seen from one of its tables.

    Attributes
    ----------
    tables : mapping
        Rows by path of the table and key; the path of the file itself is ``file``.
    path : str
        The table.
    """

    tables: Mapping[str, Mapping[str, Key]] = field(default_factory=dict)
    path: str = "file"

    @property
    def rows(self) -> Mapping[str, Key]:
        """Rows of the table; none for a table of free keys."""
        return self.tables.get(self.path, {})

    def inside(self, name: str) -> Keys:
        """Return the keys of a sub-table."""
        path, free = path_inside(self.path, name), path_inside(self.path, NAME)
        return Keys(self.tables, free if path not in self.tables and free in self.tables else path)


NO_KEYS = Keys()
"""Keys of a file without declarations."""


def path_inside(path: str, name: str) -> str:
    """Return the path of a sub-table."""
    return name if path == "file" else f"{path}.{name}"


@cache
def declared(file: str, path: str = "file") -> Keys:
    """Return the keys of one kind of file, "robot" for example, seen from one of its tables."""
    content = tomllib.loads((SCHEMA / f"{file}.toml").read_text(encoding="utf-8"))
    return Keys({table: _rows(content, table) for table in content if not table.startswith("_")}, path)


def _rows(content: Mapping[str, Any], path: str) -> dict[str, Key]:
    """Return the rows of a table, after those of the tables that it is ``like``."""
    rows: dict[str, Key] = {}
    for name, row in content[path].items():
        if isinstance(row, list):
            for other in row:
                file, _, line = other.rpartition(":")
                rows |= declared(file, line).rows if file else _rows(content, line)
        else:
            # As a shell does: ``a_{m,mm}`` stands for ``a_m`` and ``a_mm``.
            head, *rest = re.split(r"[{}]", name)
            first, *others = [f"{head}{unit}{rest[1]}" for unit in rest[0].split(",")] if rest else [name]
            rows[first] = Key(name=first, **row)
            rows |= {other: replace(rows[first], name=other, example=None) for other in others}
    return rows
