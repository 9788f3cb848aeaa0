"""Objects by name: those of a table, and others as "module:name", such as a user-defined method.

Tested in ``tests/test_plugins.py``.
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..errors import DidimError
from .words import did_you_mean, series

PLACE = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
"""Form of "module:name"."""


def named(name: str, places: Mapping[str, Any], what: str, error: type[DidimError]) -> Any:
    """Return an object by its name in a table, or as "module:name".

    Parameters
    ----------
    name : str
        Key of `places`, or "module:name".
    places : mapping
        Objects, or their location "module:name", imported on use.
    what : str
        Noun for messages, such as "method".
    error : type of DidimError
        Class of the error for an unknown name, or a module that cannot be loaded.
    """
    if name not in places and ":" not in name:
        raise error(
            f"there is no {what} '{name}'{did_you_mean(name, places)} (there are: {series(places, 40)}; "
            "or your own as module:name)"
        )
    source = places.get(name, name)
    return loaded(source, what, error) if isinstance(source, str) else source


def loaded(source: str, what: str, error: type[DidimError]) -> Any:
    """Return the object at "module:name"; the program's folder and the current folder are searched too."""
    module, _, name = source.partition(":")
    search((Path.cwd(),))
    try:
        content = import_module(module)
    except ModuleNotFoundError as reason:
        if reason.name is None or not f"{module}.".startswith(f"{reason.name}."):
            raise error(
                f"{what} '{source}': its module needs {reason.name}, which is not installed"
            ) from None
        raise error(
            f"{what} '{source}': there is no module '{module}' in Python's path, nor in this folder"
        ) from None
    except Exception as reason:
        raise error(
            f"{what} '{source}': its module cannot be loaded ({type(reason).__name__}: {reason})"
        ) from reason
    if not hasattr(content, name):
        raise error(
            f"{what} '{source}': module '{module}' has no '{name}'{did_you_mean(name, vars(content))}"
        )
    return getattr(content, name)


def optional(module: str, error: type[DidimError], needed: str) -> Any:
    """Return a module of an optional package; `needed` is the sentence of the error without it."""
    try:
        return __import__(module, fromlist=["*"])
    except ImportError:
        raise error(needed) from None


def search(folders: Iterable[Path]) -> None:
    """Make the modules of these folders importable, after all installed ones."""
    for folder in map(str, folders):
        if folder not in sys.path and Path(folder).is_dir():
            sys.path.append(folder)


def places(value: object) -> Iterator[str]:
    """Return every text of the form "module:name" anywhere in plain data."""
    if isinstance(value, str):
        if PLACE.fullmatch(value):
            yield value
    elif isinstance(value, Mapping | list):
        for inner in value.values() if isinstance(value, Mapping) else value:
            yield from places(inner)


def search_beside(content: object, path: Path) -> None:
    """Make modules beside a file importable, if its content names one as "module:name"."""
    if any(places(content)):
        search((path.resolve().parent,))


def source_digest(source: str) -> str:
    """Return the SHA-256 of the source of "module:name", or an empty text without source."""
    try:
        spec = find_spec(source.partition(":")[0])
    except (ModuleNotFoundError, ValueError):  # a missing package; a program itself
        return ""
    path = None if spec is None else spec.origin
    return hashlib.sha256(Path(path).read_bytes()).hexdigest() if path and Path(path).is_file() else ""
