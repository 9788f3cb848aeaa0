"""Reader of experiment files: a robot, its recordings, and their processing, in one TOML file.

A new log needs a file but no Python. Every key is checked, and each message names the file, the table and the
key. Tested in ``tests/test_experiment.py``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

from .._tools.inputs import read_small_file
from .._tools.keys import declared
from .._tools.plugins import search_beside
from .._tools.toml import Table, read_toml
from .._tools.words import series
from ..errors import ExperimentError
from ..log.data_file import is_log
from ..log.data_folder import DataFolder, expanded
from ..log.recording import Recording
from ..log.recording_file import read_recording, read_reduction
from ..log.sampling import TimeFault
from ..regression.settings import LeastSquaresSettings
from ..robot.payload import Payload, carrying_joint, read_flange, read_payload
from ..robot.robot import Robot
from ..robot.robot_file import PACKAGED, load_robot
from ..signal.processing import SignalProcessing
from ..signal.window import DelaySettings
from .experiment import Experiment
from .loop_tables import read_controller, read_measurement, read_reference, read_simulation
from .specs import SimulationSettings
from .unknown import read_unknown

SINCE_0_1_0 = {"ends": '"first-order"', "edge_rows": "0"}
"""Keys of ``[signal]`` that are newer than 0.1.0, with the values that reproduce its digits; the defaults differ."""

_Settings = TypeVar("_Settings")


def load_experiment(
    path: str | Path, *, data: Path | str | None = None, faults: list[tuple[str, TimeFault]] | None = None
) -> Experiment:
    """Read an experiment file and all the files it names.

    Tested in ``tests/test_experiment.py``.

    Parameters
    ----------
    path
        Experiment .toml.
    data
        Folder of the data files; by default that of the experiment file.
    faults
        For `didim.check`: list that receives faults of time stamps, which then do not raise an error.

    Returns
    -------
    Experiment
        Robot, recordings (joint side, SI units) and settings.

    Raises
    ------
    ExperimentError
        On a wrong key, value or combination.
    RobotError
        On a wrong robot file.
    RecordingError
        On a data file that contradicts the experiment.
    """
    path = Path(path)
    # A file of another kind is refused by its name, with the command for it.
    kind = path.suffix.lower()
    if kind == ".json":
        raise ExperimentError(
            f"{path}: this is a result, not an experiment: `didim validate {path} EXPERIMENT.toml` tries it on a log"
        )
    if is_log(path):
        raise ExperimentError(
            f"{path}: this is a log, not an experiment; `didim init ROBOT {path}` writes an experiment file for it"
        )
    if kind == ".urdf":
        raise ExperimentError(_other_kind(path, "robot"))
    content = read_toml(path, ExperimentError)
    search_beside(content.get("friction"), path)
    if "joint" in content and "robot" not in content:
        raise ExperimentError(_other_kind(path, "robot file"))
    digests = {f"experiment {path.name}": hashlib.sha256(read_small_file(path, ExperimentError)).hexdigest()}
    return read_experiment(content, path, data=data, faults=faults, digests=digests)


def experiment_of(log: object, robot: Robot | str | Path | None = None) -> Experiment:
    """Return an experiment, given itself, its file, or recordings of a robot.

    Raises
    ------
    ExperimentError
        For a recording without its robot, an experiment with a robot, and any other argument (``test_from_arrays.py``).
    """
    recordings = [log] if isinstance(log, Recording) else log
    if isinstance(recordings, list | tuple) and all(isinstance(each, Recording) for each in recordings):
        if robot is None or not recordings:
            raise ExperimentError(
                "a recording does not name its robot: give robot=didim.load_robot(...) with it, or an Experiment"
            )
        return Experiment.from_recordings(robot, recordings)
    if isinstance(log, Experiment | str | Path):
        if robot is not None:
            raise ExperimentError("an experiment has its robot already: leave out robot")
        return log if isinstance(log, Experiment) else load_experiment(log)
    raise ExperimentError(
        f"a log is an Experiment, the path of its file or a Recording with robot=..., got {type(log).__name__}; "
        "didim.Experiment.from_arrays(robot, q, tau, rate_hz=...) takes arrays"
    )


def _other_kind(path: Path, kind: str) -> str:
    return f"{path}: this is a {kind}, not an experiment; `didim init {path} LOG` writes an experiment for a log of it"


def read_experiment(
    content: Mapping[str, Any],
    path: Path,
    *,
    robot: Robot | None = None,
    data: Path | str | None = None,
    faults: list[tuple[str, TimeFault]] | None = None,
    digests: Mapping[str, str] | None = None,
) -> Experiment:
    """Make an experiment from the content of an experiment file; the file itself need not exist.

    Parameters
    ----------
    content
        Tables of the file, as parsed by `tomllib`.
    path
        Name of the file in messages; paths in the content are relative to its folder.
    robot
        Robot that replaces the one named in the content, without the experiment's friction.
    data, faults
        As for `load_experiment`.
    digests
        Digest of the content, for the record of results; those of the files read are added.

    Raises
    ------
    ExperimentError, RobotError, RecordingError
        As for `load_experiment`.
    """
    table = Table(content, path.name, ExperimentError, keys=declared("experiment"))
    table.check_schema()
    questions = table.texts("open")
    if questions:
        table.fail(f"not finished, open is: {questions[0]} Then delete open")
    name = table.text("name", path.stem)
    robot = _robot(table, path, robot)
    transmission = table.table("transmission", None)
    recording_tables = table.tables("recording")
    settings = _tables(table, robot)
    if not recording_tables and settings["reference"] is None:
        table.fail("there is neither a [[recording]] to read nor a [reference] to simulate")
    table.done()

    reduction = read_reduction(transmission, robot.reduction, robot.n_dof)
    folder = DataFolder(Path(path.parent if data is None else data))
    recordings: list[Recording] = []
    for i, part in enumerate(recording_tables):
        for expanded_part, title in expanded(part, f"recording {i + 1}", folder.folder):
            recording = read_recording(expanded_part, title, robot, reduction, folder, faults)
            if recording.name in [other.name for other in recordings]:
                expanded_part.fail(f"name {recording.name!r} is already used by an earlier recording")
            recordings.append(recording)

    # An experiment and a robot may both be emps.toml.
    every = {**(digests or {}), f"robot {robot.path.name}": robot.digest}
    for recording in recordings:
        every |= {f"data {file}": digest for file, digest in recording.digests.items()}
    return Experiment(
        name=name,
        path=path,
        robot=robot,
        recordings=tuple(recordings),
        digests=every,
        remarks=_changed_defaults(content),
        **settings,
    )


def _tables(table: Table, robot: Robot) -> dict[str, Any]:
    """Return the attributes of an `Experiment` that are tables of the file."""
    signal = _settings(table.part("signal"), SignalProcessing)
    least_squares = _settings(table.part("least_squares"), LeastSquaresSettings)
    delay = _settings(table.part("delay"), DelaySettings, _delay_keys)
    fixed, dropped, links = _parameters(table.part("parameters"))
    unknown = _optional(table, "unknown", robot, read_unknown) or {}
    if unknown and links != "fixed":
        table.fail('[unknown] is for known links: [parameters] links = "fixed"')
    return {
        "signal": signal,
        "least_squares": least_squares,
        "delay": delay,
        "fixed": fixed,
        "dropped": dropped,
        "links": links,
        "unknown": unknown,
        "reference": _optional(table, "reference", robot, read_reference),
        "controller": _optional(table, "controller", robot, read_controller),
        "simulation": _optional(table, "simulation", robot, read_simulation) or SimulationSettings(),
        "measurement": _optional(table, "measurement", robot, read_measurement),
        "flange": None if (part := table.table("flange", None)) is None else read_flange(part),
        "payloads": _payloads(table.part("payload"), robot),
    }


def _changed_defaults(content: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a sentence on a recipe that reproduces published digits, if it lacks keys whose defaults have changed since 0.1.0.

    Files with filters of their own do not get the sentence.
    """
    signal = content.get("signal", {})
    recipe = [
        f'{key} = "matlab"' for key in ("padding", "decimation_convention") if signal.get(key) == "matlab"
    ]
    lacking = [f"{key} = {value}" for key, value in SINCE_0_1_0.items() if key not in signal]
    if "decimation" not in signal:
        lacking = [text for text in lacking if not text.startswith("edge_rows")]
    if not recipe or not lacking or "signal" not in content:
        return ()
    return (
        f"[signal] has {recipe[0]} and lacks {series(lacking, 80)}, the defaults of 0.1.0 that its digits need; "
        "write them to end this note",
    )


