"""Files of named arrays: NumPy's npz, MATLAB's mat of version 5. Tested in ``tests/test_recording.py``."""

from __future__ import annotations

import hashlib
import io
import struct
import zlib
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from math import prod
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from .._tools.arrays import Array
from .._tools.inputs import BLOCK, check_expanded, open_npz
from .._tools.words import known_names, listing
from ..errors import RecordingError
from .data_format import LOST_SAMPLE, Column, DataFile

MOST_SIGNALS = 100
"""Largest number of columns of a matrix with fewer rows than columns; with more, each column is one sample."""


class ArrayFile(DataFile):
    """A file of named arrays. A format has two methods: `variables` and `array`; `shape` where it is known without reading.

    Parameters
    ----------
    raw
        Content of the file.
    name
        Its name in messages.
    """

    kind: ClassVar[str]
    """Name of the format in messages."""
    labels: Mapping[str, Sequence[str]] = MappingProxyType({})
    """Names of a matrix's columns, where the file has them."""

    def __init__(self, raw: bytes, name: str) -> None:
        self.name = name
        self.sha256 = hashlib.sha256(raw).hexdigest()
        self.raw = raw
        self._arrays: dict[str, Array] = {}
        try:
            self.names = self.variables()
        except RecordingError:
            raise
        except Exception:  # third-party parsers may raise anything on invalid bytes
            self.fail(f"this is not a readable {self.kind} file")

    @abstractmethod
    def variables(self) -> list[str]:
        """Names of the arrays; any error means that the file has another format."""

    @abstractmethod
    def array(self, name: str) -> Any:
        """Array of one of these names, of real numbers."""

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of an array; empty for text, structures, and what cannot be read."""
        try:
            return np.shape(self.array(name))
        except Exception:  # likewise
            return ()

    def want(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> None:
        """Check the names of columns; arrays are only read in `get`."""
        for name in self._plan(columns, variable, count)[0]:
            self._check_name(name)

    def get(self, columns: Sequence[Column] | None, variable: str | None, count: int) -> Array:
        """Columns as (n_samples, count)."""
        names, numbers = self._plan(columns, variable, count)
        if variable is None and columns is not None:
            return self._stack([(name, self._vector(name)) for name in names])
        matrix = self._matrix(names[0])
        if numbers is None:
            return self._whole(names[0], matrix, count)
        for number in numbers:
            if not 1 <= number <= matrix.shape[1]:
                self.fail(f"variable {names[0]!r} has no column {number}; it has 1 to {matrix.shape[1]}")
        return matrix[:, [number - 1 for number in numbers]]

    def _plan(
        self, columns: Sequence[Column] | None, variable: str | None, count: int
    ) -> tuple[list[str], list[int] | None]:
        """Return the variables to read, and the numbers of a matrix's requested columns (None for all)."""
        if variable is None and columns is not None:
            names = [column for column in columns if isinstance(column, str)]
            if len(names) != len(columns):
                self.fail("columns by number need variable = the matrix they belong to")
            return names, None
        if variable is None:
            if len(self.names) != 1:
                self.fail(f"variable must say which array is meant; there are {listing(self.names)}")
            variable = self.names[0]
        if columns is None:
            return [variable], None
        numbers = [column for column in columns if isinstance(column, int)]
        if len(numbers) != len(columns):
            self.fail(f"columns of the matrix {variable!r} go by number, from 1")
        return [variable], numbers

    def _check_name(self, name: str) -> None:
        if name not in self.names:
            self.fail(f"there is no variable {name!r}; {known_names(name, self.names, 'variable')}")

    def _matrix(self, name: str) -> Array:
        """Read a variable as a finite matrix; a NumPy vector becomes one column."""
        if name not in self._arrays:
            self._check_name(name)
            values = self._number_array(name)
            if values.ndim == 1:
                values = values[:, np.newaxis]
            if values.ndim != 2:
                self.fail(f"variable {name!r} must be a vector or a matrix, its shape is {values.shape}")
            bad = np.argwhere(~np.isfinite(values))
            if len(bad):
                row, column = bad[0]
                where = f"row {row + 1}, column {column + 1}"
                self.fail(f"variable {name!r}, {where}, is {values[row, column]}{LOST_SAMPLE}")
            lies = samples_in_columns(values.shape)
            self._arrays[name] = np.ascontiguousarray(values.T) if lies else values
        return self._arrays[name]

    def _number_array(self, name: str) -> Array:
        try:
            values = self.array(name)
        except Exception as reason:  # likewise
            self.fail(f"variable {name!r} cannot be read ({reason})")
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
            self.fail(f"variable {name!r} is not an array of real numbers")
        return np.ascontiguousarray(values, dtype=np.float64)

    def _vector(self, name: str) -> Array:
        matrix = self._matrix(name)
        # MATLAB stores a vector as a matrix of one row or one column; both mean the same vector.
        if 1 not in matrix.shape:
            self.fail(f"variable {name!r} must be a vector, its shape is {matrix.shape}")
        return matrix.reshape(-1)

    def _whole(self, name: str, matrix: Array, count: int) -> Array:
        if count == 1 and 1 in matrix.shape:
            return matrix.reshape(-1, 1)
        if matrix.shape[1] != count:
            hint = "; transpose it?" if matrix.shape[0] == count else ""
            self.fail(f"variable {name!r} must have shape (n_samples, {count}), got {matrix.shape}{hint}")
        return matrix

    def _stack(self, vectors: list[tuple[str, Array]]) -> Array:
        first_name, first = vectors[0]
        for name, vector in vectors[1:]:
            if len(vector) != len(first):
                self.fail(
                    f"variables {first_name!r} and {name!r} differ in length: {len(first)} and {len(vector)}"
                )
        return np.column_stack([vector for _, vector in vectors])


