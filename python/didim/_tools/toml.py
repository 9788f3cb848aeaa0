"""Strict reading of TOML tables: readers request keys with their types, and any other key is an error.

The messages are one sentence that names the file, the table and the key, as in
``emps.toml: [signal] unknown key 'cutof_hz'; did you mean 'cutoff_hz'?`` (``tests/test_schema.py``).
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from ..errors import DidimError
from .inputs import read_small_file
from .words import brief, counted, did_you_mean, listing, nearest

MISSING: Any = object()
"""Default of a mandatory key."""

LARGEST_INTEGER = 2**63 - 1
"""Largest integer that TOML guarantees."""

DEEPEST_KEY = 100
"""Largest number of dots in a key. Memory grows with its square: 50 000 dots take 3 GB."""
_PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')"""
DEEP_KEY = re.compile(rf"""(?<![\w'"-]){_PART}(?:[ \t]*\.[ \t]*{_PART}){{{DEEPEST_KEY + 1}}}""")

_Default = TypeVar("_Default")


@dataclass(frozen=True)
class Key:
    """Declaration of a key, for `Table.given`, the reference pages and the JSON schema.

    Attributes
    ----------
    name : str
        Key; its unit is the end of its name.
    kind : {"number", "integer", "text", "true or false", "list of numbers", "list of texts"}
        Type of the value.
    meaning : str
        One sentence.
    example
        A value, for the reference page.
    choices : tuple of str
        Allowed texts.
    minimum, maximum, above : int, float or None
        Bounds of a number.
    """

    name: str
    kind: str
    meaning: str = ""
    example: Any = None
    choices: tuple[str, ...] = ()
    minimum: Any = None
    maximum: Any = None
    above: Any = None


@dataclass(frozen=True, kw_only=True)
class Asked(Key):
    """A key requested by a reader: an entry of the schema of a file.

    Attributes
    ----------
    where, path : str
        File and table.
    default
        Value without the key, or `MISSING`.
    """

    where: str
    path: str
    default: Any = MISSING


_LISTENER: ContextVar[list[Asked] | None] = ContextVar("listener", default=None)


@contextmanager
def asked_keys() -> Iterator[list[Asked]]:
    """Collect all keys requested by readers, in order, for the reference pages."""
    found: list[Asked] = []
    token = _LISTENER.set(found)
    try:
        yield found
    finally:
        _LISTENER.reset(token)


