"""Where a long search stands, in a file: written as it goes on, read to go on from.

A digest of the whole content seals it: a file that is not as it was written is no checkpoint.

Tested in ``tests/test_cloe.py``.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import FitError
from .files import write_atomically
from .identification import Iteration

Array = NDArray[np.float64]


def save(
    path: Path,
    problem: str,
    arrays: Mapping[str, Array],
    numbers: Mapping[str, Any],
    history: Sequence[Iteration],
) -> None:
    """Write a checkpoint; the one before is replaced only once this one is whole.

    Parameters
    ----------
    path : Path
        An ``.npz`` file.
    problem : str
        Digest of the problem that it belongs to.
    arrays, numbers : mapping
        The state of the search.
    history : sequence of Iteration
        So far.
    """
    told = [{**asdict(item), "more": dict(item.more)} for item in history]
    record = json.dumps({"problem": problem, "numbers": dict(numbers), "history": told})
    buffer = io.BytesIO()
    named: dict[str, Any] = {f"array_{name}": value for name, value in arrays.items()}
    np.savez(buffer, record=np.array(record), seal=np.array(_seal(record, named)), **named)
    write_atomically(path, buffer.getvalue())


def load(path: Path, problem: str) -> tuple[dict[str, Array], dict[str, Any], list[Iteration]] | None:
    """Read a checkpoint; None where there is none yet.

    Raises
    ------
    FitError
        For a file that is no checkpoint, or one of another problem.
    """
    if not path.exists():
        return None
    try:
        # From memory: NumPy leaves a file open that is no archive.
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as data:
            named = {key: data[key] for key in data.files}
        text, seal = str(named.pop("record")), str(named.pop("seal"))
    except Exception as reason:  # whatever the reader of archives stumbles over in bytes of another kind
        raise FitError(f"{path}: this is no checkpoint of a search ({reason})") from None
    if seal != _seal(text, named):
        raise FitError(f"{path}: this checkpoint is damaged; take it away, or name another file")
    record = json.loads(text)
    owner, numbers, told = record["problem"], record["numbers"], record["history"]
    arrays = {key.removeprefix("array_"): values for key, values in named.items()}
    if owner != problem:
        raise FitError(
            f"{path}: this checkpoint belongs to another search (log, robot, controller, start or settings differ); "
            "take it away, or name another file"
        )
    return arrays, numbers, [Iteration(**item) for item in told]


def _seal(record: str, arrays: Mapping[str, Any]) -> str:
    """Digest of everything that a checkpoint holds."""
    digest = hashlib.sha256(record.encode())
    for name, values in sorted(arrays.items()):
        digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
