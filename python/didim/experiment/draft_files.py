"""Several files of one command: several recordings, or several signals of one log.

Half of the public logs have one file per signal, such as positions, velocities or torques. A file with both positions and
torques is a recording. Other files form one recording if their names differ only in the word of the signal. Tested in
``tests/test_init_files.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import quoted
from .._tools.words import brief, counted, series
from ..errors import ExperimentError
from ..robot.robot import Robot
from .draft_columns import Column, name_without_signal
from .draft_layout import kinds_of_blocks
from .draft_source import LogSource

EFFORTS = ("torque", "current", "voltage")
"""Kinds of signals that are a joint's effort."""
SIGNALS = ("position", "velocity", "reference", *EFFORTS)
"""Kinds of signals of a recording."""
REPEATED = "repeated"
"""Kind of a time column that repeats the time stamps of another file."""
SAME_TIME = 0.5
"""Largest difference of two time stamps of one row, in median steps, for two files to share their rows."""


@dataclass
class LogFiles:
    """A log in several files with equal rows; the attribute `file` of a column is the number of its file.

    Attributes
    ----------
    files : sequence of LogSource
        Its files.
    columns : list of Column
        Those of all files.
    joints, note
        Joints and note of a bag, which is never one of several files.
    """

    files: Sequence[LogSource]
    columns: list[Column]
    joints: tuple[str, ...] = field(default=(), init=False)
    note: str = field(default="", init=False)

    @property
    def keys(self) -> list[str]:
        """Return the keys of the first file."""
        return self.files[0].keys

    @property
    def named(self) -> bool:
        """Whether all columns have names."""
        return all(source.named for source in self.files)

    def want(self, columns: Sequence[Column]) -> None:
        """Request columns before reading."""
        for number, source in enumerate(self.files):
            source.want([column for column in columns if column.file == number])

    def values(self, columns: Sequence[Column]) -> Array:
        """Return the values of some columns, (n_samples, n)."""
        return np.hstack([self.files[column.file].values([column]) for column in columns])

    def place(self, column: Column, row: int) -> str:
        """Return the location of a value in words: file, row from 1, column."""
        return self.files[column.file].place(column, row)

    def lines(self, columns: Sequence[Column], robot: Robot) -> list[str]:
        """Return the TOML lines that name some columns; one column per file becomes a list of files."""
        numbers = [column.file for column in columns]
        if len(set(numbers)) < 2:
            return self.files[numbers[0] if numbers else 0].lines(columns, robot)
        others = self.files[numbers[0]].keys[1:]
        names = [self.files[number].keys[0].removeprefix("file = ") for number in numbers]
        return [
            f"file = [{', '.join(names)}]",
            *others,
            f"columns = {quoted([column.name for column in columns])}",
        ]


Log = LogSource | LogFiles
"""A log for the writer of a recording."""


def assembled(sources: Sequence[LogSource], robot: Robot) -> tuple[list[tuple[Log, str, Path]], list[str]]:
    """Decide which files are separate recordings, and which are signals of one.

    Parameters
    ----------
    sources : sequence of LogSource
        All files, in the order of the command line.
    robot : Robot
        Robot with its joints.

    Returns
    -------
    list of (Log, str, Path), list of str
        Logs with the name of the recording and a path for messages, and sentences on the decisions.

    Raises
    ------
    ExperimentError
        When files of one log differ in their number of rows.
    """
    logs: list[tuple[Log, str, Path]] = []
    # Efforts without a sign beside a file of commands alone: the magnitudes of a servo's current.
    notes = []
    if any(_kinds(source.columns) in (["reference"], ["time", "reference"]) for source in sources):
        for source in sources:
            for kind in EFFORTS:
                at = [k for k, column in enumerate(source.columns) if column.what == kind]
                if at and source.values([source.columns[k] for k in at]).min() >= 0.0:
                    notes.append(f"{source.path.name}: the {kind}s have no sign, so they are left out")
                    for k in at:
                        source.columns[k] = replace(source.columns[k], what="other")
    groups = _groups(sources, robot)
    for group in groups:
        if len(group) == 1:
            logs.append((group[0], group[0].path.stem, group[0].path))
            continue
        log = _merged(group, robot)
        files = series(
            f"{source.path.name} ({brief('/'.join(_kinds(log.columns, k)), 40) or 'not used'})"
            for k, source in enumerate(group)
        )
        notes.append(f"{counted(len(group), 'file')} are signals of one recording: {files}")
        name = "_".join(name_without_signal(group[0].path.stem)) or group[0].path.stem
        logs.append((log, name, group[0].path))
    if len({name for _, name, _ in logs}) < len({path.parent for _, _, path in logs}) == len(logs):
        logs = [(log, path.resolve().parent.name, path) for log, _, path in logs]
    if len(groups) > 1:
        notes.append(f"{counted(len(sources), 'file')} make {len(groups)} recordings")
    return logs, list(dict.fromkeys(notes))


def _kinds(columns: Sequence[Column], file: int | None = None) -> list[str]:
    """Return the kinds of signals among some columns."""
    there = {column.what for column in columns if (file is None or column.file == file) and not column.placed}
    return [kind for kind in ("time", *SIGNALS) if kind in there]


