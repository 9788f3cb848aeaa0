"""A recording: logged motion and torque of one run, joint side, SI units, and how it is read from files.

Motor-side logs are brought to the joints with the reduction matrix R (rows motors, columns joints):
``q_motor = R q`` and ``tau = R^T tau_motor``. Nothing is guessed: a missing sample, an uneven time stamp or a length that
differs is an error, unless `resample` asks for even samples. Tested in ``tests/test_recording.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import Table
from .._tools.words import counted
from ..errors import RecordingError
from ..robot.transmission import reduction_matrix
from .data_folder import SOURCES, DataFolder, Source
from .recording import OWN, ROLES, Recording, Role, clock
from .resampling import Resampling, resampling, step_range
from .sampling import MINIMUM_SAMPLES, TimeFault, check_time, rollout_windows, slices, stretches, time_faults
from .units import ESTIMATE, TIME, current_factors, effort_factors, position_factors, velocity_factors

GAPS = "gaps"
"""Value of ``rollouts`` that starts a rollout at each gap of the time stamps; any other value names a column."""


class _Robot(Protocol):
    """Properties of a robot that a log needs."""

    @property
    def name(self) -> str: ...
    @property
    def joint_kinds(self) -> Sequence[str]: ...
    @property
    def joint_names(self) -> Sequence[str]: ...
    @property
    def gains(self) -> Sequence[float] | None: ...


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
        The table, with the sub-tables `time`, `position`, `velocity`, `torque`, `external` and `reference`.
    name
        Name of the recording where the table gives none.
    robot
        Robot that was logged.
    reduction
        (n_dof, n_dof) reduction matrix R, or None.
    folder
        Folder of the data files.
    faults
        Callback that receives recording and fault of wrong time stamps, instead of an error: the recording then has the rate of
        the time stamps and, without `windows_s`, one window for each stretch between two gaps.

    Raises
    ------
    ExperimentError
        On a wrong key or combination of keys.
    RecordingError
        On a file that contradicts its table; the message names file, row and column.
    """
    n_dof = len(robot.joint_kinds)
    name = table.text("name", name)
    role = cast("Role", table.text("role", "fit", choices=ROLES))
    rate = table.number("rate_hz", None, above=0.0)
    windows_s = table.raw("windows_s", [], "list of [start, stop]")
    rollouts = table.text("rollouts", None)
    if rollouts is not None and windows_s:
        table.fail("give rollouts or windows_s, not both: each rollout is a window")
    payload = table.text("payload", "none")
    own = [key for key in OWN if table.text(key, "shared", choices=["shared", "own"]) == "own"]
    tables = {key: table.table(key, None) for key in SOURCES}
    table.done()
    if tables["position"] is None and tables["reference"] is None:
        table.fail("the table [recording.position] is missing")
    if tables["external"] is not None and tables["torque"] is None:
        table.fail("the table [recording.external] needs [recording.torque] beside it")
    sources = {
        key: folder.source(key, part, 1)
        if key == "time"
        else folder.source(key, part, n_dof, robot.joint_names)
        for key, part in tables.items()
        if part is not None
    }
    # All keys are checked before a file is parsed.
    make = {
        "position": _Channel.motion,
        "velocity": _Channel.velocity,
        "torque": _Channel.effort,
        "external": _Channel.effort,
        "reference": _Channel.motion,
    }
    channels = {key: make[key](source, robot, reduction) for key, source in sources.items() if key != "time"}
    period, resample = _time_keys(sources["time"]) if "time" in sources else (1.0, False)
    if rate is None and "time" not in sources:
        table.fail("either rate_hz or the table [recording.time] must be there")

    # Without measured positions the reference defines the samples of the recording.
    base = "position" if "position" in sources else "reference"
    by_column = rollouts is not None and rollouts != GAPS
    if by_column:
        sources[base].file.want([str(rollouts)], None, 1)
    values = {key: channel.read() for key, channel in channels.items()}
    count = len(values[base])
    digests = {source.file.name: source.file.sha256 for source in sources.values()}
    t = sources["time"].values()[:, 0] * period if "time" in sources else None
    for key, found in {**values, **({} if t is None else {"time": t})}.items():
        if len(found) != count:
            raise RecordingError(
                f"{name}: {key} has {counted(len(found), 'sample')} ({sources[key].place}), "
                f"{base} has {count} ({sources[base].place})"
            )
    if count < MINIMUM_SAMPLES:
        file = sources[base].place
        raise RecordingError(f"{file}: at least {MINIMUM_SAMPLES} samples are needed, got {count}")
    between_gaps: tuple[tuple[int, int], ...] = ()
    notes: tuple[str, ...] = ()
    origin = _origin(sources, channels)
    if rollouts is not None:
        if resample:
            table.fail("rollouts of uneven samples are not read: resample = true is for one run")
        if t is None and not by_column:
            table.fail("rollouts = 'gaps' needs the table [recording.time]")
        number = sources[base].file.get([str(rollouts)], None, 1)[:, 0] if by_column else None
        between_gaps = rollout_windows(count, number, t)
        if t is not None:
            for start, stop in between_gaps:
                rate = check_time(t[start:stop], rate, f"{sources['time'].place}, from row {start + 1}")
            t = None
    elif t is not None and resample:
        plan = resampling(t, rate, sources["time"].place)
        notes = (f"recording '{name}': {plan.sentence(step_range(t))}",)
        values = {key: plan.apply(found) for key, found in values.items()}
        t, rate, between_gaps = plan.t, plan.rate_hz, plan.windows
        origin["resampled"] = {"rate_hz": plan.rate_hz, "noise_variance": plan.noise_variance}
    elif t is not None:
        wrong = list(time_faults(t, rate, sources["time"].place))
        if faults is not None and wrong and np.isfinite(wrong[0].rate_hz):
            faults += [(name, fault) for fault in wrong]
            rate, t = wrong[0].rate_hz, None
            gaps = [fault.sample for fault in wrong if fault.kind == "gap" and fault.sample is not None]
            between_gaps = stretches(gaps, count)
        elif wrong:
            raise RecordingError(wrong[0].sentence + _offer(wrong[0], t, rate, sources["time"].place))
        else:
            rate = check_time(t, rate, sources["time"].place)
    assert rate is not None  # a missing rate without time stamps was refused above
    first = values[base]
    windows = slices(table, windows_s, rate, len(first))
    if resample:
        windows = _inside(table, windows, between_gaps, rate)
    return Recording(
        name=name,
        t=clock(len(first), rate) if t is None else t,
        q=values.get("position", np.full_like(first, np.nan)),
        dq=values.get("velocity"),
        tau=values.get("torque"),
        external=values.get("external"),
        rate_hz=rate,
        q_ref=values.get("reference"),
        role=role,
        windows=windows or between_gaps,
        has_positions=base == "position",
        digests=digests,
        origin=origin,
        notes=notes,
        payload=payload,
        own=tuple(own),
        drives=channels["torque"].drives if "torque" in channels else None,
    )


