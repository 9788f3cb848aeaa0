"""A log of any container for ``didim init``: columns, their values, and the TOML lines that name them.

Tested in ``tests/test_init.py`` and ``tests/test_init_logs.py``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .._tools.arrays import Array
from .._tools.files import path_from
from .._tools.inputs import first_lines
from .._tools.toml import quoted
from .._tools.words import brief, did_you_mean, listing, series
from ..errors import ExperimentError, RecordingError, RobotError
from ..log.array_file import ArrayFile, samples_in_columns
from ..log.csv_file import CsvFile
from ..log.data_file import TEXT, open_data_file
from ..log.data_format import LONGEST_LINE, MOST_COLUMNS, DataFile
from ..log.ros_bag import RosBag
from ..log.text_files import OneValueALine
from ..robot.robot import Robot
from ..robot.robot_file import load_robot
from .draft_columns import WORDS, Column, joints_by_name, read_column
from .draft_layout import layout

PERCENT = (-1.0, 101.0)
"""Range of a gripper's values in percent, as LeRobot logs them; encoders may overshoot by 1."""

BAG_KINDS = {"position": "position", "velocity": "velocity", "effort": "torque", "reference": "reference"}
"""Kind of each signal of a bag."""
NUMBER = re.compile(
    r"\"?[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?\"?|\"?[+-]?(nan|inf(inity)?)\"?|", re.IGNORECASE
)
"""Pattern of a number with either decimal sign, or of an empty cell."""
SNIFFED_LINES = 50
"""Number of first lines of a text from which delimiter and decimal sign are inferred."""
LEAST_SIGNAL_SAMPLES = 16
"""Smallest number of samples of a signal: MATLAB files also contain settings."""


@dataclass
class LogSource:
    """An opened file of a log.

    Attributes
    ----------
    data : DataFile
        The file.
    columns : list of Column
        Columns of the file.
    keys : list of str
        TOML lines common to its tables: file, delimiter, topic.
    path : Path
        Path of the file.
    named : bool
        Whether the columns have names.
    joints : tuple of str
        Joints of a bag that could not be assigned to joints of the robot; empty if all were.
    note : str
        Sentence on joints of a bag that were matched approximately by name.
    """

    data: DataFile
    columns: list[Column]
    keys: list[str]
    path: Path
    named: bool = True
    joints: tuple[str, ...] = ()
    note: str = ""

    def want(self, columns: Sequence[Column]) -> None:
        """Request columns: a text is then parsed once, and a bag's messages of other joints are skipped."""
        if columns and not isinstance(self.data, ArrayFile):
            self.data.want([column.name for column in columns], columns[0].variable, len(columns))

    def values(self, columns: Sequence[Column]) -> Array:
        """Return the values of some columns, (n_samples, n)."""
        if not isinstance(self.data, ArrayFile):
            self.want(columns)
            return self.data.get([column.name for column in columns], columns[0].variable, len(columns))
        variables = [None if isinstance(column.name, str) else column.variable for column in columns]
        each = zip(columns, variables, strict=True)
        return np.hstack([self.data.get([column.name], variable, 1) for column, variable in each])

    def place(self, column: Column, row: int) -> str:
        """Return the location of a value in words: file, row from 1, column."""
        line = f" (line {row + 1})" if self.named and isinstance(self.data, CsvFile) else ""
        matrix = f" of {column.variable!r}" if column.variable not in (None, column.name) else ""
        return f"{self.path.name}: row {row}{line}, column {column.name!r}{matrix}"

    def lines(self, columns: Sequence[Column], robot: Robot) -> list[str]:
        """Return the TOML lines that name some columns."""
        names = [column.name for column in columns]
        if isinstance(self.data, RosBag):
            if not names or columns[0].variable == "stamp" or names == list(robot.joint_names):
                return list(self.keys)
            return [*self.keys, f"columns = {quoted(names)}"]
        variables = {column.variable for column in columns if isinstance(column.name, int)} - {None}
        lines = list(self.keys)
        if variables:
            variable = variables.pop()
            lines.append(f"variable = {quoted(variable)}")
            width = sum(column.variable == variable for column in self.columns)
            if names == list(range(1, width + 1)):
                return lines
        return [*lines, f"columns = {quoted(names)}"]


