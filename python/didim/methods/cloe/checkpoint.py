"""Checkpoint file of a long search, from which it can be resumed.

A digest of the content protects it: a modified file is refused.

Tested in ``tests/test_cloe.py``.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..._tools.arrays import Array
from ..._tools.files import write_atomically
from ..._tools.inputs import open_npz
from ..._tools.words import counted
from ...errors import FitError
from ...result.iteration import Iteration


@dataclass(frozen=True)
class Checkpoint:
    """The file of one search.

    Attributes
    ----------
    path : Path or None
        An ``.npz`` file; None for a search without checkpoints.
    problem : str
        Digest of its problem.
    """

    path: Path | None
    problem: str
    failures: list[str] = field(default_factory=list)
    """Reasons for which the file could not be written: the search goes on without it."""

    def save(
        self, arrays: Mapping[str, Array], numbers: Mapping[str, Any], history: Sequence[Iteration]
    ) -> None:
        """Write the state of the search atomically.

        Parameters
        ----------
        arrays, numbers : mapping
            The state of the search.
        history : sequence of Iteration
            Iterations so far.
        """
        if self.path is None:
            return
        records = [{**asdict(iteration), "more": dict(iteration.more)} for iteration in history]
        record = json.dumps({"problem": self.problem, "numbers": dict(numbers), "history": records})
        buffer = io.BytesIO()
        named: dict[str, Any] = {f"array_{name}": value for name, value in arrays.items()}
        np.savez(buffer, record=np.array(record), seal=np.array(_seal(record, named)), **named)
        try:
            write_atomically(self.path, buffer.getvalue())
        except OSError as error:
            self.failures.append(error.strerror or str(error))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return the sentence on states that could not be saved."""
        if not self.failures:
            return ()
        return (
            f"the checkpoint '{self.path}' could not be written {counted(len(self.failures), 'time')} ({self.failures[-1]}): the "
            "search went on without it",
        )

    def load(self) -> tuple[dict[str, Array], dict[str, Any], list[Iteration]] | None:
        """Read arrays, numbers and history; None without a file.

        Raises
        ------
        FitError
            For a file that is not a checkpoint, or belongs to another problem.
        """
        path = self.path
        if path is None or not path.exists():
            return None
        if not path.is_file():  # a device may be endless
            raise FitError(f"{path}: a checkpoint must be a file")
        try:
            # From memory: NumPy does not close files that are not archives.
            with open_npz(path.read_bytes(), str(path), FitError) as data:
                named = {key: data[key] for key in data.files}
            text, seal = str(named.pop("record")), str(named.pop("seal"))
        except FitError:
            raise
        except Exception as reason:  # any error of the archive reader on invalid bytes
            raise FitError(f"{path}: this is not a checkpoint of a search ({reason})") from None
        if seal != _seal(text, named):
            raise FitError(f"{path}: this checkpoint is damaged; take it away, or name another file")
        record = json.loads(text)
        if record["problem"] != self.problem:
            raise FitError(
                f"{path}: this checkpoint belongs to another search (log, robot, controller, start or settings differ); "
                "take it away, or name another file"
            )
        arrays = {key.removeprefix("array_"): values for key, values in named.items()}
        return (
            arrays,
            record["numbers"],
            [Iteration(**record_of_iteration) for record_of_iteration in record["history"]],
        )


def _seal(record: str, arrays: Mapping[str, Any]) -> str:
    """Return the digest of the content of a checkpoint."""
    digest = hashlib.sha256(record.encode())
    for name, values in sorted(arrays.items()):
        digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
