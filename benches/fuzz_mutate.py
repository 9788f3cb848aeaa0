"""Mutations of `fuzz.py`: of bytes, of lines, of TOML values, of tables of numbers, of JSON and of npz files."""

from __future__ import annotations

import io
import json
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

NUMBERS = (
    *("0", "-1", "1", "2", "3", "7", "0.5", "-0.0", "1e-320", "1e-30", "1e-9", "1e6", "1e9", "1e30", "1e300"),
    *("-1e300", "1.7976931348623157e308", "nan", "inf", "-inf", "9223372036854775807", "9223372036854775808"),
    *(
        "-9223372036854775808",
        "4294967296",
        "100000",
        "1000000000",
        "1" + "0" * 400,
        "1" + "0" * 5000,
        "0x10",
        "1_000",
    ),
)
TEXTS = (
    *(
        '""',
        '"x"',
        '"é\u2028"',
        "'reference'",
        '"log.csv"',
        '"/"',
        '".."',
        '"\\u0000"',
        '"' + "y" * 5000 + '"',
    ),
    *(
        "true",
        "[]",
        "[[]]",
        "[1]",
        "[1.0, 2.0]",
        "[[1.0, 2.0], [3.0, 4.0]]",
        "[1, 'a']",
        "{}",
        "{a = 1}",
        "[" * 3000,
    ),
    *(
        "1979-05-27T07:32:00Z",
        "07:32:00",
        "'deg'",
        "'mm'",
        "'V'",
        "'count'",
        "'motor'",
        "'estimate'",
        "[0, 0]",
    ),
    *(
        "'fourier'",
        "'measured'",
        "'cascade'",
        "'tanh'",
        "'sign'",
        "'prismatic'",
        "'none'",
        "[[0, 1], [1, 0]]",
    ),
)
NUMBER = re.compile(r"(?<![\w.])[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?")


def mutate(path: Path, rng: random.Random) -> str:
    """Change a file once, and say how.

    Parameters
    ----------
    path : Path
        The file; it is overwritten.
    rng : Random
        Decides everything.
    """
    raw = path.read_bytes()
    ways: dict[str, list[Callable[[bytes, random.Random], bytes]]] = {
        ".toml": [_value, _value, _value, _number, _number, _number, _key, _line, _bytes, _encoding],
        ".csv": [_cell, _cell, _column, _column, _row, _line, _bytes, _encoding, _number],
        ".txt": [_cell, _cell, _column, _row, _line, _bytes, _encoding],
        ".json": [_json, _json, _json, _json, _number, _bytes, _encoding],
        ".npz": [_npz, _npz, _npz, _zip, _bytes],
        ".mat": [_mat, _mat, _bytes],
        ".h5": [_hdf5, _hdf5, _bytes],
        ".jsonl": [_json_line, _json_line, _line, _number, _bytes],
        ".urdf": [_attribute, _attribute, _element, _number, _number, _line, _bytes, _encoding],
        ".xml": [_attribute, _attribute, _attribute, _element, _number, _number, _line, _bytes, _encoding],
        ".mcap": [_bytes],
        ".yaml": [_number, _line, _bytes],
    }
    way = rng.choice(ways[path.suffix])
    try:
        changed = way(raw, rng)
    except Exception:  # an earlier mutation left nothing that this one understands
        way = _bytes
        changed = _bytes(raw, rng)
    path.write_bytes(changed)
    return f"{way.__name__.removeprefix('_')} of {path.name}"


def _lines(raw: bytes) -> list[str]:
    return raw.decode("utf-8").split("\n")


def _joined(lines: list[str]) -> bytes:
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def _bytes(raw: bytes, rng: random.Random) -> bytes:
    """Flip, insert, drop or cut bytes."""
    data = bytearray(raw)
    kind = rng.randrange(5)
    if kind == 0 or not data:
        return b"" if rng.random() < 0.3 else bytes(rng.randrange(256) for _ in range(rng.randrange(40)))
    if kind == 1:
        return bytes(data[: rng.randrange(len(data))])
    for _ in range(rng.choice((1, 1, 3, 30))):
        place = rng.randrange(len(data)) if data else 0
        if kind == 2 and data:
            data[place] ^= 1 << rng.randrange(8)
        elif kind == 3:
            data[place:place] = bytes([rng.randrange(256)])
        else:
            del data[place : place + rng.randrange(1, 20)]
    return bytes(data)


