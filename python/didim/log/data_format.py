"""Columns of a data file, and what a reader of a format must do. Tested in ``tests/test_recording.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from .._tools.arrays import Array

Column = str | int
"""A column by name, or by number from 1."""


class DataFile(Protocol):
    """What a recording needs of a file of any format."""

    name: str
    sha256: str

    def want(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> None:
        """Announce columns, so that one reading of the file serves all; wrong names are raised here."""

    def get(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> Array:
        """Columns as (n_samples, count), in the file's unit, all finite."""
