"""A recording: logged motion and torque of one run, joint side, SI units, and how it is read from files.

Motor-side logs are brought to the joints with the reduction matrix R (rows motors, columns joints):
``q_motor = R q`` and ``tau = R^T tau_motor``. Nothing is guessed: a missing sample, an uneven time stamp or a length that
differs is an error, unless `resample` asks for even samples. Tested in ``tests/test_recording.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import Table
from .._tools.words import counted, series
from ..errors import RecordingError
from ..robot.robot import Robot
from ..robot.transmission import reduction_matrix
from .data_folder import SOURCES, DataFolder, Source
from .data_format import Windows
from .recording import OWN, Recording, Role, clock
from .resampling import resampling, step_range
from .sampling import MINIMUM_SAMPLES, TimeFault, check_time, rollout_windows, slices, stretches, time_faults
from .units import ESTIMATE, TEMPERATURE, TIME, effort_factors, position_factors, velocity_factors

GAPS = "gaps"
"""Value of ``rollouts`` that starts a rollout at each gap of the time stamps; any other value names a column."""


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
    robot: Robot,
    reduction: Array | None,
    folder: DataFolder,
    faults: list[tuple[str, TimeFault]] | None = None,
) -> Recording:
    """Read one ``[[recording]]`` of an experiment.

    Parameters
    ----------
    table
        The table, with the sub-tables `time`, `position`, `velocity`, `torque`, `external`, `temperature` and `reference`.
    name
        Name of the recording where the table gives none.
    robot
        Robot that was logged.
    reduction
        (n_dof, n_dof) reduction matrix R, or None.
    folder
        Folder of the data files.
    faults
        List that receives recording and fault of wrong time stamps, instead of an error: the recording then has the rate of
        the time stamps and, without `windows_s`, one window for each stretch between two gaps.

    Raises
    ------
    ExperimentError
        On a wrong key or combination of keys.
    RecordingError
        On a file that contradicts its table; the message names file, row and column.
    """
    name, role = table.text("name", name), cast("Role", table.text("role"))
    rate = table.number("rate_hz", None)
    windows_s = table.raw("windows_s")
    rollouts = table.text("rollouts", None)
    if rollouts is not None and windows_s:
        table.fail("give rollouts or windows_s, not both: each rollout is a window")
    payload = table.text("payload")
    kp = table.spread("kp", len(robot.joint_kinds), None)
    own = [key for key in OWN if table.text(key) == "own"]
    signals = _signals(table, robot, reduction, folder, rate, rollouts)
    values, t, base = signals.values, signals.t, signals.base
    _check_counts(name, values if t is None else {**values, "time": t}, signals.sources, base)
    where = "" if t is None else signals.sources["time"].file.name
    clock_of = _Clock(t, rate)
    notes: tuple[str, ...] = ()
    if rollouts is not None:
        clock_of = clock_of.of_rollouts(_rollouts(table, signals, rollouts), where)
    elif t is not None and signals.resample:
        plan = resampling(t, rate, where)
        notes = (f"recording '{name}': {plan.sentence(step_range(t))}",)
        values = {key: plan.apply(samples) for key, samples in values.items()}
        clock_of = _Clock(plan.t, plan.rate_hz, plan.windows)
        signals.origin["resampled"] = {"rate_hz": plan.rate_hz, "noise_variance": plan.noise_variance}
    elif t is not None:
        clock_of = clock_of.checked(name, where, faults)
    rate = clock_of.rate_hz
    assert rate is not None  # a missing rate without time stamps was refused above
    first = values[base]
    windows = slices(table, windows_s, rate, len(first))
    if signals.resample:
        windows = _inside(table, windows, clock_of.windows, rate)
    return Recording(
        name=name,
        t=clock(len(first), rate) if clock_of.t is None else clock_of.t,
        q=values.get("position", np.full_like(first, np.nan)),
        dq=values.get("velocity"),
        tau=values.get("torque"),
        external=values.get("external"),
        temperature=values.get("temperature"),
        rate_hz=rate,
        q_ref=values.get("reference"),
        windows=windows or clock_of.windows,
        has_positions=base == "position",
        digests={source.file.name: source.file.sha256 for source in signals.sources.values()},
        origin=signals.origin,
        notes=notes,
        drives=signals.drives,
        role=role,
        payload=payload,
        own=tuple(own),
        kp=None if kp is None else tuple(kp),
    )


@dataclass(frozen=True)
class _Signals:
    """Values of a recording by table, as in its files.

    `t` are the time stamps (s), if any; `base` is the table whose samples the others must match; `resample` says whether even
    samples are wanted; `drives` is the reduction of currents with unknown gains, and `origin` the record for results.
    """

    sources: Mapping[str, Source]
    values: dict[str, Array]
    t: Array | None
    base: str
    resample: bool
    drives: tuple[tuple[float, ...], ...] | None
    origin: dict[str, Any]


def _signals(
    table: Table,
    robot: Robot,
    reduction: Array | None,
    folder: DataFolder,
    rate: float | None,
    rollouts: str | None,
) -> _Signals:
    """Read the signals, once all keys are checked."""
    sources = _sources(table, robot, folder)
    channels = {
        key: _channel(key, source, robot, reduction) for key, source in sources.items() if key != "time"
    }
    resample = False
    if "time" in sources:
        time = sources["time"].table
        period, resample = TIME[time.text("unit")], time.boolean("resample")
        time.done()
    elif rate is None:
        table.fail("give rate_hz or the table [recording.time]")
    # Without measured positions the reference defines the samples of the recording.
    base = "position" if "position" in sources else "reference"
    if rollouts is not None and rollouts != GAPS:
        sources[base].file.want([rollouts], None, 1)
    values = {key: channel.read() for key, channel in channels.items()}
    t = sources["time"].values()[:, 0] * period if "time" in sources else None
    drives = channels["torque"].drives if "torque" in channels else None
    origins: dict[str, Any] = {key: source.table.content for key, source in sources.items()}
    for key, channel in channels.items():
        # The factors include counts and drive gains, whichever file declares them.
        origins[key]["factors_to_si"] = channel.factors.tolist()
        if np.any(channel.zeros):
            origins[key]["zeros_si"] = np.asarray(channel.zeros).tolist()
        if channel.reduction is not None:
            origins["reduction"] = channel.reduction.tolist()
    return _Signals(sources, values, t, base, resample, drives, origins)


def _rollouts(table: Table, signals: _Signals, rollouts: str) -> Windows:
    """Return the windows of the rollouts, by a column or by gaps of the time stamps."""
    if signals.resample:
        table.fail("rollouts of uneven samples are not read: resample = true is for one run")
    if signals.t is None and rollouts == GAPS:
        table.fail("rollouts = 'gaps' needs the table [recording.time]")
    file, count = signals.sources[signals.base].file, len(signals.values[signals.base])
    number = None if rollouts == GAPS else file.get([rollouts], None, 1)[:, 0]
    return rollout_windows(count, number, signals.t)


def _sources(table: Table, robot: Robot, folder: DataFolder) -> dict[str, Source]:
    """Return the sources of the signals by table, the last keys of a recording."""
    tables = {key: table.table(key, None) for key in SOURCES}
    table.done()
    if tables["position"] is None and tables["reference"] is None:
        table.fail("the table [recording.position] is missing")
    if tables["external"] is not None and tables["torque"] is None:
        table.fail("the table [recording.external] needs [recording.torque] beside it")
    widths: dict[str, tuple[int]] = {"time": (1,)}
    columns = None if tables["temperature"] is None else tables["temperature"].raw("columns", None)
    if isinstance(columns, list) and len(columns) == 1:  # all joints share it
        widths["temperature"] = (1,)
    joints = (len(robot.joint_kinds), robot.joint_names)
    return {
        key: folder.source(key, part, *widths.get(key, joints))
        for key, part in tables.items()
        if part is not None
    }


def _check_counts(name: str, values: Mapping[str, Array], sources: Mapping[str, Source], base: str) -> None:
    """Refuse signals of different lengths, and too few samples."""
    count = len(values[base])
    for key, samples in values.items():
        if len(samples) != count:
            raise RecordingError(
                f"{name}: {key} has {counted(len(samples), 'sample')} ({sources[key].file.name}), "
                f"{base} has {count} ({sources[base].file.name})"
            )
    if count < MINIMUM_SAMPLES:
        raise RecordingError(
            f"{sources[base].file.name}: at least {MINIMUM_SAMPLES} samples are needed, got {count}"
        )


@dataclass(frozen=True)
class _Clock:
    """Time stamps of the samples (s), None for even ones, their rate (Hz), and windows between gaps."""

    t: Array | None
    rate_hz: float | None
    windows: Windows = ()

    def of_rollouts(self, windows: Windows, where: str) -> _Clock:
        """Return the clock of rollouts, which have one rate."""
        rate, t = self.rate_hz, self.t
        if t is not None:
            for start, stop in windows:
                rate = check_time(t[start:stop], rate, f"{where}, from row {start + 1}")
        return _Clock(None, rate, windows)

    def checked(self, name: str, where: str, faults: list[tuple[str, TimeFault]] | None) -> _Clock:
        """Return the clock of even time stamps; the faults of others are collected, or an error without a list for them."""
        assert self.t is not None
        wrong = list(time_faults(self.t, self.rate_hz, where))
        if not wrong:
            return _Clock(self.t, check_time(self.t, self.rate_hz, where))
        if faults is None or not np.isfinite(wrong[0].rate_hz):
            raise RecordingError(wrong[0].sentence + _offer(wrong[0], self.t, self.rate_hz, where))
        faults += [(name, fault) for fault in wrong]
        gaps = [fault.sample for fault in wrong if fault.kind == "gap" and fault.sample is not None]
        return _Clock(None, wrong[0].rate_hz, stretches(gaps, len(self.t)))


def _offer(fault: TimeFault, t: Array, rate_hz: float | None, file: str) -> str:
    """Return the end of the sentence that offers resampling, with its effect on the noise."""
    if fault.kind not in ("gap", "uneven"):
        return ""
    try:
        plan = resampling(t, rate_hz, file)
    except RecordingError:
        return ""
    return (
        f"; resample = true under [recording.time] interpolates at {plan.rate_hz:.6g} Hz (white noise keeps "
        f"{plan.noise_variance:.2f} of its variance); if only the stamps jitter, give rate_hz and no [recording.time]"
    )


def _inside(table: Table, windows: Windows, between_gaps: Windows, rate_hz: float) -> Windows:
    """Refuse a window with a gap."""
    for start, stop in windows:
        if not any(first <= start and stop <= last for first, last in between_gaps):
            there = series(
                (f"[{first / rate_hz:.6g}, {last / rate_hz:.6g}]" for first, last in between_gaps), 50
            )
            table.fail(
                f"the window [{start / rate_hz:.6g}, {stop / rate_hz:.6g}] s has a gap in it, which resampling does not bridge; "
                f"stretches without one: {there} s"
            )
    return windows


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

    def read(self) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):  # reported by Recording
            values = self.source.values() * self.factors + self.zeros
            return values if self.to_joint is None else values @ self.to_joint


def _channel(key: str, source: Source, robot: Robot, reduction: Array | None) -> _Channel:
    """Return the channel of one of the tables of a recording."""
    table, kinds = source.table, robot.joint_kinds
    if key == "temperature":
        zero = TEMPERATURE[table.text("unit")]
        table.done()
        return _Channel(source, np.ones(1), None, None, zeros=zero)
    side, matrix = _side(table, reduction)
    drives, zeros = None, np.zeros(1)
    # ``q_motor = R q`` is for columns; samples are rows here.
    to_joint = None if matrix is None else np.asarray(np.linalg.inv(matrix).T)
    if key in ("torque", "external"):
        # The gains of a robot file are those of the motors; they are valid at the joints only without a reduction.
        gains = robot.gains if side == "motor" or reduction is None else None
        factors, to_joint = effort_factors(table, side, kinds, gains), matrix
        if table.raw("gain", None) == ESTIMATE:
            drives = tuple(map(tuple, (np.eye(len(kinds)) if matrix is None else matrix).tolist()))
    elif key == "velocity":
        factors = velocity_factors(table, side, kinds)
    else:
        factors, zeros = position_factors(table, side, kinds, [limits.position for limits in robot.limits])
    table.done()
    return _Channel(source, factors, to_joint, matrix, drives, zeros)


def _side(table: Table, reduction: Array | None) -> tuple[str, Array | None]:
    side = table.text("side")
    if side == "joint":
        return side, None
    if reduction is None:
        table.fail(
            "side 'motor' needs a reduction matrix: [transmission] reduction, here or in the robot file"
        )
    return side, reduction