def _offer(fault: TimeFault, t: Array, rate_hz: float | None, file: str) -> str:
    """Return the end of the sentence that offers resampling, with its effect on the noise."""
    if fault.kind not in ("gap", "uneven"):
        return ""
    try:
        plan: Resampling = resampling(t, None if rate_hz is None else rate_hz, file)
    except RecordingError:
        return ""
    return (
        f"; resample = true under [recording.time] interpolates at {plan.rate_hz:.6g} Hz (white noise keeps "
        f"{plan.noise_variance:.2f} of its variance); if only the stamps jitter, give rate_hz and no [recording.time]"
    )


def _inside(
    table: Table,
    windows: tuple[tuple[int, int], ...],
    between_gaps: tuple[tuple[int, int], ...],
    rate_hz: float,
) -> tuple[tuple[int, int], ...]:
    """Refuse a window with a gap."""
    for start, stop in windows:
        if not any(first <= start and stop <= last for first, last in between_gaps):
            there = ", ".join(
                f"[{first / rate_hz:.6g}, {last / rate_hz:.6g}]" for first, last in between_gaps
            )
            table.fail(
                f"the window [{start / rate_hz:.6g}, {stop / rate_hz:.6g}] s has a gap in it, which resampling does not bridge; "
                f"there are samples without a gap in {there} s"
            )
    return windows