def open_log(
    log: Path,
    beside: Path,
    robot: Robot,
    *,
    values_per_sample: int | None = None,
    topic: str | None = None,
    alone: bool = True,
) -> LogSource:
    """Open a file of a log and classify its columns.

    Parameters
    ----------
    log : Path
        File of any supported container.
    beside : Path
        Folder of the experiment file.
    robot : Robot
        Robot with the names of its joints.
    values_per_sample : int, optional
        Number of values per sample in a text with one value per line.
    topic : str, optional
        Topic of a bag.
    alone : bool
        Whether it is the only file: a text with one value per line must then contain whole samples.

    Raises
    ------
    RecordingError
        When the log cannot be read.
    ExperimentError
        When an option does not apply to this container.
    """
    data, form = _opened(log, topic)
    keys = [f"file = {quoted(path_from(beside, log))}", *form]
    if isinstance(data, CsvFile):
        source = _text(data, keys, robot, log, values_per_sample, alone=alone)
    elif values_per_sample is not None:
        raise ExperimentError(f"{log.name}: --values-per-sample is for text files")
    else:
        source = _bag(data, keys, robot, log) if isinstance(data, RosBag) else _arrays(data, keys, robot, log)
    _by_file_name(source)
    return source


def log_names(log: Path, topic: str | None) -> list[str]:
    """Return the names in a file, before its robot is known: columns, arrays, joints of a bag.

    Raises
    ------
    RecordingError
        When the log cannot be read.
    """
    data, _ = _opened(log, topic)
    return list(data.joints if isinstance(data, RosBag) else getattr(data, "names", None) or ())


def _opened(log: Path, topic: str | None) -> tuple[DataFile, list[str]]:
    """Open a file of a log, and return the TOML lines on its form too."""
    if log.suffix.lower() not in TEXT:
        return open_data_file(log, log.name, delimiter=None, header=None, topic=topic), []
    delimiter, decimal = _signs(log)
    form = [] if delimiter == "," else [f"delimiter = {quoted(delimiter)}"]
    form += [] if decimal is None else [f"decimal = {quoted(decimal)}"]
    return open_data_file(log, log.name, delimiter=delimiter, header=None, decimal=decimal), form


def _by_file_name(source: LogSource) -> None:
    """Derive the kind of signal from the file name, if no column name gives it."""
    signals = [column for column in source.columns if column.what != "time"]
    words = source.path.stem.lower().replace("-", "_").split("_")
    if {"control", "commands", *WORDS["reference"]} & {*words} and {column.what for column in signals} <= {
        "position",
        "other",
    }:
        source.columns = [
            replace(column, what="reference") if column.what == "position" else column
            for column in source.columns
        ]
    if not all(column.placed or (column.what == "other" and not source.named) for column in signals):
        return
    by_name = read_column(source.path.stem)
    if by_name.placed or by_name.what in ("other", "acceleration"):
        return
    for k, column in enumerate(source.columns):
        if column.what != "time":
            number = by_name.number if len(source.columns) == 1 else column.number
            source.columns[k] = replace(
                column, what=by_name.what, motor=column.motor or by_name.motor, number=number, placed=False
            )


def _text(
    text: CsvFile, keys: list[str], robot: Robot, log: Path, values_per_sample: int | None, *, alone: bool
) -> LogSource:
    if text.names is not None:
        return LogSource(text, [read_column(name, robot.joint_names) for name in text.names], keys, log)
    data: DataFile = text
    width = text.n_columns
    if width == 1 and not alone and read_column(log.stem).what == "time":
        values_per_sample = None  # one time stamp a sample
    if values_per_sample is not None:
        if not 1 <= values_per_sample <= MOST_COLUMNS:
            raise ExperimentError(
                f"--values-per-sample must be a whole number from 1 to {MOST_COLUMNS}, got {values_per_sample}"
            )
        data, width = OneValueALine(text, values_per_sample), values_per_sample
        keys.append(f"values_per_sample = {values_per_sample}")
    elif width == 1 and alone:
        raise ExperimentError(
            f"{log.name}: the file has one value a line; --values-per-sample N says how many make a sample"
        )
    values = data.get(list(range(1, width + 1)), None, width)
    return LogSource(data, layout(values, robot.n_dof), keys, log, named=False)


def whole_samples(sources: Sequence[LogSource], robot: Robot) -> dict[Path, int]:
    """Return the number of values in each sample of files with one value a line that hold all joints of a signal, by file.

    Such a file is the only one of its signal, and its lines are as many samples of a value per joint as the time stamps have.
    """
    lone = [source for source in sources if not source.named and len(source.columns) == 1]
    kinds = [source.columns[0].what for source in lone]
    rows = {source.path: len(source.values(source.columns)) for source in lone}
    stamps = [rows[source.path] for source, kind in zip(lone, kinds, strict=True) if kind == "time"]
    return {
        source.path: robot.n_dof
        for source, kind in zip(lone, kinds, strict=True)
        if robot.n_dof > 1
        and kind not in ("time", "other")
        and kinds.count(kind) == 1
        and rows[source.path] % robot.n_dof == 0
        and all(rows[source.path] == robot.n_dof * count for count in stamps)
    }


