"""``didim robots``, ``didim methods``, ``didim schema`` and ``didim example``: lists of the package's content."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from .._tools.words import columned
from .options import Commands, add_command, add_flag, add_option, refuse
from .outputs import Saved
from .terminal.width import columns


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
    from .examples import copy_example, example_commands, packaged_examples

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
