"""HDF5: MATLAB's mat of version 7.3, and plain files. Needs the extra ``hdf5`` (h5py). Tested in ``tests/test_containers.py``."""

from __future__ import annotations

import io
from math import prod
from typing import Any

import numpy as np

from .._tools.inputs import check_expanded
from .._tools.plugins import optional
from ..errors import RecordingError
from .array_file import ArrayFile, MatFile


class Hdf5File(ArrayFile):
    """Numeric datasets of an HDF5 file by their paths, such as ``run/q``."""

    kind = "HDF5"

    def variables(self) -> list[str]:
        """Paths of the numeric datasets."""
        h5py = self._library()
        names: list[str] = []
        sizes: list[int] = []

        def visit(name: str, node: Any) -> None:
            # Names that begin with # are MATLAB's internal tables.
            if isinstance(node, h5py.Dataset) and node.dtype.kind in "fiu" and not name.startswith("#"):
                names.append(name)
                sizes.append(8 * prod(node.shape or ()))

        with h5py.File(io.BytesIO(self.raw), "r") as file:
            file.visititems(visit)
        check_expanded(sum(sizes), len(self.raw), self.name, RecordingError)
        return names

    def array(self, name: str) -> Any:
        """Dataset of a path."""
        with self._library().File(io.BytesIO(self.raw), "r") as file:
            node = file[name]
            if node.external or node.is_virtual:  # any file, a device too
                raise ValueError("its numbers are in other files")
            return np.array(node)

    def _library(self) -> Any:
        needed = "HDF5 and MATLAB 7.3 files need the package h5py: pip install 'didim[hdf5]', or save with '-v7' in MATLAB"
        return optional("h5py", RecordingError, f"{self.name}: {needed}")


class Mat73File(Hdf5File):
    """MATLAB's mat of version 7.3: HDF5 with arrays in column-major order."""

    kind = "MATLAB version 7.3"

    def array(self, name: str) -> Any:
        """Variable of a name, with rows as in MATLAB."""
        return super().array(name).T


def mat_file(raw: bytes, name: str) -> ArrayFile:
    """Open a .mat file of either version."""
    newer = b"MATLAB 7.3" in raw[:128] or raw.startswith(b"\x89HDF")
    return Mat73File(raw, name) if newer else MatFile(raw, name)
