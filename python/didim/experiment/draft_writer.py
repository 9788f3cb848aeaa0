"""The text of an experiment file for one or several logs. Tested in ``tests/test_init.py`` and ``tests/test_init_logs.py``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .._tools.arrays import Array
from .._tools.toml import quoted
from .._tools.words import brief, counted, one_line, series
from ..errors import RecordingError
from ..log.resampling import LONGEST_GAP_STEPS, resampling, step_range, whole_rate
from ..log.sampling import time_faults
from ..log.units import ESTIMATE, TIME
from ..robot.robot import Robot
from .draft_columns import Column, listed
from .draft_files import EFFORTS, REPEATED, Log
from .draft_filters import moving_window
from .draft_servos import recording_lines
from .loop_tables import of_actuators

TWO_TURNS = 4.0 * math.pi
"""Range of positions beyond which they are taken for degrees: two turns in radians, more than most joints move."""
PREFERRED = ("actual", "act", "measured", "meas", "feedback", "--columns")
"""Words of the columns that are preferred where several groups are possible."""
USUAL_SHARE = 0.98
"""Share of a column's values that defines its usual range; spikes are rarer than the others."""
ROLLOUTS = ("episode_index", "episode", "rollout", "rollout_index")
"""Names of columns that number rollouts."""
OPEN_GAIN = "# gain = 1.0"
"""Commented line of a drive gain that is not known yet."""


@dataclass
class Draft:
    """An experiment file and its open questions."""

    text: str = ""
    read: list[str] = field(default_factory=list)
    """Sentences on what was taken for what."""
    notes: tuple[str, ...] = ()
    """Sentences on what reading the robot changed."""
    questions: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class DraftOptions:
    """Options of the user for a log.

    Attributes
    ----------
    rate_hz : float or None
        Sampling rate, if the log has no time stamps.
    gains : sequence of float, or "estimate"
        Drive gains, or none.
    sides : mapping of str to str
        "motor" or "joint" by table.
    servo : mapping of str to sequence of float
        Gains ``kp`` and ``kv`` of position servos, one for all joints or one for each.
    """

    rate_hz: float | None = None
    gains: Sequence[float] | str = ()
    sides: Mapping[str, str] = field(default_factory=dict)
    servo: Mapping[str, Sequence[float]] = field(default_factory=dict)
    ratio: float | None = None
    """Gear ratio of all joints that the torques fit best, if the columns are of motors and the robot has no reduction."""
    plain: bool = False
    """Whether neither friction laws nor a delay are chosen."""


