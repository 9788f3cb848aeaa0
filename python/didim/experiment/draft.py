"""``didim init``: a first experiment file for one or several logs, from their columns.

Columns are recognised by their names, and every assumption is marked for confirmation. Open questions are commented lines.
Tested in ``tests/test_init.py`` and ``tests/test_init_logs.py``.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._tools.files import check_output, path_from, write_atomically
from .._tools.keys import declared
from .._tools.toml import Table, quoted
from .._tools.words import counted, did_you_mean, listing, one_line, percent_text, series
from ..errors import DidimError, ExperimentError, RobotError
from ..log.data_file import is_log
from ..log.data_folder import DataFolder
from ..log.recording import Recording
from ..log.recording_file import read_recording, read_reduction
from ..log.units import ESTIMATE
from ..robot.robot import Robot
from ..robot.robot_file import PACKAGED, check_closed, load_robot
from ..robot.robot_text import robot_text
from ..robot.urdf.chain import chain_of_names
from .draft_files import assembled
from .draft_filters import Filters, choose_filters, error_sentence, motor_ratio, sentence_of
from .draft_friction import delay_lines, fitted_friction, friction_lines, friction_sentences, physical_lines
from .draft_servos import payload_lines, servo_lines
from .draft_source import LogSource, choose_columns, log_names, open_log, whole_samples, without_locked
from .draft_writer import OPEN_GAIN, Draft, DraftOptions, RecordingWriter, names_of

UNFINISHED = "# Unfinished draft of `didim init`, which may replace it; SHA-256 of the lines above: "
"""First words of the last line of a file with open questions: if nobody has edited it since, it is replaced without --force."""


def initialise(  # many parameters: one per option of `didim init`
    robot: str,
    logs: Path | Sequence[Path],
    output: Path | None = None,
    *,
    rate_hz: float | None = None,
    columns: Mapping[str, str] | None = None,
    gains: Sequence[float] | str = (),
    servo: Mapping[str, Sequence[float]] | None = None,
    sides: Mapping[str, str] | None = None,
    values_per_sample: int | None = None,
    topic: str | None = None,
    chain: Mapping[str, Any] | None = None,
    plain: bool = False,
    force: bool = False,
    write: Callable[[Path, str], None] = write_atomically,
    say: Callable[[str], None] = lambda text: None,
) -> tuple[Path, Draft]:
    """Write an experiment file for a log, or for several of one robot.

    Parameters
    ----------
    robot : str
        Name of an included robot, or path of a robot file or a URDF.
    logs : Path or sequence of Path
        Text with one sample a line, .npz, .mat, .h5, or a ROS bag. Several files are several recordings, or the signals of one
        if no file has both positions and torques.
    output : Path, optional
        Experiment file; beside the first log, with its name, by default.
    rate_hz : float, optional
        Sampling rate, if the log has no time stamps.
    columns : mapping of str to str, optional
        Columns by kind of signal, if names are not sufficient: ``{"torque": "14-19"}``, or ``{"torque": "drives.csv:1-6"}``.
    gains : sequence of float, or "estimate"
        Drive gains (N.m or N per A or V), one or one per joint.
    servo : mapping of str to sequence of float, optional
        Gains ``kp`` (N.m/rad) and ``kv`` (N.m.s/rad) of position servos, one or one per joint: for a log of commanded and
        measured positions, the file describes a fit of the drives, with links fixed at the values of the robot file.
    sides : mapping of str to str, optional
        Sides of the gears by table: ``{"torque": "motor"}``.
    values_per_sample : int, optional
        Number of values per sample in a text with one value per line.
    topic : str, optional
        Topic of a ROS bag.
    chain : mapping, optional
        `tip`, `base`, `lock` and `open` of a URDF or an MJCF, as for `load_robot`. By default the chain of a tree is the one whose
        joints the log names. The robot is then written beside the experiment file.
    plain : bool
        Choose neither friction laws nor a delay.
    force : bool
        Overwrite an existing file.
    write : callable
        Function of path and text that writes the file.
    say : callable
        Receiver of sentences on the progress.

    Returns
    -------
    path, draft
        Path of the file, and its content with open questions.

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
    if is_log(Path(robot)):
        is_robot = paths[0].suffix.lower() in (".toml", ".urdf") or (PACKAGED / f"{paths[0]}.toml").is_file()
        second = paths[0] if is_robot else "ROBOT"
        raise ExperimentError(
            f"{robot}: this is a log, and the robot comes first: didim init {second} {robot}"
        )
    path = paths[0].with_suffix(".toml") if output is None else output
    if not force:
        _check_free(path)
    model, own_file = _model(robot, paths, chain or {}, topic)
    check_closed(model)
    options = DraftOptions(rate_hz, gains, sides or {}, servo or {}, plain=plain)
    _check_options(model, options)
    check_output(path)
    robot_path = path.with_name(f"{path.stem}_robot.toml")
    if own_file:
        check_output(robot_path)
        if not force and robot_path.exists() and robot_path.read_text(encoding="utf-8") != own_file:
            raise ExperimentError(
                f"{robot_path}: another robot is there already; --force overwrites it, -o writes another"
            )
    beside, alone = path.parent, len(paths) == 1
    draft = Draft(notes=model.notes)
    sources = _opened(paths, beside, model, values_per_sample, topic, draft)
    draft.read += without_locked(sources, robot, chain or {}, model)
    for kind, text in (columns or {}).items():
        choose_columns(sources, kind, text)
    tables, friction = _tables(model, sources, options, path, draft, say)
    name = (paths[0] if alone else path).stem
    head = _head(model, _named(str(robot_path) if own_file else robot, path), path, paths, name, friction)
    draft.text = _text([*head, *tables], draft.questions)
    if own_file:
        draft.read.insert(
            0, f"{robot_path}: written, the robot with {counted(model.n_dof, 'joint')} whose chain was chosen"
        )
        write(robot_path, own_file)
    write(path, draft.text)
    return path, draft


