"""Text with one sample a line; errors name row and column.

Rows count from 1 and leave the header out. Tested in ``tests/test_recording.py``.
"""

from __future__ import annotations

import csv
import hashlib
import json
import re
from collections.abc import Iterator, Sequence

import numpy as np

import didim._core as _core

from .._tools.arrays import Array
from .._tools.threads import core_threads
from .._tools.words import counted, known_names, nearest, number_of
from .data_format import LONGEST_LINE, LOST_SAMPLE, MOST_COLUMNS, Column, DataFile

LIST = re.compile(r'"\s*\[[^\]"]*\]\s*"')
"""Pattern of a cell that is a list in JSON, as Python writes it into CSV."""
# A number with a decimal comma.
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


class CsvFile(DataFile):
    """Text with one sample a line.

    Parameters
    ----------
    raw
        Content of the file.
    name
        Its name in messages.
    delimiter
        One character; a blank stands for any white space.
    header
        Whether the first line holds names; None detects it, and refuses a first line of both names and numbers.
    decimal
        Decimal sign of the numbers: a point or a comma.

    Attributes
    ----------
    names : list of str or None
        Names in the header.
    n_columns : int
        Number of columns of the first line.
    """

    def __init__(
        self, raw: bytes, name: str, delimiter: str, header: bool | None, decimal: str = "."
    ) -> None:
        self.name = name
        self.sha256 = hashlib.sha256(raw).hexdigest()
        self._check_text(raw)
        # Line ends and blanks after the last sample are ignored; a tab may be a separator.
        self._body = raw.removeprefix(b"\xef\xbb\xbf").rstrip(b"\r\n ")
        self._delimiter = delimiter
        end = self._body.find(b"\n")
        self._first = self._decoded(0, len(self._body) if end < 0 else end, 1)
        cells = [cell.strip().strip('"') for cell in self._with_lists(self._split(self._first), end)]
        if decimal == ",":
            cells = self._with_points(cells, header, end)
        self.n_columns = len(cells)
        if self.n_columns > MOST_COLUMNS:
            self.fail(f"the first line has {self.n_columns} columns, and a log has at most {MOST_COLUMNS}")
        if not any(cells):
            self.fail("the first line is blank")
        numeric = [number_of(cell) is not None for cell in cells]
        if header is None:
            header = not any(numeric)
            if any(numeric) and not all(numeric):
                odd = cells[numeric.index(False)]
                self.fail(
                    f"the first line is neither names nor numbers ({odd!r} is not a number)"
                    + (self._delimiter_hint() or "; say header = true or header = false")
                )
        # NumPy writes its header after a comment sign.
        self.names = [cells[0].removeprefix("#").strip(), *cells[1:]] if header else None
        self._n_rows = self._body.count(b"\n") + (not header)
        self._wanted: dict[int, None] = {}
        # Columns that were read, and their values, (n_samples, n_read).
        self._read: list[int] = []
        self._values: Array | None = None

    def want(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> None:
        """Announce columns."""
        self._wanted.update(dict.fromkeys(self._indices(columns, variable, count)))

    def get(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> Array:
        """Columns as (n_samples, count)."""
        indices = self._indices(columns, variable, count)
        if self._values is None or not set(indices) <= set(self._read):
            self._wanted.update(dict.fromkeys(indices))
            self._read = sorted(self._wanted)
            self._values = self._load(self._read)
        if indices == self._read:
            return self._values
        return self._values.take([self._read.index(index) for index in indices], axis=1)

    def _check_text(self, raw: bytes) -> None:
        """Refuse a file that is not UTF-8 text, and unusual line ends."""
        if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
            self.fail("the file is UTF-16 text; save it as UTF-8")
        zero = raw.find(b"\0")
        if zero >= 0:
            self.fail(f"this is not a text file in UTF-8, byte {zero} is zero (is it binary, or UTF-16?)")
        if b"\r" in raw and raw.count(b"\r") != raw.count(b"\r\n"):
            self.fail("lines end with a carriage return alone; save the file with LF or CR LF line ends")

    def _decoded(self, start: int, end: int, line: int) -> str:
        """Return the text of a line; refuse one that cannot belong to a log."""
        if end - start > LONGEST_LINE:
            self.fail(
                f"line {line} has {(end - start) / 1e6:.3g} MB; is the file binary, or are its line ends missing?"
            )
        return self._body[start:end].decode("utf-8", "replace")

    def _lines(self) -> Iterator[tuple[int, str]]:
        """Lines with their numbers from 1, decoded one by one: a log may be larger than half of the memory."""
        start, number = 0, 1
        while start <= len(self._body):
            end = self._body.find(b"\n", start)
            end = len(self._body) if end < 0 else end
            yield number, self._decoded(start, end, number)
            start, number = end + 1, number + 1

    def _split(self, line: str) -> list[str]:
        if self._delimiter == " ":
            return line.split()
        try:
            return next(csv.reader([line.rstrip("\r\n")], delimiter=self._delimiter), [])
        except csv.Error as reason:
            self.fail(f"this is not a CSV file ({reason})")

    def _with_lists(self, cells: list[str], end: int) -> list[str]:
        """Write cells with lists, ``"[0.1, 0.2]"``, as a cell a number; return the names, ``q`` as ``q_1`` and ``q_2``."""
        second = self._body[end + 1 : end + 1 + LONGEST_LINE].partition(b"\n")[0].decode("utf-8", "replace")
        if end < 0 or not LIST.search(second) or self._delimiter != ",":
            return cells
        counts = [cell.count(",") + 1 if LIST.fullmatch(f'"{cell}"') else 0 for cell in self._split(second)]
        self._body = self._body[: end + 1] + re.sub(rb'"\s*\[|\]\s*"|(?<=,) ', b"", self._body[end + 1 :])
        if len(counts) != len(cells):
            return cells
        return [
            f"{cell}_{k + 1}" if count else cell
            for cell, count in zip(cells, counts, strict=True)
            for k in range(max(count, 1))
        ]

    def _with_points(self, cells: list[str], header: bool | None, end: int) -> list[str]:
        """Turn decimal commas into points, in the numbers and not in the names; return the cells of the first line."""
        if self._delimiter == ",":
            self.fail('decimal = "," needs another delimiter than a comma: delimiter = ";"')
        points = [cell.replace(",", ".") for cell in cells]
        if header is None:
            header = not any(number_of(cell) is not None for cell in points)
        begin = (len(self._body) if end < 0 else end + 1) if header else 0
        numbers = self._body[begin:]
        point_at = numbers.find(b".")
        if point_at >= 0:
            row = numbers.count(b"\n", 0, point_at) + 1
            line = row + 1 if header else row
            self.fail(f"line {line} has a point, and decimal = ',' says that commas are the decimal signs")
        self._body = self._body[:begin] + numbers.replace(b",", b".")
        return cells if header else points

    def _delimiter_hint(self) -> str:
        """Return the end of a sentence that suggests another delimiter if the first line seems to use it."""
        for other in (";", "\t", ",", " "):
            # Names may contain commas and blanks: these are likely delimiters only if there is no other.
            if other in self._first and other != self._delimiter and (other in ";\t" or self.n_columns == 1):
                return f"; is delimiter = {json.dumps(other)} meant?"
        return ""

    def _column(self, index: int) -> str:
        return repr(self.names[index]) if self.names else str(index + 1)

    def _row(self, row: int) -> str:
        """Return the row, from 1, and the line of the file if it differs."""
        return f"row {row} (line {row + 1})" if self.names else f"row {row}"

    def _indices(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> list[int]:
        if variable is not None:
            self.fail("variable is for .mat and .npz files; a CSV file has columns")
        if columns is None:
            if self.n_columns != count:
                more = ", so columns must say which" if self.n_columns > count else ""
                self.fail(
                    f"the file has {counted(self.n_columns, 'column')} where {count} "
                    f"{'is' if count == 1 else 'are'} wanted"
                    + ("; transpose it?" if self._n_rows == count else self._delimiter_hint() or more)
                )
            return list(range(count))
        return [self._index(column) for column in columns]

    def _index(self, column: Column) -> int:
        if isinstance(column, int):
            if not 1 <= column <= self.n_columns:
                there = f"the columns are 1 to {self.n_columns}" if self.n_columns > 1 else "there is one"
                self.fail(f"there is no column {column}; {there}{self._delimiter_hint()}")
            return column - 1
        if self.names is None:
            self.fail(f"there is no column {column!r}: the file has no header, so columns go by number")
        if column not in self.names:
            there = known_names(column, self.names, "column")
            hint = "" if nearest(column, self.names) else self._delimiter_hint()
            self.fail(f"there is no column {column!r}; {there}{hint}")
        if self.names.count(column) > 1:
            self.fail(f"column {column!r} occurs twice in the header")
        return self.names.index(column)

    def _load(self, usecols: list[int]) -> Array:
        """Parse the requested columns: the core reads plain text of numbers, and any other is read line by line."""
        if self._n_rows == 0:
            self.fail("there are no rows below the header")
        plain = None
        if self._delimiter.isascii():
            begin = 0 if self.names is None else self._body.find(b"\n") + 1
            plain = _core.parse_table(
                self._body[begin:], ord(self._delimiter), self.n_columns, usecols, core_threads()
            )
        return self._parse_lines(usecols) if plain is None else plain

    def _parse_lines(self, usecols: list[int]) -> Array:
        """Parse the lines one by one, and raise on the first that is blank, ragged or not numeric."""
        values = np.empty((self._n_rows, len(usecols)))
        for number, line in self._lines():
            row = number - (self.names is not None)
            if row == 0:
                continue
            if not line.strip():
                self.fail(f"{self._row(row)} is blank; samples must not be missing")
            cells = self._split(line)
            if len(cells) != self.n_columns:
                hint = self._ragged_hint(len(cells), last=row == self._n_rows)
                self.fail(
                    f"{self._row(row)} has {counted(len(cells), 'column')} where the first line has "
                    f"{self.n_columns}{hint}"
                )
            for k, index in enumerate(usecols):
                cell = cells[index].strip()
                value = number_of(cell)
                if value is None:
                    comma = DECIMAL_COMMA.fullmatch(cell)
                    hint = '; for decimal commas, decimal = ","' if comma else ""
                    text = f"{cell!r}, not a number{hint}" if cell else f"empty{LOST_SAMPLE}"
                    self.fail(f"{self._row(row)}, column {self._column(index)}, is {text}")
                values[row - 1, k] = value
        if not np.isfinite(values).all():
            row, column = np.argwhere(~np.isfinite(values))[0]
            where = f"{self._row(row + 1)}, column {self._column(usecols[column])}"
            self.fail(f"{where}, is {values[row, column]}{LOST_SAMPLE}")
        return values

    def _ragged_hint(self, count: int, *, last: bool) -> str:
        """End of a sentence on a line with another number of cells than the first."""
        if count == 2 * self.n_columns:
            return "; are there decimal commas?"
        return "; it is the last one: delete it if the recording was cut off" if last else ""
