"""``didim view``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..options import CONVERGED, Commands, add_command, add_data, add_option, tell
from ..terminal.messages import message

if TYPE_CHECKING:
    from ..._tools.arrays import Array
    from ...experiment.experiment import Experiment
    from ...robot.robot import Robot
    from ...view.playback import Playback
    from ...view.shapes import Shape


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
    from ...view.page import Page

    robot, shapes, playbacks, notes = contents(options)
    page = Page(robot, shapes, playbacks, options.host, options.port)
    for note in notes:
        message(note, "warning")
    tell([f"{robot.name}: open {page.url} in a browser; Ctrl-C ends"])
    page.play()
    return CONVERGED


def contents(options: argparse.Namespace) -> tuple[Robot, list[Shape], list[Playback], list[str]]:
    """Return the robot, its shapes and motions, and sentences on missing items."""
    from ...view import playback, shapes
    from ...view.visuals import visuals

    _check(options)
    experiment = _experiment(options)
    robot, x, notes = _robot_and_parameters(options, experiment)
    motion = Path(options.what) if _kind(options) == ".csv" else options.motion
    drawn = [*shapes.skeleton(robot), *shapes.capsules(robot.collision)]
    urdf = _urdf_of(robot)
    if urdf is not None:
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


def _check(options: argparse.Namespace) -> None:
    """Refuse a motion without a robot, and options that what is shown leaves no place for."""
    from ...errors import RobotError

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


def _robot_and_parameters(
    options: argparse.Namespace, experiment: Experiment | None
) -> tuple[Robot, Array | None, list[str]]:
    """Return the robot, the standard parameters to draw, if any, and sentences on them.

    Those of a result are made physically consistent, because only these define bodies.
    """
    from ...export.source import exported_parameters
    from ...robot.robot_file import load_robot
    from ...studies.run import standard_parameters

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


def _experiment(options: argparse.Namespace) -> Experiment | None:
    """Return the experiment if the file is one: unlike a robot file it names a robot."""
    from ..._tools.toml import read_toml
    from ...errors import ExperimentError
    from ...experiment.experiment_file import load_experiment

    path = Path(options.what)
    if path.suffix.lower() != ".toml" or "robot" not in read_toml(path, ExperimentError):
        return None
    return load_experiment(path, data=options.data)


def _urdf_of(robot: Robot) -> Path | None:
    """Return the URDF that a robot was read from, if it exists."""
    if robot.correspondence is None:
        return None
    path = (
        robot.path
        if robot.path.suffix.lower() == ".urdf"
        else robot.path.with_name(robot.correspondence.file)
    )
    return path if path.suffix.lower() == ".urdf" and path.is_file() else None
