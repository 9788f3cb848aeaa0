"""Hostile files for `fuzz.py`, all below 1 MB: without an end, too deep, too wide, or larger inside than outside.

`hostile` puts one in the place of a sound file; `alias` makes an output of a file that the command reads, by its path or by a link.
"""

from __future__ import annotations

import io
import os
import random
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

MB = 1_000_000
"""Bytes that a hostile file has at most."""

Writer = Callable[[Path], object]


def _text(content: str) -> Writer:
    return lambda path: path.write_text(content[: MB - 1], encoding="utf-8")


def _link(target: str) -> Writer:
    return lambda path: path.symlink_to(target)


def _sparse(path: Path) -> None:
    path.touch()
    os.truncate(path, 1 << 42)


SPECIAL: dict[str, Writer] = {
    "device": _link("/dev/zero"),
    "random device": _link("/dev/urandom"),
    "terminal": _link("/dev/tty"),
    "pipe": lambda path: os.mkfifo(path),
    "folder": lambda path: path.mkdir(),
    "circle": lambda path: path.symlink_to(path.name),
    "dangling link": _link("nowhere"),
    "sparse": _sparse,
}
"""Makers of paths that are not regular files, and of a file with terabytes of zeros."""

TEXTS: dict[str, str] = {
    "one line": "1" * MB,
    "blanks": " " * MB,
    "line ends": "\n" * MB,
    "commas": "," * MB,
    "quotes": '"' * MB,
    "brackets": "[" * MB,
    "braces": "{" * MB,
    "tables": '{"a":' * (MB // 5),
    "zeros": "\0" * MB,
    "long first line": ",".join(f"c{k}" for k in range(140_000)) + "\n1,2\n",
    "columns": (",".join(["0"] * 9_900) + "\n") * 50,
    "digits": "0." + "3" * (MB - 3),
    "comments": "# a\n" * (MB // 4),
}
TOML: dict[str, str] = {
    "dots": "a." * 50_000 + "b = 1\n",
    "dotted header": "[" + "a." * 50_000 + "b]\n",
    "many dotted keys": "".join(f"a{k}{'.b' * 90} = 1\n" for k in range(5_000)),
    "keys": "".join(f"k{k} = 1\n" for k in range(80_000)),
    "joints": "schema = 1\n" + "[[joint]]\na_m = 0.1\nd_m = 0.0\nalpha_deg = 0.0\ntheta_deg = 0.0\n" * 15_000,
    "mdh joints": "schema = 1\n"
    + "[[joint]]\nalpha_deg = 90.0\nd_m = 0.1\ntheta_deg = 0.0\nr_m = 0.1\n" * 15_000,
    "recordings": "schema = 1\nrobot = 'arm.toml'\n" + "[[recording]]\nrate_hz = 250\n" * 30_000,
    "long text": f'schema = 1\nname = "{"y" * 900_000}"\n',
    "long list": f"schema = [{'1, ' * 300_000}]\n",
    "long number": f"schema = {'1' * 900_000}\n",
    "inline tables": "a = " + "{a = " * 150_000,
    "methods": "schema = 1\nexperiment = 'loop.toml'\nparameters = 'reference'\n"
    + "[[method]]\nname = 'idim-ls'\n" * 30_000,
}
JSON: dict[str, str] = {
    "list": "[" + "1," * 499_000 + "1]",
    "objects": "[" + "{}," * 330_000 + "{}]",
    "long text": '"' + "y" * (MB - 10) + '"',
    "long number": "1" * (MB - 1),
    "result": '{"schema": 1, "parameters": [' + '{"name": "a"},' * 60_000 + '{"name": "a"}]}',
    "rows": '{"id": "a"}\n' * 80_000,
}
URDF: dict[str, str] = {
    "elements": "<robot name='a'>" + "<a>" * 300_000,
    "links": "<robot name='a'>" + "".join(f"<link name='l{k}'/>" for k in range(40_000)) + "</robot>",
    "chain": "<robot name='a'><link name='l0'/>"
    + "".join(
        f"<link name='l{k + 1}'/><joint name='j{k}' type='revolute'><parent link='l{k}'/><child link='l{k + 1}'/>"
        "<axis xyz='0 0 1'/></joint>"
        for k in range(6_500)
    )
    + "</robot>",
    "attributes": "<robot " + "".join(f"a{k}='1' " for k in range(70_000)) + "/>",
    "entities": "<!DOCTYPE a [<!ENTITY b 'cccccccccc'>"
    + "<!ENTITY d '&b;&b;&b;&b;&b;&b;&b;&b;'>" * 1_000
    + "]><robot/>",
}


_LINK = "<body><joint/><geom size='.1'/>"
_BODY = "<worldbody><body name='a'><joint name='j'/><geom size='.1'/></body></worldbody>"
_MANY = 15_000
MJCF: dict[str, str] = {
    name: f"<mujoco>{text}</mujoco>"
    for name, text in {
        "bodies": "<worldbody>" + _LINK * 450 + "</body>" * 450 + "</worldbody>",
        "many bodies": "<worldbody>" + (_LINK + "</body>") * _MANY + "</worldbody>",
        "replicate": "<worldbody>"
        + "<replicate count='1000'>" * 3
        + "<geom/>"
        + "</replicate>" * 3
        + "</worldbody>",
        "composite": "<worldbody><composite type='cable' count='1000000 1 1' size='1'><geom/></composite></worldbody>",
        "flexcomp": "<worldbody><flexcomp name='f' type='grid' count='1000 1000 1000'/></worldbody>",
        "memory": "<size memory='1000G'/>" + _BODY,
        "user data": "<size nuserdata='1000000000'/>" + _BODY,
        "keys": "<size nkey='1000000000'/>" + _BODY,
        "numeric": "<custom><numeric name='x' size='2000000000' data='1'/></custom>" + _BODY,
        "texture": "<asset><texture name='t' type='2d' builtin='flat' width='99999' height='99999'/></asset>"
        + _BODY,
        "height field": "<asset><hfield name='h' nrow='99999' ncol='99999' size='1 1 1 1'/></asset>" + _BODY,
        "plugin": "<extension><plugin plugin='mujoco.sdf.torus'/></extension>" + _BODY,
        "attached to itself": "<asset><model name='m' file='arm.xml'/></asset><worldbody><attach model='m' body='a' "
        "prefix='x'/></worldbody>",
        "included in itself": "<include file='arm.xml'/>" + _BODY,
        "models": "<asset>" + "<model name='m' file='part.xml'/>" * _MANY + "</asset>" + _BODY,
        "mass": _BODY.replace("size='.1'", "size='.1' mass='x' density='x'"),
        "gear": _BODY + "<actuator><motor joint='j' gear=''/></actuator>",
        "classes": "<default>" * 400 + "</default>" * 400 + _BODY,
        "not a number": _BODY.replace("size='.1'", "size='.1' mass='nan'"),
        "infinite": _BODY.replace(
            "name='j'", "name='j' armature='1e300' damping='1e308' range='-1e300 1e300'"
        ),
        "large": _BODY.replace("size='.1'", "size='1e100' density='1e200'"),
        "sensors": _BODY + "<sensor>" + "<jointpos joint='j'/>" * _MANY + "</sensor>",
        "actuators": _BODY + "<actuator>" + "<motor joint='j'/>" * _MANY + "</actuator>",
        "ties": _BODY + "<equality>" + "<joint joint1='j'/>" * _MANY + "</equality>",
    }.items()
}


def _npz(make: Callable[[zipfile.ZipFile], None]) -> Writer:
    def write(path: Path) -> None:
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            make(archive)
        path.write_bytes(stream.getvalue())

    return write


def _head(shape: tuple[int, ...], descr: str = "<f8") -> bytes:
    stream = io.BytesIO()
    content: Any = {"descr": descr, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, content)
    return stream.getvalue()


def _zeros(archive: zipfile.ZipFile) -> None:
    """900 MB of zeros in 900 kB."""
    for name in ("counts", "current", "parameters"):
        with archive.open(f"{name}.npy", "w") as entry:
            entry.write(_head((37_500_000,)))
            for _ in range(300):
                entry.write(bytes(MB))


def _declared(archive: zipfile.ZipFile) -> None:
    for name in ("counts", "current", "parameters", "record"):
        archive.writestr(f"{name}.npy", _head((10**9, 2)) + bytes(1000))


def _texts(archive: zipfile.ZipFile) -> None:
    """Names that are texts of a million letters each."""
    for name in ("parameter_names", "names", "record", "seal"):
        archive.writestr(f"{name}.npy", _head((100,), "<U1000000") + bytes(1000))


def _entries(archive: zipfile.ZipFile) -> None:
    for number in range(4_000):
        archive.writestr(f"a{number}.npy", _head((1,)) + bytes(8))


def _objects(archive: zipfile.ZipFile) -> None:
    archive.writestr("counts.npy", _head((3,), "|O") + b"\x80\x04K\x01.")


def _dimensions(archive: zipfile.ZipFile) -> None:
    archive.writestr("counts.npy", _head((0,) * 20 + (10**15,)))
    archive.writestr("current.npy", _head((1,) * 30) + bytes(8))


def _mat_zeros(path: Path) -> None:
    packed = zlib.compress(bytes(900 * MB), 9)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(head + (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed)


def _mat_declared(path: Path) -> None:
    """A matrix that declares 4 GB."""
    body = b"".join(
        part.to_bytes(4, "little")
        for part in (6, 8, 6, 0, 5, 8, 2**16, 2**13, 0x10001, 0x61, 9, 2**32 - 8, 0, 0)
    )
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(head + (14).to_bytes(4, "little") + len(body).to_bytes(4, "little") + body)


def _mat_cells(path: Path) -> None:
    from scipy.io import savemat

    cells: Any = np.empty((10_000,), dtype=object)
    cells[:] = [np.zeros(0)] * 10_000
    stream: Any = io.BytesIO()
    savemat(stream, {"counts": cells, "current": {f"a{k}": k for k in range(500)}})
    path.write_bytes(stream.getvalue())


def _hdf5(make: Callable[[Any], None]) -> Writer:
    def write(path: Path) -> None:
        import h5py

        with h5py.File(path, "w") as file:
            make(file)

    return write


def _hdf5_declared(file: Any) -> None:
    for name in ("counts", "current"):
        file.create_dataset(name, shape=(10**9, 2), chunks=(1000, 2), dtype="f8")


def _hdf5_external(file: Any) -> None:
    file.create_dataset("counts", shape=(1000, 2), dtype="f8", external=[("/dev/zero", 0, 16_000)])


def _hdf5_groups(file: Any) -> None:
    place = file
    for _ in range(200):
        place = place.create_group("a")
    file["a/self"] = file["a"]
    for number in range(500):
        file[f"b{number}"] = np.zeros(20)


def _mcap_chunk(path: Path) -> None:
    chunk = bytes(16) + (1 << 45).to_bytes(8, "little") + bytes(20)
    path.write_bytes(b"\x89MCAP0\r\n" + b"\x06" + len(chunk).to_bytes(8, "little") + chunk)


FILES: dict[str, dict[str, Writer]] = {
    ".toml": {name: _text(text) for name, text in (TEXTS | TOML).items()},
    ".csv": {name: _text(text) for name, text in TEXTS.items()},
    ".txt": {name: _text(text) for name, text in TEXTS.items()},
    ".json": {name: _text(text) for name, text in (TEXTS | JSON).items()},
    ".jsonl": {name: _text(text) for name, text in (TEXTS | JSON).items()},
    ".urdf": {name: _text(text) for name, text in (TEXTS | URDF).items()},
    ".xml": {name: _text(text) for name, text in (TEXTS | URDF | MJCF).items()},
    ".yaml": {name: _text(text) for name, text in (TEXTS | TOML).items()},
    ".npz": {
        "zeros": _npz(_zeros),
        "declared": _npz(_declared),
        "texts": _npz(_texts),
        "entries": _npz(_entries),
        "objects": _npz(_objects),
        "dimensions": _npz(_dimensions),
    },
    ".mat": {"zeros": _mat_zeros, "declared": _mat_declared, "cells": _mat_cells},
    ".h5": {
        "declared": _hdf5(_hdf5_declared),
        "external": _hdf5(_hdf5_external),
        "groups": _hdf5(_hdf5_groups),
    },
    ".mcap": {"chunk": _mcap_chunk, "text": _text(TEXTS["one line"])},
}
"""Hostile contents by suffix and name."""


def kinds(suffix: str) -> dict[str, Writer]:
    """Return all hostile files of a suffix by name."""
    return {**SPECIAL, **FILES[suffix]}


def hostile(path: Path, rng: random.Random) -> str:
    """Put a hostile file in the place of a sound one, and say which."""
    name = rng.choice(sorted(kinds(path.suffix)))
    path.unlink()
    kinds(path.suffix)[name](path)
    return f"hostile {name} for {path.name}"


OUTPUTS = ("-o", "--json", "--report", "--save-parameters", "--checkpoint")
"""Options of a command line that name an output."""


def alias(arguments: list[str], files: tuple[str, ...], rng: random.Random) -> str:
    """Make an output of a file that the command reads; return what was done, or an empty text where there is no output."""
    places = [number + 1 for number, word in enumerate(arguments[:-1]) if word in OUTPUTS]
    if not places:
        return ""
    place, source = rng.choice(places), Path(rng.choice(files))
    target = source
    way = rng.choice(("path", "symbolic link", "hard link", "other spelling"))
    if way == "other spelling":
        target = Path("..", Path.cwd().name, source)
    elif way != "path":
        target = Path(f"alias{Path(arguments[place]).suffix}")
        target.unlink(missing_ok=True)
        if way == "hard link" and source.is_file():
            target.hardlink_to(source)
        else:
            target.symlink_to(source)
    arguments[place] = str(target)
    return f"output over {source} by its {way}"


def snapshot() -> dict[str, bytes]:
    """Return the content of every regular file of the working folder and of its folders, by path."""
    return {
        str(path): path.read_bytes()
        for path in sorted(Path().rglob("*"))
        if path.is_file() and not path.is_symlink() and path.stat().st_size <= 2 * MB
    }


def losses(before: dict[str, bytes], arguments: list[str], files: tuple[str, ...]) -> str:
    """Say which files have changed that the command does not own; an empty text when none has.

    Its own are the outputs that it names, but those of `files`, which it reads. A checkpoint is replaced, also through a link; rows
    of a study are appended behind those that are whole.
    """
    named = [
        (word, os.path.realpath(arguments[number + 1]))  # of a circle as far as it goes
        for number, word in enumerate(arguments[:-1])
        if word in OUTPUTS
    ]
    read = set(map(os.path.realpath, files))
    own = {path for word, path in named if word == "--checkpoint" or path not in read}
    after = snapshot()
    lost = []
    for name, content in before.items():
        now = after.get(name)
        if now == content or os.path.realpath(name) in own:
            continue
        if arguments[0] == "study" and name.endswith(".jsonl") and now is not None:
            whole = content[: content.rfind(b"\n") + 1]
            if now.startswith(whole):
                continue
        lost.append(name)
    return f"lost or changed: {', '.join(lost)}" if lost else ""