def _payloads(table: Table, robot: Robot) -> dict[str, Payload]:
    """Read the tables ``[payload.NAME]``."""
    payloads = {}
    for name in table.content:
        part = table.table(name)
        payloads[name] = part.checked(partial(read_payload, part, name))
        part.checked(partial(carrying_joint, robot, payloads[name]))
    table.done()
    return payloads


def _optional(
    table: Table, key: str, robot: Robot, read: Callable[[Table, Robot], _Settings]
) -> _Settings | None:
    part = table.table(key, None)
    return None if part is None else read(part, robot)


def robot_place(name: str, folder: Path) -> str | Path:
    """Return the argument of `load_robot` for an experiment in `folder`: an included name, or a file beside it."""
    # Any other name is a file beside the experiment, and messages suggest files there.
    return name if (PACKAGED / f"{name}.toml").is_file() else folder / name


def _robot(table: Table, path: Path, given: Robot | None) -> Robot:
    """Load the robot, by included name or path relative to the experiment file, with the experiment's friction."""
    name = table.text("robot")
    robot = load_robot(robot_place(name, path.parent)) if given is None else given
    friction = table.table("friction", None)
    robot = robot if friction is None else robot.with_friction_table(friction)
    springs = table.table("springs", None)
    return robot if springs is None else robot.with_spring_table(springs)


def _settings(
    table: Table, make: Callable[..., _Settings], read: Callable[[Table], dict[str, Any]] = Table.given
) -> _Settings:
    """Make settings from a table; errors are prefixed by its name."""
    options = read(table)
    table.done()
    return table.checked(lambda: make(**options))


def _delay_keys(table: Table) -> dict[str, Any]:
    value = table.raw("compensate_samples")
    if isinstance(value, list):
        return {"compensate_samples": table.numbers("compensate_samples")}
    return {"compensate_samples": value if isinstance(value, str) else table.number("compensate_samples")}


def _parameters(table: Table) -> tuple[dict[str, float], tuple[str, ...], Literal["estimated", "fixed"]]:
    """Return the fixed parameters, the dropped ones, and whether the links are fixed."""
    values = table.part("fixed")
    fixed = {key: values.number(key) for key in values.content}
    dropped = tuple(table.texts("dropped"))
    links = cast('Literal["estimated", "fixed"]', table.text("links"))
    table.done()
    return fixed, dropped, links