def _encoding(raw: bytes, rng: random.Random) -> bytes:
    """Write the text as other programs do."""
    text = raw.decode("utf-8")
    kind = rng.randrange(6)
    if kind < 3:
        return text.encode(("utf-16", "utf-32", "utf-8-sig")[kind])
    if kind == 3:
        return ("Größe" + text).encode("latin-1")
    return text.replace("\n", "\r" if kind == 4 else "\r\n").encode()


def _line(raw: bytes, rng: random.Random) -> bytes:
    """Delete, double, exchange, empty or cut a line."""
    lines = _lines(raw)
    place = rng.randrange(len(lines))
    kind = rng.randrange(6)
    if kind == 0:
        del lines[place]
    elif kind == 1:
        lines.insert(rng.randrange(len(lines)), lines[place])
    elif kind == 2:
        other = rng.randrange(len(lines))
        lines[place], lines[other] = lines[other], lines[place]
    elif kind == 3:
        lines.insert(place, rng.choice(("", " ", "#", "[a]", "[[joint]]", "[[recording]]", ",,,", "\x00")))
    elif kind == 4:
        lines[place] = lines[place][: rng.randrange(len(lines[place]) + 1)]
    else:
        # A whole block: a table, or a hundred samples.
        del lines[place : place + rng.randrange(2, max(3, len(lines) // 2))]
    return _joined(lines)


def _value(raw: bytes, rng: random.Random) -> bytes:
    """Replace the value of a key."""
    lines = _lines(raw)
    places = [i for i, line in enumerate(lines) if "=" in line and not line.startswith("#")]
    place = rng.choice(places)
    key = lines[place].split("=")[0]
    lines[place] = f"{key}= {rng.choice((*TEXTS, *NUMBERS))}"
    return _joined(lines)


def _number(raw: bytes, rng: random.Random) -> bytes:
    """Replace a number, wherever it stands."""
    text = raw.decode("utf-8")
    found = list(NUMBER.finditer(text))
    match = rng.choice(found)
    new = rng.choice(NUMBERS)
    if rng.random() < 0.4:
        new = f"{float(match.group()) * 10.0 ** rng.randint(-6, 6):.6g}"
    return (text[: match.start()] + new + text[match.end() :]).encode()


def _key(raw: bytes, rng: random.Random) -> bytes:
    """Misspell a key or the name of a table."""
    lines = _lines(raw)
    places = [i for i, line in enumerate(lines) if re.match(r"[\w\[]", line)]
    place = rng.choice(places)
    line = lines[place]
    cut = rng.randrange(max(1, len(re.split(r"[ =\]]", line)[0])))
    lines[place] = line[:cut] + rng.choice(("", "x", line[cut : cut + 1].upper(), ".", "é")) + line[cut + 1 :]
    return _joined(lines)


def _cell(raw: bytes, rng: random.Random) -> bytes:
    """Replace a cell of a table."""
    lines = _lines(raw)
    place = rng.randrange(len(lines))
    sign = "," if "," in raw[:100].decode() else " "
    cells = lines[place].split(sign)
    odd = ("", "NaN", "-", "1,5", "#N/A", '"1"', '"', "1e400", "abc", "\t", "1;2", "\u0661")
    cells[rng.randrange(len(cells))] = rng.choice((*NUMBERS, *odd))
    lines[place] = sign.join(cells)
    return _joined(lines)


def _column(raw: bytes, rng: random.Random) -> bytes:
    """Exchange, drop, double, scale or flatten columns."""
    sign = "," if "," in raw[:100].decode() else " "
    rows = [line.split(sign) for line in _lines(raw)]
    width = len(rows[0])
    one, other = rng.randrange(width), rng.randrange(width)
    kind = rng.randrange(6)
    factor = rng.choice((0.0, -1.0, 1e-300, 1e-12, 1e3, 1e12, 1e155, 1e300))
    start = rng.randrange(len(rows))
    for row in rows:
        if len(row) != width:
            continue
        if kind == 0:
            row[one], row[other] = row[other], row[one]
        elif kind == 1:
            del row[one]
        elif kind == 2:
            row.insert(other, row[one])
        elif re.match(r"[\d-]", row[one]):
            row[one] = f"{float(row[one]) * factor:.12g}" if kind == 3 else row[one]
    if kind >= 4:  # a sensor that holds, or jumps
        for row in rows[start:]:
            if len(row) == width and re.match(r"[\d-]", row[one]):
                row[one] = rows[start][one] if kind == 4 else f"{float(row[one]) + factor:.12g}"
    return _joined([sign.join(row) for row in rows])


def _row(raw: bytes, rng: random.Random) -> bytes:
    """Make a row ragged, or keep few rows, or repeat all of them."""
    lines = _lines(raw)
    place = rng.randrange(len(lines))
    kind = rng.randrange(5)
    if kind == 0:
        lines[place] += rng.choice((",1", " 1", ",", ";"))
    elif kind == 1:
        lines[place] = lines[place].rpartition(",")[0] or lines[place].rpartition(" ")[0]
    elif kind == 2:
        lines = lines[: rng.randrange(1, 30)]
    elif kind == 3:
        lines = lines[1:]
    else:
        lines += lines[1:]
    return _joined(lines)


ODD: tuple[Any, ...] = (
    *(
        None,
        True,
        False,
        0,
        1,
        -1,
        3,
        0.5,
        -1e300,
        1e300,
        1e-320,
        10**400,
        "",
        "x",
        "é",
        "nan",
        [],
        [1.0],
        [[]],
    ),
    *([None], ["a", "b"], {}, {"a": 1}, [1, [2, 3]], float("nan"), float("inf"), -float("inf"), "a" * 3000),
)


def _json(raw: bytes, rng: random.Random) -> bytes:
    """Replace, drop, double or rename an entry, anywhere in the tree."""
    data = json.loads(raw)
    place: Any = data
    while True:
        keys = list(place) if isinstance(place, dict) else range(len(place))
        if not keys:
            return json.dumps(rng.choice(ODD)).encode()
        key: Any = rng.choice(list(keys))
        deeper = isinstance(place[key], dict | list) and place[key]
        if not deeper or rng.random() < 0.25:
            break
        place = place[key]
    kind = rng.randrange(6)
    if kind == 0:
        del place[key]
    elif kind == 1 and isinstance(place, dict):
        place[f"{key}x"] = place.pop(key)
    elif kind == 2 and isinstance(place, list):
        place.append(place[key])
    elif kind == 3 and isinstance(place[key], int | float):
        place[key] = place[key] * 10.0 ** rng.randint(-9, 9)
    else:
        place[key] = rng.choice(ODD)
    return json.dumps(data).encode()


def _npz(raw: bytes, rng: random.Random) -> bytes:
    with np.load(io.BytesIO(raw)) as data:
        arrays: dict[str, Any] = {name: data[name] for name in data.files}
    if "record" in arrays and rng.random() < 0.6:
        arrays["record"] = np.array(_json(str(arrays["record"]).encode(), rng).decode())
    else:
        _array(arrays, rng)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def _zip(raw: bytes, rng: random.Random) -> bytes:
    """Damage an entry of the archive: its flags (encrypted), its compression, its sizes, or the shape in its header."""
    changed = bytearray(raw)
    kind = rng.randrange(4)
    if kind == 3:
        place = raw.find(b"'shape': (")
        head = b"'shape': (" + rng.choice((b"99999999999,", b"4294967296, 4294967296", b"-1,"))
        changed[place : place + len(head)] = head
        return bytes(changed)
    # Places in a local header, and in that of the directory: flags, compression, sizes.
    offset = ((6, 8), (8, 10), (18, 20))[kind]
    for mark, at in ((b"PK\x03\x04", offset[0]), (b"PK\x01\x02", offset[1])):
        place = raw.find(mark)
        if place >= 0:
            value = (1, rng.choice((1, 12, 99)), rng.choice((0, 0xFFFFFFFF, 0x7FFFFFFF)))[kind]
            size = 4 if kind == 2 else 2
            changed[place + at : place + at + size] = value.to_bytes(size, "little")
    return bytes(changed)


def _hdf5(raw: bytes, rng: random.Random) -> bytes:
    import h5py

    with h5py.File(io.BytesIO(raw)) as file:
        arrays: dict[str, Any] = {name: np.asarray(file[name]) for name in file}
    _array(arrays, rng)
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, value in arrays.items():
            plain = value.dtype.kind in "fiubc"
            file[name] = value if plain else np.zeros(value.shape, "S3")
    return stream.getvalue()


def _json_line(raw: bytes, rng: random.Random) -> bytes:
    """Change one line of many as JSON."""
    lines = raw.split(b"\n")
    place = rng.choice([number for number, line in enumerate(lines) if line])
    lines[place] = _json(lines[place], rng)
    return b"\n".join(lines)


def _attribute(raw: bytes, rng: random.Random) -> bytes:
    """Replace, rename or drop an attribute of XML."""
    text = raw.decode("utf-8")
    match = rng.choice(list(re.finditer(r' (\w+)="([^"]*)"', text)))
    values = (
        "",
        "x",
        "nan",
        "inf",
        "1 2",
        "1 2 3",
        "0 0 0",
        "1 2 3 4",
        "-1",
        "1e300",
        "base",
        "fore",
        "tool",
        "fixed",
    )
    kind = rng.randrange(4)
    new = f' {match.group(1)}="{rng.choice((*values, "mimic", "prismatic", "planar", "floating"))}"'
    if kind == 0:
        new = ""
    elif kind == 1:
        new = f' {match.group(1)}x="{match.group(2)}"'
    return (text[: match.start()] + new + text[match.end() :]).encode()


def _element(raw: bytes, rng: random.Random) -> bytes:
    """Drop, double or rename an element of XML."""
    text = raw.decode("utf-8")
    found = list(re.finditer(r"<(\w+)[^<>]*/>|<(link|joint) .*?</(link|joint)>", text, re.DOTALL))
    match = rng.choice(found)
    whole = match.group()
    name = match.group(1) or match.group(2)
    new = ("", whole + whole, whole.replace(name, "other"), "<!DOCTYPE a><x/>")[rng.randrange(4)]
    return (text[: match.start()] + new + text[match.end() :]).encode()


def _mat(raw: bytes, rng: random.Random) -> bytes:
    from scipy.io import loadmat, savemat

    # Any, because scipy-stubs know paths only.
    source: Any = io.BytesIO(raw)
    stream: Any = io.BytesIO()
    arrays = {k: v for k, v in loadmat(source).items() if not k.startswith("__")}
    _array(arrays, rng)
    savemat(stream, arrays)
    return bytes(stream.getvalue())


def _array(arrays: dict[str, Any], rng: random.Random) -> None:
    """Change one array: its name, shape, type or content."""
    name = rng.choice(sorted(arrays))
    value = arrays[name]
    size = value.size
    factor = rng.choice((0.0, -1.0, 1e-300, 1e12, 1e155, 1e300))
    numeric = value.dtype.kind in "fiu"
    kind = rng.randrange(14)
    if kind == 0:
        del arrays[name]
    elif kind == 1:
        arrays[name + "x"] = arrays.pop(name)
    elif kind in (2, 3, 4):
        shapes: tuple[Any, ...] = (value.T, value[..., None], value.reshape(-1))
        arrays[name] = shapes[kind - 2]
    elif kind == 5:
        arrays[name] = value[: rng.randrange(5)] if value.ndim else np.zeros((0, 2))
    elif kind == 6:
        types = ("complex128", "bool", "U5", "f2", "i1", "u8", "f4", "S3", "M8[s]")
        arrays[name] = np.zeros(value.shape, rng.choice(types))
    elif kind == 7:
        arrays[name] = np.zeros((0,) * rng.randrange(1, 4))
    elif kind == 8:
        arrays[name] = np.array(rng.choice((0.0, "x", 1j, True)))
    elif numeric and size:
        changed = np.array(value, dtype=float)
        if kind < 12:
            changed.flat[rng.randrange(size)] = float(
                rng.choice(("nan", "inf", "0", "1e300", "-1e9", "1e-320"))
            )
        else:
            with np.errstate(over="ignore"):
                changed *= factor
        arrays[name] = changed
