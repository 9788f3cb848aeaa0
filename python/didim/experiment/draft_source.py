"""A log of any container, as ``didim init`` sees it: columns, their values, and the lines of TOML that name them.

Tested in ``tests/test_init.py`` and ``tests/test_init_logs.py``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import quoted
from .._tools.words import listing
from ..errors import ExperimentError, RecordingError
from ..log.array_file import ArrayFile
from ..log.csv_file import CsvFile
from ..log.data_file import TEXT, open_data_file
from ..log.data_folder import MANY_COLUMNS
from ..log.data_format import DataFile
from ..log.ros_bag import RosBag
from ..log.text_files import OneValueALine
from ..robot.robot import Robot
from .draft_columns import WORDS, Column, column
from .draft_layout import layout

LEAST_ROWS = 16
"""Samples of an array that can be a signal: settings stand beside the signals in files of MATLAB."""

BAG_KINDS = {"position": "position", "velocity": "velocity", "effort": "torque", "reference": "reference"}
"""Kinds of the signals of a bag."""


@dataclass
class LogSource:
    """An opened log.

    Attributes
    ----------
    data : DataFile
        The file.
    columns : list of Column
        What there is in it.
    keys : list of str
        Lines of TOML that every table of it has: file, delimiter, topic.
    named : bool
        Whether the columns have names.
    """

    data: DataFile
    columns: list[Column]
    keys: list[str]
    named: bool = True

    def want(self, columns: Sequence[Column]) -> None:
        """Announce columns: a text is then parsed once, and of a bag the messages of other joints are left out."""
        if isinstance(self.data, RosBag):
            if columns:
                self.data.want([item.name for item in columns], columns[0].variable, len(columns))
        elif columns and all(item.variable is None for item in columns):
            self.data.want([item.name for item in columns], None, len(columns))

    def values(self, columns: Sequence[Column]) -> Array:
        """Values of some columns, (n_samples, n)."""
        if isinstance(self.data, RosBag):
            names = [item.name for item in columns]
            self.data.want(names, columns[0].variable, len(names))
            return self.data.get(names, columns[0].variable, len(names))
        if all(item.variable is None for item in columns):
            return self.data.get([item.name for item in columns], None, len(columns))
        return np.hstack([self._of_array(item) for item in columns])

    def _of_array(self, item: Column) -> Array:
        if isinstance(item.name, str):
            return self.data.get([item.name], None, 1)
        return self.data.get([item.name], item.variable, 1)

    def lines(self, columns: Sequence[Column], robot: Robot) -> list[str]:
        """Lines of TOML that name some columns."""
        names = [item.name for item in columns]
        if isinstance(self.data, RosBag):
            if not names or names == list(robot.joint_names):
                return list(self.keys)
            return [*self.keys, f"columns = {quoted(names)}"]
        variables = {item.variable for item in columns if isinstance(item.name, int)} - {None}
        lines = list(self.keys)
        if variables:
            variable = variables.pop()
            lines.append(f"variable = {quoted(variable)}")
            width = sum(item.variable == variable for item in self.columns)
            if names == list(range(1, width + 1)):
                return lines
        return [*lines, f"columns = {quoted(names)}"]


def open_log(
    log: Path,
    beside: Path,
    robot: Robot,
    chosen: Mapping[str, str],
    *,
    values_per_sample: int | None = None,
    topic: str | None = None,
) -> LogSource:
    """Open a log and sort its columns.

    Parameters
    ----------
    log : Path
        Any container that an experiment reads.
    beside : Path
        Folder of the experiment file.
    robot : Robot
        Its joints and their names.
    chosen : mapping of str to str
        Columns by kind of signal, as the user says: ``{"torque": "14-19"}``.
    values_per_sample : int, optional
        Of a text with one value a line.
    topic : str, optional
        Of a bag.

    Raises
    ------
    RecordingError
        When the log cannot be read.
    ExperimentError
        When a chosen column does not exist.
    """
    file = Path(os.path.relpath(log, beside)).as_posix()
    keys = [f"file = {quoted(file)}"]
    if log.suffix.lower() in TEXT:
        source = _text(log, keys, robot, values_per_sample)
    else:
        if values_per_sample is not None:
            raise ExperimentError(f"{log.name}: --values-per-sample is for text files")
        data = open_data_file(log, log.name, delimiter=None, header=None, topic=topic)
        source = _bag(data, keys, robot) if isinstance(data, RosBag) else _arrays(data, keys, robot)
    for kind, text in chosen.items():
        _choose(source, kind, text, log.name)
    return source


def _text(log: Path, keys: list[str], robot: Robot, values_per_sample: int | None) -> LogSource:
    line = _first_line(log)
    delimiter = next((sign for sign in (",", ";", "\t") if sign in line), " " if " " in line.strip() else ",")
    data: DataFile = open_data_file(log, log.name, delimiter=delimiter, header=None)
    assert isinstance(data, CsvFile)
    if delimiter != ",":
        keys.append(f"delimiter = {quoted(delimiter)}")
    if data.names is not None:
        return LogSource(data, [column(name, robot.joint_names) for name in data.names], keys)
    width = len(line.split() if delimiter == " " else line.split(delimiter))
    if values_per_sample is not None:
        if not 1 <= values_per_sample <= MANY_COLUMNS:
            raise ExperimentError(
                f"--values-per-sample must be a whole number from 1 to {MANY_COLUMNS}, got {values_per_sample}"
            )
        data, width = OneValueALine(data, values_per_sample), values_per_sample
        keys.append(f"values_per_sample = {values_per_sample}")
    elif width == 1:
        raise ExperimentError(
            f"{log.name}: the file has one value a line; --values-per-sample N says how many make a sample"
        )
    values = data.get(list(range(1, width + 1)), None, width)
    return LogSource(data, layout(values, robot.n_dof), keys, named=False)


def _first_line(log: Path) -> str:
    try:
        with log.open(encoding="utf-8-sig", errors="replace") as file:
            return file.readline().rstrip("\r\n")
    except FileNotFoundError:
        raise RecordingError(f"{log}: no such data file") from None
    except OSError as reason:
        raise RecordingError(f"{log}: cannot be read ({reason.strerror})") from None


def _arrays(data: DataFile, keys: list[str], robot: Robot) -> LogSource:
    """Columns of a file of arrays: vectors by their names, columns of a matrix by its name and their number."""
    assert isinstance(data, ArrayFile)
    columns: list[Column] = []
    for name in data.names:
        try:
            shape = np.shape(data.array(name))
        except Exception:  # text and structures of MATLAB
            continue
        if not shape or max(shape) < LEAST_ROWS or len(shape) > 2:
            continue
        kind = column(name.rsplit("/", 1)[-1], robot.joint_names)
        if len(shape) == 1 or 1 in shape:
            columns.append(Column(name, kind.what, kind.number, kind.unit, kind.motor, name, kind.stem))
            continue
        columns += [
            Column(k + 1, kind.what, k + 1, kind.unit, kind.motor, name, name)
            for k in range(min(shape[1], MANY_COLUMNS))
        ]
    return LogSource(data, columns, keys)


def _bag(data: RosBag, keys: list[str], robot: Robot) -> LogSource:
    """Columns of a bag: the joints of the robot by name."""
    if data.ambiguous:
        keys = [*keys, f"topic = {quoted(data.topic)}"]
    columns = [Column("stamp", "time", None, "s", variable="stamp", stem="stamp")]
    for signal, kind in BAG_KINDS.items():
        if data.has(signal):
            unit = {"position": "rad", "reference": "rad"}.get(signal)
            columns += [
                Column(
                    joint,
                    kind,
                    robot.joint_names.index(joint) + 1 if joint in robot.joint_names else None,
                    unit,
                    variable=signal,
                    stem=signal,
                )
                for joint in data.joints
                if not robot.joint_names or joint in robot.joint_names
            ]
    return LogSource(data, columns, keys)


def _choose(source: LogSource, kind: str, text: str, log: str) -> None:
    """Make the columns that the user names those of a kind, and no others."""
    if kind not in WORDS:
        raise ExperimentError(f"--columns: {kind!r} is not a kind of signal; known are {listing(WORDS)}")
    names = {str(item.name): k for k, item in enumerate(source.columns)}
    places = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if part.strip() in names:
            places.append(names[part.strip()])
        elif dash and first.isdigit() and last.isdigit() and first in names and last in names:
            places += list(range(names[first], names[last] + 1))
        else:
            raise ExperimentError(f"{log}: --columns {kind}={text}: there is no column {part.strip()!r}")
    # Velocities of a file that names them keep their kind; what was taken for this one is none now.
    for k, item in enumerate(source.columns):
        if item.what == kind:
            source.columns[k] = Column(
                item.name, "other", item.number, item.unit, item.motor, item.variable, item.stem
            )
    for number, k in enumerate(places):
        item = source.columns[k]
        source.columns[k] = Column(
            item.name, kind, number + 1, item.unit, item.motor, item.variable, f"--columns {kind}"
        )