class RecordingWriter:
    """Writes one ``[[recording]]``.

    Parameters
    ----------
    robot
        Robot of the log.
    source
        The log.
    name
        Name of the recording.
    file
        Name of the file in messages.
    options
        Options of the user.
    draft
        Draft that collects sentences and questions.
    """

    def __init__(
        self, robot: Robot, source: Log, name: str, file: str, options: DraftOptions, draft: Draft
    ) -> None:
        self.robot, self.source, self.name, self.file = robot, source, name, file
        self.rate, self.gains, self.sides = options.rate_hz, options.gains, options.sides
        self.servo = {"kp", "kv"} <= {*options.servo, *of_actuators(robot)}
        self.draft = draft
        self.guessed: set[str] = set()
        """Tables of positions that were taken for degrees by their range."""
        self.asked: set[str] = set()
        self.position = self._group("position")
        self.torque = self._group("torque") or self._group("current") or self._group("voltage")
        self.reference = self._group("reference")
        self.velocity = self._group("velocity")

    @property
    def motors(self) -> bool:
        """Whether columns are on the motor side."""
        return any(
            self._of_motors(table, columns)
            for table, columns in (("position", self.position), ("torque", self.torque))
            if columns
        )

    @property
    def positions_only(self) -> bool:
        """Whether the log only has commanded and measured positions, and the gains of the servos are known."""
        return bool(self.position and self.reference and not self.torque and self.servo)

    def lines(self) -> list[str]:
        """Return the lines of the table."""
        lines = ["", "[[recording]]", f"name = {quoted(self.name)}", *recording_lines(self.source)]
        stamps = [column for column in self.source.columns if column.what == "time"]
        # The header's stamp is the time of the measurement, another one the time of arrival.
        stamps.sort(key=lambda column: "stamp" not in str(column.name))
        for group in (stamps[:1], self.position, self.torque, self.reference):
            self.source.want(group)
        if self.source.note:
            self._tell(f"{self.source.note}, by what their names have in common; confirm it")
        lines += self._time(stamps)
        lines += self._motion("position", self.position)
        if self.velocity:
            lines += self._velocity()
        if not self.positions_only:
            lines += self._effort(self.torque)
        if self.reference:
            lines += self._motion("reference", self.reference)
        taken = (*stamps, *self.position, *self.velocity, *self.torque, *self.reference)
        used = {self._key(column) for column in taken}
        left = [
            str(column.name)
            for column in self.source.columns
            if column.what != REPEATED and self._key(column) not in used
        ]
        if left and self.source.named:
            lines += ["", f"# Columns that are not used: {', '.join(one_line(name) for name in left)}"]
        return lines

    @staticmethod
    def _key(column: Column) -> tuple[int, str | None, str | int]:
        return column.file, column.variable, column.name

    def _group(self, kind: str) -> list[Column]:
        """Return the columns of a kind, one per joint, by their numbers; ask if several are possible."""
        n = self.robot.n_dof
        groups: dict[tuple[int, str | None, str], list[Column]] = {}
        for column in self.source.columns:
            if column.what == kind:
                variable = column.variable if isinstance(column.name, int) else None
                groups.setdefault((column.file, variable, column.stem), []).append(column)
        whole = [group for group in groups.values() if len(group) == n and self._one_each(group)]
        every = [column for group in groups.values() for column in group]
        if not whole and len(every) == n:
            whole = [every]
        if len(whole) > 1:
            better = [group for group in whole if any(word in str(group[0].stem) for word in PREFERRED)]
            if len(better) == 1:
                whole = better
            elif kind == "velocity":  # only as commented lines
                return []
            else:
                self.asked.add(kind)
                names = brief("; ".join(listed(group) for group in whole), 90)
                self._ask(
                    f"several groups of columns may be the {kind}s ({names}): choose one with --columns {kind}=..."
                )
                return []
        if not whole:
            return []
        group = whole[0]
        return sorted(group, key=lambda column: column.number or 0) if self._one_each(group) else group

    @staticmethod
    def _one_each(group: Sequence[Column]) -> bool:
        numbers = [column.number for column in group]
        return len(group) == 1 or (None not in numbers and len(set(numbers)) == len(numbers))

    def _ask(self, question: str) -> None:
        if question not in self.draft.questions:
            self.draft.questions.append(question)

    def _tell(self, sentence: str) -> None:
        if sentence not in self.draft.read:
            self.draft.read.append(sentence)

    def _time(self, stamps: list[Column]) -> list[str]:
        if not stamps:
            if self.rate is not None:
                self._tell(f"rate {self.rate:g} Hz, as given")
                return [f"rate_hz = {self.rate:.9g}", *self._windows(None)]
            self._ask(
                "no column of time stamps was found: at what rate was the log recorded (rate_hz, or --rate)?"
            )
            return ["# rate_hz = 1000 # at what rate was it recorded? No column of time stamps was found"]
        stamp = stamps[0]
        t = self._first_rollout(self.source.values([stamp])[:, 0])
        # Messages may repeat a stamp; resampling drops these.
        steps = np.diff(t)
        step = float(np.median(steps[steps != 0.0])) if steps.any() else math.nan
        if not step > 0.0:
            raise RecordingError(
                f"{self.file}: column {stamp.name!r} looks like time stamps, and does not grow"
            )
        # Robots are logged at 10 Hz to 50 kHz.
        unit = stamp.unit or ("s" if step < 0.11 else "ms" if step < 110.0 else "us")
        unit = unit if unit in TIME else "s"
        t = t * TIME[unit]
        faults = list(time_faults(t, None, self.file))
        how = "" if stamp.unit else " # confirm"
        table = ["[recording.time]", *self.source.lines([stamp], self.robot)]
        table.append(f"unit = {quoted(unit)}{how}")
        if faults:
            return self._resampled(stamp, unit, t, faults[0].sentence, table)
        if self.rate is None:
            self.rate = whole_rate((len(t) - 1) / float(t[-1] - t[0]))
        self._tell(f"time stamps {stamp.name!r} in {unit}: {self.rate:.9g} Hz, {counted(len(t), 'sample')}")
        return [f"rate_hz = {self.rate:.9g} # confirm", *self._windows(t), *table]

    @property
    def _rollouts(self) -> list[Column]:
        """Return the column that numbers rollouts, if it has several numbers."""
        rollouts = [column for column in self.source.columns if str(column.name) in ROLLOUTS]
        return [column for column in rollouts[:1] if np.ptp(self.source.values([column])) > 0.0]

    def _first_rollout(self, t: Array) -> Array:
        """Return the time stamps of the first rollout; others restart the time."""
        if not self._rollouts:
            return t
        number = self.source.values(self._rollouts)[:, 0]
        return t[: int(np.argmax(number != number[0]))]

    def _resampled(self, stamp: Column, unit: str, t: Array, fault: str, table: list[str]) -> list[str]:
        """Return the lines for uneven time stamps: the log is resampled, with a sentence on the effect."""
        plan = resampling(t, self.rate, self.file)
        self.rate = plan.rate_hz
        self._tell(f"time stamps {stamp.name!r} in {unit}: uneven, {counted(len(t), 'sample')} ({fault})")
        self._tell(f"resample = true: {plan.sentence(step_range(t))}")
        steps = np.diff(t)
        # With gaps, the windows are the stretches between them.
        windows = [] if (steps > LONGEST_GAP_STEPS * np.median(steps)).any() else self._windows(t)
        return [
            f"rate_hz = {plan.rate_hz:.9g} # confirm",
            *windows,
            *table,
            f"resample = true # confirm: steps of {step_range(t)}; white noise keeps {plan.noise_variance:.2f} of its variance",
        ]

    def _windows(self, t: Array | None) -> list[str]:
        """Return the line of the window of the motion, if the arm rests before or after; or of the rollouts."""
        if self._rollouts:
            return [f"rollouts = {quoted(str(self._rollouts[0].name))} # each has a start of its own"]
        if not self.position or self.rate is None:
            return []
        q = self.source.values(self.position)
        window = moving_window(q, np.arange(len(q)) / self.rate if t is None else t - t[0], self.rate)
        if window is None:
            return []
        start, stop = window
        self._tell(
            f"the arm moves from {start:g} s to {stop:g} s; the samples before and after are left out (windows_s)"
        )
        return [
            f"windows_s = [[{start:g}, {stop:g}]] # confirm: before and after the arm rests, or is brought to its start"
        ]

    def _missing(self, table: str) -> list[str]:
        """Return commented lines of a table whose columns are unknown, and ask for them."""
        n = self.robot.n_dof
        names = quoted([str(column.name) for column in self.source.columns][: 3 * n])
        torque = table == "torque"
        option = f"--columns {table}=...{' (or current)' if torque else ''}, "
        blocks = self._open_blocks() or self._other_count(table)
        if not self.source.named and len(self.source.columns) == 1:
            blocks = " (or --values-per-sample N?)"
        if self.source.joints:
            known = series(self.source.joints, 60)
            self._ask(
                f"which of the log's joints {known} are the {counted(n, 'joint')} of the robot? "
                "Name them in order: --columns position=JOINT,JOINT,..."
            )
            names = quoted(list(self.source.joints))
        else:
            # A fit on positions does not need torques.
            servos = bool(torque and self.reference and self.position and not blocks)
            also = "; or give --kp and --kv of servos (fit on positions)" if servos else blocks
            question = f"which columns hold the {table}s of the {counted(n, 'joint')}"
            answer = f"Give {option}or fill in [recording.{table}]"
            if not self.asked & {table, *(EFFORTS if torque else ())}:  # one question on a signal is enough
                self._ask(f"{question}? {answer}{also}" if servos else f"{question}{also}? {answer}")
        return [
            f"# [recording.{table}] # which {counted(n, 'column')} hold the {table}s? There are {names[1:-1]}",
            *(f"# {line}" for line in self.source.keys),
            "# columns = []",
            f'# unit = "{"N.m" if torque else "rad"}"',
            '# side = "joint"',
        ]

    def _other_count(self, wanted: str) -> str:
        """Return the part of the question on a signal with a different number of joints."""
        kinds = EFFORTS if wanted == "torque" else (wanted,)
        for kind in kinds:
            there = [column for column in self.source.columns if column.what == kind]
            if there and len(there) != self.robot.n_dof and self._one_each(there):
                return f"; the log has {counted(len(there), kind)}: is it of another robot"
        return ""

    def _open_blocks(self) -> str:
        """Return unnamed columns that are candidates."""
        if self.source.named:
            return ""
        blocks: dict[str, list[Column]] = {}
        for column in self.source.columns:
            if column.what == "other":
                blocks.setdefault(column.stem, []).append(column)
        tables = [
            f"{group[0].name}-{group[-1].name}" for group in blocks.values() if len(group) == self.robot.n_dof
        ]
        return f" ({brief(' or '.join(tables), 50)})" if tables else ""

    def _of_motors(self, table: str, columns: list[Column]) -> bool:
        """Whether values are on the motor side, by the user's options or the names of the columns."""
        return (
            self.sides[table] == "motor" if table in self.sides else all(column.motor for column in columns)
        )

    def _side(self, table: str, columns: list[Column]) -> str:
        motor = self._of_motors(table, columns)
        return f'side = "{"motor" if motor else "joint"}"' + (
            "" if motor or table in self.sides else ' # confirm: "motor" for values in front of the gears'
        )

    def _plausible(self, columns: list[Column]) -> Array:
        """Return the values of a signal; refuse an absurd value, as from two numbers run together."""
        values = self.source.values(columns)
        apart = np.abs(values - np.median(values, axis=0))
        usual = np.quantile(apart, USUAL_SHARE, axis=0)
        # Largest distance of a value from the median, in usual deviations: no sensor's range exceeds its signal by so much, and
        # two numbers run together easily do.
        wrong = np.argwhere((apart > 1e6 * usual) & (usual > 0.0))
        if len(wrong):
            row, column = (int(index) for index in wrong[0])
            raise RecordingError(
                f"{self.source.place(columns[column], row + 1)}, is {values[row, column]:.6g}, and {100 * USUAL_SHARE:g} % of the "
                f"values are within {usual[column]:.3g} of their median: is a line cut?"
            )
        return values

    def _motion(self, table: str, columns: list[Column]) -> list[str]:
        if not columns:
            return self._missing("position")
        values = self._plausible(columns)
        motor = self._of_motors(table, columns)
        units, sure = [], True
        for column, kind, value in zip(columns, self.robot.joint_kinds, values.T, strict=True):
            span = float(np.ptp(value))
            known = column.unit if column.unit in ("rad", "deg", "m", "mm", "count", "percent") else None
            if known is None:
                sure = False
                if kind == "revolute" or motor:
                    known = "deg" if (span > TWO_TURNS or self._is_lerobot) and not motor else "rad"
                else:
                    known = "mm" if span > 20.0 else "m"
            units.append(known)
        # All revolute joints of a log have one unit.
        if not sure and "deg" in units:
            self.guessed.add(table)
            units = ["deg" if unit == "rad" else unit for unit in units]
        ranges = ", ".join(f"{value:.3g}" for value in np.ptp(values, axis=0))
        self._tell(f"{table} {listed(columns)} in {brief('/'.join(dict.fromkeys(units)), 30)}")
        lines = [f"[recording.{table}] # ranges: {ranges}", *self.source.lines(columns, self.robot)]
        lines.append(_unit_line(units, sure=sure))
        if "count" in units:
            lines.append("# counts_per_rev = 4096 # how many counts make one turn?")
            self._ask(f"how many counts make one turn (counts_per_rev under [recording.{table}])?")
        return [*lines, self._side(table, columns)]

    @property
    def _is_lerobot(self) -> bool:
        """Whether the log is a LeRobot dataset, whose arm joints are in degrees or percent, never in radians."""
        return getattr(getattr(self.source, "data", None), "kind", "") == "LeRobot"

    def _velocity(self) -> list[str]:
        """Return commented lines: measured velocities may be better than differences of positions, or delayed."""
        unit = "rad/s" if "revolute" in self.robot.joint_kinds else "m/s"
        own = self.source.lines(self.velocity, self.robot)
        lines = ["[recording.velocity]", *own, f'unit = "{unit}"', 'side = "joint"']
        head = "# Measured velocities, to be taken in place of differences of the positions:"
        return [head, *(f"# {line}" for line in lines)]

    def _effort(self, columns: list[Column]) -> list[str]:
        if not columns:
            return self._missing("torque")
        what = columns[0].what
        units = []
        for column, kind in zip(columns, self.robot.joint_kinds, strict=True):
            usual = "N.m" if kind == "revolute" or self._of_motors("torque", columns) else "N"
            usual = {"current": "A", "voltage": "V"}.get(what, usual)
            units.append(column.unit if column.unit in ("N.m", "N", "A") else usual)
        sure = all(column.unit in ("N.m", "N", "A") for column in columns)
        values = self._plausible(columns)
        largest = ", ".join(f"{value:.3g}" for value in np.abs(values).max(axis=0))
        self._tell(f"torque {listed(columns)} in {brief('/'.join(dict.fromkeys(units)), 30)}")
        lines = [f"[recording.torque] # largest values: {largest}", *self.source.lines(columns, self.robot)]
        lines.append(_unit_line(units, sure=sure))
        if set(units) & {"A", "V"}:
            lines.append(self._gain(columns, units[0]))
        return [*lines, self._side("torque", columns)]

    def _gain(self, columns: list[Column], unit: str) -> str:
        if self.gains == ESTIMATE:
            return f'gain = "{ESTIMATE}" # needs another log with a load of known mass: payload, and [payload.NAME]'
        if self.gains:
            gains = [float(gain) for gain in self.gains]
            return f"gain = {gains[0]:g}" if len(gains) == 1 else f"gain = {quoted(gains)}"
        motor = self._of_motors("torque", columns)
        if self.robot.gains is not None and (motor or self.robot.reduction is None):
            return "# gain: that of the robot file"
        self._ask(
            f"how many N.m are one {unit} (--gain, or gain under [recording.torque]; "
            "--gain estimate if another log has a load of known mass)?"
        )
        return f"{OPEN_GAIN} # how many N.m are one {unit}? One number, or one for each joint"


def _unit_line(units: Sequence[str], *, sure: bool) -> str:
    unit = units[0] if len(set(units)) == 1 else list(units)
    return f"unit = {quoted(unit)}{'' if sure else ' # confirm'}"


def names_of(robot: Robot) -> str:
    """Return the names of the joints as the end of a comment, if the robot has them."""
    return f": {one_line(', '.join(robot.joint_names))}" if robot.joint_names else ""
