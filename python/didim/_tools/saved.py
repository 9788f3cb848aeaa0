"""JSON of results: records as plain data and back, and files. Tested in ``tests/test_identification.py``."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from ..errors import FitError
from .files import write_atomically
from .inputs import read_file

UNBOUNDED = MappingProxyType({"none": math.inf})
"""Metadata of a field whose missing numbers in JSON are infinite; those of other fields are NaN."""

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
    raw = read_file(Path(path), FitError, copies=COPIES)
    try:
        data = json.loads(raw.decode("utf-8-sig"))
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


def plain(value: Any) -> Any:
    """Return a value as JSON data: records by field, arrays and tuples as lists, numbers that are not finite as None."""
    if isinstance(value, Mapping):
        return {key: plain(element) for key, element in value.items()}
    if isinstance(value, list | tuple):
        return [plain(element) for element in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if is_dataclass(value):
        return {element.name: plain(getattr(value, element.name)) for element in fields(value)}
    return value


def rows(**columns: Iterable[Any]) -> list[dict[str, Any]]:
    """Return columns of equal length as JSON data, one mapping per row."""
    return [plain(dict(zip(columns, values, strict=True))) for values in zip(*columns.values(), strict=True)]


_hints = cache(get_type_hints)


def restored(kind: Any, data: Any, none: float = math.nan) -> Any:
    """Return the value of a type from the data that `plain` has made of it; `none` stands for missing numbers.

    Raises
    ------
    KeyError, AttributeError, TypeError, ValueError, OverflowError
        For data of another structure.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    # From NumPy 2.5 on, `NDArray` is an alias in the sense of PEP 695, whose value is the array type.
    while (value := getattr(origin, "__value__", None)) is not None:
        origin = get_origin(value)
    if origin is UnionType:
        inner = [element for element in arguments if element is not type(None)]
        return data if data is None or len(inner) > 1 else restored(inner[0], data, none)
    if kind is float:
        return none if data is None else float(data)
    if origin is np.ndarray:
        array = np.array(data, dtype=np.float64)
        return np.where(np.isnan(array), none, array)
    if origin is tuple:
        kinds = arguments[:1] * len(data) if arguments[-1] is Ellipsis else arguments
        return tuple(restored(element, value, none) for element, value in zip(kinds, data, strict=True))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {key: restored(arguments[1], value, none) for key, value in data.items()}
    if isinstance(kind, type) and is_dataclass(kind):
        if isinstance(data, kind):
            return data
        hints = _hints(kind)
        bounds = {element.name: element.metadata.get("none", math.nan) for element in fields(kind)}
        return kind(**{key: restored(hints[key], value, bounds[key]) for key, value in data.items()})
    if kind in (int, str) and not isinstance(data, kind):
        raise TypeError(f"{data!r} is not {'a text' if kind is str else 'an integer'}")
    return data


def save_json(path: str | Path, content: object, sources: Iterable[str] = ()) -> None:
    """Write JSON, whole or not at all, unless the file is one of `sources`, given by their SHA-256.

    Raises
    ------
    OutputError
        When the file is one that the content was computed from (``test_outputs.py``).
    OSError
        When the file cannot be written.
    """
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    write_atomically(Path(path), text + "\n", sources)


def save_npz(path: str | Path, arrays: Mapping[str, Any], sources: Iterable[str] = ()) -> None:
    """Write arrays as NumPy's ``.npz``; whole or not at all, and errors, as of `save_json`."""
    content = io.BytesIO()
    np.savez(content, **arrays)
    write_atomically(Path(path), content.getvalue(), sources)