def samples_in_columns(shape: tuple[int, ...]) -> bool:
    """Whether a matrix has a sample in each column, as some programs of MATLAB write them (a vector is left as it is)."""
    return len(shape) == 2 and 1 < shape[0] < shape[1] and shape[1] > MOST_SIGNALS


MAT_NUMBERS = frozenset(
    ("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
)
"""Classes of MATLAB's arrays of numbers."""


class NpzFile(ArrayFile):
    """NumPy's npz."""

    kind = "npz"

    def variables(self) -> list[str]:
        """Names of the arrays."""
        # It stays open: reading the table of entries again for each of thousands would take minutes.
        self._archive = open_npz(self.raw, self.name, RecordingError)
        return list(self._archive.files)

    def array(self, name: str) -> Any:
        """Array of a name."""
        return self._archive[name]


class MatFile(ArrayFile):
    """MATLAB's mat of version 5."""

    kind = "MATLAB version 5"

    def variables(self) -> list[str]:
        """Return the names of the variables and of a structure's fields, in MATLAB's notation ``rec.position``."""
        from scipy.io import whosmat

        order = {b"IM": "<", b"MI": ">"}.get(self.raw[126:MAT_HEADER])
        at, size = MAT_HEADER, 0
        while order is not None and at + 8 <= len(self.raw):
            kind, count = struct.unpack(f"{order}II", self.raw[at : at + 8])
            at += 8
            if kind == MAT_COMPRESSED:
                inflate = zlib.decompressobj()
                waiting = self.raw[at : at + count]
                while waiting and not inflate.eof:
                    size += len(inflate.decompress(waiting, BLOCK))
                    waiting = inflate.unconsumed_tail
            at += count
        check_expanded(size, len(self.raw), self.name, RecordingError)
        # Any, because scipy-stubs only accept paths; the bytes avoid a second read of the file.
        stream: Any = io.BytesIO(self.raw)
        try:
            entries: list[Any] = list(whosmat(stream))
        except TypeError:  # an object of a MATLAB class is among the variables
            every = [(name, value) for name, value in self._loaded().items() if not name.startswith("__")]
            entries = [
                (name, np.shape(value), "struct" if _subfields(value) else "double") for name, value in every
            ]
        # Integers may take one byte each. The shape of a sparse matrix exceeds its content.
        size = sum(8 * prod(shape) for _, shape, kind in entries if kind != "sparse")
        check_expanded(size, len(self.raw), self.name, RecordingError)
        structures = [str(name) for name, _, kind in entries if kind == "struct" and name]
        loaded = self._loaded(structures) if structures else {}
        self._structures = {name: loaded[name] for name in structures}
        self._shapes = {str(name): tuple(shape) for name, shape, kind in entries if kind in MAT_NUMBERS}
        return [
            field
            for entry in entries
            for field in _fields(str(entry[0]), self._structures.get(str(entry[0])))
        ]

    def array(self, name: str) -> Any:
        """Return the variable of a name, or a field of a structure."""
        first, _, rest = name.partition(".")
        if first not in self._structures:
            return self._loaded([name])[name]
        value = self._structures[first]
        for field in rest.split(".") if rest else ():
            value = value[field].flat[0]
        return value

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of a variable, as the file declares it, or of a structure's field."""
        return (
            super().shape(name) if name.partition(".")[0] in self._structures else self._shapes.get(name, ())
        )

    def _loaded(self, names: list[str] | None = None) -> dict[str, Any]:
        from scipy.io import loadmat

        stream: Any = io.BytesIO(self.raw)
        return dict(loadmat(stream, variable_names=names))


def _subfields(value: Any) -> tuple[str, ...] | None:
    """Return the names of a structure's fields; None for other values."""
    return getattr(getattr(value, "dtype", None), "names", None)


def _fields(name: str, value: Any) -> list[str]:
    """Names of the arrays of a structure of one element, or the name itself."""
    fields = _subfields(value)
    if not fields or value.size != 1:
        return [name]
    return [leaf for field in fields for leaf in _fields(f"{name}.{field}", value[field].flat[0])]


MAT_HEADER, MAT_COMPRESSED = 128, 15
"""Bytes before the first element of a mat file of version 5, and the type of an element that is compressed."""
