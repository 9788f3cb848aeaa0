"""``didim robots``, ``didim methods`` and ``didim schema``: what there is."""

from __future__ import annotations

import argparse
import inspect
import json
from typing import TYPE_CHECKING

from .options import CONVERGED, add_command, refuse

if TYPE_CHECKING:
    from .options import Commands


def add(commands: Commands) -> None:
    """Add the commands and their options."""
    add_command(commands, "robots", robots, "list the packaged robots")
    add_command(commands, "methods", methods, "list the methods of identification")
    parser = add_command(commands, "schema", schema, "print every key of robot and experiment files")
    parser.add_argument(
        "file",
        choices=("robot", "experiment"),
        nargs="?",
        help="kind of file (default: both, one after the other)",
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="as a JSON schema, for editors that check TOML files; needs the kind of file",
    )


def robots(_: argparse.Namespace) -> int:
    """Run ``didim robots``."""
    from ..robot.robot_file import packaged_robots

    found = packaged_robots()
    width = max(len(name) for name in found)
    print(f"{'robot':{width}}  joints  base parameters  description")
    for name, robot in found.items():
        sets = f"; sets {', '.join(robot.sets)}" if robot.sets else ""
        print(
            f"{name:{width}}  {robot.n_dof:6}  {len(robot.base_parameters.names):15}  {robot.description}{sets}"
        )
    print("\ndidim robot NAME prints the rows of one; any robot file or URDF serves as well as a name.")
    return CONVERGED


def methods(_: argparse.Namespace) -> int:
    """Run ``didim methods``."""
    from ..methods.identify import METHODS, method_class

    width = max(len(name) for name in METHODS)
    for name in METHODS:
        made = method_class(name)
        # A method from outside the package may have no summary.
        text = getattr(made, "summary", (inspect.getdoc(made) or "").partition("\n")[0])
        print(f"{name:{width}}  {text}")
    print("\ndidim identify EXPERIMENT.toml --method NAME runs one.")
    return CONVERGED


def schema(options: argparse.Namespace) -> int:
    """Run ``didim schema``."""
    from ..experiment.schema import FILES, json_schema, page

    if options.json:
        if options.file is None:
            return refuse("--json needs the kind of file: didim schema experiment --json")
        print(json.dumps(json_schema(options.file), indent=2, ensure_ascii=False))
        return CONVERGED
    print(
        "\n".join(f"## The {file} file\n\n{page(file)}" for file in FILES if options.file in (None, file)),
        end="",
    )
    return CONVERGED
