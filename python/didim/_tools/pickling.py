"""Pickling of frozen dataclasses by their fields, without cached properties. Tested in ``tests/test_pickling.py``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from types import MappingProxyType
from typing import Any

import numpy as np


class Pickled:
    """Base of a frozen dataclass for `pickle` and `copy.deepcopy`.

    The state contains the fields; cached properties, such as the object of the numerical core, are computed again. Arrays and
    mappings that are read-only stay so.
    """

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields, with notes on properties that pickle does not preserve."""
        state: dict[str, Any] = {"values": {}, "read_only": [], "proxies": []}
        for attribute in fields(self):  # type: ignore[arg-type]
            value = getattr(self, attribute.name)
            if isinstance(value, MappingProxyType):
                state["proxies"].append(attribute.name)
                value = dict(value)
            if isinstance(value, np.ndarray) and not value.flags.writeable:
                state["read_only"].append(attribute.name)
            state["values"][attribute.name] = value
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the fields."""
        for name, value in state["values"].items():
            if name in state["proxies"]:
                value = MappingProxyType(value)
            if name in state["read_only"]:
                value.flags.writeable = False
            object.__setattr__(self, name, value)


def make_read_only(record: object, arrays: Iterable[str], mappings: Iterable[str] = ()) -> None:
    """Replace fields of a frozen dataclass by copies that are read-only: arrays of numbers, and mappings."""
    for key in arrays:
        values = np.array(getattr(record, key), dtype=np.float64)
        values.flags.writeable = False
        object.__setattr__(record, key, values)
    for key in mappings:
        object.__setattr__(record, key, MappingProxyType(dict(getattr(record, key))))
