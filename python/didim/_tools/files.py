"""Writing of result files: atomic, checked before the work, and with a fallback location."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import tempfile
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

from ..errors import OutputError
from .inputs import note_output


def write_atomically(path: Path, content: str | bytes, made_of: Iterable[str] = ()) -> None:
    """Write a file atomically: neither a reader nor a crash sees a part of it.

    Several threads and processes may write to one path: each writes a temporary file, and the last one wins.

    Parameters
    ----------
    path : Path
        A link is followed; a pipe or a terminal is written to directly. An existing file keeps its mode.
    content : str or bytes
        Text is written as UTF-8. Other bytes of file names become escapes, which JSON restores.
    made_of : iterable of str
        SHA-256 of the input files of the content.

    Raises
    ------
    OutputError
        When the file is an input of the content, or was read by the same command.
    OSError
        When the folder is missing or not writable, or the disk is full; ``filename`` is the path.
    """
    data = content.encode(errors="backslashreplace") if isinstance(content, str) else content
    note_output(path)
    keep_sources(path, made_of)
    _require_end(path)
    try:
        if path.exists() and not path.is_file():
            # A pipe without a reader is an error (ENXIO) instead of a wait without end.
            impatient = getattr(os, "O_NONBLOCK", 0)  # Windows has none
            handle = os.open(path, os.O_WRONLY | impatient)
            with os.fdopen(handle, "wb") as file:
                if impatient:
                    os.set_blocking(handle, True)
                file.write(data)
            return
        target = Path(os.path.realpath(path))
        _require_folder(path, target)
        _write_beside(target, data)
    except OSError as error:
        if error.errno is None:
            raise
        if error.errno == errno.ENXIO:
            raise OSError(errno.ENXIO, "it is a pipe that nobody reads", str(path)) from None
        # The system's message names the temporary file, or none.
        raise OSError(error.errno, os.strerror(error.errno), str(path)) from None


def path_from(folder: Path, path: str | Path) -> str:
    """Return a path as a file in `folder` names it, with slashes; the whole path on another drive of Windows."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return Path(path).absolute().as_posix()


def keep_sources(path: Path, made_of: Iterable[str]) -> None:
    """Refuse to overwrite a file whose SHA-256 is one of these inputs (``test_outputs.py``)."""
    digests = frozenset(made_of)
    if not digests or not path.is_file():
        return
    from hashlib import file_digest

    with path.open("rb") as file:
        same = file_digest(file, "sha256").hexdigest() in digests
    if same:
        raise OutputError(
            f"cannot write '{path}': the result was computed from this file, which would be lost"
        )


def check_output(path: Path) -> None:
    """Refuse a path that cannot be written, before the work.

    Raises
    ------
    OutputError
        When the same command reads this file, by whatever name or link.
    OSError
        When the path is a folder, its folder is missing, its links lead in a circle, or files cannot be created there
        (``test_outputs.py``).
    """
    note_output(path)
    _require_end(path)
    if path.is_dir():
        raise IsADirectoryError(f"cannot write '{path}': it is a folder")
    if path.exists() and not path.is_file():
        return
    target = Path(os.path.realpath(path))
    _require_folder(path, target)
    if path.exists() and not os.access(path, os.W_OK):
        raise PermissionError(f"cannot write '{path}': it is write-protected")
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name[:50]}.", suffix=".tmp", dir=target.parent)
    except OSError as error:
        raise type(error)(f"cannot write '{path}': {error.strerror}") from None
    os.close(handle)
    Path(name).unlink(missing_ok=True)


def write_elsewhere(path: Path, write: Callable[[Path], None]) -> Path | None:
    """Write a file that failed at `path` to the current folder, or else to the folder for temporary files.

    Parameters
    ----------
    path : Path
        Path with the name; a number is added if it is in use.
    write : callable
        Function that writes the file to a path.

    Returns
    -------
    Path or None
        Path of the written file; None if this failed too.
    """
    for folder_of in (Path.cwd, tempfile.gettempdir):
        # The folder was removed or is not writable, all names are in use, or the writer fails.
        with contextlib.suppress(Exception):
            named = (Path(folder_of()) / f"{path.stem}-{number}{path.suffix}" for number in range(1, 1000))
            target = next(target for target in named if not target.exists())
            write(target)
            return target
    return None


def _require_end(path: Path) -> None:
    """Refuse circular links: replacing them would create another file than intended."""
    if path.is_symlink():
        try:
            path.stat()
        except FileNotFoundError:  # a link to a file that does not exist yet
            return
        except OSError as error:
            raise OSError(f"cannot write '{path}': {error.strerror}") from None


def _require_folder(path: Path, target: Path) -> None:
    if not target.parent.is_dir():
        raise FileNotFoundError(f"cannot write '{path}': there is no folder '{target.parent}'")


def _write_beside(target: Path, data: bytes) -> None:
    """Write to a temporary file in the same folder, which then replaces `target`; a loss of power keeps one or the other."""
    try:
        mode = stat.S_IMODE(target.stat().st_mode)
    except FileNotFoundError:
        mode = 0o666 & ~_umask()
    handle, name = tempfile.mkstemp(prefix=f".{target.name[:50]}.", suffix=".tmp", dir=target.parent)
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(handle)
        temporary.chmod(mode)
        temporary.replace(target)
        # Some systems cannot open a folder, and sync the names in it by themselves.
        with contextlib.suppress(OSError):
            handle = os.open(target.parent, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
    finally:
        temporary.unlink(missing_ok=True)


@cache
def _umask() -> int:
    """Return the file mode creation mask. It can only be read by setting it, so it is read once."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
