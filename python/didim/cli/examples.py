"""Included examples: folders whose README lists the commands. Tested in ``tests/test_example.py``."""

from __future__ import annotations

import re
from pathlib import Path

from .._tools.files import check_output, write_atomically
from .._tools.words import did_you_mean, listing, series
from ..errors import ExampleError

FOLDER = Path(__file__).parents[1] / "packaged" / "examples"
README = "README.md"


def packaged_examples() -> dict[str, str]:
    """Return the first line of each example's README, by name."""
    readmes = sorted(FOLDER.glob(f"*/{README}"))
    return {path.parent.name: _readme(path.parent).partition("\n")[0].removeprefix("# ") for path in readmes}


def example_commands(name: str) -> list[str]:
    """Return the commands of an example in order."""
    return re.findall(r"^    (\S.*)$", _readme(_example(name)), flags=re.MULTILINE)


def copy_example(name: str, folder: Path, *, force: bool = False) -> list[Path]:
    """Copy the files of an example.

    Parameters
    ----------
    name : str
        One of `packaged_examples`.
    folder : Path
        Target folder, created if missing; other files in it do not change.
    force : bool
        Overwrite existing files.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    ExampleError
        When there is no such example, or one of its files exists.
    """
    source = _example(name)
    # Files compiled by an installer are not part of an example.
    files = sorted(path for path in source.iterdir() if path.is_file())
    there = [path.name for path in files if (folder / path.name).exists()]
    if there and not force:
        raise ExampleError(
            f"{folder}: it has {listing(there)} already; --force overwrites, -o takes another folder"
        )
    folder.mkdir(parents=True, exist_ok=True)
    for path in files:
        check_output(folder / path.name)
    for path in files:
        write_atomically(folder / path.name, path.read_bytes())
    return [folder / path.name for path in files]


def _example(name: str) -> Path:
    known = packaged_examples()
    if name not in known:
        near = did_you_mean(name, known)
        raise ExampleError(f"there is no example {name!r}{near} (there are: {series(known, 60)})")
    return FOLDER / name


def _readme(folder: Path) -> str:
    return (folder / README).read_text(encoding="utf-8")