def _groups(sources: Sequence[LogSource], robot: Robot) -> list[list[LogSource]]:
    alone = [[source] for source in sources]
    parts = [source for source in sources if not _complete([source], robot)]
    if len(sources) < 2 or not parts or any(source.joints or source.note for source in sources):
        return alone
    by_name: dict[tuple[str, ...], list[LogSource]] = {}
    for source in parts:
        by_name.setdefault(name_without_signal(source.path.stem), []).append(source)
    named = list(by_name.values())
    if not all(_complete(group, robot) and _disjoint(group, robot) for group in named):
        folders: dict[Path, list[LogSource]] = {}
        for source in parts:
            folders.setdefault(source.path.parent, []).append(source)
        if len(parts) == len(sources) and _disjoint(parts, robot):
            named = [parts]
        elif len(folders) > 1 and all(
            len(group) > 1 and _disjoint(group, robot) for group in folders.values()
        ):
            named = list(folders.values())
        else:
            return alone
    # In the order of the command line.
    of = {id(source): group for group in [*alone, *named] for source in group}
    return list({id(of[id(source)]): of[id(source)] for source in sources}.values())


def _complete(group: Sequence[LogSource], robot: Robot) -> bool:
    """Whether files together have positions and efforts of all joints."""
    kinds = [column.what for source in group for column in source.columns if not column.placed]
    return kinds.count("position") >= robot.n_dof and any(
        kinds.count(kind) >= robot.n_dof for kind in EFFORTS
    )


def _disjoint(group: Sequence[LogSource], robot: Robot) -> bool:
    """Whether no two files have the same signal, apart from time stamps; one-column files may.

    Of the files whose kind no name gives, those with a column per joint may be what is missing; others are not used.
    """
    seen: set[tuple[str, int | None]] = set()
    for source in group:
        signals = [column for column in source.columns if column.what != "time"]
        kinds = [kind for kind in _kinds(signals) if kind in SIGNALS]
        own_kinds = {(kind, signals[0].number if len(signals) == 1 else None) for kind in kinds}
        if own_kinds & seen:
            return False
        seen |= own_kinds
    return bool(seen) or sum(_blank(source.columns, robot) for source in group) >= 2


def _blank(columns: Sequence[Column], robot: Robot) -> bool:
    """Whether a file has a column per joint, and nothing says of which signal."""
    signals = [column for column in columns if column.what != "time"]
    return len(signals) == robot.n_dof and all(column.placed or column.what == "other" for column in signals)


def _merged(group: Sequence[LogSource], robot: Robot) -> LogFiles:
    """Merge several files with equal rows into one log."""
    columns = [replace(column, file=k) for k, source in enumerate(group) for column in source.columns]
    # Columns of another kind may hold words.
    first = [sorted(source.columns, key=lambda column: column.what == "other")[:1] for source in group]
    rows = [len(source.values(one)) for source, one in zip(group, first, strict=True)]
    for source, count in zip(group, rows, strict=True):
        if count != rows[0]:
            raise ExperimentError(
                f"{source.path.name} has {counted(count, 'row')} and {group[0].path.name} has {rows[0]}: files of one log "
                "need equal rows; several recordings need positions and torques in each file"
            )
    log = LogFiles(group, columns)
    _by_values(log, robot)
    _one_time(log)
    return log


def _by_values(log: LogFiles, robot: Robot) -> None:
    """Classify the files that neither names of columns nor of files give a kind, by their values beside those of the others."""
    files = [
        [k for k, column in enumerate(log.columns) if column.file == number and column.what != "time"]
        for number in range(len(log.files))
    ]
    blocks = [block for block in files if len(block) == robot.n_dof]
    blank = [_blank([log.columns[k] for k in block], robot) for block in blocks]
    if not any(blank) or len(blocks) < 2:
        return
    known = _kinds(log.columns)
    values = [log.values([log.columns[k] for k in block]) for block in blocks]
    stamps = [column for column in log.columns if column.what == "time"]
    t = log.values(stamps[:1])[:, 0] if stamps else np.arange(len(values[0]), dtype=np.float64)
    for kind, block, open_kind in zip(kinds_of_blocks(values, t), blocks, blank, strict=True):
        if not open_kind or kind in known:
            continue
        for number, k in enumerate(block):
            log.columns[k] = replace(log.columns[k], what=kind, number=number + 1, placed=False)


def _one_time(log: LogFiles) -> None:
    """Use the time stamps of the file with the positions; refuse files with different stamps."""
    stamps = [stamp for stamp in log.columns if stamp.what == "time"]
    if len({stamp.file for stamp in stamps}) < 2:
        return
    file_of_stamps = next((stamp.file for stamp in log.columns if stamp.what == "position"), stamps[0].file)
    first = next((stamp for stamp in stamps if stamp.file == file_of_stamps), stamps[0])
    t = log.values([first])[:, 0]
    step = float(np.median(np.abs(np.diff(t)))) if len(t) > 1 else 0.0
    for stamp in stamps:
        if stamp.file == first.file:
            continue
        apart = np.abs(log.values([stamp])[:, 0] - t)
        if apart.max() > SAME_TIME * step:
            row = int(np.argmax(apart > SAME_TIME * step))
            files = f"{log.files[stamp.file].path.name} and {log.files[first.file].path.name}"
            raise ExperimentError(
                f"{files} have other time stamps from row {row + 1} on: files of one log need equal rows; bring them to one clock"
            )
        log.columns[log.columns.index(stamp)] = replace(stamp, what=REPEATED)