def _opened(
    logs: Sequence[Path],
    beside: Path,
    robot: Robot,
    values_per_sample: int | None,
    topic: str | None,
    draft: Draft,
) -> list[LogSource]:
    """Open all files; those with one value a line that hold all joints are opened as such."""
    alone = len(logs) == 1
    sources = [
        open_log(log, beside, robot, values_per_sample=values_per_sample, topic=topic, alone=alone)
        for log in logs
    ]
    whole = whole_samples(sources, robot)
    for k, source in enumerate(sources):
        if source.path in whole:
            count = whole[source.path]
            sources[k] = open_log(source.path, beside, robot, values_per_sample=count, alone=False)
    if whole:
        names = series(path.name for path in whole)
        draft.read.append(f"{names}: taken for {robot.n_dof} values a sample (--values-per-sample)")
    return sources


def _tables(
    robot: Robot,
    sources: Sequence[LogSource],
    options: DraftOptions,
    path: Path,
    draft: Draft,
    say: Callable[[str], None],
) -> tuple[list[str], list[str]]:
    """Return the lines of the recordings, the transmission, the filters and the delay, and those of friction.

    Assumptions and questions go to the draft.
    """
    recorded, assumptions = assembled(sources, robot)
    draft.read += assumptions
    logs = [source for source, _, _ in recorded]

    def written(options: DraftOptions) -> _Written:
        own = Draft()
        writers = [
            RecordingWriter(robot, source, name, file.name, options, own) for source, name, file in recorded
        ]
        lines = [*payload_lines(logs), *(line for writer in writers for line in writer.lines())]
        if any(writer.motors for writer in writers):
            lines += _transmission(robot, options.ratio, own)
        if all(writer.positions_only for writer in writers):
            return _Written(lines, writers, own)
        recordings, in_torque = _recordings("\n".join(lines), robot, path)
        filters = choose_filters(robot, recordings, comparable=in_torque) if recordings else None
        return _Written(lines, writers, own, recordings, filters)

    chosen = written(options)
    chosen = _motors_or_degrees(robot, chosen, options, written)
    draft.read += chosen.draft.read
    draft.questions += chosen.draft.questions
    if all(writer.positions_only for writer in chosen.writers):
        return [*chosen.lines, *servo_lines(robot, logs, options.servo, draft.read)], []
    friction, delay = [], []
    # The error of a plain fit is not known with load friction, which needs an estimate first; laws need known drive gains.
    fitted = chosen.filters is not None and (chosen.filters.error is not None or robot.friction.has_load)
    fitted &= all(recording.drives is None for recording in chosen.recordings)
    if fitted and chosen.filters is not None and not options.plain:
        try:
            fit = fitted_friction(robot, chosen.recordings, chosen.filters.signal, say)
            friction, delay = friction_lines(robot, fit), [*delay_lines(fit), *physical_lines(fit)]
            draft.read += friction_sentences(fit)
        except DidimError as reason:  # a log that says too little has its plain friction
            draft.read.append(f"no friction law was tried: {reason}")
    return [*chosen.lines, *_signal(chosen.filters, draft, path.name, plain=not friction), *delay], friction


class _Written(NamedTuple):
    """Lines of the recordings, what was written beside them, and the filters of the log, if nothing is open."""

    lines: list[str]
    writers: list[RecordingWriter]
    draft: Draft
    recordings: Sequence[Recording] = ()
    filters: Filters | None = None


