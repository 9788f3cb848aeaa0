"""Input files: regular files only, within memory, and never overwritten by the run that reads them.

Every reader of the package gets its bytes here, which records all inputs of a run. `one_run` compares each output with them.
Tested in ``tests/test_inputs.py`` and ``tests/test_outputs.py``.
"""

from __future__ import annotations

import errno
import io
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import DidimError, OutputError

if TYPE_CHECKING:
    import zipfile

LARGEST_EXPANSION = 200
"""Largest ratio of an archive's content to the bytes of its file. Noisy logs of 64-bit numbers expand 2 to 20 times and encoder
counts of an arm at rest some 100 times. Zeros expand 1000 times: a file of 2 MB can fill 2 GB."""
SMALL_CONTENT = 64 << 20
"""Content (bytes) that any archive may expand to, whatever its ratio: so little does no harm."""
LARGEST_DESCRIPTION = 10_000_000
"""Largest file (bytes) that a person writes: robot, experiment, study, URDF. Parsed TOML takes some 20 times its bytes."""
BLOCK = 1 << 20
"""Bytes that are read or expanded in one step."""
GB = 1e9
"""Bytes of a gigabyte."""


@dataclass
class Run:
    """Files of one run of a command.

    Attributes
    ----------
    read : dict
        Files that were read, as keys in order.
    outputs : dict
        Files that will be written, as keys in order.
    """

    read: dict[Path, None] = field(default_factory=dict)
    outputs: dict[Path, None] = field(default_factory=dict)


_RUN: ContextVar[Run | None] = ContextVar("run", default=None)


@contextmanager
def one_run() -> Iterator[Run]:
    """Compare every output with every input within this context, in either order of use."""
    run = Run()
    token = _RUN.set(run)
    try:
        yield run
    finally:
        _RUN.reset(token)


def note_input(path: Path) -> None:
    """Record an input file.

    Raises
    ------
    OutputError
        When it is an output of this run.
    """
    run = _RUN.get()
    if run is None:
        return
    for output in run.outputs:
        _refuse_same(output, path)
    run.read[path] = None


def note_output(path: Path) -> None:
    """Record an output file.

    Raises
    ------
    OutputError
        When this run has read it, by whatever name or link.
    """
    run = _RUN.get()
    if run is None:
        return
    for source in run.read:
        _refuse_same(path, source)
    run.outputs[path] = None


def _refuse_same(output: Path, source: Path) -> None:
    if not same_file(output, source):
        return
    name = "it" if str(output) == str(source) else f"it is '{source}', which"
    raise OutputError(f"cannot write '{output}': {name} is read by the same command and would be lost")


def same_file(one: Path, other: Path) -> bool:
    """Whether two paths lead to one file: by links of either kind, or by two spellings of a path that does not exist."""
    try:
        return os.path.samefile(one, other)
    except (OSError, ValueError):  # one of them does not exist, or is not a valid file name
        with suppress(OSError, ValueError):
            return os.path.realpath(one) == os.path.realpath(other)
        return False


def read_file(
    path: Path, error: type[DidimError], missing: str = "no such file", *, copies: int = 1
) -> bytes:
    """Read a whole file.

    Parameters
    ----------
    path : Path
        The file. Links are followed.
    error : type
        Class of the error to raise.
    missing : str
        Noun for a missing file in the message.
    copies : int
        Smallest ratio of the memory while reading to the file's size.

    Raises
    ------
    DidimError
        Of class `error`, for what is not a regular file (a device has no end, a pipe may wait for ever), is larger than the free
        memory, or cannot be read.
    OutputError
        For an output of the same run.
    """
    check_input(path, error, missing, copies=copies)
    with readable(path, error):
        try:
            return path.read_bytes()
        except MemoryError:
            raise error(f"{path}: there is no memory for its {path.stat().st_size / GB:.3g} GB") from None


@contextmanager
def readable(path: Path, error: type[DidimError]) -> Iterator[None]:
    """Raise what the system says against reading a file as an error of this class, with the file."""
    try:
        yield
    except OSError as reason:
        raise error(f"{path}: cannot be read ({reason.strerror})") from None


