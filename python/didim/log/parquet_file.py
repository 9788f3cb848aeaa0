"""Parquet files, and LeRobot datasets of version 2 and 3, which are folders of them. Needs the extra ``lerobot`` (pyarrow).

A dataset has one row per frame: ``action`` are the commanded positions, ``observation.state`` the measured ones, as lists with
an entry per motor; ``meta/info.json`` has the names of the motors. Version 2 has one file per episode, version 3 files with
several. Tested in ``tests/test_lerobot.py``.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._tools.inputs import check_expanded, read_file, read_small_file
from .._tools.plugins import optional
from ..errors import RecordingError
from .array_file import ArrayFile

INFO = Path("meta") / "info.json"
"""Path of a LeRobot dataset's description within its folder."""


class ParquetFile(ArrayFile):
    """Columns of numbers of a Parquet file by their names; a column of lists of equal length is a matrix.

    Columns of a matrix have names if a LeRobot dataset has them.
    """

    kind = "Parquet"

    def variables(self) -> list[str]:
        """Names of the columns that hold numbers, or lists of numbers."""
        arrow, parquet = self._library()
        file = parquet.ParquetFile(arrow.BufferReader(self.raw))
        groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
        check_expanded(
            sum(group.total_byte_size for group in groups), len(self.raw), self.name, RecordingError
        )
        return [field.name for field in file.schema_arrow if _is_numeric(arrow.types, field.type)]

    def array(self, name: str) -> Any:
        """Column of a name: a vector, or a matrix of lists."""
        arrow, parquet = self._library()
        column = (
            parquet.read_table(arrow.BufferReader(self.raw), columns=[name]).column(name).combine_chunks()
        )
        if column.null_count:
            raise ValueError("it has empty cells")
        # Lists of fixed length are not nested in pyarrow 15.
        if not (arrow.types.is_nested(column.type) or arrow.types.is_fixed_size_list(column.type)):
            return np.asarray(column)
        values = np.asarray(column.flatten())
        lengths = np.diff(np.asarray(column.offsets)) if hasattr(column, "offsets") else None
        if lengths is not None and len(set(lengths.tolist())) > 1:
            raise ValueError("its lists differ in length")
        return values.reshape(len(column), -1)

    def _library(self) -> tuple[Any, Any]:
        needed = "Parquet files and LeRobot datasets need the package pyarrow: pip install 'didim[lerobot]'"
        arrow, parquet = (
            optional(module, RecordingError, f"{self.name}: {needed}")
            for module in ("pyarrow", "pyarrow.parquet")
        )
        return arrow, parquet


def _is_numeric(types: Any, kind: Any) -> bool:
    if types.is_list(kind) or types.is_fixed_size_list(kind) or types.is_large_list(kind):
        kind = kind.value_type
    return bool(types.is_integer(kind) or types.is_floating(kind))


class LeRobotDataset(ArrayFile):
    """All frames of a LeRobot dataset in the order of its episodes, as one file.

    Parameters
    ----------
    parts : sequence of ParquetFile
        Its files, in order.
    labels : mapping of str to sequence of str
        Names of the motors by column.
    name : str
        Name of the folder in messages.
    digest : str
        SHA-256 of the files.
    """

    kind = "LeRobot"

    def __init__(
        self, parts: Sequence[ParquetFile], labels: Mapping[str, Sequence[str]], name: str, digest: str
    ) -> None:
        self._parts, self.labels = parts, labels
        super().__init__(b"", name)
        self.sha256 = digest

    def variables(self) -> list[str]:
        """Names of the columns that all files have."""
        return [name for name in self._parts[0].names if all(name in part.names for part in self._parts)]

    def array(self, name: str) -> Any:
        """Column of a name, file after file."""
        return np.concatenate([part.array(name) for part in self._parts])


def open_parquet(path: Path, name: str) -> ArrayFile:
    """Open a Parquet file, or the folder of a LeRobot dataset.

    Parameters
    ----------
    path : Path
        The file or folder.
    name : str
        Its name in messages.

    Raises
    ------
    RecordingError
        Without pyarrow, for files that cannot be read, and for a dataset of another version or without data.
    """
    if path.is_dir():
        info = _info(path, name)
        files = sorted((path / "data").glob("*/*.parquet"), key=_numbers)
        if not files:
            raise RecordingError(f"{name}: the dataset has no data/*/*.parquet")
        digest = hashlib.sha256()
        parts = []
        for each in files:
            raw = read_file(each, RecordingError, "no such data file", copies=2)
            digest.update(raw)
            parts.append(ParquetFile(raw, f"{name}/{each.relative_to(path).as_posix()}"))
        return LeRobotDataset(parts, _labels(info, parts[0].names), name, digest.hexdigest())
    file = ParquetFile(read_file(path, RecordingError, "no such data file", copies=2), name)
    # A file of a dataset lies in data/chunk-000.
    folder = next((above for above in path.resolve().parents[:3] if (above / INFO).is_file()), None)
    if folder is not None:
        file.labels = _labels(_info(folder, folder.name), file.names)
    return file


def _numbers(file: Path) -> list[int]:
    """Numbers in a path, by which files of a dataset are ordered."""
    return [int(number) for number in re.findall(r"\d+", f"{file.parent.name}/{file.stem}")]


def _info(folder: Path, name: str) -> Mapping[str, Any]:
    """Content of ``meta/info.json``; versions other than 2 and 3 are refused."""
    try:
        info = json.loads(read_small_file(folder / INFO, RecordingError))
    except ValueError as reason:
        raise RecordingError(f"{name}: {INFO.as_posix()} is not JSON ({reason})") from None
    version = str(info.get("codebase_version", "")) if isinstance(info, dict) else ""
    if version[:2] not in ("v2", "v3"):
        raise RecordingError(
            f"{name}: LeRobot datasets of version 2 and 3 are read, got {version or 'none'!r}"
        )
    return dict(info)


def _labels(info: Mapping[str, Any], names: Sequence[str]) -> dict[str, list[str]]:
    """Names of motors by column: a list, or a table with one."""
    features = info.get("features")
    labels: dict[str, list[str]] = {}
    for key in names:
        feature = features.get(key) if isinstance(features, dict) else None
        motors = feature.get("names") if isinstance(feature, dict) else None
        if isinstance(motors, dict):
            motors = next((value for value in motors.values() if isinstance(value, list)), None)
        if isinstance(motors, list) and len(motors) > 1:
            labels[key] = [str(motor) for motor in motors]
    return labels