def _signs(log: Path) -> tuple[str, str | None]:
    """Return delimiter and decimal sign of a text, with which the lines after the first are numbers."""
    read = first_lines(log, RecordingError, SNIFFED_LINES, LONGEST_LINE)
    first, *lines = (line.decode("utf-8-sig", errors="replace").rstrip("\r\n") for line in read)
    rows = [line for line in lines if line.strip()]
    for delimiter in (";", "\t", ",", " "):
        cells = [
            cell.strip() for line in rows for cell in line.split(None if delimiter == " " else delimiter)
        ]
        if len(cells) == len(rows) or not cells:
            continue
        if all(NUMBER.fullmatch(cell) for cell in cells):
            commas = delimiter != "," and any("," in cell for cell in cells)
            return delimiter, "," if commas else None
    return next(
        (sign for sign in (",", ";", "\t") if sign in first), " " if " " in first.strip() else ","
    ), None


def _arrays(data: DataFile, keys: list[str], robot: Robot, log: Path) -> LogSource:
    """Return the columns of a file of arrays: vectors by name, columns of a matrix by name and number."""
    assert isinstance(data, ArrayFile)
    columns: list[Column] = []
    for name in data.names:
        shape = data.shape(name)
        if not shape or max(shape) < LEAST_SIGNAL_SAMPLES or len(shape) > 2:
            continue
        kind = read_column(re.split(r"[/.]", name)[-1], robot.joint_names)
        labels = data.labels.get(name)
        if labels is not None and len(shape) == 2 and shape[1] == len(labels):
            columns += _labelled(data, name, labels, kind, robot)
            continue
        if len(shape) == 1 or 1 in shape:
            columns.append(Column(name, kind.what, kind.number, kind.unit, kind.motor, name, kind.stem))
            continue
        width = shape[0] if samples_in_columns(shape) else shape[1]
        columns += [
            Column(k + 1, kind.what, k + 1, kind.unit, kind.motor, name, name)
            for k in range(min(width, MOST_COLUMNS))
        ]
    return LogSource(data, columns, keys, log)


def _labelled(data: ArrayFile, name: str, labels: Sequence[str], kind: Column, robot: Robot) -> list[Column]:
    """Return the columns of a matrix with column names: by the robot's joints if all match, otherwise in their order."""
    stems = [label.removesuffix(".pos").removesuffix("_joint") for label in labels]
    joints = [joint.removesuffix("_joint") for joint in robot.joint_names]
    named = set(joints) <= set(stems) and len(set(stems)) == len(stems)
    values = np.asarray(data.array(name))
    labelled = []
    for k, stem in enumerate(stems):
        number = (joints.index(stem) + 1 if stem in joints else None) if named else k + 1
        low, high = float(values[:, k].min()), float(values[:, k].max())
        share = "gripper" in stem and low >= PERCENT[0] and high <= PERCENT[1]
        what = kind.what if number is not None else "other"
        labelled.append(
            Column(k + 1, what, number, "percent" if share else kind.unit, kind.motor, name, name)
        )
    return labelled


def _bag(data: RosBag, keys: list[str], robot: Robot, log: Path) -> LogSource:
    """Return the columns of a bag: the robot's joints by name, or by names with another prefix."""
    if data.ambiguous:
        keys = [*keys, f"topic = {quoted(data.topic)}"]
    names, note = joints_by_name(data.joints, robot.joint_names, robot.n_dof)
    columns = [Column("stamp", "time", None, "s", variable="stamp", stem="stamp")]
    for signal, kind in BAG_KINDS.items():
        if data.has(signal):
            unit = {"position": "rad", "reference": "rad"}.get(signal)
            columns += [
                Column(
                    joint,
                    kind if joint in names else "other",
                    names.index(joint) + 1 if joint in names else None,
                    unit if "prismatic" not in robot.joint_kinds else None,
                    variable=signal,
                    stem=signal,
                )
                for joint in data.joints
            ]
    return LogSource(data, columns, keys, log, joints=() if names else data.joints, note=note)


