"""PyTorch's ``.pt`` files, without PyTorch and without running code of the file. Tested in ``tests/test_torch_file.py``.

A file is a zip of raw arrays, the storages, and a pickle that describes the tensors in them. The pickle is read by an
interpreter that accepts only dictionaries, lists, numbers, texts and tensors.
"""

from __future__ import annotations

import io
import pickle
import zipfile
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from .array_file import ArrayFile

STORAGES = {
    "DoubleStorage": "f8",
    "FloatStorage": "f4",
    "HalfStorage": "f2",
    "LongStorage": "i8",
    "IntStorage": "i4",
    "ShortStorage": "i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
}
"""NumPy type of each torch storage whose numbers can be signals."""
LARGEST_PICKLE = 10_000_000
"""Largest description of tensors (bytes) that is read: it has some hundred bytes per tensor."""


@dataclass(frozen=True)
class _Storage:
    """Storage of tensors: member of the archive, type and count of its numbers."""

    member: str
    dtype: str
    count: int


@dataclass(frozen=True)
class _Tensor:
    """Layout of a tensor in its storage, in elements."""

    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    stride: tuple[int, ...]


class TorchFile(ArrayFile):
    """Tensors of a PyTorch file by their keys; those of nested dictionaries by paths, such as ``run/q``."""

    kind = "PyTorch"

    def variables(self) -> list[str]:
        """Return the keys of the tensors.

        Raises
        ------
        RecordingError
            For files of PyTorch before 1.6, which are not archives, and for files with other content than tensors, numbers and
            texts.
        """
        if not zipfile.is_zipfile(io.BytesIO(self.raw)):
            self.fail("PyTorch files before version 1.6 are not read; load it there and save it again")
        with zipfile.ZipFile(io.BytesIO(self.raw)) as archive:
            described = [name for name in archive.namelist() if name.endswith("/data.pkl")]
            if len(described) != 1:
                self.fail("this is not a PyTorch file of tensors: it has no data.pkl")
            self._root = described[0].removesuffix("/data.pkl")
            order = self._member(archive, f"{self._root}/byteorder", b"little")
            self._big = order == b"big"
            description = self._member(archive, described[0])
        if len(description) > LARGEST_PICKLE:
            self.fail(f"its description of tensors has more than {LARGEST_PICKLE:,} bytes")
        try:
            content = _Reader(io.BytesIO(description)).load()
        except _UnknownNameError as reason:
            self.fail(f"it has {reason}, which is not read; save a dictionary of tensors")
        self._tensors: dict[str, _Tensor] = {}
        self._collect(content, "")
        if not self._tensors:
            self.fail("there is no tensor in this file; save a dictionary of tensors")
        return list(self._tensors)

    def array(self, name: str) -> Any:
        """Return the tensor of a key."""
        tensor = self._tensors[name]
        dtype = np.dtype(tensor.storage.dtype).newbyteorder(">" if self._big else "<")
        with zipfile.ZipFile(io.BytesIO(self.raw)) as archive:
            raw = self._member(archive, f"{self._root}/data/{tensor.storage.member}")
        values = np.frombuffer(raw, dtype)
        last = tensor.offset + sum(
            (length - 1) * step for length, step in zip(tensor.shape, tensor.stride, strict=True)
        )
        size = int(np.prod(tensor.shape, dtype=object))
        inside = size > 0 and tensor.offset >= 0 and min(tensor.stride, default=0) >= 0 and last < values.size
        if not inside or size > values.size:
            self.fail(f"variable {name!r} does not lie in the numbers of the file; it is damaged")
        strides = tuple(step * dtype.itemsize for step in tensor.stride)
        view = np.lib.stride_tricks.as_strided(values[tensor.offset :], tensor.shape, strides)
        return np.array(view, dtype=dtype.newbyteorder("="))

    def _member(self, archive: zipfile.ZipFile, name: str, default: bytes | None = None) -> bytes:
        """Return a member of the archive; PyTorch does not compress, so none is larger than the file."""
        try:
            entry = archive.getinfo(name)
        except KeyError:
            if default is not None:
                return default
            self.fail(f"its member {name!r} is missing; the file is damaged")
        if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > len(self.raw):
            self.fail(f"its member {name!r} is compressed, as PyTorch does not write it")
        return archive.read(name)

    def _collect(self, content: object, path: str) -> None:
        if isinstance(content, _Tensor):
            self._tensors[path or "tensor"] = content
        elif isinstance(content, dict | list | tuple):
            for key, value in content.items() if isinstance(content, dict) else enumerate(content):
                self._collect(value, f"{path}/{key}" if path else str(key))


class _UnknownNameError(Exception):
    """A name in the pickle that is neither a tensor nor a dictionary."""


class _Reader(pickle.Unpickler):
    """Unpickler of a PyTorch file; it refuses all names except those of tensors before it looks them up."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if (module, name) == ("collections", "OrderedDict"):
            return _dictionary
        if module in ("torch", "torch.storage") and name in STORAGES:
            return STORAGES[name]
        raise _UnknownNameError(f"{module}.{name}")

    def persistent_load(self, pid: Any) -> _Storage:
        kind, dtype, member, _, count = pid
        if kind != "storage" or dtype not in STORAGES.values():
            _refuse()
        return _Storage(str(member), dtype, int(count))


def _tensor(
    storage: object, offset: int, shape: tuple[int, ...], stride: tuple[int, ...], *_: object
) -> _Tensor:
    if not isinstance(storage, _Storage) or len(shape) != len(stride):
        _refuse()
    return _Tensor(storage, int(offset), tuple(map(int, shape)), tuple(map(int, stride)))


def _dictionary(*pairs: object) -> dict[Any, Any]:
    """Return an empty dictionary for the pickle to fill; PyTorch writes the hooks of tensors as one."""
    if pairs:
        _refuse()
    return {}


def _refuse() -> NoReturn:
    raise _UnknownNameError("a tensor in a form of its own")
