"""Rows of a study as JSON lines: appended whole, read with care, merged by ``cat``. Tested in ``tests/test_study_rows.py``."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from .._tools.words import counted
from ..errors import StudyError
from .worker import LOST, TRUTH

Row = dict[str, Any]

KEYS = ("id", "scenario", "method", "seed", "status")
"""Keys that every row has."""


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
        Lines that were not rows, and rows that contradict each other.
    """

    fits: dict[str, Row] = field(default_factory=dict)
    truths: dict[str, Row] = field(default_factory=dict)
    untrue: dict[str, Row] = field(default_factory=dict)
    times: dict[str, Row] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @property
    def done(self) -> set[str]:
        """Ids of the tasks that need not be run again: all but those whose workers died."""
        rows = [*self.fits.values(), *self.truths.values(), *self.untrue.values()]
        return {row["id"] for row in rows if row["status"] != LOST}


def times_path(path: Path) -> Path:
    """Return the file of the times that belong to a file of rows."""
    return path.with_name(f"{path.stem}.times{path.suffix or '.jsonl'}")


def read_rows(*paths: Path, own_times: bool = True) -> Rows:
    """Read files of rows, and the times beside them.

    A row that stands in several files counts once. A line that a killed process has left unfinished is dropped, with a remark.

    Parameters
    ----------
    paths : Path
        Files of rows.
    own_times : bool
        Read the times beside each file too.

    Raises
    ------
    StudyError
        For a file that is missing, or holds something else.
    """
    collected = Collected()
    for path in paths:
        collected.add(_lines(_content(path)), path.name)
        beside = times_path(path)
        if own_times and beside.is_file():
            collected.add_times(_lines(_content(beside)))
    return collected.rows()


def rows_of(lines: Iterable[tuple[str, str | None]]) -> Rows:
    """Return rows from lines, each with that of its times or None."""
    pairs = list(lines)
    collected = Collected()
    collected.add((json.loads(row) for row, _ in pairs), "rows")
    collected.add_times(json.loads(times) for _, times in pairs if times is not None)
    return collected.rows()


class Collected:
    """Rows and times as they come from files."""

    def __init__(self) -> None:
        self._found: dict[str, Row] = {}
        self._times: dict[str, Row] = {}
        self._remarks: list[str] = []

    def add(self, lines: Iterable[Row | None], name: str) -> None:
        """Add the rows of a file.

        Raises
        ------
        StudyError
            For rows of something else.
        """
        torn = different = 0
        for row in lines:
            if row is None:
                torn += 1
                continue
            missing = [key for key in KEYS if key not in row]
            if missing:
                raise StudyError(
                    f"{name}: a row of a study has the key {missing[0]!r}, and this file has rows without"
                )
            texts = ("id", "scenario", "status", *(("method",) if row["method"] is not None else ()))
            wrong = [key for key in texts if not isinstance(row[key], str)]
            if wrong:
                raise StudyError(
                    f"{name}: {wrong[0]!r} of a row must be text, got {str(row[wrong[0]])[:40]!r}"
                )
            before = self._found.get(row["id"])
            if before is None or before["status"] == LOST:
                self._found[row["id"]] = row
            elif before != row and row["status"] != LOST:
                different += 1
        if torn:
            self._remarks.append(f"{name}: {counted(torn, 'unfinished line')} dropped")
        if different:
            self._remarks.append(
                f"{name}: {counted(different, 'row')} differ from earlier ones of the same task, which count"
            )

    def add_times(self, lines: Iterable[Row | None]) -> None:
        """Add the times of a file."""
        self._times.update({row["id"]: row for row in lines if row is not None and "id" in row})

    def rows(self) -> Rows:
        """Return what was collected."""
        return _sorted(self._found, self._times, self._remarks)


def _sorted(found: dict[str, Row], times: dict[str, Row], remarks: Iterable[str]) -> Rows:
    # Rows come in the order in which workers ended: that of the ids is always the same.
    ordered = [found[key] for key in sorted(found)]
    return Rows(
        fits={row["id"]: row for row in ordered if row["method"] is not None},
        truths={row["scenario"]: row for row in ordered if row["status"] == TRUTH},
        untrue={row["scenario"]: row for row in ordered if row["method"] is None and row["status"] != TRUTH},
        times=times,
        remarks=tuple(remarks),
    )


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as reason:
        raise StudyError(f"{path}: cannot be read ({reason.strerror})") from None


def _lines(content: bytes) -> Iterable[Row | None]:
    """Rows of a file; None for a line that is not one."""
    for line in content.split(b"\n"):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except ValueError:
            yield None
            continue
        yield row if isinstance(row, dict) else None


class RowFile:
    """File that rows are appended to, each by one write: a reader or a crash never meets half of one but the last.

    Parameters
    ----------
    path : Path
        An unfinished last line is cut off when the file is opened.

    Raises
    ------
    StudyError
        When another process writes to the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
        try:
            _lock(self._file, path)
            _cut_unfinished(self._file)
        except BaseException:
            os.close(self._file)
            raise

    def append(self, line: str) -> None:
        """Append a line.

        Raises
        ------
        OSError
            When it could not be written whole, such as on a full disk.
        """
        data = line.encode() + b"\n"
        written = os.write(self._file, data)
        if written != len(data):
            # The rest of this line would be torn by the next: take back what came of it.
            os.ftruncate(self._file, os.fstat(self._file).st_size - written)
            raise OSError(28, "No space left on device", str(self.path))

    def close(self) -> None:
        """Close the file, which also gives up its lock."""
        os.close(self._file)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _lock(file: int, path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # Windows: two studies of one file are not noticed there
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


def _cut_unfinished(file: int) -> None:
    """Cut off what stands behind the last line break."""
    end = size = os.fstat(file).st_size
    while end > 0:
        begin = max(0, end - 65536)
        os.lseek(file, begin, os.SEEK_SET)
        place = os.read(file, end - begin).rfind(b"\n")
        if place >= 0:
            end = begin + place + 1
            break
        end = begin
    if end < size:
        os.ftruncate(file, end)
