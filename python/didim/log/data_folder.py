"""Data files named by the tables of an experiment, each opened once.

A ``[[recording]]`` with a ``*`` in its file names is one recording per match. Tested in ``tests/test_recording.py`` and
``tests/test_containers.py``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from .._tools.arrays import Array
from .._tools.toml import Table
from .._tools.words import counted, did_you_mean
from .data_file import open_data_file
from .data_format import Column, DataFile
from .text_files import OneColumnAFile, OneValueALine

SOURCES = ("time", "position", "velocity", "torque", "external", "temperature", "reference")
"""Tables of a recording that name data files."""


@dataclass(frozen=True)
class Source:
    """The part of a data file that one table of the experiment declares."""

    table: Table
    file: DataFile
    columns: list[Column] | None
    variable: str | None
    count: int

    def values(self) -> Array:
        """Columns as (n_samples, count), in the unit of the file."""
        return self.file.get(self.columns, self.variable, self.count)


class DataFolder:
    """Opens each data file once, however many tables read from it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._files: dict[tuple[Any, ...], DataFile] = {}

    def source(self, kind: str, table: Table, count: int, joints: Sequence[str] = ()) -> Source:
        """Columns that a table declares with `file`, `columns`, `variable` and the keys of its format.

        Parameters
        ----------
        kind
            Name of the table, one of `SOURCES`: it selects the signal of files with named signals.
        table
            The table.
        count
            Number of columns.
        joints
            Names of the robot's joints, by which `columns` may be given.
        """
        names = _names(table)
        options: dict[str, Any] = {
            "delimiter": table.text("delimiter", None),
            "header": table.boolean("header", None),
            "topic": table.text("topic", None),
            "decimal": table.text("decimal", None),
        }
        width = table.integer("values_per_sample", None)
        variable = table.text("variable", None)
        columns = _columns(table, count, joints)
        key = (*names, *options.values(), width)
        if key not in self._files:
            files = [open_data_file(self.folder / name, name, **options) for name in names]
            file: DataFile = OneColumnAFile(files) if isinstance(table.raw("file"), list) else files[0]
            self._files[key] = file if width is None else OneValueALine(file, width)
        file = self._files[key]
        signals = getattr(file, "signals", None)
        if signals is not None:
            # Columns of named joints are found by name, in any order.
            variable = signals.get(kind) if variable is None else variable
            if columns is None and kind != "time":
                if not joints:
                    table.fail(
                        f"{names[0]} has joints by name, and the robot file has no names: give each [[joint]] a name, "
                        "or list the names of the log as columns"
                    )
                columns = list(joints)
        file.want(columns, variable, count)
        return Source(table, file, columns, variable, count)


def expanded(recording: Table, name: str, folder: Path) -> list[tuple[Table, str]]:
    """Return the recordings of a ``[[recording]]`` table with their names: several if its file names have a ``*``.

    Parameters
    ----------
    recording
        The table.
    name
        Name of the recording if the table does not name it.
    folder
        Folder of the data files.
    """
    content = recording.content_unread
    patterns = [
        part["file"]
        for key in SOURCES
        if isinstance(part := content.get(key), dict)
        and isinstance(part.get("file"), str)
        and "*" in part["file"]
    ]
    if not patterns:
        return [(recording, name)]
    pattern = patterns[0]
    for other in patterns:
        if other.count("*") != 1:
            recording.fail(f"file = {other!r} may have one *, for the part of the name that differs")
    before, after = pattern.split("*")
    fitting = re.compile(
        re.escape(Path(before + "x").name[:-1]) + "(.*)" + re.escape(Path("x" + after).name[1:])
    )
    files = sorted(folder.glob(pattern))
    parts = [match.group(1) for path in files if (match := fitting.fullmatch(path.name))]
    if not parts:
        recording.fail(f"no file in {folder} is called {pattern}")
    return [(recording.changed(_with_part(content, part)), part or name) for part in parts]


def _with_part(content: Mapping[str, Any], part: str) -> dict[str, Any]:
    """Return a recording with the ``*`` of its file names replaced, and the part added to its own name."""
    changed = dict(content)
    for key, value in content.items():
        if isinstance(value, dict) and isinstance(value.get("file"), str):
            changed[key] = {**value, "file": value["file"].replace("*", part)}
        elif key == "name" and isinstance(value, str):
            changed[key] = f"{value} {part}"
    return changed


def _names(table: Table) -> list[str]:
    """File names of a table: one, or a list with one file for each column."""
    if not isinstance(table.raw("file"), list):
        return [table.text("file")]
    names = table.texts("file")
    if not names:
        table.fail("file must name at least one file")
    return names


def _columns(table: Table, count: int, joints: Sequence[str]) -> list[Column] | None:
    columns = table.raw("columns", None)
    if columns is None:
        return None
    if isinstance(columns, dict):
        if not joints:
            table.fail("columns by name of joint need a robot whose joints have names")
        for name in columns:
            if name not in joints:
                table.fail(
                    f"columns names joint {name!r}, which the robot has not{did_you_mean(name, joints)}"
                )
        missing = [name for name in joints if name not in columns]
        if missing:
            table.fail(f"columns has none for joint {missing[0]!r}")
        columns = [columns[name] for name in joints]
    if not isinstance(columns, list) or not all(type(column) in (str, int) for column in columns):
        table.fail(f"columns must be a list of names, or of numbers from 1, got {columns!r}")
    if len(columns) != count:
        joint = ", one for each joint of the robot" if count > 1 else ""
        table.fail(f"columns must name {counted(count, 'column')}{joint}, got {len(columns)}")
    # One file per column: columns of different files may have the same name.
    if len(set(columns)) < count and not isinstance(table.raw("file"), list):
        table.fail(f"columns names a column twice: {columns!r}")
    return cast("list[Column]", columns)
