"""``didim init``: a first experiment file for one or several logs, from what their columns say.

Names of columns are guessed at, and everything guessed is marked to be confirmed. What cannot be guessed is left as a commented
line with a question. Tested in ``tests/test_init.py`` and ``tests/test_init_logs.py``.
"""

from __future__ import annotations

import json
import math
import os
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from .._tools.files import check_output, write_atomically
from .._tools.toml import Table, quoted
from .._tools.words import counted, one_line
from ..errors import DidimError, ExperimentError
from ..log.data_folder import DataFolder
from ..log.recording import Recording
from ..log.recording_file import read_recording, read_reduction
from ..robot.robot import Robot
from ..robot.robot_file import PACKAGED, load_robot
from .draft_filters import choose_filters, sentence_of
from .draft_source import open_log
from .draft_writer import Draft, RecordingWriter, names_of


def initialise(
    robot: str,
    logs: Path | Sequence[Path],
    output: Path | None = None,
    *,
    rate_hz: float | None = None,
    columns: Mapping[str, str] | None = None,
    gains: Sequence[float] = (),
    values_per_sample: int | None = None,
    topic: str | None = None,
    force: bool = False,
    write: Callable[[Path, str], None] = write_atomically,
) -> tuple[Path, Draft]:
    """Write an experiment file for a log, or for several of one robot.

    Parameters
    ----------
    robot : str
        Packaged name, or path of a robot file or a URDF.
    logs : Path or sequence of Path
        Text with one sample a line, .npz, .mat, .h5, or a ROS bag.
    output : Path, optional
        Experiment file; beside the first log, with its name, by default.
    rate_hz : float, optional
        Sampling rate, where the log has no time stamps.
    columns : mapping of str to str, optional
        Columns by kind of signal where names do not tell: ``{"torque": "14-19"}``.
    gains : sequence of float
        Drive gains (N.m or N per A or V), one or one per joint.
    values_per_sample : int, optional
        Of text with one value a line.
    topic : str, optional
        Topic of a ROS bag.
    force : bool
        Overwrite an existing file.
    write : callable
        Called with path and text at the end.

    Returns
    -------
    path, draft
        Where it is, and what was read and what is open.

    Raises
    ------
    ExperimentError
        When the file exists, or an option does not fit.
    RobotError, RecordingError
        When robot or log cannot be read.
    OSError
        When the file cannot be written to, before the log is read.
    """
    paths = [logs] if isinstance(logs, Path) else list(logs)
    model = load_robot(robot)
    path = paths[0].with_suffix(".toml") if output is None else output
    if path.exists() and not force:
        raise ExperimentError(f"{path}: the file is there already; --force overwrites it, -o writes another")
    if rate_hz is not None and not 0.0 < rate_hz < math.inf:
        raise ExperimentError(f"the rate must be a positive number of Hz, got {rate_hz:g}")
    if gains and (len(gains) not in (1, model.n_dof) or not np.isfinite(gains).all() or not all(gains)):
        raise ExperimentError(
            f"--gain takes one number or {model.n_dof}, one for each joint, none of them zero; got {list(gains)}"
        )
    check_output(path)
    draft = Draft(notes=model.notes)
    writers = []
    for log in paths:
        source = open_log(
            log, path.parent, model, columns or {}, values_per_sample=values_per_sample, topic=topic
        )
        writers.append(RecordingWriter(model, source, log, rate_hz, gains, draft))
    body = [line for writer in writers for line in writer.lines()]
    head = _head(model, _named(robot, path), path, paths)
    transmission = _transmission(model, draft) if any(writer.motors for writer in writers) else []
    text = "\n".join([*head, *body, *transmission])
    recordings, in_torque = _recordings(text, model, path)
    draft.text = "\n".join([text, *_signal(model, recordings, in_torque, draft)]) + "\n"
    write(path, draft.text)
    return path, draft


def _named(robot: str, path: Path) -> str:
    """Return how the experiment names the robot: a path is relative to the experiment file."""
    if (PACKAGED / f"{robot}.toml").is_file() and not robot.endswith(".toml"):
        return robot
    return Path(os.path.relpath(robot, path.parent)).as_posix()


def _head(robot: Robot, named: str, path: Path, logs: Sequence[Path]) -> list[str]:
    speed = "m_s" if "prismatic" in robot.joint_kinds else "rad_s"
    names = one_line(", ".join(log.name for log in logs))
    return [
        f'# Written by `didim init` from {names}. Lines that say "confirm" are guesses;',
        f"# `didim check {one_line(path.name)}` looks for wrong ones.",
        "schema = 1",
        f"name = {quoted((logs[0] if len(logs) == 1 else path).stem)}",
        f"robot = {quoted(named)} # {counted(robot.n_dof, 'joint')}{names_of(robot)}",
        "",
        "# Friction; without this table that of the robot file. Smooth for a simulated log, a dead zone for standstill.",
        "# [friction]",
        '# coulomb = "tanh"',
        f"# smoothing_{speed} = 0.01",
        '# coulomb = "sign"',
        f"# dead_zone_{speed} = 0.01",
    ]


def _transmission(robot: Robot, draft: Draft) -> list[str]:
    """Commented lines of the gear ratios, where the columns are of motors and the robot has none."""
    if robot.reduction is not None:
        return []
    draft.questions.append(
        "the columns are of motors, and the robot file has no reduction: fill in [transmission]"
    )
    return [
        "",
        "# What are the gear ratios? Rows are motors, columns joints: q_motor = reduction q.",
        "# [transmission]",
        f"# reduction = {json.dumps(np.eye(robot.n_dof, dtype=int).tolist())}",
    ]


def _recordings(text: str, robot: Robot, path: Path) -> tuple[list[Recording], bool]:
    """Read the recordings of the file as it stands, and whether their torques are known; none where something is open."""
    table = Table(tomllib.loads(text), path.name, ExperimentError)
    found = []
    try:
        reduction = read_reduction(table.table("transmission", None), robot.reduction, robot.n_dof)
        folder = DataFolder(path.parent)
        for k, part in enumerate(table.tables("recording")):
            found.append(read_recording(part, f"recording {k + 1}", robot, reduction, folder))
    except DidimError:
        return [], False
    return found, all(recording.tau is not None for recording in found)


def _signal(robot: Robot, recordings: Sequence[Recording], in_torque: bool, draft: Draft) -> list[str]:
    head = ["", "# Filters: positions without delay, then torques and model down to the band of the motion."]
    if not recordings:
        return [
            *head,
            "# What is open above keeps them from being chosen: `didim init` with the answers does it.",
            "# [signal]",
            "# cutoff_hz = 40",
            "# decimation = [10]",
        ]
    filters = choose_filters(robot, recordings, comparable=in_torque)
    draft.read.append(sentence_of(filters))
    return [
        *head,
        f"# {filters.reason[0].upper()}{filters.reason[1:]}.",
        "[signal]",
        f"cutoff_hz = {filters.cutoff_hz:g}",
        f"trim_start = {filters.trim}",
        f"trim_end = {filters.trim}",
        f"decimation = {list(filters.decimation)}",
    ]
