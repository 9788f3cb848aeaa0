"""``didim init``: a first experiment file for a log, from what its columns say.

Names of columns are guessed at, and everything guessed is marked to be confirmed. What cannot be guessed is left as a commented
line with a question. Tested in ``tests/test_init.py``.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.files import write_atomically
from .._tools.words import counted
from ..errors import ExperimentError, RecordingError
from ..log.data_file import open_data_file
from ..log.recording import Recording
from ..log.sampling import time_faults
from ..robot.robot import Robot
from ..robot.robot_file import PACKAGED, load_robot
from ..signal.spectrum import motion_band
from .draft_columns import Column, column, column_count, first_line

TWO_TURNS = 4.0 * math.pi
"""Positions through more than this are taken for degrees: few joints turn so far."""
CUTOFF_TIMES = 20.0
"""Times the band of the velocity that the cut-off is set at: reversals under friction reach far beyond it. 40 Hz for the
simulated TX40, whose experiment has 60."""


@dataclass
class Draft:
    """An experiment file and what is open about it."""

    text: str = ""
    read: list[str] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    questions: list[str] = field(default_factory=list)


def initialise(
    robot: str, log: Path, output: Path | None = None, *, rate_hz: float | None = None, force: bool = False
) -> tuple[Path, Draft]:
    """Write an experiment file for a log.

    Parameters
    ----------
    robot : str
        Packaged name, or path of a robot file.
    log : Path
        Text file with one sample a line (.csv, .txt, .tsv, .dat).
    output : Path, optional
        Experiment file; beside the log, with its name, by default.
    rate_hz : float, optional
        Sampling rate, where the log has no time stamps.
    force : bool
        Overwrite an existing file.

    Returns
    -------
    path, draft
        Where it is, and what was read and what is open.

    Raises
    ------
    ExperimentError
        When the file exists, or the log is of another kind.
    RobotError, RecordingError
        When robot or log cannot be read.
    """
    model = load_robot(robot)
    path = log.with_suffix(".toml") if output is None else output
    if path.exists() and not force:
        raise ExperimentError(f"{path}: the file is there already; --force overwrites it, -o writes another")
    if log.suffix.lower() not in (".csv", ".txt", ".tsv", ".dat"):
        raise ExperimentError(
            f"{log}: `didim init` reads text files (.csv .txt .tsv .dat), write the experiment file by hand"
        )
    if rate_hz is not None and not 0.0 < rate_hz < math.inf:
        raise ExperimentError(f"the rate must be a positive number of Hz, got {rate_hz:g}")
    draft = _Writer(model, _named(robot, path), log, path, rate_hz).draft()
    draft.notes = model.notes
    write_atomically(path, draft.text)
    return path, draft


def _joint_list(robot: Robot) -> str:
    """Names of the joints as the end of a comment, where the robot has them."""
    names = ", ".join(robot.joint_names)
    return f": {''.join(c if c.isprintable() else ' ' for c in names)}" if names else ""


def _named(robot: str, path: Path) -> str:
    """Return how the experiment names the robot: a path is relative to the experiment file."""
    if (PACKAGED / f"{robot}.toml").is_file() and not robot.endswith(".toml"):
        return robot
    return Path(os.path.relpath(robot, path.parent)).as_posix()


class _Writer:
    """Puts the file together."""

    def __init__(self, robot: Robot, named: str, log: Path, path: Path, rate_hz: float | None) -> None:
        self.robot, self.named, self.log, self.path, self.rate = robot, named, log, path, rate_hz
        self.file = Path(os.path.relpath(log, path.parent)).as_posix()
        self.draft_ = Draft()
        self.delimiter, names = first_line(log)
        self.data = open_data_file(log, log.name, delimiter=self.delimiter, header=None)
        self.columns = (
            [column(name, self.robot.joint_names) for name in names]
            if names is not None
            else self._unnamed(column_count(log, self.delimiter))
        )

    def _values(self, columns: list[Column]) -> Array:
        return self.data.get([item.name for item in columns], None, len(columns))

    def _unnamed(self, width: int) -> list[Column]:
        """Guess columns by their number: time first if there is one more, then positions, velocities perhaps, torques."""
        n = self.robot.n_dof
        layouts = {
            2 * n: ("position", "torque"),
            2 * n + 1: ("time", "position", "torque"),
            3 * n: ("position", "velocity", "torque"),
            3 * n + 1: ("time", "position", "velocity", "torque"),
            4 * n: ("position", "velocity", "acceleration", "torque"),
            4 * n + 1: ("time", "position", "velocity", "acceleration", "torque"),
        }
        found: list[Column] = []
        for what in layouts.get(width, ()):
            count = 1 if what == "time" else n
            found += [Column(len(found) + k + 1, what, k + 1) for k in range(count)]
        return found or [Column(k + 1, "other", k + 1) for k in range(width)]

    def _of(self, *kinds: str) -> list[Column]:
        """Columns of the first kind that has one for each joint, in the order of their numbers."""
        n = self.robot.n_dof
        for kind in kinds:
            found = [item for item in self.columns if item.what == kind]
            if len(found) == n:
                if n > 1 and None not in {item.number for item in found}:
                    found.sort(key=lambda item: item.number or 0)
                return found
        return []

    def _ask(self, question: str) -> None:
        self.draft_.questions.append(question)

    def draft(self) -> Draft:
        robot, n = self.robot, self.robot.n_dof
        position = self._of("position")
        torque = self._of("torque", "current", "voltage")
        reference = self._of("reference")
        stamps = [item for item in self.columns if item.what == "time"]
        speed = "m_s" if "prismatic" in robot.joint_kinds else "rad_s"
        lines = [
            f'# Written by `didim init` from {self.log.name}. Lines that say "confirm" are guesses;',
            f"# `didim check {self.path.name}` looks for wrong ones.",
            "schema = 1",
            f"name = {json.dumps(self.log.stem)}",
            f"robot = {json.dumps(self.named)} # {counted(n, 'joint')}{_joint_list(robot)}",
            "",
            "# Friction; without this table that of the robot file. Smooth for a simulated log, a dead zone for standstill.",
            "# [friction]",
            '# coulomb = "tanh"',
            f"# smoothing_{speed} = 0.01",
            '# coulomb = "sign"',
            f"# dead_zone_{speed} = 0.01",
            "",
            "[[recording]]",
            f"name = {json.dumps(self.log.stem)}",
        ]
        time_lines = self._time(stamps)
        lines += time_lines
        lines += self._motion("position", position)
        lines += self._effort(torque)
        if reference:
            lines += self._motion("reference", reference)
        if any(item.motor for item in (*position, *torque)) and robot.reduction is None:
            lines += [
                "",
                "# What are the gear ratios? Rows are motors, columns joints: q_motor = reduction q.",
                "# [transmission]",
                f"# reduction = {json.dumps(np.eye(n, dtype=int).tolist())}",
            ]
            self._ask(
                "the columns are of motors, and the robot file has no reduction: fill in [transmission]"
            )
        lines += self._signal(position)
        used = {item.name for item in (*position, *torque, *reference, *stamps[:1])}
        left = [str(item.name) for item in self.columns if item.name not in used]
        if left:
            lines += ["", f"# Columns that are not used: {', '.join(left)}"]
        self.draft_.text = "\n".join(lines) + "\n"
        return self.draft_

    def _source(self, columns: list[Column]) -> list[str]:
        lines = [f"file = {json.dumps(self.file)}"]
        if self.delimiter != ",":
            lines.append(f"delimiter = {json.dumps(self.delimiter)}")
        lines.append(f"columns = {json.dumps([item.name for item in columns], ensure_ascii=False)}")
        return lines

    def _time(self, stamps: list[Column]) -> list[str]:
        if not stamps:
            if self.rate is not None:
                self.draft_.read.append(f"rate {self.rate:g} Hz, as told")
                return [f"rate_hz = {self.rate:.9g}"]
            self._ask(
                "no column of time stamps was found: at what rate was the log recorded (rate_hz, or --rate)?"
            )
            return ["# rate_hz = 1000 # at what rate was it recorded? No column of time stamps was found"]
        stamp = stamps[0]
        t = self._values([stamp])[:, 0]
        step = float(np.median(np.diff(t))) if len(t) > 1 else math.nan
        if not step > 0.0:
            raise RecordingError(
                f"{self.log.name}: column {stamp.name!r} looks like time stamps, and does not grow"
            )
        # A robot is logged at 10 Hz to 50 kHz.
        unit = stamp.unit or ("s" if step < 0.11 else "ms" if step < 110.0 else "us")
        seconds = {"s": 1.0, "ms": 1e-3, "us": 1e-6}.get(unit)
        if seconds is None:
            unit, seconds = "s", 1.0
        faults = list(time_faults(t * seconds, None, self.log.name))
        rate = faults[0].rate_hz if faults else (len(t) - 1) / (float(t[-1] - t[0]) * seconds)
        # Time stamps are rounded: a whole number of Hz within a thousandth is meant.
        rate = round(rate) if round(rate) > 0 and abs(rate - round(rate)) < 1e-3 * rate else rate
        if self.rate is None:
            self.rate = rate
        else:
            rate = self.rate
        self.draft_.read.append(
            f"time stamps {stamp.name!r} in {unit}: {rate:.9g} Hz, {counted(len(t), 'sample')}"
        )
        for fault in faults[:1]:
            self._ask(fault.sentence)
        how = "" if stamp.unit else " # confirm"
        return [
            f"rate_hz = {rate:.9g} # confirm",
            "[recording.time]",
            *self._source([stamp]),
            f"unit = {json.dumps(unit)}{how}",
        ]

    def _missing(self, table: str, wanted: str) -> list[str]:
        n = self.robot.n_dof
        names = json.dumps([str(item.name) for item in self.columns][: 3 * n])
        self._ask(
            f"which columns hold the {wanted}s of the {counted(n, 'joint')}? Fill in [recording.{table}]"
        )
        return [
            f"# [recording.{table}] # which {counted(n, 'column')} hold the {wanted}s? There are {names[1:-1]}",
            f"# file = {json.dumps(self.file)}",
            "# columns = []",
            f'# unit = "{"rad" if table == "position" else "N.m"}"',
            '# side = "joint"',
        ]

    def _side(self, columns: list[Column]) -> str:
        motor = all(item.motor for item in columns)
        return f'side = "{"motor" if motor else "joint"}"' + (
            "" if motor else ' # confirm: "motor" for values in front of the gears'
        )

    def _motion(self, table: str, columns: list[Column]) -> list[str]:
        if not columns:
            return self._missing(table, "position")
        values = self._values(columns)
        motor = all(item.motor for item in columns)
        units, sure = [], True
        for item, kind, value in zip(columns, self.robot.joint_kinds, values.T, strict=True):
            span = float(np.ptp(value))
            told = item.unit if item.unit in ("rad", "deg", "m", "mm", "count") else None
            if told is None:
                sure = False
                if kind == "revolute" or motor:
                    told = "deg" if span > TWO_TURNS and not motor else "rad"
                else:
                    told = "mm" if span > 20.0 else "m"
            units.append(told)
        # All revolute joints of one log are in one unit.
        if not sure and "deg" in units:
            units = ["deg" if unit == "rad" else unit for unit in units]
        unit = json.dumps(units[0] if len(set(units)) == 1 else units)
        ranges = ", ".join(f"{value:.3g}" for value in np.ptp(values, axis=0))
        self.draft_.read.append(f"{table} {_listed(columns)} in {'/'.join(dict.fromkeys(units))}")
        lines = [f"[recording.{table}] # ranges: {ranges}", *self._source(columns)]
        lines.append(f"unit = {unit}" + ("" if sure else " # confirm"))
        if "count" in units:
            lines.append("# counts_per_rev = 4096 # how many counts make one turn?")
            self._ask(f"how many counts make one turn (counts_per_rev under [recording.{table}])?")
        return [*lines, self._side(columns)]

    def _effort(self, columns: list[Column]) -> list[str]:
        if not columns:
            return self._missing("torque", "torque")
        what = columns[0].what
        units = []
        for item, kind in zip(columns, self.robot.joint_kinds, strict=True):
            usual = "N.m" if kind == "revolute" or item.motor else "N"
            usual = {"current": "A", "voltage": "V"}.get(what, usual)
            units.append(item.unit if item.unit in ("N.m", "N", "A") else usual)
        sure = all(item.unit in ("N.m", "N", "A") for item in columns)
        values = self._values(columns)
        largest = ", ".join(f"{value:.3g}" for value in np.abs(values).max(axis=0))
        self.draft_.read.append(f"torque {_listed(columns)} in {'/'.join(dict.fromkeys(units))}")
        lines = [f"[recording.torque] # largest values: {largest}", *self._source(columns)]
        lines.append(
            f"unit = {json.dumps(units[0] if len(set(units)) == 1 else units)}"
            + ("" if sure else " # confirm")
        )
        if set(units) & {"A", "V"}:
            motor = all(item.motor for item in columns)
            if self.robot.gains is not None and (motor or self.robot.reduction is None):
                lines.append("# gain: that of the robot file")
            else:
                lines.append(
                    f"# gain = 1.0 # how many N.m are one {units[0]}? One number, or one for each joint"
                )
                self._ask(f"how many N.m are one {units[0]} (gain under [recording.torque])?")
        return [*lines, self._side(columns)]

    def _signal(self, position: list[Column]) -> list[str]:
        lines = [
            "",
            "# Filters: positions without delay, then torques and model down to the band of the motion.",
        ]
        rate = self.rate
        if rate is None or not position:
            return [*lines, "# [signal]", "# cutoff_hz = 40", "# decimation = [10]"]
        q = self._values(position)
        band = motion_band(Recording.from_arrays(q, rate_hz=rate)) if len(q) >= 64 else 0.0
        # Below a fifth of the rate; a log that is slower than its motion is `didim check`'s to tell.
        cutoff = min(CUTOFF_TIMES * band if band > 0.0 else 0.04 * rate, 0.2 * rate)
        cutoff = float(f"{cutoff:.2g}")
        # Down to twice the cut-off, in stages of 10 at most: one filter for more would be unsound.
        factor = int(min(0.5 * rate / cutoff, len(q) / 200))
        stages: list[int] = []
        while factor >= 2:
            stage = min(factor, 10)
            stages.append(stage)
            factor //= stage
        trim = int(min(round(2.0 * rate / cutoff), len(q) // 20))
        return [
            *lines,
            f"[signal] # the motion ends near {band:.3g} Hz",
            f"cutoff_hz = {cutoff:g}",
            f"trim_start = {trim}",
            f"trim_end = {trim}",
            f"decimation = {stages}",
        ]


def _listed(columns: list[Column]) -> str:
    return ", ".join(str(item.name) for item in columns)
