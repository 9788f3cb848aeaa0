"""Strict reading of TOML tables: readers request keys, `didim._tools.keys` has their bounds, and any other key is an error.

The messages are one sentence that names the file, the table and the key, as in
``emps.toml: [signal] unknown key 'cutof_hz'; did you mean 'cutoff_hz'?`` (``tests/test_schema.py``).
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Mapping
from operator import ge, gt, le
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from ..errors import DidimError
from .inputs import read_small_file
from .keys import NO_KEYS, Keys
from .settings import real_number
from .words import brief, counted, did_you_mean, listing, nearest

MISSING: Any = object()
"""Default of a mandatory key."""

SCHEMA = 1
"""Version of the file formats that this code reads."""

LARGEST_INTEGER = 2**63 - 1
"""Largest integer that TOML guarantees."""

MOST_DOTS = 5000
"""Largest number of dots in keys of more than three: each takes 600 bytes, and in one key memory grows with the square."""
_PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')"""
DEEP_KEY = re.compile(rf"""(?<![\w'"-]){_PART}(?:[ \t]*\.[ \t]*{_PART}){{4,}}""")

_Default = TypeVar("_Default")
_Made = TypeVar("_Made")


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
        if sum(key.group().count(".") for key in DEEP_KEY.finditer(content)) > MOST_DOTS:
            raise error(
                f"{path.name}: its keys have more than {MOST_DOTS} dots, and no key of didim more than ten"
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


def toml_key(name: str) -> str:
    """Return a name as a TOML key, quoted where needed."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else quoted(name)


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
    keys
        Declared keys of the table: choices and bounds of values, and defaults that a reader does not give.
    """

    def __init__(
        self,
        mapping: Mapping[str, Any],
        where: str,
        error: type[DidimError],
        path: str = "",
        keys: Keys = NO_KEYS,
    ) -> None:
        self._mapping = mapping
        self._asked: dict[str, None] = {}
        self._where = where
        self._error = error
        self._path = path
        self._keys = keys

    def fail(self, text: str) -> NoReturn:
        """Raise this table's error, with file and table as prefix."""
        raise self._error(f"{self.prefix} {text}")

    def checked(self, make: Callable[[], _Made]) -> _Made:
        """Return the object made by `make`, or raise the reason against it as this table's error."""
        try:
            return make()
        except DidimError as reason:
            raise self._error(f"{self.prefix} {reason}") from None

    @property
    def prefix(self) -> str:
        """File and table, as messages open: ``emps.toml: [signal]``."""
        return f"{self._where}: [{self._path}]" if self._path else f"{self._where}:"

    def has(self, key: str) -> bool:
        """Whether the table holds `key`; counts as asking for it."""
        self._asked[key] = None
        return key in self._mapping

    def raw(self, key: str, default: object = MISSING) -> Any:
        """Return the value as `tomllib` gives it, or else the default, given or declared."""
        self._asked[key] = None
        if key in self._mapping:
            return self._mapping[key]
        row = self._keys.rows.get(key)
        if default is MISSING and row is not None and row.default is not None:
            return row.default
        if default is MISSING:
            # A misspelt key is both missing and unknown: say the second, which is the cure.
            near = nearest(key, self._unknown())
            self.fail(f"key {key!r} is missing" + (f"; is {near!r} meant to be it?" if near else ""))
        return default

    def _read(self, key: str, default: object) -> Any:
        """Return the value of a key, its declared default, or `MISSING` in the place of the reader's default."""
        value = self.raw(key, default)
        return MISSING if value is default and key not in self._mapping else value

    def check_schema(self) -> None:
        """Refuse a file of another version of the format than `SCHEMA`."""
        schema = self.integer("schema")
        if schema != SCHEMA:
            self.fail(f"schema {schema} is unknown; this version reads schema {SCHEMA}")

    def _typed(self, key: str, default: _Default, kind: type[_Made], noun: str) -> _Made | _Default:
        """Return the value of a key, which must be of one type, or the default."""
        if (value := self._read(key, default)) is MISSING:
            return default
        if not isinstance(value, kind):
            self.fail(f"{key} must be {noun}, got {brief(repr(value))}")
        return value

    def given(self) -> dict[str, Any]:
        """Return the values of the declared keys that the table holds: the defaults are those of settings."""
        readers: dict[str, Callable[[str], Any]] = {
            "number": self.number,
            "integer": self.integer,
            "integer, or list of integers": self.integers,
            "text": self.text,
            "true or false": self.boolean,
            "list of texts": self.texts,
        }
        plain = {key: readers[row.type] for key, row in self._keys.rows.items() if row.type in readers}
        return {key: read(key) for key, read in plain.items() if self.has(key)}

    def number(self, key: str, default: _Default = MISSING) -> float | _Default:
        """Finite number within its declared bounds."""
        if (value := self._read(key, default)) is MISSING:
            return default
        return self._finite(key, value)

    def integer(self, key: str, default: _Default = MISSING, maximum: int | None = None) -> int | _Default:
        """Integer within its declared bounds and a `maximum` that depends on other keys; 3.0 is not one."""
        if (value := self._read(key, default)) is MISSING:
            return default
        if isinstance(value, bool) or not isinstance(value, int):
            self.fail(f"{key} must be an integer, got {brief(repr(value))}")
        if abs(value) > LARGEST_INTEGER:
            self.fail(f"{key} must be an integer of at most {LARGEST_INTEGER}, got {brief(str(value))}")
        self._check_range(key, value)
        if maximum is not None and value > maximum:
            self.fail(f"{key} must be at most {maximum}, got {value}")
        return value

    def integers(self, key: str) -> list[int]:
        """List of integers, or one of them."""
        value = self.raw(key)
        if not isinstance(value, list):
            return [self.integer(key)]
        if not all(type(number) is int for number in value):
            self.fail(f"{key} must be a list of integers, got {value!r}")
        return value

    def text(self, key: str, default: _Default = MISSING) -> str | _Default:
        """Text, one of the declared choices if there are any."""
        value = self._typed(key, default, str, "a text")
        row = self._keys.rows.get(key)
        if row is not None and row.choices and isinstance(value, str) and value not in row.choices:
            self.fail(
                f"{key} must be one of {listing(row.choices, 60)}, got {brief(repr(value), 40)}{did_you_mean(value, row.choices)}"
            )
        return value

    def boolean(self, key: str, default: _Default = MISSING) -> bool | _Default:
        """Truth value, ``true`` or ``false``."""
        return self._typed(key, default, bool, "true or false")

    def numbers(
        self, key: str, length: int | None = None, default: _Default = MISSING
    ) -> list[float] | _Default:
        """List of finite numbers, of the given length when there is one."""
        if (value := self._read(key, default)) is MISSING:
            return default
        return self._number_list(key, value, length)

    def spread(self, key: str, length: int, default: _Default = MISSING) -> list[float] | _Default:
        """List of `length` numbers, or one number that stands for all of them."""
        if (value := self._read(key, default)) is MISSING:
            return default
        if isinstance(value, list):
            return self._number_list(key, value, length)
        return [self._finite(key, value)] * length

    def texts(self, key: str) -> list[str]:
        """List of texts."""
        value = self.raw(key)
        if not isinstance(value, list) or not all(isinstance(text, str) for text in value):
            self.fail(f"{key} must be a list of texts, got {brief(repr(value))}")
        return list(value)

    def matrix(
        self, key: str, rows: int | None, columns: int, default: _Default = MISSING
    ) -> list[list[float]] | _Default:
        """Matrix as a list of rows, of any number of them for None."""
        if (value := self._read(key, default)) is MISSING:
            return default
        if not isinstance(value, list) or rows not in (None, len(value)):
            got = counted(len(value), "row") if isinstance(value, list) else repr(value)
            shape = "" if rows is None else f"{counted(rows, 'row')} and "
            self.fail(f"{key} must be a matrix of {shape}{counted(columns, 'column')}, got {got}")
        return [self._number_list(key, row, columns, f", row {i + 1},") for i, row in enumerate(value)]

    def table(self, key: str, default: _Default = MISSING) -> Table | _Default:
        """Sub-table ``[key]``."""
        value = self._typed(key, default, dict, "a table")
        return self._child(value, key) if isinstance(value, dict) else value

    def part(self, key: str) -> Table:
        """Sub-table ``[key]``, empty if the file has none."""
        return self.table(key, None) or self._child({}, key)

    def tables(self, key: str, default: _Default = MISSING) -> list[Table] | _Default:
        """Return an array of tables ``[[key]]``; several are named by their index."""
        if (value := self._read(key, default)) is MISSING:
            return default
        if not isinstance(value, list) or not all(isinstance(row, dict) for row in value):
            self.fail(f"{key} must be an array of tables, [[{key}]]")
        return [self._child(row, key, "" if len(value) == 1 else f" {i + 1}") for i, row in enumerate(value)]

    def changed(self, mapping: Mapping[str, Any]) -> Table:
        """Return a table of other content with the same location."""
        return Table(mapping, self._where, self._error, self._path, self._keys)

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

    def _child(self, mapping: Mapping[str, Any], key: str, number: str = "") -> Table:
        path = f"{self._path}.{key}{number}" if self._path else f"{key}{number}"
        return Table(mapping, self._where, self._error, path, self._keys.inside(key))

    def _finite(self, key: str, value: object, where: str = "") -> float:
        """Return a finite number within the declared bounds of its key; `where` follows the key in messages."""
        number = real_number(value)
        if not math.isfinite(number):
            self.fail(f"{key}{where} must be a finite number, got {brief(repr(value))}")
        self._check_range(key, number, where)
        return number

    def _number_list(self, key: str, value: object, length: int | None, where: str = "") -> list[float]:
        if not isinstance(value, list):
            self.fail(f"{key}{where} must be a list of numbers, got {brief(repr(value))}")
        if length is not None and len(value) != length:
            self.fail(f"{key}{where} must hold {counted(length, 'number')}, got {len(value)}")
        return [self._finite(key, number, f"{where} number {i + 1}") for i, number in enumerate(value)]

    def _check_range(self, key: str, value: float, where: str = "") -> None:
        row = self._keys.rows.get(key)
        if row is None:
            return
        for words, bound, keeps in (
            ("above", row.above, gt), ("at least", row.minimum, ge), ("at most", row.maximum, le)
        ):  # fmt: skip
            if bound is not None and not keeps(value, bound):
                self.fail(f"{key}{where} must be {words} {bound}, got {value}")