def _motors_or_degrees(
    robot: Robot, degrees: _Written, options: DraftOptions, written: Callable[[DraftOptions], _Written]
) -> _Written:
    """Return the reading of positions that are too large for joints in radians: motors before degrees, if the torques say so.

    The gears are those of the robot file; without them, one ratio is sought for all joints.
    """
    tables = {table for writer in degrees.writers for table in writer.guessed} - options.sides.keys()
    before = None if degrees.filters is None else degrees.filters.error
    if "position" not in tables or before is None:
        return degrees
    motors = dict.fromkeys(tables, "motor")
    as_degrees = f"in degrees the relative error is {percent_text(100.0 * before)} %"
    if robot.reduction is not None:
        sides = [options.sides[key] for key in ("torque",) if key in options.sides] or ["motor", "joint"]
        for side in sides:
            motor = written(replace(options, sides={**options.sides, **motors, "torque": side}))
            error = None if motor.filters is None else motor.filters.error
            if error is not None and error < before:  # no number was fitted to say so
                motor.draft.read.append(f"positions are those of the motors: {as_degrees}")
                return motor
    ratio = motor_ratio(robot, degrees.recordings, degrees.filters.signal, before)  # type: ignore[union-attr]
    if ratio is None:
        return degrees
    largest = np.max(
        [np.abs(log.tau).max(axis=0) for log in degrees.recordings if log.tau is not None], axis=0
    )
    efforts = [limits.effort for limits in robot.limits]
    beyond = any(effort and value * ratio > effort for value, effort in zip(largest, efforts, strict=True))
    sides_of = {**motors, "torque": "joint" if beyond else "motor", **options.sides}
    best = written(replace(options, sides=sides_of, ratio=ratio))
    best.draft.read.append(
        f"positions are those of motors behind gears of about {ratio:g}, which the torques fit best: {as_degrees}; "
        "confirm the ratios under [transmission]"
    )
    return best


def _check_options(robot: Robot, options: DraftOptions) -> None:
    rate_hz, gains = options.rate_hz, options.gains
    for key, values in options.servo.items():
        if len(values) not in (1, robot.n_dof) or not all(0.0 <= value < math.inf for value in values):
            raise ExperimentError(
                f"--{key} takes one number or {robot.n_dof}, one for each joint, none negative; got {list(values)}"
            )
    if rate_hz is not None and not 0.0 < rate_hz < math.inf:
        raise ExperimentError(f"the rate must be a positive number of Hz, got {rate_hz:g}")
    if gains and gains != ESTIMATE:
        numbers = [gain for gain in gains if isinstance(gain, float | int)]
        if (
            len(numbers) != len(gains)
            or len(gains) not in (1, robot.n_dof)
            or not np.isfinite(numbers).all()
            or not all(numbers)
        ):
            raise ExperimentError(
                f'--gain takes one number or {robot.n_dof}, one for each joint, none of them zero, or "{ESTIMATE}"; '
                f"got {list(gains)}"
            )
    for table, side in options.sides.items():
        for word, known in ((table, ("position", "torque", "reference")), (side, ("joint", "motor"))):
            if word not in known:
                raise ExperimentError(
                    f"--side takes one of {listing(known, 40)} there, got {word!r}{did_you_mean(word, known)}"
                )


def _check_free(path: Path) -> None:
    """Refuse an existing file, unless it is an unedited draft of `didim init`."""
    if not path.exists():
        return
    edited = ""
    if path.is_file():
        text, _, last = path.read_bytes().rstrip(b"\n").rpartition(b"\n")
        if last.startswith(UNFINISHED.encode()):
            if last.removeprefix(UNFINISHED.encode()).decode() == hashlib.sha256(text).hexdigest():
                return
            edited = ", a draft that was edited since didim init wrote it"
    raise ExperimentError(
        f"{path}: the file is there already{edited}; --force overwrites it, -o writes another"
    )


def _text(lines: Sequence[str], questions: Sequence[str]) -> str:
    """Return the text of the file; with open questions it cannot be used, and is marked as a draft."""
    if not questions:
        return "\n".join(lines) + "\n"
    opening = (
        "# Not finished: answer these questions by options of `didim init`, or fill in the lines below and delete `open`.",
        f"open = {quoted(list(questions))}",
        "",
    )
    text = "\n".join([*opening, *lines])
    return f"{text}\n{UNFINISHED}{hashlib.sha256(text.encode()).hexdigest()}\n"


