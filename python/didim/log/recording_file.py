"""A recording: logged motion and torque of one run, joint side, SI units, and how it is read from files.

Motor-side logs are brought to the joints with the reduction matrix R (rows motors, columns joints):
``q_motor = R q`` and ``tau = R^T tau_motor``. Nothing is interpolated or guessed: a missing sample, an uneven
time stamp or a length that differs is an error. Tested in ``tests/test_recording.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import Table
from .._tools.words import counted, did_you_mean
from ..errors import RecordingError
from ..robot.transmission import reduction_matrix
from .data_file import open_data_file
from .data_format import Column, DataFile
from .recording import ROLES, Recording, Role, clock
from .sampling import MINIMUM_SAMPLES, TimeFault, check_time, slices, stretches, time_faults
from .units import TIME, effort_factors, position_factors


class _Robot(Protocol):
    """What a log needs to know of a robot."""

    @property
    def name(self) -> str: ...
    @property
    def joint_kinds(self) -> Sequence[str]: ...
    @property
    def joint_names(self) -> Sequence[str]: ...
    @property
    def gains(self) -> Sequence[float] | None: ...


@dataclass(frozen=True)
class _Source:
    """The part of a data file that one table of the experiment declares."""

    table: Table
    file: DataFile
    columns: list[Column] | None
    variable: str | None
    count: int

    def values(self) -> Array:
        return self.file.get(self.columns, self.variable, self.count)

    @property
    def place(self) -> str:
        return self.file.name


class DataFolder:
    """Opens each data file once, however many tables read from it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[tuple[str, str | None, bool | None], DataFile] = {}

    def source(self, table: Table, count: int, joints: Sequence[str] = ()) -> _Source:
        """Columns that a table declares with `file`, `columns`, `variable`, `delimiter` and `header`.

        `joints` are the names of the robot's joints, by which `columns` may be given.
        """
        name = table.text("file")
        delimiter = table.text("delimiter", None, choices=[",", ";", "\t", " "])
        header = table.boolean("header", None)
        variable = table.text("variable", None)
        columns = self._columns(table, count, joints)
        key = (name, delimiter, header)
        if key not in self._files:
            self._files[key] = open_data_file(self._folder / name, name, delimiter=delimiter, header=header)
        file = self._files[key]
        file.want(columns, variable, count)
        return _Source(table, file, columns, variable, count)

    @staticmethod
    def _columns(table: Table, count: int, joints: Sequence[str]) -> list[Column] | None:
        columns = table.raw("columns", None)
        if columns is None:
            return None
        if isinstance(columns, dict):
            columns = _by_joint(table, columns, joints)
        if not isinstance(columns, list) or not all(type(column) in (str, int) for column in columns):
            table.fail(f"columns must be a list of names, or of numbers from 1, got {columns!r}")
        if len(columns) != count:
            table.fail(f"columns must name {counted(count, 'column')}, got {len(columns)}")
        if len(set(columns)) < count:
            table.fail(f"columns names a column twice: {columns!r}")
        return cast("list[Column]", columns)


def _by_joint(table: Table, columns: Mapping[str, Any], joints: Sequence[str]) -> list[Any]:
    """Columns in the order of the joints, from a table ``{ joint = column }``."""
    if not joints:
        table.fail("columns by name of joint need a robot whose joints have names")
    for name in columns:
        if name not in joints:
            table.fail(f"columns names joint {name!r}, which the robot has not{did_you_mean(name, joints)}")
    missing = [name for name in joints if name not in columns]
    if missing:
        table.fail(f"columns has none for joint {missing[0]!r}")
    return [columns[name] for name in joints]


def read_reduction(table: Table | None, robot_reduction: Array | None, n_dof: int) -> Array | None:
    """Reduction matrix R of ``[transmission]``, or else of the robot; rows motors, columns joints.

    Raises
    ------
    DidimError
        Of the table's class, when the matrix is singular.
    """
    if table is None:
        return robot_reduction
    reduction = reduction_matrix(table, n_dof)
    table.done()
    return reduction


