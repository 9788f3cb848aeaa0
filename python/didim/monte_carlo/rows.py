"""Rows of a study as JSON lines: appended whole, validated when read, merged by ``cat``. Tested in ``tests/test_study_rows.py``."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from .._tools.inputs import read_file, readable
from .._tools.settings import real_number
from .._tools.words import brief, counted, series
from ..errors import StudyError
from ..result.iteration import Status
from .worker import ERROR, FAILED, LOST, SEAL, TRUTH, seal_of

Row = dict[str, Any]

NO_FIT = (FAILED, ERROR, LOST)
"""Statuses of rows without a result; they have a sentence instead."""

Line = tuple[int, Row | None]
"""Number of a line, from 1, and its row; None if the line is not a row."""
LONGEST_ROW = 1 << 20
"""Upper bound of the bytes of a row that is looked for in a file to be continued; one of 500 parameters has 20 kB."""
SEARCHED = 1 << 26
"""Bytes of a file to be continued in which a row is looked for."""


@dataclass(frozen=True)
class Rows:
    """Rows by id, each once.

    Attributes
    ----------
    fits : dict
        Rows of identifications, failed ones too, by id.
    truths : dict
        Rows of scenarios, by the name of the scenario.
    untrue : dict
        Rows of scenarios whose truth failed, by the name of the scenario.
    times : dict
        Times by id.
    remarks : tuple of str
        Sentences on lines that are not rows, and on contradictory rows.
    """

    fits: dict[str, Row] = field(default_factory=dict)
    truths: dict[str, Row] = field(default_factory=dict)
    untrue: dict[str, Row] = field(default_factory=dict)
    times: dict[str, Row] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @property
    def statuses(self) -> dict[str, str]:
        """Status of each row by id."""
        rows = (*self.fits.values(), *self.truths.values(), *self.untrue.values())
        return {row["id"]: row["status"] for row in rows}

    @property
    def done(self) -> set[str]:
        """Ids of the finished tasks: all except those whose workers died."""
        return {key for key, status in self.statuses.items() if status != LOST}


def times_path(path: Path) -> Path:
    """Return the file with the times of a file of rows."""
    return (
        path.parent / f"{path.stem}.times{path.suffix or '.jsonl'}"
    )  # a path without a name is refused with the rows


def read_rows(*paths: Path, appended: bool = False) -> Rows:
    """Read files of rows, and the files of their times.

    A row in several files counts once. An unfinished line of a killed process is dropped with a remark, and so is a row whose
    content contradicts its digest. Rows of versions before 0.3.0 have no digest, and a remark says so.

    Parameters
    ----------
    paths : Path
        Files of rows.
    appended : bool
        Whether the files are outputs of this run, to be continued.

    Raises
    ------
    StudyError
        For a missing file, or one with other content.
    """
    collected = Collected()
    for path in paths:
        collected.add(_lines(_content(path, appended)), path.name)
        beside = times_path(path)
        if beside.is_file():
            collected.add_times(_lines(_content(beside, appended)), beside.name)
    return collected.rows()


def rows_of(rows: Iterable[str], times: Iterable[str]) -> Rows:
    """Return rows from their lines and those of their times."""
    collected = Collected()
    collected.add(enumerate(map(json.loads, rows), 1), "rows")
    collected.add_times(enumerate(map(json.loads, times), 1), "times")
    return collected.rows()


class Collected:
    """Collector of rows and times from files."""

    def __init__(self) -> None:
        self._found: dict[str, Row] = {}
        self._times: dict[str, Row] = {}
        self._remarks: list[str] = []

    def add(self, lines: Iterable[Line], name: str) -> None:
        """Add the rows of a file.

        Raises
        ------
        StudyError
            For an invalid row; the sentence names the file, the line and the key.
        """
        torn: list[int] = []
        changed: list[int] = []
        different = unsealed = 0
        for number, row in lines:
            if row is None:
                torn.append(number)
                continue
            if SEAL not in row:
                unsealed += 1
            elif not _is_sound(row):
                changed.append(number)
                continue
            _check_row(row, f"{name}: line {number}")
            row = {key: value for key, value in row.items() if key != SEAL}
            before = self._found.get(row["id"])
            if before is None or before["status"] == LOST:
                self._found[row["id"]] = row
            elif before != row and row["status"] != LOST:
                different += 1
        remarks = (
            (torn, f"{_places(torn)} no row (unfinished or damaged), dropped"),
            (changed, f"{_places(changed)} not as written (digests differ), dropped"),
            (
                unsealed,
                f"{counted(unsealed, 'row')} without a digest, as before version 0.3.0: changes would not be seen",
            ),
            (
                different,
                f"{counted(different, 'row')} differ from earlier ones of the same task, which count",
            ),
        )
        self._remarks += [f"{name}: {remark}" for found, remark in remarks if found]

    def add_times(self, lines: Iterable[Line], name: str) -> None:
        """Add the times of a file.

        Raises
        ------
        StudyError
            For invalid times; the sentence names the file, the line and the key.
        """
        for number, row in lines:
            if row is not None:
                _check(row, {"id": "text", "seconds": "a number"}, f"{name}: line {number}")
                self._times[row["id"]] = row

    def rows(self) -> Rows:
        """Return the collected rows, in the order of their ids: workers finish in any order."""
        ordered = [self._found[key] for key in sorted(self._found)]
        scenarios = [row for row in ordered if row["method"] is None]
        return Rows(
            fits={row["id"]: row for row in ordered if row["method"] is not None},
            truths={row["scenario"]: row for row in scenarios if row["status"] == TRUTH},
            untrue={row["scenario"]: row for row in scenarios if row["status"] != TRUTH},
            times=self._times,
            remarks=tuple(self._remarks),
        )


def _is_sound(row: Row) -> bool:
    """Whether a row's content matches its digest."""
    try:
        return bool(row[SEAL] == seal_of(row))
    except ValueError:  # infinities or invalid texts, which rows never contain
        return False


