"""Logs with one column per file, or one value per line. Tested in ``tests/test_containers.py``."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from .._tools.arrays import Array
from .._tools.words import counted
from ..errors import RecordingError
from .data_format import Column, DataFile


class OneValueALine(DataFile):
    """Text with one value a line, sample after sample.

    Parameters
    ----------
    file
        The text, of one column.
    values_per_sample
        Number of values per sample: the columns, numbered from 1.
    """

    def __init__(self, file: DataFile, values_per_sample: int) -> None:
        self.name, self.sha256 = file.name, file.sha256
        self._file, self._width = file, values_per_sample

    def want(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> None:
        """Request columns."""
        self._numbers(columns, count)
        self._file.want(None, variable, 1)

    def get(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> Array:
        """Columns as (n_samples, count)."""
        numbers = self._numbers(columns, count)
        values = self._file.get(None, variable, 1)
        if len(values) % self._width:
            self.fail(
                f"{counted(len(values), 'line')} are not a whole number of samples of {counted(self._width, 'value')}"
            )
        return np.ascontiguousarray(values.reshape(-1, self._width)[:, [number - 1 for number in numbers]])

    def _numbers(self, columns: Sequence[Column] | None, count: int) -> list[int]:
        if columns is None:
            if count != self._width:
                self.fail(f"columns must say which {count} of the {self._width} values of a sample are meant")
            return list(range(1, count + 1))
        numbers = [column for column in columns if isinstance(column, int)]
        if len(numbers) < len(columns):
            self.fail("values with one per line have no names: columns go by number, from 1")
        for number in numbers:
            if not 1 <= number <= self._width:
                self.fail(f"there is no column {number}; values_per_sample says 1 to {self._width}")
        return numbers


class OneColumnAFile(DataFile):
    """Several files of one column each, in the order of the joints.

    Parameters
    ----------
    files
        The files.
    """

    def __init__(self, files: Sequence[DataFile]) -> None:
        self.name = f"{files[0].name} to {files[-1].name}" if len(files) > 1 else files[0].name
        self.sha256 = hashlib.sha256("".join(file.sha256 for file in files).encode()).hexdigest()
        self._files = files

    def want(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> None:
        """Request columns."""
        if columns is not None and len(columns) != len(self._files):
            self.fail(
                f"columns must be one for each of the {counted(len(self._files), 'file')}, or be left out"
            )
        if len(self._files) != count:
            self.fail(f"file must name {counted(count, 'file')} of one column each, got {len(self._files)}")
        for file, column in zip(self._files, self._each(columns), strict=True):
            file.want(None if column is None else [column], variable, 1)

    def get(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> Array:
        """Columns as (n_samples, count)."""
        parts = [
            file.get(None if column is None else [column], variable, 1)
            for file, column in zip(self._files, self._each(columns), strict=True)
        ]
        for file, part in zip(self._files, parts, strict=True):
            if len(part) != len(parts[0]):
                raise RecordingError(
                    f"{file.name} has {counted(len(part), 'sample')}, {self._files[0].name} has {len(parts[0])}"
                )
        return np.hstack(parts)

    def _each(self, columns: Sequence[Column] | None) -> Sequence[Column | None]:
        return [None] * len(self._files) if columns is None else columns