def read_recording(
    table: Table,
    name: str,
    robot: _Robot,
    reduction: Array | None,
    folder: DataFolder,
    faults: list[tuple[str, TimeFault]] | None = None,
) -> Recording:
    """Read one ``[[recording]]`` of an experiment.

    Parameters
    ----------
    table
        The table, with the sub-tables `time`, `position`, `torque` and `reference`.
    name
        Name of the recording where the table gives none.
    robot
        Robot that was logged.
    reduction
        (n_dof, n_dof) reduction matrix R, or None.
    folder
        Where the data files are.
    faults
        Takes recording and fault of wrong time stamps, which are then no errors: the recording has the rate of the time
        stamps, and without `windows_s` a window for each stretch between two gaps.

    Raises
    ------
    ExperimentError
        On a wrong key or combination of keys.
    RecordingError
        On a file that is not as the table says; the message names file, row and column.
    """
    n_dof = len(robot.joint_kinds)
    name = table.text("name", name)
    role = cast("Role", table.text("role", "fit", choices=ROLES))
    rate = table.number("rate_hz", None, above=0.0)
    windows_s = table.raw("windows_s", [])
    tables = {key: table.table(key, None) for key in ("time", "position", "torque", "reference")}
    table.done()
    if tables["position"] is None:
        table.fail("the table [recording.position] is missing")
    sources = {
        key: folder.source(part, 1) if key == "time" else folder.source(part, n_dof, robot.joint_names)
        for key, part in tables.items()
        if part is not None
    }
    # All keys are checked before a file is parsed.
    position = _Channel.motion(sources["position"], robot, reduction)
    torque = _Channel.effort(sources["torque"], robot, reduction) if "torque" in sources else None
    reference = _Channel.motion(sources["reference"], robot, reduction) if "reference" in sources else None
    period = _time_unit(sources["time"]) if "time" in sources else 1.0
    if rate is None and "time" not in sources:
        table.fail("either rate_hz or the table [recording.time] must be there")

    q = position.read()
    digests = {source.file.name: source.file.sha256 for source in sources.values()}
    other = {
        "torque": torque.read() if torque else None,
        "reference": reference.read() if reference else None,
    }
    t = sources["time"].values()[:, 0] * period if "time" in sources else None
    for key, values in {**other, "time": t}.items():
        if values is not None and len(values) != len(q):
            raise RecordingError(
                f"{name}: {key} has {counted(len(values), 'sample')} ({sources[key].place}), "
                f"position has {len(q)} ({sources['position'].place})"
            )
    if len(q) < MINIMUM_SAMPLES:
        file = sources["position"].place
        raise RecordingError(f"{file}: at least {MINIMUM_SAMPLES} samples are needed, got {len(q)}")
    between_gaps: tuple[tuple[int, int], ...] = ()
    if t is not None:
        wrong = [] if faults is None else list(time_faults(t, rate, sources["time"].place))
        if faults is not None and wrong and np.isfinite(wrong[0].rate_hz):
            faults += [(name, fault) for fault in wrong]
            rate, t = wrong[0].rate_hz, None
            gaps = [fault.sample for fault in wrong if fault.kind == "gap" and fault.sample is not None]
            between_gaps = stretches(gaps, len(q))
        else:
            rate = check_time(t, rate, sources["time"].place)
    assert rate is not None  # a missing rate without time stamps was refused above
    return Recording(
        name=name,
        t=clock(len(q), rate) if t is None else t,
        q=q,
        tau=other["torque"],
        rate_hz=rate,
        q_ref=other["reference"],
        role=role,
        windows=slices(table, windows_s, rate, len(q)) or between_gaps,
        digests=digests,
        origin=_origin(sources, {"position": position, "torque": torque, "reference": reference}),
    )


def _origin(sources: Mapping[str, _Source], channels: Mapping[str, _Channel | None]) -> dict[str, Any]:
    """Tables that were read, with what became of their units, as JSON knows it."""
    found: dict[str, Any] = {key: source.table.content for key, source in sources.items()}
    for key, channel in channels.items():
        if channel is not None:
            # Of counts and drive gains too, wherever these were written down.
            found[key]["factors_to_si"] = channel.factors.tolist()
            if channel.reduction is not None:
                found["reduction"] = channel.reduction.tolist()
    return found


@dataclass(frozen=True)
class _Channel:
    """A source with its way to the joints: joint side = (values * factors) @ to_joint, from the reduction."""

    source: _Source
    factors: Array
    to_joint: Array | None
    reduction: Array | None

    @classmethod
    def motion(cls, source: _Source, robot: _Robot, reduction: Array | None) -> _Channel:
        side, matrix = _side(source.table, reduction)
        factors = position_factors(source.table, side, robot.joint_kinds)
        source.table.done()
        # q_motor = R q for columns; samples are rows here.
        to_joint = None if matrix is None else np.linalg.inv(matrix).T.astype(np.float64)
        return cls(source, np.array(factors), to_joint, matrix)

    @classmethod
    def effort(cls, source: _Source, robot: _Robot, reduction: Array | None) -> _Channel:
        side, matrix = _side(source.table, reduction)
        # A robot file has the gains of the motors: they hold at the joints only when nothing is in between.
        gains = robot.gains if side == "motor" or reduction is None else None
        factors = effort_factors(source.table, side, robot.joint_kinds, gains)
        source.table.done()
        return cls(source, np.array(factors), matrix, matrix)

    def read(self) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):  # reported by Recording
            values = self.source.values() * self.factors
            return values if self.to_joint is None else values @ self.to_joint


def _side(table: Table, reduction: Array | None) -> tuple[str, Array | None]:
    side = table.text("side", choices=["motor", "joint"])
    if side == "joint":
        return side, None
    if reduction is None:
        table.fail(
            "side 'motor' needs a reduction matrix: [transmission] reduction, here or in the robot file"
        )
    return side, reduction


def _time_unit(source: _Source) -> float:
    unit = source.table.text("unit", "s", choices=list(TIME))
    source.table.done()
    return TIME[unit]
