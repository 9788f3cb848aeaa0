"""``didim robots``, ``didim methods``, ``didim schema`` and ``didim example``: lists of the package's content.

An example is a folder whose README lists the commands. Tested in ``tests/test_example.py``.
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

from .._tools.files import check_output, write_atomically
from .._tools.words import columned, did_you_mean, listing, series
from ..errors import ExampleError
from .options import Commands, add_command, add_flag, add_option, refuse
from .outputs import Saved
from .terminal.width import columns

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


def add(commands: Commands) -> None:
    """Add the commands and their options."""
    add_command(commands, "robots", robots, "list the packaged robots")
    add_command(commands, "methods", methods, "list the methods of identification")
    parser = add_command(
        commands,
        "schema",
        schema,
        "print every key of the files",
        "didim schema robot",
        "didim schema experiment --json > didim.schema.json",
    )
    add_option(
        parser,
        "file FILE",
        "robot, experiment, study or excitation (default: all, one after the other)",
        choices=("robot", "experiment", "study", "excitation"),
        nargs="?",
    )
    add_flag(parser, "--json", "as a JSON schema, for editors that complete and check TOML files")
    parser = add_command(commands, "example", example, "copy an example, with the commands to run")
    add_option(parser, "name NAME", "example (default: list them)", nargs="?")
    add_option(parser, "-o --output FOLDER", "where to (default: a folder NAME, here)", Path)
    add_flag(parser, "--force", "overwrite files that are there already")


def robots(_: argparse.Namespace) -> int:
    """Run ``didim robots``."""
    from ..robot.robot_file import packaged_robots

    packaged = packaged_robots()
    width = max(len(name) for name in packaged)
    lines, identified = [f"{'robot':{width}}  joints  base parameters  description"], []
    for name, robot in packaged.items():
        sets = f"; sets {', '.join(robot.sets)}" if robot.sets else ""
        lines.append(
            f"{name:{width}}  {robot.n_dof:6}  {len(robot.base_parameters.names):15}  {robot.description}{sets}"
        )
        identified += [f"{name}, set {key!r}, {origin}" for key, origin in robot.origins.items()]
    end = "`didim robot NAME` prints the rows of one. A robot file or a URDF can take the place of a name."
    return Saved().end("\n".join([*lines, *(f"\n{text}" for text in identified), "", end]))


def methods(_: argparse.Namespace) -> int:
    """Run ``didim methods``."""
    from ..methods.table import METHODS

    lines = columned([(row.name, row.line) for row in METHODS.values()], left=2)
    end = "`didim identify EXPERIMENT.toml --method NAME` runs one; NAME may be module:Class, a method of your own."
    return Saved().end("\n".join([*lines, "", end]))


def schema(options: argparse.Namespace) -> int:
    """Run ``didim schema``."""
    from .schema import FILES, json_schema, listed, page

    files = [file for file in FILES if options.file in (None, file)]
    if options.json:
        return Saved().end(
            json.dumps(json_schema(options.file or "any"), indent=2, ensure_ascii=False), exact=True
        )
    if columns() is None:
        pages = "\n".join(f"## The {file} file\n\n{page(file)}" for file in files)
        return Saved().end(pages.rstrip("\n"), exact=True)
    return Saved().end("\n\n".join(listed(file) for file in files))


def example(options: argparse.Namespace) -> int:
    """Run ``didim example``."""
    if options.name is None:
        if options.output is not None:
            return refuse("-o needs the name of an example: didim example tx40 -o FOLDER")
        lines = columned(list(packaged_examples().items()), left=2)
        end = "didim example NAME copies the files of one into a folder NAME."
        return Saved().end("\n".join([*lines, "", end]))
    folder = options.output or Path(options.name)
    written = copy_example(options.name, folder, force=options.force)
    saved = Saved()
    saved.show(f"{folder}: {', '.join(path.name for path in written)}\n\nNow run:\n")
    # Commands are not wrapped, because they are copied.
    return saved.end("\n".join([f"cd {folder}", *example_commands(options.name)]), exact=True)