def _origin(sources: Mapping[str, Source], channels: Mapping[str, _Channel]) -> dict[str, Any]:
    """Return the tables with the factors of their units, as JSON data."""
    found: dict[str, Any] = {key: source.table.content for key, source in sources.items()}
    for key, channel in channels.items():
        # The factors include counts and drive gains, whichever file declares them.
        found[key]["factors_to_si"] = channel.factors.tolist()
        if np.any(channel.zeros):
            found[key]["zeros_si"] = np.asarray(channel.zeros).tolist()
        if channel.reduction is not None:
            found["reduction"] = channel.reduction.tolist()
    return found


@dataclass(frozen=True)
class _Channel:
    """A source and its transformation to the joint side, ``(values * factors) @ to_joint``, by the reduction."""

    source: Source
    factors: Array
    to_joint: Array | None
    reduction: Array | None
    drives: tuple[tuple[float, ...], ...] | None = None
    """Reduction matrix of currents whose drive gains are to be estimated."""
    zeros: Array | float = 0.0
    """Position (rad or m) at which each column is zero: shares of a joint's range begin at its lower limit."""

    @classmethod
    def motion(cls, source: Source, robot: _Robot, reduction: Array | None) -> _Channel:
        side, matrix = _side(source.table, reduction)
        ranges = [limits.position for limits in getattr(robot, "limits", ())]
        factors, zeros = position_factors(source.table, side, robot.joint_kinds, ranges)
        source.table.done()
        return cls(source, np.array(factors), _to_joint(matrix), matrix, zeros=np.array(zeros))

    @classmethod
    def velocity(cls, source: Source, robot: _Robot, reduction: Array | None) -> _Channel:
        side, matrix = _side(source.table, reduction)
        factors = velocity_factors(source.table, side, robot.joint_kinds)
        source.table.done()
        return cls(source, np.array(factors), _to_joint(matrix), matrix)

    @classmethod
    def effort(cls, source: Source, robot: _Robot, reduction: Array | None) -> _Channel:
        side, matrix = _side(source.table, reduction)
        if source.table.raw("gain", None, f'number, list of numbers, or "{ESTIMATE}"') == ESTIMATE:
            factors = current_factors(source.table, len(robot.joint_kinds))
            drives = np.eye(len(robot.joint_kinds)) if matrix is None else matrix
            source.table.done()
            return cls(source, np.array(factors), matrix, matrix, tuple(map(tuple, drives.tolist())))
        # The gains of a robot file are those of the motors; they are valid at the joints only without a reduction.
        gains = robot.gains if side == "motor" or reduction is None else None
        factors = effort_factors(source.table, side, robot.joint_kinds, gains)
        source.table.done()
        return cls(source, np.array(factors), matrix, matrix)

    def read(self) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):  # reported by Recording
            values = self.source.values() * self.factors + self.zeros
            return values if self.to_joint is None else values @ self.to_joint


def _to_joint(matrix: Array | None) -> Array | None:
    """Return the matrix from rows of motor positions to joint positions: ``q_motor = R q`` for columns; samples are rows here."""
    return None if matrix is None else np.linalg.inv(matrix).T.astype(np.float64)


def _side(table: Table, reduction: Array | None) -> tuple[str, Array | None]:
    side = table.text("side", choices=["motor", "joint"])
    if side == "joint":
        return side, None
    if reduction is None:
        table.fail(
            "side 'motor' needs a reduction matrix: [transmission] reduction, here or in the robot file"
        )
    return side, reduction


def _time_keys(source: Source) -> tuple[float, bool]:
    """Return the unit of the time stamps in s, and whether to resample them evenly."""
    unit = source.table.text("unit", "s", choices=list(TIME))
    resample = source.table.boolean("resample", False)
    source.table.done()
    return TIME[unit], resample
