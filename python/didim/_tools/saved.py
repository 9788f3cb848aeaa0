"""Reader of the JSON of saved results. Tested in ``tests/test_identification.py``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..errors import FitError, OutputError
from .inputs import read_file

SCHEMA = 1
"""Version of the format that this code writes and reads."""
COPIES = 4
"""Memory that parsed JSON takes, as a multiple of the file's bytes: a number of 18 digits becomes an object of 32 bytes in a
list."""


def read_saved(path: str | Path) -> dict[str, Any]:
    """Read the JSON of a result.

    Raises
    ------
    FitError
        When the file cannot be read, is not JSON, or not that of a result of this schema.
    """
    try:
        data = json.loads(read_file(Path(path), FitError, copies=COPIES).decode("utf-8-sig"))
    except (OutputError, FitError):
        raise
    except (ValueError, RecursionError) as error:  # not UTF-8, not JSON, an integer of thousands of digits
        hint = (
            "; the result (FIT.json) comes first, then the experiment" if Path(path).suffix == ".toml" else ""
        )
        raise FitError(f"{path}: not a JSON file: {error}{hint}") from None
    if not isinstance(data, dict) or "schema" not in data:
        raise FitError(f"{path}: not the result of an identification, it has no 'schema'")
    if data["schema"] != SCHEMA:
        raise FitError(f"{path}: schema {data['schema']} is not the schema {SCHEMA} that this version reads")
    return data
