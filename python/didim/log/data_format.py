"""Columns of a data file, and the interface of a reader. Tested in ``tests/test_recording.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from .._tools.arrays import Array

Column = str | int
"""A column by name, or by number from 1."""
MOST_COLUMNS = 10_000
"""Largest number of columns of a log: 100 signals of 100 joints."""
LONGEST_LINE = 1_000_000
"""Largest length (bytes) of a line: 100 bytes for each of `MOST_COLUMNS`. A longer line is binary or has lost its line ends."""

LOST_SAMPLE = (
    "; delete this row, which resample = true under [recording.time] bridges, or split the log there"
)
"""Last words of a sentence on a missing value."""


class DataFile(Protocol):
    """Interface of a data file of any format."""

    name: str
    sha256: str

    def want(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> None:
        """Request columns before the file is read once for all; wrong names raise here."""

    def get(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> Array:
        """Columns as (n_samples, count), in the file's unit, all finite."""
