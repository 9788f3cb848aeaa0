"""Pickling of frozen dataclasses: their fields, and nothing that is made of them. Tested in ``tests/test_pickling.py``."""

from __future__ import annotations

from dataclasses import fields
from types import MappingProxyType
from typing import Any

import numpy as np


class Pickled:
    """Base of a frozen dataclass that `pickle` and `copy.deepcopy` take.

    The state is that of the fields: what a cached property holds, such as the object of the numerical core, is made again
    on arrival. Arrays that cannot be written stay so, and read-only mappings stay read-only.
    """

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields; what pickle does not carry is noted beside them."""
        state: dict[str, Any] = {"values": {}, "read_only": [], "proxies": []}
        for item in fields(self):  # type: ignore[arg-type]
            value = getattr(self, item.name)
            if isinstance(value, MappingProxyType):
                state["proxies"].append(item.name)
                value = dict(value)
            if isinstance(value, np.ndarray) and not value.flags.writeable:
                state["read_only"].append(item.name)
            state["values"][item.name] = value
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the fields."""
        for name, value in state["values"].items():
            if name in state["proxies"]:
                value = MappingProxyType(value)
            if name in state["read_only"]:
                value.flags.writeable = False
            object.__setattr__(self, name, value)