def check_input(
    path: Path, error: type[DidimError], missing: str = "no such file", *, copies: int = 1
) -> int:
    """Check a file before it is opened, record it as an input, and return its size (bytes).

    Parameters and errors as of `read_file`.
    """
    try:
        status = path.stat()
    except FileNotFoundError:
        raise error(f"{path}: {missing}") from None
    except OSError as reason:
        raise error(f"{path}: cannot be read ({reason.strerror})") from None
    except ValueError as reason:  # a zero byte in the name
        raise error(f"{str(path)!r} is not a file name ({reason})") from None
    if stat.S_ISDIR(status.st_mode):
        raise error(f"{path}: cannot be read ({os.strerror(errno.EISDIR)})")
    if not stat.S_ISREG(status.st_mode):
        raise error(f"{path}: cannot be read (it is {_kind(status.st_mode)}; save its content as a file)")
    check_memory(copies * status.st_size, str(path), error)
    note_input(path)
    return status.st_size


def _kind(mode: int) -> str:
    if stat.S_ISFIFO(mode):
        return "a pipe"
    return "a socket" if stat.S_ISSOCK(mode) else "a device"


def read_small_file(path: Path, error: type[DidimError], missing: str = "no such file") -> bytes:
    """Read a hand-written file of at most `LARGEST_DESCRIPTION` bytes. Errors as of `read_file`."""
    size = check_input(path, error, missing)
    if size > LARGEST_DESCRIPTION:
        raise error(
            f"{path}: it has {size / 1e6:.0f} MB, and descriptions have at most {LARGEST_DESCRIPTION / 1e6:.0f}; is it a log?"
        )
    return read_file(path, error, missing)


def first_lines(path: Path, error: type[DidimError], count: int, longest: int) -> list[bytes]:
    """Return the first lines of a log with their ends, each of at most `longest` bytes. Errors as of `read_file`."""
    check_input(path, error, "no such data file")
    with readable(path, error), path.open("rb") as file:
        return [file.readline(longest) for _ in range(count)]


# Memory.


def free_memory() -> int | None:
    """Return the memory (bytes) available to this process; None if unknown."""
    limits = []
    with suppress(OSError, ValueError, IndexError):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        sizes = {line.split(":")[0]: 1024 * int(line.split()[1]) for line in lines}
        limits.append(sizes.get("MemAvailable", 0) + sizes.get("SwapFree", 0))
    with suppress(ImportError, OSError, ValueError, IndexError):
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
            limits.append(limit - pages * resource.getpagesize())
    return max(0, min(limits)) if limits else None


def check_memory(size: int, where: str, error: type[DidimError]) -> None:
    """Refuse content that is larger than the free memory (bytes)."""
    free = free_memory() if size > SMALL_CONTENT else None
    if free is not None and size > free:
        raise error(
            f"{where}: reading it takes {size / GB:.3g} GB of memory, and {free / GB:.3g} GB are free"
        )


# Archives.


def check_expanded(size: int, packed: int, where: str, error: type[DidimError]) -> None:
    """Refuse an archive with a suspicious compression ratio, or with content that does not fit memory.

    Parameters
    ----------
    size : int
        Bytes of the content, as its headers declare them.
    packed : int
        Bytes of the file.
    where : str
        Name of the file in messages.
    error : type
        Class of the error to raise.
    """
    if size > max(SMALL_CONTENT, LARGEST_EXPANSION * packed):
        raise error(
            f"{where}: its {packed} bytes declare a content of {size:.3g} bytes, more than {LARGEST_EXPANSION} times as many"
        )
    check_memory(size, where, error)


def open_npz(raw: bytes, where: str, error: type[DidimError]) -> Any:
    """Open an npz archive as `numpy.load` does, for a ``with`` statement.

    Raises
    ------
    DidimError
        Of class `error`, when its compression ratio is suspicious (`check_expanded`).
    Exception
        Any, for invalid bytes.
    """
    # Imported late, to speed up commands without archives.
    import zipfile

    import numpy as np

    size = 0
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        for entry in archive.infolist():
            size += max(entry.file_size, _declared(archive, entry))
    check_expanded(size, len(raw), where, error)
    return np.load(io.BytesIO(raw), allow_pickle=False)


def _declared(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> int:
    """Return the bytes of an array as 64-bit numbers, by its header; 0 for a damaged one, which fails when it is read."""
    from numpy.lib import format as npy

    try:
        with archive.open(entry) as file:
            first = npy.read_magic(file) == (1, 0)
            shape, _, dtype = (npy.read_array_header_1_0 if first else npy.read_array_header_2_0)(file)
            return prod(shape) * max(dtype.itemsize, 8)
    except Exception:  # encrypted, truncated, or with an unknown compression
        return 0