def read_toml(path: Path, error: type[DidimError]) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    path
        The file.
    error
        Class of the error to raise.

    Raises
    ------
    DidimError
        Of class `error`, when the file is missing, unreadable, or not TOML (with its line and column).
    """
    raw = read_small_file(path, error, f"no such file{_near(path)}")
    try:
        # Some Windows editors begin a file with a byte-order mark, which TOML does not allow.
        content = raw.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as reason:
        text = f"not a TOML file, byte {reason.start} is not UTF-8"
    else:
        if DEEP_KEY.search(content):
            raise error(
                f"{path.name}: a key has more than {DEEPEST_KEY} dots, and no key of didim has more than ten"
            )
        try:
            return tomllib.loads(content)
        except (
            ValueError,
            RecursionError,
        ) as reason:  # an integer of thousands of digits, deeply nested brackets
            text = f"not valid TOML, {reason}"
    hint = "" if path.suffix == ".toml" else "; a file of this kind ends in .toml"
    raise error(f"{path.name}: {text}{hint}")


def _near(path: Path) -> str:
    """Return the end of the sentence on a missing file that exists with the suffix .toml."""
    name = f"{path.name}.toml"
    return f"; did you mean {name!r}?" if path.name and path.with_name(name).is_file() else ""


def quoted(value: object) -> str:
    """Return a text or a list as TOML: like JSON, except for DEL, which TOML escapes."""
    text = json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    try:
        text.encode()
    except UnicodeEncodeError:
        raise DidimError(f"{value!a} is not UTF-8, and a TOML file cannot name it: rename it") from None
    return text


class Table:
    """Strict reader of one TOML table.

    Parameters
    ----------
    mapping
        The table as parsed by `tomllib`.
    where
        File name, the prefix of each message.
    error
        Class of the errors raised.
    path
        Dotted name of the table inside the file; empty for the file itself.
    """

    def __init__(
        self, mapping: Mapping[str, Any], where: str, error: type[DidimError], path: str = ""
    ) -> None:
        self._mapping = mapping
        self._asked: dict[str, None] = {}
        self._where = where
        self._error = error
        self._path = path

    def fail(self, text: str) -> NoReturn:
        """Raise this table's error, with file and table as prefix."""
        raise self._error(f"{self.prefix} {text}")

    def _note(self, key: str, kind: str, default: Any, **bounds: Any) -> None:
        """Tell who listens that a key is asked for."""
        listener = _LISTENER.get()
        if listener is not None:
            listener.append(
                Asked(name=key, kind=kind, where=self._where, path=self._path, default=default, **bounds)
            )

    @property
    def prefix(self) -> str:
        """File and table, as messages open: ``emps.toml: [signal]``."""
        return f"{self._where}: [{self._path}]" if self._path else f"{self._where}:"

    def has(self, key: str) -> bool:
        """Whether the table holds `key`; counts as asking for it."""
        self._note(key, "", None)
        self._asked[key] = None
        return key in self._mapping

    def raw(self, key: str, default: object = MISSING, kind: str | None = None) -> Any:
        """Value as `tomllib` gives it; `kind` says in words what it may be, where no other method does."""
        if kind is not None:
            self._note(key, kind, default)
        self._asked[key] = None
        if key in self._mapping:
            return self._mapping[key]
        if default is MISSING:
            # A misspelt key is both missing and unknown: say the second, which is the cure.
            near = nearest(key, self._unknown())
            self.fail(f"key {key!r} is missing" + (f"; is {near!r} meant to be it?" if near else ""))
        return default

    def _read(self, key: str, kind: str, default: object, **bounds: Any) -> Any:
        """Return the value of a key as `tomllib` gives it, `MISSING` in the place of its default."""
        self._note(key, kind, default, **bounds)
        self.raw(key, default)
        return self._mapping.get(key, MISSING)

    def given(self, keys: Sequence[Key]) -> dict[str, Any]:
        """Return the values of declared keys that the table holds: settings keep the one place of their defaults."""
        for key in keys:
            said = {name: value for name, value in vars(key).items() if name not in ("name", "kind")}
            self._note(key.name, key.kind, None, **said)
            self._asked[key.name] = None
        return {key.name: self._declared(key) for key in keys if key.name in self._mapping}

    def _declared(self, key: Key) -> Any:
        match key.kind:
            case "number":
                return self.number(key.name, MISSING, key.minimum, key.maximum, key.above)
            case "integer":
                return self.integer(key.name, MISSING, key.minimum, key.maximum)
            case "text":
                return self.text(key.name, choices=key.choices or None)
        others: dict[str, Callable[[str], Any]] = {
            "true or false": self.boolean,
            "list of numbers": self.numbers,
            "list of texts": self.texts,
        }
        return others[key.kind](key.name)

    def number(
        self,
        key: str,
        default: _Default = MISSING,
        minimum: float | None = None,
        maximum: float | None = None,
        above: float | None = None,
    ) -> float | _Default:
        """Finite number within `minimum` <= value <= `maximum`, and value > `above`."""
        value = self._read(key, "number", default, minimum=minimum, maximum=maximum, above=above)
        if value is MISSING:
            return default
        number = self._finite(key, value)
        self._check_range(key, number, minimum, maximum, above)
        return number

    def integer(
        self,
        key: str,
        default: _Default = MISSING,
        minimum: int | None = None,
        maximum: int | None = None,
    ) -> int | _Default:
        """Integer within `minimum` <= value <= `maximum`; 3.0 is not one."""
        value = self._read(key, "integer", default, minimum=minimum, maximum=maximum)
        if value is MISSING:
            return default
        if isinstance(value, bool) or not isinstance(value, int):
            self.fail(f"{key} must be an integer, got {brief(repr(value))}")
        if abs(value) > LARGEST_INTEGER:
            self.fail(f"{key} must be an integer of at most {LARGEST_INTEGER}, got {brief(str(value))}")
        self._check_range(key, value, minimum, maximum, None)
        return value

    def text(
        self, key: str, default: _Default = MISSING, choices: Sequence[str] | None = None
    ) -> str | _Default:
        """Text, one of `choices` when they are given."""
        value = self._read(key, "text", default, choices=tuple(choices or ()))
        if value is MISSING:
            return default
        if not isinstance(value, str):
            self.fail(f"{key} must be a text, got {brief(repr(value))}")
        if choices is not None and value not in choices:
            self.fail(
                f"{key} must be one of {listing(choices)}, got {brief(repr(value))}{did_you_mean(value, choices)}"
            )
        return value

    def boolean(self, key: str, default: _Default = MISSING) -> bool | _Default:
        """Truth value, ``true`` or ``false``."""
        value = self._read(key, "true or false", default)
        if value is MISSING:
            return default
        if not isinstance(value, bool):
            self.fail(f"{key} must be true or false, got {brief(repr(value))}")
        return value

    def numbers(
        self, key: str, length: int | None = None, default: _Default = MISSING
    ) -> list[float] | _Default:
        """List of finite numbers, of the given length when there is one."""
        value = self._read(key, "list of numbers", default)
        if value is MISSING:
            return default
        return self._number_list(key, value, length)

    def spread(self, key: str, length: int, default: _Default = MISSING) -> list[float] | _Default:
        """List of `length` numbers, or one number that stands for all of them."""
        value = self._read(key, "number, or list of numbers", default)
        if value is MISSING:
            return default
        if isinstance(value, list):
            return self._number_list(key, value, length)
        return [self._finite(key, value)] * length

    def texts(self, key: str, default: _Default = MISSING) -> list[str] | _Default:
        """List of texts."""
        value = self._read(key, "list of texts", default)
        if value is MISSING:
            return default
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self.fail(f"{key} must be a list of texts, got {brief(repr(value))}")
        return list(value)

    def matrix(
        self, key: str, rows: int, columns: int, default: _Default = MISSING
    ) -> list[list[float]] | _Default:
        """Matrix as a list of rows."""
        value = self._read(key, "matrix, row by row", default)
        if value is MISSING:
            return default
        if not isinstance(value, list) or len(value) != rows:
            got = counted(len(value), "row") if isinstance(value, list) else repr(value)
            shape = f"{counted(rows, 'row')} and {counted(columns, 'column')}"
            self.fail(f"{key} must be a matrix of {shape}, got {got}")
        return [self._number_list(f"{key}, row {i + 1},", row, columns) for i, row in enumerate(value)]

    def table(self, key: str, default: _Default = MISSING) -> Table | _Default:
        """Sub-table ``[key]``."""
        value = self._read(key, "table", default)
        if value is MISSING:
            return default
        if not isinstance(value, dict):
            self.fail(f"{key} must be a table, got {brief(repr(value))}")
        return self._child(value, key)

    def tables(self, key: str, default: _Default = MISSING) -> list[Table] | _Default:
        """Return an array of tables ``[[key]]``; several are named by their index."""
        value = self._read(key, "array of tables", default)
        if value is MISSING:
            return default
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            self.fail(f"{key} must be an array of tables, [[{key}]]")
        return [
            self._child(item, key if len(value) == 1 else f"{key} {i + 1}") for i, item in enumerate(value)
        ]

    def changed(self, mapping: Mapping[str, Any]) -> Table:
        """Return a table of other content with the same location."""
        return Table(mapping, self._where, self._error, self._path)

    @property
    def content(self) -> dict[str, Any]:
        """Return a copy of a table with free keys; all its keys count as requested."""
        self._asked.update(dict.fromkeys(self._mapping))
        return dict(self._mapping)

    @property
    def content_unread(self) -> dict[str, Any]:
        """Return a copy of the table for the record of a result, without requesting keys."""
        return dict(self._mapping)

    def done(self) -> None:
        """Raise on the first key that was never requested, with the most similar valid key, or all of them."""
        for key in self._unknown():
            known = f"; known here are {listing(self._asked)}" if self._asked else ""
            self.fail(f"unknown key {key!r}{did_you_mean(key, self._asked) or known}")

    def _unknown(self) -> list[str]:
        return [key for key in self._mapping if key not in self._asked]

    def _child(self, mapping: Mapping[str, Any], name: str) -> Table:
        path = f"{self._path}.{name}" if self._path else name
        return Table(mapping, self._where, self._error, path)

    def _finite(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.fail(f"{key} must be a finite number, got {brief(repr(value))}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf  # an integer of more than 308 digits
        if not math.isfinite(number):
            self.fail(f"{key} must be a finite number, got {brief(repr(value))}")
        return number

    def _number_list(self, key: str, value: object, length: int | None) -> list[float]:
        if not isinstance(value, list):
            self.fail(f"{key} must be a list of numbers, got {brief(repr(value))}")
        if length is not None and len(value) != length:
            self.fail(f"{key} must hold {counted(length, 'number')}, got {len(value)}")
        return [self._finite(f"{key} number {i + 1}", item) for i, item in enumerate(value)]

    def _check_range(
        self, key: str, value: float, minimum: float | None, maximum: float | None, above: float | None
    ) -> None:
        if above is not None and not value > above:
            self.fail(f"{key} must be above {above}, got {value}")
        if minimum is not None and value < minimum:
            self.fail(f"{key} must be at least {minimum}, got {value}")
        if maximum is not None and value > maximum:
            self.fail(f"{key} must be at most {maximum}, got {value}")
