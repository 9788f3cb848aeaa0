"""Columns of a data file, and the base of its readers. Tested in ``tests/test_recording.py``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NoReturn

from .._tools.arrays import Array
from ..errors import RecordingError

Column = str | int
"""A column by name, or by number from 1."""
Windows = tuple[tuple[int, int], ...]
"""Half-open slices of samples, in order and without overlap."""
MOST_COLUMNS = 10_000
"""Largest number of columns of a log: 100 signals of 100 joints."""
LONGEST_LINE = 1_000_000
"""Largest length (bytes) of a line: 100 bytes for each of `MOST_COLUMNS`. A longer line is binary or has lost its line ends."""

LOST_SAMPLE = (
    "; delete this row, which resample = true under [recording.time] bridges, or split the log there"
)
"""Last words of a sentence on a missing value."""


class DataFile(ABC):
    """A data file of any format.

    Attributes
    ----------
    name, sha256 : str
        Its name in messages, and its digest.
    """

    name: str
    sha256: str

    @abstractmethod
    def want(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> None:
        """Request columns before the file is read once for all; wrong names raise here."""

    @abstractmethod
    def get(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> Array:
        """Columns as (n_samples, count), in the file's unit, all finite."""

    def fail(self, text: str) -> NoReturn:
        """Raise an error that names the file."""
        raise RecordingError(f"{self.name}: {text}")
