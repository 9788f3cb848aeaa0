"""Data files: one reader per suffix, with a common interface for recordings.

A file is opened once; all columns are requested first, then it is read once. Tested in ``tests/test_recording.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from .._tools.inputs import read_file
from .._tools.plugins import loaded
from ..errors import RecordingError
from .csv_file import CsvFile
from .data_format import DataFile

Reader = Callable[[bytes, str], DataFile]
"""Makes a `DataFile` of the content of a file, and its name in messages."""

TEXT = (".csv", ".txt", ".tsv", ".dat")
"""Suffixes of text files with one sample a line."""
READERS: dict[str, str | Reader] = {
    ".npz": "didim.log.array_file:NpzFile",
    ".mat": "didim.log.hdf5_file:mat_file",
    ".h5": "didim.log.hdf5_file:Hdf5File",
    ".hdf5": "didim.log.hdf5_file:Hdf5File",
    ".pt": "didim.log.torch_file:TorchFile",
    ".pth": "didim.log.torch_file:TorchFile",
    ".json": "didim.log.bam_file:BamFile",
}
"""Readers of the other formats by suffix, or their location "module:name", imported when such a file is opened."""


BAGS = (".mcap", ".db3", ".bag")
"""Suffixes of ROS bags; a folder can be one too. They have no reader of bytes, because they are not read as a whole."""

PARQUET = ".parquet"
"""Suffix of Parquet files; a LeRobot dataset is a folder with several and their description."""


def is_log(path: Path) -> bool:
    """Whether a path has the suffix of a data file, or is the folder of a bag or of a dataset."""
    return path.suffix.lower() in (*TEXT, *READERS, *BAGS, PARQUET) or _is_bag(path) or _is_dataset(path)


def _is_bag(path: Path) -> bool:
    return path.suffix.lower() in BAGS or (path / "metadata.yaml").is_file()


def _is_dataset(path: Path) -> bool:
    return (path / "meta" / "info.json").is_file()


def open_data_file(
    path: Path,
    name: str,
    *,
    delimiter: str | None,
    header: bool | None,
    topic: str | None = None,
    decimal: str | None = None,
) -> DataFile:
    """Open a data file by its suffix.

    Parameters
    ----------
    path
        The file.
    name
        Its name in messages and digests.
    topic
        Topic of a ROS bag. Not for the other formats.
    delimiter, header
        Of a CSV file: separator (a comma by default; a blank stands for any white space), and whether the
        first line holds names (detected by default). Not for the other formats.
    decimal
        Of a CSV file: its decimal sign, a point by default, or a comma.

    Raises
    ------
    RecordingError
        When the file is missing, empty, or of an unknown format.
    """
    bag = _is_bag(path)
    if topic is not None and not bag:
        raise RecordingError(f"{name}: topic is for ROS bags only")
    text = any(option is not None for option in (delimiter, header, decimal))
    if text and path.suffix.lower() not in TEXT and path.exists():
        raise RecordingError(f"{name}: delimiter, header and decimal are for CSV files only")
    if path.suffix.lower() == ".mcap" and path.is_file():
        from .mcap_file import has_json, open_mcap_json

        if has_json(path):
            return open_mcap_json(path, name, topic)
    if bag and path.exists():
        from .ros_bag import RosBag

        return RosBag(path, name, topic)
    if path.suffix.lower() == PARQUET or _is_dataset(path):
        from .parquet_file import open_parquet

        return open_parquet(path, name)
    raw = read_file(path, RecordingError, "no such data file", copies=2)
    if not raw or raw.isspace():
        raise RecordingError(f"{name}: the file is empty")
    suffix = path.suffix.lower()
    if suffix in TEXT:
        return CsvFile(raw, name, "," if delimiter is None else delimiter, header, decimal or ".")
    if suffix not in READERS:
        known = " ".join((*TEXT, *READERS, PARQUET, *BAGS))
        raise RecordingError(f"{name}: the format {suffix!r} is unknown; known are {known}")
    reader = READERS[suffix]
    make: Reader = loaded(reader, "reader", RecordingError) if isinstance(reader, str) else reader
    return make(raw, name)