def _model(
    robot: str, logs: Sequence[Path], chain: Mapping[str, Any], topic: str | None
) -> tuple[Robot, str | None]:
    """Load the robot; a chosen chain, or that of a tree which the logs name, with the text of its robot file."""
    if any(chain.values()):
        model = load_robot(robot, **chain)
        return model, robot_text(model)
    if Path(robot).suffix.lower() != ".urdf":
        return load_robot(robot), None
    names = [name for log in logs for name in log_names(log, topic)]
    named_chain = chain_of_names(Path(robot), names)
    try:
        whole = load_robot(robot)
    except RobotError as error:
        if named_chain is None:
            raise RobotError(str(error).replace("didim robot --tip", "--tip")) from None
    else:
        if named_chain is None or whole.geometry.in_line:
            return whole, None
    tip, locked = named_chain
    model = load_robot(robot, tip=tip, lock=dict.fromkeys(locked, 0.0))
    return model, robot_text(model)


def _named(robot: str, path: Path) -> str:
    """Return the robot's name for the experiment: a path is relative to the experiment file."""
    if (PACKAGED / f"{robot}.toml").is_file():
        return robot
    return path_from(path.parent, robot)


def _head(
    robot: Robot, named: str, path: Path, logs: Sequence[Path], name: str, friction: Sequence[str]
) -> list[str]:
    speed = "m_s" if "prismatic" in robot.joint_kinds else "rad_s"
    names = one_line(", ".join(log.name for log in logs))
    plain = [
        "# Friction; without this table that of the robot file. Smooth for a simulated log, a dead zone for standstill.",
        "# [friction]",
        '# coulomb = "tanh"',
        f"# smoothing_{speed} = 0.01",
        '# coulomb = "sign"',
        f"# dead_zone_{speed} = 0.01",
    ]
    return [
        f'# Written by `didim init` from {names}. Lines that say "confirm" are guesses;',
        f"# `didim check {one_line(path.name)}` looks for wrong ones.",
        "schema = 1",
        f"name = {quoted(name)}",
        f"robot = {quoted(named)} # {counted(robot.n_dof, 'joint')}{names_of(robot)}",
        "",
        *(friction if any(line.startswith("[") for line in friction) else [*plain, *friction]),
    ]


def _transmission(robot: Robot, ratio: float | None, draft: Draft) -> list[str]:
    """Return the gear ratios of columns on the motor side, if the robot has none: the `ratio` that was found, or open lines."""
    head = "Rows are motors, columns joints: q_motor = reduction q."
    if ratio is not None:
        gears = json.dumps((ratio * np.eye(robot.n_dof)).tolist())
        return [
            "",
            f"# {head}",
            "[transmission]",
            f"reduction = {gears} # confirm: by the torques, one for all",
        ]
    if robot.reduction is not None:
        return []
    draft.questions.append(
        "the columns are of motors, and the robot file has no reduction: fill in [transmission]"
    )
    return [
        "",
        f"# What are the gear ratios? {head}",
        "# [transmission]",
        f"# reduction = {json.dumps(np.eye(robot.n_dof, dtype=int).tolist())}",
    ]


def _recordings(text: str, robot: Robot, path: Path) -> tuple[list[Recording], bool]:
    """Read the recordings of the draft, and whether their torques are known; none if questions are open.

    Drive gains may be open, because the bandwidth of the motion does not depend on them.
    """
    closed = text.replace(f"\n{OPEN_GAIN} ", f"\n{OPEN_GAIN[2:]} ")
    table = Table(tomllib.loads(closed), path.name, ExperimentError, keys=declared("experiment"))
    recordings = []
    try:
        reduction = read_reduction(table.table("transmission", None), robot.reduction, robot.n_dof)
        folder = DataFolder(path.parent)
        for k, part in enumerate(table.tables("recording")):
            recordings.append(read_recording(part, f"recording {k + 1}", robot, reduction, folder))
    except DidimError:
        return [], False
    return recordings, closed == text and all(recording.tau is not None for recording in recordings)


def _signal(filters: Filters | None, draft: Draft, name: str, *, plain: bool) -> list[str]:
    head = ["", "# Filters: positions without delay, then torques and model down to the band of the motion."]
    if filters is None:
        return [
            *head,
            "# What is open above keeps them from being chosen: `didim init` with the answers does it.",
            "# [signal]",
            "# cutoff_hz = 40",
            "# decimation = [10]",
        ]
    draft.read.append(sentence_of(filters))
    if filters.error is not None and plain:  # with laws `identify` misses less
        draft.read.append(error_sentence(filters.error, name))
    return [
        *head,
        f"# {filters.reason[0].upper()}{filters.reason[1:]}.",
        "[signal]",
        f"cutoff_hz = {filters.signal.cutoff_hz:g}",
        f"trim_start = {filters.signal.trim_start}",
        f"trim_end = {filters.signal.trim_end}",
        f"decimation = {list(filters.signal.decimation)}",
    ]
