"""Tables of experiment files without a file, and declarations of keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from didim._tools.keys import Key, declared
from didim._tools.toml import Table
from didim.errors import ExperimentError


def experiment_table(path: str, content: Mapping[str, Any], file: str = "log.toml") -> Table:
    """Return the table at a path of an experiment file."""
    return Table(content, file, ExperimentError, path, declared("experiment", path))


def row(name: str, type: str, **more: Any) -> Key:
    """Return the declaration of a key."""
    return Key(name=name, type=type, meaning="A key.", **more)