def without_locked(
    sources: Sequence[LogSource], file: str, chain: Mapping[str, Any], robot: Robot
) -> list[str]:
    """Leave out columns of locked joints.

    They are told by the order of the robot file, where a signal has one numbered column for each of its joints. Tested in
    ``tests/test_init_positions.py``.

    Parameters
    ----------
    sources : sequence of LogSource
        All files of the command.
    file : str
        Name or path of the robot.
    chain : mapping
        Options of `load_robot`, with the joints that the user locks.
    robot : Robot
        The robot with these joints locked.

    Returns
    -------
    list of str
        Sentence on the columns, if there are any.
    """
    if not chain.get("lock"):
        return []
    try:
        joints = load_robot(file, **{**chain, "lock": None}).joint_names
    except RobotError:  # with more joints than didim takes, which is why some are locked
        return []
    free = [name in robot.joint_names for name in joints]
    if [name for name, moves in zip(joints, free, strict=True) if moves] != list(robot.joint_names):
        return []
    left_out = []
    for source in sources:
        groups: dict[tuple[str, str | None, str], list[int]] = {}
        for k, column in enumerate(source.columns):
            if column.number is not None and column.what != "other" and not isinstance(source.data, RosBag):
                groups.setdefault((column.what, column.variable, column.stem), []).append(k)
        for places in groups.values():
            ordered = sorted(places, key=lambda k: source.columns[k].number or 0)
            first = source.columns[ordered[0]].number or 0
            if [source.columns[k].number for k in ordered] != list(range(first, first + len(joints))):
                continue
            for k in (k for k, moves in zip(ordered, free, strict=True) if not moves):
                left_out.append(str(source.columns[k].name))
                source.columns[k] = replace(source.columns[k], what="other")
    names = brief(series(dict.fromkeys(left_out)), 60)
    return (
        [f"{names}: of locked joints, left out; the others are in the order of the robot file"]
        if left_out
        else []
    )


def choose_columns(sources: Sequence[LogSource], kind: str, text: str) -> None:
    """Assign exactly the columns named by the user to a kind of signal.

    Parameters
    ----------
    sources : sequence of LogSource
        All files of the command.
    kind : str
        Kind of signal.
    text : str
        Names, numbers and ranges of numbers from 1; a prefix ``FILE:`` selects one file.

    Raises
    ------
    ExperimentError
        When the kind is unknown, or no file has these columns.
    """
    if kind not in WORDS:
        raise ExperimentError(
            f"--columns: {kind!r} is not a kind of signal; known are {listing(WORDS, 60)}{did_you_mean(kind, WORDS)}"
        )
    file, colon, columns = text.partition(":")
    meant = [source for source in sources if colon and file in (source.path.name, source.path.stem)]
    choices = [(source, _places(source, columns if meant else text)) for source in meant or sources]
    fitting = [(source, places) for source, places in choices if isinstance(places, list)]
    if not fitting:
        source, missing = choices[0]
        names = [column.name for column in source.columns]
        near = did_you_mean(str(missing), map(str, names)) if source.named else ""
        raise ExperimentError(
            f"{source.path.name}: --columns {kind}={text}: there is no column {missing!r}{near}"
        )
    for source, places in fitting:
        _choose(source, kind, places)


def _places(source: LogSource, text: str) -> list[int] | str:
    """Return the indices of the columns named in a text, or its first part that does not name a column."""
    names: dict[str, list[int]] = {}
    for k, column in enumerate(source.columns):
        names.setdefault(str(column.name), []).append(k)
        if column.variable is not None and isinstance(column.name, int):
            names.setdefault(column.variable, []).append(k)
    if isinstance(source.data, RosBag):
        names = {name: at[:1] for name, at in names.items()}
    numbers = {str(k + 1): [k] for k in range(len(source.columns))}
    places: list[int] = []
    for part in (part.strip() for part in text.split(",")):
        first, dash, last = part.partition("-")
        if part in names:
            places += names[part]
        elif part in numbers:
            places += numbers[part]
        elif dash and first in numbers and last in numbers and int(first) <= int(last):
            places += range(int(first) - 1, int(last))
        else:
            return part
    return places


def _choose(source: LogSource, kind: str, places: list[int]) -> None:
    if isinstance(source.data, RosBag):
        # The joints are chosen once for all signals of the bag.
        order = [source.columns[k].name for k in places]
        source.joints, source.note = (), ""
        for k, column in enumerate(source.columns):
            signal = BAG_KINDS.get(str(column.variable))
            if signal is not None:
                number = order.index(column.name) + 1 if column.name in order else None
                source.columns[k] = replace(column, what=signal if number else "other", number=number)
        return
    # Named velocities keep their kind; other columns previously assigned to this kind lose it.
    for k, column in enumerate(source.columns):
        if column.what == kind:
            source.columns[k] = replace(column, what="other")
    for number, k in enumerate(places):
        source.columns[k] = replace(
            source.columns[k], what=kind, number=number + 1, stem=f"--columns {kind}", placed=False
        )
