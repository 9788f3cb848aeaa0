"""``didim view``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .options import CONVERGED, Commands, add_command, add_data, add_option, tell
from .terminal.messages import message

if TYPE_CHECKING:
    from .._tools.arrays import Array
    from ..experiment.experiment import Experiment
    from ..robot.robot import Robot
    from ..view.playback import Playback
    from ..view.shapes import Shape


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "view",
        run,
        "show a robot, its motion and its inertias in a browser",
        "didim view arm.urdf --meshes ~/robots",
        "didim view log.toml --parameters fit.json",
        "didim view fit.json",
        "didim view motion.csv --robot ur5e",
    )
    add_option(
        parser,
        "what ROBOT|EXPERIMENT.toml|FIT.json|MOTION.csv",
        "a packaged robot, robot file, URDF or MJCF; an experiment, whose log is played; a result; a motion",
    )
    add_option(parser, "--robot ROBOT", "robot of a motion, or of a result whose robot file is elsewhere")
    add_data(parser)
    add_option(
        parser,
        "--parameters FILE|NAME",
        "result (.json) or parameters (.toml, .npz), or a parameter set: bodies, residual and simulated motion",
    )
    add_option(parser, "--motion FILE.csv", "motion to play, as didim excite writes it", Path)
    add_option(
        parser, "--meshes FOLDER", "folder of packages that hold meshes", Path, action="append", default=[]
    )
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to serve at (default: %(default)s, this machine only)"
    )
    parser.add_argument("--port", type=int, default=8080, help="port to serve at (default: %(default)s)")


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..view.page import Page

    robot, shapes, playbacks, notes = contents(options)
    page = Page(robot, shapes, playbacks, options.host, options.port)
    for note in notes:
        message(note, "warning")
    tell([f"{robot.name}: open {page.url} in a browser; Ctrl-C ends"])
    page.play()
    return CONVERGED


def contents(options: argparse.Namespace) -> tuple[Robot, list[Shape], list[Playback], list[str]]:
    """Return the robot, its shapes and motions, and sentences on missing items."""
    from .._tools.toml import read_toml
    from ..errors import ExperimentError, RobotError
    from ..experiment.experiment_file import load_experiment
    from ..view import playback, shapes
    from ..view.visuals import visuals

    what, kind = options.what, _kind(options)
    if kind == ".csv" and options.robot is None:
        raise RobotError(f"{what}: which robot moves like this? Say --robot ROBOT")
    for option, value, useless in (
        ("--robot", options.robot, kind not in (".json", ".csv")),
        ("--parameters", options.parameters, kind == ".json"),
        ("--motion", options.motion, kind == ".csv"),
    ):
        if value is not None and useless:
            raise RobotError(f"{option} {value} has no place beside '{what}': leave it out")
    path, experiment = Path(what), None
    # Unlike a robot file, an experiment names a robot.
    if kind == ".toml" and "robot" in read_toml(path, ExperimentError):
        experiment = load_experiment(path, data=options.data)
    robot, x, notes = _robot_and_parameters(options, experiment)
    motion = path if kind == ".csv" else options.motion
    drawn = [*shapes.skeleton(robot), *shapes.capsules(robot.collision)]
    urdf = robot.path
    if robot.correspondence is not None and urdf.suffix.lower() != ".urdf":
        urdf = urdf.with_name(robot.correspondence.file)
    if robot.correspondence is not None and urdf.suffix.lower() == ".urdf" and urdf.is_file():
        meshes, missing = visuals(robot, urdf, tuple(options.meshes))
        drawn += meshes
        notes += missing[:1] + (
            [f"{len(missing) - 1} further meshes were not found"] if len(missing) > 1 else []
        )
    if "urdf" in robot.sets:
        bodies, _ = shapes.bodies(robot, robot.parameter_set("urdf"), "prior", shapes.PRIOR)
        drawn += bodies
    if x is not None:
        bodies, refused = shapes.bodies(robot, x, "estimate", shapes.ESTIMATE)
        drawn += bodies
        notes += refused
    motions: list[Playback] = []
    if motion is not None:
        motions.append(playback.of_file(motion, robot))
    elif experiment is not None:
        motions, more = playback.of_log(experiment, options.parameters)
        notes += more
    return robot, drawn, motions, notes


def _kind(options: argparse.Namespace) -> str:
    return Path(options.what).suffix.lower()


def _robot_and_parameters(
    options: argparse.Namespace, experiment: Experiment | None
) -> tuple[Robot, Array | None, list[str]]:
    """Return the robot, the standard parameters to draw, if any, and sentences on them.

    Those of a result are made physically consistent, because only these define bodies.
    """
    from ..export.source import exported_parameters
    from ..robot.robot_file import load_robot
    from ..studies.run import standard_parameters

    if _kind(options) == ".json":
        result = exported_parameters(fit=Path(options.what), parameters=None, robot=options.robot, urdf=None)
        return result.robot, result.x, list(result.notes)
    named = options.robot if _kind(options) == ".csv" else options.what
    robot = load_robot(named) if experiment is None else experiment.robot
    if options.parameters is None:
        return robot, None, []
    if not options.parameters.endswith(".json"):
        return robot, standard_parameters(robot, options.parameters), []
    result = exported_parameters(
        fit=Path(options.parameters), parameters=None, robot=str(robot.path), urdf=None
    )
    return robot, result.x[: len(robot.parameter_names)], list(result.notes)