def _places(lines: list[int]) -> str:
    """Return numbers of lines as the subject of a sentence."""
    return f"line {lines[0]} is" if len(lines) == 1 else f"lines {series(map(str, lines), 20)} are"


def _content(path: Path, appended: bool) -> bytes:
    if not appended:
        return read_file(path, StudyError, "cannot be read (there is no such file)", copies=2)
    with readable(path, StudyError):
        return path.read_bytes()


def _lines(content: bytes) -> Iterable[Line]:
    """Return the nonempty lines of a file."""
    for number, line in enumerate(content.split(b"\n"), 1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):  # deeply nested brackets
            row = None
        yield number, row if isinstance(row, dict) else None


def _is_number(value: object) -> bool:
    return math.isfinite(real_number(value))


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and _is_number(value) and value >= 0


KINDS: dict[str, Callable[[object], bool]] = {
    "text": lambda value: isinstance(value, str),
    "text or null": lambda value: value is None or isinstance(value, str),
    "a number": _is_number,
    "a number or null": lambda value: value is None or _is_number(value),
    "a list of numbers": lambda value: (
        isinstance(value, list) and all(entry is None or _is_number(entry) for entry in value)
    ),
    "a table": lambda value: isinstance(value, dict),
    "a whole number": _is_whole,
    "a whole number or null": lambda value: value is None or _is_whole(value),
}
"""Test of each kind of value, by the name that messages use."""
HEAD = {
    "id": "text",
    "scenario": "text",
    "method": "text or null",
    "seed": "a whole number or null",
    "status": "text",
}
"""Kinds of the keys of every row."""
FIT = {
    "beta": "a list of numbers",
    "std": "a list of numbers",
    "factor": "a number or null",
    "torque_error": "a number or null",
    "simulations": "a whole number",
}
"""Kinds of the keys of a row with a result."""


