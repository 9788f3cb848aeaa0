"""Rows of a text log by their number: a log of any length is read a range of rows at a time.

Tested in ``tests/test_pieces.py``.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..._tools.inputs import BLOCK, check_input
from ...errors import RecordingError
from ..csv_file import CsvFile
from ..data_file import TEXT
from ..data_format import LONGEST_LINE

EVERY = 1024
"""Rows between two rows whose place in the file is kept: 8 bytes for each 1024 rows."""


class TextRows:
    """A text file with one sample a line, of which ranges of rows are read.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        Its name in messages.
    delimiter, header, decimal
        As for `CsvFile`.

    Attributes
    ----------
    count : int
        Number of rows, without the header and blank lines at the end.

    Raises
    ------
    RecordingError
        For a file of another format, and as `CsvFile`.
    """

    def __init__(
        self, path: Path, name: str, delimiter: str | None, header: bool | None, decimal: str | None
    ) -> None:
        if path.suffix.lower() not in TEXT:
            raise RecordingError(f"{name}: only text files are read in pieces ({' '.join(TEXT)})")
        check_input(path, RecordingError, "no such data file", copies=0)
        self._path, self._name = path, name
        self._options = ("," if delimiter is None else delimiter, header, decimal or ".")
        with path.open("rb") as file:
            self._first = file.readline()
            probe = CsvFile(self._first + file.readline(), name, *self._options)
            self._skipped = int(probe.names is not None)
            self._places, lines = _places(file)
        self.count = lines - self._skipped

    def rows(self, start: int, stop: int) -> CsvFile:
        """Return rows `start` to `stop`, from 0, as a file of their own; messages count rows from the first of them."""
        first, last = start + self._skipped, stop + self._skipped
        near = first // EVERY
        with self._path.open("rb") as file:
            file.seek(self._places[near])
            far = -(-last // EVERY)
            size = self._places[far] - file.tell() if far < len(self._places) else -1
            raw = file.read(size)
        ends = np.flatnonzero(np.frombuffer(raw, np.uint8) == ord("\n")) + 1
        begin = int(ends[first - near * EVERY - 1]) if first > near * EVERY else 0
        wanted = last - near * EVERY - 1
        raw = raw[begin : int(ends[wanted]) if wanted < len(ends) else len(raw)]
        name = self._name if start == 0 else f"{self._name} after row {start}"
        return CsvFile(self._first * self._skipped + raw, name, *self._options)


def _places(file: BinaryIO) -> tuple[list[int], int]:
    """Return the places (bytes) of every `EVERY`-th line, and the number of lines before blank ones at the end."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - LONGEST_LINE))
    tail = file.read()
    end = size - len(tail) + len(tail.rstrip(b"\r\n "))
    places, lines, begin = [0], 0, 0
    file.seek(0)
    while block := file.read(min(16 * BLOCK, end - begin)):
        ends = np.flatnonzero(np.frombuffer(block, np.uint8) == ord("\n"))
        places += (begin + 1 + ends[EVERY * len(places) - lines - 1 :: EVERY]).tolist()
        lines, begin = lines + len(ends), begin + len(block)
    return places, lines + 1