def _check(row: Row, kinds: dict[str, str], where: str) -> None:
    """Refuse a row with a missing key or a value of the wrong kind."""
    for key, kind in kinds.items():
        if key not in row:
            raise StudyError(f"{where}: a row of a study has the key {key!r}, and this one has not")
        if not KINDS[kind](row[key]):
            raise StudyError(f"{where}: {key!r} of a row must be {kind}, got {_shown(row[key])}")


def _shown(value: object) -> str:
    return brief(json.dumps(value), 43)


def _check_row(row: Row, where: str) -> None:
    """Refuse a row that no worker could write; all readers of rows rely on this."""
    _check(row, HEAD, where)
    status = row["status"]
    if row["method"] is None:
        known: tuple[str, ...] = (TRUTH, *NO_FIT)
        own = {"truth": "a list of numbers", "keys": "a table"}
    else:
        known = (*Status.__members__, *NO_FIT)
        own = {"seed": "a whole number", **FIT}
    if status not in known:
        raise StudyError(f"{where}: 'status' of a row is unknown, got {_shown(status)}")
    if status in NO_FIT:
        own = {"seed": HEAD["seed"] if row["method"] is None else "a whole number", "sentence": "text"}
    _check(row, own, where)
    if "beta" in own and len(row["beta"]) != len(row["std"]):
        raise StudyError(
            f"{where}: 'std' of a row must have a value for each of 'beta', got {len(row['std'])} for {len(row['beta'])}"
        )


OPENING = b'{"id":'
"""First bytes of a row."""


class RowFile:
    """File of rows, each appended by a single write: at most the last line can be incomplete.

    Parameters
    ----------
    path : Path
        The file; it is not changed before the first row is appended, which removes an unfinished last line.

    Raises
    ------
    StudyError
        When another process writes to the file, or it contains other than rows.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if path.exists() and not path.is_file():
            raise StudyError(f"{path}: rows are appended to a file and read again, and this is none")
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
        self._whole = False
        try:
            _lock(self._file, path)
            _require_rows(path)
        except BaseException:
            os.close(self._file)
            raise

    def append(self, line: str) -> None:
        """Append a line.

        Raises
        ------
        OSError
            When it could not be written completely, for example on a full disk.
        """
        if not self._whole:
            # Text after the last line break is removed.
            end = size = os.fstat(self._file).st_size
            while end > 0:
                begin = max(0, end - 65536)
                os.lseek(self._file, begin, os.SEEK_SET)
                end_of_line = os.read(self._file, end - begin).rfind(b"\n")
                if end_of_line >= 0:
                    end = begin + end_of_line + 1
                    break
                end = begin
            if end < size:
                os.ftruncate(self._file, end)
            self._whole = True
        data = line.encode() + b"\n"
        written = os.write(self._file, data)
        if written != len(data):
            # The next line would be appended to this incomplete one, so it is removed.
            os.ftruncate(self._file, os.fstat(self._file).st_size - written)
            raise OSError(28, "No space left on device", str(self.path))

    def close(self) -> None:
        """Close the file and release its lock."""
        os.close(self._file)


def _lock(file: int, path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # Windows: two studies with one file are not detected there
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise StudyError(
            f"{path}: another process writes to this file; give each study a file of its own"
        ) from None
    except OSError:
        # A file system without locks.
        return


def _require_rows(path: Path) -> None:
    """Refuse a file of other content, which appending would damage.

    One line with an id suffices, because others may be damaged; an unfinished first line must begin like a row.
    """
    with path.open("rb") as file:
        opening = file.read(len(OPENING))
        file.seek(0)
        for line in iter(partial(file.readline, LONGEST_ROW), b""):
            if file.tell() > SEARCHED:
                break
            try:
                row = json.loads(line)
            except (ValueError, RecursionError):
                continue
            if isinstance(row, dict) and isinstance(row.get("id"), str):
                return
        if OPENING.startswith(opening) if len(opening) < len(OPENING) else opening == OPENING:
            return
    raise StudyError(
        f"{path}: this file holds no rows of a study, and nothing was written to it; give -o another file"
    )
